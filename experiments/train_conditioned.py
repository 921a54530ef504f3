"""One network for every speed from 600 to 3500 rpm: its error beside the least-squares inverse and beside a plain
network.

The plain network is the paper's perceptron with the speed as a fifth input, trained by Bayesian regularisation on
faults of one rotor at random speeds (Huang et al. 2026, Sensors 26:2565, section 2.2). A repeat prints the same digits.

    python experiments/train_conditioned.py --output output/conditioned
"""

import argparse
import csv
import dataclasses
import io
from collections.abc import Callable
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from tqdm import tqdm

from rotorjax import Jeffcott
from rotorjax.data.files import write_whole
from rotorjax.diagnosis.conditioned import ConditionedNetwork, train_conditioned
from rotorjax.diagnosis.dataset import sample_faults
from rotorjax.diagnosis.evidence_steps import Scaled
from rotorjax.diagnosis.features import FaultValues, components, feature_map, inverse_map
from rotorjax.diagnosis.network import Range
from rotorjax.diagnosis.training import BayesianRegularisation
from rotorjax.reporting.tables import Table, number

UNITS = np.array([1e-6, 1e-6, 1e-3, 1e-3])
"""g mm and mm."""
HEADS = (
    "speed rpm", "inverse, relative", "U g mm", "s mm", "exact U g mm", "exact s mm", "plain U g mm", "plain s mm",
    "noisy U g mm", "noisy s mm", "noisy U, ratio", "noisy s, ratio",
)  # fmt: skip


@dataclasses.dataclass(frozen=True)
class Config:
    """What is run: by default the paper's rotor (table 3, with the mass that reproduces its natural frequencies)."""

    output: Path = Path("output/conditioned")
    seed: int = 0
    speeds_rpm: tuple[float, ...] = (600.0, 1000.0, 1500.0, 2000.0, 2197.3, 2250.0, 2307.1, 2500.0, 3000.0, 3500.0)
    cases: int = 2000
    """Faults per speed up to 1000 g mm and 50 mm; and draws of noise."""
    small: tuple[float, float, float, float] = (10.0, 67.5, 0.5, 45.0)
    """The fault measured with noise: U [g mm], α [°], s [mm], θ [°]."""
    noise_um: float = 0.1
    rigs: int = 40
    plain_cases: int = 3000
    plain_epochs: int = 60


def relative(found: np.ndarray, exact: np.ndarray) -> float:
    """Error of an inverse, relative, the worse of its rows for unbalance and for bow."""
    return max(
        float(np.linalg.norm(found[rows] - exact[rows]) / np.linalg.norm(exact[rows]))
        for rows in (slice(0, 2), slice(2, 4))
    )


def largest(error: np.ndarray) -> list[float]:
    """Largest error of U [g mm] and of s [mm]."""
    e = error / UNITS
    return [float(np.max(np.hypot(e[:, k], e[:, k + 1]))) for k in (0, 2)]


def rms(error: np.ndarray) -> np.ndarray:
    """Root mean square error of U [g mm] and of s [mm]."""
    e = error / UNITS
    return np.sqrt(np.array([np.mean(e[:, k] ** 2 + e[:, k + 1] ** 2) for k in (0, 2)]))


def plain_network(config: Config, rotor: Jeffcott) -> Callable[[np.ndarray, float], np.ndarray]:
    """Faults from (f1, f2, f3, f4, Ω) by a 5-40-4 perceptron that nothing is told about."""
    faults_key, speeds_key, key = jax.random.split(jax.random.fold_in(jax.random.key(config.seed), 1), 3)
    faults = np.asarray(sample_faults(faults_key, config.plain_cases))
    speeds = np.asarray(jax.random.uniform(speeds_key, (config.plain_cases,), minval=600.0, maxval=3500.0))
    x = np.column_stack([np.einsum("nij,nj->ni", feature_map(rotor, speeds), faults), speeds])
    inputs, outputs = Range.of(x, "features and speed"), Range.of(faults, "faults")
    data = Scaled(jnp.asarray(inputs.scaled(x)), jnp.asarray(outputs.scaled(faults)))
    with tqdm(total=config.plain_epochs, desc="plain network", unit="epoch") as bar:
        perceptron = BayesianRegularisation(epochs=config.plain_epochs).fit(
            data, 40, key, lambda epoch, rms: bar.update(epoch - bar.n) and None
        )[0]

    def diagnose(f: np.ndarray, speed: float) -> np.ndarray:
        scaled = inputs.scaled(np.column_stack([f, np.full(len(f), speed)]))
        return np.asarray(outputs.unscaled(np.asarray(jax.vmap(perceptron)(jnp.asarray(scaled)))))

    return diagnose


def by_speed(config: Config, network: ConditionedNetwork, rotor: Jeffcott) -> list[list[str]]:
    """One row per speed."""
    plain = plain_network(config, rotor)
    drawn, noise = jax.random.split(jax.random.fold_in(jax.random.key(config.seed), 2))
    faults = np.asarray(sample_faults(drawn, config.cases))
    small = components(FaultValues(*config.small))
    noise = 1e-6 * config.noise_um * np.asarray(jax.random.normal(noise, (config.cases, 4)))
    rows = []
    for speed in tqdm(config.speeds_rpm, desc="speeds", unit="speed"):
        ours, exact, forward = (
            np.asarray(network.at(rotor, speed).matrix),
            inverse_map(rotor, speed),
            feature_map(rotor, speed)[0],
        )
        f, noisy = faults @ forward.T, forward @ small + noise
        values = [
            relative(ours, exact),
            *largest(f @ ours.T - faults),
            *largest(f @ exact.T - faults),
            *largest(plain(f, speed) - faults),
        ]
        with_noise, best = rms(noisy @ ours.T - small), rms(noisy @ exact.T - small)
        rows.append(
            [
                f"{speed:g}",
                *(f"{v:.2g}" for v in values),
                *(number(v) for v in with_noise),
                *(f"{v:.4f}" for v in with_noise / best),
            ]
        )
    return rows


def over_range(config: Config, network: ConditionedNetwork, rotor: Jeffcott) -> list[list[str]]:
    """Worst and median relative error of the inverse: of this rotor on a grid of speeds, and of random rotors."""
    grid = np.linspace(600.0, 3500.0, 117)
    own = [relative(np.asarray(network.at(rotor, float(s)).matrix), inverse_map(rotor, s)) for s in grid]
    draws = np.asarray(jax.random.uniform(jax.random.fold_in(jax.random.key(config.seed), 3), (config.rigs, 15)))
    others = []
    for u in tqdm(draws, desc="rotors", unit="rotor"):
        ratio, mass = 0.85 + 0.13 * u[0], 0.5 * 100.0 ** u[1]
        first = 1760.0 / 0.85 + (3000.0 - 1760.0 / 0.85) * u[2]
        rig = Jeffcott.from_critical_speed(
            mass=mass, critical_speed_rpm=[first, first * ratio], damping_ratio=0.002 + 0.048 * u[3:5]
        )
        others += [
            relative(np.asarray(network.at(rig, float(s)).matrix), inverse_map(rig, s)) for s in 600.0 + 2900.0 * u[5:]
        ]
    return [
        [name, f"{np.max(e):.2g}", f"{np.median(e):.2g}"]
        for name, e in (("the paper's", own), (f"{config.rigs} random rigs", others))
    ]


def run(config: Config) -> None:
    config.output.mkdir(parents=True, exist_ok=True)
    rotor = Jeffcott(0.9686, [56538.0, 51282.0], [0.0050, 0.0047])
    network = train_conditioned(jax.random.key(config.seed))
    network.save(config.output / "conditioned.json")
    rows = by_speed(config, network, rotor)
    lines = io.StringIO()
    csv.writer(lines, lineterminator="\n").writerows([HEADS, *rows])
    write_whole(config.output / "conditioned.csv", lines.getvalue())
    small = f"{config.small[0]:g} g mm and {config.small[2]:g} mm with noise of {config.noise_um:g} µm"
    note = (
        f"Largest errors without noise, faults up to 1000 g mm and 50 mm; noisy: root mean square errors at {small}, "
        "and over those of the exact inverse."
    )
    text = Table("The conditioned network on the paper's rotor", HEADS, rows, note).text()
    ranges = Table(
        "Relative error of the inverse, 600 to 3500 rpm",
        ("rotor", "worst", "median"),
        over_range(config, network, rotor),
    ).text()
    write_whole(config.output / "conditioned.md", f"```\n{text}\n\n{ranges}\n```\n")
    print(f"{text}\n\n{ranges}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--output", type=Path, default=Config.output, help="folder for network and tables (%(default)s)"
    )
    parser.add_argument("--seed", type=int, default=Config.seed, help="of JAX's random keys (%(default)s)")
    parser.add_argument(
        "--plain-epochs", type=int, default=Config.plain_epochs, help="steps of the plain network (%(default)s)"
    )
    jax.config.update("jax_enable_x64", True)
    try:
        run(Config(**vars(parser.parse_args())))
    except (ValueError, OSError) as error:
        parser.exit(2, f"{error}\n")


if __name__ == "__main__":
    main()
