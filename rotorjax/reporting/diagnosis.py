"""What people read of a diagnosis: unbalance and bow of every run."""

from typing import Any

import numpy as np

from rotorjax.data.measurement import Measurement
from rotorjax.data.rig import Rig
from rotorjax.data.rig_sections import Convention
from rotorjax.diagnosis.inverse import Diagnosis, Fault, RunDiagnosis
from rotorjax.effects.excitation import ResidualUnbalance
from rotorjax.reporting.balance import balance_json, balance_lines, diagnosed_corrections, held_unbalance
from rotorjax.reporting.comparison import measurement_line
from rotorjax.reporting.tables import Table, laid_out, number
from rotorjax.units import GRAM_MILLIMETRE


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
    parts += balance_lines(diagnosed_corrections(diagnosis, rig, measurement))
    return laid_out(parts, width, everything="--json FILE")


def diagnosis_table(diagnosis: Diagnosis, convention: Convention) -> Table:
    """Unbalance and bow of every run, with standard errors."""
    headers = [
        "run",
        "unbalance g mm",
        "± s.e.",
        "at °",
        "± s.e.",
        "bow mm",
        "± s.e.",
        "at °",
        "± s.e.",
        "told apart",
        "as unbalance alone g mm",
    ]
    found = [*diagnosis.runs, *([diagnosis.inherent] if diagnosis.inherent else [])]
    rows = []
    for run in found:
        alone = run.unbalance_alone
        together = (
            "-" if alone is None else f"{number(alone.magnitude * 1e6)} at {convention.angle_deg(alone.pair):.0f}°"
        )
        cells = [*_fault_cells(run.unbalance, 1e6, convention), *_fault_cells(run.bow, 1e3, convention)]
        rows.append([run.run, *cells, "yes" if run.identifiable else "no", together])
    reasons: dict[str, list[str]] = {}
    for run in found:
        if run.reason:
            reasons.setdefault(run.reason, []).append(run.run)
    lines = [f"Not told apart in {_listed(runs)}: {reason}." for reason, runs in reasons.items()]
    note = "\n".join(lines)
    return Table(
        "Unbalance and bow", headers, rows, note, spare=["as unbalance alone g mm", "told apart", "± s.e.", "at °"]
    )


def _listed(runs: list[str], most: int = 6) -> str:
    return ", ".join(runs[:most]) + (f" and {len(runs) - most} more" if len(runs) > most else "")


def _fault_cells(fault: Fault | None, factor: float, convention: Convention) -> list[str]:
    if fault is None:
        return ["-"] * 4
    error = fault.standard_error
    return [
        number(fault.magnitude * factor),
        number(None if error is None else error * factor, 2),
        f"{convention.angle_deg(fault.pair):.1f}",
        number(fault.angle_standard_error_deg, 2),
    ]


def diagnosis_json(diagnosis: Diagnosis, rig: Rig, measurement: Measurement) -> dict[str, Any]:
    """What ``diagnose --json`` writes."""
    convention = rig.convention

    def fault(found: Fault | None, factor: float) -> dict[str, float | None]:
        if found is None:
            return {"value": None, "angle_deg": None, "standard_error": None, "angle_standard_error_deg": None}
        error = found.standard_error
        return {
            "value": found.magnitude * factor,
            "angle_deg": convention.angle_deg(found.pair),
            "standard_error": None if error is None else error * factor,
            "angle_standard_error_deg": found.angle_standard_error_deg,
        }

    def run(found: RunDiagnosis) -> dict[str, Any]:
        return {
            "unbalance_g_mm": fault(found.unbalance, 1e6),
            "bow_mm": fault(found.bow, 1e3),
            "identifiable": found.identifiable,
            "reason": found.reason,
            "reduced_chi2": found.reduced_chi2,
            "unbalance_alone_g_mm": fault(found.unbalance_alone, 1e6),
        }

    return {
        "runs": {r.run: run(r) for r in diagnosis.runs},
        "inherent": run(diagnosis.inherent) if diagnosis.inherent else None,
        "balance": balance_json(diagnosed_corrections(diagnosis, rig, measurement)),
    }
