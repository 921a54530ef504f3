"""All linear effects at once beside what is stated, and beside changes of it: what no set of them can do better than.

Nonlinear forces, and a sweep, cost many times as much, and are left out.
"""

import dataclasses
import math
from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np

from rotorjax.data.declarations import OF_READING, OF_WEIGHT, Mistake
from rotorjax.data.wrong_readings import WRONG
from rotorjax.discovery.contest import FITS, Contender, Contest, Effects, Known
from rotorjax.discovery.race import race
from rotorjax.discovery.rivals import TIE
from rotorjax.discovery.search import wide_noise
from rotorjax.inference.data import largest_displacement
from rotorjax.inference.descent import HOPELESS, End, Start, best_of, descend, starts_at
from rotorjax.inference.descent_settings import MAX_STEPS, QUICK, DescentSettings
from rotorjax.inference.noise import LARGEST_HEALTHY_CHI2, NO_NOISE, Noise
from rotorjax.model.contract import WITH_AMPLITUDE

HALVED = 0.5
"""Share of the misfit, or of the cost with all linear effects, that a change must leave at most to count where it does
not hold within the noise. Without a mistake the best of 20 changes left 0.84 of the cost beside drawn nonlinear
forces; mistakes left 0.03 to 0.07.
"""
FAR_LESS = 0.1
"""The same of what concerns one run or single readings, where the noise is unknown."""
BESIDE_FORCES = QUICK._replace(most_steps=16, rescan=False)
"""The same beside nonlinear forces, as many steps as motions need to balance: before, a cost says little.
"""
GAINS = frozenset({"chain_gain", "probe_gain"})
"""Effects that stand for another amplitude of vibration."""
SAME = 1e-6
"""Difference of costs of one fit made twice."""


class Change(NamedTuple):
    """What is stated, or a change of it."""

    mistake: Mistake | None
    contest: Contest
    log_odds: float = 0.0
    known: Known | None = None
    """What was fitted beside it already."""

    @property
    def of_weight(self) -> bool:
        """Whether it changes the weight of the rotor."""
        return self.mistake is not None and self.mistake.kind in OF_WEIGHT

    @property
    def of_part(self) -> bool:
        """Whether it concerns one run, or single readings, and leaves all others as they are."""
        return self.of_readings or (self.mistake is not None and self.mistake.kind.startswith("run_"))

    @property
    def of_readings(self) -> bool:
        """Whether single readings are wrong."""
        return self.mistake is not None and self.mistake.kind == WRONG

    @classmethod
    def of(cls, contest: Contest, mistake: Mistake, odds: float) -> "Change":
        """With the model and the measurement as the change has them."""
        model, measurement = mistake.corrected(contest.space.model, contest.measurement)
        space = dataclasses.replace(contest.space, model=model).with_uncertain(mistake.uncertain)
        return cls(mistake, dataclasses.replace(contest, space=space, measurement=measurement), odds)

    def near(self, own: End) -> list[Start]:
        """Where linear effects begin beside where others ended: at what is given, and there without errors of the
        reading, as they may stand for the change.
        """
        space, given = self.contest.space, self.contest.space.given_unknowns()
        errors = space.only_of(e.name for e in space.model.effects if e.family == "reading")
        kept = np.where(errors | self.contest.only_of(self.contest.costly), given, own.point)
        return starts_at(np.stack([given, kept] if np.any(kept != given) else [given]))

    def begun_from(self, level: "Screened", own: Contender) -> list[Start]:
        """Where to begin: where all effects ended beside what is stated, and at the costly effects of an answer alone;
        but with a change of how the table is to be read at that answer without errors of the reading, as they may stand
        for the change.
        """
        space = self.contest.space
        if self.mistake is not None and self.mistake.kind in OF_READING:
            errors = space.only_of(e.name for e in space.model.effects if e.family == "reading")
            return [Start(np.where(errors, space.given_unknowns(), own.best.point))]
        costly = self.contest.only_of(own.effects & self.contest.costly)
        return starts_at(np.stack([level.end.point, np.where(costly, own.best.point, space.given_unknowns())]))

    def without(self, effects: Effects) -> "Change":
        """The same with none of these effects beside it."""
        candidates = tuple(name for name in self.contest.candidates if name not in effects)
        return self._replace(contest=dataclasses.replace(self.contest, candidates=candidates))


class Screened(NamedTuple):
    """All linear effects beside a change, fitted at once."""

    change: Change
    end: End

    @property
    def beside(self) -> Effects:
        """What else is in the fit: nonlinear forces, and a sweep."""
        contest = self.change.contest
        free = np.isin(np.arange(len(self.end.point)), self.end.free)
        return frozenset(contest.space.effects_of(free)) & contest.costly

    def without(self, effects: Effects) -> "Screened":
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

    def counting(self, share: float) -> float:
        """The same with a share of what the data cost."""
        return self.cost - (1.0 - share) * self.end.data_cost

    @property
    def holds(self) -> bool:
        """Whether what the fit leaves, and the size of its values, are no more than noise and priors allow."""
        return self.end.cost < self.change.contest.most_held

    @property
    def may_hold(self) -> bool:
        """Whether some of the effects of the fit may hold within the noise by themselves."""
        numbers = np.count_nonzero(self.change.contest.measurement.weights(0.0))
        return bool(2.0 * self.end.data_cost < LARGEST_HEALTHY_CHI2 * numbers + FITS * math.sqrt(2.0 * numbers))

    def differs(self, other: "Screened") -> bool:
        """Whether the change makes any difference to linear effects."""
        return abs(self.end.cost - other.end.cost) > SAME


def as_stated(contest: Contest, *, level: Screened | None = None, to_the_end: bool = False) -> Screened:
    """What is stated, under the noise of the table: where linear effects do not hold, from where they end under a wide
    one, and with a sweep if that helps.

    **Arguments:** ``level``: the fit under a wide noise, if there is one; ``to_the_end``: also where it promises to
    miss by far.
    """
    change = Change(None, contest)
    enough = math.inf if to_the_end else contest.far_off
    stated = screen(change, NO_NOISE, hopeless=enough)
    if not stated.holds:
        rough = level or screen(change, wide_noise(contest.measurement))
        stated = min(stated, under_table_noise(rough, hopeless=enough), key=lambda one: one.end.cost)
    if not stated.holds and (sweeps := contest.sweeping):
        also = screen(change, NO_NOISE, also=sweeps, hopeless=enough)
        stated = min(stated, also, key=lambda one: one.end.cost)
    return stated


def screen(
    change: Change,
    noise: Noise,
    own: Contender | None = None,
    *,
    also: Collection[str] = (),
    starts: Sequence[Start] = (),
    settings: DescentSettings = QUICK,
    hopeless: float = math.inf,
) -> Screened:
    """All linear effects at once, from where the model has them, or the lowest of descents from some ``starts``.

    **Arguments:** ``own``: an answer whose nonlinear forces, and sweep, are fitted too; ``also``: further
    effects; ``settings`` of the descent; ``hopeless``: cost with which it does not go on.
    """
    contest = change.contest
    free = contest.linear | contest.only_of(also)
    if own is not None:
        free = free | contest.only_of(own.effects & contest.costly)
    starts = starts or starts_at(contest.space.given_unknowns()[None])
    data, training = contest.data(noise, starts[0].point), np.tile(contest.training, (len(starts), 1))
    budget = contest.budget
    ends = descend(contest.space, data, starts, free, training, budget=budget, settings=settings, hopeless=hopeless)
    return Screened(change, best_of(ends))


def beside_answer(
    stated: Screened, changes: Collection[Screened], answer: Contender, contest: Contest, noise: Noise, hopeless: float
) -> tuple[Screened, list[Screened]]:
    """All linear effects with the costly ones of an answer, beside what is stated and beside changes, which do not go
    on where they promise a cost with which they are ``hopeless``; of a change with which the costly ones alone are not,
    those alone: few values are found where many may lead astray. The nearest go on to their end, as long as that is
    within reach. **Arguments:** ``contest`` of the answer.
    """
    own, fitted = as_large_as_read(answer, contest, stated.change.contest), list[Screened]()
    level = screen(stated.change, noise, own, starts=[Start.at(own.best)], hopeless=hopeless)
    for one in changes:
        own = as_large_as_read(answer, contest, one.change.contest)
        alone = _costly_alone(one.change, own, noise, hopeless)
        if alone.balanced and alone.best.cost < hopeless:
            fitted.append(Screened(one.change, alone.best))
            continue
        starts = one.change.begun_from(level, own)
        fitted.append(screen(one.change, noise, own, starts=starts, settings=BESIDE_FORCES, hopeless=hopeless))
    for k in sorted(range(len(fitted)), key=lambda k: fitted[k].end.cost):
        change, end = fitted[k]
        if end.result == MAX_STEPS:
            fitted[k] = screen(change, noise, answer, starts=[Start.at(end)], hopeless=hopeless)
            if fitted[k].end.cost > hopeless:
                break
    return level, fitted


def as_large_as_read(own: Contender, contest: Contest, there: Contest) -> Contender:
    """An answer to begin with where the table says another amplitude of vibration: with nonlinear forces that do the
    same to such a motion. Where the answer has an error of a gain, that stands for it, and the motion is the same.
    **Arguments:** ``contest`` of the answer; ``there``: that in which it is to begin.
    """
    model = contest.space.model
    larger = largest_displacement(there.space.model, there.measurement) / largest_displacement(
        model, contest.measurement
    )
    if abs(math.log(larger)) < SAME or own.effects & GAINS:
        return own
    powers = np.zeros(len(own.best.point))
    of = {(e.name, p.name): WITH_AMPLITUDE.get(p.of, 0.0) for e in model.effects for p in e.parameters()}
    for entry in contest.space.entries:
        if entry.effect in contest.costly and not entry.logarithmic:
            powers[entry.unknown] = of[entry.effect, entry.parameter]
    return own.led_by(own.best._replace(point=own.best.point * larger**powers, exact=False), own.noise)


def beside_forces_of(own: Contender, stated: Contest, changes: Collection[Change], noise: Noise) -> list[Screened]:
    """Changes that do better beside the costly effects of an answer that misses.

    Fitted are those effects alone, then with all linear ones; where the answer has none, each nonlinear force alone.
    Kept is a change that leaves less than the answer does, and hardly more than the best of the changes. All are
    compared under a wide noise, which does not ask for what is small: beside a strong spring and a trial weight on the
    opposite side no linear effect tells one change from another.
    """
    wide = wide_noise(stated.measurement)
    level = race(stated, wide, [own.effects], {own.effects: own})[own.effects].best
    there = [(change, as_large_as_read(own, stated, change.contest)) for change in changes]
    alone = list[_Alone]()
    if own.effects & stated.coupled:
        alone = [_Alone(change, _costly_alone(change, moved, wide, level.cost + TIE)) for change, moved in there]
    elif 2.0 * level.cost < LARGEST_HEALTHY_CHI2 * np.count_nonzero(stated.measurement.weights(0.0)):
        return []
    if not any(one.leaves_less_than(level) for one in alone):
        alone = _one_force_each(changes, own, wide, level.cost + TIE)
    most = min((one.cost + HOPELESS for one in alone), default=math.inf)
    return [
        screen(
            one.change._replace(known={one.fitted.effects: one.fitted}),
            noise,
            one.fitted,
            starts=[Start.at(one.fitted.best)],
            settings=BESIDE_FORCES,
        )
        for one in sorted(alone, key=lambda one: one.cost)
        if one.cost < most and one.leaves_less_than(level)
    ]


class _Alone(NamedTuple):
    """Nonlinear forces beside a change, and nothing else."""

    change: Change
    fitted: Contender

    @property
    def cost(self) -> float:
        """Of the fit and of the prior odds of the change; without end where motions do not balance."""
        return self.fitted.best.cost - self.change.log_odds if self.fitted.balanced else math.inf

    def leaves_less_than(self, other: End) -> bool:
        """Whether it leaves less of the data than another fit, be it less probable beforehand: under a wide noise that
        counts as much as what they leave.
        """
        return self.fitted.balanced and self.fitted.best.data_cost < other.data_cost


def _one_force_each(changes: Collection[Change], own: Contender, noise: Noise, hopeless: float) -> list[_Alone]:
    """The best nonlinear force, if there is any but that of an answer, by itself beside every change: none goes on that
    promises far more than the best of them.
    """
    found = list[_Alone]()
    for change in changes:
        contest = change.contest
        forces = [frozenset({name}) for name in contest.candidates if name in contest.coupled - own.effects]
        fitted = race(contest, noise, forces, {}, hopeless=hopeless)
        found += sorted((_Alone(change, fitted[one]) for one in forces), key=lambda one: one.cost)[:1]
        hopeless = min([hopeless, *(one.cost + HOPELESS for one in found[-1:])])
    return found


def _costly_alone(change: Change, own: Contender, noise: Noise, hopeless: float) -> Contender:
    """The costly effects of an answer beside a change, and nothing else, from where the answer has them."""
    contest = change.contest
    effects = own.effects & contest.costly
    point = np.where(contest.only_of(effects), own.best.point, contest.space.given_unknowns())
    near = Contender(effects, (own.best._replace(point=point, exact=False),), -math.inf, noise, foreseen=True)
    return race(contest, noise, [effects], {effects: near}, hopeless=hopeless)[effects]


def under_table_noise(rough: Screened, *, hopeless: float = math.inf) -> Screened:
    """The fit under the noise of the table, begun where that under a wide one ended."""
    return screen(rough.change, NO_NOISE, starts=[Start.at(rough.end)], hopeless=hopeless)
