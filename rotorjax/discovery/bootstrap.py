"""Is what is left more than noise? A p-value calibrated by data drawn from the fitted model."""

from typing import NamedTuple

import numpy as np

from rotorjax._core import numpy_pair
from rotorjax.discovery.race import Contender, Contest
from rotorjax.inference.data import declared_starts
from rotorjax.inference.descent import QUICK, End, Start, best_of, descend
from rotorjax.inference.noise import Noise

FEWEST_DRAWS, MOST_DRAWS = 39, 199
ENOUGH_EXCEED = 5
"""Draws that leave more than the data after which the p-value is large enough (Besag, Clifford 1991, Biometrika 78:301-304)."""
NONE_EXCEED = 99
"""Draws without a single one that leaves more after which it is small enough."""
BATCH = 24
"""Fits made together."""
BLIND_STARTS = 2
"""Starts of every fit, those of the data's own among them; one where orders are balanced together, which takes a hundred times as long."""


class PValue(NamedTuple):
    """Probability, if the model and the noise hold, of leaving as much as the data do."""

    value: float
    draws: int


def p_value(contest: Contest, contender: Contender, *, seed: int = 0) -> PValue:
    """Parametric bootstrap of the least cost: the same fit, from the same starts, of data drawn from the fitted model.

    Noise is the table's and the scatter between runs; what a misfit would add is not counted. (k + 1)/(n + 1) for k of n
    draws that leave more than the data; it stops once 5 do, or once none of 99 does. The least cost of a draw is at most that of
    the point it was drawn at: a descent that ends higher, or nowhere, has failed, and does not count against the noise.
    """
    noise = Noise(0.0, contest.floor.scatter)
    data = contest.data(noise, contender.best.point)
    free = contest.free(contender.effects)
    declared = declared_starts(contest.space, contest.only_of(contender.effects), contest.measurement.reach)
    own_starts = [Start.at(end) for end in contender.ends]
    starts = [*own_starts, *(own_starts[0]._replace(point=np.where(free, s, contender.best.point)) for s in declared)]
    starts = starts[: 1 if contest.timed & contender.effects else BLIND_STARTS]

    def fit(shifts: np.ndarray, model: np.ndarray | None) -> list[End]:
        tasks = starts * len(shifts)
        shown = data if model is None else data._replace(pairs=model)
        counted = np.broadcast_to(contest.training, (len(tasks), len(contest.training)))
        moved = np.repeat(shifts, len(starts), axis=0)
        ends = descend(contest.space, shown, tasks, free, counted, budget=contest.budget, kept=contender.best.point, shift=moved, manner=QUICK)
        return [best_of(ends[k : k + len(starts)]) for k in range(0, len(ends), len(starts))]

    weight = data.weight.reshape(len(contest.training), -1)
    own = fit(np.zeros((1, *weight.shape)), None)[0]
    pairs, prior = numpy_pair(own.shown), own.prior.cost
    rng = np.random.default_rng(seed)
    per_call = max(1, BATCH // len(starts))
    costs: list[float] = []
    while len(costs) < MOST_DRAWS:
        exceed = sum(cost >= own.cost for cost in costs)
        if (exceed >= ENOUGH_EXCEED and len(costs) >= FEWEST_DRAWS) or (len(costs) >= NONE_EXCEED and exceed == 0):
            break
        noises = rng.standard_normal((per_call, *weight.shape)) * (weight > 0.0) * contest.training[:, None]
        known = prior + 0.5 * np.sum(noises**2, axis=(1, 2))
        if data.scatter.shape[-1]:
            random = rng.standard_normal((per_call, data.run_count, data.scatter.shape[-1]))
            known += 0.5 * np.sum(random**2, axis=(1, 2))
            noises += np.einsum("cml,dcl->dcm", data.scatter, random[:, data.run])
        costs += [min(end.cost, bound) for end, bound in zip(fit(noises, pairs), known.tolist(), strict=True)]
    exceed = sum(cost >= own.cost for cost in costs)
    return PValue((exceed + 1) / (len(costs) + 1), len(costs))
