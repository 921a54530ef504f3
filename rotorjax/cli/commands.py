"""One function for each command."""

import argparse
import contextlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rotorjax.cli.arguments import check_outputs, check_search, effect_names, parse_effects, parse_mistake
from rotorjax.cli.progress import progress_line
from rotorjax.cli.recordings import read_recorded, table_or_recordings
from rotorjax.cli.terminal import aside, note, say, terminal_width
from rotorjax.compilation import use_double_precision
from rotorjax.data.files import write_whole
from rotorjax.errors import InputError, do_every

if TYPE_CHECKING:
    from rotorjax.data.measurement import Measurement
    from rotorjax.data.record_vectors import Records
    from rotorjax.data.rig import Rig
    from rotorjax.discovery.explanation import Explanation
    from rotorjax.discovery.story import Story
    from rotorjax.model.model import Model

LARGEST_SEED = 2**31 - 1


def compare(options: argparse.Namespace) -> None:
    """The model against a measurement, effects added one after the other."""
    source = table_or_recordings(options)
    check_outputs(options)
    use_double_precision()
    from rotorjax.discovery.story import tell
    from rotorjax.reporting.comparison import comparison_text
    from rotorjax.reporting.comparison_json import comparison_json

    rig, measurement, records = _measured(options)
    mistake, named = parse_mistake(options.effect, rig.model, measurement)
    additions, fixed = parse_effects(named, rig.model.with_orders(measurement.orders))
    declared = {uncertain.effect for uncertain in measurement.knowledge.uncertain}
    if already := [effect.name for effect in additions if effect.name in declared]:
        raise InputError(
            f"--effect {already[0]}: the rig file declares it uncertain, so that it is fitted in any case; leave it out"
        )
    healthy = _of_healthy(options, rig)
    story = tell(rig.model, measurement, additions, fixed=fixed, mistake=mistake, healthy=healthy)
    _hand_over(
        options,
        rig,
        comparison_text(story, rig.put_right(mistake).convention, width=terminal_width()),
        story.final_model,
        comparison_json(story),
        story,
        source.name if options.recordings else f"{source.name} against {options.rig.name}",
        records,
    )


def _hand_over(
    options: argparse.Namespace,
    rig: "Rig",
    text: str,
    model: "Model",
    content: dict[str, Any],
    result: "Story | Explanation",
    title: str,
    records: "Records | None",
) -> None:
    """The text of a comparison or an explanation, and the files that were asked for."""

    def write_rig() -> None:
        if not rig.write(options.write_rig, model, result.mistake):
            assert result.mistake is not None
            cure = f"change by hand: {result.mistake.cure}"
            say(f"\n{options.write_rig} still has the wrong entry; {cure}.")

    def report() -> None:
        result.report(options.report, rig, title=title, records=records)
        say(f"\nReport: {options.report}")

    do_every(
        lambda: say(text),
        options.write_rig and write_rig,
        options.json and (lambda: _write_json(options.json, content)),
        options.report and report,
    )


def explain(options: argparse.Namespace) -> None:
    """What is missing."""
    source = table_or_recordings(options)
    check_outputs(options)
    check_search(options)
    only, exclude = (
        effect_names(flag, text, with_mistakes=options.mistakes is not False)
        for flag, text in (("--only", options.only), ("--exclude", options.exclude))
    )
    with progress_line() as progress:
        progress(f"reading {source}")
        use_double_precision()
        from rotorjax.discovery.explain import explain
        from rotorjax.reporting.explanation import explanation_text
        from rotorjax.reporting.explanation_json import explanation_json

        rig, measurement, records = _measured(options, progress)
        rig.check_only(only or (), measurement)
        found = explain(
            rig.model,
            measurement,
            max_effects=options.max_effects,
            limit=options.limit,
            only=only,
            exclude=exclude or (),
            mistakes=options.mistakes,
            progress=progress,
            healthy=_of_healthy(options, rig),
        )
    _hand_over(
        options,
        rig,
        explanation_text(found, rig, width=terminal_width()),
        found.model,
        explanation_json(found, rig),
        found,
        f"{source.name}: what {'the model' if options.recordings else options.rig.name} lacks",
        records,
    )


def diagnose(options: argparse.Namespace) -> None:
    """Unbalance and bow of every run."""
    source = table_or_recordings(options)
    check_outputs(options)
    use_double_precision()
    from rotorjax.diagnosis.inverse import diagnose
    from rotorjax.reporting.diagnosis import diagnosis_json, diagnosis_text

    rig, measurement, _ = _measured(options)
    try:
        diagnosis = diagnose(rig.model, measurement, reference=tuple(options.reference))
    except ValueError as error:
        raise InputError(f"{source}: {error}") from error
    do_every(
        lambda: say(diagnosis_text(diagnosis, rig, measurement, width=terminal_width())),
        options.json and (lambda: _write_json(options.json, diagnosis_json(diagnosis, rig, measurement))),
    )


def simulate(options: argparse.Namespace) -> None:
    """A measurement table from a model."""
    check_outputs(options)
    if options.like and options.orders:
        raise InputError("--orders goes with --speeds; with --like the table's orders are taken")
    use_double_precision()
    from rotorjax.data.rig import read_measurement, read_rig
    from rotorjax.data.simulate import noisy, plan_like, plan_speeds
    from rotorjax.physics.stability import steadiness
    from rotorjax.reporting.comparison import objections
    from rotorjax.reporting.tables import wrapped

    rig = read_rig(options.rig)
    note(rig.notes)
    if not 0.0 <= options.noise_um < float("inf"):
        raise InputError(f"--noise-um {options.noise_um}: must be a finite number, zero or more")
    if abs(options.seed) > LARGEST_SEED:
        raise InputError(f"--seed {options.seed}: must be a whole number of at most {LARGEST_SEED}")
    if options.like:
        measured = read_measurement(options.like, rig)
        note(measured.notes)
        plan = plan_like(measured)
    else:
        plan = plan_speeds(rig, options.speeds, options.orders or "1")
    model = rig.model.with_orders(plan.orders)
    additions, given = parse_effects(options.effect, model)
    for effect in additions:
        if not any(key.startswith(f"{effect.name}.") for key in given):
            raise InputError(
                f"--effect {effect.name}: give its values, like {effect.name}:{effect.parameters()[0].name}=1.0"
            )
    full = model.plus(additions)
    made = noisy(full, plan, noise_um=options.noise_um, seed=options.seed)
    rig.write_measurement(options.output, made)
    say(f"{int(made.present.sum())} vectors of {len(made.runs)} runs written to {options.output}")
    for line in (*objections(full), *steadiness(full, plan.conditions)):
        say(wrapped(line, terminal_width()))


def effects(options: argparse.Namespace) -> None:
    """The catalogue, or one page of it, or what a word finds in it."""
    from rotorjax.cli.catalogue import effect_text

    say(effect_text(options.name, terminal_width()))


def paper(options: argparse.Namespace) -> None:
    """Tables and figures of the paper, recomputed."""
    use_double_precision()
    from rotorjax.paper.pages import prepare, reproduce
    from rotorjax.paper.study import Study

    prepare(options.output)
    say(reproduce(Study(progress=lambda line: aside(f"{line} ...")), options.output))
    say(f"\nWritten to {options.output}: begin with README.md.")


def example(options: argparse.Namespace) -> None:
    """A table, a rig file and what to type."""
    from rotorjax.data.example import write_example
    from rotorjax.reporting.tables import wrapped

    if options.recordings:
        use_double_precision()
    say(wrapped(write_example(options.folder, recordings=options.recordings), terminal_width()))


def _measured(
    options: argparse.Namespace, progress: "Callable[[str], None] | None" = None
) -> "tuple[Rig, Measurement, Records | None]":
    """Rig file and vectors, from a table or from recordings, and these.

    **Arguments:** ``progress`` of the recordings; a line of their own without it.
    """
    if options.recordings:
        with progress_line() if progress is None else contextlib.nullcontext(progress) as told:
            rig, measurement, records = read_recorded(options, told)
    else:
        from rotorjax.data.rig import read_measurement, read_rig

        rig = read_rig(options.rig)
        measurement, records = read_measurement(options.data, rig), None
    note(measurement.notes)
    return rig, measurement, records


def _of_healthy(options: argparse.Namespace, rig: "Rig") -> "Measurement | None":
    """The measurement of the healthy rotor, if there is one."""
    from rotorjax.data.rig import read_measurement

    healthy = rig.of_healthy(options.data) if options.healthy is None else read_measurement(options.healthy, rig)
    note(() if healthy is None else healthy.notes)
    return healthy


def _write_json(path: Path, content: dict[str, Any]) -> None:
    write_whole(path, json.dumps(content, indent=2, allow_nan=False, ensure_ascii=False) + "\n")
