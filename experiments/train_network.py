"""Table 1 of Huang et al. 2026 (Sensors 26:2565) over several seeds: the fault network trained in three ways.

For every seed, which draws cases and first weights anew: Bayesian regularisation as published, our default, and Optax
with L2. Errors are those on the test cases, without noise and with noise on the features, there beside the exact linear
inverse of the same noisy features. Five seeds of a thousand epochs take some ten minutes.

    python experiments/train_network.py --output output/training
"""

import argparse
import csv
import dataclasses
import io
import math
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np
import tabulate
from tqdm import tqdm

from rotorjax.data.files import write_whole
from rotorjax.diagnosis.compensation import LinearInverse
from rotorjax.diagnosis.dataset import Dataset, Split, make_dataset, split, with_noise
from rotorjax.diagnosis.training import BayesianRegularisation, Method, OptaxL2, Training, Whitened, rms_errors, train
from rotorjax.paper.printed import printed, rotor
from rotorjax.paper.tables import READINGS
from rotorjax.reporting.tables import number
from rotorjax.units import GRAM_MILLIMETRE

MILLIMETRE = 1e-3
COMPONENTS = ("U_x_g_mm", "U_y_g_mm", "s_x_mm", "s_y_mm")
UNITS = np.array([GRAM_MILLIMETRE, GRAM_MILLIMETRE, MILLIMETRE, MILLIMETRE])
NOISE_KEY = 1
"""Folded into a seed's key for the noise, which so differs from every other draw."""


@dataclasses.dataclass(frozen=True)
class Config:
    """What is run: by default the paper's dataset and number of epochs."""

    speed_rpm: float = 1500.0
    count: int = 10_000
    fractions: tuple[float, float, float] = (0.70, 0.15, 0.15)
    seeds: tuple[int, ...] = (0, 1, 2, 3, 4)
    epochs: int = 1000
    optax_steps: int = 2000
    noises: tuple[float, ...] = (1e-6, 1e-5, 1e-4)
    """Standard deviations of the noise on the test features, in half ranges."""
    chosen: tuple[str, ...] = ()
    """Names of the trainings to run; all if none is given."""

    def quick(self) -> "Config":
        """A minute's worth, to see that everything works; its errors mean nothing."""
        return dataclasses.replace(self, seeds=self.seeds[:2], epochs=3, optax_steps=100)

    def methods(self) -> dict[str, tuple[Method, int]]:
        """Name -> how to train, and the most steps that it makes."""
        default = Whitened()
        every: dict[str, tuple[Method, int]] = {
            "as published": (BayesianRegularisation(epochs=self.epochs), self.epochs),
            "default": (default, default.epochs),
            "Optax L2": (OptaxL2(steps=self.optax_steps), self.optax_steps),
        }
        return {name: every[name] for name in self.chosen or every}


class Noisy(NamedTuple):
    """Errors at one level of noise, of both components together."""

    unbalance_g_mm: float
    bow_mm: float
    unbalance_ratio: float
    """To the exact linear inverse on the same features."""
    bow_ratio: float


class Outcome(NamedTuple):
    """One training."""

    method: str
    seed: int
    seconds: float
    errors: np.ndarray
    """Of U_x, U_y [g mm], s_x, s_y [mm] on the test cases."""
    effective: float
    """Weights that the data determine, at the end; not a number where no step was made or the method has none."""
    epochs: int
    """Steps made."""
    stopped: str
    noisy: tuple[Noisy, ...]


def cases(config: Config, seed: int) -> Split:
    """The cases of a seed, those of `rotorjax.paper.study.Study` with the same seed."""
    draw, parts = jax.random.split(jax.random.key(seed))
    return split(make_dataset(rotor(), config.speed_rpm, config.count, key=draw), key=parts, fractions=config.fractions)


def pairs(errors: np.ndarray) -> tuple[float, float]:
    """Root mean square over both components of U, and of s."""
    unbalance, bow = np.sqrt(np.mean(errors.reshape(2, 2) ** 2, axis=1))
    return float(unbalance), float(bow)


def with_noisy_features(config: Config, seed: int, training: Training, test: Dataset) -> tuple[Noisy, ...]:
    """Errors of network and exact inverse at every level of noise."""
    exact = LinearInverse.at(rotor(), config.speed_rpm).diagnose
    found = []
    for k, level in enumerate(config.noises):
        key = jax.random.fold_in(jax.random.fold_in(jax.random.key(seed), NOISE_KEY), k)
        disturbed = with_noise(test, key, level)
        ours, best = (pairs(rms_errors(inverse, disturbed) / UNITS) for inverse in (training.network.diagnose, exact))
        found.append(Noisy(*ours, ours[0] / best[0], ours[1] / best[1]))
    return tuple(found)


def run(config: Config, seed: int, bar: tqdm) -> list[Outcome]:
    """Every method on the cases of one seed."""
    data, outcomes = cases(config, seed), []
    for name, (method, most) in config.methods().items():
        bar.set_description(f"{name}, seed {seed}")
        done = 0

        def progress(epoch: int, rms: float) -> None:
            nonlocal done
            bar.update(epoch - done)
            done = epoch

        begin = time.perf_counter()
        training = train(data.train, key=jax.random.key(seed), method=method, progress=progress)
        seconds = time.perf_counter() - begin
        bar.update(most - done)
        history = training.history
        outcomes.append(
            Outcome(
                name, seed, seconds, rms_errors(training.network.diagnose, data.test) / UNITS,
                history[-1].effective if history else math.nan,
                done, training.stopped, with_noisy_features(config, seed, training, data.test),
            )
        )  # fmt: skip
    return outcomes


def columns(config: Config, times: bool) -> list[str]:
    """Heads of the CSV file."""
    noisy = [
        f"{what}_at_noise_{level:.0e}"
        for level in config.noises
        for what in ("U_g_mm", "s_mm", "U_ratio_to_exact", "s_ratio_to_exact")
    ]
    return ["method", "seed", *(["seconds"] if times else []), *COMPONENTS, "effective", "epochs", "stopped", *noisy]


def comma_separated(config: Config, outcomes: Sequence[Outcome], times: bool) -> str:
    """Every training in a row."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns(config, times))
    for o in outcomes:
        noisy = [f"{value:.3g}" for level in o.noisy for value in level]
        effective = f"{o.effective:.3g}" if math.isfinite(o.effective) else ""
        errors = [f"{error:.3g}" for error in o.errors]
        writer.writerow(
            [
                o.method,
                o.seed,
                *([f"{o.seconds:.2f}"] if times else []),
                *errors,
                effective,
                o.epochs,
                o.stopped,
                *noisy,
            ]
        )
    return text.getvalue()


def of_method(outcomes: Sequence[Outcome]) -> dict[str, list[Outcome]]:
    """Method -> its trainings."""
    names = dict.fromkeys(o.method for o in outcomes)
    return {name: [o for o in outcomes if o.method == name] for name in names}


def pipes(heads: Sequence[str], rows: list[list[str]]) -> str:
    """A table of Markdown."""
    return tabulate.tabulate(rows, heads, tablefmt="pipe", disable_numparse=True)


def beside_table_1(groups: dict[str, list[Outcome]]) -> str:
    """Medians over seeds in the units of each reading, and how many times what is printed they are."""
    rows = []
    for reading, unbalance, bow in READINGS:
        for k, row in enumerate(printed("table01_fnn_rmse")):
            factor = UNITS[k] * (unbalance if k < 2 else bow)
            medians = [float(np.median([o.errors[k] for o in group])) * factor for group in groups.values()]
            paper = float(row["rmse"])
            rows.append(
                [
                    reading,
                    row["component"],
                    f"{paper:.2e}",
                    *(f"{value:.2e} ({value / paper:.2g} x)" for value in medians),
                ]
            )
    return pipes(["reading", "component", "printed", *groups], rows)


def summary(groups: dict[str, list[Outcome]], times: bool) -> str:
    """Medians over seeds of everything else, errors with their range."""
    rows = []
    for name, group in groups.items():
        effective = [o.effective for o in group if math.isfinite(o.effective)]
        sizes = np.array([pairs(o.errors) for o in group])
        spans = [f"{number(float(np.median(s)))} ({number(s.min())} to {number(s.max())})" for s in sizes.T]
        middle = [
            number(float(np.median(effective))) if effective else "-",
            f"{np.median([o.epochs for o in group]):.0f}",
        ]
        seconds = [number(float(np.median([o.seconds for o in group])))] if times else []
        rows.append([name, *seconds, *spans, *middle, "; ".join(dict.fromkeys(o.stopped for o in group))])
    heads = [
        "method",
        *(["seconds"] if times else []),
        "U g mm (range)",
        "s mm (range)",
        "effective parameters",
        "epochs",
        "stopped because",
    ]
    return pipes(heads, rows)


def noise_table(config: Config, groups: dict[str, list[Outcome]]) -> str:
    """Medians over seeds at every level of noise."""
    rows = []
    for name, group in groups.items():
        for k, level in enumerate(config.noises):
            medians = np.median([o.noisy[k] for o in group], axis=0)
            rows.append(
                [
                    name,
                    f"{level:.0e}",
                    *(number(float(value)) for value in medians[:2]),
                    *(f"{value:.3f}" for value in medians[2:]),
                ]
            )
    return pipes(["method", "noise", "U g mm", "s mm", "U / exact", "s / exact"], rows)


def page(config: Config, outcomes: Sequence[Outcome], times: bool) -> str:
    """The Markdown file."""
    groups = of_method(outcomes)
    seeds = ", ".join(str(seed) for seed in dict.fromkeys(o.seed for o in outcomes))
    return "\n\n".join(
        [
            "# Table 1 over seeds: the 4-40-4 network",
            f"{config.count} cases at {config.speed_rpm:g} rpm, {round(config.count * config.fractions[0])} of them to "
            f"train on; seeds {seeds}, each with "
            f"cases and first weights of its own. As published: Bayesian regularisation, {config.epochs} epochs. "
            "Medians over the seeds of the root mean "
            "square errors on the test cases; the paper prints no units, so each reading stands by itself, with the "
            "multiple of what is printed in brackets.",
            beside_table_1(groups),
            "## How each training ended",
            "U and s stand for both components together."
            + (" Seconds hold compilation where it occurs, which is in the first seed." if times else ""),
            summary(groups, times),
            "## What noise leaves of it",
            "All errors above are on noise-free features. Here the test features have Gaussian noise of the given "
            "fraction of their half range; the last two "
            "columns are the error in units of that of the exact linear inverse on the same features, which no inverse "
            "of one speed can beat by much. The cure "
            "for that is a second speed, not a better network.",
            noise_table(config, groups) + "\n",
        ]
    )


def write(config: Config, output: Path, outcomes: Sequence[Outcome], times: bool) -> None:
    """Both files, each whole or not at all."""
    write_whole(output / "training_seeds.csv", comma_separated(config, outcomes, times))
    write_whole(output / "training_seeds.md", page(config, outcomes, times))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--output", type=Path, default=Path("output/training"), help="folder for the files (%(default)s)"
    )
    parser.add_argument("--seeds", type=int, nargs="+", default=Config.seeds, help="seeds to run (%(default)s)")
    parser.add_argument("--epochs", type=int, default=Config.epochs, help="of the training as published (%(default)s)")
    parser.add_argument(
        "--fractions",
        type=float,
        nargs=3,
        default=Config.fractions,
        help="train, validation and test cases (%(default)s)",
    )
    parser.add_argument(
        "--methods", nargs="+", default=Config.chosen, choices=list(Config().methods()), help="trainings to run (all)"
    )
    parser.add_argument(
        "--no-times", action="store_true", help="leave out the seconds, so that a second run gives the same files"
    )
    parser.add_argument("--quick", action="store_true", help="two seeds and few steps, to see that it works")
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    config = Config(
        seeds=tuple(arguments.seeds),
        epochs=arguments.epochs,
        fractions=tuple(arguments.fractions),
        chosen=tuple(arguments.methods),
    )
    config = config.quick() if arguments.quick else config
    try:
        arguments.output.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        parser.exit(2, f"{arguments.output}: cannot be made a folder ({error.strerror}); give another\n")
    outcomes: list[Outcome] = []
    with tqdm(total=len(config.seeds) * sum(most for _, most in config.methods().values()), unit=" steps") as bar:
        for seed in config.seeds:
            outcomes += run(config, seed, bar)
            # After every seed: a run that is stopped leaves what it has.
            write(config, arguments.output, outcomes, not arguments.no_times)
    print(page(config, outcomes, times=True))
    print(
        f"{len(outcomes)} trainings are in {arguments.output / 'training_seeds.md'} and "
        f"{arguments.output / 'training_seeds.csv'}"
    )


if __name__ == "__main__":
    main()
