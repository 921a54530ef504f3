"""Probabilities of whole explanations: of what is hidden all together, not of one effect beside others."""

import math
from collections.abc import Iterable
from typing import NamedTuple

from rotorjax.discovery.answers import MistakeRace
from rotorjax.discovery.contest import Contender, Contest

CREDIBLE = 0.95
"""Probability that the set of explanations listed has."""


class Probable(NamedTuple):
    """Effects, and a mistake in what was written down, that together may be what is hidden."""

    names: tuple[str, ...]
    """Of both, in alphabetical order, with what is too small to matter; empty where nothing is missing."""
    probability: float


def probable(contest: Contest, contenders: Iterable[Contender], written: MistakeRace) -> tuple[Probable, ...]:
    """Probability of every set of effects among those that were fitted, the most probable first.

    p(M | z) = p(z | M) p(M) / Σ p(z | M') p(M'), with the evidence p(z | M) as fitted, or as foreseen to first order,
    and prior odds p(M); answers beside other mistakes in rig file and table than that of the answer, or beside none,
    count with their odds against it. What is in no set that was fitted has no share. **Arguments:** ``contenders``
    beside what the answer states; ``written``: the answers beside mistakes.
    **Source:** MacKay 1992, Neural Comput. 4:415-447.
    """
    mistake = () if written.best.mistake is None else (written.best.mistake.name,)
    logs: dict[frozenset[str], float] = {}
    for contender in contenders:
        log, names = contest.log_posterior(contender), frozenset((*mistake, *contender.effects))
        if math.isfinite(log):
            logs[names] = max(log, logs.get(names, -math.inf))
    if not logs:
        return ()
    top = max(logs.values())
    weights = {names: math.exp(log - top) for names, log in logs.items()}
    total = sum(weights.values())
    share = 1.0 / (1.0 + sum(written.odds))
    found = {names: share * weight / total for names, weight in weights.items()}
    for other, against in zip(written.ranked[1:], written.odds, strict=True):
        names = frozenset((*other.named, *other.selection.small))
        found[names] = found.get(names, 0.0) + share * against
    return tuple(Probable(tuple(sorted(names)), p) for names, p in sorted(found.items(), key=lambda item: -item[1]))


def credible(every: Iterable[Probable]) -> tuple[Probable, ...]:
    """The most probable explanations that together have a probability of `CREDIBLE`."""
    chosen, total = [], 0.0
    for one in every:
        if total >= CREDIBLE:
            break
        chosen.append(one)
        total += one.probability
    return tuple(chosen)
