"""What people read of a diagnosis: unbalance and bow of every run."""

import math
from typing import Any

import numpy as np

from rotorjax.data.measurement import Measurement
from rotorjax.data.rig import Rig
from rotorjax.data.rig_sections import Convention
from rotorjax.diagnosis.fault import Fault
from rotorjax.diagnosis.inverse import Diagnosis, RunDiagnosis
from rotorjax.diagnosis.separability import MODEL_FAILS
from rotorjax.effects.excitation import ResidualUnbalance
from rotorjax.reporting.balance import (
    balance_json,
    balance_lines,
    differ_lines,
    influence_json,
    influence_lines,
)
from rotorjax.reporting.comparison import measurement_line
from rotorjax.reporting.intervals import angle_and_error, together, value_and_error
from rotorjax.reporting.tables import Table, laid_out, number
from rotorjax.reporting.to_correct import balance_of_diagnosis, held_unbalance
from rotorjax.units import GRAM_MILLIMETRE, MICROMETRE

SEPARABLE = "separable from bow"
ANGLE, BOW_ANGLE = "at ° ± 95 %", "bow at ° ± 95 %"
IF_NO_BOW = "unbalance g mm if no bow"
MISFIT = "misfit / noise"


def diagnosis_text(diagnosis: Diagnosis, rig: Rig, measurement: Measurement, *, width: int | None = None) -> str:
    """Everything that `rotorjax diagnose` prints. **Arguments:** ``width``: columns of the terminal, if it is one."""
    parts: list[str | Table] = [measurement_line(measurement), diagnosis_table(diagnosis, rig.convention)]
    if np.any(held := held_unbalance(rig)):
        size = (
            f"{number(float(np.hypot(*held)) / GRAM_MILLIMETRE)} g mm at {rig.convention.angle_deg(held) % 360.0:.0f}°"
        )
        parts.append(
            f"The rig file holds an unbalance of {size} already, under [effects.{ResidualUnbalance.name}]: what is "
            "listed comes on top of it."
        )
    balance = balance_of_diagnosis(diagnosis, rig, measurement)
    parts += [*balance_lines(balance), *influence_lines(measurement, rig), *differ_lines(balance, measurement, rig)]
    return laid_out(parts, width, everything="--json FILE")


def diagnosis_table(diagnosis: Diagnosis, convention: Convention) -> Table:
    """Unbalance and bow of every run, with 95 % intervals, and below it what the table does not say by itself."""
    found = diagnosis.found
    headers = ["run", "unbalance g mm ± 95 %", ANGLE, "bow µm ± 95 %", BOW_ANGLE, SEPARABLE, MISFIT, IF_NO_BOW]
    rows = []
    for run in found:
        cells = [
            *_fault_cells(run.unbalance, GRAM_MILLIMETRE, convention),
            *_fault_cells(run.bow, MICROMETRE, convention),
        ]
        misfit = None if run.reduced_chi2 is None else math.sqrt(run.reduced_chi2)
        separable = "model fails" if run.model_holds is False else "yes" if run.identifiable else "no"
        rows.append([run.run, *cells, separable, number(misfit), _alone(run, convention)])
    title = "Unbalance and bow of every run, with what was installed in it"
    spare = [IF_NO_BOW, MISFIT, BOW_ANGLE, SEPARABLE, ANGLE]
    table = Table(title, headers, rows, "\n".join(_notes(diagnosis)), spare=spare)
    return table.without_empty((MISFIT, IF_NO_BOW))


def _fault_cells(fault: Fault | None, unit: float, convention: Convention) -> list[str]:
    """Size and angle, each with half of its 95 % interval; of what is not different from zero only a bound."""
    if fault is None or fault.covariance is None:
        return ["not determined", "-"]
    if not fault.differs_from_zero:
        return [f"below {number(fault.below / unit, 2)}", "-"]
    angle = angle_and_error(convention.angle_deg(fault.pair), fault.angle_half_interval_deg)
    return [together(value_and_error(fault.magnitude, fault.half_interval, unit)), together(angle)]


def _alone(run: RunDiagnosis, convention: Convention) -> str:
    """The unbalance that would account for the most without any bow, where the two are not separable."""
    alone = run.unbalance_alone
    if alone is None:
        return "-"
    size, _ = value_and_error(alone.magnitude, alone.half_interval, GRAM_MILLIMETRE)
    return f"{size} at {angle_and_error(convention.angle_deg(alone.pair), 10.0)[0]}°"


def _notes(diagnosis: Diagnosis) -> list[str]:
    """Lines below the table: what its words mean, and why something is not determined."""
    lines, found = [], diagnosis.found
    faults = [fault for run in found for fault in (run.unbalance, run.bow) if fault is not None]
    if any(fault.covariance is not None and not fault.differs_from_zero for fault in faults):
        lines.append("below: not different from zero; the vector is smaller than that (95 %), and its angle is open.")
    if diagnosis.inherent:
        lines.append(
            "inherent: the rotor's own unbalance and bow, which the reference runs show beyond what was installed in "
            "them; it is taken off the other runs."
        )
    if any(fault.covariance is not None and math.isfinite(fault.freedom) for fault in faults):
        lines.append(
            "The noise of the readings is not given: ± comes from what the model leaves, and whether the model holds "
            "cannot be checked. Give sigma_um, or repeats."
        )
    failing = [run.run for run in found if run.model_holds is False]
    if failing:
        lines.append(
            f"The model does not hold in {_listed(failing)}: the misfit is above the noise, so that what the model "
            "lacks is counted as unbalance and bow. Do not use these values; `rotorjax explain` looks for what is "
            "missing."
        )
    reasons: dict[str, list[str]] = {}
    for run in found:
        if run.reason and not run.reason.startswith(MODEL_FAILS):
            reasons.setdefault(run.reason, []).append(run.run)
    lines += [f"Unbalance and bow are not separable in {_listed(runs)}: {why}." for why, runs in reasons.items()]
    return lines


def _listed(runs: list[str], most: int = 6) -> str:
    return ", ".join(runs[:most]) + (f" and {len(runs) - most} more" if len(runs) > most else "")


_FAULT_KEYS = (
    "value", "angle_deg", "standard_error", "angle_standard_error_deg",
    "half_interval", "angle_half_interval_deg", "differs_from_zero", "below",
)  # fmt: skip


def diagnosis_json(diagnosis: Diagnosis, rig: Rig, measurement: Measurement) -> dict[str, Any]:
    """What ``diagnose --json`` writes."""
    convention, balance = rig.convention, balance_of_diagnosis(diagnosis, rig, measurement)

    def fault(found: Fault | None, factor: float) -> dict[str, float | bool | None]:
        if found is None:
            return dict.fromkeys(_FAULT_KEYS)
        known = found.covariance is not None
        sizes = [found.magnitude, found.standard_error, found.half_interval, found.below if known else None]
        value, error, half, below = (None if size is None else size * factor for size in sizes)
        angles = found.angle_standard_error_deg, found.angle_half_interval_deg
        differs = found.differs_from_zero if known else None
        told = value, convention.angle_deg(found.pair), error, angles[0], half, angles[1], differs, below
        return dict(zip(_FAULT_KEYS, told, strict=True))

    def run(found: RunDiagnosis) -> dict[str, Any]:
        return {
            "unbalance_g_mm": fault(found.unbalance, 1e6),
            "bow_mm": fault(found.bow, 1e3),
            "identifiable": found.identifiable,
            "reason": found.reason,
            "reduced_chi2": found.reduced_chi2,
            "model_holds": found.model_holds,
            "unbalance_alone_g_mm": fault(found.unbalance_alone, 1e6),
        }

    return {
        "runs": {r.run: run(r) for r in diagnosis.runs},
        "inherent": run(diagnosis.inherent) if diagnosis.inherent else None,
        "balance": balance_json(balance),
        "no_correction": balance.why_none or None,
        "influence_coefficients": influence_json(measurement, rig),
    }
