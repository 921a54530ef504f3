"""An explanation as JSON: plain finite numbers in the units that their names say."""

import math
from typing import Any

from rotorjax.data.rig import Rig
from rotorjax.discovery.explanation import Explanation
from rotorjax.discovery.named_force import NamedForce
from rotorjax.discovery.next_measurement import Proposal
from rotorjax.discovery.probable import credible
from rotorjax.discovery.rivals import TIE
from rotorjax.inference.descent_settings import CONVERGED
from rotorjax.inference.noise import NO_SCATTER
from rotorjax.reporting.answer import sentence
from rotorjax.reporting.balance import balance_json
from rotorjax.reporting.comparison_json import mistake_json, step_json, view_json
from rotorjax.reporting.correction import balance_of
from rotorjax.reporting.critical_speeds import critical_speeds_json, stability_json
from rotorjax.reporting.explanation import notes
from rotorjax.reporting.healthy import healthy_json
from rotorjax.units import MICROMETRE


def explanation_json(found: Explanation, rig: Rig | None = None) -> dict[str, Any]:
    """What ``explain --json`` writes: plain finite numbers, null where a key does not apply. **Arguments:** ``rig``:
    for what would balance the rotor.
    """
    story = found.story
    every = []
    for k, (view, fitted) in enumerate(zip(story.views, story.fits, strict=True)):
        step = step_json(f"+ {found.effects[k - 1]}" if k else "before anything is added", view, fitted)
        ties = found.ties.groups() if k == len(story.fits) - 1 else _near(found, k)
        every.append({**step, "ranking": _ranking_json(found, k), "ties": ties})
    if found.mistake is not None:
        every[0] = {**every[0], "added": found.mistake.name}
        every.insert(0, {**step_json("before anything is added", story.declared, None), "ranking": [], "ties": []})
    uncertain = {e.entry.effect for e in story.fits[0].estimates if e.entry.declared_uncertain}
    every[0] |= {
        "uncertain_values": {k: v for k, v in every[0]["parameters"].items() if k in uncertain},
        "parameters": {},
    }
    return {
        "verdict": found.verdict,
        "sentence": sentence(found),
        "effects": list(found.named),
        "probability": found.probability,
        "probable": [{"effects": list(one.names), "probability": one.probability} for one in credible(found.probable)],
        "written_down_wrongly": _mistake_json(found),
        "steps": every,
        "ranking": _ranking_json(found, 0),
        "ties": found.tied_groups(),
        "tied_predictions": [
            {"instead_of": list(t.instead_of), "effects": list(t.effects), "standardised_difference": t.apart}
            for t in found.ties.tied
        ],
        "contains": [[list(t.instead_of), list(t.effects)] for t in found.ties.contains],
        "detected_but_small": [small._asdict() for small in found.detected_but_small],
        "small_ties": found.ties.small_groups(),
        "where": view_json(story.declared, story.declared.reduced_chi2)["where"],
        "next_measurement": _next_measurement_json(found.next_measurement),
        "noise": "given" if found.contest.measurement.noise == "given" else "inferred",
        "run_scatter": found.noise.scatter.as_json() if found.noise.scatter != NO_SCATTER else None,
        "p_value": None if found.p_value is None else found.p_value.value,
        "p_value_draws": None if found.p_value is None else found.p_value.draws,
        "balance": balance_json(balance_of(found, rig)),
        "no_correction": balance_of(found, rig).why_none or None,
        "critical_speeds": critical_speeds_json(story),
        "stability": stability_json(story),
        "missing_force": _missing_force_json(found.named_force),
        "findings": notes(found),
        "healthy": healthy_json(story.healthy),
        "cost": {**found.cost._asdict(), "untried": list(found.cost.untried), "exhausted": found.cost.exhausted},
    }


def _mistake_json(found: Explanation) -> dict[str, Any] | None:
    """What was written down wrongly, with its probability whatever effects are beside it."""
    told = mistake_json(found.mistake)
    if told is None or found.probability is None:
        return told
    return {**told, "probability": sum(one.probability for one in found.probable if told["name"] in one.names)}


def _next_measurement_json(proposal: Proposal | None) -> dict[str, Any] | None:
    if proposal is None:
        return None
    return {
        "run": proposal.run,
        "speed_rpm": proposal.speeds_rpm[0],
        "speeds_rpm": list(proposal.speeds_rpm),
        "new_probes": list(proposal.new_probes),
        "separates": [" + ".join(names) for names in proposal.separates],
        "standardised_difference": proposal.standardised_difference,
    }


def _ranking_json(found: Explanation, step: int) -> list[dict[str, Any]]:
    return [
        {
            "effect": r.effect,
            "probability": r.probability,
            "log_evidence": r.log_evidence if math.isfinite(r.log_evidence) else None,
            "reduced_chi2": found.chi2(r),
            "converged": r.contender.best.result == CONVERGED,
        }
        for r in found.rankings[step]
    ]


def _near(found: Explanation, step: int) -> list[list[list[str]]]:
    """Effects that the next step could as well have begun with."""
    ranked = found.rankings[step]
    added = next((r for r in ranked if step < len(found.effects) and r.effect == found.effects[step]), ranked[0])
    others = [
        [r.effect]
        for r in ranked
        if r is not added and r.effect != "none" and abs(r.log_evidence - added.log_evidence) < TIE
    ]
    return [[[added.effect], *others]] if others and added.effect != "none" else []


def _missing_force_json(named: NamedForce | None) -> dict[str, Any] | None:
    if named is None:
        return None
    terms = [
        {
            "term": t.term,
            "words": t.words,
            "coefficients": t.coefficients,
            "share": t.share,
            "gain": t.gain,
            "rivals": list(t.rivals),
        }
        for t in named.terms
    ]
    fitted = named.fit
    return {
        "reason": named.force.reason,
        "held": ["xy"[axis] for axis in named.force.held],
        "beside": list(named.beside),
        "terms": terms,
        "rivals": list(named.rivals),
        "parameters": None
        if fitted is None
        else {e.entry.key: {"value": e.value, "standard_error": e.standard_error} for e in fitted.estimates},
        "rms_um": None if fitted is None else named.force.measurement.rms_of(fitted.predicted) / MICROMETRE,
        "held_out_rms_um": None if fitted is None or fitted.held_out_rms is None else fitted.held_out_rms / MICROMETRE,
        "reduced_chi2": None if fitted is None else fitted.reduced_chi2,
        "enough": named.enough,
    }
