"""Races of sets of effects under one noise: that which the winner leaves, or that of the table."""

import dataclasses
from collections.abc import Iterable
from typing import NamedTuple

from rotorjax.discovery.contest import Contender, Contest, Effects, Known
from rotorjax.discovery.race import WORTH_TRYING, anew, falls, race
from rotorjax.inference.descent import HOPELESS
from rotorjax.inference.descent_settings import LEFT_BEHIND
from rotorjax.inference.influence import CLEAR
from rotorjax.inference.noise import MOST_ROUNDS, NO_NOISE, SAME_MISFIT, Noise


class Race(NamedTuple):
    """Contenders under one noise: that which the winner leaves."""

    noise: Noise
    contenders: Known
    winner: Effects


class QuietRace(NamedTuple):
    """Contenders under the noise of the table alone."""

    contenders: Known
    leader: Effects | None
    """The best of them, if it holds within that noise."""


def settle(
    contest: Contest,
    hypotheses: Iterable[Effects],
    known: Known,
    noise: Noise,
    *,
    quiet_race: QuietRace | None = None,
) -> Race:
    """Race hypotheses until the misfit allowed for is what the winner leaves.

    Under the noise that is known, if one holds within that. Else again and again: the noise is common to all, so that
    the evidence compares what they predict and not how much each may miss. It begins wide and comes down, not below the
    floor: a wide one lets no hypothesis be dragged into a corner by data that it cannot meet. **Arguments:** ``noise``:
    where to begin; ``quiet_race``: what they are under the noise that is known, if that was tried.
    """
    wanted = list(dict.fromkeys(hypotheses))
    quiet_race = quiet_race or (
        under_table_noise(contest, wanted, known) if contest.floor == NO_NOISE else QuietRace({}, None)
    )
    if quiet_race.leader is not None:
        return Race(NO_NOISE, quiet_race.contenders, quiet_race.leader)
    noise = Noise(max(noise.allowance, contest.floor.allowance), contest.floor.scatter)
    reached = {e: c for e, c in quiet_race.contenders.items() if c.best.result != LEFT_BEHIND}
    found = {**known, **race(contest, noise, wanted, known, also=reached)}
    for _ in range(MOST_ROUNDS):
        leader = _leader(contest, found, wanted)
        quiet, found[leader] = _settled(contest, found[leader], noise)
        if _same(quiet, noise):
            break
        # What was hopeless under more noise stays so under less.
        near = _near(found, wanted)
        if not falls(quiet, noise):
            least = found[leader].log_evidence - WORTH_TRYING - CLEAR
            near = anew(contest, quiet, near, found, lambda there, least=least: there.log_evidence > least)
        found.update(race(contest, quiet, near, found, afresh=falls(quiet, noise)))
        noise = quiet
    contenders = {effects: found[effects] for effects in wanted}
    return Race(noise, contenders, _leader(contest, contenders, wanted))


def _near(found: Known, wanted: list[Effects]) -> list[Effects]:
    best = max(found[effects].log_evidence for effects in wanted)
    return [effects for effects in wanted if found[effects].log_evidence > best - HOPELESS]


def _leader(contest: Contest, found: Known, wanted: list[Effects]) -> Effects:
    return max(wanted, key=lambda effects: contest.log_posterior(found[effects]))


def under_table_noise(contest: Contest, wanted: list[Effects], known: Known) -> QuietRace:
    """Hypotheses under the noise of the table alone; where some misfit is known to be there those with
    nonlinear forces, which that misfit may come from. If none of them holds some are missing.
    """
    if not contest.tries_table_noise:
        return QuietRace({}, None)
    linear = contest.floor == NO_NOISE and contest.linear_may_hold
    possible = [effects for effects in wanted if linear or effects & contest.coupled]
    contest = dataclasses.replace(contest, floor=NO_NOISE)
    first = sets_under_table_noise(contest, possible, known)
    if first.leader is None:
        return first
    # What was left behind as it cannot hold goes on: it is shown how far off it is.
    begun = {e: c._replace(foreseen=c.best.result == LEFT_BEHIND) for e, c in first.contenders.items()}
    every = race(contest, NO_NOISE, wanted, {**known, **begun})
    return QuietRace(every, _holding(contest, every, wanted))


def sets_under_table_noise(contest: Contest, sets: list[Effects], known: Known) -> QuietRace:
    """Sets under the noise of the table; one that cannot come to hold does not go on."""
    found = race(contest, NO_NOISE, sets, known, hopeless=contest.far_off)
    return QuietRace(found, _holding(contest, found, sets))


def _holding(contest: Contest, found: Known, wanted: list[Effects]) -> Effects | None:
    """The best, if it leaves no more than the noise of the table."""
    if not wanted:
        return None
    leader = _leader(contest, found, wanted)
    return leader if contest.misfit_left(found[leader]) == 0.0 else None


def _settled(contest: Contest, contender: Contender, noise: Noise) -> tuple[Noise, Contender]:
    """The misfit that one contender leaves when it is fitted under just that misfit, and the contender there."""
    for _ in range(MOST_ROUNDS):
        after = noise._replace(allowance=contest.misfit_left(contender))
        if _same(after, noise):
            break
        contender = race(
            contest, after, [contender.effects], {contender.effects: contender}, afresh=falls(after, noise)
        )[contender.effects]
        noise = after
    return noise, contender


def _same(one: Noise, other: Noise) -> bool:
    return abs(one.allowance - other.allowance) <= SAME_MISFIT * max(one.allowance, other.allowance)
