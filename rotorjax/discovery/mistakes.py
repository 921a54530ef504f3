"""Whether something was written down wrongly: changes of what rig file and table state, in the race with effects.

For each change all effects are fitted at once but those that cost many times as much: forces that depend on motion, and
a sweep. No set of them can do better, so that what misses by more than the best answer known need not be searched; what
may come near is searched as the original is. Where they do not hold within the noise with what is stated, no set of
them is tried under that noise before a force that depends on motion holds.
"""

import dataclasses
import math
from collections.abc import Collection, Mapping
from typing import NamedTuple, get_args

import numpy as np

from rotorjax.data.declarations import Mistake, log_odds, mistakes, promising
from rotorjax.discovery.contest import Contest
from rotorjax.discovery.progress import Progress
from rotorjax.discovery.race import exactly, race, score, share_counted
from rotorjax.discovery.rivals import TIE
from rotorjax.discovery.screening import HALVED, Change, Screened, as_stated, beside_answer, of_what_fails, screen
from rotorjax.discovery.search import NOTHING, Begun, Selection, begin, retold, select, with_set
from rotorjax.discovery.ties import noise_left, settled
from rotorjax.inference.descent import HOPELESS
from rotorjax.inference.noise import NO_NOISE, Noise, is_large
from rotorjax.model.contract import Effect, Family

MOST_SEARCHED = 3
"""Changes that are searched where no answer holds."""
OF_WHAT_IS_STATED = 0.6
"""Share of the linearisations left for what is stated where the rotor may have another weight, or the noise is unknown.
"""


class Alternative(NamedTuple):
    """What is stated, or a change of it, with the best effects beside."""

    mistake: Mistake | None
    selection: Selection
    score: float
    """Logarithm of marginal likelihood and prior odds, up to a constant."""
    misfit: float
    """Allowance for misfit that its answer needs [m]."""

    @property
    def named(self) -> tuple[str, ...]:
        """What was changed, then the effects."""
        return (*([] if self.mistake is None else [self.mistake.name]), *self.selection.effects)


class Race(NamedTuple):
    """Alternatives, the most probable first."""

    ranked: tuple[Alternative, ...]
    tried: bool = True
    """Whether changes of what is stated took part."""
    cut_off: tuple[Mistake, ...] = ()
    """Those whose search was ended, as it took as long as that for the answer."""

    @property
    def best(self) -> Alternative:
        """The answer."""
        return self.ranked[0]

    @property
    def tied(self) -> tuple[Alternative, ...]:
        """Those within 3 log units of it."""
        return tuple(other for other in self.ranked[1:] if self.best.score - other.score < TIE)


def race_of_mistakes(
    contest: Contest,
    kinds: Collection[str],
    most: int,
    catalog: Mapping[str, type[Effect]],
    progress: Progress,
    *,
    always: bool,
) -> Race:
    """Race what is stated against every change of it that the data do not rule out, each with the effects beside it.

    **Arguments:** ``kinds`` of changes that may be; ``most`` effects at most, of the ``catalog``; ``always``: also
    where what is stated leads to an answer that holds and is not `_like_a_mistake`: with such an answer only changes
    are searched with which linear effects do as well, and changes of the weight that its forces feel. **Returns** what
    is stated alone where nothing comes near it.
    """
    changes = _changes(contest, kinds)
    before = contest.budget.spent
    begun, stated, screened, ahead = _screened(contest, changes, most, progress)
    if not changes:
        return Race((_search_as_stated(begun, stated, most, progress, endless=False)[0],), tried=False)
    weights = [one for one in screened if one.change.of_weight]
    if stated and (found := _without_what_is_stated(begun, stated, ahead, screened, most, progress)):
        return found
    endless = bool(weights) or contest.measurement.sigma is None
    own, unfinished = _search_as_stated(begun, stated, most, progress, endless=endless)
    share = math.inf if _misses(own) else contest.budget.spent - before
    own = own if always else _with_its_ties(own, catalog, progress)
    doubtful = always or _misses(own) or _like_a_mistake(own)
    doubted = changes if doubtful else [one for one in changes if one.of_weight and _feels_the_weight(own)]
    if contest.budget.exhausted or not (doubted or screened):
        return Race((own,), tried=bool(screened))
    noise = Noise(own.misfit if contest.measurement.sigma is None else 0.0)
    stated = stated or screen(Change(None, contest), noise)
    if not screened:
        progress("whether something was written down wrongly")
        hopeless = _Reach.of(own, noise).hopeless
        screened = [screen(change, noise, hopeless=hopeless) for change in doubted]
    near = _near(own, stated, screened, noise, beside_forces=doubtful)
    if unfinished:
        share = contest.budget.left / max(1, len(near))
    found, cut_off = _with_near(own, near, noise, most, progress, share=share)
    if unfinished and max(found, key=lambda one: one.score) is own:
        again = begin(contest, known=own.selection.known, progress=progress)
        found[0] = _alternative(None, select(again, most, progress=progress))
    return _ranked(found, cut_off)


def _changes(contest: Contest, kinds: Collection[str]) -> list[Change]:
    """Of some kinds, as far as the data do not rule them out."""
    model, measurement = contest.space.model, contest.measurement
    every = mistakes(model, measurement, kinds) if measurement.rms > 0.0 and kinds else []
    if not every:
        return []
    odds = log_odds(every, 1.0 / len(get_args(Family)))
    return [Change.of(contest, one, odds[one.name]) for one in promising(model, measurement, every)]


def _screened(
    contest: Contest, changes: list[Change], most: int, progress: Progress
) -> tuple[Begun, Screened | None, list[Screened], list[Screened]]:
    """The search beside what is stated, begun; all linear effects beside that, where the noise is known; and as in
    `of_what_fails` where neither they nor one effect by itself hold, nor a force with linear effects; or changes of
    the rotor's weight ahead.
    """
    if contest.measurement.sigma is None:
        return begin(contest, progress=progress), None, [], []
    stated = as_stated(contest)
    begun = begin(dataclasses.replace(contest, linear_may_hold=stated.may_hold), progress=progress)
    if stated.holds or begun.holds:
        return begun, stated, [], []
    if ahead := _ahead_with_a_force(begun, [Screened(one, stated.end) for one in changes if one.of_weight], progress):
        return begun, stated, [], ahead
    begun = begun if stated.may_hold else with_set(begun, most)
    if begun.holds:
        return begun, stated, [], []
    if changes:
        progress("whether something was written down wrongly")
    better, screened, ahead = of_what_fails(stated, changes)
    if better.may_hold and not stated.may_hold:
        begun = begin(dataclasses.replace(contest, linear_may_hold=True), progress=progress)
    return begun, better, screened, ahead


def _ahead_with_a_force(begun: Begun, weights: list[Screened], progress: Progress) -> list[Screened]:
    """Changes of the rotor's weight, the most probable first, if one holds within the noise of the table beside a force
    that depends on motion where no effect does beside what is stated; else none.

    Looked at before a second effect is, and before any misfit is allowed for: beside a wrong weight forces are added
    without end.
    """
    forces = [frozenset({name}) for name in begun.contest.candidates if name in begun.contest.timed]
    if not weights or not forces:
        return []
    progress("whether the weight of the rotor was written down wrongly")
    ahead, held = list[tuple[float, Screened]](), False
    for one in weights:
        own = dataclasses.replace(one.change.contest, linear_may_hold=False)
        exact = exactly(own, forces, {NOTHING: begun.known[NOTHING]})
        held = held or exact.leader is not None
        best = max(own.log_posterior(contender) for contender in exact.contenders.values())
        known = one.change._replace(known=exact.contenders)
        ahead.append((best + one.change.log_odds, one._replace(change=known)))
    return [one for _, one in sorted(ahead, key=lambda scored: -scored[0])] if held else []


def _search_as_stated(
    begun: Begun, stated: Screened | None, most: int, progress: Progress, *, endless: bool
) -> tuple[Alternative, bool]:
    """What is stated, searched, and whether that is unfinished: where all linear effects at once hold, from a pair of
    them that does, if there is one; else effect by effect, and where that leads to no answer that holds, from more of
    them that do. **Arguments:** ``stated``: the fit of all; ``endless``: whether forces that depend on motion may make
    up for something wrong without end, as for another weight, or where the noise is unknown, so that two fifths of the
    linearisations are left.
    """
    budget = begun.contest.budget
    with budget.share(OF_WHAT_IS_STATED * budget.left if endless else math.inf):
        linear = None if stated is None or not stated.holds else {stated.beside: stated.end}
        pair = begun if linear is None else with_set(begun, min(most, 2), linear)
        own = _alternative(None, select(pair, most, progress=progress))
        if linear is not None and _misses(own):
            together = with_set(begun, most, linear)
            own = _alternative(None, select(together, most, progress=progress)) if together.holds else own
        return own, endless and budget.exhausted


def _with_its_ties(own: Alternative, catalog: Mapping[str, type[Effect]], progress: Progress) -> Alternative:
    """An answer, or what ties with it and turns out more probable, looked at where it holds and is `_like_a_mistake`:
    what holds without an effect of the measuring chain may come to light only there.
    """
    if own.selection.contest.budget.exhausted or _misses(own) or not _like_a_mistake(own):
        return own
    progress("what else would do as well")
    return _alternative(None, settled(own.selection, catalog)[0])


def _misses(own: Alternative) -> bool:
    """Whether an answer leaves more than the noise, or more than noise would be where that is unknown."""
    measurement = own.selection.contest.measurement
    return own.misfit > 0.0 if measurement.sigma is not None else is_large(own.misfit, measurement)


def _like_a_mistake(own: Alternative) -> bool:
    """Whether an effect of the measuring chain is in an answer, one of what is installed in a plane or, where nothing
    else is installed in any other run, an excitation: what they do, a mistake may do as well.
    """
    contest = own.selection.contest
    installed = np.asarray(contest.measurement.conditions.unbalance)
    families = {"reading", "excitation"} if np.all(installed == installed[:1]) else {"reading"}
    return any(
        e.family in families or any("plane" in p.axes for p in e.parameters())
        for e in contest.space.model.effects
        if e.name in own.selection.present
    )


def _feels_the_weight(own: Alternative) -> bool:
    """Whether a force that depends on motion is in an answer: what the weight does through it nothing else shows, and
    another effect may stand for what the weight does not do as stated.
    """
    return bool(own.selection.present & own.selection.contest.dear)


class _Reach(NamedTuple):
    """What changes must come to that may do as well as an answer, under one noise."""

    least: float
    """Log evidence and prior odds."""
    share: float
    """Of the cost of the data that counts."""

    @classmethod
    def of(cls, answer: Alternative, noise: Noise) -> "_Reach":
        """Of an answer."""
        selection = answer.selection
        own = score(selection.contest, selection.known[selection.present], noise, normalised=False)
        return cls(own - TIE, share_counted(selection.contest, noise))

    @property
    def hopeless(self) -> float:
        """Cost of a change from which on it cannot do as well."""
        return -self.least / self.share

    def holds(self, one: Screened) -> bool:
        """Whether a change may do as well."""
        return -one.counting(self.share) > self.least


def _without_what_is_stated(
    begun: Begun, stated: Screened, ahead: list[Screened], screened: list[Screened], most: int, progress: Progress
) -> Race | None:
    """Changes with which effects leave far less than with what is stated, or hold within the noise where they do not:
    if one of them leads to an answer that holds, what is stated is searched last, with as many linearisations, for a
    force that depends on motion may hold. **Arguments:** ``begun``: the search beside what is stated; ``ahead``: those
    changes; ``screened``: all, if they were: another may do as well beside the forces of that answer. **Returns**
    nothing where none does within half of the linearisations left.
    """
    if not ahead:
        return None
    budget = stated.change.contest.budget
    nearest = ahead[0]
    others = [one for one in screened or ahead if one.change.mistake != nearest.change.mistake]
    before = budget.spent
    with budget.share(budget.left / 2):
        first = _searched(nearest, most, progress)
    if first is None or first.misfit > 0.0:
        return None
    took = budget.spent - before
    found, cut_off = _with_near(first, _near(first, stated, others, NO_NOISE), NO_NOISE, most, progress)
    with budget.share(took):
        own = _alternative(None, select(begun, most, progress=progress))
    return _ranked([*found, own], cut_off)


def _with_near(
    first: Alternative,
    near: list[Screened],
    noise: Noise,
    most: int,
    progress: Progress,
    *,
    share: float | int = math.inf,
) -> tuple[list[Alternative], tuple[Mistake, ...]]:
    """An answer, and changes searched, the nearest first, until the next is out of reach of what was found; and those
    that were cut off. **Arguments:** ``share``: linearisations for each of them.
    """
    found, cut_off, holds = [first], list[Mistake](), first.misfit <= noise.allowance
    reaches = [_Reach.of(first, noise)]
    for one in near:
        budget = one.change.contest.budget
        if budget.exhausted or (holds and not all(reach.holds(one) for reach in reaches)):
            break
        before = budget.spent
        with budget.share(share):
            other = _searched(one, most, progress, holds=holds)
            if budget.exhausted and one.change.mistake is not None:
                cut_off.append(one.change.mistake)
        if other is None:
            continue
        # Of an unknown noise each alternative has its own, and the score counts it.
        if noise.allowance > 0.0 or other.misfit == 0.0 or other.misfit < HALVED * first.misfit:
            if other.score > max(answer.score for answer in found):
                share = min(share, budget.spent - before)
            found.append(other)
            reaches.append(_Reach.of(other, noise))
    return found, tuple(cut_off)


def _ranked(found: list[Alternative], cut_off: tuple[Mistake, ...]) -> Race:
    every = [*found, *_as_stated_too(found)]
    ranked = tuple(sorted(every, key=lambda one: -one.score))
    return Race(ranked, cut_off=tuple(mistake for mistake in cut_off if mistake != ranked[0].mistake))


def _as_stated_too(found: list[Alternative]) -> list[Alternative]:
    """The effects of the best, if that is a change, beside what is stated: their search may have gone another way, and
    they may do as well without the change.
    """
    best = max(found, key=lambda one: one.score)
    effects, own = best.selection.present, next(one.selection for one in found if one.mistake is None)
    if best.mistake is None or effects == own.present or own.contest.budget.exhausted:
        return []
    answer = best.selection.known[effects]
    near, reach = answer._replace(foreseen=True), answer.best.cost + HOPELESS
    fitted = race(own.contest, answer.noise, [effects], {**own.known, effects: near}, hopeless=reach)
    there = fitted[effects]
    likely = score(own.contest, there, answer.noise) if there.balanced else -math.inf
    if likely < best.score - TIE:
        return []
    return [Alternative(None, retold(own, effects, fitted), likely, own.contest.misfit_left(there))]


def _searched(one: Screened, most: int, progress: Progress, *, holds: bool = False) -> Alternative | None:
    """A change, begun with what holds of all linear effects beside it, if they do. **Arguments:** ``holds``: whether an
    answer holds; **returns** nothing where no set beside forces that depend on motion does then.
    """
    change = one.change
    assert change.mistake is not None
    progress(f"whether {change.mistake.meaning}")
    begun = begin(change.contest, known=change.known)
    if one.may_hold:
        begun = with_set(begun, most, {one.beside: one.end})
        if holds and one.beside and begun.contest.tried_exactly and not begun.holds:
            return None
    return _alternative(change.mistake, select(begun, most), change.log_odds)


def _near(
    own: Alternative, stated: Screened, screened: list[Screened], noise: Noise, *, beside_forces: bool = True
) -> list[Screened]:
    """Changes that may do as well as the answer. If that holds within the noise: those with which all linear effects,
    and its forces that depend on motion, cost no more than it does with its prior; nothing else need be beside them.
    Else those that leave far less than what is stated. **Arguments:** ``beside_forces``: whether those forces count for
    all changes, or only for those of the weight, which nothing else feels.
    """
    contest, costly = own.selection.contest, own.selection.contest.dear
    answer = own.selection.known[own.selection.present]
    beside = answer.effects & costly
    if _misses(own) or contest.floor.scatter != noise.scatter:
        # Where the answer misses all effects at once may do what few of them do not.
        all_hold = _misses(own) and stated.holds
        likely = [one for one in screened if one.end.cost < HALVED * stated.end.cost or (all_hold and one.holds)]
        if beside:
            likely += [one for one in screened if one.change.of_weight and one not in likely]
        return sorted(likely, key=lambda one: one.cost)[:MOST_SEARCHED]
    with_forces = [one for one in screened if beside and (beside_forces or one.change.of_weight)]
    reach = _Reach.of(own, noise)
    near = [one for one in screened if one not in with_forces and reach.holds(one) and one.differs(stated)]
    found = [one.without(costly) for one in near]
    if with_forces:
        level, fitted = beside_answer(stated, with_forces, answer, noise, reach.hopeless)
        near = [one for one in fitted if reach.holds(one) and one.differs(level)]
        found += [one.without(costly - beside) for one in near]
    return sorted(found, key=lambda one: one.cost)


def _alternative(mistake: Mistake | None, selection: Selection, odds: float = 0.0) -> Alternative:
    contest, noise = selection.contest, noise_left(selection)
    contender = selection.known[selection.present]
    return Alternative(mistake, selection, score(contest, contender, noise) + odds, noise.allowance)
