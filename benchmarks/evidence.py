"""The evidence by Laplace's method beside that by nested sampling, hypothesis by hypothesis.

Cases are those of `tests/drawn_effects`, integrated in time. Each is explained; then the answer, "none", and what comes
next in the last race are integrated over their priors by dynamic nested sampling (Skilling 2006, Bayesian Anal.
1:833-860; Speagle 2020, MNRAS 493:3132-3158: the package dynesty), with the same likelihood and the same noise. Motions
are balanced at every point, from those of the nearest point before. Prints a line for each and writes a table.

    python benchmarks/evidence.py --first 2714 --seeds 10 --output benchmarks/results
"""

import argparse
import math
import sys
import time
from pathlib import Path
from typing import NamedTuple

import dynesty
import numpy as np
import tabulate
from scipy.special import ndtri

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))
from rotorjax import explain
from rotorjax.compilation import spare_memory_maps, use_double_precision
from rotorjax.data.files import write_whole
from rotorjax.discovery.contest import Contender, Contest
from rotorjax.inference.budget import Budget
from rotorjax.inference.evidence import left_open
from rotorjax.inference.linearised import Linearisation, Point
from rotorjax.inference.motions import balanced
from rotorjax.inference.prior import USUAL, together
from rotorjax.inference.squares import squares_of

from drawn_effects import draw

RIVALS = 3
"""Hypotheses beside the answer and "none", the most probable first."""
NOT_FAR = 60.0
"""Log evidence behind the answer beyond which a hypothesis is left out."""
LIVE = 400
"""Points alive: the logarithm is known to the square root of the information gained over their number."""
TIGHT = 1e-2
"""Standard errors by which the reading of a motion may be off balance."""
NEVER = -1e100
"""Log likelihood where no steady motion is found."""
FAR = 1e3
"""Prior scales up to which a size that is left open is drawn; the rest of its tail has less than 1e-20."""
ABOUT = """*Laplace*: log evidence as `explain` ranks by. *Nested*: by nested sampling, with its standard error. Both of
the same likelihood, prior and noise, up to the same constant. The goal is a difference of at most 0.5 in 95 % of the
rows, and the same winner in 98 % of the pairs within a case.

Written by `python benchmarks/evidence.py --output benchmarks/results`."""


class Sampled(NamedTuple):
    """Log evidence by nested sampling."""

    value: float
    error: float
    calls: int


class Likelihood:
    """Log likelihood of one hypothesis as a function of its free unknowns, and its prior as a map of the unit cube."""

    def __init__(self, contest: Contest, contender: Contender) -> None:
        self.contest, self.best = contest, contender.best
        self.data = contest.data(contender.noise, contender.best.point)
        self.lin = Linearisation(contest.space, self.data, Budget(limit=None))
        self.free = np.asarray(self.best.free)
        self.parts = together(np.asarray(contest.space.open_size)[self.free])
        self.left_open = list(left_open(contender.best, contest.space))
        self.motions, self.at = self.best.motions, self.best.point
        self.radius, self.density = _tail()

    @property
    def dimensions(self) -> int:
        """Of the unit cube: the free unknowns, and one for each prior that is averaged over."""
        return len(self.free) + len(self.left_open)

    @property
    def sizes(self) -> list[np.ndarray]:
        """Unknowns that have one open size together; of most hypotheses none."""
        rows = {tuple(np.flatnonzero(row)) for row in self.parts if row.any()}
        return [np.array(row) for row in sorted(rows)]

    def unknowns(self, cube: np.ndarray) -> np.ndarray:
        """Free unknowns distributed as the prior."""
        free = ndtri(cube[: len(self.free)])
        for size in self.sizes:
            if len(size) == 1:
                free[size] = math.copysign(self._quantile(abs(2.0 * cube[size[0]] - 1.0), 1), cube[size[0]] - 0.5)
            else:
                radius, angle = self._quantile(cube[size[0]], 2), 2.0 * math.pi * cube[size[1]]
                free[size] = radius * np.array([math.cos(angle), math.sin(angle)])
        for share, (group, widths) in zip(cube[len(self.free) :], self.left_open, strict=True):
            free[group] = widths[min(int(share * len(widths)), len(widths) - 1)] @ free[group]
        return free

    def _quantile(self, share: float, count: int) -> float:
        total = np.cumsum(self.density * self.radius ** (count - 1) * np.gradient(self.radius))
        return float(np.interp(share, total / total[-1], self.radius))

    @property
    def normalisation(self) -> float:
        """Logarithm of the integral of the prior that is ranked by, in that of the normal distribution."""
        total = 0.0
        for size in self.sizes:
            shell = {1: 2.0, 2: 2.0 * math.pi}[len(size)] * self.radius ** (len(size) - 1)
            integral = float(np.sum(shell * self.density * np.gradient(self.radius)))
            total += math.log(integral / (2.0 * math.pi) ** (0.5 * len(size)))
        return total

    def __call__(self, free: np.ndarray) -> float:
        """Up to the constant that is left out of the evidence."""
        point = self.best.point.copy()
        point[self.free] = free
        none = np.zeros(0, int)
        if self.best.motions is None:
            (one,) = self.lin.at([Point(point, None)], [none])
        else:
            found = self._balanced(point)
            if found is None:
                return NEVER
            one = found
        if not one.finite:
            return NEVER
        error = one.error
        return -squares_of(self.data, error, np.zeros((*error.shape, 0)), self.contest.training).cost

    def _balanced(self, point: np.ndarray):
        """Linearised at motions that balance, looked for from those of the point before, then of the best."""
        for motions in (self.motions, self.best.motions):
            (here,) = self.lin.at([Point(point, motions, True)], [np.zeros(0, int)])
            (near,), _ = balanced(self.lin, [here], TIGHT)
            (one,) = self.lin.at([near], [np.zeros(0, int)])
            if one.freedom is not None and np.all(one.freedom.off <= 10.0 * TIGHT):
                self.motions = near.motions
                return one
        return None


def _tail() -> tuple[np.ndarray, np.ndarray]:
    """Radii, and the density of an open size there, the normal distribution's at the centre being one."""
    radius = np.concatenate([[0.0], np.geomspace(1e-4, FAR, 20_000)])
    far = np.maximum((radius / USUAL) ** 2, 1.0)
    return radius, np.exp(-np.where(far > 1.0, 0.5 * USUAL**2 * (1.0 + np.log(far)), 0.5 * radius**2))


def sampled(contest: Contest, contender: Contender, rng: np.random.Generator) -> Sampled:
    """Log evidence of one hypothesis."""
    likelihood = Likelihood(contest, contender)
    count = len(likelihood.free)
    if count == 0:
        return Sampled(likelihood(np.zeros(0)), 0.0, 1)
    sampler = dynesty.NestedSampler(likelihood, likelihood.unknowns, likelihood.dimensions, nlive=LIVE, rstate=rng)
    sampler.run_nested(dlogz=0.1, print_progress=False)
    found = sampler.results
    return Sampled(float(found.logz[-1]) + likelihood.normalisation, float(found.logzerr[-1]), int(np.sum(found.ncall)))


def compared(seed: int, motions: bool) -> list[list[str]]:
    """Rows of one case. **Arguments:** ``motions``: also hypotheses with a force that depends on motion."""
    hidden = draw(seed)
    found = explain(hidden.model, hidden.measurement, thorough=False)
    contest, race = found.contest, found.rankings[-1]
    ranked = {r.contender.effects: r.contender for r in race} | found.ties.raced
    order = sorted(ranked.values(), key=lambda c: -contest.log_posterior(c))
    winner = order[0]
    # All under the noise of the last race.
    known = winner.noise.allowance <= contest.floor.allowance
    chosen = [c for c in order if known and c.balanced and c.noise == winner.noise and not c.foreseen]
    chosen = [c for c in chosen if motions or c.best.motions is None][: RIVALS + 2]
    chosen = [c for c in chosen if c.log_evidence > winner.log_evidence - NOT_FAR and _possible(contest, c)]
    rows, rng = [], np.random.default_rng(seed)
    for contender in chosen:
        begin = time.perf_counter()
        nested = sampled(contest, contender, rng)
        rows.append(
            [
                str(seed), " + ".join(hidden.effects), " + ".join(sorted(contender.effects)) or "none",
                str(len(contender.best.free)), "yes" if contender.best.motions is not None else "",
                f"{contender.log_evidence:.2f}", f"{nested.value:.2f} ± {nested.error:.2f}",
                f"{contender.log_evidence - nested.value:+.2f}", str(nested.calls),
                f"{time.perf_counter() - begin:.0f}",
            ]
        )  # fmt: skip
        print(" | ".join(rows[-1]), flush=True)
    spare_memory_maps()
    return rows


def _possible(contest: Contest, contender: Contender) -> bool:
    """Whether the prior can be drawn from: sizes of one number or two."""
    parts = together(np.asarray(contest.space.open_size)[contender.best.free])
    return int(parts.sum(axis=1).max(initial=0.0)) <= 2


HEADS = ["seed", "hidden", "hypothesis", "free", "motion", "Laplace", "nested", "difference", "likelihoods", "s"]


def summary(rows: list[list[str]]) -> str:
    """How often they agree."""
    off = np.array([float(row[7]) for row in rows])
    pairs = [
        (a, b) for i, a in enumerate(rows) for b in rows[i + 1 :] if a[0] == b[0] and abs(_nested(a) - _nested(b)) > 0.5
    ]
    same = sum((float(a[5]) > float(b[5])) == (_nested(a) > _nested(b)) for a, b in pairs)
    within = int(np.sum(np.abs(off) <= 0.5))
    return (
        f"{len(rows)} hypotheses: {within} within 0.5 ({100.0 * within / len(rows):.0f} %), largest difference "
        f"{np.max(np.abs(off)):.2f}, median {np.median(off):+.2f}. Of {len(pairs)} pairs further apart than 0.5 "
        f"{same} have the same winner."
    )


def _nested(row: list[str]) -> float:
    return float(row[6].split()[0])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=2714, help="seed to begin with (%(default)s)")
    parser.add_argument("--seeds", type=int, default=10, help="number of cases (%(default)s)")
    what = "also forces that depend on motion: some ten minutes for each instead of half a one"
    parser.add_argument("--motions", action="store_true", help=what)
    parser.add_argument("--output", type=Path, help="folder for evidence.md")
    arguments = parser.parse_args()
    use_double_precision()
    rows = [row for k in range(arguments.seeds) for row in compared(arguments.first + k, arguments.motions)]
    print(summary(rows))
    if arguments.output:
        arguments.output.mkdir(parents=True, exist_ok=True)
        table = tabulate.tabulate(rows, HEADS, tablefmt="pipe", disable_numparse=True)
        text = f"# The evidence beside nested sampling\n\n{ABOUT}\n\n{summary(rows)}\n\n{table}\n"
        write_whole(arguments.output / "evidence.md", text)


if __name__ == "__main__":
    main()
