"""What people read of a correction: the mass, where it goes, and what is left."""

import math
from typing import Any

import numpy as np

from rotorjax.data.measurement import Measurement
from rotorjax.data.rig import Rig
from rotorjax.diagnosis.balancing import Correction, predicted
from rotorjax.diagnosis.influence_coefficients import InfluenceBalance, measured_influence, weighted_planes
from rotorjax.diagnosis.separability import ENTANGLED
from rotorjax.model.model import Model
from rotorjax.reporting.intervals import angle_and_error, decimals_of, value_and_error
from rotorjax.reporting.tables import Table, number
from rotorjax.reporting.to_correct import Balance
from rotorjax.units import GRAM_MILLIMETRE, MICROMETRE, RPM

GRAM = 1e-3
MOST_SPEEDS = 12
"""Speeds at which the vibration after the correction is predicted."""
HARDLY_LESS = 0.95
"""Share of the vibration from which on a correction by influence coefficients leaves as much as there was."""
DIFFER = 0.05
"""Share of an unbalance by which two values of it differ at least to be said to."""


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
    hint = "" if c.plane.radius_m is not None else f" For a mass in grams give radius_mm under [planes.{c.name}]."
    angle, turn = angle_and_error(c.correction_angle_deg, c.unbalance.angle_half_interval_deg)
    sense = c.convention.weight_angles.replace("-", " the ")
    holes = f", that is {held}" if (held := _holes(c)) else ""
    put = f"To balance{proviso}: correction {_amount(c)} at {angle}° ± {turn}° from +x {sense} {where}"
    if c.beside:
        return f"{put}{holes}.{hint}"
    opposite = angle_and_error(c.angle_deg, c.unbalance.angle_half_interval_deg)[0]
    return (
        f"{put} (opposite the unbalance at {opposite}°){holes}. Specific unbalance times speed at {c.speed / RPM:.0f} "
        f"rpm ({c.speed_is}): {number(c.grade(c.size))} mm/s before, below {number(c.grade(c.left_below), 2)} mm/s "
        f"after (95 %, if installed exactly); grade G of ISO 21940-11 where the rotor behaves as rigid.{hint}"
    )


def _amount(c: Correction) -> str:
    """As a mass, if the radius of its plane is stated, with half of its 95 % interval, if that is known."""
    half, radius = c.unbalance.half_interval, c.plane.radius_m
    unit = GRAM_MILLIMETRE if radius is None else GRAM * radius
    size, error = value_and_error(c.size, half, unit)
    said = "g mm" if radius is None else f"g at a radius of {1e3 * radius:g} mm,"
    return f"{size} {said}" if half is None else f"{size} ± {error} {said}"


def _holes(c: Correction) -> str:
    """Masses in holes, to the decimals that the correction's error bears; those that round to nothing left out."""
    if c.unbalance.covariance is not None and not c.unbalance.differs_from_zero:
        return ""
    error = (c.mass_at_radius(c.unbalance.half_interval or 0.0) or 0.0) / GRAM
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
    said = [_influence_line(one, [name], rig, alone=True) for name, one in zip(names, alone, strict=True) if one]
    planes = " and ".join(names)
    return [*said, f"The influence vectors of {planes} are nearly proportional: one correction each, either will do."]


def differ_lines(balance: Balance, measurement: Measurement, rig: Rig) -> list[str]:
    """That corrections by the rotor model and by influence coefficients contradict each other, in a sentence."""
    own = {correction.name: correction.unbalance for correction in balance.corrections}
    for k, plane in enumerate(weighted_planes(measurement)):
        name, alone = list(rig.planes)[plane], measured_influence(measurement, using=(k,))
        if alone is None or name not in own:
            continue
        one, other = own[name], alone.unbalance[0]
        if one.covariance is None or other.covariance is None:
            continue
        apart = one._replace(pair=one.pair - other.pair, covariance=one.covariance + other.covariance)
        if apart.differs_from_zero and apart.magnitude > DIFFER * one.magnitude:
            return [
                f"The two differ by {number(apart.magnitude / GRAM_MILLIMETRE, 2)} g mm in plane {name}, more than "
                "their errors: the rotor, or its weights, may not be as the rig file states (`rotorjax explain` looks "
                "for what is missing). Influence coefficients need no rotor."
            ]
    return []


def _influence_line(found: InfluenceBalance, names: list[str], rig: Rig, *, alone: bool = False) -> str:
    """One answer of influence coefficients in a sentence. **Arguments:** ``names`` of the planes; ``alone``: whether
    other planes could do it, too.
    """
    said_of = {name: f"plane {name}{' alone' if alone else ''}" for name in names}
    without = "By influence coefficients, without the rotor model: "
    if len(names) == 1 and found.unbalance[0].covariance is not None and not found.unbalance[0].differs_from_zero:
        bound = number(found.unbalance[0].below / GRAM_MILLIMETRE, 2)
        return f"{without}no correction in {said_of[names[0]]}, the unbalance is below {bound} g mm (95 %)."
    every = [
        Correction(name, rig.planes[name], fault, math.nan, math.nan, rig.convention)
        for name, fault in zip(names, found.unbalance, strict=True)
    ]
    parts = [f"{_opposite(one)} in {said_of[one.name]}" for one in every]
    before, after = _rms_um(found)
    if after > HARDLY_LESS * before:
        return f"{without}no correction in {' and '.join(said_of.values())} reduces the vibration at 1X."
    holes = [f" In plane {one.name} that is {held}." for one in every if (held := _holes(one))]
    told = "" if all(one.unbalance.covariance is not None for one in every) else " The error of that is not known."
    said = (
        f"{without}correction {' and '.join(parts)}.{''.join(holes)}{told} It leaves {number(after, 2)} of "
        f"{number(before)} µm at 1X (0-pk, rms over probes and speeds). That minimises the reading: the response to a "
        "bow and runout are compensated too."
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


def _opposite(c: Correction) -> str:
    """The weight against an unbalance."""
    if c.unbalance.covariance is not None and not c.unbalance.differs_from_zero:
        return f"not different from zero, below {number(c.unbalance.below / GRAM_MILLIMETRE, 2)} g mm,"
    angle, turn = angle_and_error(c.correction_angle_deg, c.unbalance.angle_half_interval_deg)
    return f"{_amount(c)} at {angle}°{'' if turn == '-' else f' ± {turn}°'}"


def influence_json(measurement: Measurement, rig: Rig) -> dict[str, Any] | None:
    """The same for JSON."""
    found = measured_influence(measurement)
    if found is None:
        return None
    names, planes = list(rig.planes), {}
    for plane, fault in zip(weighted_planes(measurement), found.unbalance, strict=True):
        angle, half = rig.convention.angle_deg(fault.pair) % 360.0, fault.half_interval
        radius = rig.planes[names[plane]].radius_m
        planes[names[plane]] = {
            "unbalance_g_mm": fault.magnitude / GRAM_MILLIMETRE,
            "angle_deg": angle,
            "correction_angle_deg": (angle + 180.0) % 360.0,
            "correction_g": None if radius is None else fault.magnitude / radius / GRAM,
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
