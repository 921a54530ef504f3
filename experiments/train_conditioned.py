"""Train one network for all speeds and tabulate its error beside the exact inverse, speed by speed.

python experiments/train_conditioned.py --output output
"""

import argparse
import csv
import dataclasses
from pathlib import Path

import jax
import numpy as np
from tqdm import tqdm

from rotorjax.conditioned import train_conditioned
from rotorjax.features import FaultValues, components, feature_map, inverse_map
from rotorjax.paper.printed import rotor

UNITS = np.array([1e-6, 1e-6, 1e-3, 1e-3])


@dataclasses.dataclass(frozen=True)
class Config:
    """What is run."""

    seed: int = 0
    speeds_rpm: tuple[float, ...] = (600.0, 800.0, 1000.0, 1250.0, 1500.0, 1750.0, 2000.0, 2100.0, 2250.0, 2400.0, 2500.0, 2750.0, 3000.0, 3250.0, 3500.0)
    fault: tuple[float, float, float, float] = (10.0, 67.5, 0.5, 45.0)
    """U [g mm], α [°], s [mm], θ [°]."""
    noise: float = 1e-7
    """Standard error of a feature [m]."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=Path("output"))
    parser.add_argument("--seed", type=int, default=Config.seed)
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    config = Config(seed=arguments.seed)
    network, wheel, fault = train_conditioned(jax.random.key(config.seed)), rotor(), components(FaultValues(*config.fault))
    heads = ["speed_rpm", "error_U_g_mm", "error_s_mm", "exact_se_U_g_mm", "exact_se_s_mm", "ratio_U", "ratio_s"]
    rows = []
    for speed in tqdm(config.speeds_rpm, unit="speed"):
        ours, exact = np.asarray(network.at(wheel, speed).matrix), inverse_map(wheel, speed)
        miss = (ours @ feature_map(wheel, speed)[0] @ fault - fault) / UNITS
        noise, best = (config.noise * np.sqrt(np.sum(m**2, axis=1)) / UNITS for m in (ours, exact))
        whole = np.sqrt(noise**2 + miss**2)
        values = [
            np.hypot(*miss[:2]),
            np.hypot(*miss[2:]),
            best[0],
            best[2],
            np.hypot(*whole[:2]) / np.hypot(*best[:2]),
            np.hypot(*whole[2:]) / np.hypot(*best[2:]),
        ]
        rows.append([f"{speed:.0f}", *(f"{v:.3g}" for v in values)])
    arguments.output.mkdir(parents=True, exist_ok=True)
    path = arguments.output / "conditioned.csv"
    with path.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows([heads, *rows])
    print(path.read_text(encoding="utf-8"), end="")


if __name__ == "__main__":
    main()
