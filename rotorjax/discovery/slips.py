"""Whether something was written down wrongly: changes of what rig file and table state, in the race with effects.

For each change all effects without a force that depends on motion are fitted at once. No set of them can do better, so
that what misses by more than the best answer known need not be searched; what may come near is searched as the
original is.
"""

import dataclasses
import itertools
import math
from collections.abc import Collection
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool

from rotorjax.data.declarations import Slip, log_odds, promising, slips
from rotorjax.discovery.race import EXACT_SHARE, Contender, Contest, Effects, misfit_left
from rotorjax.discovery.rivals import TIE
from rotorjax.discovery.search import Progress, Selection, select
from rotorjax.inference.descent import End, descend, starts_at
from rotorjax.inference.manner import QUICK
from rotorjax.inference.noise import NO_NOISE, Noise

NEAR = 15.0
"""Log evidence behind the answer up to which a change is searched, by what its fit of all linear effects says of small
sets of them to second order.
"""
MOST_SEARCHED = 3
"""Changes that are searched."""
FAMILY_ODDS = 0.25
"""Prior odds that something was written down wrongly: those of a family of effects."""
HALVED = 0.5
"""Share of the misfit that a change must leave at most to count where it does not hold within the noise."""
FITS = 5.0
"""Standard deviations of chi-square up to which a fit of all linear effects holds within the noise."""


PATIENT = QUICK._replace(patience=12)
"""How all linear effects are fitted: begun far from the truth, as a rule."""
SAME = 1e-6
"""Difference of costs of one fit made twice."""


class Alternative(NamedTuple):
    """What is stated, or a change of it, with the best effects beside."""

    slip: Slip | None
    selection: Selection
    score: float
    """Logarithm of marginal likelihood and prior odds, up to a constant."""
    misfit: float
    """Allowance for misfit that its answer needs [m]."""

    @property
    def slip_name(self) -> str | None:
        """Name of what was changed, if anything."""
        return None if self.slip is None else self.slip.name

    @property
    def named(self) -> tuple[str, ...]:
        """What was changed, then the effects."""
        return (*([] if self.slip is None else [self.slip.name]), *self.selection.effects)


class Race(NamedTuple):
    """Alternatives, the most probable first."""

    ranked: tuple[Alternative, ...]

    @property
    def best(self) -> Alternative:
        """The answer."""
        return self.ranked[0]

    @property
    def tied(self) -> tuple[Alternative, ...]:
        """Those within 3 log units of it."""
        return tuple(other for other in self.ranked[1:] if self.best.score - other.score < TIE)


class _Screened(NamedTuple):
    """What is stated, or a change of it, with all linear effects fitted at once."""

    slip: Slip | None
    contest: Contest
    end: End
    log_odds: float


def race_of_slips(contest: Contest, kinds: Collection[str], most: int, progress: Progress) -> Race:
    """Race what is stated against every change of it that the data do not rule out, each with the effects beside it.

    **Arguments:** ``kinds`` of changes that may be; ``most`` effects at most. **Returns** what is stated alone where
    nothing comes near it.
    """
    measurement = contest.measurement
    every = slips(contest.space.model, measurement, kinds) if measurement.rms > 0.0 and kinds else []
    if not every:
        return Race((Alternative(None, select(contest, most, progress=progress), 0.0, 0.0),))
    odds = log_odds(every, FAMILY_ODDS)
    every, screened, stated = promising(contest.space.model, measurement, every), [], None
    if measurement.sigma is not None:
        stated = _screened(contest, None, NO_NOISE, 0.0)
        if not _holds(stated):
            progress("whether something was written down wrongly")
            screened = [_screened(contest, slip, NO_NOISE, odds[slip.name]) for slip in every]
            sound = [one for one in screened if _holds(one)]
            if sound:
                return _without_what_is_stated(stated, sound, most, progress)
    own = _alternative(None, select(contest, most, progress=progress))
    if contest.budget.exhausted:
        return Race((own,))
    noise = Noise(own.misfit if measurement.sigma is None else 0.0)
    stated = stated or _screened(contest, None, noise, 0.0)
    if not screened:
        progress("whether something was written down wrongly")
        least = _least(own, noise)
        screened = [_screened(contest, slip, noise, odds[slip.name], hopeless=-least) for slip in every]
    return _race(own, _near(own, stated, screened, noise), most, progress)


def _least(own: Alternative, noise: Noise) -> float:
    """Log evidence and prior odds under a noise from which on a change may do as well as the answer."""
    contest = own.selection.contest
    return _score(contest, own.selection.known[own.selection.present], noise, normalised=False) - NEAR


def _without_what_is_stated(stated: _Screened, sound: list[_Screened], most: int, progress: Progress) -> Race:
    """Changes with which linear effects hold within the noise, where they do not with what is stated: that is searched
    last, with a share of the linearisations and one effect, for a force that depends on motion may hold.
    """
    contest = stated.contest
    nearest, *further = sorted(sound, key=lambda one: one.end.cost - one.log_odds)
    first = _searched(nearest, most, progress)
    others = [_searched(one, most, progress) for one in _near(first, stated, further, NO_NOISE)]
    limit = math.inf if contest.budget.limit is None else contest.budget.limit - contest.budget.spent
    share = int(min(EXACT_SHARE, limit))
    apart = dataclasses.replace(contest, budget=contest.budget.part(share))
    own = _alternative(None, select(apart, 1, progress=progress))
    contest.budget.spend(apart.budget.spent)
    return _ranked([first, *others, own])


def _race(own: Alternative, near: list[_Screened], most: int, progress: Progress) -> Race:
    found = [own]
    for one in near:
        if one.contest.budget.exhausted:
            break
        other = _searched(one, most, progress)
        if other.misfit == 0.0 or other.misfit < HALVED * own.misfit:
            found.append(other)
    return _ranked(found)


def _ranked(found: list[Alternative]) -> Race:
    return Race(tuple(sorted(found, key=lambda one: -one.score)))


def _searched(one: _Screened, most: int, progress: Progress) -> Alternative:
    assert one.slip is not None
    progress(f"whether {one.slip.meaning}")
    return _alternative(one.slip, select(one.contest, most), one.log_odds)


def _near(own: Alternative, stated: _Screened, screened: list[_Screened], noise: Noise) -> list[_Screened]:
    """Changes that may do as well as the answer for what is stated: by their score if that holds within the noise, else
    by their cost.
    """
    contest = own.selection.contest
    if own.misfit <= noise.allowance and contest.floor.scatter == noise.scatter:
        sets, least = _small_sets(contest, own.selection), _least(own, noise)
        scores = {one.slip: max(_second_order(one, effects) for effects in sets) + one.log_odds for one in screened}
        likely = [one for one in screened if scores[one.slip] > least and _differs(one, stated)]
    else:
        likely = [one for one in screened if one.end.cost < HALVED * stated.end.cost]
    if own.selection.present & contest.timed:
        likely += [one for one in screened if one.slip and one.slip.kind.startswith("weight_") and one not in likely]
    return sorted(likely, key=lambda one: one.end.cost - one.log_odds)[:MOST_SEARCHED]


def _screened(
    contest: Contest, slip: Slip | None, noise: Noise, odds: float, *, hopeless: float = math.inf
) -> _Screened:
    """All linear effects at once, from where the model has them. **Arguments:** ``hopeless``: cost with which the fit
    does not go on.
    """
    if slip is not None:
        model, measurement = slip.corrected(contest.space.model, contest.measurement)
        space = dataclasses.replace(contest.space, model=model)
        contest = dataclasses.replace(contest, space=space, measurement=measurement)
    start, free = contest.space.given_unknowns(), _linear(contest)
    data, budget = contest.data(noise, start), contest.budget
    training, starts = contest.training[None], starts_at(start[None])
    (end,) = descend(contest.space, data, starts, free, training, budget=budget, manner=PATIENT, hopeless=hopeless)
    return _Screened(slip, contest, end, odds)


def _linear(contest: Contest) -> Bool[np.ndarray, "param"]:
    return contest.free(frozenset(contest.candidates) - contest.timed)


def _differs(one: _Screened, other: _Screened) -> bool:
    """Whether a change makes any difference to linear effects."""
    return abs(one.end.cost - other.end.cost) > SAME


def _holds(one: _Screened) -> bool:
    """Whether what the fit leaves, and the size of its values, are no more than noise and priors allow."""
    numbers = np.count_nonzero(one.contest.measurement.weights(0.0))
    return bool(2.0 * one.end.cost < numbers + FITS * math.sqrt(2.0 * numbers))


def _alternative(slip: Slip | None, selection: Selection, odds: float = 0.0) -> Alternative:
    contest, contender = selection.contest, selection.known[selection.present]
    noise = Noise(misfit_left(contest, contender), contest.floor.scatter)
    return Alternative(slip, selection, _score(contest, contender, noise) + odds, noise.allowance)


def _score(contest: Contest, contender: Contender, noise: Noise, *, normalised: bool = True) -> float:
    """Log evidence and prior odds, ``normalised`` by the size of the noise, so that different noises compare.

    Where a misfit is allowed for, only independent data count: a misfit repeats itself from run to run.
    """
    end = contender.best
    data = contest.data(noise, end.point)
    old, weight = contest.measurement.weights(contender.noise.allowance), data.weight
    ratio = np.divide(weight, old, out=np.zeros_like(old), where=old > 0.0).reshape(len(old), -1)
    error, used = end.local.error * ratio, weight[weight > 0.0]
    cost, logarithm = 0.0, -float(np.sum(np.log(used)))
    for run in range(data.run_count):
        own, block = error[data.run == run].ravel(), data.scatter[data.run == run]
        block = block.reshape(len(own), block.shape[-1])
        covariance = np.eye(len(own)) + block @ block.T
        logarithm += 0.5 * float(np.linalg.slogdet(covariance)[1])
        cost += 0.5 * float(own @ np.linalg.solve(covariance, own))
    share = min(1.0, contest.independent_numbers / len(used)) if noise.allowance > 0.0 else 1.0
    occam = end.prior.cost + 0.5 * float(np.linalg.slogdet(end.curvature)[1])
    return -share * (cost + normalised * logarithm) - occam + contest.log_odds(contender.effects)


def _small_sets(contest: Contest, selection: Selection) -> list[Effects]:
    """Nothing, every effect, every pair, and the answer: of effects without a force that depends on motion."""
    linear = [name for name in contest.candidates if name not in contest.timed]
    sets = [frozenset(part) for size in range(3) for part in itertools.combinations(linear, size)]
    return list(dict.fromkeys([*sets, selection.present - contest.timed]))


def _second_order(one: _Screened, effects: Effects) -> float:
    """Log evidence and prior odds of a set, its cost to second order about the fit of all linear effects."""
    contest, end = one.contest, one.end
    kept = contest.free(effects)[end.free]
    point, curvature = end.point[end.free][~kept], end.curvature
    rest, across = curvature[np.ix_(kept, kept)], curvature[np.ix_(kept, ~kept)]
    schur = curvature[np.ix_(~kept, ~kept)] - across.T @ np.linalg.solve(rest, across)
    occam = 0.5 * float(np.linalg.slogdet(rest)[1])
    return -(end.cost + 0.5 * float(point @ schur @ point)) - occam + contest.log_odds(effects)
