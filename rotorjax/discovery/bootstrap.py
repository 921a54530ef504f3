"""Is what is left more than noise? A p-value calibrated by data drawn from the fitted model."""

from typing import NamedTuple

import numpy as np

from rotorjax.discovery.descent import QUICK, End, best_of, declared_starts, descend
from rotorjax.discovery.noise import Noise
from rotorjax.discovery.race import Contender, Contest

MOST_DRAWS = 199
ENOUGH_EXCEED = 5
"""Draws that leave more than the data after which the p-value is large enough (Besag, Clifford 1991, Biometrika 78:301-304)."""
NONE_EXCEED = 99
"""Draws without a single one that leaves more after which it is small enough."""
BLIND_STARTS = 4
"""Starts of every fit, those of the data's own among them."""


class PValue(NamedTuple):
    """Probability, if the model and the noise hold, of leaving as much as the data do."""

    value: float
    draws: int


def p_value(contest: Contest, contender: Contender, *, seed: int = 0) -> PValue:
    """Parametric bootstrap of the least cost: the same fit, from the same starts, of data drawn from the fitted model.

    Noise is the table's and the scatter between runs; what a misfit would add is not counted. (k + 1)/(n + 1) for k of n
    draws that leave more than the data; it stops once 5 do, or once none of 99 does.
    """
    noise = Noise(0.0, contest.floor.scatter)
    data = contest.data(noise, contender.best.point)
    free = contest.free(contender.effects)
    declared = declared_starts(contest.space, contest.only_of(contender.effects))
    starts = np.stack([*(end.point for end in contender.ends), *(np.where(free, s, contender.best.point) for s in declared)])[:BLIND_STARTS]

    def fit(shifts: np.ndarray, model: np.ndarray | None) -> list[End]:
        tasks = np.tile(starts, (len(shifts), 1))
        shown = data if model is None else data._replace(pairs=model)
        counted = np.broadcast_to(contest.training, (len(tasks), len(contest.training)))
        moved = np.repeat(shifts, len(starts), axis=0)
        ends = descend(contest.space, shown, tasks, free, counted, kept=contender.best.point, shift=moved, manner=QUICK)
        return [best_of(ends[k : k + len(starts)]) for k in range(0, len(ends), len(starts))]

    weight = np.asarray(data.weight).reshape(len(contest.training), -1)
    own = fit(np.zeros((1, *weight.shape)), None)[0]
    pairs = np.asarray(data.pairs) + np.divide(own.local.error.reshape(data.weight.shape), data.weight, out=np.zeros(data.weight.shape), where=data.weight > 0)
    rng = np.random.default_rng(seed)
    per_call = max(1, QUICK.batch // len(starts))
    exceed = draws = 0
    while draws < MOST_DRAWS and exceed < ENOUGH_EXCEED and not (draws >= NONE_EXCEED and exceed == 0):
        noises = rng.standard_normal((per_call, *weight.shape)) * (weight > 0.0)
        if data.scatter.shape[-1]:
            random = rng.standard_normal((per_call, data.run_count, data.scatter.shape[-1]))
            noises += np.einsum("cml,dcl->dcm", np.asarray(data.scatter).reshape(*weight.shape, -1), random[:, np.asarray(data.run)])
        costs = [end.cost for end in fit(noises, pairs)]
        exceed += sum(cost >= own.cost for cost in costs)
        draws += per_call
    return PValue((exceed + 1) / (draws + 1), draws)
