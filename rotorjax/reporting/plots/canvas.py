"""What every plot stands on: figures, SVG, colours, names as they are, axes of amplitudes."""

import io
import warnings

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter

from rotorjax.data.names import harmless

COLOURS = ("#1b5e9c", "#c8500a", "#2e7d4f", "#8e3b8a", "#7a5c00")
"""Told apart in print and by colour-blind readers: blue, orange, green, purple, ochre."""


def figure(width: float, height: float, rows: int = 1, columns: int = 1) -> tuple[Figure, list[Axes]]:
    """A figure with its axes, row by row, laid out so that labels do not overlap. Sizes in inches."""
    drawn = Figure(figsize=(width, height), layout="constrained")
    return drawn, list(drawn.subplots(rows, columns, squeeze=False).ravel())


def svg(drawn: Figure) -> bytes:
    """A figure as SVG whose text stays text: the browser has glyphs that the drawing library's font lacks."""
    buffer = io.BytesIO()
    with rc_context({"svg.fonttype": "none", "svg.hashsalt": "rotorjax"}), warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph")
        drawn.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    return buffer.getvalue()


def plain(name: str) -> str:
    """A user's name as it is: a dollar sign begins no formula, an underline hides no entry of a legend, a control
    character is written out.
    """
    return (" " if name.startswith("_") else "") + harmless(name).replace("$", r"\$")


def logarithmic(axes: Axes) -> None:
    """A logarithmic axis of amplitudes with numbers as people write them, more of them where it spans little."""
    axes.set_yscale("log")
    low, high = axes.get_ylim()
    written = FuncFormatter(lambda value, _: f"{value:g}")
    axes.yaxis.set_major_formatter(written)
    axes.yaxis.set_minor_formatter(written if high < 10.0 * low else NullFormatter())


def with_room(values: np.ndarray) -> tuple[float, float]:
    """Limits that leave room for a legend above."""
    low, high = float(np.min(values)), float(np.max(values))
    return low - 0.08 * (high - low), high + 0.25 * (high - low)
