"""`explain` as one case of many: a table and a rig file, or a rig file and its recordings, become a row."""

from pathlib import Path
from typing import Any, NamedTuple

from rotorjax.compilation import spare_memory, use_double_precision
from rotorjax.data.names import harmless
from rotorjax.data.record_vectors import read_recordings
from rotorjax.data.rig import Rig, read_measurement, read_rig
from rotorjax.discovery.explain import explain
from rotorjax.discovery.explanation import Explanation
from rotorjax.errors import InputError
from rotorjax.reporting.explanation import readings_in_words
from rotorjax.reporting.explanation_json import explanation_json
from rotorjax.reporting.results import write_report
from rotorjax.reporting.sizes import sizes
from rotorjax.reporting.wording import plain_name, with_error

TEXT, NUMBER, WHOLE, NAMES = "text", "number", "whole", "names"
"""Kinds of a column: text, number, whole number, list of texts. A list of records is a mapping of its keys to kinds."""
_BALANCE = dict.fromkeys(
    (
        "unbalance_g_mm",
        "half_interval_g_mm",
        "correction_angle_deg",
        "correction_g",
        "half_interval_g",
        "grade_before",
        "grade_after_below",
    ),
    NUMBER,
)
"""Of a correction, as in ``explain --json``."""
COLUMNS: dict[str, str | dict[str, str]] = {
    "name": TEXT,
    "data": TEXT,
    "rig": TEXT,
    "verdict": TEXT,
    "sentence": TEXT,
    "effects": NAMES,
    "probability": NUMBER,
    "probable": {"effects": TEXT, "probability": NUMBER},
    "written_down_wrongly": TEXT,
    "change": TEXT,
    "probabilities": {"beside": TEXT, "effect": TEXT, "probability": NUMBER},
    "sizes": {"effect": TEXT, "parameter": TEXT, "value": NUMBER, "low": NUMBER, "high": NUMBER},
    "sizes_in_words": NAMES,
    "error_before_um": NUMBER,
    "error_after_um": NUMBER,
    "error_held_out_um": NUMBER,
    "p_value": NUMBER,
    "ties": NAMES,
    "detected_but_small": NAMES,
    "missing_force": NAMES,
    "next_measurement": TEXT,
    "next_run": TEXT,
    "next_speed_rpm": NUMBER,
    "next_new_probes": NAMES,
    "next_separates": NAMES,
    "balance": {"plane": TEXT, **_BALANCE},
    "balance_in_words": NAMES,
    "no_correction": TEXT,
    "linearisations": WHOLE,
    "seconds": NUMBER,
    "notes": NAMES,
    "report": TEXT,
    "failure": TEXT,
}
"""Columns of the results -> kind. Sizes are in SI, the unit at the end of the parameter's name, with the ends of the
95 % interval; errors are rms |residual|.
"""
PERCENT = 0.01
"""Probabilities below are not listed."""


class Task(NamedTuple):
    """One table and its rig file, or one rig file with recordings, and how they are explained."""

    data: Path | None
    """None where vectors come from the recordings that the rig file names."""
    rig: Path | None
    """None where there is none."""
    report: Path | None = None
    """Where a report is written, if at all."""
    max_effects: int = 3
    only: tuple[str, ...] | None = None
    exclude: tuple[str, ...] = ()
    mistakes: bool | None = None
    """Whether mistakes in rig file and table are raced: always, never, or where nothing else explains the data."""
    limit: int | None = None
    """Linearisations allowed; by default as many as `explain` allows."""


def explain_case(task: Task) -> dict[str, Any]:
    """The row of one case: what was found, or under ``failure`` the message that `explain` has for bad input."""
    use_double_precision()
    row: dict[str, Any] = {"data": _path(task.data), "rig": _path(task.rig)}
    try:
        return {**row, **_explained(task)}
    except InputError as error:
        return {**row, "failure": harmless("\n".join(error.shown()))}
    finally:
        spare_memory()


def _explained(task: Task) -> dict[str, Any]:
    if task.rig is None:
        assert task.data is not None
        raise InputError(
            f"{task.data}: no rig file; neither {task.data.with_suffix('.toml').name} nor rig.toml is beside it: "
            "put one there, or give a list with the columns data,rig"
        )
    rig = read_rig(task.rig)
    measurement = read_recordings(rig).measurement(rig) if task.data is None else read_measurement(task.data, rig)
    rig.check_only(task.only or (), measurement)
    found = explain(
        rig.model,
        measurement,
        max_effects=task.max_effects,
        limit=task.limit,
        only=task.only,
        exclude=task.exclude,
        mistakes=task.mistakes,
        healthy=rig.of_healthy(task.data),
    )
    if task.report:
        _write_report(
            task.report,
            found,
            rig,
            f"{(task.data or task.rig).name}: what {'the model' if task.data is None else task.rig.name} lacks",
        )
    told = [harmless(note) for note in measurement.notes]
    return {**row_of(found, rig), "notes": told, "report": _path(task.report)}


def _path(path: Path | None) -> str | None:
    """A path as text; what is no character of it, as some file systems have, is written out."""
    return None if path is None else harmless(str(path))


def _write_report(path: Path, found: Explanation, rig: Rig, title: str) -> None:
    """**Errors.** `OSError`, which is no fault of the input: such a case is tried again."""
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        write_report(path, found, rig, title=title)
    except InputError as error:
        raise OSError(str(error)) from error


def row_of(found: Explanation, rig: Rig) -> dict[str, Any]:
    """An explanation as one flat row, from what ``explain --json`` writes."""
    told = explanation_json(found, rig)
    last, further, wrong = told["steps"][-1], told["next_measurement"] or {}, told["written_down_wrongly"] or {}
    return {
        "verdict": told["verdict"],
        "sentence": told["sentence"],
        "effects": told["effects"],
        "probability": told["probability"],
        "probable": [{**one, "effects": " + ".join(one["effects"]) or "none"} for one in told["probable"]],
        "written_down_wrongly": wrong.get("name"),
        "change": wrong.get("change"),
        "probabilities": _probabilities(told["steps"]),
        **_sizes(found, rig),
        "error_before_um": 1e6 * found.story.declared.rms,
        "error_after_um": last["rms_um"],
        "error_held_out_um": last["held_out_rms_um"],
        "p_value": told["p_value"],
        "ties": [" or ".join(" + ".join(names) for names in group) for group in told["ties"]],
        "detected_but_small": [small["effect"] for small in told["detected_but_small"]],
        "missing_force": [term["words"] for term in (told["missing_force"] or {}).get("terms", [])],
        "next_measurement": None if found.next_measurement is None else readings_in_words(found.next_measurement),
        "next_run": further.get("run"),
        "next_speed_rpm": further.get("speed_rpm"),
        "next_new_probes": further.get("new_probes", []),
        "next_separates": further.get("separates", []),
        **_balance(told["balance"], doubtful=found.verdict == "unexplained"),
        "no_correction": told["no_correction"],
        "linearisations": told["cost"]["linearisations"],
    }


def _probabilities(steps: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """What was raced at every step, beside what was added before."""
    listed, beside = [], []
    for step in steps:
        if step["added"] is not None:
            beside.append(step["added"])
        listed += [
            {"beside": " + ".join(beside), "effect": ranked["effect"], "probability": ranked["probability"]}
            for ranked in step["ranking"]
            if ranked["probability"] >= PERCENT
        ]
    return listed


def _sizes(found: Explanation, rig: Rig) -> dict[str, Any]:
    """Parameters of the effects found with 95 % intervals, in numbers and in words."""
    fitted = found.story.fits[-1]
    own = [e for e in fitted.estimates if e.entry.effect in found.effects]
    told = [
        {
            "effect": e.entry.effect,
            "parameter": e.entry.label,
            "value": e.value,
            "low": e.value - fitted.quantile * e.standard_error,
            "high": e.value + fitted.quantile * e.standard_error,
        }
        for e in own
    ]
    convention = rig.put_right(found.mistake).convention
    words = [f"{plain_name(s.effect)}: {s.what} {s.value}" for s in sizes(fitted, found.effects, convention)]
    return {"sizes": told, "sizes_in_words": words}


def _balance(told: dict[str, dict[str, Any]], *, doubtful: bool) -> dict[str, Any]:
    """Corrections by plane, in numbers and in words. **Arguments:** ``doubtful``: whether the data are unexplained."""
    doubt = ", although the data are not explained" if doubtful else ""
    rows = [{"plane": plane, **{key: one[key] for key in _BALANCE}} for plane, one in told.items()]
    words = []
    for row in rows:
        unit = "g_mm" if row["correction_g"] is None else "g"
        mass = with_error(row["unbalance_g_mm" if unit == "g_mm" else "correction_g"], row[f"half_interval_{unit}"])
        words.append(
            f"{mass} {unit.replace('_', ' ')} at {row['correction_angle_deg']:.0f}° in plane {row['plane']}{doubt}"
        )
    return {"balance": rows, "balance_in_words": words}
