"""How probable it is that each effect is what is missing, "nothing" among them."""

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from rotorjax.discovery.common_noise import Race
from rotorjax.discovery.contest import Contender, Contest, Effects
from rotorjax.discovery.race import contender_of, log_likelihood

DETECTED = 0.05
"""Probability of "none", against one effect, below which that counts as detected."""
PRICE = math.log((1.0 - DETECTED) / DETECTED)
"""The same in log odds: an effect 19 times as probable as "none"."""
COMPLETE = 0.75
"""Probability that nothing more is missing below which an answer is undecided."""
SHOWS = 0.5
"""Fall of the cost, of the data and of values declared uncertain, from which on an optimum counts beside "none": what
the data do not show may be there or not.
"""


class Ranked(NamedTuple):
    """One entry of a ranking: the effect that would be added, "none" for adding nothing."""

    effect: str
    probability: float
    log_evidence: float
    contender: Contender


def ranking(contest: Contest, race: Race, base: Effects) -> list[Ranked]:
    """Probabilities of what may be added to a set, "none" among them, the most probable first."""
    return _ranked(contest, base, _one_more(race, base))


def showing(contest: Contest, race: Race, base: Effects) -> list[Ranked]:
    """The same without the optima that fit no better than "none": a stop that the rotor does not reach, say. "None"
    stands for these too.
    """
    log_of = log_likelihood(contest, race.noise)
    least = log_of(race.contenders[base].best.cost) + SHOWS
    shown = []
    for c in _one_more(race, base):
        ends = [end for end in c.ends if c.effects == base or log_of(end.cost) >= least]
        if len(ends) == len(c.ends):
            shown.append(c)
        elif ends:
            shown.append(contender_of(contest, c.effects, ends, c.noise)._replace(foreseen=c.foreseen))
    return _ranked(contest, base, shown)


def _one_more(race: Race, base: Effects) -> list[Contender]:
    return [c for effects, c in race.contenders.items() if effects >= base and len(effects) <= len(base) + 1]


def _ranked(contest: Contest, base: Effects, contenders: list[Contender]) -> list[Ranked]:
    logs = np.array([c.log_evidence + contest.log_odds(c.effects - base) for c in contenders])
    finite = np.where(np.isfinite(logs), logs, -1e300)
    weights = np.exp(finite - finite.max())
    weights /= weights.sum()
    ranked = [
        Ranked(next(iter(c.effects - base), "none"), float(p), c.log_evidence, c)
        for c, p in zip(contenders, weights, strict=True)
    ]
    return sorted(ranked, key=lambda r: (-r.probability, -r.log_evidence))


def none_left(ranked: Iterable[Ranked]) -> float:
    """Probability that nothing is to be added."""
    return next(r.probability for r in ranked if r.effect == "none")


def is_detected(ranked: Iterable[Ranked]) -> bool:
    """Whether the best effect is so much more probable than "none" that it is added: several may share what "none"
    lacks.
    """
    best = max((r.probability for r in ranked if r.effect != "none"), default=0.0)
    return best * DETECTED >= none_left(ranked) * (1.0 - DETECTED)


def may_be_missing(ranked: Sequence[Ranked]) -> list[Ranked]:
    """What may be missing, the most probable first, where "none" has a probability below `COMPLETE`; else nothing."""
    if none_left(ranked) >= COMPLETE:
        return []
    first, *others = (r for r in ranked if r.effect != "none")
    return [first, *(r for r in others if r.probability >= DETECTED)]
