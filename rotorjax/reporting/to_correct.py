"""What is to be corrected: the unbalance that was fitted or diagnosed, against all that excites the rotor beside it."""

import dataclasses
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import stdtridf

from rotorjax.data.measurement import Measurement
from rotorjax.data.rig import Rig
from rotorjax.data.rig_sections import Plane
from rotorjax.diagnosis.balancing import Correction
from rotorjax.diagnosis.fault import Fault
from rotorjax.diagnosis.inverse import Diagnosis, RunDiagnosis
from rotorjax.discovery.fit import Fit
from rotorjax.discovery.least_vibration import Left, against, excites_at_1x, together
from rotorjax.effects.excitation import PlaneParticipation, ResidualBow, ResidualUnbalance
from rotorjax.inference.estimates import NORMAL_QUANTILE
from rotorjax.inference.faults import acting_participation
from rotorjax.model.model import Model
from rotorjax.reporting.tables import number
from rotorjax.reporting.wording import said
from rotorjax.units import GRAM_MILLIMETRE, MICROMETRE, RPM

STEP = 1e-3
"""Change of an unknown, in prior scales, by which a derivative is taken."""


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
    return _against(made, least.effects, least.left)


def _against(made: Balance, effects: tuple[str, ...], left: Left) -> Balance:
    """Corrections against an unbalance and other effects together, with what they leave."""
    before, after, alone = (number(size / MICROMETRE) for size in left)
    beside = tuple(name for name in effects if name != ResidualUnbalance.name)
    leaves = (
        f"It leaves the least vibration at 1X against {said(effects)} together: {after} of {before} µm (0-pk, "
        "rms over probes and the speeds measured; without runout). A correction of the residual unbalance alone would "
        f"leave {alone} µm."
    )
    return made._replace(
        corrections=tuple(dataclasses.replace(one, beside=beside) for one in made.corrections), leaves=leaves
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
    """The same for what `diagnose` found: the inherent unbalance and bow, or else those of the first run with nothing
    installed.

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
    unbalance, left = found.unbalance._replace(pair=found.unbalance.pair + held), None
    if found.covariance is not None and found.bow is not None and found.bow.differs_from_zero:
        whose += " and the bow together"
        faults = np.concatenate([unbalance.pair, found.bow.pair])
        pair, by_fault, left = against(rig.model, measurement.speed_cluster()[1], faults)
        unbalance = unbalance._replace(pair=pair, covariance=by_fault @ found.covariance @ by_fault.T)
    planes = {
        name: (plane, unbalance.scaled(1.0 / plane.participation))
        for name, plane in _acting_planes(rig, rig.model).items()
    }
    made = _balance(_ToCorrect(unbalance, float(rig.model.rotor.mass), planes), whose, rig, measurement)
    if left is not None and made.corrections:
        made = _against(made, (ResidualUnbalance.name, ResidualBow.name), left)
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
