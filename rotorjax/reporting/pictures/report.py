"""The pictures of a report: caption and SVG of each."""

from typing import Literal

import numpy as np
from matplotlib.figure import Figure

from rotorjax.diagnosis.critical_speeds import critical_speeds_rpm
from rotorjax.discovery.explanation import Explanation
from rotorjax.discovery.named_force import NamedForce
from rotorjax.discovery.story import Story
from rotorjax.reporting import plots
from rotorjax.reporting.curves import declared_curves
from rotorjax.reporting.pictures.orbits import (
    centrelines,
    draw_campbell,
    natural_frequencies_of,
    orbit_cases,
    orbit_view,
    pairs_read,
)
from rotorjax.reporting.pictures.views import (
    draw_before_after,
    draw_fall,
    first_order,
    has_before,
    last_curves,
    shown_runs,
)
from rotorjax.units import MICROMETRE

Phase = Literal["lead", "lag"]
LETTER, SHORT_NAME = 0.07, 4
"""Height of a letter of an upright label [inch], and of how many a map of residuals has room anyway."""
MOST_PLANES = 2
"""Planes of probes whose orbits a report shows."""


def story_pictures(story: Story, phase: Phase = "lead") -> list[tuple[str, bytes]]:
    """Caption and SVG of every view: the fall of the error, Bode, polar, map of residuals.

    **Arguments:** ``phase``: how phases are shown.
    """
    figures = []
    if story.changed:
        figures.append(("The error step by step as effects were added.", _fall(story)))
    subject = "the model with what was added" if story.changed else "the model"
    figures.append((_bode_caption(story), _bode(story, phase)))
    figures.append(
        (
            f"Vectors in the polar plane: each measured one is tied to where {subject} puts it, a cross; the runs in "
            "colour are those above, joined in the order of speed.",
            _polar(story, phase),
        )
    )
    figures += [*_orbits(story), *_campbell(story)]
    figures.append(
        (
            "Size of the residual by run, speed and probe"
            + (", before and after" if story.changed else "")
            + "; grey: not measured.",
            _maps(story),
        )
    )
    return [(caption, plots.svg(drawn)) for caption, drawn in figures]


def _bode_caption(story: Story) -> str:
    """What is drawn, and which runs why."""
    runs, every = shown_runs(story.last), len(story.measurement.runs)
    which = "" if len(runs) == every else f" Of {every} runs those from the largest vibration to the least."
    lines = "the model with what was found" if story.changed else "the model"
    if has_before(story):
        lines = "as declared (dashed) and with what was added (solid, with its 95 % band)"
    return f"Amplitude and phase over speed: measured (dots), {lines}; dotted: critical speeds.{which}"


def first_pictures(story: Story) -> list[tuple[str, bytes]]:
    """What is seen first: the fall of the error, and amplitude over speed before and after, of the run with the largest
    vibration.
    """
    before_after = _before_after(story)
    if not story.changed:
        return [("Amplitude over speed: measured (dots) and the model (line).", plots.svg(before_after))]
    drawn, (axes,) = plots.figure(5.4, 2.5)
    draw_fall(axes, story, short=True)
    return [
        (
            "Amplitude over speed: measured (dots), the model as declared (dashed) and with what was added (line)."
            if has_before(story)
            else "Amplitude over speed: measured (dots) and the model with what was found (line).",
            plots.svg(before_after),
        ),
        ("The error as effects were added; diamonds: on data held out.", plots.svg(drawn)),
    ]


def explanation_pictures(found: Explanation, phase: Phase = "lead") -> list[tuple[str, bytes]]:
    """The same, and the force that is missing, where it was shown."""
    pictures = story_pictures(found.story, phase)
    named = found.named_force
    if named is not None and named.force.reason is None:
        beside = f"the model with {' and '.join(named.beside)}" if named.beside else "the model as declared"
        caption = (
            f"The force that acts on the rotor beside {beside}, from the measured orders, with a band of one standard "
            "error."
        )
        pictures.insert(0, (caption, plots.svg(_missing_force(named))))
    return pictures


def _missing_force(named: NamedForce) -> Figure:
    drawn, axes = plots.figure(12.0, 6.4, 2, 3)
    for dof in (0, 1):
        for k, over in enumerate(("displacement", "velocity", "angle")):
            plots.missing_force(axes[3 * dof + k], named.force, over=over, dof=dof, legend=dof == 0 and k == 0)  # pyright: ignore
    return drawn


def headline_figure(story: Story) -> Figure:
    """The story in one picture: every vector of the last probe read before and after, and the fall of the error
    between.
    """
    m = story.measurement
    drawn, (before, fall, after) = plots.figure(15.0, 4.4, 1, 3)
    probe, order = m.probes_read[-1], m.orders[0]
    plots.polar(before, story.declared, probe=probe, order=order).set_title("as declared")
    draw_fall(fall, story, short=True)
    plots.polar(after, story.last, probe=probe, order=order).set_title("with what was added")
    before.legend(fontsize=8)
    return drawn


def _fall(story: Story) -> Figure:
    drawn, (axes,) = plots.figure(9.2, 3.4)
    draw_fall(axes, story)
    return drawn


def _before_after(story: Story) -> Figure:
    drawn, (axes,) = plots.figure(5.4, 2.9)
    draw_before_after(axes, story)
    return drawn


def _bode(story: Story, phase: Phase) -> Figure:
    m, order, runs, lag = story.measurement, first_order(story.measurement), shown_runs(story.last), phase == "lag"
    after = {run: last_curves(story, run) for run in runs}
    before = {run: declared_curves(story.model, m, run) for run in runs} if has_before(story) else None
    critical = critical_speeds_rpm(story.final_model)
    count = len(m.probes_read)
    drawn, axes = plots.figure(4.6 * max(count, 2), 6.0, 2, count)
    for k, probe in enumerate(m.probes_read):
        at = m.probes.index(probe), m.orders.index(order)
        plots.bode(
            axes[k],
            axes[count + k],
            story.last,
            {run: curve.of(*at, lag=lag) for run, curve in after.items()},
            probe=probe,
            order=order,
            before=None if before is None else {run: curve.of(*at, lag=lag) for run, curve in before.items()},
            critical_rpm=list(critical),
        )
    handles, labels = axes[0].get_legend_handles_labels()
    drawn.legend(handles, labels, loc="outside upper center", ncols=len(runs), fontsize=8)
    return drawn


def _polar(story: Story, phase: Phase) -> Figure:
    m = story.measurement
    count = len(m.probes_read)
    drawn, axes = plots.figure(4.6 * max(count, 2), 4.6, 1, count)
    for each, probe in zip(axes, m.probes_read, strict=True):
        plots.polar(each, story.last, probe=probe, order=first_order(m), runs=shown_runs(story.last), phase=phase)
    handles, labels = axes[0].get_legend_handles_labels()
    drawn.legend(handles, labels, loc="outside upper center", ncols=3, fontsize=8)
    return drawn


def _orbits(story: Story) -> list[tuple[str, Figure]]:
    """Orbits at the critical speeds or the largest responses, a row for each pair of probes; the full spectrum where
    several orders were measured; the shaft centreline where 0X was.
    """
    view, model, figures = story.last, story.final_model, []
    critical = [one.speed_rpm for one in story.lateral.critical_speeds or ()]
    pairs = pairs_read(story)[:MOST_PLANES]
    rows = [[orbit_view(view, model, case, pair) for case in orbit_cases(view, pair, critical)] for pair in pairs]
    rows = [row for row in rows if row]
    if rows:
        columns = max(map(len, rows))
        drawn, axes = plots.figure(max(3.8 * columns, 7.6), 4.4 * len(rows), len(rows), columns)
        spectra, bars = plots.figure(max(3.8 * columns, 7.6), 2.8 * len(rows), len(rows), columns)
        for r, row in enumerate(rows):
            for c in range(columns):
                path, bar = axes[r * columns + c], bars[r * columns + c]
                if c >= len(row):
                    path.set_axis_off()
                    bar.set_axis_off()
                    continue
                plots.orbit(path, row[c].measured, row[c].model, probes=row[c].probes)
                plots.full_spectrum(bar, row[c].measured, row[c].model)
                for each in (path, bar):
                    plane = f", {' and '.join(map(plots.plain, row[c].probes))}" if len(rows) > 1 else ""
                    each.set_title(row[c].title + plane, fontsize=9, loc="left")
        which = "Nearest to the critical speeds, then where the vibration is largest."
        figures.append((f"{plots.CAPTIONS['orbit']} {which}", drawn))
        if any(sum(order > 0.0 for order in one.measured.orders) > 1 for row in rows for one in row):
            figures.append((f"{plots.CAPTIONS['full_spectrum']} Readings as above.", spectra))
    lines = [found for pair in pairs if (found := centrelines(view, model, pair, shown_runs(view)))]
    if lines:
        drawn, axes = plots.figure(max(4.6 * len(lines), 7.6), 4.2, 1, len(lines))
        for each, found in zip(axes, lines, strict=True):
            plots.centreline(each, found)
        figures.append((plots.CAPTIONS["centreline"], drawn))
    return figures


def _campbell(story: Story) -> list[tuple[str, Figure]]:
    """The Campbell diagram, where natural frequencies are known."""
    found = natural_frequencies_of(story)
    if found is None:
        return []
    drawn, (axes,) = plots.figure(9.2, 4.2)
    draw_campbell(axes, story, found)
    caption = plots.CAPTIONS["campbell"]
    if found[1] is not None:
        caption = f"{caption} Thin, dashed: as declared."
    if story.lateral.linearised:
        caption = f"{caption} Nonlinear and time-periodic forces are left out."
    return [(caption, drawn)]


def _maps(story: Story) -> Figure:
    views = [("as declared", story.declared), *([("with what was added", story.last)] if story.changed else [])]
    longest = max(len(plots.plain(probe)) for probe in story.measurement.probes_read)
    height = max(2.6, 0.6 + 0.2 * len(story.measurement.runs)) + LETTER * max(0, longest - SHORT_NAME)
    drawn, axes = plots.figure(10.0, height, 1, len(views))
    sizes = np.concatenate([np.abs(v.residual[v.present]) for _, v in views]) / MICROMETRE
    positive = sizes[sizes > 0.0]
    limits = (float(np.quantile(positive, 0.05)), float(positive.max()) * 1.0001) if len(positive) else None
    for each, (title, view) in zip(axes, views, strict=True):
        plots.residual_map(each, view, limits_um=limits)
        each.set_title(title, fontsize=10)
    return drawn
