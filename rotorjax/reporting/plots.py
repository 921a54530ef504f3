"""Pictures: every function draws on the axes it is given and returns them. Amplitudes in µm, speeds in rpm."""

import io
import warnings
from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np
from jaxtyping import Complex, Float
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator, MultipleLocator, NullFormatter

from rotorjax.data.names import harmless
from rotorjax.discovery.compare import Comparison
from rotorjax.discovery.missing_force import MissingForce
from rotorjax.physics.harmonic_balance import SAMPLES
from rotorjax.reporting.curves import Curve
from rotorjax.reporting.wording import percent
from rotorjax.units import MICROMETRE

COLOURS = ("#1b5e9c", "#c8500a", "#2e7d4f", "#8e3b8a", "#7a5c00")
"""Told apart in print and by colour-blind readers: blue, orange, green, purple, ochre."""
CIRCLES, LABELLED = 4, np.radians(15.0)
"""Circles of amplitude in a polar plot, and where their sizes are written."""


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
    for colour, (run, curve) in zip(COLOURS, after.items(), strict=False):
        cases = (m.run == m.runs.index(run)) & m.present[:, k, n]
        speed, z = m.speed_rpm[cases], view.measured[cases, k, n] / MICROMETRE
        dots = {"color": colour, "markersize": 4.5, "zorder": 3}
        amplitude.plot(speed, np.abs(z), "o", label=f"{plain(run)}, measured", **dots)
        phase.plot(speed, curve.near(speed, sign * np.degrees(np.angle(z))), "o", **dots)
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
    _logarithmic(amplitude)
    amplitude.set(ylabel=f"{plain(probe)} {order:g}X amplitude, µm (0-peak)")
    phase.set(ylabel=f"phase {'lag' if lag else 'lead'}, degrees", xlabel="speed, rpm")
    phase.yaxis.set_major_locator(MultipleLocator(90.0 if np.ptp(phase.get_ylim()) < 720.0 else 180.0))
    return amplitude, phase


def _logarithmic(axes: Axes) -> None:
    """A logarithmic axis of amplitudes with numbers as people write them, more of them where it spans little."""
    axes.set_yscale("log")
    low, high = axes.get_ylim()
    written = FuncFormatter(lambda value, _: f"{value:g}")
    axes.yaxis.set_major_formatter(written)
    axes.yaxis.set_minor_formatter(written if high < 10.0 * low else NullFormatter())


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
    _logarithmic(axes)
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
    for colour, run in zip(COLOURS, runs, strict=False):
        own = np.flatnonzero(m.run[cases] == m.runs.index(run))
        own = own[np.argsort(m.speed_rpm[cases][own], kind="stable")]
        axes.plot(z.real[own], z.imag[own], "o-", color=colour, markersize=4, linewidth=0.9, label=plain(run), zorder=3)
        if run == runs[0]:
            _label_speeds(axes, z[own], m.speed_rpm[cases][own])
    largest = max(float(np.abs(part).max()) for part in (z, model)) if len(z) else 1.0
    _graticule(axes, largest or 1.0, phase)
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
    arc = 1.2 * rim * np.exp(1j * np.radians([35.0, 55.0]))
    bent = {"arrowstyle": "->", "connectionstyle": "arc3,rad=0.18", "color": "0.3"}
    axes.annotate("", (arc[1].real, arc[1].imag), (arc[0].real, arc[0].imag), arrowprops=bent)
    axes.annotate("rotation", (arc[0].real, arc[0].imag), fontsize=7, color="0.3", ha="left", va="top")
    axes.set(xlim=(-1.3 * rim, 1.3 * rim), ylim=(-1.3 * rim, 1.3 * rim), xticks=[], yticks=[])
    axes.set_aspect("equal", adjustable="box")
    for spine in axes.spines.values():
        spine.set_visible(False)


def _label_speeds(axes: Axes, z: Complex[np.ndarray, "_"], speed_rpm: Float[np.ndarray, "_"]) -> None:
    """Speeds beside vectors, where they do not lie on one another."""
    points, labelled = np.stack([np.real(z), np.imag(z)], axis=1), []
    room = 0.12 * float(np.ptp(points, axis=0).max()) if len(points) else 0.0
    for at, speed in zip(points, speed_rpm, strict=True):
        # About the origin the runs lie on one another.
        if np.linalg.norm(at) > room and all(np.linalg.norm(at - other) > room for other in labelled):
            labelled.append(at)
            axes.annotate(
                f"{speed:.0f} rpm", tuple(at), textcoords="offset points", xytext=(5, 4), fontsize=7, zorder=5
            )


def residual_map(axes: Axes, view: Comparison, *, limits_um: tuple[float, float] | None = None) -> Axes:
    """|residual| [µm] as a map: runs down, speed and probe across; grey where nothing was measured."""
    m = view.measurement
    cluster, speeds = m.speed_cluster()
    columns = [
        (s, k, n)
        for n in range(len(m.orders))
        for s in range(len(speeds))
        for k, probe in enumerate(m.probes)
        if probe in m.probes_read
    ]
    grid = np.full((len(m.runs), len(columns)), np.nan)
    for j, (s, k, n) in enumerate(columns):
        for run in range(len(m.runs)):
            cases = (cluster == s) & (m.run == run) & m.present[:, k, n]
            if cases.any():
                grid[run, j] = np.sqrt(np.mean(np.abs(view.residual[cases, k, n]) ** 2)) / MICROMETRE
    low, high = limits_um or _positive_range(grid)
    image = axes.imshow(
        np.maximum(grid, low), aspect="auto", cmap="YlOrRd", norm=LogNorm(low, high), interpolation="none"
    )
    axes.set_facecolor("0.85")
    several = len(m.orders) > 1
    labels = [
        f"{plain(m.probes[k])} {speeds[s]:.0f}" + (f" {m.orders[n]:g}X" if several else "") for s, k, n in columns
    ]
    step = max(1, len(columns) // 24)
    axes.set_xticks(range(0, len(columns), step), labels[::step], rotation=90 if len(columns) > 6 else 0, fontsize=7)
    step = max(1, len(m.runs) // 30)
    axes.set_yticks(range(0, len(m.runs), step), list(map(plain, m.runs[::step])), fontsize=7)
    axes.set(xlabel="probe and speed, rpm")
    if axes.figure is not None:
        axes.figure.colorbar(image, ax=axes, label="|residual|, µm")
    return axes


def _positive_range(grid: np.ndarray) -> tuple[float, float]:
    seen = grid[np.isfinite(grid) & (grid > 0.0)]
    if not len(seen):
        return 1e-3, 1.0
    low, high = float(seen.min()), float(seen.max())
    return (low, high) if high > 1.01 * low else (0.5 * low, 2.0 * low)


def error_fall(
    axes: Axes, labels: list[str], rms_um: list[float], held_out_um: list[float | None], *, noise_um: float | None
) -> Axes:
    """The error step by step as effects were added, with the error on held-out data and the level of the noise."""
    at = np.arange(len(labels))
    axes.plot(at, rms_um, "o-", color=COLOURS[0], markersize=7, linewidth=1.2, label="all data")
    held = [(x, h) for x, h in zip(at, held_out_um, strict=True) if h is not None]
    if held:
        axes.plot(
            *zip(*held, strict=True),
            "D",
            color=COLOURS[1],
            markersize=7,
            fillstyle="none",
            markeredgewidth=1.5,
            label="held out",
        )
    if noise_um is not None:
        axes.axhline(noise_um, color="0.3", linestyle="--", linewidth=1.0, label="noise alone (√2 standard errors)")
    for x, value in zip(at, rms_um, strict=True):
        axes.annotate(f"{value:#.3g}".rstrip("."), (x, value), textcoords="offset points", xytext=(8, 4), fontsize=8)
    axes.set_yscale("log")
    floor = float(np.min([*rms_um, *(h for _, h in held), *([noise_um] if noise_um else [])]))
    axes.set_ylim(max(floor, 1e-9) / 2.0, max(1e-9, *rms_um) * 3.0)
    axes.set_xticks(at, labels, fontsize=8)
    axes.set(ylabel="rms |residual|, µm", xlim=(-0.4, len(labels) - 0.4))
    axes.legend(fontsize=8, loc="upper right")
    axes.grid(axis="y", alpha=0.3)
    return axes


def probabilities(axes: Axes, effects: list[str], values: list[float]) -> Axes:
    """How probable each of some effects is, the most probable on top; "none" in grey."""
    at = np.arange(len(effects))[::-1]
    axes.barh(at, values, color=["0.65" if name == "none" else COLOURS[0] for name in effects])
    for y, value in zip(at, values, strict=True):
        axes.annotate(
            percent(value),
            (value, y),
            textcoords="offset points",
            xytext=(4, 0),
            va="center",
            fontsize=8,
        )
    axes.set_yticks(at, effects)
    axes.set(xlabel="probability", xlim=(0.0, 1.15))
    return axes


def correlations(axes: Axes, names: list[str], matrix: Float[np.ndarray, "param param"]) -> Axes:
    """Correlations of fitted parameters: red together, blue against one another."""
    image = axes.imshow(matrix, cmap="RdBu_r", vmin=-1.0, vmax=1.0)
    axes.set_xticks(range(len(names)), names, rotation=90, fontsize=7)
    axes.set_yticks(range(len(names)), names, fontsize=7)
    if axes.figure is not None:
        axes.figure.colorbar(image, ax=axes, label="correlation")
    return axes


def error_cloud(axes: Axes, errors: Float[np.ndarray, "sample"], *, label: str, rms: float) -> Axes:
    """Errors of one fault component case by case, with their root mean square as a band."""
    axes.plot(np.arange(1, len(errors) + 1), errors, ".", color=COLOURS[0], markersize=2.0, rasterized=True)
    axes.axhspan(-rms, rms, color=COLOURS[1], alpha=0.2, label=f"± rms, {rms:.2g}")
    axes.set(xlabel="test case", ylabel=label, xlim=(0, len(errors) + 1))
    axes.legend(fontsize=8, loc="upper right")
    axes.grid(alpha=0.3)
    return axes


def waveform(
    axes: Axes,
    time: Float[np.ndarray, "sample"],
    displacement: Float[np.ndarray, "sample probe"],
    pulses: Float[np.ndarray, "_"],
) -> Axes:
    """Displacement of two probes over time, phase-reference pulses as vertical lines. In s and m."""
    for k, name in enumerate("XY"):
        axes.plot(1e3 * time, displacement[:, k] / MICROMETRE, "-", color=COLOURS[k], linewidth=1.0, label=name)
    shown = pulses[(pulses >= time[0]) & (pulses <= time[-1])]
    for k, pulse in enumerate(shown):
        axes.axvline(
            1e3 * pulse, color="0.4", linestyle="--", linewidth=0.9, label="phase reference" if k == 0 else None
        )
    axes.set(xlabel="time, ms", ylabel="displacement, µm", ylim=_with_room(displacement / MICROMETRE))
    axes.legend(fontsize=8, loc="upper center", ncols=3)
    axes.grid(alpha=0.3)
    return axes


def _with_room(values: np.ndarray) -> tuple[float, float]:
    """Limits that leave room for a legend above."""
    low, high = float(np.min(values)), float(np.max(values))
    return low - 0.08 * (high - low), high + 0.25 * (high - low)


def phase_picture(
    axes: Axes,
    angle_deg: Float[np.ndarray, "_"],
    mean: Float[np.ndarray, "_ probe"],
    scatter: Float[np.ndarray, "_ probe"],
) -> Axes:
    """Mean displacement over one revolution from pulse to pulse, with its scatter; each probe's peak marked."""
    for k, name in enumerate("XY"):
        m, s = mean[:, k] / MICROMETRE, scatter[:, k] / MICROMETRE
        peak = angle_deg[int(np.argmax(m))]
        axes.plot(angle_deg, m, "-", color=COLOURS[k], label=f"{name}, peak at {peak:.0f}°")
        axes.fill_between(angle_deg, m - s, m + s, color=COLOURS[k], alpha=0.25, linewidth=0.0)
        axes.axvline(peak, color=COLOURS[k], linestyle=":", linewidth=1.0)
    axes.set(
        xlabel="shaft angle after the phase reference, degrees",
        ylabel="displacement, µm",
        xlim=(0, 360),
        xticks=range(0, 361, 45),
        ylim=_with_room(mean / MICROMETRE),
    )
    axes.legend(fontsize=8, loc="upper center", ncols=2)
    axes.grid(alpha=0.3)
    return axes


def convergence(axes: Axes, histories: dict[str, Float[np.ndarray, "step"]], *, tolerance: float) -> Axes:
    """Largest relative error after every step, one line per method, on a logarithmic scale."""
    for colour, (name, errors) in zip(COLOURS, histories.items(), strict=False):
        axes.semilogy(
            np.arange(len(errors)),
            np.maximum(errors, 1e-16),
            "o-",
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


_SERIES = ("#9aa5b1", "#8fb8de", "#1b5e9c", "#f0a868", "#c8500a", "#2e7d4f")
"""Fills for bars: grey for nothing done, then pairs of light and dark."""


def missing_force(
    axes: Axes,
    found: MissingForce,
    *,
    over: Literal["displacement", "velocity", "angle"],
    dof: int,
    most: int = 4,
    legend: bool = True,
) -> Axes:
    """The force along x (0) or y (1) that the model lacks [N], over displacement, velocity or shaft angle, with a band
    of one standard error.

    The ``most`` cases with the largest force beyond noise, one colour each; force along x and y to the same scale. No
    curves where nothing can be said.
    """
    m, name = found.measurement, "xy"[dof]
    waves, label = {
        "displacement": (found.displacement / MICROMETRE, f"displacement {name}, µm"),
        "velocity": (1e3 * found.velocity, f"velocity {name}, mm/s"),
        "angle": (
            np.broadcast_to(np.degrees(found.angle)[None, None], found.force.shape),
            "shaft angle after the phase reference, deg",
        ),
    }[over]
    largest = [int(case) for case in np.argsort(-found.rms, kind="stable")[:most] if found.usable[case]]
    for colour, case in zip(COLOURS, sorted(largest, key=lambda case: m.speed_rpm[case]), strict=False):
        at, force, error = (np.append(w[case, dof], w[case, dof, 0]) for w in (waves, found.force, found.force_error))
        if over == "angle":
            at[-1] = at[-2] + at[1] - at[0]
        axes.plot(
            at,
            force,
            "-",
            color=colour,
            linewidth=1.2,
            label=f"{plain(m.runs[m.run[case]])}, {m.speed_rpm[case]:.0f} rpm",
        )
        axes.fill_between(at, force - error, force + error, color=colour, alpha=0.2, linewidth=0.0)
    axes.axhline(0.0, color="0.8", linewidth=0.7, zorder=0)
    axes.set(xlabel=label, ylabel=f"force missing along {name}, N")
    if over == "angle":
        axes.set(
            xlim=(0.0, 360.0 * len(found.angle) / SAMPLES), xticks=np.arange(0, 361, 90) * len(found.angle) // SAMPLES
        )
    if largest:
        axes.set_ylim(_with_room(found.force[largest]))
    if largest and legend:
        axes.legend(fontsize=7, loc="upper center", ncols=2)
    axes.grid(alpha=0.3)
    return axes
