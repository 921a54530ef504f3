"""The Campbell diagram."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import LinearSegmentedColormap

from rotorjax.diagnosis.natural_frequencies import NaturalFrequencies
from rotorjax.reporting.plots.canvas import COLOURS

DAMPED = LinearSegmentedColormap.from_list("damped", ["#0b2545", "#2f78b8", "#7fb2dd"])
"""Dark where there is little damping."""
UNSTABLE = "#ab2b2b"
PAPER = {"facecolor": "white", "alpha": 0.8, "linewidth": 0.0, "pad": 0.6}
"""Behind names that lie on lines."""
BESIDE = 0.03
"""Room at the right, in spans of the speeds."""


def campbell(
    axes: Axes,
    found: NaturalFrequencies,
    *,
    before: NaturalFrequencies | None = None,
    measured_rpm: tuple[float, float] | None = None,
    critical_rpm: Sequence[float] = (),
    orders: Sequence[float] = (1.0,),
) -> Axes:
    """Natural frequencies over speed, in the colour of their damping ratio, red where a mode grows; each named by its
    whirl.

    **Arguments:** ``before``: the same of another model, dashed; ``measured_rpm``: range of speeds to shade;
    ``critical_rpm``: critical speeds, dots on the line of 1X; ``orders`` whose lines are drawn.
    """
    speed, frequency = found.speed_rpm, found.frequency_hz
    if measured_rpm is not None:
        axes.axvspan(*measured_rpm, color="0.93", zorder=0, label="measured speeds")
    if before is not None:
        for k in range(before.frequency_hz.shape[1]):
            label = "as declared" if k == 0 else None
            style = {"color": "0.1", "linewidth": 0.9, "dashes": (6, 4), "zorder": 4}
            axes.plot(before.speed_rpm, before.frequency_hz[:, k], "-", label=label, **style)
    _modes(axes, found)
    end, top = float(speed[-1]), _top(found, before)
    for order in orders:
        _order_line(axes, order, end, top)
    for k, critical in enumerate(critical_rpm):
        _mark_critical(axes, critical, first=k == 0, left=k % 2 == 0)
    axes.set(xlabel="speed, rpm", ylabel="natural frequency, Hz", xlim=(0.0, (1.0 + BESIDE) * end), ylim=(0.0, top))
    if not np.isfinite(frequency).any():
        axes.annotate("no mode oscillates", (0.5, 0.5), xycoords="axes fraction", ha="center")
    if axes.get_legend_handles_labels()[1]:
        axes.legend(fontsize=8, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=4, frameon=False)
    axes.grid(alpha=0.3)
    return axes


def _mark_critical(axes: Axes, speed_rpm: float, *, first: bool, left: bool) -> None:
    """A dot on the line of 1X, and the speed written upright above the axis of speeds."""
    label = "critical speed" if first else None
    axes.plot([speed_rpm, speed_rpm], [0.0, speed_rpm / 60.0], ":", color="0.35", linewidth=1.0, zorder=2)
    axes.plot(speed_rpm, speed_rpm / 60.0, "o", color=COLOURS[1], markersize=6, zorder=5, label=label)
    axes.annotate(
        f"{speed_rpm:.0f} rpm", (speed_rpm, 0.0), textcoords="offset points", xytext=(-2 if left else 2, 5),
        ha="right" if left else "left", va="bottom", rotation=90, fontsize=8, zorder=6,
    )  # fmt: skip


def _top(found: NaturalFrequencies, before: NaturalFrequencies | None) -> float:
    """End of the axis of frequencies [Hz]: all modes, or 1X where that is more."""
    every = [found.frequency_hz, *([] if before is None else [before.frequency_hz])]
    highest = max(float(np.nanmax(one, initial=0.0)) for one in every)
    return 1.15 * max(highest, float(found.speed_rpm[-1]) / 60.0)


def _modes(axes: Axes, found: NaturalFrequencies) -> None:
    """Lines in the colour of their damping, and their names at the right."""
    speed, ratio = found.speed_rpm, 100.0 * found.damping_ratio
    highest = max(float(np.nanmax(ratio, initial=0.0)), 1e-3)
    lines = None
    for k in range(ratio.shape[1]):
        points = np.stack([speed, found.frequency_hz[:, k]], axis=1)
        pieces = np.stack([points[:-1], points[1:]], axis=1)
        damped = 0.5 * (ratio[:-1, k] + ratio[1:, k])
        lines = LineCollection(list(pieces), cmap=DAMPED, linewidths=2.2, zorder=3)
        lines.set_array(damped)
        lines.set_clim(0.0, highest)
        axes.add_collection(lines)
        grows = damped < 0.0
        if grows.any():
            axes.add_collection(LineCollection(list(pieces[grows]), colors=UNSTABLE, linewidths=2.6, zorder=4))
    if np.nanmin(ratio, initial=0.0) < 0.0:
        axes.plot([], [], "-", color=UNSTABLE, linewidth=2.6, label="unstable")
    if lines is not None and axes.figure is not None:
        axes.figure.colorbar(lines, ax=axes, label="damping ratio, %")
    _name_modes(axes, found)


def _name_modes(axes: Axes, found: NaturalFrequencies) -> None:
    """Each mode's whirl at the end of its line; names of modes at one frequency once, others kept apart."""
    ends: dict[str, tuple[float, float]] = {}
    for k, whirl in enumerate(found.whirl):
        last = int(np.flatnonzero(np.isfinite(found.frequency_hz[:, k]))[-1])
        name = whirl
        while name in ends and not np.isclose(ends[name][1], found.frequency_hz[last, k]):
            name += " "
        ends[name] = float(found.speed_rpm[last]), float(found.frequency_hz[last, k])
    for k, (name, (x, y)) in enumerate(sorted(ends.items(), key=lambda item: item[1][1])):
        beside = {"xytext": (-2, -5), "va": "top"} if k == 0 and len(ends) > 1 else {"xytext": (-2, 4), "va": "bottom"}
        axes.annotate(name.strip(), (x, y), textcoords="offset points", ha="right", fontsize=8, bbox=PAPER, **beside)


def _order_line(axes: Axes, order: float, end: float, top: float) -> None:
    """The frequency of an order over speed, with its name where it leaves the picture."""
    axes.plot([0.0, end], [0.0, order * end / 60.0], "-.", color="0.35", linewidth=0.9, zorder=2)
    speed = min(end, 0.93 * top * 60.0 / order)
    axes.annotate(
        f"{order:g}X", (speed, order * speed / 60.0), textcoords="offset points", xytext=(-4, 4), ha="right",
        fontsize=8, color="0.25",
    )  # fmt: skip
