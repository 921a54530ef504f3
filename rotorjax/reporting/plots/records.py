"""Recordings: displacement over time and over the shaft angle."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes

from rotorjax.reporting.plots.canvas import COLOURS, plain, with_room
from rotorjax.units import MICROMETRE


def waveform(
    axes: Axes,
    time: Float[np.ndarray, "sample"],
    displacement: Float[np.ndarray, "sample probe"],
    pulses: Float[np.ndarray, "_"],
    *,
    probes: Sequence[str] = ("X", "Y"),
) -> Axes:
    """Displacement of two probes over time, phase-reference pulses as vertical lines. In s and m."""
    for k, name in enumerate(probes):
        axes.plot(1e3 * time, displacement[:, k] / MICROMETRE, "-", color=COLOURS[k], linewidth=1.0, label=plain(name))
    shown = pulses[(pulses >= time[0]) & (pulses <= time[-1])]
    for k, pulse in enumerate(shown):
        axes.axvline(
            1e3 * pulse, color="0.4", linestyle="--", linewidth=0.9, label="phase reference" if k == 0 else None
        )
    axes.set(xlabel="time, ms", ylabel="displacement, µm", ylim=with_room(displacement / MICROMETRE))
    axes.legend(fontsize=8, loc="upper center", ncols=3)
    axes.grid(alpha=0.3)
    return axes


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
        ylim=with_room(mean / MICROMETRE),
    )
    axes.legend(fontsize=8, loc="upper center", ncols=2)
    axes.grid(alpha=0.3)
    return axes
