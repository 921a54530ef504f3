"""Is what is left more than noise? A p-value calibrated by data drawn from the fitted model."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from rotorjax.arrays import numpy_pair
from rotorjax.discovery.contest import Contender, Contest
from rotorjax.inference.curvature import solved
from rotorjax.inference.data import Data
from rotorjax.inference.descent import End, Start, descend
from rotorjax.inference.descent_settings import QUICK
from rotorjax.inference.noise import Noise
from rotorjax.inference.squares import squares_of

UNEXPLAINED = 0.01
"""P-value up to which what is left counts as structure."""
MOST_DRAWS = 199
ENOUGH_EXCEED = 5
"""Draws that leave more than the data after which the p-value is large enough (Besag, Clifford 1991, Biometrika
78:301-304).
"""
BATCH = 24
"""Fits made together; after two of them it is looked whether enough exceed, after five whether none does."""
DOUBTFUL = 10.0
"""Distance of the data's cost from that of structure within which draws are fitted in full."""


class PValue(NamedTuple):
    """Probability, if the model and the noise hold, of leaving as much as the data do."""

    value: float
    draws: int


def p_value(contest: Contest, contender: Contender) -> PValue:
    """Parametric bootstrap of the least cost: the same fit of data drawn from the fitted model.

    Noise is the table's and the scatter between runs; what a misfit would add is not counted. (k + 1)/(n + 1) for k of
    n draws that leave more than the data. The fits are linearised where the data's own ended, which is a projection of
    the noise; draws are fitted in full, from the same start, only where that p-value is near the threshold, until 5
    leave more, or none of the first 120 does.
    """
    noise = Noise(0.0, contest.floor.scatter)
    data = contest.data(noise, contender.best.point)
    own = _refitted(contest, contender, data, None, np.zeros((1, *data.weight.reshape(len(data.weight), -1).shape)))[0]
    draws = _Draws(contest, own, data, np.random.default_rng(0))
    noises = draws.make(MOST_DRAWS)
    known, projected = draws.costs(noises)
    if abs(own.cost - float(np.quantile(projected, 1.0 - UNEXPLAINED))) > DOUBTFUL or contest.budget.exhausted:
        return PValue((int(np.sum(projected >= own.cost)) + 1) / (MOST_DRAWS + 1), MOST_DRAWS)
    pairs, costs = numpy_pair(own.shown), []
    for first in range(0, MOST_DRAWS, BATCH):
        exceed = sum(cost >= own.cost for cost in costs)
        if (exceed >= ENOUGH_EXCEED and first >= 2 * BATCH) or (exceed == 0 and first >= 5 * BATCH):
            break
        part = slice(first, first + BATCH)
        ends = _refitted(contest, contender, data, pairs, noises[part])
        # The least cost of a draw is at most that of the point it was drawn at.
        costs += [min(end.cost, bound) for end, bound in zip(ends, known[part].tolist(), strict=True)]
    return PValue((sum(cost >= own.cost for cost in costs) + 1) / (len(costs) + 1), len(costs))


def _refitted(
    contest: Contest,
    contender: Contender,
    data: Data,
    pairs: Float[np.ndarray, "case probe order 2"] | None,
    shifts: Float[np.ndarray, "draw case cell"],
) -> list[End]:
    """The fit to each draw of the noise about some vectors, those measured by default, from where the
    data's own ended.
    """
    free, starts = contest.free(contender.effects), [Start.at(contender.best)] * len(shifts)
    shown = data if pairs is None else data._replace(pairs=pairs)
    counted = np.broadcast_to(contest.training, (len(starts), len(contest.training)))
    return descend(
        contest.space,
        shown,
        starts,
        free,
        counted,
        budget=contest.budget,
        kept=contender.best.point,
        shift=shifts,
        settings=QUICK,
    )


class _Draws:
    """Noise drawn about a fit."""

    def __init__(self, contest: Contest, own: End, data: Data, rng: np.random.Generator) -> None:
        self.own, self.data, self.rng, self.training = own, data, rng, contest.training
        self.counted = (data.weight.reshape(len(data.weight), -1) > 0.0) & contest.training[:, None]

    def make(self, count: int) -> Float[np.ndarray, "draw case cell"]:
        """Noise in standard errors, with what the errors of several vectors have in common."""
        noises, common = self.rng.standard_normal((count, *self.counted.shape)) * self.counted, self.data.common
        random = self.rng.standard_normal((count, common.shape[-1]))
        return noises + np.einsum("cml,dl->dcm", common * self.counted[..., None], random)

    def costs(
        self, noises: Float[np.ndarray, "draw case cell"]
    ) -> tuple[Float[np.ndarray, "draw"], Float[np.ndarray, "draw"]]:
        """The cost of each draw at the point it was drawn at, and the least one, the model linearised there."""
        own = self.own
        slopes = np.concatenate([own.local.slopes * self.counted[..., None], np.moveaxis(noises, 0, -1)], axis=-1)
        free = len(own.free)
        products = squares_of(self.data, np.zeros(self.counted.shape), slopes, self.training).hessian
        known = 0.5 * np.diag(products)[free:] + own.prior.cost
        gradient = products[:free, free:] + (own.prior.weight * own.point[own.free])[:, None]
        return known, known - 0.5 * np.sum(gradient * solved(own.curvature, gradient), axis=0)
