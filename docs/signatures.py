"""The small picture of every effect: what a probe shows over speed without it and with it."""

from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MultipleLocator

from rotorjax import Conditions, Effect, Jeffcott, Layout, Model, response
from rotorjax.effects import CATALOG
from rotorjax.reporting.plots import COLOURS, figure
from rotorjax.units import GRAVITY, MICROMETRE, RPM

MASS, STIFFNESS, DAMPING_RATIO = 1.0, (56500.0, 51300.0), 0.03
"""The standard rotor: unequal axes, critical speeds of 2270 and 2163 rpm."""
SPEEDS = np.linspace(0.3, 1.6, 131)
"""Times the mean natural frequency."""


class Sizes(NamedTuple):
    """Which sizes of an effect are drawn, and where."""

    scales: tuple[dict[str, float] | float, ...] = (1.0, 3.0)
    """In prior scales: of every parameter, or of those named."""
    orders: tuple[float, ...] = (1.0,)
    """With one, amplitude and phase; with two, the amplitude of each."""
    probe: str = "Y"
    gravity: bool = False


_CONTACT = ({"stiffness_n_per_m": 0.2, "inverse_gap_per_m": 0.5}, {"stiffness_n_per_m": 0.5, "inverse_gap_per_m": 0.5})
_TWICE = (1.0, 2.0)
DRAWN: dict[str, Sizes] = {
    "residual_unbalance": Sizes((0.3, 1.0)),
    "residual_bow": Sizes((0.3, 1.0)),
    "thermal_bow": Sizes((0.3, 1.0)),
    "misalignment": Sizes((0.3, 1.0), _TWICE),
    "plane_participation": Sizes((2.0, 5.0)),
    "sweep_rate": Sizes((0.3, 2.0)),
    "stiffness_error": Sizes((1.0, -1.0)),
    "mass_error": Sizes((1.0, -1.0)),
    "damping_error": Sizes((1.0, -1.0)),
    "stiffness_axes": Sizes((1.0, 3.0)),
    "cross_coupling": Sizes((1.0, -1.0)),
    "speed_dependent_stiffness": Sizes((1.0, -1.0)),
    "speed_dependent_damping": Sizes((1.0,)),
    "speed_dependent_cross_coupling": Sizes((1.0, -1.0)),
    "internal_damping": Sizes((1.0, 2.0)),
    "foundation": Sizes(
        tuple({"compliance_m_per_n": 1.0, "log_frequency": at, "log_damping": -1.0} for at in (-0.5, 0.5))
    ),
    "gyroscopic": Sizes((1.0, 3.0)),
    "duffing": Sizes((0.3, -0.3), _TWICE, gravity=True),
    "clearance": Sizes(_CONTACT, _TWICE, gravity=True),
    "rub": Sizes(tuple({**sizes, "friction": 1.0} for sizes in _CONTACT), _TWICE, gravity=True),
    "crack": Sizes((1.0, 2.0), _TWICE, gravity=True),
    "asymmetric_shaft": Sizes((1.0, 2.0), _TWICE, gravity=True),
    "quadratic_damping": Sizes((0.1, 0.5)),
    "coulomb_friction": Sizes((1.0, 3.0)),
    "probe_gain": Sizes((2.0, -2.0)),
    "chain_gain": Sizes((1.0, 3.0)),
    "probe_angle": Sizes((2.0, -2.0)),
    "phase_reference_offset": Sizes((1.0, -1.0)),
    "time_delay": Sizes((2.0, 5.0)),
    "runout": Sizes((1.0, 3.0)),
    "probe_saturation": Sizes((0.5, 1.0), (1.0, 3.0)),
    "speed_error": Sizes((2.0, -2.0)),
}


def signature(name: str) -> tuple[Figure, dict[str, str]]:
    """The picture of one effect, and the values behind each of its lines."""
    sizes = DRAWN.get(name, Sizes())
    bare = _rotor(sizes)
    effects = {_label(k, scales): _sized(CATALOG[name], bare, scales) for k, scales in enumerate(sizes.scales, start=1)}
    speeds = SPEEDS * float(bare.rotor.natural_frequency())
    lines = {"without": _shown(bare, speeds, sizes)}
    lines |= {label: _shown(bare + effect, speeds, sizes) for label, effect in effects.items()}
    drawn, axes = figure(8.6, 3.2, 1, 2)
    _amplitude(axes[0], lines, speeds, sizes, 0)
    if len(sizes.orders) > 1:
        _amplitude(axes[1], lines, speeds, sizes, 1)
    else:
        _phase(axes[1], lines, speeds, sizes.probe)
    handles, labels = axes[0].get_legend_handles_labels()
    drawn.legend(handles, labels, loc="outside upper center", ncols=len(lines), fontsize=8)
    return drawn, {label: _values(effect) for label, effect in effects.items()}


def _rotor(sizes: Sizes) -> Model:
    down = (0.0, -GRAVITY) if sizes.gravity else (0.0, 0.0)
    rotor = Jeffcott(MASS, STIFFNESS, DAMPING_RATIO, gravity=down)
    return Model(
        rotor, participation=np.array([1.0, 1.0]), layout=Layout(("X", "Y"), ("first", "second"), sizes.orders)
    )


def _sized(cls: type[Effect], model: Model, scales: dict[str, float] | float) -> Effect:
    """The effect at so many prior scales."""
    by_name = scales if isinstance(scales, dict) else {p.name: scales for p in cls.parameters()}
    values = {p.name: by_name.get(p.name, 0.0) * p.prior_scale(model.rotor) for p in cls.parameters()}
    return cls(**values).sized(model.layout)


def _shown(model: Model, speeds: np.ndarray, sizes: Sizes) -> np.ndarray:
    """Vectors of the probe drawn, speed by order [µm], with an unbalance of grade G6.3 in the second plane."""
    unbalance = model.rotor.quantities()["unbalance"]
    conditions = Conditions.at(speeds, unbalance=np.array([[0.0, 0.0], [unbalance, 0.0]]))
    vectors = np.asarray(response(model, conditions))[:, model.layout.probes.index(sizes.probe)]
    return vectors / MICROMETRE


def _amplitude(axes: Axes, lines: dict[str, np.ndarray], speeds: np.ndarray, sizes: Sizes, order: int) -> None:
    for (label, line), style in zip(lines.items(), _STYLES, strict=False):
        size = np.abs(line[:, order])
        axes.plot(speeds / RPM, np.where(size > 1e-6, size, np.nan), label=label, **style)
    axes.set_yscale("log")
    axes.set(ylabel=f"{sizes.probe} {sizes.orders[order]:g}X amplitude, µm (0-peak)", **_over(speeds))
    axes.grid(alpha=0.3, which="both", linewidth=0.5)


def _phase(axes: Axes, lines: dict[str, np.ndarray], speeds: np.ndarray, probe: str) -> None:
    for line, style in zip(lines.values(), _STYLES, strict=False):
        axes.plot(speeds / RPM, np.degrees(np.unwrap(np.angle(line[:, 0]))), **style)
    axes.set(ylabel=f"{probe} 1X phase lead, degrees", **_over(speeds))
    axes.yaxis.set_major_locator(MultipleLocator(45.0))
    axes.grid(alpha=0.3)


def _over(speeds: np.ndarray) -> dict[str, object]:
    """The axis of speeds, the same in all pictures."""
    return {"xlabel": "speed, rpm", "xlim": (speeds[0] / RPM, speeds[-1] / RPM)}


_STYLES = (
    {"color": "0.45", "linestyle": "--", "linewidth": 1.4},
    {"color": COLOURS[0], "linewidth": 1.5},
    {"color": COLOURS[1], "linewidth": 1.5},
)


def _label(number: int, scales: dict[str, float] | float) -> str:
    """The name of a line."""
    return f"{scales:g} × prior scale".replace("-", "−") if isinstance(scales, float) else f"size {number}"


def _values(effect: Effect) -> str:
    """Its values in the units that people read, one per parameter."""
    parts = []
    for declared, value in zip(effect.parameters(), effect.values(), strict=True):
        number = float(np.ravel(value)[0]) / declared.unit.factor
        unit = "" if declared.unit.shown == "1" else f" {declared.unit.shown}"
        parts.append(f"{declared.name} {number:.3g}{unit}")
    return ", ".join(parts)
