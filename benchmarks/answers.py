"""What `explain` answered, as one flat record that can be scored."""

import math
from typing import Any

from scipy.special import stdtridf, stdtrit

from rotorjax.discovery.explanation import Explanation
from rotorjax.discovery.fit import Fit
from rotorjax.discovery.probable import credible
from rotorjax.discovery.ranking import none_left

NORMAL_95, NORMAL_90 = 1.959964, 1.644854
"""Half of an interval of 95 % and of 90 % in standard deviations."""


def answer(found: Explanation) -> dict[str, Any]:
    """Verdict, names, probabilities, what ties, sizes with intervals of 90 %, and cost."""
    return {
        "verdict": found.verdict,
        "named": list(found.named),
        "probability": found.probability,
        "step_probability": None if found.verdict == "unexplained" else _by_steps(found),
        "set95": [list(one.names) for one in credible(found.probable)],
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
    return 1.0 / (1.0 + sum(found.written.odds))


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
