"""Results as pandas data frames, in the units that people read; pandas is the optional extra ``pandas``."""

import importlib
from typing import Any

import numpy as np

from rotorjax.data.measurement import COLUMN, Measurement
from rotorjax.data.rig import to_rows
from rotorjax.diagnosis.inverse import Diagnosis
from rotorjax.discovery.compare import Comparison
from rotorjax.discovery.explanation import Explanation
from rotorjax.discovery.fit import Fit
from rotorjax.discovery.story import Story
from rotorjax.model.model import Model
from rotorjax.reporting.comparison import step_labels, steps
from rotorjax.units import GRAM_MILLIMETRE, MICROMETRE, RPM, unit_of


def frame(result: Any) -> Any:
    """A result as a data frame.

    A measurement has a row per vector, as in a table, but zero-to-peak with leading phase whatever the rig file says,
    as the names of its columns state; a comparison a row per vector with its prediction, the worst first; a fit a row
    per parameter; a diagnosis a row per run, angles as leading phases count; a story a row per step; an explanation a
    row per candidate of every step; a model a row per number of its rotor and effects.
    **Errors.** ``ImportError`` where pandas is not installed, ``TypeError`` for what has no rows.
    """
    makers = {
        Measurement: _vectors,
        Comparison: _cells,
        Fit: _parameters,
        Story: _steps,
        Explanation: _candidates,
        Model: _parts,
        Diagnosis: _faults,
    }
    for kind, make in makers.items():
        if isinstance(result, kind):
            return _pandas().DataFrame(make(result))
    raise TypeError(f"a {type(result).__name__} has no rows to put into a data frame")


def _pandas() -> Any:
    try:
        return importlib.import_module("pandas")
    except ImportError as error:
        raise ImportError("to_pandas needs pandas: install it, or rotorjax with its extra: rotorjax[pandas]") from error


def _vectors(m: Measurement) -> list[dict[str, Any]]:
    stated = {column: name for name, column in COLUMN.items()}
    return [
        {stated.get(name, name): value for name, value in row._asdict().items() if value is not None}
        for row in to_rows(m)
    ]


def _cells(view: Comparison) -> list[dict[str, Any]]:
    rows = []
    for cell in view.where():
        row = {"run": cell.run, "speed_rpm": cell.speed_rpm, "probe": cell.probe, "order": cell.order}
        for name, z in (("measured", cell.measured), ("predicted", cell.predicted)):
            row |= {f"{name}_um": abs(z) / MICROMETRE, f"{name}_phase_deg": float(np.degrees(np.angle(z)))}
        rows.append(row | {"residual_um": cell.residual_um, "standardised": cell.standardised})
    return rows


def _parameters(fitted: Fit) -> list[dict[str, Any]]:
    rows = []
    for e in fitted.estimates:
        unit, half = e.entry.unit, fitted.quantile * e.standard_error
        rows.append({
            "effect": e.entry.effect,
            "parameter": e.entry.label,
            "value": e.value / unit.factor,
            "low": (e.value - half) / unit.factor,
            "high": (e.value + half) / unit.factor,
            "unit": unit.shown,
            "determined": e.determined,
            "declared_uncertain": e.entry.declared_uncertain,
        })  # fmt: skip
    return rows


def _steps(story: Story) -> list[dict[str, Any]]:
    rows = []
    for label, (view, fitted) in zip(step_labels(story), steps(story), strict=True):
        held = None if fitted is None or fitted.held_out_rms is None else fitted.held_out_rms / MICROMETRE
        rows.append({
            "step": label,
            "rms_um": view.rms / MICROMETRE,
            "held_out_rms_um": held,
            "reduced_chi2": view.reduced_chi2 if fitted is None else fitted.reduced_chi2,
        })  # fmt: skip
    return rows


def _candidates(found: Explanation) -> list[dict[str, Any]]:
    return [
        {
            "step": step,
            "effect": ranked.effect,
            "probability": ranked.probability,
            "log_evidence": ranked.log_evidence,
            "reduced_chi2": found.chi2(ranked),
        }
        for step, ranking in enumerate(found.rankings)
        for ranked in ranking
    ]


def _faults(diagnosis: Diagnosis) -> list[dict[str, Any]]:
    rows = []
    for run in diagnosis.found:
        row: dict[str, Any] = {"run": run.run}
        for name, fault, unit in (("unbalance_g_mm", run.unbalance, GRAM_MILLIMETRE), ("bow_um", run.bow, MICROMETRE)):
            size = (None, None, None)
            if fault is not None:
                angle = float(np.degrees(np.arctan2(fault.pair[1], fault.pair[0])))
                half = fault.half_interval
                size = (fault.magnitude / unit, None if half is None else half / unit, angle)
            row |= dict(zip((name, f"{name}_half_interval", f"{name}_angle_deg"), size, strict=True))
        rows.append(row | {"separable": run.identifiable, "reduced_chi2": run.reduced_chi2, "reason": run.reason})
    return rows


def _parts(model: Model) -> list[dict[str, Any]]:
    return [dict(zip(("part", "parameter", "value", "unit"), row, strict=True)) for row in parts_of(model)]


def parts_of(model: Model) -> list[tuple[str, str, float, str]]:
    """Numbers of a model's rotor and effects: part, parameter, value and unit, as people read them."""
    rotor = model.rotor
    nominal = np.sqrt(np.asarray(rotor.stiffness) / float(rotor.mass)) / RPM
    rows = [("rotor", "mass", float(rotor.mass), "kg")]
    for what, pair, unit in (("stiffness", rotor.stiffness, "N/m"), ("natural frequency", nominal, "rpm")):
        rows += [("rotor", f"{what} {axis}", float(v), unit) for axis, v in zip("xy", np.asarray(pair), strict=True)]
    for effect in model.effects:
        labels = [label for p in effect.parameters() for label in p.labels(model.layout)]
        values = [float(v) for value in effect.values() for v in np.asarray(value).ravel()]
        for label, value in zip(labels, values, strict=True):
            unit = unit_of(label.split(".")[0])
            rows.append((effect.name, label, value / unit.factor, unit.shown))
    return rows
