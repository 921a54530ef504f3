"""The main job: three stories of what is missing in a rotor model, each found by `explain` and told in a report.

1. Real measurements of an RK4 rotor kit. 2. Data with hidden effects, made by time integration; what is hidden is
compared only after the answer. 3. The paper's own vectors, rebuilt from its tables 4 and 5, under two declarations of
the noise.

    python experiments/stories.py --output output
"""

import argparse
import dataclasses
import json
import sys
import time
import tomllib
from collections.abc import Iterator
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any

import jax

from rotorjax import explain, read_measurement, read_rig
from rotorjax.batch.case import Case
from rotorjax.batch.pool import Processes, processors
from rotorjax.reporting.explanation import explanation_text, notes, sentence
from rotorjax.reporting.explanation_json import explanation_json
from rotorjax.reporting.pictures import headline_figure
from rotorjax.reporting.tables import Table, number

MICROMETRE = 1e-6
HIDDEN = ("case_1", "case_2", "case_3", "case_4", "case_5", "case_6")
IN_FULL = "case_5"
TRUTH = Path(__file__).parent / "hidden_truth.toml"


@dataclasses.dataclass(frozen=True)
class Task:
    """One measurement to be explained."""

    name: str
    """Of what is written."""
    title: str
    folder: tuple[str, ...]
    """Below the package's data."""
    output: Path
    rig: str = "rig.toml"
    picture: Path | None = None


def solve(task: Task) -> dict[str, Any]:
    """Explain one measurement; write report, JSON and the explained model, in the conventions of the rig file.

    **Returns** what is printed of it.
    """
    jax.config.update("jax_enable_x64", True)
    with as_file(files("rotorjax") / "data") as data:
        folder = data.joinpath(*task.folder)
        rig = read_rig(folder / task.rig)
        found = explain(rig.model, read_measurement(folder / "measurement.csv", rig))
    found.report(task.output / f"{task.name}.html", rig, title=task.title)
    (task.output / f"{task.name}.json").write_text(
        json.dumps(explanation_json(found, rig), indent=2, allow_nan=False) + "\n", encoding="utf-8"
    )
    rig.write(task.output / f"{task.name}_explained.toml", found.model)
    if task.picture:
        headline_figure(found.story).savefig(task.picture, dpi=110)
    views = found.story
    ties = "; ".join(" or ".join(" + ".join(names) for names in group) for group in found.ties.groups())
    row = [
        ", ".join(found.effects) or "nothing", ", ".join(s.effect for s in found.detected_but_small), ties,
        found.verdict, number(views.declared.rms / MICROMETRE), number(views.last.rms / MICROMETRE),
        number(views.noise_um()),
    ]  # fmt: skip
    return {"text": explanation_text(found, rig), "sentence": sentence(found), "notes": notes(found), "row": row}


def tasks(output: Path, picture: Path | None) -> list[Task]:
    """All measurements, those that take longest first."""
    rk4 = Task("rk4", "RK4 rotor kit, plane 2: what a Jeffcott model lacks", ("rk4",), output, picture=picture)
    title = "The paper's vectors, {}".format
    paper = Task("paper", title("sensor noise of 1 µm alone"), ("paper",), output)
    scatter = Task("paper_scatter", title("a few per cent of scatter allowed"), ("paper",), output, "rig_scatter.toml")
    hidden = [Task(f"hidden_{name}", f"Hidden effects, {name}", ("hidden", name), output) for name in HIDDEN]
    return [rk4, paper, scatter, *hidden]


def solved(asked: list[Task]) -> Iterator[tuple[str, dict[str, Any]]]:
    """What is printed of every measurement, in the order in which they end, with a line for each."""
    begin = time.perf_counter()
    outcomes = Processes(processors()).outcomes(solve, [Case(task.name, task) for task in asked])
    for done, outcome in enumerate(outcomes, 1):
        if outcome.row is None:
            sys.exit(f"{outcome.name}: {outcome.failure}")
        elapsed = time.perf_counter() - begin
        print(f"{outcome.name}: {done} of {len(asked)} measurements, {elapsed:.0f} s", file=sys.stderr, flush=True)
        yield outcome.name, json.loads(outcome.row)


def real(told: dict[str, Any]) -> None:
    print("1. REAL MEASUREMENTS: RK4 rotor kit, plane 2 (M. Nouioua, KFUPM; doi 10.5281/zenodo.23152815)\n")
    print(told["text"], end="\n\n\n")


def hidden(told: dict[str, dict[str, Any]]) -> None:
    print("2. HIDDEN EFFECTS: number, effects, sizes and rigs drawn by seed, integrated in time, with noise\n")
    print(told[IN_FULL]["text"], end="\n\n")
    with TRUTH.open("rb") as file:
        truth = tomllib.load(file)
    rows = [[name, ", ".join(truth[name]) or "nothing", *told[name]["row"]] for name in HIDDEN]
    heads = ["case", "hidden", "found", "too small to matter", "ties", "verdict", "before µm", "after µm", "noise µm"]
    print(Table("All cases, with the truth that the tool did not read", heads, rows).text(), end="\n\n\n")


def paper(alone: dict[str, Any], scatter: dict[str, Any]) -> None:
    print("3. THE PAPER'S OWN DATA: vectors rebuilt from tables 4 and 5 of Sensors 2026, 26, 2565 (not measured)\n")
    for words, told in (("sensor noise of 1 µm alone", alone), ("a few per cent of scatter allowed", scatter)):
        print(f"With {words}: {told['sentence']}\n")
        print("\n".join(f"- {line}" for line in told["notes"]), end="\n\n")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=Path("output"))
    parser.add_argument("--picture", type=Path, help="write the picture of the measured vectors, docs/rk4.png, too")
    arguments = parser.parse_args()
    begin = time.perf_counter()
    asked = tasks(arguments.output, arguments.picture)
    print(
        f"{len(asked)} measurements are explained, as many at one time as there are processors, with a report for "
        "each: one and a quarter to four minutes on two cores.\n",
        flush=True,
    )
    arguments.output.mkdir(parents=True, exist_ok=True)
    told = dict(solved(asked))
    real(told["rk4"])
    hidden({name: told[f"hidden_{name}"] for name in HIDDEN})
    paper(told["paper"], told["paper_scatter"])
    print(
        f"\nDone in {time.perf_counter() - begin:.0f} s. Open {arguments.output / 'rk4.html'} and its neighbours in a "
        "browser; the .json files hold the numbers."
    )


if __name__ == "__main__":
    main()
