"""Whether something was written down wrongly: changes of what rig file and table state, in the race with effects.

For each change all effects are fitted at once but those that cost many times as much: forces that depend on motion, and
a sweep. No set of them can do better, so that what misses by more than the best answer known need not be searched; what
may come near is searched as the original is. Where they do not hold within the noise with what is stated, no set of
them is tried under that noise before a force that depends on motion holds.
"""

import dataclasses
import math
from collections.abc import Collection
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from rotorjax.data.declarations import Slip, log_odds, promising, slips
from rotorjax.discovery.contest import Contest, Effects
from rotorjax.discovery.race import score
from rotorjax.discovery.rivals import TIE
from rotorjax.discovery.search import WIDE, Progress, Selection, select
from rotorjax.inference.descent import HOPELESS, End, descend, starts_at
from rotorjax.inference.manner import CONVERGED, QUICK, Manner
from rotorjax.inference.noise import LARGEST_HEALTHY_CHI2, NO_NOISE, Noise, is_large
from rotorjax.inference.prediction import predict
from rotorjax.model.contract import SweepEffect

MOST_SEARCHED = 3
"""Changes that are searched where no answer holds."""
FAMILY_ODDS = 0.25
"""Prior odds that something was written down wrongly: those of a family of effects."""
HALVED = 0.5
"""Share of the misfit, or of the cost with all linear effects, that a change must leave at most to count where it does
not hold within the noise. Without a mistake the best of 20 changes left 0.84 of the cost beside drawn forces that
depend on motion; mistakes left 0.03 to 0.07.
"""
OF_WHAT_IS_STATED = 0.6
"""Share of the linearisations left for what is stated where the rotor may have another weight: RK4 took 0.52."""
FITS = 5.0
"""Standard deviations of chi-square up to which a fit of all linear effects holds within the noise."""


BEGUN = QUICK._replace(most_steps=5)
"""How changes begin: what they leave after some steps is the order in which they go on."""
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
    def named(self) -> tuple[str, ...]:
        """What was changed, then the effects."""
        return (*([] if self.slip is None else [self.slip.name]), *self.selection.effects)


class Race(NamedTuple):
    """Alternatives, the most probable first."""

    ranked: tuple[Alternative, ...]
    tried: bool = True
    """Whether changes of what is stated took part."""
    cut_off: tuple[Slip, ...] = ()
    """Those whose search was ended, as it took as long as that for the answer."""

    @property
    def best(self) -> Alternative:
        """The answer."""
        return self.ranked[0]

    @property
    def tied(self) -> tuple[Alternative, ...]:
        """Those within 3 log units of it."""
        return tuple(other for other in self.ranked[1:] if self.best.score - other.score < TIE)


class _Change(NamedTuple):
    """What is stated, or a change of it."""

    slip: Slip | None
    contest: Contest
    log_odds: float = 0.0

    @property
    def numbers(self) -> int:
        """Of data that count."""
        return int(np.count_nonzero(self.contest.measurement.weights(0.0)))

    def without(self, effects: Effects) -> "_Change":
        """The same with none of these effects beside it."""
        candidates = tuple(name for name in self.contest.candidates if name not in effects)
        return self._replace(contest=dataclasses.replace(self.contest, candidates=candidates))


class _Screened(NamedTuple):
    """All linear effects beside a change, fitted at once."""

    change: _Change
    end: End

    def without(self, effects: Effects) -> "_Screened":
        """The same with none of these effects beside the change when that is searched."""
        return self._replace(change=self.change.without(effects))

    @property
    def cost(self) -> float:
        """Of the fit and of the prior odds, and what narrows down the values declared uncertain: minus the log evidence
        of any set of those effects is more, as each of them costs prior odds and narrows down its own.
        """
        own = self.change.contest.free(frozenset())[self.end.free]
        occam = 0.5 * float(np.linalg.slogdet(self.end.curvature[np.ix_(own, own)])[1])
        return self.end.cost + occam - self.change.log_odds


def race_of_slips(
    contest: Contest, kinds: Collection[str], most: int, progress: Progress, *, always: bool = True
) -> Race:
    """Race what is stated against every change of it that the data do not rule out, each with the effects beside it.

    **Arguments:** ``kinds`` of changes that may be; ``most`` effects at most; ``always``: also where what is stated
    leads to an answer that holds and is not `_like_a_mistake`: with such an answer only changes are searched with
    which linear effects do as well. **Returns** what is stated alone where nothing comes near it.
    """
    measurement = contest.measurement
    every = slips(contest.space.model, measurement, kinds) if measurement.rms > 0.0 and kinds else []
    if not every:
        return Race((Alternative(None, select(contest, most, progress=progress), 0.0, 0.0),), tried=False)
    odds = log_odds(every, FAMILY_ODDS)
    changes = [_change(contest, slip, odds[slip.name]) for slip in promising(contest.space.model, measurement, every)]
    screened, stated, budget = [], None, contest.budget
    if measurement.sigma is not None:
        as_is = _Change(None, contest)
        # What misses by more is fitted under a wide noise first.
        enough = _most_held(as_is) / HALVED
        stated = _screened(as_is, NO_NOISE, hopeless=enough)
        if not _holds(stated) and (sweeps := _sweeps(contest)):
            also = _screened(as_is, NO_NOISE, also=sweeps, hopeless=enough)
            stated = min(stated, also, key=lambda one: one.end.cost)
        if not _holds(stated):
            progress("whether something was written down wrongly")
            stated, screened, ahead = _of_what_fails(stated, changes)
            if ahead and (race := _without_what_is_stated(stated, ahead, most, progress)):
                return race
        contest = dataclasses.replace(contest, linear_may_hold=_may_hold(stated))
    before = budget.spent
    own, unfinished = _as_stated(contest, most, progress, beside=any(_of_weight(one.change) for one in screened))
    doubtful = always or _misses(own) or _like_a_mistake(own)
    if budget.exhausted or not (doubtful or screened):
        return Race((own,), tried=bool(screened))
    share = math.inf if _misses(own) else budget.spent - before
    noise = Noise(own.misfit if measurement.sigma is None else 0.0)
    stated = stated or _screened(_Change(None, contest), noise)
    if not screened:
        progress("whether something was written down wrongly")
        least = _least(own, noise)
        screened = [_screened(change, noise, hopeless=-least) for change in changes]
    near = _near(own, stated, screened, noise, beside_forces=doubtful)
    if unfinished:
        share = budget.left / max(1, len(near))
    found, cut_off = _with_near(own, near, noise, most, progress, share=share)
    if unfinished and _ranked(found, cut_off).best is own:
        found[0] = _alternative(None, select(contest, most, known=own.selection.known, progress=progress))
    return _ranked(found, cut_off)


def _as_stated(contest: Contest, most: int, progress: Progress, *, beside: bool) -> tuple[Alternative, bool]:
    """What is stated, searched, and whether that is unfinished. **Arguments:** ``beside``: whether the rotor may have
    another weight: forces that depend on motion make up for a wrong one without end, so that two fifths of the
    linearisations are left.
    """
    budget = contest.budget
    with budget.share(OF_WHAT_IS_STATED * budget.left if beside else math.inf):
        own = _alternative(None, select(contest, most, progress=progress))
        return own, beside and budget.exhausted


def _of_what_fails(stated: _Screened, changes: list[_Change]) -> tuple[_Screened, list[_Screened], list[_Screened]]:
    """What is stated, where linear effects do not hold within the noise with it, changes that may be near, and those
    ahead, the nearest first; none where what is stated holds after all.

    All are fitted under a wide noise first: data that a fit cannot meet drag it into a corner. What is behind what is
    stated under that noise stays so.
    """
    measurement = stated.change.contest.measurement
    level = _screened(stated.change, Noise(WIDE * measurement.rms))
    enough = _most_held(stated.change) / HALVED
    stated = min(stated, _exactly(level, hopeless=enough), key=lambda one: one.end.cost)
    if _holds(stated):
        return stated, [], []
    # What linear effects do not feel, a weight for instance, leaves them as they are.
    felt = [change for change in changes if _feels(change, level)]
    alike = [_Screened(change, stated.end) for change in changes if change not in felt]
    possible = _not_behind(level, felt)
    screened, enough = list[_Screened](), max(HALVED * stated.end.cost, enough)
    for one in possible:
        screened.append(_exactly(one, hopeless=enough))
        if _holds(screened[-1]):
            enough = min(enough, screened[-1].end.cost + HOPELESS)
    ahead = [
        exact
        for rough, exact in zip(possible, screened, strict=True)
        if _holds(exact) or rough.end.cost < HALVED * level.end.cost or exact.end.cost < HALVED * stated.end.cost
    ]
    ahead.sort(key=lambda one: (0, one.cost) if _holds(one) else (1, 0.0))
    return stated, [*screened, *alike], ahead


def _not_behind(level: _Screened, changes: list[_Change]) -> list[_Screened]:
    """Changes that leave no more than what is stated under the wide noise of its fit, the nearest first.

    All are begun, and go on in the order of what they leave: not once they promise twice as much as what is stated
    leaves, or far more than the best.
    """
    wide, most = Noise(WIDE * level.change.contest.measurement.rms), level.end.cost + TIE
    enough = most / HALVED
    begun = [_screened(change, wide, manner=BEGUN, hopeless=enough) for change in changes]
    fitted = list[_Screened]()
    for one in sorted(begun, key=lambda one: one.end.cost):
        going_on = one.end.result != CONVERGED and one.end.steps == BEGUN.most_steps
        fitted.append(_screened(one.change, wide, start=one.end.point, hopeless=enough) if going_on else one)
        enough = min(enough, fitted[-1].end.cost + HOPELESS)
    return sorted((one for one in fitted if one.end.cost < most), key=lambda one: one.cost)


def _exactly(rough: _Screened, *, hopeless: float = math.inf) -> _Screened:
    """The fit under the noise of the table, begun where that under a wide one ended."""
    return _screened(rough.change, NO_NOISE, start=rough.end.point, hopeless=hopeless)


def _feels(change: _Change, level: _Screened) -> bool:
    """Whether a change makes any difference to linear effects fitted to what is stated: to what was measured, or to
    what they show.
    """
    contest, stated = change.contest, level.change.contest
    if contest.measurement.vectors is not stated.measurement.vectors:
        return True
    shown = predict(contest.space, contest.measurement.conditions, level.end.point, budget=contest.budget).shown
    return not np.allclose(shown, level.end.shown, rtol=SAME, atol=0.0, equal_nan=True)


def _misses(own: Alternative) -> bool:
    """Whether an answer leaves more than the noise, or more than noise would be where that is unknown."""
    measurement = own.selection.contest.measurement
    return own.misfit > 0.0 if measurement.sigma is not None else is_large(own.misfit, measurement)


def _like_a_mistake(own: Alternative) -> bool:
    """Whether an effect of the measuring chain is in an answer or, where nothing else is installed in any other run, an
    excitation: what they do, a mistake may do as well.
    """
    contest = own.selection.contest
    installed = np.asarray(contest.measurement.conditions.unbalance)
    families = {"reading", "excitation"} if np.all(installed == installed[:1]) else {"reading"}
    return any(e.name in own.selection.present and e.family in families for e in contest.space.model.effects)


def _least(own: Alternative, noise: Noise) -> float:
    """Log evidence and prior odds under a noise from which on a change may do as well as the answer."""
    contest = own.selection.contest
    return score(contest, own.selection.known[own.selection.present], noise, normalised=False) - TIE


def _without_what_is_stated(stated: _Screened, ahead: list[_Screened], most: int, progress: Progress) -> Race | None:
    """Changes with which linear effects leave far less than with what is stated, or hold within the noise where they do
    not: if one of them leads to an answer that holds, what is stated is searched last, with as many linearisations, for
    a force that depends on motion may hold. **Returns** nothing where none does within half of the linearisations left.
    """
    budget = stated.change.contest.budget
    nearest, *further = ahead
    before = budget.spent
    with budget.share(budget.left / 2):
        first = _searched(nearest.change, most, progress)
    if first.misfit > 0.0:
        return None
    took = budget.spent - before
    found, cut_off = _with_near(first, _near(first, stated, further, NO_NOISE), NO_NOISE, most, progress)
    with budget.share(took):
        own = _alternative(None, select(stated.change.contest, most, progress=progress))
    return _ranked([*found, own], cut_off)


def _with_near(
    first: Alternative,
    near: list[_Screened],
    noise: Noise,
    most: int,
    progress: Progress,
    *,
    share: float | int = math.inf,
) -> tuple[list[Alternative], tuple[Slip, ...]]:
    """An answer, and changes searched, the nearest first, until the next is out of reach of what was found; and those
    that were cut off. **Arguments:** ``share``: linearisations for each of them.
    """
    found, cut_off, holds = [first], list[Slip](), first.misfit <= noise.allowance
    for one in near:
        budget = one.change.contest.budget
        if budget.exhausted or (holds and -one.cost < max(_least(other, noise) for other in found)):
            break
        with budget.share(share):
            other = _searched(one.change, most, progress)
            if budget.exhausted and one.change.slip is not None:
                cut_off.append(one.change.slip)
        # Of an unknown noise each alternative has its own, and the score counts it.
        if noise.allowance > 0.0 or other.misfit == 0.0 or other.misfit < HALVED * first.misfit:
            found.append(other)
    return found, tuple(cut_off)


def _ranked(found: list[Alternative], cut_off: tuple[Slip, ...]) -> Race:
    ranked = tuple(sorted(found, key=lambda one: -one.score))
    return Race(ranked, cut_off=tuple(slip for slip in cut_off if slip != ranked[0].slip))


def _searched(change: _Change, most: int, progress: Progress) -> Alternative:
    assert change.slip is not None
    progress(f"whether {change.slip.meaning}")
    return _alternative(change.slip, select(change.contest, most), change.log_odds)


def _near(
    own: Alternative, stated: _Screened, screened: list[_Screened], noise: Noise, *, beside_forces: bool = True
) -> list[_Screened]:
    """Changes that may do as well as the answer. If that holds within the noise: those with which all linear effects,
    and its forces that depend on motion, cost no more than it does with its prior; nothing else need be beside them.
    Else those that leave far less than what is stated. **Arguments:** ``beside_forces``: whether those forces count for
    all changes, or only for those of the weight, which nothing else feels.
    """
    contest, dear = own.selection.contest, _dear(own.selection.contest)
    beside = own.selection.present & dear
    if own.misfit > noise.allowance or contest.floor.scatter != noise.scatter:
        likely = [one for one in screened if one.end.cost < HALVED * stated.end.cost]
        if beside:
            likely += [one for one in screened if _of_weight(one.change) and one not in likely]
        return sorted(likely, key=lambda one: one.cost)[:MOST_SEARCHED]
    least = _least(own, noise)
    with_forces = [one for one in screened if beside and (beside_forces or _of_weight(one.change))]
    near = [one for one in screened if one not in with_forces and -one.cost > least and _differs(one, stated)]
    found = [one.without(dear) for one in near]
    if possible := [one for one in with_forces if HALVED * one.end.cost < stated.end.cost]:
        level, *fitted = (_screened(one.change, noise, own) for one in (stated, *possible))
        near = [one for one in fitted if -one.cost > least and _differs(one, level)]
        found += [one.without(dear - beside) for one in near]
    return sorted(found, key=lambda one: one.cost)


def _of_weight(change: _Change) -> bool:
    return change.slip is not None and change.slip.kind.startswith("weight_")


def _change(contest: Contest, slip: Slip, odds: float) -> _Change:
    model, measurement = slip.corrected(contest.space.model, contest.measurement)
    space = dataclasses.replace(contest.space, model=model)
    return _Change(slip, dataclasses.replace(contest, space=space, measurement=measurement), odds)


def _screened(
    change: _Change,
    noise: Noise,
    own: Alternative | None = None,
    *,
    also: Collection[str] = (),
    start: Float[np.ndarray, "param"] | None = None,
    manner: Manner = QUICK,
    hopeless: float = math.inf,
) -> _Screened:
    """All linear effects at once, from a ``start`` or where the model has them. **Arguments:** ``own``: an answer whose
    forces that depend on motion, and sweep, are fitted too; ``also``: further effects; ``manner`` of the descent;
    ``hopeless``: cost with which it does not go on.
    """
    contest = change.contest
    start, free = contest.space.given_unknowns() if start is None else start, _linear(contest)
    free = free | contest.only_of(also)
    if own is not None:
        dear = contest.only_of(own.selection.present & _dear(contest))
        best = own.selection.known[own.selection.present].best
        start, free = np.where(dear, best.point, start), free | dear
    data, budget = contest.data(noise, start), contest.budget
    training, starts = contest.training[None], starts_at(start[None])
    (end,) = descend(contest.space, data, starts, free, training, budget=budget, manner=manner, hopeless=hopeless)
    return _Screened(change, end)


def _linear(contest: Contest) -> Bool[np.ndarray, "param"]:
    return contest.free(frozenset(contest.candidates) - _dear(contest))


def _dear(contest: Contest) -> Effects:
    """Effects that are fitted beside a change only where the answer has them: forces that depend on motion, and a
    sweep.
    """
    return contest.timed | _sweeps(contest)


def _sweeps(contest: Contest) -> set[str]:
    """Those that may be missing by which the speed changes."""
    changing = {e.name for e in contest.space.model.effects if isinstance(e, SweepEffect)}
    return changing.intersection(contest.candidates)


def _differs(one: _Screened, other: _Screened) -> bool:
    """Whether a change makes any difference to linear effects."""
    return abs(one.end.cost - other.end.cost) > SAME


def _holds(one: _Screened) -> bool:
    """Whether what the fit leaves, and the size of its values, are no more than noise and priors allow."""
    return one.end.cost < _most_held(one.change)


def _most_held(change: _Change) -> float:
    """Cost up to which a fit holds within the noise."""
    numbers = change.numbers
    return 0.5 * (numbers + FITS * math.sqrt(2.0 * numbers))


def _may_hold(one: _Screened) -> bool:
    """Whether some of the effects of a fit may hold within the noise by themselves."""
    numbers = one.change.numbers
    return bool(2.0 * one.end.data_cost < LARGEST_HEALTHY_CHI2 * numbers + FITS * math.sqrt(2.0 * numbers))


def _alternative(slip: Slip | None, selection: Selection, odds: float = 0.0) -> Alternative:
    contest, contender = selection.contest, selection.known[selection.present]
    noise = Noise(contest.misfit_left(contender), contest.floor.scatter)
    return Alternative(slip, selection, score(contest, contender, noise) + odds, noise.allowance)
