"""What two probes in one plane show together: orbits, full spectra, the shaft centreline."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes

from rotorjax.data.spectra import FullSpectrum
from rotorjax.diagnosis.orbits import Centreline, Orbit, RecordedOrbit
from rotorjax.reporting.plots.canvas import COLOURS, arc_of_rotation, distinct_styles, label_speeds, legend_above, plain
from rotorjax.units import MICROMETRE

MEASURED, MODEL = COLOURS[0], COLOURS[1]
ROOM, BELOW = 1.5, 1.85
"""Limits of an orbit's axes in reaches of the orbit, and below, where the legend is."""
RIM = 1.25
"""Where probes and the sense of rotation are shown, in reaches of the orbit."""
CORNERS, CLEAR = np.radians([135.0, 45.0, 90.0]), np.radians(30.0)
"""Where the sense of rotation may be shown, and how far from a probe."""
SHOWN_TURNS = 8
"""Revolutions of a record that are drawn: more would cover one another."""


def orbit(
    axes: Axes, measured: Orbit, model: Orbit | None = None, *, probes: Mapping[str, float] | None = None
) -> Axes:
    """Path of the shaft's centre, seen so that x points right and y up, all orders measured: as measured, and what the
    model puts there.

    A dot where the phase reference fires, once in each revolution; an arrowhead in the sense of whirl. **Arguments:**
    ``probes``: angle of each from +x towards +y [rad], to show where they stand.
    """
    _draw(axes, measured, f"measured, {_whirl_words(measured)}", below=True)
    if model is not None:
        _draw(axes, model, f"model, {_whirl_words(model)}")
    _frame_orbit(axes, max(one.reach for one in (measured, model or measured)), measured.spin, probes or {})
    return axes


def record_orbit(
    axes: Axes,
    record: RecordedOrbit,
    model: Orbit | None = None,
    *,
    probes: Mapping[str, float] | None = None,
    turns: int = SHOWN_TURNS,
) -> Axes:
    """Orbit of a record: as recorded in its last revolutions, thin, and filtered at 1X; beside it the model.

    Dots where the phase reference fires, an arrowhead in the sense of whirl of 1X. **Arguments:** ``probes`` as in
    `orbit`; ``turns``: revolutions shown as recorded.
    """
    direct, dots = record.direct / MICROMETRE, record.at_reference[-turns:] / MICROMETRE
    each = max(1, len(direct) // max(1, len(record.at_reference)))
    axes.plot(*direct[-each * turns :].T, "-", color="0.6", linewidth=0.7, label=f"as recorded, {turns} revolutions")
    axes.plot(*dots.T, "o", color="0.35", markersize=3.0, zorder=3)
    _draw(axes, record.filtered, f"filtered, {_whirl_words(record.filtered)}", below=True)
    reach = max(float(np.linalg.norm(direct, axis=1).max()) * MICROMETRE, record.filtered.reach)
    if model is not None:
        _draw(axes, model, f"model, {_whirl_words(model)}")
        reach = max(reach, model.reach)
    _frame_orbit(axes, reach, record.filtered.spin, probes or {})
    return axes


def _whirl_words(one: Orbit) -> str:
    """The sense of whirl at 1X, or at the lowest order there is."""
    turning = [order for order in one.orders if order > 0.0]
    if not turning:
        return "at rest"
    order = 1.0 if 1.0 in turning else turning[0]
    if not np.any(one.at_order(order).motion):
        return f"no {order:g}X"
    sense = one.sense(order)
    return f"{order:g}X {'along a line' if sense == 'a line' else sense}"


def _draw(axes: Axes, one: Orbit, label: str, *, below: bool = False) -> None:
    """A closed orbit with its dots and an arrowhead: a broad line ``below``, or a thin one that leaves that to be
    seen.
    """
    path, dots = one.path() / MICROMETRE, one.at_reference() / MICROMETRE
    colour = MEASURED if below else MODEL
    width, size, alpha, dashes = (3.2, 10.0, 0.55, "-") if below else (1.4, 5.5, 1.0, "--")
    axes.plot(path[:, 0], path[:, 1], dashes, color=colour, label=label, zorder=4, linewidth=width, alpha=alpha)
    edge = {"markeredgecolor": "white", "markeredgewidth": 0.7}
    axes.plot(dots[:, 0], dots[:, 1], "o", color=colour, markersize=size, zorder=6, **edge)
    at = int(0.15 * len(path) / one.turns)
    if np.linalg.norm(path[at + 1] - path[at]) > 0.0:
        head = {"arrowstyle": "-|>", "color": colour, "mutation_scale": 19.0 if below else 12.0, "linewidth": 0.0}
        axes.annotate("", tuple(path[at + 2]), tuple(path[at]), arrowprops=head, zorder=5)


def _frame_orbit(axes: Axes, reach: float, spin: int, probes: Mapping[str, float]) -> None:
    """Limits, labels, where the probes stand, and the sense of rotation. **Arguments:** ``reach`` [m]."""
    size = reach / MICROMETRE or 1.0
    for name, angle in probes.items():
        at = RIM * size * np.array([np.cos(angle), np.sin(angle)])
        axes.plot([0.93 * at[0], at[0]], [0.93 * at[1], at[1]], "-", color="0.45", linewidth=2.5)
        axes.annotate(plain(name), tuple(1.07 * at), fontsize=8, color="0.35", ha="center", va="center")
    free = [at for at in CORNERS if all(np.cos(at - angle) < np.cos(CLEAR) for angle in probes.values())]
    arc_of_rotation(axes, RIM * size, float([*free, CORNERS[0]][0]), spin)
    axes.axhline(0.0, color="0.85", linewidth=0.7, zorder=0)
    axes.axvline(0.0, color="0.85", linewidth=0.7, zorder=0)
    axes.set(xlim=(-ROOM * size, ROOM * size), ylim=(-BELOW * size, ROOM * size), xlabel="x, µm", ylabel="y, µm")
    axes.set_aspect("equal", adjustable="box")
    axes.legend(fontsize=7, loc="lower center", framealpha=1.0)


def full_spectrum(
    axes: Axes, measured: Orbit | FullSpectrum, model: Orbit | None = None, *, highest_order: float = 5.0
) -> Axes:
    """Amplitudes of forward (right) and backward (left) circular motion over order: as measured, and the model's.

    **Arguments:** ``measured``: orders of an orbit as bars, or the spectrum of a record as a line, up to
    ``highest_order``.
    """
    if isinstance(measured, Orbit):
        order, amplitude = _both_ways(measured)
        highest = max(1.0, float(np.abs(order).max(initial=0.0)))
        apart = min(1.0, float(np.min(np.diff(np.unique([0.0, *measured.orders])), initial=1.0)))
        axes.bar(order, amplitude / MICROMETRE, width=0.3 * apart, color=MEASURED, label="measured")
        axes.set_xlim(-highest - 0.7, highest + 0.7)
        crowded = apart < 1.0
        axes.set_xticks(order, [f"{n:+g}{'' if crowded else 'X'}" for n in order], fontsize=7 if crowded else None)
    else:
        shown = np.abs(measured.order) <= highest_order
        order, amplitude = measured.order[shown], measured.amplitude[shown]
        axes.plot(order, amplitude / MICROMETRE, "-", color=MEASURED, linewidth=1.1, label="measured")
        ticks = np.arange(-np.floor(highest_order), highest_order + 0.5)
        axes.set_xticks(ticks, [f"{n:+g}X" if n else "0" for n in ticks])
        axes.set_xlim(-highest_order, highest_order)
    top = float(amplitude.max(initial=0.0))
    if model is not None:
        order, amplitude = _both_ways(model)
        top = max(top, float(amplitude.max(initial=0.0)))
        style = {"color": MODEL, "markersize": 7, "fillstyle": "none", "markeredgewidth": 1.5}
        axes.plot(order, amplitude / MICROMETRE, "D", label="model", **style)
    axes.axvline(0.0, color="0.6", linewidth=0.8, zorder=0)
    for at, words in ((0.2, "backward"), (0.8, "forward")):
        axes.annotate(words, (at, 0.97), xycoords="axes fraction", ha="center", va="top", fontsize=8, color="0.35")
    axes.set(xlabel="order", ylabel="amplitude, µm (0-peak)", ylim=(0.0, 1.25 * (top / MICROMETRE or 1.0)))
    axes.legend(fontsize=7, loc="upper center", framealpha=1.0)
    axes.grid(axis="y", alpha=0.3)
    return axes


def _both_ways(one: Orbit) -> tuple[Float[np.ndarray, "_"], Float[np.ndarray, "_"]]:
    """Orders, negative for backward motion, with their amplitudes [m]; rising."""
    turning = np.array(one.orders) > 0.0
    orders = np.array(one.orders)[turning]
    order = np.concatenate([-orders[::-1], orders])
    return order, np.concatenate([one.backward[turning][::-1], one.forward[turning]])


def centreline(
    axes: Axes,
    lines: Mapping[str, Centreline],
    *,
    clearance_um: float | None = None,
    centre_um: Sequence[float] = (0.0, 0.0),
) -> Axes:
    """Mean position of the shaft (0X) over speed, x to the right and y up: one colour per run, joined in the order of
    speed; each tied to where the model puts it, a cross.

    **Arguments:** ``lines`` by run; ``clearance_um``: radius of the bearing clearance, drawn as a circle about
    ``centre_um``.
    """
    shown = [
        place / MICROMETRE for one in lines.values() for place in (one.measured, one.predicted) if place is not None
    ]
    rim = [] if clearance_um is None else [np.add.outer([-clearance_um, clearance_um], centre_um)]
    every = np.concatenate([*shown, *rim])
    extent, middle = float(np.ptp(every, axis=0).max()) or 1.0, 0.5 * (every.min(axis=0) + every.max(axis=0))
    for (colour, marker), (run, line) in zip(distinct_styles(), lines.items(), strict=False):
        order = np.argsort(line.speed_rpm, kind="stable")
        place = line.measured[order] / MICROMETRE
        joined = {"color": colour, "markersize": 4, "linewidth": 0.9, "zorder": 3}
        axes.plot(*place.T, f"{marker}-", label=f"{plain(run)}, measured", **joined)
        if line.predicted is not None:
            model = line.predicted[order] / MICROMETRE
            axes.plot(*np.stack([place, model]).transpose(2, 0, 1), "-", color="0.6", linewidth=0.8, zorder=1)
            axes.plot(*model.T, "x", color=colour, markersize=6, label=f"{plain(run)}, model", zorder=4)
    if clearance_um is not None:
        turn = 2.0 * np.pi * np.linspace(0.0, 1.0, 361)
        x, y = centre_um[0] + clearance_um * np.cos(turn), centre_um[1] + clearance_um * np.sin(turn)
        axes.plot(x, y, "--", color="0.3", linewidth=1.0, label="clearance")
        axes.plot(*centre_um, "+", color="0.3", markersize=8)
    limits = [(float(at - 0.6 * extent), float(at + 0.6 * extent)) for at in middle]
    axes.set(xlabel="x, µm", ylabel="y, µm", xlim=limits[0], ylim=limits[1])
    axes.set_aspect("equal", adjustable="box")
    for first in list(lines.values())[:1]:
        order = np.argsort(first.speed_rpm, kind="stable")
        label_speeds(axes, first.measured[order] @ [1.0, 1.0j] / MICROMETRE, first.speed_rpm[order])
    legend_above(axes, most=len(lines) + 1, fontsize=7.0)
    axes.grid(alpha=0.3)
    return axes
