"""Answers beside what is stated and beside changes of it, and how an answer is raced against changes that may do as
well.
"""

import functools
import math
from typing import NamedTuple

import numpy as np

from rotorjax.data.declarations import Mistake
from rotorjax.data.odd_runs import is_same_run
from rotorjax.discovery.contest import Contest
from rotorjax.discovery.doubtful_readings import doubtful_beside
from rotorjax.discovery.nearest_changes import in_order
from rotorjax.discovery.odd_run import with_values
from rotorjax.discovery.progress import Progress
from rotorjax.discovery.race import Scored, race, score
from rotorjax.discovery.rivals import TIE
from rotorjax.discovery.screening import FAR_LESS, HALVED, Change, Screened, beside_answer, beside_forces_of, screen
from rotorjax.discovery.search import Selection, begin, select, with_answer, with_set
from rotorjax.discovery.ties import Ties, noise_left
from rotorjax.inference.descent import HOPELESS
from rotorjax.inference.noise import LARGEST_HEALTHY_CHI2, Noise, is_large

MOST_SEARCHED = 3
"""Changes that are searched where no answer holds."""
SLIGHT = math.sqrt(0.5 * (LARGEST_HEALTHY_CHI2 - 1.0))
"""What runs may scatter by chance, in the noise of a vector: more makes a fit unhealthy."""
FOR_ONE_SET = 10_000
"""Of the linearisations reserved, what the effects of the best may take beside what is stated."""


class Answer(NamedTuple):
    """What is stated, or a change of it, with the best effects beside."""

    mistake: Mistake | None
    selection: Selection
    log_odds: float
    """Of the change beforehand."""
    scored: Scored
    """Marginal likelihood and prior odds."""
    misfit: float
    """Allowance for misfit that it needs [m]."""
    cut_off: bool
    """Whether its search was ended by a share of the linearisations."""
    ties: Ties | None = None
    """What ties with it, where that was looked at."""

    @classmethod
    def of(
        cls, mistake: Mistake | None, selection: Selection, log_odds: float = 0.0, *, cut_off: bool = False
    ) -> "Answer":
        """What a search came to."""
        contest, noise = selection.contest, noise_left(selection)
        own = score(contest, selection.known[selection.present], noise)
        own = own._replace(prior=own.prior + log_odds)
        return cls(mistake, selection, log_odds, own, noise.allowance, cut_off)

    def with_values(self) -> "Answer":
        """With the values of what is other in one run, if that is the mistake."""
        if self.mistake is None:
            return self
        contender = self.selection.known[self.selection.present]
        return self._replace(mistake=with_values(self.mistake, self.selection.contest, contender))

    def lead(self, other: "Answer") -> float:
        """Log odds against another answer."""
        return self.scored.lead(other.scored)

    def is_alike(self, other: "Answer") -> bool:
        """Whether another is about the same run, with the same effects beside, and the data are as likely with it."""
        if self.mistake is None or other.mistake is None or not is_same_run(self.mistake, other.mistake):
            return False
        alike = other.selection.present == self.selection.present
        return alike and other.scored.likelihood > self.scored.likelihood - TIE

    def finished(self, most: int, progress: Progress) -> "Answer":
        """Its search to the end, with ``most`` effects at most."""
        again = begin(self.selection.contest, known=self.selection.known, progress=progress)
        return Answer.of(self.mistake, select(again, most, progress=progress), self.log_odds)

    @property
    def named(self) -> tuple[str, ...]:
        """What was changed, then the effects."""
        return (*([] if self.mistake is None else [self.mistake.name]), *self.selection.effects)


def _order(one: Answer, other: Answer) -> int:
    lead = one.lead(other)
    return (lead > 0.0) - (lead < 0.0)


LEAD = functools.cmp_to_key(_order)
"""By which the more probable of two answers is greater."""


class MistakeRace(NamedTuple):
    """Answers beside what is stated and changes of it, the most probable first."""

    ranked: tuple[Answer, ...]
    tried: bool = True
    """Whether changes of what is stated took part."""
    cut_off: tuple[Mistake, ...] = ()
    """Those that were not searched to the end, as the linearisations allowed for them were spent."""
    left_out: bool = False
    """Whether the linearisations ran out before changes that may do as well as the answer were searched."""

    def with_others(self, found: "MistakeRace") -> "MistakeRace":
        """With what an earlier race found beside changes that this one did not search, or did not search to the end."""
        known = {one.mistake for one in self.ranked}
        others = [one for one in found.ranked if one.mistake not in known]
        cut_off = [one for one in (*self.cut_off, *found.cut_off) if one != self.best.mistake]
        ranked = sorted([*self.ranked, *others], key=LEAD, reverse=True)
        return self._replace(ranked=tuple(ranked), cut_off=tuple(dict.fromkeys(cut_off)))

    @property
    def best(self) -> Answer:
        """The most probable."""
        return self.ranked[0]

    @property
    def odds(self) -> tuple[float, ...]:
        """Of each of the others against the most probable."""
        return tuple(math.exp(min(700.0, -self.best.lead(other))) for other in self.ranked[1:])

    @property
    def tied(self) -> tuple[Answer, ...]:
        """Those within 3 log units of it, and those about the same run with which the data are as likely."""
        return tuple(other for other in self.ranked[1:] if self.best.lead(other) < TIE or self.best.is_alike(other))


def misses(own: Answer) -> bool:
    """Whether an answer leaves more than the noise, or more than noise would be where that is unknown. Beside a change
    of what is stated noise may be a little more than the table says, as it is by chance.
    """
    contest = own.selection.contest
    if contest.measurement.noise_rms is None:
        return is_large(own.misfit, contest.measurement)
    slight = SLIGHT * contest.measurement.noise_rms
    least = min(slight, contest.floor.allowance) if own.mistake is not None else 0.0
    return own.misfit > least


def like_a_mistake(own: Answer) -> bool:
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


def _has_a_force(own: Answer) -> bool:
    """Whether a nonlinear force is in an answer: what the weight does through it nothing else shows."""
    return bool(own.selection.present & own.selection.contest.costly)


def _feels_the_weight(own: Answer) -> bool:
    """Whether a nonlinear force is in an answer, or the sag was measured: another effect may stand for what the weight
    does not do as stated.
    """
    return _has_a_force(own) or 0.0 in own.selection.contest.measurement.orders


class _Reach(NamedTuple):
    """What changes must come to that may do as well as an answer, under one noise."""

    least: float
    """Log evidence and prior odds."""
    share: float
    """Of the cost of the data that counts."""

    @classmethod
    def of(cls, answer: Answer, noise: Noise) -> "_Reach":
        """Of an answer."""
        selection = answer.selection
        own = score(selection.contest, selection.known[selection.present], noise, normalised=False)
        return cls(own.log_posterior - TIE, own.share)

    @property
    def hopeless(self) -> float:
        """Cost of a change from which on it cannot do as well."""
        return -self.least / self.share

    def holds(self, one: Screened) -> bool:
        """Whether a change may do as well."""
        return -one.counting(self.share) > self.least


class Doubts(NamedTuple):
    """Changes that an answer beside what is stated is raced against."""

    contest: Contest
    """Beside what is stated."""
    changes: list[Change]
    screened: list[Screened]
    """The changes with all linear effects, where they were fitted already."""
    stated: Screened | None
    most: int
    always: bool
    progress: Progress
    missed: Answer | None = None
    """Beside a change that was searched before, and misses."""
    of_readings: float = 0.0
    """Prior odds that readings are wrong, if they may be."""

    def race(self, own: Answer, share: float | int) -> MistakeRace:
        """An answer, and changes near it. **Arguments:** ``share``: linearisations for each change."""
        contest, screened = own.selection.contest, self.screened
        doubtful = self.always or misses(own) or like_a_mistake(own)
        of_weight = [one for one in self.changes if one.of_weight and _feels_the_weight(own)]
        doubted = self.changes if doubtful else of_weight
        readings = self.of_readings > 0.0 and misses(own)
        if contest.budget.exhausted or not (doubted or screened or readings):
            return self.ranked([own], ())._replace(tried=bool(screened), left_out=bool(doubted or screened or readings))
        noise = Noise(own.misfit if contest.measurement.sigma is None else 0.0)
        stated = self.stated or screen(Change(None, contest), noise)
        if not screened:
            self.progress("whether an entry of rig file or table is wrong")
            hopeless = _Reach.of(own, noise).hopeless
            answer = own.selection.known[own.selection.present]
            screened = in_order(doubted, noise, starts=lambda one: one.near(answer.best), hopeless=hopeless)
        elif _has_a_force(own):
            # What linear effects leave beside a change says little of what they leave with a nonlinear force.
            known = {one.change.mistake for one in screened}
            screened = [*screened, *(Screened(one, stated.end) for one in doubted if one.mistake not in known)]
        near = near_changes(own, stated, screened, noise, beside_forces=doubtful)
        if misses(own) and (_has_a_force(own) or all(one.end.cost > FAR_LESS * stated.end.cost for one in near)):
            near = self._beside_its_forces(own, noise, near)
        if readings and not any(one.change.of_readings for one in near):
            answer = own.selection.known[own.selection.present]
            near = [*doubtful_beside(own.selection.contest, answer, self.of_readings), *near]
        if own.cut_off:
            share = contest.budget.left / max(1, len(near))
        found = with_near(own, near, noise, self.most, self.progress, share=share, missed=self.missed)
        return self.ranked(*found)

    def _beside_its_forces(self, own: Answer, noise: Noise, near: list[Screened]) -> list[Screened]:
        """Changes near an answer that misses, those first that are beside its nonlinear forces."""
        contest, answer = own.selection.contest, own.selection.known[own.selection.present]
        found = beside_forces_of(answer, contest, self.changes, noise)
        others = [one for one in near if all(one.change.mistake != other.change.mistake for other in found)]
        return [*found, *others][:MOST_SEARCHED]

    def ranked(self, found: list[Answer], cut_off: tuple[Mistake, ...]) -> MistakeRace:
        """What was found, the search of the best finished if it was cut off; with the effects of the best change beside
        what is stated.
        """
        leader = max(found, key=LEAD)
        if leader.cut_off and not self.contest.budget.exhausted:
            found = [one.finished(self.most, self.progress) if one is leader else one for one in found]
        best, *others = sorted([*found, *_as_stated_too(found)], key=LEAD, reverse=True)
        best = best._replace(selection=best.selection.among(self.contest.candidates))
        return MistakeRace((best, *others), cut_off=tuple(mistake for mistake in cut_off if mistake != best.mistake))


def with_near(
    first: Answer,
    near: list[Screened],
    noise: Noise,
    most: int,
    progress: Progress,
    *,
    share: float | int = math.inf,
    missed: Answer | None = None,
) -> tuple[list[Answer], tuple[Mistake, ...]]:
    """An answer, and changes searched, the nearest first, until the next is out of reach of what was found; and those
    that were cut off. **Arguments:** ``share``: linearisations for each of them; ``missed``: what one of them came to
    before, not searched again where the answer misses, too.
    """
    found, cut_off, holds = [first], list[Mistake](), first.misfit <= noise.allowance
    reaches = [_Reach.of(first, noise)]
    for one in near:
        budget = one.change.contest.budget
        if holds and not all(reach.holds(one) for reach in reaches):
            break
        if budget.exhausted:
            cut_off += [one.change.mistake] if one.change.mistake is not None else []
            continue
        before = budget.spent
        with budget.share(share):
            again = holds or missed is None or missed.mistake != one.change.mistake
            other = searched(one, most, progress, holds=holds) if again else missed
            if budget.exhausted and one.change.mistake is not None:
                cut_off.append(one.change.mistake)
        if other is None:
            continue
        # Of an unknown noise each has its own, and the score counts it.
        if noise.allowance > 0.0 or other.misfit == 0.0 or other.misfit < HALVED * first.misfit:
            if again and all(other.lead(answer) > 0.0 for answer in found):
                share = min(share, budget.spent - before)
            found.append(other)
            reaches.append(_Reach.of(other, noise))
    return found, tuple(cut_off)


def _as_stated_too(found: list[Answer]) -> list[Answer]:
    """The effects of the best, if that is a change, beside what is stated: their search may have gone another way, and
    they may do as well without the change.
    """
    best = max(found, key=LEAD)
    effects, own = best.selection.present, next(one.selection for one in found if one.mistake is None)
    if best.mistake is None or effects == own.present:
        return []
    answer = best.selection.known[effects]
    near, reach = answer._replace(foreseen=True), answer.best.cost + HOPELESS
    with own.contest.budget.ahead(FOR_ONE_SET):
        fitted = race(own.contest, answer.noise, [effects], {**own.known, effects: near}, hopeless=reach)
    there = fitted[effects]
    if not there.balanced:
        return []
    likely = score(own.contest, there, answer.noise)
    if best.scored.lead(likely) > TIE:
        return []
    return [Answer(None, with_answer(own, effects, fitted), 0.0, likely, own.contest.misfit_left(there), cut_off=False)]


def searched(one: Screened, most: int, progress: Progress, *, holds: bool = False) -> Answer | None:
    """A change, begun with what holds of all linear effects beside it, if they do: among those alone where few of them
    hold. **Arguments:** ``holds``: whether an answer holds; **returns** nothing where no few effects do then.
    """
    change = one.change
    assert change.mistake is not None
    progress(f"whether {change.mistake.meaning}")
    if one.holds and not one.beside:
        linear = change.without(change.contest.costly).contest
        begun = with_set(begin(linear, known=change.known), most, {one.beside: one.end})
        if begun.holds:
            selection = select(begun, most)
            return Answer.of(change.mistake, selection, change.log_odds, cut_off=linear.budget.exhausted)
    begun = begin(change.contest, known=change.known)
    if one.may_hold:
        begun = with_set(begun, most, {one.beside: one.end})
        if holds and begun.contest.tries_table_noise and not begun.holds:
            begun = begun if one.beside else with_set(begun, min(most, 2))
            if not begun.holds:
                return None
    elif change.of_weight:
        begun = with_set(begun, min(most, 2))
    selection = select(begun, most)
    return Answer.of(change.mistake, selection, change.log_odds, cut_off=change.contest.budget.exhausted)


def near_changes(
    own: Answer, stated: Screened, screened: list[Screened], noise: Noise, *, beside_forces: bool = True
) -> list[Screened]:
    """Changes that may do as well as the answer. If that holds within the noise: those with which all linear effects,
    and its nonlinear forces, cost no more than it does with its prior; nothing else need be beside them.
    Else those that leave far less than what is stated. **Arguments:** ``beside_forces``: whether those forces count for
    all changes, or only for those of the weight, which nothing else feels.
    """
    contest, costly = own.selection.contest, own.selection.contest.costly
    answer = own.selection.known[own.selection.present]
    beside = answer.effects & costly
    if misses(own) or contest.floor.scatter != noise.scatter:
        # Where the answer misses all effects at once may do what few of them do not.
        all_hold = misses(own) and stated.holds
        likely = [one for one in screened if one.end.cost < HALVED * stated.end.cost or (all_hold and one.holds)]
        if beside:
            likely += [one for one in screened if one.change.of_weight and one not in likely]
        return sorted(likely, key=lambda one: one.cost)[:MOST_SEARCHED]
    with_forces = [one for one in screened if beside and (beside_forces or one.change.of_weight)]
    reach = _Reach.of(own, noise)
    near = [one for one in screened if one not in with_forces and reach.holds(one) and one.differs(stated)]
    found = [one.without(costly) for one in near]
    if with_forces:
        level, fitted = beside_answer(stated, with_forces, answer, contest, noise, reach.hopeless)
        near = [one for one in fitted if reach.holds(one) and one.differs(level)]
        found += [one.without(costly - beside) for one in near]
    return sorted(found, key=lambda one: one.cost)
