"""Make measurements with hidden effects: number, effects, sizes and rig drawn by seed, integrated in time, with noise.

Each case is a table and a rig file that knows nothing of what is hidden. The truth goes to another file, which no
command reads: only `experiments/stories.py` opens it, after the tool has answered.

    python tests/make_hidden.py rotorjax/data/hidden experiments/hidden_truth.toml
"""

import argparse
from pathlib import Path

import jax
import numpy as np

from rotorjax import Jeffcott
from rotorjax.effects import CATALOG
from rotorjax.model.contract import API_670_RUNOUT, RestoringEffect, WaveformEffect

import hidden

SEED, CASES = 2565, 6
RUNS = ("baseline", "trial-a", "trial-b")


def draw_machine(rng: np.random.Generator) -> hidden.Machine:
    stiffness = float(np.exp(rng.uniform(np.log(3e4), np.log(1e6))))
    ratio = rng.uniform(0.02, 0.06, 2)
    return hidden.Machine(
        float(np.exp(rng.uniform(0.0, 2.0))),
        (round(stiffness), round(stiffness * rng.uniform(0.85, 1.0))),
        tuple(ratio.round(4).tolist()),
    )


LEFT_OUT = {
    "plane_participation", "misalignment", "sweep_rate",
    # Came after the draw.
    "speed_dependent_cross_coupling",
}  # fmt: skip

LATER = {"damping_angle_rad"}
"""Parameters that came after the draw."""
SCALES = {"runout": API_670_RUNOUT}
"""Prior scales that were others when the cases were drawn."""


def draw_effects(rng: np.random.Generator, rotor: Jeffcott) -> dict[str, list[float]]:
    """None, one or two effects, each parameter a half to one and a half prior scales from its null."""
    # One plane, 1X only, steady speeds, and nothing that makes the orders depend on one another.
    coupled = {n for n, cls in CATALOG.items() if issubclass(cls, RestoringEffect | WaveformEffect)}
    names = [n for n in CATALOG if n not in coupled | LEFT_OUT]
    chosen = rng.choice(names, size=rng.choice([0, 1, 2], p=[0.1, 0.6, 0.3]), replace=False)
    drawn = {}
    for name in map(str, chosen):
        values = []
        for p in CATALOG[name].parameters():
            count = 2 if "probe" in p.axes else 1
            scale = SCALES.get(p.of) or p.prior_scale(rotor)
            if p.name in LATER:
                values += [0.0] * count
                continue
            values += (scale * rng.uniform(0.5, 1.5, count) * rng.choice([-1.0, 1.0], count)).tolist()
        if name == "foundation":
            values[0] = abs(values[0])
        drawn[name] = values
    return drawn


def write_case(folder: Path, machine: hidden.Machine, plan: hidden.Plan, z: np.ndarray) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    x, y = machine.stiffness
    rig = [
        "[rotor]", f"mass_kg = {machine.mass!r}", f"stiffness_n_per_m = {{ x = {x}, y = {y} }}",
        f"damping_ratio = {{ x = {machine.ratio[0]}, y = {machine.ratio[1]} }}", "[probes]",
        "X = { angle_deg = 0.0 }", "Y = { angle_deg = 90.0 }",
    ]  # fmt: skip
    lines = ["run,speed_rpm,probe,order,amplitude_um,phase_deg,sigma_um"]
    sigma = f"{plan.sigma * 1e6:.4f}"
    cells = iter(z)
    for run, (weight,) in plan.weights.items():
        size, angle = abs(weight) * 1e6, np.degrees(np.angle(weight))
        rig += [f"[runs.{run}]", f"unbalance = {{ magnitude_g_mm = {size:.6f}, angle_deg = {angle:.4f} }}"]
        for speed in plan.speeds:
            for probe, value in zip("XY", next(cells)[:, 0], strict=True):
                lines.append(
                    f"{run},{speed * 30 / np.pi:.6f},{probe},1,"
                    f"{abs(value) * 1e6:.6f},{np.degrees(np.angle(value)):.5f},{sigma}"
                )
    (folder / "rig.toml").write_text("\n".join(rig) + "\n", encoding="utf-8")
    (folder / "measurement.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("truth", type=Path)
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    truth = [
        "# What is hidden in rotorjax/data/hidden, in SI, in the order of the catalogue page. Never read by the tool."
    ]
    for case in range(1, CASES + 1):
        rng = np.random.default_rng([SEED, case])
        machine = draw_machine(rng)
        rotor = Jeffcott(machine.mass, list(machine.stiffness), list(machine.ratio))
        weights = (
            rotor.quantities()["unbalance"] * np.array([0.0, 5.0, 5.0]) * np.exp(1j * np.radians([0.0, 0.0, 120.0]))
        )
        speeds = machine.frequency * np.array([0.5, 0.65, 0.8, 0.9, 0.96, 1.04, 1.12, 1.25, 1.4, 1.6])
        sigma = rotor.quantities()["eccentricity"] * rng.uniform(0.003, 0.02)
        plan = hidden.Plan(
            {run: [complex(w)] for run, w in zip(RUNS, weights, strict=True)}, tuple(speeds), sigma=round(sigma, 10)
        )
        drawn = draw_effects(rng, rotor)
        write_case(arguments.folder / f"case_{case}", machine, plan, hidden.measure(machine, plan, drawn, rng))
        truth += [f"[case_{case}]", *(f"{name} = {values}" for name, values in drawn.items())]
    arguments.truth.write_text("\n".join(truth) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
