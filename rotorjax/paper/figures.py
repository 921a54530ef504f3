"""The paper's figures that can be drawn again: 4, 7, 9 and 10."""

import numpy as np
from matplotlib.figure import Figure

from rotorjax.data import signals
from rotorjax.data.pulses import shaft_angle
from rotorjax.diagnosis.compensation import value_errors
from rotorjax.diagnosis.features import vectors_of
from rotorjax.paper.printed import SPEEDS
from rotorjax.paper.schemes import mean_errors_printed, schemes
from rotorjax.paper.study import FRACTION, Study
from rotorjax.reporting import plots
from rotorjax.units import RPM

RATE, SECONDS = 2000.0, 2.0
"""Sampling rate of the paper's sensors [1/s], and length of the simulated record [s]."""
NOISE = 5e-6
"""Of each simulated sample [m]."""


def figures(study: Study) -> dict[str, tuple[Figure, str]]:
    """File name -> figure and caption."""
    return {
        "figure_04": (
            figure_04(study),
            "Figure 4: errors of the network as published on the noise-free test cases at 1500 rpm, in g mm and mm.",
        ),
        "figure_07": (
            figure_07(study),
            "Figure 7: a simulated record (2 kHz, 5 µm noise per sample; the measured one is not public) and its phase "
            "picture.",
        ),
        "figure_09": (
            figure_09(study),
            "Figure 9: self-compensation of the same-quadrant case at 1500 rpm, by Newton's method and by the paper's "
            "increments.",
        ),
        "figure_10": (
            figure_10(study),
            "Figure 10: mean errors of the four cases, the paper's and ours; the last two with the tested case left "
            "out.",
        ),
    }


def figure_04(study: Study) -> Figure:
    """Errors over the test cases."""
    found = (
        study.training_as_published.network.diagnose(study.test.features) - np.asarray(study.test.faults)
    ) * np.array([1e6, 1e6, 1e3, 1e3])
    drawn, axes = plots.figure(10.0, 5.4, 2, 2)
    for k, (ax, name) in enumerate(zip(axes, ("U_x, g mm", "U_y, g mm", "s_x, mm", "s_y, mm"), strict=True)):
        plots.error_cloud(ax, found[:, k], label=f"error of {name}", rms=float(np.sqrt(np.mean(found[:, k] ** 2))))
    return drawn


def simulated_record(study: Study, *, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time [s], displacement of X and Y [m] and pulses [s] as the same-quadrant case would give at a slowly varying
    1500 rpm.
    """
    time = np.arange(int(SECONDS * RATE)) / RATE
    angle = SPEEDS[0] * RPM * (time + 2e-4 * np.sin(2.0 * np.pi * 0.4 * time)) - 0.3
    z = vectors_of(study.rebuilt[SPEEDS[0]].features[0])
    clean = np.real(z[None] * np.exp(1j * angle)[:, None])
    displacement = clean + NOISE * np.random.default_rng(seed).standard_normal(clean.shape)
    turns = np.arange(np.ceil(angle[0] / (2.0 * np.pi)), np.floor(angle[-1] / (2.0 * np.pi)) + 1.0)
    return time, displacement, np.interp(2.0 * np.pi * turns, angle, time)


def figure_07(study: Study) -> Figure:
    """A record, and its phase picture."""
    time, displacement, pulses = simulated_record(study)
    folded = signals.fold(shaft_angle(time, pulses), displacement)
    drawn, (left, right) = plots.figure(10.5, 3.6, 1, 2)
    shown = time < 0.13
    plots.waveform(left, time[shown], displacement[shown], pulses)
    plots.phase_picture(right, folded.angle_deg, folded.mean, folded.scatter)
    return drawn


def figure_09(study: Study) -> Figure:
    """Largest error by step."""
    newton, loop = study.compensations[SPEEDS[0]][0], study.loop
    drawn, (axes,) = plots.figure(7.5, 3.8)
    label = f"increments of {100.0 * FRACTION:.3g} % ({loop.steps} steps)"
    plots.convergence(
        axes,
        {f"Newton ({newton.steps} steps)": newton.errors.max(axis=1), label: loop.errors.max(axis=1)},
        tolerance=1e-3,
    )
    return drawn


def figure_10(study: Study) -> Figure:
    """Mean errors by scheme: magnitudes above, angles below, one column per speed."""
    drawn, axes = plots.figure(12.0, 6.6, 2, 2)
    for column, speed in enumerate(SPEEDS):
        ours, paper = schemes(study, speed), mean_errors_printed(speed)
        means = {
            scheme: np.mean(value_errors(faults, study.rebuilt[speed].induced), axis=0)
            for scheme, faults in ours.items()
        }
        for row, (parameters, unit) in enumerate((((0, 2), "%"), ((1, 3), "°"))):
            series = {"no compensation": [means["none"][k] for k in parameters]}
            series |= {f"{name}, paper": [paper[k][name] for k in parameters] for name in ("IFbC", "IFC")}
            series |= {
                "IFC = IFbC, left out": [means["IFC, left out"][k] for k in parameters],
                "gain, left out": [means["gain, left out"][k] for k in parameters],
            }
            names = [("U", "α", "s", "θ")[k] for k in parameters]
            plots.grouped_bars(axes[2 * row + column], names, series, ylabel=f"mean error, {unit}").set_title(
                f"{speed:.0f} rpm" if row == 0 else ""
            )
    return drawn
