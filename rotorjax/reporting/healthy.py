"""What a measurement of the healthy rotor gave: a line, a table, JSON."""

from typing import Any

from rotorjax.discovery.healthy import Healthy
from rotorjax.discovery.story import Story
from rotorjax.inference.estimates import NORMAL_QUANTILE
from rotorjax.reporting.tables import Table, number
from rotorjax.reporting.wording import listed, with_error
from rotorjax.units import MICROMETRE

TOO_MUCH = 1.2
"""Times the noise alone from which on the healthy rotor is said to show more than its calibrated model."""


def model_compared(story: Story) -> str:
    """What is held against the measurement before anything is added."""
    return "The model as declared" if story.healthy is None else "The model calibrated on the healthy rotor"


def healthy_lines(story: Story) -> list[str]:
    """What the calibration brought, and what it leaves."""
    healthy = story.healthy
    if healthy is None:
        return []
    before, after = (number(view.rms / MICROMETRE) for view in (healthy.declared, healthy.calibrated))
    noise, chi2 = healthy.calibrated.measurement.noise_rms, healthy.fit.reduced_chi2
    alone = "" if noise is None else f" (noise alone is {number(noise / MICROMETRE)} µm)"
    vectors = int(healthy.calibrated.measurement.present.sum())
    within, changes = (number(100.0 * one, 2) for one in (healthy.tolerance, healthy.tolerance_of_changes))
    lines = [
        f"Healthy rotor, {vectors} vectors: the model as stated differs from it by {before} µm rms, by {after} µm "
        f"once it is fitted to it{alone}. So calibrated it is the model as declared in all that "
        f"follows: what is found has changed since. Its form counts as right within {within} %, "
        f"what has changed within {changes} %."
    ]
    lacking = [p for p in story.measurement.probes_read if p not in healthy.calibrated.measurement.probes_read]
    lacking += [f"{n:g}X" for n in story.measurement.orders if n not in healthy.calibrated.measurement.orders]
    if lacking:
        lines.append(f"The healthy rotor was not read at {listed(lacking)}: there the model is not calibrated.")
    more = noise is None or healthy.calibrated.rms > TOO_MUCH * noise
    if more and chi2 is not None and chi2 > TOO_MUCH**2:
        lines.append(
            f"The healthy rotor shows more than that (reduced chi² {number(chi2)}): what that is "
            "may be taken for a change: explain that measurement first, and put into the rig file what is found."
        )
    return lines


def healthy_table(healthy: Healthy | None) -> Table | None:
    """What was fitted to the healthy rotor."""
    if healthy is None:
        return None
    rows = []
    determined = [e for e in healthy.fit.estimates if e.determined]
    for e in determined:
        unit, relative = e.entry.unit, e.entry.unit.si == "1"
        by, shown = (100.0, "%") if relative else (1.0 / unit.factor, unit.shown)
        error = NORMAL_QUANTILE * e.standard_error
        rows.append([e.entry.key, with_error(by * e.value, by * error), shown])
    note = (
        "Beside the values of the rig file, which has them in SI; what these leave open counts as an error that all "
        f"vectors share. {len(healthy.fit.estimates) - len(determined)} more are not determined by the healthy vectors."
    )
    return Table("The model of the healthy rotor", ["in rig files", "value (95 % interval)", "unit"], rows, note)


def healthy_json(healthy: Healthy | None) -> dict[str, Any] | None:
    """The same as plain numbers."""
    if healthy is None:
        return None
    noise = healthy.calibrated.measurement.noise_rms
    parameters: dict[str, dict[str, Any]] = {}
    for e in healthy.fit.estimates:
        own = parameters.setdefault(e.entry.effect, {})
        own[e.entry.label] = {"value": e.value, "standard_error": e.standard_error, "determined": e.determined}
    return {
        "as_stated_rms_um": healthy.declared.rms / MICROMETRE,
        "rms_um": healthy.calibrated.rms / MICROMETRE,
        "noise_rms_um": None if noise is None else noise / MICROMETRE,
        "reduced_chi2": healthy.fit.reduced_chi2,
        "tolerance": healthy.tolerance,
        "tolerance_of_changes": healthy.tolerance_of_changes,
        "parameters": parameters,
    }
