"""What every plot stands on: figures, SVG, colours, names as they are, axes of amplitudes."""

import io
import warnings
from collections.abc import Iterator, Sequence
from itertools import cycle

import numpy as np
from jaxtyping import Complex, Float
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Annotation
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter, NullLocator

from rotorjax.data.names import harmless

COLOURS = ("#1b5e9c", "#c8500a", "#2e7d4f", "#8e3b8a", "#7a5c00")
"""Told apart in print and by colour-blind readers: blue, orange, green, purple, ochre."""

MARKERS = "osD^vP*X"
"""Of the first series in these colours, the second, ...: what comes after the last colour is told apart by them."""

LONGEST_NAME = 24
"""Characters of a name in a picture."""

SPEED_PT, BESIDE_PT, SPARE = 7.0, 4.0, 1.1
"""Size of a speed's letters, their distance from its point, and the part by which axes may shrink when laid out."""

SIDES = np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]])
"""Right and up, right and down, left and up, left and down."""

LETTER_EM, HANDLE_EM = 0.6, 3.5
"""Widths in heights of a letter: of a letter, and of what stands beside the words of a legend."""


def figure(width: float, height: float, rows: int = 1, columns: int = 1) -> tuple[Figure, list[Axes]]:
    """A figure with its axes, row by row, laid out so that labels do not overlap. Sizes in inches."""
    drawn = Figure(figsize=(width, height), layout="constrained")
    return drawn, list(drawn.subplots(rows, columns, squeeze=False).ravel())


def distinct_styles() -> Iterator[tuple[str, str]]:
    """Colour and marker of one series after another, without end."""
    return ((colour, marker) for marker in cycle(MARKERS) for colour in COLOURS)


def legend_above(axes: Axes, *, most: int, fontsize: float = 8.0) -> None:
    """A legend above the axes, where it hides nothing, in as many columns as have room there, ``most`` at the most."""
    longest = max((len(label) for label in axes.get_legend_handles_labels()[1]), default=0)
    fit = int(points_per_axes(axes)[0] / (HANDLE_EM + LETTER_EM * longest) / fontsize)
    place = {"loc": "lower center", "bbox_to_anchor": (0.5, 1.0), "frameon": False}
    axes.legend(fontsize=fontsize, ncols=max(1, min(most, fit)), **place)


def points_per_axes(axes: Axes) -> Float[np.ndarray, "2"]:
    """Width and height of axes [pt], before they are laid out."""
    box = axes.get_window_extent()
    return 72.0 * np.array([box.width, box.height]) / (axes.figure.dpi if axes.figure is not None else 72.0)


def svg(drawn: Figure) -> bytes:
    """A figure as SVG whose text stays text: the browser has glyphs that the drawing library's font lacks."""
    buffer = io.BytesIO()
    with rc_context({"svg.fonttype": "none", "svg.hashsalt": "rotorjax"}), warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph")
        drawn.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    return buffer.getvalue()


def plain(name: str) -> str:
    """A user's name as it is: a dollar sign begins no formula, an underline hides no entry of a legend, a control
    character is written out. A long one, which would leave the picture no room, is shortened in its middle.
    """
    shown = harmless(name)
    if len(shown) > LONGEST_NAME:
        half = (LONGEST_NAME - 1) // 2
        shown = f"{shown[: LONGEST_NAME - 1 - half]}…{shown[-half:]}"
    return (" " if shown.startswith("_") else "") + shown.replace("$", r"\$")


def logarithmic(axes: Axes) -> None:
    """A logarithmic axis of amplitudes with numbers as people write them, more of them where it spans little; linear
    where nothing is above zero.
    """
    if not np.isfinite(axes.dataLim.minposy):
        axes.set_ylim(-0.05, 1.0)
        return
    axes.set_yscale("log")
    low, high = axes.get_ylim()
    if high < 4.0 * low:
        axes.yaxis.set_major_locator(MaxNLocator(6))
        axes.yaxis.set_minor_locator(NullLocator())
    elif high < 100.0 * low:
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())


def with_room(values: np.ndarray) -> tuple[float, float]:
    """Limits that leave room for a legend above."""
    low, high = float(np.min(values)), float(np.max(values))
    return low - 0.08 * (high - low), high + 0.25 * (high - low)


def label_speeds(
    axes: Axes, z: Complex[np.ndarray, "_"], speed_rpm: Float[np.ndarray, "_"], *, clear: float = 0.0
) -> None:
    """Speeds beside vectors, each once, where they lie neither on one another nor outside the axes.

    The limits of the axes must be set, their scales be equal. **Arguments:** ``clear``: how far from the origin none is
    labelled: there the runs of a polar plot lie on one another.
    """
    limits = np.array([axes.get_xlim(), axes.get_ylim()]).T
    unit = SPARE * float(np.max(np.ptp(limits, axis=0) / points_per_axes(axes)))
    points = np.stack([np.real(z), np.imag(z)], axis=1) / unit
    written = [np.array(text.xy) / unit for text in axes.texts if isinstance(text, Annotation) and text.get_text()]
    marked = [np.asarray(line.get_xydata()) / unit for line in axes.lines if line.get_marker() != "None"]
    seen, labels = np.concatenate([points, *marked, *([written] if written else [])]), {}
    said = [f"{speed:.0f} rpm" for speed in speed_rpm]
    half = 0.5 * SPEED_PT * np.array([LETTER_EM * max(map(len, said), default=0), 1.2])
    for at, words in zip(points, said, strict=True):
        near = any(np.linalg.norm(at - other) < SPEED_PT for other, _ in labels.values())
        if words in labels or near or np.linalg.norm(at) < clear / unit:
            continue
        side = _free_side(at, half, limits / unit, seen, [middle for _, middle in labels.values()])
        if side is not None:
            labels[words] = at, at + side * (half + BESIDE_PT)
            axes.annotate(
                words,
                tuple(at * unit),
                textcoords="offset points",
                xytext=tuple(BESIDE_PT * side),
                ha="left" if side[0] > 0 else "right",
                va="bottom" if side[1] > 0 else "top",
                fontsize=SPEED_PT,
                zorder=5,
            )


def _free_side(
    at: Float[np.ndarray, "2"],
    half: Float[np.ndarray, "2"],
    limits: Float[np.ndarray, "2 2"],
    seen: Float[np.ndarray, "_ 2"],
    labels: Sequence[Float[np.ndarray, "2"]],
) -> Float[np.ndarray, "2"] | None:
    """On which side of a point words hide the least of what is seen, above and to the right if they may: within the
    limits, and on no other label; none where there is no room. In points of print.
    """
    free = []
    for side in SIDES:
        middle = at + side * (half + BESIDE_PT)
        within = np.all((limits[0] < middle - half) & (middle + half < limits[1]))
        if within and not any(np.all(np.abs(middle - other) < 2.0 * half) for other in labels):
            free.append((int(np.sum(np.all(np.abs(seen - middle) < half + 2.0, axis=1))), side))
    return min(free, key=lambda one: one[0])[1] if free else None


def arc_of_rotation(axes: Axes, radius: float, middle: float, spin: int) -> None:
    """A short arc with an arrowhead in the sense of rotation. **Arguments:** ``middle``: its place, from right to up
    [rad]; ``spin``: +1 for counterclockwise.
    """
    first, last = (radius * np.exp(1j * (middle - end * spin * np.radians(10.0))) for end in (1.0, -1.0))
    bent = {"arrowstyle": "->", "connectionstyle": f"arc3,rad={0.18 * spin}", "color": "0.3"}
    axes.annotate("", (last.real, last.imag), (first.real, first.imag), arrowprops=bent)
    lower = first if first.imag <= last.imag else last
    side = "left" if lower.real >= 0.0 else "center"
    axes.annotate("rotation", (lower.real, lower.imag), fontsize=7, color="0.3", ha=side, va="top")
