"""The main job: three stories of what is missing in a rotor model, each found by `explain` and told in a report.

1. Real measurements of an RK4 rotor kit. 2. Data with hidden effects, made by time integration; what is hidden is
compared only after the answer. 3. The paper's own vectors, rebuilt from its tables 4 and 5, under two declarations of
the noise.

    python experiments/stories.py --output output
"""

import argparse
import dataclasses
import json
import time
import tomllib
from importlib.resources import as_file, files
from pathlib import Path

import jax

from rotorjax import Explanation, explain, read_measurement, read_rig
from rotorjax.cli.progress import progress_line
from rotorjax.data.rig import Rig
from rotorjax.reporting.explanation import explanation_text, notes, sentence
from rotorjax.reporting.explanation_json import explanation_json
from rotorjax.reporting.pictures import headline_figure
from rotorjax.reporting.tables import Table, number

MICROMETRE = 1e-6


@dataclasses.dataclass(frozen=True)
class Config:
    """What is run."""

    max_effects: int = 3
    hidden: tuple[str, ...] = ("case_1", "case_2", "case_3", "case_4", "case_5", "case_6")
    in_full: str = "case_5"


def solve(folder: Path, output: Path, name: str, title: str, rig_name: str = "rig.toml") -> tuple[Explanation, Rig]:
    """Explain one measurement; write report, JSON and the explained model, in the conventions of the rig file."""
    rig = read_rig(folder / rig_name)
    with progress_line() as progress:
        measurement = read_measurement(folder / "measurement.csv", rig)
        found = explain(
            rig.model, measurement, max_effects=Config().max_effects, progress=lambda line: progress(f"{name}: {line}")
        )
    found.report(output / f"{name}.html", rig, title=title)
    (output / f"{name}.json").write_text(
        json.dumps(explanation_json(found, rig), indent=2, allow_nan=False) + "\n", encoding="utf-8"
    )
    rig.write(output / f"{name}_explained.toml", found.model)
    return found, rig


def real(data: Path, output: Path) -> Explanation:
    print("1. REAL MEASUREMENTS: RK4 rotor kit, plane 2 (M. Nouioua, KFUPM; doi 10.5281/zenodo.23152815)\n", flush=True)
    found, rig = solve(data / "rk4", output, "rk4", "RK4 rotor kit, plane 2: what a Jeffcott model lacks")
    print(explanation_text(found, rig), end="\n\n\n")
    return found


def hidden(data: Path, output: Path) -> None:
    print(
        "2. HIDDEN EFFECTS: number, effects, sizes and rigs drawn by seed, integrated in time, with noise\n", flush=True
    )
    solved = {
        name: solve(data / "hidden" / name, output, f"hidden_{name}", f"Hidden effects, {name}")
        for name in Config().hidden
    }
    print(explanation_text(*solved[Config().in_full]), end="\n\n")
    with (Path(__file__).parent / "hidden_truth.toml").open("rb") as file:
        truth = tomllib.load(file)
    rows = []
    for name, (answer, _) in solved.items():
        views = answer.story
        ties = "; ".join(" or ".join(" + ".join(names) for names in group) for group in answer.ties.groups())
        rows.append(
            [
                name, ", ".join(truth[name]) or "nothing", ", ".join(answer.effects) or "nothing",
                ", ".join(s.effect for s in answer.detected_but_small),
                ties, answer.verdict, number(views.declared.rms / MICROMETRE), number(views.last.rms / MICROMETRE),
                number(views.noise_um()),
            ]
        )  # fmt: skip
    heads = ["case", "hidden", "found", "too small to matter", "ties", "verdict", "before µm", "after µm", "noise µm"]
    print(Table("All cases, with the truth that the tool did not read", heads, rows).text(), end="\n\n\n")


def paper(data: Path, output: Path) -> None:
    print(
        "3. THE PAPER'S OWN DATA: vectors rebuilt from tables 4 and 5 of Sensors 2026, 26, 2565 (rebuilt, not "
        "measured)\n",
        flush=True,
    )
    for rig_name, noise in (
        ("rig.toml", "sensor noise of 1 µm alone"),
        ("rig_scatter.toml", "a few per cent of scatter allowed"),
    ):
        name = "paper" if rig_name == "rig.toml" else "paper_scatter"
        found, _ = solve(data / "paper", output, name, f"The paper's vectors, {noise}", rig_name)
        print(f"With {noise}: {sentence(found)}\n")
        print("\n".join(f"- {line}" for line in notes(found)), end="\n\n")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=Path("output"))
    parser.add_argument("--picture", type=Path, help="write the picture of the measured vectors, docs/rk4.png, too")
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    begin = time.perf_counter()
    print(
        "Every measurement is explained, with a report for each: two to five minutes on two cores, a third of it the "
        "measured vectors.\n",
        flush=True,
    )
    arguments.output.mkdir(parents=True, exist_ok=True)
    with as_file(files("rotorjax") / "data") as data:
        rk4 = real(data, arguments.output)
        hidden(data, arguments.output)
        paper(data, arguments.output)
    if arguments.picture:
        headline_figure(rk4.story).savefig(arguments.picture, dpi=110)
    seconds = time.perf_counter() - begin
    print(
        f"\nDone in {seconds:.0f} s. Open {arguments.output / 'rk4.html'} and its neighbours in a browser; the .json "
        "files hold the numbers."
    )


if __name__ == "__main__":
    main()
