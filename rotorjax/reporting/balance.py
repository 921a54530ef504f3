"""What people read of a correction: the mass, where it goes, and what is left."""

import dataclasses
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import stdtridf

from rotorjax.data.measurement import Measurement
from rotorjax.data.rig import Rig
from rotorjax.data.rig_sections import Plane
from rotorjax.diagnosis.balancing import Correction, predicted
from rotorjax.diagnosis.fault import Fault
from rotorjax.diagnosis.influence_coefficients import InfluenceBalance, measured_influence, weighted_planes
from rotorjax.diagnosis.inverse import Diagnosis, RunDiagnosis
from rotorjax.diagnosis.separability import ENTANGLED
from rotorjax.discovery.fit import Fit
from rotorjax.discovery.least_vibration import excites_at_1x, together
from rotorjax.effects.excitation import PlaneParticipation, ResidualUnbalance
from rotorjax.inference.estimates import NORMAL_QUANTILE
from rotorjax.inference.faults import acting_participation
from rotorjax.model.model import Model
from rotorjax.reporting.intervals import angle_and_error, decimals_of, value_and_error
from rotorjax.reporting.tables import Table, number
from rotorjax.reporting.wording import said
from rotorjax.units import GRAM_MILLIMETRE, MICROMETRE, RPM

GRAM = 1e-3
MOST_SPEEDS = 12
"""Speeds at which the vibration after the correction is predicted."""
STEP = 1e-3
"""Change of an unknown, in prior scales, by which a derivative is taken."""

HARDLY_LESS = 0.95
"""Share of the vibration from which on a correction by influence coefficients leaves as much as there was."""


class Balance(NamedTuple):
    """What corrects an unbalance: one correction for each plane of the rig by itself."""

    corrections: tuple[Correction, ...] = ()
    why_none: str = ""
    """In a sentence, where an unbalance was looked for and nothing is to be corrected."""
    proviso: str = ""
    """What must hold for it, from a comma on."""
    leaves: str = ""
    """What vibration it leaves, in sentences, where not only an unbalance is corrected."""


def balance_of_fit(fitted: Fit, rig: Rig, measurement: Measurement) -> Balance:
    """What corrects the residual unbalance of a fitted model; nothing where the fit has no residual unbalance. Where a
    bow or a force excites the rotor beside it, what leaves least vibration against all of them.
    """
    found = {e.entry.label: e for e in fitted.estimates if e.entry.effect == ResidualUnbalance.name}
    labels = [f"unbalance_{axis}_kg_m" for axis in "xy"]
    if not found.keys() >= set(labels):
        return Balance()
    if len(excites_at_1x(fitted)) > 1:
        return _together(fitted, rig, measurement)
    by_unknown = np.zeros((2, len(fitted.end.point)))
    for axis, label in enumerate(labels):
        by_unknown[axis, found[label].entry.unknown] = found[label].entry.scale
    unbalance = np.array([found[label].value for label in labels])
    return _balance(_in_planes(fitted, unbalance, by_unknown, rig), "the residual unbalance", rig, measurement)


def _together(fitted: Fit, rig: Rig, measurement: Measurement) -> Balance:
    """What leaves least vibration against an unbalance and what else excites the rotor; of a linear rotor."""
    names = [name for name in excites_at_1x(fitted) if name != ResidualUnbalance.name]
    if not fitted.stage.space.is_linear_at(fitted.end.point):
        return Balance(
            why_none=f"No correction: beside a nonlinear force that against {said(names)} and the residual unbalance "
            "depends on the vibration; influence coefficients (`rotorjax diagnose`) correct what was read."
        )
    least = together(fitted, measurement.speed_cluster()[1])
    whose = f"what {said(least.effects)} do together"
    made = _balance(_in_planes(fitted, least.unbalance, least.by_unknown, rig), whose, rig, measurement)
    if made.why_none:
        return made
    before, after, alone = (number(size / MICROMETRE) for size in (least.before, least.after, least.unbalance_alone))
    left = (
        f"It leaves the least vibration at 1X against {said(least.effects)} together: {after} of {before} µm (0-pk, "
        "rms over probes and the speeds measured; without runout). A correction of the residual unbalance alone would "
        f"leave {alone} µm."
    )
    return made._replace(
        corrections=tuple(dataclasses.replace(one, beside=tuple(names)) for one in made.corrections), leaves=left
    )


class _ToCorrect(NamedTuple):
    """An unbalance on the disk, and in each plane as the planes act."""

    on_disk: Fault
    mass: float
    """Of the rotor [kg]."""
    planes: dict[str, tuple[Plane, Fault]]


def _in_planes(
    fitted: Fit, unbalance: Float[np.ndarray, "2"], by_unknown: Float[np.ndarray, "2 param"], rig: Rig
) -> _ToCorrect:
    """An unbalance on the disk of a fitted model, and its change with each unknown, with the participation of every
    plane as it was found, and the error of that.
    """
    freedom = float(stdtridf(0.975, fitted.quantile)) if fitted.quantile > NORMAL_QUANTILE else np.inf

    def fault(pair: np.ndarray, slopes: np.ndarray) -> Fault:
        return Fault(pair, slopes @ fitted.covariance @ slopes.T, freedom)

    planes, acting = _acting_planes(rig, fitted.model), acting_participation(fitted.model)
    by_error = np.zeros((len(acting), len(fitted.end.point)))
    for unknown in (e.entry.unknown for e in fitted.estimates if e.entry.effect == PlaneParticipation.name):
        there = fitted.end.point.copy()
        there[unknown] += STEP
        by_error[:, unknown] = (acting_participation(fitted.stage.space.model_at(there)) - acting) / STEP
    in_each = {}
    for name, slopes in zip(rig.planes, by_error, strict=True):
        if name in planes:
            pair = unbalance / planes[name].participation
            in_each[name] = (
                planes[name],
                fault(pair, (by_unknown - np.outer(pair, slopes)) / planes[name].participation),
            )
    return _ToCorrect(fault(unbalance, by_unknown), float(fitted.model.rotor.mass), in_each)


def _acting_planes(rig: Rig, model: Model) -> dict[str, Plane]:
    """Those that drive the disk at all, with the participation that the model has."""
    shares = dict(zip(rig.planes, acting_participation(model), strict=True))
    return {
        name: plane._replace(participation=float(shares[name]))
        for name, plane in rig.planes.items()
        if shares[name] != 0.0
    }


def balance_of_diagnosis(diagnosis: Diagnosis, rig: Rig, measurement: Measurement) -> Balance:
    """The same for what `diagnose` found: the inherent unbalance, or else that of the first run with nothing installed.

    What the rig file holds already is corrected with it.
    """
    found = diagnosis.inherent or _free_run(diagnosis, measurement)
    if found is None:
        return Balance(
            why_none="No correction: every run has a weight installed, and --reference names none of them, so that the "
            "rotor's own unbalance is not known."
        )
    whose = "the inherent unbalance" if found is diagnosis.inherent else f"the unbalance of {found.run}"
    if found.model_holds is False:
        return Balance(why_none=f"No correction: the model does not hold for {whose}, see above.")
    if found.unbalance is None or found.unbalance.covariance is None or not found.identifiable:
        return Balance(why_none=f"No correction: {whose} is not determined apart from a bow, see above.")
    held = held_unbalance(rig)
    if np.any(held):
        whose += ", with what the rig file holds,"
    unbalance = found.unbalance._replace(pair=found.unbalance.pair + held)
    planes = {
        name: (plane, unbalance.scaled(1.0 / plane.participation))
        for name, plane in _acting_planes(rig, rig.model).items()
    }
    made = _balance(_ToCorrect(unbalance, float(rig.model.rotor.mass), planes), whose, rig, measurement)
    return made if found.model_holds else made._replace(proviso=", if the model holds (which cannot be checked)")


def _free_run(diagnosis: Diagnosis, measurement: Measurement) -> RunDiagnosis | None:
    """The first run with nothing installed."""
    weights = np.asarray(measurement.conditions.unbalance)
    free = {run for k, run in enumerate(measurement.runs) if not np.any(weights[measurement.run == k])}
    return next((run for run in diagnosis.runs if run.run in free), None)


def held_unbalance(rig: Rig) -> Float[np.ndarray, "dof"]:
    """Residual unbalance that the rig file has among its effects [kg m]."""
    effect = rig.model.find(ResidualUnbalance.name)
    return np.zeros(2) if effect is None else np.array([float(value) for value in effect.values()])


def _balance(found: _ToCorrect, whose: str, rig: Rig, measurement: Measurement) -> Balance:
    """One correction for each plane, where the unbalance on the disk is different from zero."""
    if not found.on_disk.differs_from_zero:
        most = f"{number(found.on_disk.below / GRAM_MILLIMETRE, 2)} g mm"
        return Balance(why_none=f"No correction: {whose} is not different from zero, below {most} (95 %).")
    speed_rpm, which = grade_speed(measurement)
    return Balance(
        tuple(
            Correction(name, plane, unbalance, found.mass, RPM * speed_rpm, rig.convention, which)
            for name, (plane, unbalance) in found.planes.items()
        )
    )


def grade_speed(measurement: Measurement) -> tuple[float, str]:
    """Speed [rpm] at which the balance quality grade counts, and which it is: the highest operating speed, or else the
    highest that may be measured, or else the highest measured.
    """
    limits = measurement.knowledge.limits
    if limits.operating_speed_rpm is not None:
        return limits.operating_speed_rpm[1], "the highest operating speed"
    if limits.speed_rpm is not None:
        return limits.speed_rpm[1], "the highest of [limits]"
    return float(measurement.speed_rpm.max()), "the highest measured"


def balance_lines(found: Balance) -> list[str]:
    """All corrections in sentences, or why there are none."""
    alone = len(found.corrections) > 1
    lines = [balance_line(one, alone=alone, proviso=found.proviso) for one in found.corrections]
    return [*lines, *filter(None, [found.leaves, found.why_none])]


def balance_line(correction: Correction, *, alone: bool = False, proviso: str = "") -> str:
    """One correction in a sentence. **Arguments:** ``alone``: whether other planes could do it, too; ``proviso``: what
    must hold for it, from a comma on.
    """
    c, where = correction, f"in plane {correction.name}{' alone' if alone else ''}"
    size, error = value_and_error(c.size, c.unbalance.half_interval, GRAM_MILLIMETRE)
    amount, hint = f"{size} ± {error} g mm", f" For a mass in grams give radius_mm under [planes.{c.name}]."
    if c.plane.radius_m is not None:
        mass, error = value_and_error(*_grams(c))
        amount, hint = f"{mass} ± {error} g at a radius of {1e3 * c.plane.radius_m:g} mm,", ""
    angle, turn = angle_and_error(c.correction_angle_deg, c.unbalance.angle_half_interval_deg)
    sense = c.convention.weight_angles.replace("-", " the ")
    holes = f", that is {held}" if (held := _holes(c)) else ""
    put = f"To balance{proviso}: correction {amount} at {angle}° ± {turn}° from +x {sense} {where}"
    if c.beside:
        return f"{put}{holes}.{hint}"
    opposite = angle_and_error(c.angle_deg, c.unbalance.angle_half_interval_deg)[0]
    return (
        f"{put} (opposite the unbalance at {opposite}°){holes}. Specific unbalance times speed at {c.speed / RPM:.0f} "
        f"rpm ({c.speed_is}): {number(c.grade(c.size))} mm/s before, below {number(c.grade(c.left_below), 2)} mm/s "
        f"after (95 %, if installed exactly); grade G of ISO 21940-11 where the rotor behaves as rigid.{hint}"
    )


def _grams(c: Correction) -> tuple[float, float]:
    """Mass of a correction at the plane's radius, and half of its 95 % interval [g]."""
    mass, error = c.mass_at_radius(c.size), c.mass_at_radius(c.unbalance.half_interval or 0.0)
    return (mass or 0.0) / GRAM, (error or 0.0) / GRAM


def _holes(c: Correction) -> str:
    """Masses in holes, to the decimals that the correction's error bears; those that round to nothing left out."""
    error = _grams(c)[1]
    decimals = decimals_of(error) if error > 0.0 else 3
    parts = [(f"{part.mass_kg / GRAM:.{decimals}f}", part) for part in c.in_holes]
    return " and ".join(
        f"{mass} g in hole {part.hole} (at {part.angle_deg:g}°)" for mass, part in parts if float(mass) > 0.0
    )


def influence_lines(measurement: Measurement, rig: Rig) -> list[str]:
    """The correction by influence coefficients, which need no rotor model, in sentences; none where the runs do not
    determine it. For planes with nearly proportional influence vectors there is one correction each.
    """
    together = measured_influence(measurement)
    if together is None:
        return []
    names = [list(rig.planes)[plane] for plane in weighted_planes(measurement)]
    alone = [measured_influence(measurement, using=(k,)) for k in range(len(names))]
    alike = any(
        fault.largest_error > ENTANGLED * one.unbalance[0].largest_error
        for fault, one in zip(together.unbalance, alone, strict=True)
        if one is not None and fault.covariance is not None
    )
    if not alike:
        return [_influence_line(together, names, rig)]
    said = [_influence_line(one, [f"{name} alone"], rig) for name, one in zip(names, alone, strict=True) if one]
    planes = " and ".join(names)
    return [*said, f"The influence vectors of {planes} are nearly proportional: one correction each, either will do."]


def _influence_line(found: InfluenceBalance, names: list[str], rig: Rig) -> str:
    """One answer of influence coefficients in a sentence. **Arguments:** ``names`` of the planes."""
    without = "By influence coefficients, without the rotor model: "
    if len(names) == 1 and found.unbalance[0].covariance is not None and not found.unbalance[0].differs_from_zero:
        bound = number(found.unbalance[0].below / GRAM_MILLIMETRE, 2)
        return f"{without}no correction in plane {names[0]}, the unbalance is below {bound} g mm (95 %)."
    parts = [f"{_opposite(fault, rig)} in plane {name}" for name, fault in zip(names, found.unbalance, strict=True)]
    before, after = _rms_um(found)
    if after > HARDLY_LESS * before:
        return (
            f"{without}no correction in {' and '.join(f'plane {name}' for name in names)} reduces the vibration at 1X."
        )
    said = (
        f"{without}correction {' and '.join(parts)}. It leaves {number(after, 2)} of {number(before)} µm at 1X (0-pk, "
        "rms over probes and speeds). That minimises the reading: the response to a bow and runout are compensated too."
    )
    if found.linear is False:
        said += (
            f" But the runs differ by {number(np.sqrt(found.reduced_chi2 or 0.0))} times the noise from what is linear "
            "in the weights: scatter between mountings, a weight stated wrongly, or a rotor that is not linear."
        )
    return said


def _rms_um(found: InfluenceBalance) -> tuple[float, float]:
    """Of the vibration without weights, and with the correction."""
    before, after = (float(np.sqrt(np.mean(np.abs(z) ** 2))) / MICROMETRE for z in (found.initial, found.left))
    return before, after


def _opposite(unbalance: Fault, rig: Rig) -> str:
    """The weight against an unbalance."""
    if unbalance.covariance is not None and not unbalance.differs_from_zero:
        return f"not different from zero, below {number(unbalance.below / GRAM_MILLIMETRE, 2)} g mm,"
    size, error = value_and_error(unbalance.magnitude, unbalance.half_interval, GRAM_MILLIMETRE)
    at = rig.convention.angle_deg(unbalance.pair) + 180.0
    angle, turn = angle_and_error(at, unbalance.angle_half_interval_deg)
    return f"{size} g mm at {angle}°" if error == "-" else f"{size} ± {error} g mm at {angle}° ± {turn}°"


def influence_json(measurement: Measurement, rig: Rig) -> dict[str, Any] | None:
    """The same for JSON."""
    found = measured_influence(measurement)
    if found is None:
        return None
    names, planes = list(rig.planes), {}
    for plane, fault in zip(weighted_planes(measurement), found.unbalance, strict=True):
        angle, half = rig.convention.angle_deg(fault.pair) % 360.0, fault.half_interval
        planes[names[plane]] = {
            "unbalance_g_mm": fault.magnitude / GRAM_MILLIMETRE,
            "angle_deg": angle,
            "correction_angle_deg": (angle + 180.0) % 360.0,
            "half_interval_g_mm": None if half is None else half / GRAM_MILLIMETRE,
            "angle_half_interval_deg": fault.angle_half_interval_deg,
            "differs_from_zero": None if half is None else fault.differs_from_zero,
        }
    before, after = _rms_um(found)
    return {"planes": planes, "rms_before_um": before, "rms_after_um": after, "reduced_chi2": found.reduced_chi2}


def predicted_table(model: Model, correction: Correction, speeds_rpm: np.ndarray) -> Table:
    """Vibration at 1X with nothing installed, before and after a correction, at some of the speeds measured."""
    picked = np.unique(np.linspace(0, len(speeds_rpm) - 1, min(MOST_SPEEDS, len(speeds_rpm))).round().astype(int))
    speeds, first = speeds_rpm[picked], model.layout.orders.index(1.0)
    vectors = predicted(model, correction, speeds)
    before = np.abs(vectors.before[:, :, first]) / MICROMETRE
    after = (np.abs(vectors.after) + vectors.error)[:, :, first] / MICROMETRE
    headers = ["rpm", *(f"{probe} {when} µm" for probe in model.layout.probes for when in ("before", "after, below"))]
    rows = [
        [
            f"{speed:.0f}",
            *(cell for p in range(before.shape[1]) for cell in (number(before[k, p]), number(after[k, p], 2))),
        ]
        for k, speed in enumerate(speeds)
    ]
    return Table(
        f"Vibration at 1X predicted with the correction in plane {correction.name}, nothing else installed",
        headers,
        rows,
        "After: the bound (95 %) that the error of the unbalance leaves, with the correction installed exactly. Errors "
        "of the other parameters and measurement noise come on top.",
    )


def balance_json(found: Balance) -> dict[str, dict[str, Any]]:
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
            "standard_error_g": grams(c.unbalance.standard_error or 0.0, c),
            "standard_error_g_mm": (c.unbalance.standard_error or 0.0) / GRAM_MILLIMETRE,
            "half_interval_g": grams(c.unbalance.half_interval or 0.0, c),
            "half_interval_g_mm": (c.unbalance.half_interval or 0.0) / GRAM_MILLIMETRE,
            "angle_half_interval_deg": c.unbalance.angle_half_interval_deg,
            "holes": [
                {"hole": part.hole, "angle_deg": part.angle_deg, "mass_g": part.mass_kg / GRAM} for part in c.in_holes
            ],
            "against": ["residual_unbalance", *c.beside],
            "grade_before": None if c.beside else c.grade(c.size),
            "grade_after": None if c.beside else c.grade(c.left),
            "grade_after_below": None if c.beside else c.grade(c.left_below),
            "grade_speed_rpm": c.speed / RPM,
        }
        for c in found.corrections
    }
