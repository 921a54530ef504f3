"""The command line. The only place that prints or sets JAX's global options."""

import argparse
import contextlib
import json
import os
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rotorjax.errors import InputError

if TYPE_CHECKING:
    from rotorjax.data.measurement import Measurement
    from rotorjax.data.rig import Rig
    from rotorjax.discovery.explain import Explanation
    from rotorjax.discovery.story import Story
    from rotorjax.model.contract import Effect
    from rotorjax.model.model import Model

BAD_INPUT, INTERRUPTED = 2, 130
MOST_PROBLEMS = 20
TICK_S = 1.0
"""How often the time elapsed is shown anew."""


def main(arguments: list[str] | None = None) -> int:
    """Run one command. **Returns** the exit status: 0 done, 2 bad input."""
    parser = _parser()
    options = parser.parse_args(arguments)
    try:
        options.command(options)
    except InputError as error:
        print("\n".join(f"rotorjax: {problem}" for problem in error.problems[:MOST_PROBLEMS]), file=sys.stderr)
        if len(error.problems) > MOST_PROBLEMS:
            print(f"rotorjax: and {len(error.problems) - MOST_PROBLEMS} more problems", file=sys.stderr)
        return BAD_INPUT
    except KeyboardInterrupt:
        print("rotorjax: stopped", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:
        _leave_output()
    return 0


def _say(text: str) -> None:
    """Print; that the reader of a pipe has seen enough does not cost the files asked for."""
    try:
        print(text, flush=True)
    except BrokenPipeError:
        _leave_output()


def _leave_output() -> None:
    """Nobody reads standard output any more; Python would complain once more when it closes it."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="rotorjax", description="Hold a rotor model against vibration measurements and find what it lacks.")
    parser.add_argument("--version", action="version", version=f"rotorjax {version('rotorjax')}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    def command(name: str, run: Callable[[argparse.Namespace], None], what: str) -> argparse.ArgumentParser:
        sub = commands.add_parser(name, help=what, description=what)
        sub.set_defaults(command=run)
        return sub

    sub = command("compare", _compare, "where a model fails against a measurement; add effects and watch the error fall")
    sub.add_argument("data", type=Path, metavar="DATA.csv", help="measurement table")
    sub.add_argument("--rig", type=Path, required=True, metavar="RIG.toml")
    _effect_option(sub, "add this effect and fit what is not given")
    sub.add_argument("--write-rig", type=Path, metavar="NEW.toml", help="write the fitted model as a rig file")
    sub.add_argument("--json", type=Path, metavar="FILE", help="write the result as JSON")
    sub.add_argument("--report", type=Path, metavar="FILE.html", help="write a report with pictures, one file")

    sub = command("explain", _explain, "which physical effect is missing, how sure, what ties with it, what to measure next")
    sub.add_argument("data", type=Path, metavar="DATA.csv", help="measurement table")
    sub.add_argument("--rig", type=Path, required=True, metavar="RIG.toml")
    sub.add_argument("--max-effects", type=int, default=3, metavar="N", help="add at most so many (3)")
    sub.add_argument("--only", metavar="A,B", help="only these may be missing")
    sub.add_argument("--exclude", default="", metavar="A,B", help="these are not missing")
    sub.add_argument("--write-rig", type=Path, metavar="NEW.toml", help="write the explained model as a rig file")
    sub.add_argument("--json", type=Path, metavar="FILE", help="write the result as JSON")
    sub.add_argument("--report", type=Path, metavar="FILE.html", help="write a report with pictures, one file")

    sub = command("diagnose", _diagnose, "unbalance and bow of every run, with standard errors")
    sub.add_argument("data", type=Path, metavar="DATA.csv")
    sub.add_argument("--rig", type=Path, required=True, metavar="RIG.toml")
    sub.add_argument("--reference", action="append", default=[], metavar="RUN", help="run whose installed faults are known: the rest is inherent")
    sub.add_argument("--json", type=Path, metavar="FILE")

    sub = command("simulate", _simulate, "make a measurement table from a model")
    sub.add_argument("--rig", type=Path, required=True, metavar="RIG.toml")
    what = sub.add_mutually_exclusive_group(required=True)
    what.add_argument("--like", type=Path, metavar="DATA.csv", help="the runs, speeds, probes and orders of this table")
    what.add_argument("--speeds", metavar="LOW:HIGH:COUNT", help="every run of the rig file at these speeds, in rpm")
    sub.add_argument("--orders", metavar="1,2", help="orders, with --speeds")
    _effect_option(sub, "add this effect")
    sub.add_argument("--noise-um", type=float, default=0.0, metavar="SIGMA", help="standard error of real and of imaginary part")
    sub.add_argument("--seed", type=int, default=0)
    sub.add_argument("--output", type=Path, required=True, metavar="DATA.csv")

    sub = command("effects", _effects, "the catalogue of effects, or one of them in full")
    sub.add_argument("name", nargs="?")

    sub = command("paper", _paper, "every table and figure of Huang et al. 2026 (Sensors 26:2565), recomputed")
    sub.add_argument("--output", type=Path, default=Path("paper_tables"), metavar="DIR", help="folder to write to (default: paper_tables)")

    sub = command("example", _example, "write a table, a rig file and what to type: a start for your own data")
    sub.add_argument("folder", type=Path, metavar="DIR")
    return parser


def _effect_option(sub: argparse.ArgumentParser, what: str) -> None:
    sub.add_argument("--effect", action="append", default=[], metavar="NAME[:PARAMETER=VALUE,...]", help=f"{what}; may be repeated")


def _compute() -> None:
    """Double precision, and compiled programs kept for the next process."""
    import jax

    jax.config.update("jax_enable_x64", True)
    if cache := os.environ.get("JAX_COMPILATION_CACHE_DIR") or _cache_folder():
        jax.config.update("jax_compilation_cache_dir", cache)
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.1)


def _cache_folder() -> str | None:
    """A folder of the user's for compiled programs; none where it cannot be made."""
    folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "rotorjax"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return None
    return str(folder)


def _read(options: argparse.Namespace) -> "tuple[Rig, Measurement]":
    from rotorjax.data.rig import read_rig
    from rotorjax.data.table import read_table

    rig = read_rig(options.rig)
    table = read_table(options.data, probes=rig.model.layout.probes)
    for note in table.notes:
        print(f"rotorjax: note: {note}", file=sys.stderr)
    return rig, rig.measurement(table, options.data)


def _check_outputs(options: argparse.Namespace) -> None:
    """Refuse outputs that would overwrite an input or one another, or cannot be written, before anything is computed."""
    read = {path.resolve(): f"{path} is read" for path in (getattr(options, n, None) for n in ("data", "rig", "like")) if path}
    problems = []
    for name in ("json", "report", "write_rig", "output"):
        path = getattr(options, name, None)
        if path is None:
            continue
        flag = "--" + name.replace("_", "-")
        if path.resolve() in read:
            problems.append(f"{flag} {path}: {read[path.resolve()]} by the same command; choose another file")
        elif path.is_dir() or not path.name:
            problems.append(f"{flag} {path}: is a folder; name a file")
        elif not path.parent.is_dir():
            problems.append(f"{flag} {path}: cannot be written, the folder {path.parent} does not exist; make it first")
        read.setdefault(path.resolve(), f"{path} is written")
    if problems:
        raise InputError(*problems)


def _compare(options: argparse.Namespace) -> None:
    _check_outputs(options)
    _compute()
    from rotorjax.discovery.story import tell
    from rotorjax.reporting.comparison import comparison_json, comparison_text

    rig, measurement = _read(options)
    additions, fixed = parse_effects(options.effect, rig.model.with_orders(measurement.orders))
    declared = {uncertain.effect for uncertain in measurement.knowledge.uncertain}
    if already := [effect.name for effect in additions if effect.name in declared]:
        raise InputError(f"--effect {already[0]}: the rig file declares it uncertain, so that it is estimated along in any case; leave it out")
    story = tell(rig.model, measurement, additions, fixed=fixed)
    _say(comparison_text(story))
    _write_outputs(options, rig, story.final_model, comparison_json(story), story, f"{options.data.name} against {options.rig.name}")


def _write_outputs(options: argparse.Namespace, rig: "Rig", model: "Model", content: dict[str, Any], result: "Story | Explanation", title: str) -> None:
    """The files that a comparison or an explanation was asked for."""
    if options.write_rig:
        rig.write(options.write_rig, model)
    if options.json:
        _write_json(options.json, content)
    if options.report:
        result.report(options.report, rig, title=title)
        print(f"\nReport: {options.report}")


def _explain(options: argparse.Namespace) -> None:
    _check_outputs(options)
    if options.max_effects < 0:
        raise InputError(f"--max-effects {options.max_effects}: must be zero or more")
    only, exclude = (_effect_names(flag, text) for flag, text in (("--only", options.only), ("--exclude", options.exclude)))
    with progress_line() as progress:
        progress(f"reading {options.data}")
        _compute()
        from rotorjax.discovery.explain import explain
        from rotorjax.reporting.explanation import explanation_text
        from rotorjax.reporting.explanation_json import explanation_json

        rig, measurement = _read(options)
        declared = {uncertain.effect for uncertain in measurement.knowledge.uncertain}
        if held := [name for name in only or () if name in rig.model or name in declared]:
            how = "declares it uncertain, so that it is estimated along in any case" if held[0] in declared else "has it in [effects] already"
            raise InputError(f"--only {held[0]}: the rig file {how}; leave it out here, or there")
        found = explain(rig.model, measurement, max_effects=options.max_effects, only=only, exclude=exclude or (), progress=progress)
    _say(explanation_text(found, rig))
    _write_outputs(options, rig, found.model, explanation_json(found, rig), found, f"{options.data.name}: what {options.rig.name} lacks")


@contextlib.contextmanager
def progress_line() -> Iterator[Callable[[str], None]]:
    """Says on standard error what is being done and for how long: on a terminal in place, gone at the end, elsewhere a line for every stage.

    While it lasts Ctrl-C ends the process at once, in the midst of a compilation too.
    """
    began, terminal, stage, over = time.monotonic(), sys.stderr.isatty(), [""], threading.Event()

    def show(line: str) -> None:
        elapsed = f"{time.monotonic() - began:4.0f} s"
        print(f"\r\x1b[K{elapsed}  {line} ..." if terminal else f"{elapsed}  {line}", end="" if terminal else "\n", file=sys.stderr, flush=True)

    def progress(line: str) -> None:
        stage[0] = line
        show(line)

    def tick() -> None:
        while not over.wait(TICK_S):
            show(stage[0])

    if terminal:
        threading.Thread(target=tick, daemon=True).start()
    try:
        with _interruptible():
            yield progress
    finally:
        over.set()
        if terminal:
            print("\r\x1b[K", end="", file=sys.stderr, flush=True)


@contextlib.contextmanager
def _interruptible() -> Iterator[None]:
    """Ends the process at Ctrl-C without waiting for compiled code to come back. Nothing is written meanwhile, so that nothing is lost."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    woken, waker = socket.socketpair()
    waker.setblocking(False)
    before = signal.set_wakeup_fd(waker.fileno(), warn_on_full_buffer=False)

    def wait() -> None:
        while number := woken.recv(1):
            if number[0] == signal.SIGINT:
                print("\nrotorjax: stopped", file=sys.stderr, flush=True)
                os._exit(INTERRUPTED)

    waiting = threading.Thread(target=wait, daemon=True)
    waiting.start()
    try:
        yield
    finally:
        signal.set_wakeup_fd(before)
        waker.close()
        waiting.join()
        woken.close()


def _effect_names(flag: str, text: str | None) -> tuple[str, ...] | None:
    """Names of effects, separated by commas, all known."""
    if text is None:
        return None
    from rotorjax.data.section import nearest
    from rotorjax.effects import CATALOG

    names = tuple(name.strip() for name in text.split(",") if name.strip())
    if unknown := [name for name in names if name not in CATALOG]:
        raise InputError(*(f"{flag}: unknown effect {name!r}; {nearest(name, CATALOG)}" for name in unknown))
    return names


def _write_json(path: Path, content: dict[str, Any]) -> None:
    from rotorjax.data.files import write_whole

    write_whole(path, json.dumps(content, indent=2, allow_nan=False, ensure_ascii=False) + "\n")


def parse_effects(texts: list[str], model: "Model") -> "tuple[list[Effect], frozenset[str]]":
    """Effects from ``NAME:PARAMETER=VALUE,...`` as the command line gives them, and the keys of the values given."""
    from rotorjax.data.rig import effect_from_labels
    from rotorjax.data.section import nearest
    from rotorjax.effects.terms import NAMED

    effects, fixed, problems = [], set(), []
    for text in texts:
        name, _, assignments = text.partition(":")
        if name in {effect.name for effect in effects}:
            problems.append(f"--effect {text}: {name} is there already; give all its values in one --effect")
            continue
        if name not in NAMED:
            problems.append(f"--effect {text}: unknown effect {name!r}; {nearest(name, NAMED)}")
            continue
        labels = [label for p in NAMED[name].parameters() for label in p.labels(model.layout)]
        given: dict[str, float] = {}
        for assignment in filter(None, assignments.split(",")):
            parameter, _, value = assignment.partition("=")
            matching = [label for label in labels if label == parameter or label.startswith(f"{parameter}.")]
            if set(matching) & set(given):
                problems.append(f"--effect {text}: {parameter} is given twice; keep one value")
            if not matching:
                problems.append(f"--effect {text}: {name} has no parameter {parameter!r}; {nearest(parameter, labels)}")
            try:
                number = float(value)
                if not abs(number) < float("inf"):
                    raise ValueError(value)
            except ValueError:
                problems.append(f"--effect {text}: {value!r} is not a finite number; write {parameter}=1.5")
                continue
            given.update(dict.fromkeys(matching, number))
        fixed |= {f"{name}.{label}" for label in given}
        effects.append(effect_from_labels(NAMED[name], model.layout, _beyond(model, name, given)))
    if problems:
        raise InputError(*problems)
    return effects, frozenset(fixed)


def _beyond(model: "Model", name: str, given: dict[str, float]) -> dict[str, float]:
    """Values given less those that the model has already: what is added makes up the value given."""
    present = model.find(name)
    if present is None:
        return given
    labels = [label for p in present.parameters() for label in p.labels(model.layout)]
    has = dict(zip(labels, (float(v) for value in present.values() for v in value.ravel()), strict=True))
    return {label: value - has[label] for label, value in given.items()}


def _diagnose(options: argparse.Namespace) -> None:
    _check_outputs(options)
    _compute()
    from rotorjax.diagnosis.inverse import diagnose
    from rotorjax.reporting.diagnosis import diagnosis_json, diagnosis_text

    rig, measurement = _read(options)
    try:
        diagnosis = diagnose(rig.model, measurement, reference=tuple(options.reference))
    except ValueError as error:
        raise InputError(f"{options.data}: {error}") from error
    _say(diagnosis_text(diagnosis, rig, measurement))
    if options.json:
        _write_json(options.json, diagnosis_json(diagnosis, rig, measurement))


def _simulate(options: argparse.Namespace) -> None:
    _check_outputs(options)
    if options.like and options.orders:
        raise InputError("--orders goes with --speeds; with --like the table's orders are taken")
    _compute()
    from rotorjax.data.rig import read_measurement, read_rig
    from rotorjax.data.simulate import noisy, plan_like, plan_speeds
    from rotorjax.physics.stability import steadiness
    from rotorjax.reporting.comparison import objections

    rig = read_rig(options.rig)
    if not 0.0 <= options.noise_um < float("inf"):
        raise InputError(f"--noise-um {options.noise_um}: must be a finite number, zero or more")
    plan = plan_like(read_measurement(options.like, rig)) if options.like else plan_speeds(rig, options.speeds, options.orders or "1")
    model = rig.model.with_orders(plan.orders)
    additions, given = parse_effects(options.effect, model)
    for effect in additions:
        if not any(key.startswith(f"{effect.name}.") for key in given):
            raise InputError(f"--effect {effect.name}: give its values, like {effect.name}:{effect.parameters()[0].name}=1.0")
    full = model.plus(additions)
    made = noisy(full, plan, noise_um=options.noise_um, seed=options.seed)
    rig.write_measurement(options.output, made)
    print(f"{int(made.present.sum())} vectors of {len(made.runs)} runs written to {options.output}")
    for line in (*objections(full), *steadiness(full, plan.conditions)):
        print(line)


def _effects(options: argparse.Namespace) -> None:
    from importlib.resources import files

    from rotorjax.reporting.tables import Table

    catalogue = json.loads((files("rotorjax") / "data" / "catalogue.json").read_text(encoding="utf-8"))
    if options.name is None:
        rows = [[effect["family"], name, effect["meaning"]] for name, effect in catalogue.items() if not name.startswith("term_")]
        note = "\n`rotorjax effects NAME` shows its equation, parameters, prior scales and source.\nSimple terms of a missing force, along one axis: "
        note += ", ".join(name for name in catalogue if name.startswith("term_")) + "."
        print(Table("", ["family", "effect", "what it is"], rows, note).text())
    elif options.name in catalogue:
        print(catalogue[options.name]["page"])
    else:
        from rotorjax.data.section import nearest

        raise InputError(f"unknown effect {options.name!r}; {nearest(options.name, catalogue)}")


def _paper(options: argparse.Namespace) -> None:
    _compute()
    from rotorjax.paper.pages import prepare, reproduce
    from rotorjax.paper.study import Study

    prepare(options.output)
    print(
        reproduce(Study(progress=lambda line: print(f"{line} ...", file=sys.stderr)), options.output),
        f"\nWritten to {options.output}: begin with README.md.",
        sep="\n",
    )


def _example(options: argparse.Namespace) -> None:
    from rotorjax.data.example import write_example

    print(write_example(options.folder))


if __name__ == "__main__":
    sys.exit(main())
