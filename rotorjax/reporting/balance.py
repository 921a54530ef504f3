"""What people read of a correction: the mass, where it goes, and what is left."""

from typing import Any

import numpy as np
from jaxtyping import Float

from rotorjax.data.measurement import Measurement
from rotorjax.data.rig import Rig
from rotorjax.diagnosis.balancing import Correction, before_and_after
from rotorjax.diagnosis.inverse import Diagnosis
from rotorjax.discovery.fit import NORMAL_QUANTILE, Fit
from rotorjax.effects.excitation import ResidualUnbalance
from rotorjax.model.model import Model
from rotorjax.reporting.tables import Table, number
from rotorjax.units import GRAM_MILLIMETRE, MICROMETRE, RPM

GRAM = 1e-3
MOST_SPEEDS = 12
"""Speeds at which the vibration after the correction is predicted."""


def corrections(fitted: Fit, rig: Rig, measurement: Measurement) -> tuple[Correction, ...]:
    """What corrects the residual unbalance of a fitted model, in each plane of the rig by itself; none where the fit
    has no residual unbalance.
    """
    found = {e.entry.label: e for e in fitted.estimates if e.entry.effect == ResidualUnbalance.name}
    labels = [f"unbalance_{axis}_kg_m" for axis in "xy"]
    if not found.keys() >= set(labels):
        return ()
    which, scale = (
        [found[label].entry.unknown for label in labels],
        np.array([found[label].entry.scale for label in labels]),
    )
    covariance = scale[:, None] * fitted.covariance[np.ix_(which, which)] * scale
    return _in_every_plane(
        np.array([found[label].value for label in labels]), covariance, rig, measurement, float(fitted.model.rotor.mass)
    )


def diagnosed_corrections(diagnosis: Diagnosis, rig: Rig, measurement: Measurement) -> tuple[Correction, ...]:
    """The same for what `diagnose` found: the inherent unbalance, or else that of the first run with nothing installed;
    none where it is not told apart.

    What the rig file holds already is corrected with it.
    """
    free = [
        k
        for k in range(len(measurement.runs))
        if not np.any(np.asarray(measurement.conditions.unbalance)[measurement.run == k])
    ]
    found = diagnosis.inherent or next(
        (run for run in diagnosis.runs for k in free if run.run == measurement.runs[k]), None
    )
    if found is None or not found.identifiable or found.unbalance is None or found.unbalance.covariance is None:
        return ()
    return _in_every_plane(
        found.unbalance.pair + held_unbalance(rig),
        found.unbalance.covariance,
        rig,
        measurement,
        float(rig.model.rotor.mass),
    )


def held_unbalance(rig: Rig) -> Float[np.ndarray, "dof"]:
    """Residual unbalance that the rig file has among its effects [kg m]."""
    effect = rig.model.find(ResidualUnbalance.name)
    return np.zeros(2) if effect is None else np.array([float(value) for value in effect.values()])


def _in_every_plane(
    unbalance: Float[np.ndarray, "dof"],
    covariance: Float[np.ndarray, "dof dof"],
    rig: Rig,
    measurement: Measurement,
    mass: float,
) -> tuple[Correction, ...]:
    """One correction for each plane. The grade counts at the highest speed of the rig's limits, or else of those
    measured.
    """
    limits = measurement.knowledge.limits.speed_rpm
    speed = RPM * (float(measurement.speed_rpm.max()) if limits is None else limits[1])
    return tuple(
        Correction(
            name,
            plane,
            unbalance / plane.participation,
            covariance / plane.participation**2,
            mass,
            speed,
            rig.convention,
        )
        for name, plane in rig.planes.items()
        if plane.participation != 0.0
    )


def balance_lines(found: tuple[Correction, ...]) -> list[str]:
    """All corrections in sentences."""
    return [balance_line(one, alone=len(found) > 1) for one in found]


def balance_line(correction: Correction, *, alone: bool = False) -> str:
    """One correction in a sentence. **Arguments:** ``alone``: whether other planes could do it, too."""
    c = correction
    where = f"at {c.correction_angle_deg:.0f}° in plane {c.name}{' alone' if alone else ''}"
    mass, error = c.mass_at_radius(c.size), c.mass_at_radius(NORMAL_QUANTILE * c.standard_error)
    if mass is None or error is None:
        amount = (
            f"{number(c.size / GRAM_MILLIMETRE)} ± {number(NORMAL_QUANTILE * c.standard_error / GRAM_MILLIMETRE, 2)} g "
            f"mm {where}"
        )
        hint = f" Its mass follows once the rig file has radius_mm under [planes.{c.name}]."
    else:
        amount = (
            f"{number(mass / GRAM)} ± {number(error / GRAM, 2)} g {where}, at a radius of "
            f"{number(1e3 * (c.plane.radius_m or 0.0))} mm"
        )
        hint = ""
    holes = " and ".join(f"{number(part.mass_kg / GRAM)} g in hole {part.hole}" for part in c.in_holes)
    grades = (
        f"balance quality grade G {number(c.grade(c.size))} before, G {number(c.grade(c.left), 2)} after (at "
        f"{c.speed / RPM:.0f} rpm)"
    )
    return f"To balance: {amount}{f' ({holes})' if holes else ''}; {grades}.{hint}"


def predicted_table(model: Model, correction: Correction, speeds_rpm: np.ndarray) -> Table:
    """Vibration at 1X with nothing installed, before and after a correction, at some of the speeds measured."""
    picked = np.unique(np.linspace(0, len(speeds_rpm) - 1, min(MOST_SPEEDS, len(speeds_rpm))).round().astype(int))
    speeds, first = speeds_rpm[picked], model.layout.orders.index(1.0)
    before, after = (np.abs(z[:, :, first]) / MICROMETRE for z in before_and_after(model, correction, speeds))
    headers = ["rpm", *(f"{probe} {when} µm" for probe in model.layout.probes for when in ("before", "after"))]
    rows = [
        [f"{speed:.0f}", *(number(float(z[k, p])) for p in range(before.shape[1]) for z in (before, after))]
        for k, speed in enumerate(speeds)
    ]
    return Table(
        f"Vibration at 1X predicted with the correction in plane {correction.name}, nothing else installed",
        headers,
        rows,
    )


def balance_json(found: tuple[Correction, ...]) -> dict[str, dict[str, Any]]:
    """Corrections by plane."""

    def grams(unbalance: float, c: Correction) -> float | None:
        mass = c.mass_at_radius(unbalance)
        return None if mass is None else mass / GRAM

    return {
        c.name: {
            "unbalance_g_mm": c.size / GRAM_MILLIMETRE,
            "angle_deg": c.angle_deg,
            "correction_g": grams(c.size, c),
            "correction_angle_deg": c.correction_angle_deg,
            "standard_error_g": grams(c.standard_error, c),
            "standard_error_g_mm": c.standard_error / GRAM_MILLIMETRE,
            "holes": [{"hole": part.hole, "mass_g": part.mass_kg / GRAM} for part in c.in_holes],
            "grade_before": c.grade(c.size),
            "grade_after": c.grade(c.left),
            "grade_speed_rpm": c.speed / RPM,
        }
        for c in found
    }
