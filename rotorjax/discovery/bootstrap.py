"""Is what is left more than noise? A p-value calibrated by data drawn from the fitted model."""

from typing import NamedTuple

import numpy as np

from rotorjax.discovery.descent import QUICK, End, best_of, declared_starts, descend
from rotorjax.discovery.noise import Noise
from rotorjax.discovery.race import Contender, Contest

FEWEST_DRAWS, MOST_DRAWS = 39, 199
ENOUGH_EXCEED = 5
"""Draws that leave more than the data after which the p-value is large enough (Besag, Clifford 1991, Biometrika 78:301-304)."""
NONE_EXCEED = 99
"""Draws without a single one that leaves more after which it is small enough."""
FAR, FAR_DRAWS = 8.0, 19
"""Standard deviations above the draws at which the data leave no doubt, and how many draws are enough to say so."""
BLIND_STARTS = 2
"""Starts of every fit, those of the data's own among them."""


class PValue(NamedTuple):
    """Probability, if the model and the noise hold, of leaving as much as the data do."""

    value: float
    draws: int
    far: bool
    """The data leave more than every draw by many standard deviations: the value is only the least that so few can show."""


def p_value(contest: Contest, contender: Contender, *, seed: int = 0) -> PValue:
    """Parametric bootstrap of the least cost: the same fit, from the same starts, of data drawn from the fitted model.

    Noise is the table's and the scatter between runs; what a misfit would add is not counted. (k + 1)/(n + 1) for k of n
    draws that leave more than the data; it stops once 5 do, once none of 99 does, or where the data leave no doubt.
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
        ends = descend(contest.space, shown, tasks, free, counted, kept=contender.best.point, shift=moved, manner=contest.manner())
        return [best_of(ends[k : k + len(starts)]) for k in range(0, len(ends), len(starts))]

    weight = np.asarray(data.weight).reshape(len(contest.training), -1)
    own = fit(np.zeros((1, *weight.shape)), None)[0]
    pairs = np.asarray(data.pairs) + np.divide(own.local.error.reshape(data.weight.shape), data.weight, out=np.zeros(data.weight.shape), where=data.weight > 0)
    rng = np.random.default_rng(seed)
    per_call = max(1, QUICK.batch // len(starts))
    costs: list[float] = []
    while len(costs) < MOST_DRAWS:
        exceed, spread = sum(cost >= own.cost for cost in costs), float(np.std(costs)) if costs else 0.0
        far = len(costs) >= FAR_DRAWS and own.cost > np.mean(costs) + FAR * spread
        if (exceed >= ENOUGH_EXCEED and len(costs) >= FEWEST_DRAWS) or far or (len(costs) >= NONE_EXCEED and exceed == 0):
            break
        noises = rng.standard_normal((per_call, *weight.shape)) * (weight > 0.0)
        if data.scatter.shape[-1]:
            random = rng.standard_normal((per_call, data.run_count, data.scatter.shape[-1]))
            noises += np.einsum("cml,dcl->dcm", np.asarray(data.scatter).reshape(*weight.shape, -1), random[:, np.asarray(data.run)])
        costs += [end.cost for end in fit(noises, pairs)]
    exceed = sum(cost >= own.cost for cost in costs)
    far = exceed == 0 and own.cost > np.mean(costs) + FAR * np.std(costs)
    return PValue((exceed + 1) / (len(costs) + 1), len(costs), bool(far))
