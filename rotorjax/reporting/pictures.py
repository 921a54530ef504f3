"""The pictures of a comparison: which views to draw, from which runs; the drawing itself is in `plots`."""

from typing import Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from rotorjax.data.measurement import Measurement
from rotorjax.diagnosis.critical_speeds import critical_speeds_rpm
from rotorjax.discovery.compare import Comparison
from rotorjax.discovery.explain import Explanation
from rotorjax.discovery.named_force import NamedForce
from rotorjax.discovery.story import Story
from rotorjax.reporting import plots
from rotorjax.reporting.comparison import step_labels, steps
from rotorjax.reporting.curves import Curves, declared_curves, fitted_curves
from rotorjax.units import MICROMETRE

Phase = Literal["lead", "lag"]
MOST_RUNS = 3
"""Runs in one Bode plot: more cannot be told apart."""
MOST_SHOWN = 6
"""Effects in a picture of probabilities."""


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
    figures.append(
        (
            "Size of the residual by run, speed and probe"
            + (", before and after" if story.changed else "")
            + "; grey: not measured.",
            _maps(story),
        )
    )
    return [(caption, plots.svg(drawn)) for caption, drawn in figures]


def _has_before(story: Story) -> bool:
    """Whether the model as declared can be drawn beside: not where what was measured, or installed, was put right."""
    return story.changed and story.slip is None


def _bode_caption(story: Story) -> str:
    """What is drawn, and which runs why."""
    runs, every = shown_runs(story.last), len(story.measurement.runs)
    which = "" if len(runs) == every else f" Of {every} runs those from the largest vibration to the least."
    lines = "the model with what was found" if story.changed else "the model"
    if _has_before(story):
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
            if _has_before(story)
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


def draw_fall(axes: Axes, story: Story, *, short: bool = False) -> Axes:
    """The error step by step; ``short``: names of effects in several lines."""
    rows = steps(story)
    labels = [
        label.replace("+ ", "+\n").replace(" values", "\nvalues").replace("as ", "as\n") for label in step_labels(story)
    ]
    if short:
        labels = [label.replace("_", "\n") for label in labels]
    held = [f.held_out_rms / MICROMETRE if f and f.held_out_rms is not None else None for _, f in rows]
    return plots.error_fall(axes, labels, [view.rms / MICROMETRE for view, _ in rows], held, noise_um=story.noise_um())


def shown_runs(view: Comparison) -> list[str]:
    """Runs for a Bode plot, spread from the least to the largest measured vibration."""
    m = view.measurement
    sizes = [
        float(np.sqrt(np.mean(np.abs(m.vectors[m.run == k][m.present[m.run == k]]) ** 2))) for k in range(len(m.runs))
    ]
    ranked = np.argsort(sizes)
    picked = np.unique(np.linspace(0, len(ranked) - 1, min(MOST_RUNS, len(ranked))).round().astype(int))
    return [m.runs[k] for k in ranked[picked][::-1]]


def first_order(m: Measurement) -> float:
    """1X, or the lowest order measured."""
    return 1.0 if 1.0 in m.orders else m.orders[0]


def _before_after(story: Story) -> Figure:
    drawn, (axes,) = plots.figure(5.4, 2.9)
    draw_before_after(axes, story)
    return drawn


def draw_before_after(
    axes: Axes, story: Story, *, run: str | None = None, probe: str | None = None, order: float | None = None
) -> Axes:
    """Amplitude over speed of one run, by default that with the largest vibration: measured, as declared, and with what
    was added.
    """
    m = story.measurement
    run, probe = run or shown_runs(story.last)[0], probe or m.probes_read[-1]
    order = first_order(m) if order is None else order
    curves = {"as declared": declared_curves(story.model, m, run)} if _has_before(story) else {}
    curves |= {"with what was added" if story.changed else "model": _last_curves(story, run)}
    at = m.probes.index(probe), m.orders.index(order)
    shown = {name: curve.of(*at) for name, curve in curves.items()}
    return plots.before_after(axes, story.last, run=run, probe=probe, order=order, curves=shown)


def _last_curves(story: Story, run: str) -> Curves:
    """What the last fit shows, with its band; the model as it is where nothing was fitted."""
    return fitted_curves(story.fits[-1], run) if story.fits else declared_curves(story.model, story.measurement, run)


def _bode(story: Story, phase: Phase) -> Figure:
    m, order, runs, lag = story.measurement, first_order(story.measurement), shown_runs(story.last), phase == "lag"
    after = {run: _last_curves(story, run) for run in runs}
    before = {run: declared_curves(story.model, m, run) for run in runs} if _has_before(story) else None
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
    axes[0].legend(fontsize=8)
    return drawn


def _maps(story: Story) -> Figure:
    views = [("as declared", story.declared), *([("with what was added", story.last)] if story.changed else [])]
    height = max(2.6, 0.6 + 0.2 * len(story.measurement.runs))
    drawn, axes = plots.figure(10.0, height, 1, len(views))
    sizes = np.concatenate([np.abs(v.residual[v.present]) for _, v in views]) / MICROMETRE
    positive = sizes[sizes > 0.0]
    limits = (float(np.quantile(positive, 0.05)), float(positive.max()) * 1.0001) if len(positive) else None
    for each, (title, view) in zip(axes, views, strict=True):
        plots.residual_map(each, view, limits_um=limits)
        each.set_title(title, fontsize=10)
    return drawn


class Plots:
    """Pictures of a comparison or an explanation. Every one returns its axes, new ones where none are given."""

    def __init__(self, result: Explanation | Story) -> None:
        self._found = result if isinstance(result, Explanation) else None
        self._story = result.story if isinstance(result, Explanation) else result

    def error(self, ax: Axes | None = None) -> Axes:
        """The error step by step, with that on data held out."""
        return draw_fall(ax or _new(5.6, 3.2), self._story, short=True)

    def bode(
        self, ax: Axes | None = None, *, run: str | None = None, probe: str | None = None, order: float | None = None
    ) -> Axes:
        """Amplitude over speed of one run, by default that with the largest vibration: measured, as declared, and with
        what was added.
        """
        return draw_before_after(ax or _new(5.6, 3.2), self._story, run=run, probe=probe, order=order)

    def polar(
        self, ax: Axes | None = None, *, probe: str | None = None, order: float | None = None, declared: bool = False
    ) -> Axes:
        """Vectors in the polar plane, each tied to where the model puts it; ``declared``: the model before anything
        was added.
        """
        m, view = self._story.measurement, self._story.declared if declared else self._story.last
        axes = plots.polar(
            ax or _new(4.6, 4.4),
            view,
            probe=probe or m.probes_read[-1],
            order=first_order(m) if order is None else order,
            runs=shown_runs(view),
        )
        axes.legend(fontsize=8)
        return axes

    def residuals(self, ax: Axes | None = None, *, declared: bool = False) -> Axes:
        """Size of the residual by run, speed and probe."""
        return plots.residual_map(ax or _new(7.0, 3.2), self._story.declared if declared else self._story.last)

    def probabilities(self, ax: Axes | None = None, *, step: int = 0) -> Axes:
        """What would be added at a step, 0 the first, "none" among it."""
        ranked = self._explanation("probabilities").rankings[step][:MOST_SHOWN]
        return plots.probabilities(ax or _new(5.6, 2.6), [r.effect for r in ranked], [r.probability for r in ranked])

    def missing_force(self, ax: Axes | None = None, *, axis: str = "x", over: str = "displacement") -> Axes:
        """The force that is missing along x or y, over displacement, velocity or angle. **Errors.** ``ValueError``
        where it was not looked into.
        """
        named = self._explanation("the missing force").named_force
        if named is None or named.force.reason is not None:
            raise ValueError(
                f"no missing force to show: {'it was not looked into' if named is None else named.force.reason}"
            )
        return plots.missing_force(ax or _new(5.6, 3.4), named.force, over=over, dof="xy".index(axis))  # pyright: ignore

    def correlations(self, ax: Axes | None = None) -> Axes:
        """Correlations of the parameters fitted last. **Errors.** ``ValueError`` where nothing was fitted."""
        if not self._story.fits or not self._story.fits[-1].estimates:
            raise ValueError("nothing was fitted: there are no correlations to show")
        last = self._story.fits[-1]
        unknowns = {e.entry.unknown: e.entry.key for e in last.estimates}
        part = last.covariance[np.ix_(list(unknowns), list(unknowns))]
        spread = np.sqrt(np.diag(part))
        return plots.correlations(ax or _new(5.2, 4.6), list(unknowns.values()), part / spread[:, None] / spread)

    def _explanation(self, what: str) -> Explanation:
        if self._found is None:
            raise ValueError(f"a comparison has no {what}: explain finds that")
        return self._found


def _new(width: float, height: float) -> Axes:
    return plots.figure(width, height)[1][0]
