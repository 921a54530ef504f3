"""Results as people hold them: a summary, a report, pictures by name, and what a notebook shows."""

import html as escaping
from pathlib import Path
from typing import Any

import numpy as np

from rotorjax.data.files import write_whole
from rotorjax.data.measurement import Measurement
from rotorjax.data.names import harmless
from rotorjax.data.record_vectors import Records
from rotorjax.data.rig import Rig
from rotorjax.data.rig_sections import Convention
from rotorjax.diagnosis.inverse import Diagnosis
from rotorjax.discovery.compare import Comparison
from rotorjax.discovery.explanation import Explanation
from rotorjax.discovery.fit import Fit
from rotorjax.discovery.story import Story
from rotorjax.model.model import Model
from rotorjax.reporting import pictures
from rotorjax.reporting.comparison import (
    comparison_page,
    comparison_text,
    measurement_line,
    parameter_table,
    share_table,
    sizes_by_effect,
    worst_cells,
)
from rotorjax.reporting.diagnosis import diagnosis_table
from rotorjax.reporting.explanation import explanation_page, explanation_text, headline
from rotorjax.reporting.frames import parts_of
from rotorjax.reporting.page import Headline, html_report
from rotorjax.reporting.pictures.recorded import recorded_pictures
from rotorjax.reporting.tables import Table, number
from rotorjax.units import GRAM_MILLIMETRE, MICROMETRE

COLOURS = {"explained": "#23703f", "nothing missing": "#23703f", "undecided": "#9a6100", "unexplained": "#ab2b2b"}
"""Of a verdict, as in the report."""


def summary(result: Any, rig: Rig | None = None) -> str:
    """What the command line prints of a result."""
    if isinstance(result, Explanation):
        return explanation_text(result, rig)
    if isinstance(result, Story):
        return comparison_text(result, None if rig is None else rig.put_right(result.mistake).convention)
    if isinstance(result, Measurement):
        return measurement_line(result)
    if isinstance(result, Diagnosis):
        return diagnosis_table(result, Convention() if rig is None else rig.convention).text()
    return "\n\n".join(
        [*([] if isinstance(result, Model) else [repr(result)]), *(table.text() for table in _tables(result))]
    )


def write_report(
    path: Path,
    result: Explanation | Story,
    rig: Rig | None = None,
    *,
    title: str = "",
    records: Records | None = None,
) -> Path:
    """Write the HTML report of a comparison or of an explanation."""
    convention = Convention() if rig is None else rig.put_right(result.mistake).convention
    recorded = recorded_pictures(rig, records) if rig is not None and records is not None else []
    if isinstance(result, Story):
        first = pictures.first_pictures(result)
        page = comparison_page(
            result,
            title=title or "Model and measurement",
            pictures=[*pictures.story_pictures(result, convention.phase), *recorded],
            first=first,
            convention=convention,
        )
    else:
        first = pictures.first_pictures(result.story)
        every = [*pictures.explanation_pictures(result, convention.phase), *recorded]
        page = explanation_page(result, title=title or "What the model lacks", pictures=every, first=first, rig=rig)
    write_whole(path, html_report(page))
    return path


def html(result: Any) -> str:
    """What a notebook shows of a result."""
    if isinstance(result, Explanation):
        return _headline(headline(result, []))
    if isinstance(result, Story):
        names = tuple(dict.fromkeys(result.additions))
        found = sizes_by_effect(result.fits[-1], names, None) if result.fits else []
        return _headline(Headline("compared", comparison_text(result).split("\n\n")[1], "", found, [], []))
    line = (
        ""
        if isinstance(result, Model | Diagnosis)
        else measurement_line(result)
        if isinstance(result, Measurement)
        else repr(result)
    )
    return (f"<p>{_escaped(line)}</p>" if line else "") + "".join(_table(table) for table in _tables(result))


def _escaped(text: str) -> str:
    """Text for HTML, control characters written out."""
    return escaping.escape(harmless(text))


def _headline(top: Headline) -> str:
    """Verdict, sizes and what to do, without pictures."""
    style = f"color:#fff;background:{COLOURS.get(top.verdict, '#516170')};padding:.1em .6em;border-radius:.3em"
    badge = f'<span style="{style}"><b>{_escaped(top.verdict)}</b></span>'
    rows = [[name, size.what, size.value] for name, _, found in top.effects for size in found]
    sizes = _table(Table("", ["effect", "size of", "value (95 % interval)"], rows)) if rows else ""
    lines = "".join(f"<p>{_escaped(line)}</p>" for line in (top.fall, *top.lines) if line)
    return f"{badge} {_escaped(top.sentence)}{sizes}{lines}"


def _table(table: Table) -> str:
    heads = "".join(f'<th style="text-align:left">{_escaped(head)}</th>' for head in table.headers)
    rows = "".join(
        "<tr>" + "".join(f'<td style="text-align:left">{_escaped(cell)}</td>' for cell in row) + "</tr>"
        for row in table.rows
    )
    caption = f"<caption>{_escaped(table.title)}</caption>" if table.title else ""
    return f"<table>{caption}<thead><tr>{heads}</tr></thead><tbody>{rows}</tbody></table>"


def _tables(result: Any) -> list[Table]:
    """What there is to say of a fit, a comparison, a diagnosis, a model or a measurement in tables."""
    if isinstance(result, Fit):
        return [parameter_table(result)] if result.estimates else []
    if isinstance(result, Comparison):
        return [worst_cells(result, "Where the model fails"), share_table(result, "Share of the misfit")]
    if isinstance(result, Measurement):
        return [_runs(result)]
    if isinstance(result, Diagnosis):
        return [diagnosis_table(result, Convention())]
    return [_effects(result)]


def _runs(m: Measurement) -> Table:
    """Runs of a measurement: speeds, size, what was installed."""
    rows = []
    for k, run in enumerate(m.runs):
        cases = m.run == k
        speed, there = m.speed_rpm[cases], np.abs(m.vectors[cases][m.present[cases]])
        installed = np.linalg.norm(np.asarray(m.conditions.unbalance)[cases][0], axis=-1) / GRAM_MILLIMETRE
        size, speeds = number(float(np.sqrt(np.mean(there**2))) / MICROMETRE), f"{speed.min():.0f} to {speed.max():.0f}"
        rows.append([run, str(int(cases.sum())), speeds, size, ", ".join(map(number, installed))])
    return Table("Runs", ["run", "readings", "rpm", "µm rms", "installed g mm"], rows)


def _effects(model: Model) -> Table:
    """Rotor and effects of a model, in the units that people read."""
    rows = [
        [part, name, number(value, 4) if name.startswith("natural frequency") else number(value), unit]
        for part, name, value, unit in parts_of(model)
    ]
    return Table("Rotor and effects", ["part", "parameter", "value", "unit"], rows)
