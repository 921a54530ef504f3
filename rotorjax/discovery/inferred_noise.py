"""A fit under the noise that it leaves: the table's, and the misfit that has to be added to it, inferred along.

Fit and misfit alternate until the misfit allowed for is the one found. Sets of effects that race do so under one noise,
that of their winner (`rotorjax.discovery.common_noise.settle`).
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool

from rotorjax.data.measurement import Measurement
from rotorjax.inference.budget import Budget
from rotorjax.inference.data import Data, declared_starts, make_data, residual_vectors
from rotorjax.inference.descent import HOPELESS, End, Start, best_of, descend, distinct_of, starts_at
from rotorjax.inference.noise import LEAST_NOISE, MOST_ROUNDS, NO_NOISE, NOISE_FLOOR, SAME_MISFIT, Noise, misfit_of
from rotorjax.inference.space import Space
from rotorjax.model.model import Model


class Stage(NamedTuple):
    """What is fitted to what."""

    space: Space
    measurement: Measurement
    names: tuple[str, ...]
    free: Bool[np.ndarray, "param"]
    keep: frozenset[str]
    budget: Budget


class Round(NamedTuple):
    """One fit under one allowance for misfit, and the misfit that it found."""

    allowance: float
    data: Data
    best: End
    starts: list[Start]
    """Where the descents ended: to go on from."""
    misfit: float
    first_cost: float
    """Cost of the best fit under the allowance that the rounds began with, if that was a narrow one and its motions
    balance.
    """

    @property
    def settled(self) -> bool:
        """Whether the misfit found is the one allowed for."""
        return abs(self.misfit - self.allowance) <= SAME_MISFIT * self.allowance

    @property
    def holds(self) -> bool:
        """Whether it needs no allowance, and its motions balance."""
        return self.best.exact and self.allowance == self.misfit == 0.0

    @property
    def minus_log_posterior(self) -> float:
        """Up to a constant; the noise's own normalisation counts, so that allowances can be compared."""
        weight = np.asarray(self.data.weight)
        return self.best.cost - float(np.sum(np.log(weight[weight > 0.0])))


class Ahead(NamedTuple):
    """What other models reached on the same data."""

    minus_log_posterior: float = math.inf
    first_cost: float = math.inf
    """As in `Round`, of rounds that begin with no allowance."""
    holds: bool = False
    """Whether one of them holds within the noise that is known."""

    def of(self, rounds: list[Round]) -> "Ahead":
        """With what another model reached, if its motions balance."""
        best = likeliest(rounds)
        if not best.best.exact:
            return self
        return Ahead(
            min(self.minus_log_posterior, best.minus_log_posterior),
            min(self.first_cost, rounds[0].first_cost),
            self.holds or best.holds,
        )

    def hopeless_cost(self, measurement: Measurement) -> float:
        """Cost under the table's noise alone with which a fit does not go on; where that noise is a misfit, only the
        ratio of costs counts.
        """
        if measurement.sigma is None:
            return math.inf
        numbers = max(1, np.count_nonzero(measurement.weights(0.0)))
        return max(self.first_cost + HOPELESS, self.first_cost * math.exp(2.0 * HOPELESS / numbers))


def fitted_rounds(stage: Stage, own: list[Start] | None = None, ahead: Ahead | None = None) -> list[Round]:
    """A fit within the table's noise, or else some that start from it and from a wide allowance for misfit.

    Where a model leaves a hundred standard errors, weighing the data by those would let them drag weakly determined
    parameters anywhere; the allowance, one isotropic standard error added to the table's, grows or shrinks until it
    equals the misfit found, and vanishes where the model holds. A wide one alone can settle where the prior rules and
    nothing was fitted; a narrow one alone can run into a corner first: so both, compared by posterior density.
    What is behind other models by far under a wide one ends there; where one holds within the noise of the table, the
    others are fitted under that noise, from where they are told to begin and from where a wide one leads.
    **Arguments:** ``own``: starts in the place of those declared; ``ahead``: what other models reached.
    """
    measurement, ahead = stage.measurement, ahead or Ahead()
    starts = own or starts_at(declared_starts(stage.space, stage.free, measurement))
    most = max(measurement.rms, LEAST_NOISE)
    floor = 0.0 if measurement.sigma is not None else max(NOISE_FLOOR * measurement.rms, LEAST_NOISE)
    hopeless = ahead.hopeless_cost(measurement)
    if ahead.holds:
        wide = _round(stage, most, starts, stage.space.model)
        return [_round(stage, floor, begin, stage.space.model, hopeless) for begin in (starts, [Start.at(wide.best)])]
    wide = _settle(stage, most, starts) if math.isfinite(ahead.minus_log_posterior) else None
    if wide is not None and wide.minus_log_posterior > ahead.minus_log_posterior + HOPELESS:
        return [wide._replace(first_cost=math.inf)]
    now = _settle(stage, floor, starts, hopeless)
    # The noise given is known: a fit that holds within it needs no comparison with one that had to widen it.
    if now.holds:
        return [now]
    wide = wide or _settle(stage, most, starts)
    return [now, wide, _settle(stage, floor, [Start.at(wide.best)], hopeless)]


def likeliest(rounds: list[Round]) -> Round:
    """The one whose cost is finite and whose motions balance, with no misfit if there is one, by posterior density."""
    return min(
        rounds,
        key=lambda one: (
            not math.isfinite(one.best.cost), not one.best.exact, one.misfit > 0.0, one.minus_log_posterior
        ),
    )  # fmt: skip


def _settle(stage: Stage, allowance: float, starts: list[Start], hopeless: float = math.inf) -> Round:
    """Rounds until the allowance equals the misfit found. **Arguments:** ``hopeless``: cost with which the first of
    them does not go on.
    """
    now = _round(stage, allowance, starts, stage.space.model, hopeless)
    # What a calibration leaves open is felt otherwise where the fit ends.
    felt_there = stage.measurement.calibration is None
    for _ in range(MOST_ROUNDS - 1):
        if (now.settled and felt_there) or not math.isfinite(now.best.cost):
            break
        felt_there = True
        now = _round(stage, now.misfit, now.starts, stage.space.model_at(now.best.point))._replace(
            first_cost=now.first_cost
        )
    return now


def _round(stage: Stage, allowance: float, starts: list[Start], model: Model, hopeless: float = math.inf) -> Round:
    data = make_data(stage.measurement, model, Noise(allowance))
    every = np.ones((len(starts), len(stage.measurement.run)), bool)
    ends = descend(stage.space, data, starts, stage.free, every, budget=stage.budget, hopeless=hopeless)
    best = best_of(ends)
    # Of many starts a few optima are left.
    ended = [Start.at(end) for end in distinct_of(ends)]
    ended = ended or [
        Start.at(end) if math.isfinite(end.cost) else start for end, start in zip(ends, starts, strict=True)
    ]
    left = residual_vectors(best.local.error, data)
    misfit = misfit_of(stage.measurement, stage.space.model_at(best.point), left, int(stage.free.sum()), NO_NOISE)
    return Round(allowance, data, best, ended, misfit, best.cost if best.exact else math.inf)
