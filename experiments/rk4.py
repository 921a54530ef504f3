"""The main job: a Jeffcott model held against real measurements of an RK4 rotor kit, effect by effect.

Prints where the model as declared fails, how the error falls as effects are added by name, on all data and on runs
held out, and writes a report, the result as JSON and the fitted model.

    python experiments/rk4.py --output output
"""

import argparse
import dataclasses
import json
import time
from importlib.resources import as_file, files
from pathlib import Path

import jax

from rotorjax import effects, read_measurement, read_rig, tell
from rotorjax.cli import write_report
from rotorjax.pictures import headline_figure
from rotorjax.report import comparison_json, comparison_text


@dataclasses.dataclass(frozen=True)
class Config:
    """What is added, in this order."""

    effects: tuple[str, ...] = ("residual_unbalance", "phase_reference_offset", "probe_angle", "plane_participation")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=Path("output"))
    parser.add_argument("--picture", type=Path, help="write the README's picture too")
    arguments = parser.parse_args()
    output = arguments.output
    jax.config.update("jax_enable_x64", True)
    begin = time.perf_counter()
    with as_file(files("rotorjax") / "data" / "rk4") as folder:
        rig = read_rig(folder / "rig.toml")
        measurement = read_measurement(folder / "measurement.csv", rig)
    story = tell(rig.model, measurement, [effects.CATALOG[name]() for name in Config().effects])
    output.mkdir(parents=True, exist_ok=True)
    print("Bently Nevada RK4 rotor kit, plane 2 (measured by M. Nouioua, KFUPM; doi 10.5281/zenodo.23152815)\n")
    print(comparison_text(story))
    write_report(output / "rk4.html", story, title="RK4 rotor kit, plane 2: a Jeffcott model against the measurement")
    (output / "rk4.json").write_text(json.dumps(comparison_json(story), indent=2, allow_nan=False) + "\n", encoding="utf-8")
    rig.write(output / "rk4_fitted.toml", story.final_model)
    if arguments.picture:
        headline_figure(story).savefig(arguments.picture, dpi=110)
    print(f"\nDone in {time.perf_counter() - begin:.0f} s. Open {output / 'rk4.html'} in a browser.")
    print(f"The fitted model is {output / 'rk4_fitted.toml'}; the numbers are in {output / 'rk4.json'}.")


if __name__ == "__main__":
    main()
