"""Vibration vectors of a measurement and of a model: Bode plots, and the polar plane."""

from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np
from jaxtyping import Complex, Float
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator, MultipleLocator

from rotorjax.discovery.compare import Comparison
from rotorjax.reporting.curves import Curve
from rotorjax.reporting.plots.canvas import COLOURS, arc_of_rotation, distinct_styles, label_speeds, logarithmic, plain
from rotorjax.units import MICROMETRE

CIRCLES, LABELLED = 4, np.radians(15.0)
"""Circles of amplitude in a polar plot, and where their sizes are written."""

CLEAR = 0.1
"""Vectors of a polar plot whose speeds are not labelled: smaller than this in the largest."""

SHORT_NAME = 8
"""Characters of a probe's name that go into one line with the rest of a label."""


def bode(
    amplitude: Axes,
    phase: Axes,
    view: Comparison,
    after: Mapping[str, Curve],
    *,
    probe: str,
    order: float,
    before: Mapping[str, Curve] | None = None,
    critical_rpm: Sequence[float] = (),
) -> tuple[Axes, Axes]:
    """Amplitude, logarithmic, and phase, without jumps, over speed: one colour per run, measured as dots.

    **Arguments:** ``after``: what the model shows by run, solid with its 95 % band if it has one; ``before``: the same
    as declared, dashed; ``critical_rpm``: critical speeds to mark.
    """
    m, lag = view.measurement, any(curve.lag for curve in after.values())
    sign = -1.0 if lag else 1.0
    k, n = m.probes.index(probe), m.orders.index(order)
    for (colour, marker), (run, curve) in zip(distinct_styles(), after.items(), strict=False):
        cases = (m.run == m.runs.index(run)) & m.present[:, k, n]
        speed, z = m.speed_rpm[cases], view.measured[cases, k, n] / MICROMETRE
        dots = {"color": colour, "markersize": 4.5, "zorder": 3}
        amplitude.plot(speed, np.abs(z), marker, label=f"{plain(run)}, measured", **dots)
        phase.plot(speed, curve.near(speed, sign * np.degrees(np.angle(z))), marker, **dots)
        for axes, line, band in (
            (amplitude, curve.amplitude_um, curve.band_um),
            (phase, curve.phase_deg, curve.band_deg),
        ):
            axes.plot(curve.speed_rpm, line, "-", color=colour, linewidth=1.3, label=f"{plain(run)}, model")
            if band is not None:
                axes.fill_between(curve.speed_rpm, *band, color=colour, alpha=0.2, linewidth=0.0)
        if before is not None:
            old, thin = before[run], {"color": colour, "linewidth": 1.0, "alpha": 0.7}
            amplitude.plot(old.speed_rpm, old.amplitude_um, "--", label=f"{plain(run)}, as declared", **thin)
            phase.plot(old.speed_rpm, curve.near(old.speed_rpm, old.phase_deg), "--", **thin)
    for axes in (amplitude, phase):
        low, high = axes.get_xlim()
        for speed in critical_rpm:
            if low < speed < high:
                axes.axvline(speed, color="0.45", linestyle=":", linewidth=1.0, zorder=0)
        axes.grid(alpha=0.3)
    logarithmic(amplitude)
    apart = " " if len(plain(probe)) <= SHORT_NAME else "\n"
    amplitude.set(ylabel=f"{plain(probe)}{apart}{order:g}X amplitude, µm (0-peak)")
    phase.set(ylabel=f"phase {'lag' if lag else 'lead'}, degrees", xlabel="speed, rpm")
    phase.yaxis.set_major_locator(MultipleLocator(90.0 if np.ptp(phase.get_ylim()) < 720.0 else 180.0))
    return amplitude, phase


def measured_bode(
    amplitude: Axes,
    phase: Axes,
    runs: Mapping[str, tuple[Float[np.ndarray, "_"], Complex[np.ndarray, "_"]]],
    *,
    what: str,
    lag: bool = False,
) -> tuple[Axes, Axes]:
    """Amplitude, logarithmic, and phase, without jumps, over speed as measured: one colour per run.

    **Arguments:** ``runs``: speeds [rpm] and vectors [m] by run; ``what`` they are, such as "X 1X"; ``lag``: whether
    phases are shown as lags.
    """
    for (colour, marker), (run, (speed, vectors)) in zip(distinct_styles(), runs.items(), strict=False):
        order = np.argsort(speed, kind="stable")
        style = {"color": colour, "marker": marker, "markersize": 3.5, "linewidth": 1.0, "label": plain(run)}
        amplitude.plot(speed[order], np.abs(vectors[order]) / MICROMETRE, **style)
        angle = np.degrees(np.unwrap(np.angle(vectors[order])))
        phase.plot(speed[order], -angle if lag else angle, **style)
    for axes in (amplitude, phase):
        axes.grid(alpha=0.3)
    logarithmic(amplitude)
    amplitude.set(ylabel=f"{what} amplitude, µm (0-peak)")
    phase.set(ylabel=f"phase {'lag' if lag else 'lead'}, degrees", xlabel="speed, rpm")
    phase.yaxis.set_major_locator(MultipleLocator(90.0 if np.ptp(phase.get_ylim()) < 720.0 else 180.0))
    return amplitude, phase


def before_after(
    axes: Axes,
    view: Comparison,
    *,
    run: str,
    probe: str,
    order: float,
    curves: Mapping[str, Curve],
) -> Axes:
    """Amplitude over speed of one run, logarithmic: measured as dots, models as lines, the first of two dashed.

    **Arguments:** ``curves``: by the model's name, with its 95 % band if it has one.
    """
    m = view.measurement
    k, n = m.probes.index(probe), m.orders.index(order)
    cases = (m.run == m.runs.index(run)) & m.present[:, k, n]
    styles = [(COLOURS[1], "--"), (COLOURS[0], "-")][-len(curves) :]
    for (name, curve), (colour, dashes) in zip(curves.items(), styles, strict=True):
        axes.plot(curve.speed_rpm, curve.amplitude_um, dashes, color=colour, linewidth=1.5, label=name)
        if curve.band_um is not None:
            axes.fill_between(curve.speed_rpm, *curve.band_um, color=colour, alpha=0.2, linewidth=0.0)
    axes.plot(
        m.speed_rpm[cases],
        np.abs(view.measured[cases, k, n]) / MICROMETRE,
        "o",
        color="0.15",
        markersize=4.5,
        label="measured",
    )
    logarithmic(axes)
    axes.set(xlabel="speed, rpm", ylabel=f"{plain(probe)} {order:g}X, µm (0-peak)")
    axes.set_title(f"run {plain(run)}", fontsize=9, loc="left")
    axes.legend(fontsize=8)
    axes.grid(alpha=0.3, which="both", linewidth=0.5)
    return axes


def polar(
    axes: Axes,
    view: Comparison,
    *,
    probe: str,
    order: float,
    runs: Sequence[str] = (),
    phase: Literal["lead", "lag"] = "lead",
) -> Axes:
    """Measured vectors in the polar plane as dots, each tied to where the model puts it, a cross.

    Leads count counterclockwise, as the shaft turns in this plane; lags clockwise. **Arguments:** ``runs`` to show in
    colour, joined in the order of speed, the speeds of the first labelled; ``phase``: how angles are labelled.
    """
    m = view.measurement
    k, n = m.probes.index(probe), m.orders.index(order)
    cases = m.present[:, k, n]
    z, model = view.measured[cases, k, n] / MICROMETRE, view.predicted[cases, k, n] / MICROMETRE
    axes.plot(np.stack([z.real, model.real]), np.stack([z.imag, model.imag]), "-", color="0.6", linewidth=0.8, zorder=1)
    axes.plot(model.real, model.imag, "x", color="0.2", markersize=5, label="model", zorder=4)
    rest = ~np.isin(m.run[cases], [m.runs.index(run) for run in runs])
    if rest.any():
        label = "other runs, measured" if runs else "measured"
        axes.plot(z.real[rest], z.imag[rest], "o", color="0.6" if runs else COLOURS[0], markersize=4, label=label)
    for (colour, marker), run in zip(distinct_styles(), runs, strict=False):
        own = np.flatnonzero(m.run[cases] == m.runs.index(run))
        own = own[np.argsort(m.speed_rpm[cases][own], kind="stable")]
        joined = {"color": colour, "markersize": 4, "linewidth": 0.9, "zorder": 3}
        axes.plot(z.real[own], z.imag[own], f"{marker}-", label=plain(run), **joined)
    largest = max(float(np.abs(part).max()) for part in (z, model)) if len(z) else 1.0
    _graticule(axes, largest or 1.0, phase)
    if runs:
        first = m.run[cases] == m.runs.index(runs[0])
        by_speed = np.flatnonzero(first)[np.argsort(m.speed_rpm[cases][first], kind="stable")]
        label_speeds(axes, z[by_speed], m.speed_rpm[cases][by_speed], clear=CLEAR * largest)
    axes.set(
        xlabel=f"phase {phase} in degrees, counted {'with' if phase == 'lead' else 'against'} the rotation",
        ylabel=f"{plain(probe)} {order:g}X, µm (0-peak)",
    )
    return axes


def _graticule(axes: Axes, largest: float, phase: Literal["lead", "lag"]) -> None:
    """Circles of amplitude and lines of phase with their labels, and an arrow with the rotation, in the place of axes.

    **Arguments:** ``largest`` amplitude to show [µm].
    """
    step = float(MaxNLocator(CIRCLES, steps=[1, 2, 2.5, 5, 10]).tick_values(0.0, largest)[1])
    rim, turn = step * np.ceil(largest / step - 1e-9), 2.0 * np.pi * np.arange(361) / 360.0
    thin = {"color": "0.8", "linewidth": 0.7, "zorder": 0}
    for radius in np.arange(step, rim + 0.5 * step, step):
        axes.plot(radius * np.cos(turn), radius * np.sin(turn), "-", **thin)
        axes.annotate(f"{radius:g}", (radius * np.cos(LABELLED), radius * np.sin(LABELLED)), fontsize=7, color="0.4")
    for degrees in range(0, 360, 30):
        angle = np.radians(degrees if phase == "lead" else -degrees)
        at = np.array([np.cos(angle), np.sin(angle)])
        axes.plot([0.0, rim * at[0]], [0.0, rim * at[1]], "-", **thin)
        axes.annotate(f"{degrees}°", tuple(1.09 * rim * at), fontsize=8, color="0.3", ha="center", va="center")
    arc_of_rotation(axes, 1.2 * rim, np.radians(45.0), 1)
    axes.set(xlim=(-1.3 * rim, 1.3 * rim), ylim=(-1.3 * rim, 1.3 * rim), xticks=[], yticks=[])
    axes.set_aspect("equal", adjustable="box")
    for spine in axes.spines.values():
        spine.set_visible(False)
