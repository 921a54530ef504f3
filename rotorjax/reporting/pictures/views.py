"""Which views of a comparison to draw, from which runs."""

import numpy as np
from matplotlib.axes import Axes

from rotorjax.data.measurement import Measurement
from rotorjax.data.names import one_of
from rotorjax.discovery.compare import Comparison
from rotorjax.discovery.story import Story
from rotorjax.reporting import plots
from rotorjax.reporting.comparison import step_labels, steps
from rotorjax.reporting.curves import Curves, declared_curves, fitted_curves
from rotorjax.units import MICROMETRE

MOST_RUNS = 3
"""Runs in one Bode plot: more cannot be told apart."""


def has_before(story: Story) -> bool:
    """Whether the model as declared can be drawn beside: not where what was measured, or installed, was put right."""
    return story.changed and story.mistake is None


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
    rising = runs_by_size(view.measurement)[::-1]
    picked = np.unique(np.linspace(0, len(rising) - 1, min(MOST_RUNS, len(rising))).round().astype(int))
    return [rising[k] for k in picked[::-1]]


def runs_by_size(m: Measurement) -> list[str]:
    """Runs from the largest measured vibration to the least."""
    sizes = [
        float(np.sqrt(np.mean(np.abs(m.vectors[m.run == k][m.present[m.run == k]]) ** 2))) for k in range(len(m.runs))
    ]
    return [m.runs[k] for k in np.argsort(sizes)[::-1]]


def first_order(m: Measurement) -> float:
    """1X, or the lowest order measured."""
    return 1.0 if 1.0 in m.orders else m.orders[0]


def the_reading(m: Measurement, probe: str | None, order: float | None) -> tuple[str, float]:
    """A probe, by default the last that was read, and an order, by default 1X. **Errors.** ``ValueError`` where the
    measurement lacks them.
    """
    probe, order = m.probes_read[-1] if probe is None else probe, first_order(m) if order is None else order
    return one_of(probe, m.probes_read, "probe"), one_of(order, m.orders, "order")


def _worst_probe(story: Story, order: float | None) -> str:
    """The probe with the largest residual of the model as declared at one order."""
    view = story.declared
    m = view.measurement
    n = m.orders.index(the_reading(m, None, order)[1])
    return max(m.probes_read, key=lambda probe: float(np.sum(np.abs(view.residual[:, m.probes.index(probe), n]) ** 2)))


def draw_before_after(
    axes: Axes, story: Story, *, run: str | None = None, probe: str | None = None, order: float | None = None
) -> Axes:
    """Amplitude over speed of one run, by default that with the most readings, of several the one with the largest
    vibration: measured, as declared, and with what was added. By default of the probe at which the model as declared
    fails most.
    """
    m = story.measurement
    probe, order = the_reading(m, probe, order) if probe else the_reading(m, _worst_probe(story, order), order)
    read = m.present[:, m.probes.index(probe), m.orders.index(order)]
    run = run or max(runs_by_size(m), key=lambda name: int(read[m.run == m.runs.index(name)].sum()))
    curves = {"as declared": declared_curves(story.model, m, run)} if has_before(story) else {}
    curves |= {"with what was added" if story.changed else "model": last_curves(story, run)}
    at = m.probes.index(probe), m.orders.index(order)
    shown = {name: curve.of(*at) for name, curve in curves.items()}
    return plots.before_after(axes, story.last, run=run, probe=probe, order=order, curves=shown)


def last_curves(story: Story, run: str) -> Curves:
    """What the last fit shows, with its band; the model as it is where nothing was fitted."""
    return fitted_curves(story.fits[-1], run) if story.fits else declared_curves(story.model, story.measurement, run)
