"""Effects of the catalogue, and forces outside it, as they act on the detailed rotor: how large at first, and how they
are put in. NumPy only; the names and SI values are those of the catalogue, so that answers can be compared.
"""

import dataclasses
from collections.abc import Callable

import numpy as np

from detailed import forces as laws
from detailed.chain import Chain
from detailed.rotor import Frame, Rotor

PROBES = ("X", "Y")
SECOND_PLANE = "disk2"
DOWN = (0.0, -9.80665)


@dataclasses.dataclass(frozen=True)
class Plant:
    """The rotor as it is, with all that is hidden, and how it is read."""

    rotor: Rotor
    chain: Chain = dataclasses.field(default_factory=Chain)
    forces: tuple[laws.Force, ...] = ()
    speed_ratio: float = 1.0
    """True over stated speed."""
    second_plane: float = 1.0
    """True over stated participation of the second plane."""

    def rotor_with(self, **changes: object) -> "Plant":
        """The plant with some values of the rotor changed."""
        return dataclasses.replace(self, rotor=dataclasses.replace(self.rotor, **changes))  # pyright: ignore

    def chain_with(self, **changes: object) -> "Plant":
        """The plant with some values of the chain changed."""
        return dataclasses.replace(self, chain=dataclasses.replace(self.chain, **changes))  # pyright: ignore

    def pushed(self, force: laws.Force) -> "Plant":
        """The plant with one more nonlinear force."""
        return dataclasses.replace(self, forces=(*self.forces, force))


@dataclasses.dataclass(frozen=True)
class Scale:
    """What sizes are drawn in: of the rotor without anything hidden."""

    amplitude: float
    """Largest at 1X [m]."""
    mass: float
    """As the rig file states it [kg]."""
    stiffness: tuple[float, float]
    """That the disk feels [N/m]."""
    ratio: float
    """Mean damping ratio."""
    frequency: float
    """Mean natural frequency [rad/s]."""
    unbalance: float
    """Usual installed one [kg m]."""
    sag: float
    """Under the weight [m]."""
    shaft_share: float
    """Deflection of the shaft over that of the disk."""
    orders: tuple[int, ...]

    @property
    def spring(self) -> float:
        """Mean stiffness [N/m]."""
        return float(np.mean(self.stiffness))

    @property
    def push(self) -> float:
        """Damping force at the largest amplitude [N]."""
        return 2.0 * self.ratio * self.spring * self.amplitude


@dataclasses.dataclass(frozen=True)
class Hidden:
    """An effect with its values."""

    name: str
    values: dict[str, float]
    """Label of the catalogue -> value in SI, at size 1."""
    grows: tuple[str, ...]
    """Labels of the values that are proportional to the size."""
    put: Callable[[Plant, dict[str, float]], Plant]
    signed: bool = True
    """Whether every value of either sign is possible."""
    in_model: dict[str, float] = dataclasses.field(default_factory=dict)
    """Factor that turns values into what a model without this detail has for them, where that is no more than an
    estimate.
    """
    exact: bool = True
    """Whether the values are true in a model without this detail, but for its tolerance."""

    def at(self, size: float) -> dict[str, float]:
        """Values at a size."""
        return {label: v * size if label in self.grows else v for label, v in self.values.items()}

    def applied(self, plant: Plant, size: float) -> Plant:
        """A plant with this effect beside what it has."""
        return self.put(plant, self.at(size))

    def truth(self, size: float) -> dict[str, float]:
        """Values in the terms of the model."""
        return {label: v * self.in_model.get(label, 1.0) for label, v in self.at(size).items()}


def _pair(name: str, *labels: str, put, exact: bool = True):
    """A vector (x, y) of any direction."""

    def make(rng: np.random.Generator, scale: float, factor: float = 1.0) -> Hidden:
        z = scale * np.exp(2j * np.pi * rng.random())
        values = dict(zip(labels, (float(z.real), float(z.imag)), strict=True))
        return Hidden(name, values, labels, put, in_model=dict.fromkeys(labels, factor), exact=exact)

    return make


def _signs(rng: np.random.Generator, labels: tuple[str, ...], scale: float) -> dict[str, float]:
    """Values of either sign, between half and three halves of a scale."""
    return {label: float(scale * rng.uniform(0.5, 1.5) * rng.choice([-1.0, 1.0])) for label in labels}


def _excitation(name: str, rng: np.random.Generator, s: Scale) -> Hidden:
    if name == "residual_unbalance":
        labels = "unbalance_x_kg_m", "unbalance_y_kg_m"
        make = _pair(name, *labels, put=lambda p, v: p.rotor_with(unbalance=p.rotor.unbalance + complex(*v.values())))
        return make(rng, 0.2 * s.unbalance)
    if name == "residual_bow":
        make = _pair(name, "bow_x_m", "bow_y_m", put=lambda p, v: p.rotor_with(bow=p.rotor.bow + complex(*v.values())))
        return make(rng, 0.2 * s.unbalance / s.mass)
    if name == "thermal_bow":
        make = _pair(
            name, "bow_x_m", "bow_y_m", put=lambda p, v: p.rotor_with(thermal_bow=complex(*v.values())), exact=False
        )
        return make(rng, 0.2 * s.unbalance / s.mass)
    if name == "misalignment":
        labels = (
            "force_1_x_n", "force_1_y_n", "force_2_x_real_n", "force_2_x_imaginary_n", "force_2_y_real_n",
            "force_2_y_imaginary_n",
        )  # fmt: skip

        def put(plant: Plant, v: dict[str, float]) -> Plant:
            a, b, c, d, e, f = v.values()
            return plant.rotor_with(force_1=complex(a, b), force_2=(complex(c, d), complex(e, f)))

        return Hidden(name, _signs(rng, labels, s.push), labels, put)
    label = f"gain.{SECOND_PLANE}"
    return Hidden(
        name, _signs(rng, (label,), 0.1), (label,), lambda p, v: dataclasses.replace(p, second_plane=1.0 + v[label])
    )


def _structure(name: str, rng: np.random.Generator, s: Scale) -> Hidden:
    k = np.array(s.stiffness)
    both = "error_x", "error_y"

    def springs(v: dict[str, float]) -> tuple[float, ...]:
        return tuple(float(e * stiffness) for e, stiffness in zip(v.values(), k, strict=True))

    def foundation(plant: Plant, v: dict[str, float]) -> Plant:
        own = s.frequency * np.exp(v["log_frequency"])
        stiffness = 1.0 / v["compliance_m_per_n"]
        damping = 2 * 0.05 * np.exp(v["log_damping"]) * stiffness / own
        return plant.rotor_with(frame=Frame(stiffness, stiffness / own**2, damping))

    one = "angle_rad", "cross_stiffness_n_per_m", "damping_n_s_per_m", "inertia_ratio_kg", "compliance_m_per_n"
    made: dict[str, Callable[[], Hidden]] = {
        "stiffness_error": lambda: Hidden(
            name, _signs(rng, both, 0.05), both, lambda p, v: p.rotor_with(spring=springs(v))
        ),
        "mass_error": lambda: Hidden(
            name, _signs(rng, ("error",), 0.05), ("error",), lambda p, v: p.rotor_with(mass_added=v["error"] * s.mass)
        ),
        "damping_error": lambda: Hidden(
            name, _signs(rng, ("log_ratio_x", "log_ratio_y"), 0.4), ("log_ratio_x", "log_ratio_y"),
            lambda p, v: p.rotor_with(damping_factor=tuple(np.exp(list(v.values())))), exact=False,
        ),
        "stiffness_axes": lambda: Hidden(
            name, _signs(rng, one[:1], 0.2), one[:1], lambda p, v: p.rotor_with(axes=v["angle_rad"]), exact=False
        ),
        "cross_coupling": lambda: Hidden(
            name, _signs(rng, one[1:2], 0.5 * s.ratio * s.spring), one[1:2], lambda p, v: p.rotor_with(cross=v[one[1]])
        ),
        "speed_dependent_stiffness": lambda: Hidden(
            name, _signs(rng, both, 0.05), both, lambda p, v: p.rotor_with(spring_growing=springs(v))
        ),
        "internal_damping": lambda: Hidden(
            name, {one[2]: 2 * s.ratio * s.mass * s.frequency * 0.5}, one[2:3],
            lambda p, v: p.rotor_with(internal=v[one[2]]), signed=False,
        ),
        "gyroscopic": lambda: Hidden(
            name, {one[3]: 0.05 * s.mass}, one[3:4], lambda p, v: p.rotor_with(gyroscopic=v[one[3]]), signed=False
        ),
        "foundation": lambda: Hidden(
            name, {one[4]: 0.05 / s.spring, "log_frequency": float(rng.uniform(-1.0, 1.0)),
                   "log_damping": float(rng.uniform(-1.0, 1.0))},
            one[4:5], foundation, signed=False, exact=False,
        ),
    }  # fmt: skip
    return made[name]()


def _restoring(name: str, rng: np.random.Generator, s: Scale, gravity: tuple[float, float]) -> Hidden:
    a, share = s.amplitude, s.shaft_share
    stop = "stiffness_n_per_m", "inverse_gap_per_m", "friction"
    reach = a + (s.sag if any(gravity) else 0.0)
    gap = float(rng.uniform(0.5, 0.85) * reach)
    touch = {stop[0]: 0.2 * s.spring, stop[1]: 1.0 / gap, stop[2]: float(rng.uniform(0.05, 0.25))}
    cubic, dragged, dry = "cubic_n_per_m3", "damping_n_s2_per_m2", "force_n"
    loss, half = ("loss_x_n_per_m", "loss_y_n_per_m"), ("difference_x_n_per_m", "difference_y_n_per_m")

    def pushes(make: Callable[[dict[str, float]], laws.Force]) -> Callable[[Plant, dict[str, float]], Plant]:
        return lambda plant, v: plant.pushed(make(v))

    if name in ("crack", "asymmetric_shaft"):
        make = (
            pushes(lambda v: laws.crack(complex(*v.values()), gravity))
            if name == "crack"
            else pushes(lambda v: laws.unequal_shaft(complex(*v.values())))
        )
        labels, size = (loss, 0.05) if name == "crack" else (half, 0.02)
        return _pair(name, *labels, put=make, exact=False)(rng, size * s.spring, share**2)
    sign = -1.0 if rng.random() < 0.3 else 1.0
    values, grows, make = {
        "duffing": ({cubic: sign * s.push / a**3}, (cubic,), pushes(lambda v: laws.power(v[cubic], 3))),
        "clearance": (
            {label: touch[label] for label in stop[:2]},
            stop[:1],
            pushes(lambda v: laws.stop(v[stop[0]], 1.0 / v[stop[1]])),
        ),
        "rub": (touch, stop[:1], pushes(lambda v: laws.stop(v[stop[0]], 1.0 / v[stop[1]], v[stop[2]]))),
        "quadratic_damping": (
            {dragged: s.push / (s.frequency * a) ** 2},
            (dragged,),
            pushes(lambda v: laws.drag(v[dragged])),
        ),
        "coulomb_friction": ({dry: 0.3 * s.push}, (dry,), pushes(lambda v: laws.dry_friction(v[dry]))),
    }[name]
    on_shaft = name == "duffing"
    factor = {cubic: share**4} if on_shaft else {}
    return Hidden(name, values, grows, make, signed=on_shaft, in_model=factor, exact=not on_shaft)


def _reading(name: str, rng: np.random.Generator, s: Scale) -> Hidden:
    gains, angles = (tuple(f"{label}.{p}" for p in PROBES) for label in ("gain", "angle_rad"))
    orders = [n for n in s.orders if n > 0]
    runout = tuple(f"{part}_m.{p}.{n}X" for part in ("real", "imaginary") for p in PROBES for n in orders)

    def added(plant: Plant, v: dict[str, float]) -> Plant:
        found = {n: [complex(v[f"real_m.{p}.{n}X"], v[f"imaginary_m.{p}.{n}X"]) for p in PROBES] for n in orders}
        return plant.chain_with(runout=found)

    def turned(plant: Plant, v: dict[str, float]) -> Plant:
        return plant.chain_with(angles=tuple(a + e for a, e in zip(plant.chain.angles, v.values(), strict=True)))

    made: dict[str, Callable[[], tuple[dict[str, float], Callable[[Plant, dict[str, float]], Plant]]]] = {
        "probe_gain": lambda: (
            _signs(rng, gains, 0.05), lambda p, v: p.chain_with(gains=tuple(1.0 + g for g in v.values()))
        ),
        "chain_gain": lambda: (
            _signs(rng, ("gain_real", "gain_imaginary"), 0.07),
            lambda p, v: p.chain_with(common_gain=1.0 + complex(*v.values())),
        ),
        "probe_angle": lambda: (_signs(rng, angles, 0.07), turned),
        "phase_reference_offset": lambda: (
            _signs(rng, ("angle_rad",), 0.2), lambda p, v: p.chain_with(reference=v["angle_rad"])
        ),
        "time_delay": lambda: (
            _signs(rng, ("delay_s",), 0.1 / s.frequency), lambda p, v: p.chain_with(delay=v["delay_s"])
        ),
        "runout": lambda: (_signs(rng, runout, 0.02 * s.amplitude), added),
        "probe_saturation": lambda: (
            {"inverse_limit_per_m": 0.3 / s.amplitude},
            lambda p, v: p.chain_with(inverse_limit=v["inverse_limit_per_m"]),
        ),
        "speed_error": lambda: (
            _signs(rng, ("error",), 0.01), lambda p, v: dataclasses.replace(p, speed_ratio=1.0 + v["error"])
        ),
    }  # fmt: skip
    values, put = made[name]()
    return Hidden(name, values, tuple(values), put, signed=name != "probe_saturation")


FAMILIES: dict[str, tuple[str, ...]] = {
    "excitation": ("residual_unbalance", "residual_bow", "thermal_bow", "misalignment", "plane_participation"),
    "structure": (
        "stiffness_error", "mass_error", "damping_error", "stiffness_axes", "cross_coupling",
        "speed_dependent_stiffness", "internal_damping", "foundation", "gyroscopic",
    ),
    "restoring": (
        "duffing", "clearance", "rub", "crack", "asymmetric_shaft", "quadratic_damping", "coulomb_friction",
    ),
    "reading": (
        "probe_gain", "chain_gain", "probe_angle", "phase_reference_offset", "time_delay", "runout",
        "probe_saturation", "speed_error",
    ),
}  # fmt: skip
EFFECTS = tuple(name for names in FAMILIES.values() for name in names)
"""All of the catalogue that show at steady speeds can be hidden, but speed_dependent_damping and
speed_dependent_cross_coupling, which came after them.
"""
OUTSIDE = ("slider", "fifth_power", "late_force", "switched_stiffness", "cubic_drag")
"""Forces that the catalogue does not have."""
WEIGHED = ("crack", "asymmetric_shaft")
"""Told by what the weight makes of them."""
TWICE = ("misalignment", *WEIGHED, "switched_stiffness")
"""Seen at 2X."""


def effect(name: str, rng: np.random.Generator, scale: Scale, gravity: tuple[float, float]) -> Hidden:
    """An effect of the catalogue, its direction and what does not grow with its size drawn."""
    family = next(family for family, names in FAMILIES.items() if name in names)
    if family == "restoring":
        return _restoring(name, rng, scale, gravity)
    return {"excitation": _excitation, "structure": _structure, "reading": _reading}[family](name, rng, scale)


def outside(name: str, rng: np.random.Generator, s: Scale) -> Hidden:
    """A force that the catalogue does not have."""
    a, phase, direction = s.amplitude, float(rng.uniform(0, 2 * np.pi)), float(rng.uniform(0, np.pi))
    delay = float(rng.uniform(1.0, 3.0) * 2 * np.pi / s.frequency)
    spread = 0.02 * s.frequency * a
    strength, put = {
        "slider": (0.5 * s.push, lambda p, v: p.pushed(laws.slider(v["size"], direction, spread))),
        "fifth_power": (s.push / a**5, lambda p, v: p.pushed(laws.power(v["size"], 5))),
        "late_force": (0.5 * s.push / a, lambda p, v: p.rotor_with(late=(v["size"], delay))),
        "switched_stiffness": (
            0.03 * s.spring,
            lambda p, v: p.pushed(laws.switched_stiffness(v["size"], phase, direction)),
        ),
        "cubic_drag": (s.push / (s.frequency * a) ** 3, lambda p, v: p.pushed(laws.drag(v["size"], 3))),
    }[name]
    return Hidden(name, {"size": strength}, ("size",), put, signed=False)
