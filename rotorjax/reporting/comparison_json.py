"""A comparison as JSON: plain finite numbers in the units that their names say."""

from typing import Any

from rotorjax.data.declarations import Mistake
from rotorjax.discovery.compare import Comparison
from rotorjax.discovery.fit import Fit
from rotorjax.discovery.story import Story
from rotorjax.inference.noise import NO_SCATTER
from rotorjax.reporting.comparison import findings, step_labels, steps, verdict
from rotorjax.reporting.critical_speeds import critical_speeds_json, stability_json
from rotorjax.reporting.healthy import healthy_json
from rotorjax.units import MICROMETRE


def comparison_json(story: Story) -> dict[str, Any]:
    """What ``compare --json`` writes: the model as it is at the end, what it was before, and every step."""
    return {
        "verdict": verdict(story),
        "written_down_wrongly": mistake_json(story.mistake),
        **view_json(story.last, story.fits[-1].reduced_chi2 if story.fits else story.declared.reduced_chi2),
        "noise": "inferred" if story.measurement.noise != "given" else "given",
        "before": view_json(story.declared, story.declared.reduced_chi2),
        "steps": [
            step_json(label, view, fitted)
            for label, (view, fitted) in zip(step_labels(story), steps(story), strict=True)
        ],
        "ties": [[[r.effect], [r.instead]] for r in story.rivals if r.tied and r.instead],
        "not_needed": [r.effect for r in story.rivals if r.tied and r.instead is None],
        "run_scatter": story.fits[-1].run_scatter.as_json()
        if story.fits and story.fits[-1].run_scatter != NO_SCATTER
        else None,
        "critical_speeds": critical_speeds_json(story),
        "stability": stability_json(story),
        "findings": findings(story),
        "healthy": healthy_json(story.healthy),
    }


def mistake_json(mistake: Mistake | None) -> dict[str, str] | None:
    """What was written down wrongly, if anything, and what to change."""
    return None if mistake is None else {"name": mistake.name, "meaning": mistake.meaning, "change": mistake.cure}


def view_json(view: Comparison, chi2: float | None) -> dict[str, Any]:
    """Error, where it sits, and its shares."""
    where = [
        {
            "run": c.run, "speed_rpm": c.speed_rpm, "probe": c.probe, "order": c.order, "residual_um": c.residual_um,
            "standardised": c.standardised, "amplitude_ratio": c.amplitude_ratio, "phase_error_deg": c.phase_error_deg,
        }
        for c in view.where()
    ]  # fmt: skip
    return {"rms_um": view.rms / MICROMETRE, "reduced_chi2": chi2, "where": where, "share": view.share()}


def step_json(label: str, view: Comparison, fitted: Fit | None) -> dict[str, Any]:
    """Error and parameters at one step."""
    parameters: dict[str, dict[str, Any]] = {}
    for e in fitted.estimates if fitted else ():
        inner = parameters.setdefault(e.entry.effect, {})
        inner[e.entry.label] = {"value": e.value, "standard_error": e.standard_error, "determined": e.determined}
    return {
        "added": label.removeprefix("+ ") if label.startswith("+ ") else None,
        "step": label,
        "rms_um": view.rms / MICROMETRE,
        "reduced_chi2": fitted.reduced_chi2 if fitted else view.reduced_chi2,
        "held_out_rms_um": fitted.held_out_rms / MICROMETRE if fitted and fitted.held_out_rms is not None else None,
        "held_out_reason": fitted.held_out_reason or None if fitted else "nothing was fitted",
        "converged": fitted.converged if fitted else True,
        "parameters": parameters,
    }
