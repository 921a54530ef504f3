"""The evidence by Laplace's method beside the integral itself, hypothesis by hypothesis.

Cases are those of `tests/drawn_effects`, integrated in time. Each is explained; then the hypotheses that did best in
the last race are integrated over their unknowns with the same likelihood, prior and noise: all by importance sampling,
some by nested sampling too (Skilling 2006, Bayesian Anal. 1:833-860; Speagle 2020, MNRAS 493:3132-3158: the package
dynesty), which looks further from the optimum and takes longer. Motions are balanced at every point. Prints a line for
each and writes a table, anew after each case.

    python benchmarks/evidence.py --output benchmarks/results
    python benchmarks/evidence.py --first 5001 --seeds 1 --nested 1
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
from rotorjax import Explanation, explain
from rotorjax.compilation import spare_memory, use_double_precision
from rotorjax.data.files import write_whole
from rotorjax.discovery.contest import Contender, Contest
from rotorjax.inference.budget import Budget
from rotorjax.inference.descent_settings import CONVERGED
from rotorjax.inference.evidence import left_open
from rotorjax.inference.linearised import Linearisation, Point
from rotorjax.inference.motions import balanced
from rotorjax.inference.prior import prior_at, together
from rotorjax.inference.squares import squares_of

from drawn_effects import draw

HYPOTHESES = 3
"""Of each case at most, the most probable first."""
NOT_FAR = 60.0
"""Log evidence behind the answer beyond which a hypothesis is left out."""
LIVE = 100
"""Points alive: the logarithm is known to the square root of the information gained over their number."""
TIGHT = 1e-2
"""Standard errors by which the reading of a motion may be off balance."""
NEVER = -1e100
"""Log likelihood where no steady motion is found."""
CLOSE, LEAST_DRAWS, MOST_DRAWS, MOST_TIMED, TOGETHER = 0.05, 1000, 40_000, 4000, 250
"""Importance sampling: standard error at which it ends, points at least and at most, with motions at most, and so many
at one time.
"""
WIDER, NESTED_WIDER, TAILS = 2.0, 4.0, scipy.stats.t(3)
"""What is sampled from: so many standard errors of the optimum, in nested sampling more, and its tails."""
FEW, FEW_OF_MOTIONS = 5, 3
"""Unknowns up to which nested sampling draws from ellipsoids, beyond by random walks; up to which it is made where
motions are balanced: hours for more.
"""
FORMS = 60
"""Priors of narrower scales and simpler forms drawn, about whose optima is sampled, too."""
GOAL = 0.5
"""Difference up to which the two agree."""
ABOUT = """*Laplace*: log evidence as `explain` ranks by. *Importance*: the integral by importance sampling, with its
standard error. *Nested*: by nested sampling, for some rows, with motions only where no more than three unknowns
are free. All of the same likelihood, prior and noise, up to the same constant. *Difference*: Laplace less the
reference, that of the two with the smaller error. *At declared scales*: the same difference from importance sampling
without the means over scales and forms, so that what is left is the shape of the optimum. *Motion*: with a force that
makes orders depend on one another; its size is open unless the rig file states one. The goal is a difference of at most
0.5 in 95 % of the rows, and the same winner in 98 % of the pairs within a case."""


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
    optima: int
    laplace: float
    importance: Integral
    nested: Integral | None
    at_declared: float
    """Difference without the means over scales and forms."""
    seconds: float

    @property
    def exact(self) -> Integral:
        """The integral as it is known best."""
        return min(filter(None, (self.importance, self.nested)), key=lambda one: one.error)

    @property
    def difference(self) -> float:
        """Of Laplace's method from the integral."""
        return self.laplace - self.exact.value

    def cells(self) -> list[str]:
        """As written in the table."""
        motion, nested = "yes" if self.motion else "", "" if self.nested is None else str(self.nested)
        return [
            str(self.seed), self.hidden, self.hypothesis, str(self.free), motion, str(self.optima),
            f"{self.laplace:.2f}", str(self.importance), nested, f"{self.difference:+.2f}", f"{self.at_declared:+.2f}",
            f"{self.seconds:.0f}",
        ]  # fmt: skip


HEADS = [
    "seed", "hidden", "hypothesis", "free", "motion", "optima", "Laplace", "importance", "nested", "difference",
    "at declared scales", "s",
]  # fmt: skip


class Integrand:
    """Likelihood times prior of one hypothesis over its free unknowns, and what it is sampled from: a density
    like that of its optima, only wider and with long tails.

    The integral is that of likelihood times prior over that density, which then takes the place of the prior (Chen,
    Feroz, Hobson 2019, Stat. Comput. 29:835-850): no narrow peak has to be found in a wide prior.

    **Arguments:** ``wider``: so many standard errors of the optima.
    """

    def __init__(self, contest: Contest, contender: Contender, wider: float) -> None:
        best = contender.best
        self.contest, self.wider = contest, wider
        self.ends = [best, *(end for end in contender.ends[1:] if end.result == CONVERGED)]
        self.data = contest.data(contender.noise, best.point)
        self.lin = Linearisation(contest.space, self.data, Budget(limit=None))
        self.free = np.asarray(best.free)
        self.parts = together(np.asarray(contest.space.open_size)[self.free])
        self.priors = [
            (group, np.linalg.inv(np.stack(widths)), np.linalg.slogdet(np.stack(widths))[1])
            for group, widths in left_open(best, contest.space)
        ]
        self.centres = np.stack([end.point[self.free] for end in self.ends])
        self.roots = np.stack([wider * np.linalg.cholesky(np.linalg.inv(end.curvature)) for end in self.ends])
        self.shares = np.full(len(self.ends), 1.0 / len(self.ends))

    def with_forms(self, rng: np.random.Generator) -> "Integrand":
        """Samples half of its points about where the optimum moves under some of the priors that the mean is over, to
        first order: under the prior of a simpler form it lies in a thin slab, which few of the other points meet.
        """
        if not self.priors:
            return self
        best = self.ends[0]
        drawn = [rng.integers(len(log_dets), size=FORMS) for _, _, log_dets in self.priors]
        to_declared = np.tile(np.eye(len(self.free)), (FORMS, 1, 1))
        for (group, inverses, _), chosen in zip(self.priors, drawn, strict=True):
            to_declared[:, group[:, None], group] = inverses[chosen]
        weights = prior_at(to_declared @ self.centres[0], self.parts).weight
        curvature = best.data_curvature + np.swapaxes(to_declared, 1, 2) @ (weights[..., None] * to_declared)
        pull = best.curvature @ self.centres[0]
        self.centres = np.append(self.centres, np.linalg.solve(curvature, pull[:, None])[..., 0], axis=0)
        roots = self.wider * np.linalg.cholesky(np.linalg.inv(curvature))
        self.roots = np.append(self.roots, roots, axis=0)
        self.shares = np.append(0.5 * self.shares, np.full(FORMS, 0.5 / FORMS))
        return self

    def __call__(self, steps: np.ndarray, which: np.ndarray) -> np.ndarray:
        """Logarithm at many points, up to the constant that is left out of the evidence: in the first row with the
        means over scales and forms, in the second with the declared prior.

        **Arguments:** ``steps``: from a centre, point by point, drawn from `TAILS`; ``which`` centre, the optima first.
        """
        free = self.centres[which] + np.einsum("pij,pj->pi", self.roots[which], steps)
        points = np.tile(self.ends[0].point, (len(steps), 1))
        points[:, self.free] = free
        ends = [self.ends[k if k < len(self.ends) else 0] for k in which]
        starts = [Point(point, end.motions, True) for point, end in zip(points, ends, strict=True)]
        found = self._at(starts) if self.ends[0].motions is None else self._coupled(starts)
        data = np.array([np.inf if cost is None else cost for cost in found])
        logs = self._log_priors(free) - data - self._log_density(free)
        return np.where(np.isfinite(data), logs, NEVER)

    def _log_density(self, free: np.ndarray) -> np.ndarray:
        """Of what is sampled from."""
        logs = [
            np.sum(TAILS.logpdf((free - centre) @ np.linalg.inv(root).T), axis=1)
            - np.linalg.slogdet(root)[1]
            + math.log(share)
            for centre, root, share in zip(self.centres, self.roots, self.shares, strict=True)
        ]
        return np.logaddexp.reduce(logs) + 0.5 * free.shape[1] * math.log(2.0 * math.pi)

    def _at(self, points: list[Point]) -> list[float | None]:
        """Cost of the data; none where a motion is off balance."""
        costs: list[float | None] = []
        for one in self.lin.at(points, [np.zeros(0, int)] * len(points)):
            steady = one.response is None or np.all(one.response.off <= 10.0 * TIGHT)
            error = one.error
            fit = squares_of(self.data, error, np.zeros((*error.shape, 0)), self.contest.training)
            costs.append(fit.cost if steady and one.finite else None)
        return costs

    def _coupled(self, begun: list[Point]) -> list[float | None]:
        """The same at motions that balance, looked for from those of the optimum."""
        here = self.lin.at(begun, [np.zeros(0, int)] * len(begun))
        near, _ = balanced(self.lin, here, TIGHT)
        return self._at(list(near))

    def _log_priors(self, free: np.ndarray) -> np.ndarray:
        """Logarithms of the two priors of `__call__`, in that of the normal distribution at its peak."""
        declared = -prior_at(free, self.parts).cost
        averaged = declared.copy()
        for group, to_declared, log_dets in self.priors:
            own, parts = free[:, group], self.parts[np.ix_(group, group)]
            scaled = np.einsum("kij,pj->pki", to_declared, own).reshape(-1, len(group))
            logs = -prior_at(scaled, parts).cost.reshape(len(free), -1) - log_dets
            averaged += np.logaddexp.reduce(logs, axis=1) - math.log(len(log_dets)) + prior_at(own, parts).cost
        return np.stack([averaged, declared])


def by_importance(integrand: Integrand, rng: np.random.Generator) -> tuple[Integral, Integral]:
    """Log evidence by importance sampling, then that at the declared scales."""
    count = len(integrand.free)
    if count == 0:
        averaged, declared = integrand(np.zeros((1, 0)), np.zeros(1, int))[:, 0]
        return Integral(float(averaged), 0.0), Integral(float(declared), 0.0)
    integrand, logs, error = integrand.with_forms(rng), np.zeros((2, 0)), math.inf
    most = MOST_DRAWS if integrand.ends[0].motions is None else MOST_TIMED
    while logs.shape[1] < LEAST_DRAWS or (error > CLOSE and logs.shape[1] < most):
        steps = TAILS.rvs((TOGETHER, count), random_state=rng)
        which = rng.choice(len(integrand.shares), TOGETHER, p=integrand.shares)
        logs = np.append(logs, integrand(steps, which), axis=1)
        averaged, declared = mean_of(logs[0]), mean_of(logs[1])
        error = averaged.error
    return averaged, declared


def mean_of(logs: np.ndarray) -> Integral:
    """Logarithm of a mean. **Arguments:** ``logs``: logarithms of the draws."""
    weight = np.exp(logs - logs.max())
    error = np.std(weight) / np.mean(weight) / math.sqrt(len(logs))
    return Integral(float(logs.max() + np.log(np.mean(weight))), float(error))


def by_nested_sampling(integrand: Integrand, rng: np.random.Generator) -> Integral:
    """Log evidence by nested sampling; where there are several optima, one coordinate more says which."""
    count, optima = len(integrand.free), len(integrand.ends)

    def drawn(cube: np.ndarray) -> np.ndarray:
        return np.append(TAILS.ppf(cube[:count]), np.floor(cube[count:] * optima))

    def one_by_one(drawn: np.ndarray) -> float:
        which = drawn[count:].astype(int) if optima > 1 else np.zeros(1, int)
        return float(integrand(drawn[None, :count], which)[0, 0])

    settings = {"sample": "unif", "bootstrap": 0} if count <= FEW else {"sample": "rwalk"}
    sampler = dynesty.NestedSampler(one_by_one, drawn, count + (optima > 1), nlive=LIVE, rstate=rng, **settings)
    sampler.run_nested(dlogz=0.1, print_progress=False)
    return Integral(float(sampler.results.logz[-1]), float(sampler.results.logzerr[-1]))


def chosen_of(found: Explanation) -> list[Contender]:
    """The most probable hypotheses of the last race, all fitted under its noise."""
    contest = found.contest
    ranked = {r.contender.effects: r.contender for r in found.rankings[-1]} | found.ties.raced
    order = sorted(ranked.values(), key=lambda c: -contest.log_posterior(c))
    winner = order[0]
    if winner.noise.allowance > contest.floor.allowance:
        return []
    order = [c for c in order if c.balanced and c.noise == winner.noise and not c.foreseen]
    return [c for c in order if c.log_evidence > winner.log_evidence - NOT_FAR][:HYPOTHESES]


def at_declared(integrand: Integrand) -> float:
    """Log evidence by Laplace's method without the means over scales and forms."""
    return float(np.logaddexp.reduce([-e.cost - 0.5 * np.linalg.slogdet(e.curvature)[1] for e in integrand.ends]))


def compared(seed: int, nested: int, before: int) -> list[Row]:
    """Rows of one case. **Arguments:** ``nested``: nested sampling for every so many rows, counted with those
    ``before``.
    """
    hidden = draw(seed)
    found = explain(hidden.model, hidden.measurement, thorough=False)
    rows, rng = [], np.random.default_rng(seed)
    for contender in chosen_of(found):
        begin, integrand = time.perf_counter(), Integrand(found.contest, contender, WIDER)
        averaged, declared = by_importance(integrand, rng)
        few = contender.best.motions is None or len(integrand.free) <= FEW_OF_MOTIONS
        wanted = nested and (before + len(rows)) % nested == 0 and few and len(integrand.free)
        again = by_nested_sampling(Integrand(found.contest, contender, NESTED_WIDER), rng) if wanted else None
        rows.append(Row(
            seed, " + ".join(hidden.effects) or "nothing", " + ".join(sorted(contender.effects)) or "none",
            len(integrand.free), contender.best.motions is not None, len(integrand.ends), contender.log_evidence,
            averaged, again, at_declared(integrand) - declared.value, time.perf_counter() - begin,
        ))  # fmt: skip
        print(" | ".join(rows[-1].cells()), flush=True)
    spare_memory()
    return rows


def summary(rows: list[Row]) -> str:
    """How often they agree."""
    off = np.array([row.difference for row in rows])
    within, both = int(np.sum(np.abs(off) <= GOAL)), [row for row in rows if row.nested is not None]
    pairs = [(a, b) for i, a in enumerate(rows) for b in rows[i + 1 :] if a.seed == b.seed]
    clear = [(a, b) for a, b in pairs if abs(a.exact.value - b.exact.value) > GOAL]
    cases = [[row for row in rows if row.seed == seed] for seed in dict.fromkeys(row.seed for row in rows)]
    first = sum(max(case, key=lambda row: row.laplace) is max(case, key=lambda row: row.exact.value) for case in cases)
    text = (
        f"{len(rows)} hypotheses of {len(cases)} cases, {sum(row.motion for row in rows)} with motions: {within} "
        f"within {GOAL} ({100.0 * within / len(rows):.0f} %), largest difference {np.max(np.abs(off)):.2f}, median "
        f"{np.median(off):+.2f}. Same winner in {same_winner(pairs)} of {len(pairs)} pairs within a case, in "
        f"{same_winner(clear)} of the {len(clear)} that are further apart than {GOAL}; the same first in {first} "
        f"cases."
    )
    if both:
        apart = np.array([row.importance.value - row.nested.value for row in both])
        errors = np.array([math.hypot(row.importance.error, row.nested.error) for row in both])
        text += (
            f" Importance and nested sampling, {len(both)} hypotheses: {int(np.sum(np.abs(apart) <= 2.0 * errors))} "
            f"within two standard errors, largest difference {np.max(np.abs(apart)):.2f}, median "
            f"{np.median(apart):+.2f}."
        )
    return text


def same_winner(pairs: list[tuple[Row, Row]]) -> int:
    """Number of pairs of which Laplace's method and the integral prefer the same."""
    return sum((a.laplace > b.laplace) == (a.exact.value > b.exact.value) for a, b in pairs)


def written(rows: list[Row], command: str) -> str:
    """The page."""
    table = tabulate.tabulate([row.cells() for row in rows], HEADS, tablefmt="pipe", disable_numparse=True)
    made = f"Written by `{command} --output benchmarks/results`."
    return f"# The evidence beside the integral\n\n{ABOUT}\n\n{made}\n\n{table}\n\n{summary(rows)}\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=5039, help="seed to begin with (%(default)s)")
    parser.add_argument(
        "--seeds", type=int, default=18, help="number of seeds; those of unknown noise are left out (%(default)s)"
    )
    parser.add_argument(
        "--nested", type=int, default=3, help="nested sampling for every so many rows (%(default)s; 0: none)"
    )
    parser.add_argument("--output", type=Path, help="folder for evidence.md")
    asked = parser.parse_args()
    use_double_precision()
    command = f"python benchmarks/evidence.py --first {asked.first} --seeds {asked.seeds} --nested {asked.nested}"
    rows: list[Row] = []
    for seed in range(asked.first, asked.first + asked.seeds):
        rows += compared(seed, asked.nested, len(rows))
        if asked.output and rows:
            asked.output.mkdir(parents=True, exist_ok=True)
            write_whole(asked.output / "evidence.md", written(rows, command))
    print(summary(rows) if rows else "No case whose noise is known.")


if __name__ == "__main__":
    main()
