"""What `explain` answered, as one flat record that can be scored."""

import math
from typing import Any

from scipy.special import stdtridf, stdtrit

from rotorjax.discovery.answers import Answer
from rotorjax.discovery.explanation import Explanation
from rotorjax.discovery.fit import Fit
from rotorjax.discovery.search import none_left

NORMAL_95, NORMAL_90 = 1.959964, 1.644854
"""Half of an interval of 95 % and of 90 % in standard deviations."""
SHARE = 0.95
"""Probability that a set of explanations is to have."""


def answer(found: Explanation) -> dict[str, Any]:
    """Verdict, names, probabilities, what ties, sizes with intervals of 90 %, and cost."""
    joint = _joint(found)
    whole = frozenset(found.named) | {small.effect for small in found.detected_but_small}
    return {
        "verdict": found.verdict,
        "named": list(found.named),
        "probability": None if found.verdict == "unexplained" else joint.get(whole, 0.0),
        "step_probability": None if found.verdict == "unexplained" else _by_steps(found),
        "set95": [sorted(names) for names in _smallest(joint)],
        "ties": [sorted(names) for names in _alternatives(found, found.ties.tied)]
        + [sorted(other.named) for other in found.written.tied],
        "tie_gaps": [round(tied.gap, 2) for tied in found.ties.tied],
        "contains": [sorted(names) for names in _alternatives(found, found.ties.contains)],
        "small": [small.effect for small in found.detected_but_small],
        "small_ties": found.ties.small_groups(),
        "more": [ranked.effect for ranked in found.more],
        "objections": list(found.objections),
        "confirmed": found.confirmed,
        "outside_term": None if found.named_force is None else [t.term for t in found.named_force.terms],
        "sizes": _sizes(found.story.fits[-1], found.effects),
        "p_value": None if found.p_value is None else found.p_value.value,
        "held_out_rms": found.story.fits[-1].held_out_rms,
        "chi2": found.story.fits[-1].reduced_chi2,
        "linearisations": found.cost.linearisations,
        "exhausted": found.cost.exhausted,
    }


def _by_steps(found: Explanation) -> float:
    """Probability of the answer as the rankings state it: of each effect at its step, of nothing further at the last,
    and of what was written down wrongly against its alternatives.
    """
    total = none_left(found.rankings[-1])
    for step, name in zip(found.rankings, found.effects, strict=False):
        total *= next((r.probability for r in step if r.effect == name), 0.0)
    return float(total * _of_mistake(found))


def _of_mistake(found: Explanation) -> float:
    return 1.0 / (1.0 + sum(_against_the_answer(found, other) for other in found.written.ranked[1:]))


def _against_the_answer(found: Explanation, other: Answer) -> float:
    """Odds of another answer."""
    return math.exp(min(700.0, -found.written.best.lead(other)))


def _joint(found: Explanation) -> dict[frozenset[str], float]:
    """Set, with what is too small to matter -> probability among all sets that were fitted under the noise that the
    answer leaves, its swaps and additions; mistakes other than the one in the answer take their share.
    """
    mistake = () if found.mistake is None else (found.mistake.name,)
    contenders = [*found.ties.raced.values(), found.ties.winner, *(r.contender for r in found.rankings[-1])]
    logs: dict[frozenset[str], float] = {}
    for c in contenders:
        log, names = found.contest.log_posterior(c), frozenset((*mistake, *c.effects))
        if math.isfinite(log):
            logs[names] = max(log, logs.get(names, -math.inf))
    if not logs:
        return {}
    top, share = max(logs.values()), _of_mistake(found)
    weights = {names: math.exp(log - top) for names, log in logs.items()}
    total = sum(weights.values())
    joint = {names: share * w / total for names, w in weights.items()}
    for other in found.written.ranked[1:]:
        names = frozenset((*other.named, *other.selection.small))
        joint[names] = joint.get(names, 0.0) + share * _against_the_answer(found, other)
    return joint


def _smallest(joint: dict[frozenset[str], float]) -> list[frozenset[str]]:
    """The most probable sets that together have `SHARE`."""
    chosen, total = [], 0.0
    for names, p in sorted(joint.items(), key=lambda item: -item[1]):
        if total >= SHARE:
            break
        chosen.append(names)
        total += p
    return chosen


def _alternatives(found: Explanation, others) -> list[set[str]]:
    """The answer with each of some alternatives in the place of a part of it."""
    named = set(found.named)
    return [named - set(other.instead_of) | set(other.effects) for other in others]


def _sizes(fitted: Fit, effects: tuple[str, ...]) -> list[dict[str, Any]]:
    """Parameters of effects in SI with intervals of 90 %."""
    factor = NORMAL_90
    if fitted.quantile > NORMAL_95 + 1e-4:
        factor = float(stdtrit(stdtridf(0.975, fitted.quantile), 0.95))
    return [
        {
            "name": f"{e.entry.effect}.{e.entry.label}",
            "value": float(e.value),
            "half": float(factor * e.standard_error),
            "determined": bool(e.determined),
        }
        for e in fitted.estimates
        if e.entry.effect in effects and math.isfinite(e.standard_error)
    ]
