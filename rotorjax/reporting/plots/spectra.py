"""Spectra one behind the other: cascade over speed, waterfall over time."""

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from rotorjax.data.spectra import Spectra
from rotorjax.reporting.plots.canvas import COLOURS
from rotorjax.units import MICROMETRE

TALLEST = 8.0
"""Height of the largest peak, in distances from one spectrum to the next."""


def cascade(
    axes: Axes, found: Spectra, *, orders: tuple[float, ...] = (1.0, 2.0), highest_hz: float | None = None
) -> Axes:
    """Spectra of one probe over frequency, each raised to its speed; orders as dashed lines.

    **Arguments:** ``orders`` to mark; ``highest_hz``: end of the axis of frequencies, by default one and a half times
    that of the highest order marked.
    """
    order = np.argsort(found.speed_rpm, kind="stable")
    end = _stacked(axes, found, order, found.speed_rpm, _end(found, orders, highest_hz))
    low, high = float(found.speed_rpm.min()), float(found.speed_rpm.max())
    for n in orders:
        _mark_order(axes, n, np.array([low, high]) * n / 60.0, np.array([low, high]), end)
    axes.set(ylabel="speed, rpm")
    return axes


def waterfall(
    axes: Axes, found: Spectra, *, orders: tuple[float, ...] = (1.0, 2.0), highest_hz: float | None = None
) -> Axes:
    """Spectra of one probe over frequency, each raised to its time; orders as dashed lines that follow the speed.

    **Arguments** as in `cascade`.
    """
    order = np.argsort(found.time, kind="stable")
    end = _stacked(axes, found, order, found.time, _end(found, orders, highest_hz))
    for n in orders:
        _mark_order(axes, n, found.speed_rpm[order] * n / 60.0, found.time[order], end)
    axes.set(ylabel="time, s")
    return axes


def _end(found: Spectra, orders: tuple[float, ...], highest_hz: float | None) -> float:
    wanted = 1.5 * max(orders) * float(found.speed_rpm.max()) / 60.0 if highest_hz is None else highest_hz
    return min(wanted, float(found.frequency_hz[-1]))


def _stacked(axes: Axes, found: Spectra, order: np.ndarray, base: Float[np.ndarray, "_"], end: float) -> float:
    """Spectra raised to their places, those in front over those behind; a bar for the scale. **Returns** the end of the
    axis of frequencies [Hz].
    """
    shown = found.frequency_hz <= end
    frequency, amplitude = found.frequency_hz[shown], found.amplitude[:, shown] / MICROMETRE
    span = float(np.ptp(base)) or 1.0
    scale = TALLEST * span / max(1, len(base) - 1) / (float(amplitude.max()) or 1.0)
    for depth, k in enumerate(order):
        line, place = base[k] + scale * amplitude[k], 2.0 - depth / len(order)
        axes.fill_between(frequency, base[k], line, color="white", zorder=place, linewidth=0.0)
        axes.plot(frequency, line, "-", color=COLOURS[0], linewidth=0.8, zorder=place)
    bar = float(MaxNLocator(3, steps=[1, 2, 5, 10]).tick_values(0.0, float(amplitude.max()) or 1.0)[1])
    highest = float((base[:, None] + scale * amplitude).max())
    x, foot = 0.955 * end, float(base.max()) + 0.06 * span
    top = max(highest, foot + scale * bar) + 0.03 * span
    axes.set(xlabel="frequency, Hz", xlim=(0.0, end), ylim=(float(base.min()) - 0.03 * span, top))
    axes.plot([x, x], [foot, foot + scale * bar], "-", color="0.2", linewidth=3.0, solid_capstyle="butt", zorder=4)
    axes.annotate(
        f"{bar:g} µm (0-peak)", (x, foot + 0.5 * scale * bar), textcoords="offset points", xytext=(-6, 0),
        ha="right", va="center", fontsize=8, zorder=4,
    )  # fmt: skip
    return end


def _mark_order(
    axes: Axes, order: float, frequency: Float[np.ndarray, "_"], place: Float[np.ndarray, "_"], end: float
) -> None:
    """An order as a dashed line, named at its upper end."""
    axes.plot(frequency, place, "--", color=COLOURS[1], linewidth=0.9, zorder=3)
    seen = np.flatnonzero(frequency <= end)
    if len(seen):
        last = int(seen[np.argmax(place[seen])])
        axes.annotate(
            f"{order:g}X", (frequency[last], place[last]), textcoords="offset points", xytext=(3, 2),
            fontsize=8, color=COLOURS[1], zorder=4,
        )  # fmt: skip
