"""Errors of a study: case by case, step by step, in groups."""

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes

from rotorjax.reporting.plots.canvas import COLOURS, distinct_styles

_SERIES = ("#9aa5b1", "#8fb8de", "#1b5e9c", "#f0a868", "#c8500a", "#2e7d4f")
"""Fills for bars: grey for nothing done, then pairs of light and dark."""


def error_cloud(axes: Axes, errors: Float[np.ndarray, "sample"], *, label: str, rms: float) -> Axes:
    """Errors of one fault component case by case, with their root mean square as a band."""
    axes.plot(np.arange(1, len(errors) + 1), errors, ".", color=COLOURS[0], markersize=2.0, rasterized=True)
    axes.axhspan(-rms, rms, color=COLOURS[1], alpha=0.2, label=f"± rms, {rms:.2g}")
    axes.set(xlabel="test case", ylabel=label, xlim=(0, len(errors) + 1))
    axes.legend(fontsize=8, loc="upper right")
    axes.grid(alpha=0.3)
    return axes


def convergence(axes: Axes, histories: dict[str, Float[np.ndarray, "step"]], *, tolerance: float) -> Axes:
    """Largest relative error after every step, one line per method, on a logarithmic scale."""
    for (colour, marker), (name, errors) in zip(distinct_styles(), histories.items(), strict=False):
        axes.semilogy(
            np.arange(len(errors)),
            np.maximum(errors, 1e-16),
            f"{marker}-",
            color=colour,
            markersize=3.5,
            linewidth=1.1,
            label=name,
        )
    axes.axhline(tolerance, color="0.3", linestyle="--", linewidth=1.0, label=f"tolerance, {100.0 * tolerance:g} %")
    axes.set(xlabel="step", ylabel="largest relative error of the four fault values")
    axes.legend(fontsize=8)
    axes.grid(alpha=0.3)
    return axes


def grouped_bars(axes: Axes, groups: list[str], series: dict[str, list[float]], *, ylabel: str) -> Axes:
    """Bars side by side: one group per place, one colour per series, values on top."""
    width = 0.8 / len(series)
    at = np.arange(len(groups))
    for k, (name, values) in enumerate(series.items()):
        bars = axes.bar(
            at + (k - 0.5 * (len(series) - 1)) * width,
            values,
            width=0.92 * width,
            label=name,
            color=_SERIES[k % len(_SERIES)],
        )
        axes.bar_label(bars, fmt=lambda v: f"{v:.1f}", fontsize=7, padding=1)
    axes.set_xticks(at, groups)
    axes.set(ylabel=ylabel)
    axes.margins(y=0.12)
    axes.legend(fontsize=8)
    axes.grid(axis="y", alpha=0.3)
    return axes
