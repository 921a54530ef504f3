"""Whether something was written down wrongly: changes of what rig file and table state, in the race with effects.

For each change all effects are fitted at once but those that cost many times as much: nonlinear forces, and
a sweep. No set of them can do better, so that what misses by more than the best answer known need not be searched; what
may come near is searched as the original is. Where they do not hold within the noise with what is stated, no set of
them is tried under that noise before a nonlinear force holds.
"""

import dataclasses
import math
from collections.abc import Collection, Mapping
from typing import NamedTuple, get_args

from rotorjax.data.declarations import log_odds, mistakes, promising
from rotorjax.data.odd_runs import odd_runs
from rotorjax.data.wrong_readings import WRONG
from rotorjax.discovery.answers import (
    Answer,
    Doubts,
    MistakeRace,
    like_a_mistake,
    misses,
    near_changes,
    searched,
    with_near,
)
from rotorjax.discovery.common_noise import under_table_noise
from rotorjax.discovery.contest import Contest
from rotorjax.discovery.doubtful_readings import doubtful_readings
from rotorjax.discovery.nearest_changes import of_what_fails
from rotorjax.discovery.progress import Progress
from rotorjax.discovery.scattered_runs import with_scatter
from rotorjax.discovery.screening import FAR_LESS, Change, Screened, as_stated, screen
from rotorjax.discovery.search import NOTHING, SearchStart, begin, select, wide_noise, with_set
from rotorjax.discovery.sets_that_hold import beside_linear
from rotorjax.discovery.ties import settled
from rotorjax.inference.descent import Start
from rotorjax.inference.noise import Noise
from rotorjax.model.contract import Effect, Family

OF_WHAT_IS_STATED = 0.6
"""Share of the linearisations left for what is stated where the rotor may have another weight, or the noise is unknown.
"""


def race_of_mistakes(
    contest: Contest,
    kinds: Collection[str],
    most: int,
    catalog: Mapping[str, type[Effect]],
    progress: Progress,
    *,
    always: bool,
) -> MistakeRace:
    """Race what is stated against every change of it that the data do not rule out, each with the effects beside it.

    **Arguments:** ``kinds`` of changes that may be; ``most`` effects at most, of the ``catalog``; ``always``: also
    where what is stated leads to an answer that holds and is not `like_a_mistake`: with such an answer only changes
    are searched with which linear effects do as well, and changes of the weight that its forces feel. **Returns** what
    is stated alone where nothing comes near it.
    """
    before = contest.budget.spent
    stated_changes = _changes(contest, kinds)
    of_readings = _odds_of_readings(stated_changes) if WRONG in kinds and contest.measurement.rms > 0.0 else 0.0
    beginning = _begun(contest, stated_changes, of_readings, most, progress)
    begun, stated = beginning.search, beginning.stated
    if beginning.scattered is not None:
        own = _search_as_stated(begin(beginning.scattered), None, most, progress, endless=False)
        if not misses(own):
            return MistakeRace((own,))
    if not (beginning.changes or of_readings):
        return MistakeRace((_search_as_stated(begun, stated, most, progress, endless=False),), tried=False)
    doubts = Doubts(
        contest, beginning.changes, beginning.screened, stated, most, always, progress, of_readings=of_readings
    )
    found = None
    if beginning.ahead:
        found, doubts = _without_what_is_stated(begun, stated, beginning.ahead, doubts)
        if found and found.best.mistake is not None:
            return found
    endless = beginning.endless
    own = found.best if found else _search_as_stated(begun, stated, most, progress, endless=endless)
    raced = _doubted(own, doubts, catalog, contest.budget.spent - before)
    return raced.with_others(found) if found else raced


def _doubted(own: Answer, doubts: Doubts, catalog: Mapping[str, type[Effect]], spent: int) -> MistakeRace:
    """An answer beside what is stated, or what ties with it and does better, raced against changes. **Arguments:**
    ``spent``: linearisations on the answer, as many as each change may have where it holds.
    """
    budget, progress = doubts.contest.budget, doubts.progress
    share, before = math.inf if misses(own) else spent, budget.spent - spent
    own = own if doubts.always or misses(own) else _with_its_ties(own, catalog, progress)
    raced = doubts.race(own, share)
    if raced.best.mistake is not None or not misses(raced.best):
        return raced
    # What does as well as an answer that misses may hold, and is doubted as such then.
    own = _with_its_ties(raced.best, catalog, progress)
    if misses(own):
        return raced._replace(ranked=(own, *raced.ranked[1:]))
    return doubts.race(own, budget.spent - before)


def _changes(contest: Contest, kinds: Collection[str]) -> list[Change]:
    """Of some kinds, as far as the data do not rule them out."""
    model, measurement = contest.space.model, contest.measurement
    every = mistakes(model, measurement, kinds) if measurement.rms > 0.0 and kinds else []
    if every:
        every += [one for one in odd_runs(model, measurement, kinds) if one.kind in model or not one.uncertain]
    if not every:
        return []
    odds = log_odds(every, 1.0 / len(get_args(Family)))
    return [Change.of(contest, one, odds[one.name]) for one in promising(model, measurement, every)]


class _Beginning(NamedTuple):
    """What is stated and changes of it before any of them is searched."""

    search: SearchStart
    """Beside what is stated, begun."""
    changes: list[Change]
    stated: Screened | None = None
    """All linear effects beside what is stated, where the noise is known."""
    screened: list[Screened] = []  # noqa: RUF012
    """The same beside changes, where neither what is stated nor one effect by itself holds, nor a force with linear
    effects.
    """
    ahead: list[Screened] = []  # noqa: RUF012
    """Those that leave far less, as in `of_what_fails`, or changes of the rotor's weight."""
    scattered: Contest | None = None
    """What is stated, with a scatter between three runs, where nothing else holds."""

    @property
    def endless(self) -> bool:
        """Whether nonlinear forces may make up for something wrong without end: for another weight, for readings, or
        where the noise is unknown.
        """
        doubtful = any(one.of_weight for one in self.changes) and bool(self.screened)
        return doubtful or self.stated is None or any(one.of_readings for one in self.changes)


def _begun(contest: Contest, changes: list[Change], of_readings: float, most: int, progress: Progress) -> _Beginning:
    """What is stated, begun, and what changes leave where it does not hold. **Arguments:** ``of_readings``: prior odds
    that some are wrong; zero if they may not be.
    """
    if contest.measurement.sigma is None:
        return _begun_without_noise(contest, changes, of_readings, progress)
    stated = as_stated(contest)
    begun = begin(dataclasses.replace(contest, linear_may_hold=stated.may_hold), progress=progress)
    if stated.holds or begun.holds:
        return _Beginning(begun, changes, stated)
    weights = [Screened(one, stated.end) for one in changes if one.of_weight]
    if ahead := _ahead_with_a_force(begun, weights, progress):
        return _Beginning(begun, changes, stated, ahead=ahead)
    begun = with_set(with_set(begun, most, {stated.beside: stated.end}) if stated.may_hold else begun, most)
    if begun.holds:
        return _Beginning(begun, changes, stated)
    if ahead := _ahead_with_a_pair(weights, most):
        return _Beginning(begun, changes, stated, ahead=ahead)
    level = screen(stated.change, wide_noise(contest.measurement))
    if of_readings > 0.0:
        progress("whether single readings are wrong")
        changes = [*changes, *doubtful_readings(level, of_readings)]
    if changes:
        progress("whether an entry of rig file or table is wrong")
    better, screened, ahead = of_what_fails(stated, level, changes)
    if better.may_hold and not stated.may_hold:
        known = {**begun.known, **begun.quiet_race.contenders}
        begun = begin(dataclasses.replace(contest, linear_may_hold=True), known=known, progress=progress)
    scattered = None if any(one.holds for one in screened) else with_scatter(level)
    return _Beginning(begun, changes, better, screened, ahead, scattered)


def _begun_without_noise(contest: Contest, changes: list[Change], of_readings: float, progress: Progress) -> _Beginning:
    """The same where the noise is unknown."""
    begun = begin(contest, progress=progress)
    if of_readings == 0.0 and not any(one.of_part for one in changes):
        return _Beginning(begun, changes)
    level = screen(Change(None, contest), wide_noise(contest.measurement))
    changes = [*changes, *(doubtful_readings(level, of_readings) if of_readings > 0.0 else [])]
    return _Beginning(begun, changes, ahead=_ahead_of(level, changes))


def _ahead_of(level: Screened, changes: list[Change]) -> list[Screened]:
    """What may be other in one run, or in single readings, without which linear effects leave far less than with what
    is stated, the nearest first; of an unknown noise. **Arguments:** ``level``: what is stated under a wide noise.
    """
    noise = wide_noise(level.change.contest.measurement)
    fitted = [screen(one, noise) for one in changes if one.of_part]
    return sorted((one for one in fitted if one.end.cost < FAR_LESS * level.end.cost), key=lambda one: one.cost)


def _odds_of_readings(changes: list[Change]) -> float:
    """Prior odds that readings are wrong: those of one kind of mistake among all."""
    kinds = {one.mistake.kind for one in changes if one.mistake is not None}
    return 1.0 / len(get_args(Family)) / (1 + len(kinds))


def _ahead_with_a_force(begun: SearchStart, weights: list[Screened], progress: Progress) -> list[Screened]:
    """Changes of the rotor's weight, the most probable first, if one holds within the noise of the table beside a
    nonlinear force where no effect does beside what is stated; else none.

    Looked at before a second effect is, and before any misfit is allowed for: beside a wrong weight forces are added
    without end.
    """
    forces = [frozenset({name}) for name in begun.contest.candidates if name in begun.contest.coupled]
    if not weights or not forces:
        return []
    progress("whether the weight of the rotor is stated wrongly")
    ahead, held = list[tuple[float, Screened]](), False
    for one in weights:
        own = dataclasses.replace(one.change.contest, linear_may_hold=False)
        quiet_race = under_table_noise(own, forces, {NOTHING: begun.known[NOTHING]})
        held = held or quiet_race.leader is not None
        best = max(own.log_posterior(contender) for contender in quiet_race.contenders.values())
        known = one.change._replace(known=quiet_race.contenders)
        ahead.append((best + one.change.log_odds, one._replace(change=known)))
    return [one for _, one in sorted(ahead, key=lambda scored: -scored[0])] if held else []


def _ahead_with_a_pair(weights: list[Screened], most: int) -> list[Screened]:
    """Changes of the rotor's weight beside which a nonlinear force and a linear effect hold within the noise of the
    table, where no such set does beside what is stated; the most probable first.
    """
    ahead = list[tuple[float, Screened]]()
    for one in weights:
        quiet = dataclasses.replace(one.change.contest, linear_may_hold=False)
        begun = begin(quiet, known=one.change.known)
        if not begun.holds:
            begun = with_set(begun, min(most, 2), beside_linear(begun.contest, exciting=False))
        if begun.found:
            best = begun.contest.log_posterior(begun.known[begun.found])
            ahead.append((best + one.change.log_odds, one._replace(change=one.change._replace(known=begun.known))))
    return [one for _, one in sorted(ahead, key=lambda scored: -scored[0])]


def _search_as_stated(
    begun: SearchStart, stated: Screened | None, most: int, progress: Progress, *, endless: bool
) -> Answer:
    """What is stated, searched: where all linear effects at once hold, from a pair of
    them that does, if there is one; else effect by effect, and where that leads to no answer that holds, from more of
    them that do. **Arguments:** ``stated``: the fit of all; ``endless``: whether nonlinear forces may make
    up for something wrong without end, as for another weight, or where the noise is unknown, so that two fifths of the
    linearisations are left.
    """
    budget = begun.contest.budget
    with budget.share(OF_WHAT_IS_STATED * budget.left if endless else math.inf):
        linear = None if stated is None or not stated.holds else {stated.beside: stated.end}
        few = begun if linear is None else with_set(begun, most, linear)
        own = Answer.of(None, select(few, most, progress=progress))
        return own._replace(cut_off=endless and budget.exhausted)


def _with_its_ties(own: Answer, catalog: Mapping[str, type[Effect]], progress: Progress) -> Answer:
    """An answer, or what ties with it and turns out more probable, looked at where it misses or is `like_a_mistake`:
    what holds, or does so without an effect of the measuring chain, may come to light only there.
    """
    if own.selection.contest.budget.exhausted or not (misses(own) or like_a_mistake(own)):
        return own
    progress("what else would do as well")
    selection, ties = settled(own.selection, catalog)
    return Answer.of(None, selection, cut_off=own.cut_off)._replace(ties=ties)


def _without_what_is_stated(
    begun: SearchStart, stated: Screened | None, ahead: list[Screened], doubts: Doubts
) -> tuple[MistakeRace | None, Doubts]:
    """Changes with which effects leave far less than with what is stated, or hold within the noise where they do not:
    if one of them leads to an answer that holds, what is stated is searched last, with as many linearisations, for a
    nonlinear force may hold. **Arguments:** ``begun``: the search beside what is stated; ``ahead``: those
    changes; ``doubts``: all, another of which may do as well beside the forces of that answer. **Returns** nothing
    where none does within half of the linearisations left; and the doubts, with the answer of the nearest if it misses.
    """
    budget, most, progress = doubts.contest.budget, doubts.most, doubts.progress
    nearest = ahead[0]
    others = [one for one in doubts.screened or ahead if one.change.mistake != nearest.change.mistake]
    before = budget.spent
    with budget.share(budget.left / 2):
        first = searched(nearest, most, progress)
    if first is None or misses(first):
        return None, doubts if first is None or first.cut_off else doubts._replace(missed=first)
    took, noise = budget.spent - before, Noise(first.misfit)
    if stated is None:
        others = [screen(one.change, noise, starts=[Start.at(one.end)]) for one in others]
        stated = screen(Change(None, begun.contest), noise)
    found, cut_off = with_near(first, near_changes(first, stated, others, noise), noise, most, progress)
    with budget.share(took):
        own = Answer.of(None, select(begun, most, progress=progress), cut_off=budget.exhausted)
    return doubts.ranked([*found, own], cut_off), doubts
