"""Where a model fails, how the error falls, what is probable, and the force that is missing."""

from typing import Literal

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm

from rotorjax.discovery.compare import Comparison
from rotorjax.discovery.missing_force import MissingForce
from rotorjax.reporting.plots.canvas import COLOURS, MARKERS, distinct_styles, logarithmic, plain, with_room
from rotorjax.reporting.wording import percent
from rotorjax.units import MICROMETRE

NOTHING_UM = 1e-9
"""Errors not above this are those of rounding [µm]."""


def residual_map(axes: Axes, view: Comparison, *, limits_um: tuple[float, float] | None = None) -> Axes:
    """|residual| [µm] as a map: runs down, probe and speed across; grey where nothing was measured."""
    m = view.measurement
    cluster, speeds = m.speed_cluster()
    columns = [
        (s, k, n)
        for n in range(len(m.orders))
        for k, probe in enumerate(m.probes)
        if probe in m.probes_read
        for s in range(len(speeds))
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
    """The error step by step as effects were added, with the error on held-out data and the level of the noise.

    What is nothing but rounding stands as 0 at the bottom.
    """
    at = np.arange(len(labels))
    noise = [] if noise_um is None else [noise_um]
    low, high, rms, held_out = _error_heights(rms_um, held_out_um, noise)
    axes.plot(at, rms, "o-", color=COLOURS[0], markersize=7, linewidth=1.2, label="all data")
    held = [(x, h) for x, h in zip(at, held_out, strict=True) if h is not None]
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
    for level in noise:
        axes.axhline(level, color="0.3", linestyle="--", linewidth=1.0, label="noise alone (√2 standard errors)")
    for x, y, value in zip(at, rms, rms_um, strict=True):
        words = f"{value:#.3g}".rstrip(".") if value > NOTHING_UM else "0"
        axes.annotate(words, (x, y), textcoords="offset points", xytext=(8, 4), fontsize=8)
    axes.set_ylim(low, high)
    logarithmic(axes)
    axes.set_xticks(at, labels, fontsize=8)
    axes.set(ylabel="rms |residual|, µm", xlim=(-0.4, len(labels) - 0.4))
    # Above the axes: inside it would hide points and their numbers.
    axes.legend(fontsize=8, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, frameon=False)
    axes.grid(axis="y", alpha=0.3)
    return axes


def _error_heights(
    rms_um: list[float], held_out_um: list[float | None], noise_um: list[float]
) -> tuple[float, float, list[float], list[float | None]]:
    """Limits that hold every error and the noise, and where the errors are drawn: what is nothing at the floor, a
    decade below the least that is seen; at zero where nothing is.
    """
    every = [*rms_um, *(h for h in held_out_um if h is not None), *noise_um]
    seen = [value for value in every if value > NOTHING_UM]
    if not seen:
        return -0.05, 1.0, [0.0] * len(rms_um), [None if h is None else 0.0 for h in held_out_um]
    floor = min(seen) / (1.0 if len(seen) == len(every) else 10.0)
    held_out = [None if h is None else max(h, floor) for h in held_out_um]
    return floor / 2.0, 3.0 * max(seen), [max(value, floor) for value in rms_um], held_out


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
    for (colour, marker), case in zip(
        distinct_styles(), sorted(largest, key=lambda case: m.speed_rpm[case]), strict=False
    ):
        at, force, error = (np.append(w[case, dof], w[case, dof, 0]) for w in (waves, found.force, found.force_error))
        if over == "angle":
            at[-1] = at[-2] + at[1] - at[0]
        style = {"color": colour, "linewidth": 1.2, "markersize": 4, "markevery": 8}
        words = f"{plain(m.runs[m.run[case]])}, {m.speed_rpm[case]:.0f} rpm"
        axes.plot(at, force, "-" if marker == MARKERS[0] else f"{marker}-", label=words, **style)
        axes.fill_between(at, force - error, force + error, color=colour, alpha=0.2, linewidth=0.0)
    axes.axhline(0.0, color="0.8", linewidth=0.7, zorder=0)
    axes.set(xlabel=label, ylabel=f"force missing along {name}, N")
    if over == "angle":
        period = len(found.angle) * np.degrees(found.angle[1])
        axes.set(xlim=(0.0, period), xticks=np.linspace(0.0, period, 5))
    if largest:
        axes.set_ylim(with_room(found.force[largest]))
    if largest and legend:
        axes.legend(fontsize=7, loc="upper center", ncols=2)
    axes.grid(alpha=0.3)
    return axes
