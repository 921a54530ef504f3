"""The evidence by Laplace's method beside the integral itself, hypothesis by hypothesis.

Cases are those of `tests/drawn_effects`, integrated in time. Each is explained; then the answer, "none", and what comes
next in the last race are integrated over their unknowns with the same likelihood, prior and noise: by importance
sampling, and, where asked for, by nested sampling too (Skilling 2006, Bayesian Anal. 1:833-860; Speagle 2020, MNRAS
493:3132-3158: the package dynesty), which finds what the other might miss and takes a hundred times as long. Motions
are balanced at every point. Prints a line for each and writes a table.

    python benchmarks/evidence.py --first 5000 --seeds 10 --output benchmarks/results
"""

import argparse
import math
import sys
import time
from pathlib import Path
from typing import NamedTuple

import dynesty
import numpy as np
import scipy.stats
import tabulate

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))
from rotorjax import explain
from rotorjax.compilation import spare_memory, use_double_precision
from rotorjax.data.files import write_whole
from rotorjax.discovery.contest import Contender, Contest
from rotorjax.inference.budget import Budget
from rotorjax.inference.evidence import left_open
from rotorjax.inference.linearised import Linearisation, Point
from rotorjax.inference.motions import balanced
from rotorjax.inference.prior import prior_at, together
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
CLOSE, LEAST_DRAWS, MOST_DRAWS, MOST_TIMED, TOGETHER = 0.05, 1000, 40_000, 4000, 250
"""Importance sampling: standard error at which it ends, points at least and at most, with motions at most, and so many
at one time.
"""
WIDER, TAILS = 2.0, scipy.stats.t(3)
"""What is sampled from: so many standard errors of the optimum, and its tails."""
ABOUT = """*Laplace*: log evidence as `explain` ranks by. *Importance*: the integral by importance sampling, with its
standard error. *Nested*: by nested sampling, where that was asked for. All of the same likelihood, prior and noise, up
to the same constant. The goal is a difference of at most 0.5 in 95 % of the rows, and the same winner in 98 % of the
pairs within a case.

Written by `python benchmarks/evidence.py --motions --output benchmarks/results`."""


class Integral(NamedTuple):
    """Logarithm of an integral, with its standard error."""

    value: float
    error: float

    def __str__(self) -> str:
        return f"{self.value:.2f} ± {self.error:.2f}"


class Row(NamedTuple):
    """One hypothesis."""

    seed: int
    hidden: str
    hypothesis: str
    free: int
    motion: bool
    laplace: float
    exact: Integral
    nested: Integral | None
    seconds: float

    @property
    def difference(self) -> float:
        """Of Laplace's method from the integral."""
        return self.laplace - self.exact.value

    def cells(self) -> list[str]:
        """As written in the table."""
        motion, nested = "yes" if self.motion else "", "" if self.nested is None else str(self.nested)
        return [
            str(self.seed), self.hidden, self.hypothesis, str(self.free), motion, f"{self.laplace:.2f}",
            str(self.exact), f"{self.difference:+.2f}", nested, f"{self.seconds:.0f}",
        ]  # fmt: skip


class Integrand:
    """Likelihood times prior of one hypothesis over its free unknowns, and what it is sampled from: a density
    like that of the optimum, only wider and with long tails.

    The integral is that of likelihood times prior over that density, which then takes the place of the prior (Chen,
    Feroz, Hobson 2019, Stat. Comput. 29:835-850): no narrow peak has to be found in a wide prior.
    """

    def __init__(self, contest: Contest, contender: Contender) -> None:
        self.contest, self.best = contest, contender.best
        self.data = contest.data(contender.noise, contender.best.point)
        self.lin = Linearisation(contest.space, self.data, Budget(limit=None))
        self.free = np.asarray(self.best.free)
        self.parts = together(np.asarray(contest.space.open_size)[self.free])
        self.priors = [
            (group, [(np.linalg.inv(width), np.linalg.slogdet(width)[1]) for width in widths])
            for group, widths in left_open(contender.best, contest.space)
        ]
        self.centre = self.best.point[self.free]
        self.root = WIDER * np.linalg.cholesky(np.linalg.inv(self.best.curvature))

    def __call__(self, steps: np.ndarray) -> np.ndarray:
        """Logarithm at many points, up to the constant that is left out of the evidence.

        **Arguments:** ``steps``: from the optimum, point by point, drawn from `TAILS`.
        """
        count = steps.shape[1]
        density = np.sum(TAILS.logpdf(steps), axis=1) - np.sum(np.log(np.diag(self.root)))
        density += 0.5 * count * math.log(2.0 * math.pi)
        points = np.tile(self.best.point, (len(steps), 1))
        points[:, self.free] = self.centre + steps @ self.root.T
        found = (
            self._at([Point(point, None) for point in points]) if self.best.motions is None else self._coupled(points)
        )
        logs = np.array([self.log_prior(point[self.free]) for point in points]) - density
        return np.array([NEVER if fit is None else log - fit for log, fit in zip(logs, found, strict=True)])

    def _at(self, points: list[Point]) -> list[float | None]:
        """Cost of the data; none where a motion is off balance."""
        costs: list[float | None] = []
        for one in self.lin.at(points, [np.zeros(0, int)] * len(points)):
            steady = one.freedom is None or np.all(one.freedom.off <= 10.0 * TIGHT)
            error = one.error
            fit = squares_of(self.data, error, np.zeros((*error.shape, 0)), self.contest.training)
            costs.append(fit.cost if steady and one.finite else None)
        return costs

    def _coupled(self, points: np.ndarray) -> list[float | None]:
        """The same at motions that balance, looked for from those of the optimum."""
        begun = [Point(point, self.best.motions, True) for point in points]
        here = self.lin.at(begun, [np.zeros(0, int)] * len(points))
        near, _ = balanced(self.lin, here, TIGHT)
        return self._at(list(near))

    def log_prior(self, free: np.ndarray) -> float:
        """Logarithm of the prior, in that of the normal distribution at its peak, averaged as in the evidence."""
        total = -prior_at(free, self.parts).cost
        for group, priors in self.priors:
            own, parts = free[group], self.parts[np.ix_(group, group)]
            logs = [-prior_at(to_declared @ own, parts).cost - log_det for to_declared, log_det in priors]
            total += np.logaddexp.reduce(logs) - math.log(len(logs)) + prior_at(own, parts).cost
        return float(total)

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


def by_importance(integrand: Integrand, rng: np.random.Generator) -> Integral:
    """Log evidence by importance sampling."""
    count = len(integrand.free)
    if count == 0:
        return Integral(float(integrand(np.zeros((1, 0)))[0]), 0.0)
    logs, error, most = np.zeros(0), math.inf, MOST_DRAWS if integrand.best.motions is None else MOST_TIMED
    while len(logs) < LEAST_DRAWS or (error > CLOSE and len(logs) < most):
        logs = np.append(logs, integrand(TAILS.rvs((TOGETHER, count), random_state=rng)))
        weight = np.exp(logs - logs.max())
        error = float(np.std(weight) / np.mean(weight) / math.sqrt(len(logs)))
    return Integral(float(logs.max() + np.log(np.mean(weight))), error)


def by_nested_sampling(integrand: Integrand, rng: np.random.Generator) -> Integral:
    """Log evidence by nested sampling."""

    def one_by_one(steps: np.ndarray) -> float:
        return float(integrand(steps[None])[0])

    sampler = dynesty.NestedSampler(one_by_one, TAILS.ppf, len(integrand.free), nlive=LIVE, rstate=rng)
    sampler.run_nested(dlogz=0.1, print_progress=False)
    return Integral(float(sampler.results.logz[-1]), float(sampler.results.logzerr[-1]))


def compared(seed: int, motions: bool, nested: bool) -> list[Row]:
    """Rows of one case. **Arguments:** ``motions``: also hypotheses with a nonlinear force; ``nested``:
    nested sampling too.
    """
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
    chosen = [c for c in chosen if c.log_evidence > winner.log_evidence - NOT_FAR]
    rows, rng = [], np.random.default_rng(seed)
    for contender in chosen:
        begin, integrand = time.perf_counter(), Integrand(contest, contender)
        exact = by_importance(integrand, rng)
        again = by_nested_sampling(integrand, rng) if nested and len(integrand.free) else None
        hypothesis, motion = " + ".join(sorted(contender.effects)) or "none", contender.best.motions is not None
        found_here = (len(integrand.free), motion, contender.log_evidence, exact, again, time.perf_counter() - begin)
        rows.append(Row(seed, " + ".join(hidden.effects) or "nothing", hypothesis, *found_here))
        print(" | ".join(rows[-1].cells()), flush=True)
    spare_memory()
    return rows


HEADS = ["seed", "hidden", "hypothesis", "free", "motion", "Laplace", "importance", "difference", "nested", "s"]


def summary(rows: list[Row]) -> str:
    """How often they agree."""
    off = np.array([row.difference for row in rows])
    pairs = [
        (a, b)
        for i, a in enumerate(rows)
        for b in rows[i + 1 :]
        if a.seed == b.seed and abs(a.exact.value - b.exact.value) > 0.5
    ]
    same = sum((a.laplace > b.laplace) == (a.exact.value > b.exact.value) for a, b in pairs)
    within = int(np.sum(np.abs(off) <= 0.5))
    return (
        f"{len(rows)} hypotheses: {within} within 0.5 ({100.0 * within / len(rows):.0f} %), largest difference "
        f"{np.max(np.abs(off)):.2f}, median {np.median(off):+.2f}. Of {len(pairs)} pairs further apart than 0.5 "
        f"{same} have the same winner."
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=5000, help="seed to begin with (%(default)s)")
    parser.add_argument("--seeds", type=int, default=10, help="number of cases (%(default)s)")
    parser.add_argument("--motions", action="store_true", help="also nonlinear forces")
    parser.add_argument("--nested", action="store_true", help="nested sampling too: minutes for each hypothesis")
    parser.add_argument("--output", type=Path, help="folder for evidence.md")
    arguments = parser.parse_args()
    use_double_precision()
    seeds = range(arguments.first, arguments.first + arguments.seeds)
    rows = [row for seed in seeds for row in compared(seed, arguments.motions, arguments.nested)]
    print(summary(rows))
    if arguments.output:
        arguments.output.mkdir(parents=True, exist_ok=True)
        table = tabulate.tabulate([row.cells() for row in rows], HEADS, tablefmt="pipe", disable_numparse=True)
        text = f"# The evidence beside the integral\n\n{ABOUT}\n\n{summary(rows)}\n\n{table}\n"
        write_whole(arguments.output / "evidence.md", text)


if __name__ == "__main__":
    main()
