"""Effects of the catalogue, one or two, drawn by seed with machine, plan, noise and what is poor about the measurement;
integrated in time, longhand.
"""

import dataclasses
from collections.abc import Callable

import numpy as np

from rotorjax import Conditions, Jeffcott, Knowledge, Layout, Measurement, Model
from rotorjax.data.knowledge import Uncertain

import nonlinear_oracle as in_time
from hidden import Machine
from nonlinear_oracle import DOWN, NonlinearRotor
from poor_data import cut

RESTORING = ("duffing", "clearance", "rub", "crack", "asymmetric_shaft", "quadratic_damping", "coulomb_friction")
LINEAR = (
    "stiffness_error", "damping_error", "mass_error", "residual_unbalance", "residual_bow", "cross_coupling",
    "probe_gain", "phase_reference_offset", "time_delay", "probe_angle",
)  # fmt: skip
MAIN = (*RESTORING, *RESTORING, *LINEAR, "nothing")
"""Take turns."""
HANDICAPS = ("none", "none", "one probe", "one run", "noise unknown", "uncertain mass")
ORDERS = ((1.0,), (1.0, 2.0), (1.0, 2.0, 3.0), (0.0, 1.0, 2.0, 3.0))
WEIGHED = ("crack", "asymmetric_shaft")
"""Told by what the weight makes of them."""
STOP = ("stiffness_n_per_m", "inverse_gap_per_m")
LABELS = {
    "duffing": ("cubic_n_per_m3",),
    "clearance": STOP,
    "rub": (*STOP, "friction"),
    "crack": ("loss_x_n_per_m", "loss_y_n_per_m"),
    "asymmetric_shaft": ("difference_x_n_per_m", "difference_y_n_per_m"),
    "quadratic_damping": ("damping_n_s2_per_m2",),
    "coulomb_friction": ("force_n",),
    "cross_coupling": ("cross_stiffness_n_per_m",),
    "stiffness_error": ("error_x", "error_y"),
    "mass_error": ("error",),
    "damping_error": ("log_ratio_x", "log_ratio_y"),
    "residual_unbalance": ("unbalance_x_kg_m", "unbalance_y_kg_m"),
    "residual_bow": ("bow_x_m", "bow_y_m"),
    "probe_gain": ("gain.X", "gain.Y"),
    "phase_reference_offset": ("angle_rad",),
    "time_delay": ("delay_s",),
    "probe_angle": ("angle_rad.X", "angle_rad.Y"),
}
"""What the catalogue calls the values of an effect, in their order here; a complex one is two."""


@dataclasses.dataclass(frozen=True)
class Hidden:
    """What is hidden, and how well it can be seen."""

    effects: tuple[str, ...]
    handicap: str
    model: Model
    measurement: Measurement
    weight: bool
    truth: dict[str, dict[str, float]]
    """Effect -> label -> value in SI: what is hidden, and the mass where it is declared uncertain."""
    sigma: float
    """Standard error of real and imaginary part, whether the measurement says it or not [m]."""

    @property
    def words(self) -> str:
        """The measurement in a few words."""
        m = self.measurement
        orders = " ".join(f"{order:g}" for order in m.orders)
        return f"{len(m.run)} cases, orders {orders}{', weight' if self.weight else ''}" + (
            f", {self.handicap}" if self.handicap != "none" else ""
        )


@dataclasses.dataclass
class _Rotor:
    """One rotor as it is, to be changed by what is hidden."""

    machine: Machine
    amplitude: float
    """Largest of the rotor without what is hidden [m]."""
    grade: float
    """Largest unbalance installed [kg m]."""
    rng: np.random.Generator
    gravity: tuple[float, float]
    unbalance: complex = 0.0
    bow: complex = 0.0
    forces: tuple[in_time.Force, ...] = ()
    probes: tuple[float, float] = (0.0, np.pi / 2)
    gains: tuple[float, float] = (1.0, 1.0)
    offset: float = 0.0
    delay: float = 0.0
    sizes: dict[str, dict[str, float]] = dataclasses.field(default_factory=dict)
    """Effect -> label -> value in SI, of the forces added."""

    @property
    def push(self) -> float:
        """A force between half and three times the damping force at the largest amplitude [N]."""
        return (
            2
            * np.mean(self.machine.ratio)
            * np.mean(self.machine.stiffness)
            * self.amplitude
            * self.rng.uniform(0.5, 3.0)
        )

    def part(self, low: float, high: float) -> float:
        return float(self.rng.uniform(low, high) * self.rng.choice([-1.0, 1.0]))

    def turned(self, size: float) -> complex:
        return complex(size * np.exp(2j * np.pi * self.rng.random()))

    def hide(self, name: str) -> None:
        """Add an effect of a size that is drawn."""
        rng, a, stiffness = self.rng, self.amplitude, float(np.mean(self.machine.stiffness))
        reach = a + (-self.gravity[1] * self.machine.mass / stiffness)
        gap, stop = rng.uniform(0.5, 0.85) * reach, rng.uniform(0.1, 0.6) * stiffness
        actions: dict[str, Callable[[], object]] = {
            "nothing": lambda: None,
            "duffing": lambda: self._add("duffing", self.push / a**3 * (-0.4 if rng.random() < 0.3 else 1.0)),
            "clearance": lambda: self._add("clearance", stop, gap),
            "rub": lambda: self._add("rub", stop, gap, rng.uniform(0.05, 0.25)),
            "crack": lambda: self._add("crack", self.turned(rng.uniform(0.03, 0.1) * stiffness)),
            "asymmetric_shaft": lambda: self._add("asymmetric_shaft", self.turned(rng.uniform(0.01, 0.04) * stiffness)),
            "quadratic_damping": lambda: self._add("quadratic_damping", self.push / (self.machine.frequency * a) ** 2),
            "coulomb_friction": lambda: self._add("coulomb_friction", 0.5 * self.push),
            "cross_coupling": lambda: self._add(
                "cross_coupling", self.part(0.2, 0.6) * 2 * np.mean(self.machine.ratio) * stiffness
            ),
            "stiffness_error": lambda: self._set(
                stiffness=tuple(k * (1 + self.part(0.02, 0.06)) for k in self.machine.stiffness)
            ),
            "mass_error": lambda: self._set(mass=self.machine.mass * (1 + self.part(0.02, 0.06))),
            "damping_error": lambda: self._set(
                ratio=tuple(z * np.exp(self.part(0.2, 0.6)) for z in self.machine.ratio)
            ),
            "residual_unbalance": lambda: setattr(self, "unbalance", self.turned(rng.uniform(0.1, 0.6) * self.grade)),
            "residual_bow": lambda: setattr(
                self, "bow", self.turned(rng.uniform(0.05, 0.4) * self.grade / self.machine.mass)
            ),
            "probe_gain": lambda: setattr(self, "gains", (1 + self.part(0.03, 0.1), 1 + self.part(0.03, 0.1))),
            "phase_reference_offset": lambda: setattr(self, "offset", self.part(0.1, 0.5)),
            "time_delay": lambda: setattr(self, "delay", rng.uniform(0.01, 0.05) * 2 * np.pi / self.machine.frequency),
            "probe_angle": lambda: setattr(self, "probes", (self.part(0.03, 0.1), np.pi / 2 + self.part(0.03, 0.1))),
        }
        actions[name]()

    def _add(self, name: str, *values: complex) -> None:
        """A force of these values, which are kept as the catalogue has them."""
        beside = {"rub": (1,), "crack": (1, self.gravity), "asymmetric_shaft": (1,)}.get(name, ())
        make = _cross if name == "cross_coupling" else getattr(in_time, name)
        self.forces = (*self.forces, make(*values, *beside))
        pairs = [(value.real, value.imag) if isinstance(value, complex) else (value,) for value in values]
        numbers = [float(number) for pair in pairs for number in pair]
        named = zip(LABELS[name], numbers, strict=True)
        self.sizes[name] = {label: 1.0 / number if label == "inverse_gap_per_m" else number for label, number in named}

    def truth(self, declared: Machine) -> dict[str, dict[str, float]]:
        """Effect -> label -> value in SI, of the forces added and of all other effects that may be hidden."""
        now = self.machine
        linear = {
            "stiffness_error": [
                k / nominal - 1.0 for k, nominal in zip(now.stiffness, declared.stiffness, strict=True)
            ],
            "mass_error": [now.mass / declared.mass - 1.0],
            "damping_error": [np.log(c / nominal) for c, nominal in zip(now.damping, declared.damping, strict=True)],
            "residual_unbalance": [self.unbalance.real, self.unbalance.imag],
            "residual_bow": [self.bow.real, self.bow.imag],
            "probe_gain": [gain - 1.0 for gain in self.gains],
            "phase_reference_offset": [-self.offset],
            "time_delay": [self.delay],
            "probe_angle": [self.probes[0], self.probes[1] - np.pi / 2],
        }
        labelled = {name: dict(zip(LABELS[name], map(float, values), strict=True)) for name, values in linear.items()}
        return {**labelled, **self.sizes}

    def _set(self, **values: object) -> None:
        """The machine with other values; damping forces stay what they are unless their ratio is changed."""
        before = self.machine.damping
        machine = dataclasses.replace(self.machine, **values)  # pyright: ignore
        if "ratio" not in values:
            ratio = tuple(c / (2 * np.sqrt(k * machine.mass)) for c, k in zip(before, machine.stiffness, strict=True))
            machine = dataclasses.replace(machine, ratio=ratio)  # pyright: ignore
        self.machine = machine

    def vectors(self, unbalances: list[complex], speed: float, orders: tuple[float, ...]) -> np.ndarray:
        """As the chain shows them, for every unbalance installed: gains, a turned reference, a late signal."""
        m = self.machine
        rotor = NonlinearRotor(m.mass, m.stiffness, m.damping, gravity=self.gravity, bow=self.bow, forces=self.forces)
        n = np.array(orders)
        shown = (
            rotor.vectors_of([one + self.unbalance for one in unbalances], speed, orders, self.probes)
            * np.array(self.gains)[:, None]
            * np.exp(-1j * n * (self.offset + speed * self.delay))
        )
        return np.where(n == 0.0, shown.real + 0j, shown)


def _cross(stiffness: float) -> in_time.Force:
    """k (y, -x)."""
    return lambda angle, q, v, d: stiffness * np.array([q[1], -q[0]])


def draw(seed: int) -> Hidden:
    """Effects take turns; all else is drawn anew until the rotor settles into a motion that repeats
    itself every turn.
    """
    rng = np.random.default_rng([1926, seed])
    main = MAIN[seed % len(MAIN)]
    while True:
        second = (
            str(rng.choice([name for name in LINEAR if name != main]))
            if main != "nothing" and rng.random() < 0.35
            else None
        )
        hidden = tuple(name for name in (main, second) if name not in (None, "nothing"))
        try:
            return _measured(rng, hidden, str(rng.choice(HANDICAPS)))  # pyright: ignore
        except (RuntimeError, np.linalg.LinAlgError):
            continue


def _measured(rng: np.random.Generator, hidden: tuple[str, ...], handicap: str) -> Hidden:
    mass, frequency, split, ratio = (
        np.exp(rng.uniform(np.log(0.3), np.log(20.0))),
        rng.uniform(80.0, 400.0),
        rng.uniform(0.0, 0.12),
        rng.uniform(0.01, 0.05),
    )
    stiffness = mass * frequency**2
    declared = Machine(
        float(mass), (stiffness * (1 + split / 2), stiffness * (1 - split / 2)), (ratio, ratio * rng.uniform(0.7, 1.4))
    )
    if handicap == "uncertain mass":
        declared = dataclasses.replace(declared, mass=float(mass * rng.uniform(0.97, 1.03)))
    machine = dataclasses.replace(declared, mass=float(mass))
    machine = dataclasses.replace(
        machine,
        ratio=tuple(c / (2 * np.sqrt(k * mass)) for c, k in zip(declared.damping, machine.stiffness, strict=True)),
    )
    orders = ORDERS[rng.integers(len(ORDERS))]
    speeds = np.sort(rng.uniform(0.5, 1.5, rng.integers(6, 10))) * frequency
    grade = mass * rng.uniform(1e-5, 8e-5)
    weights = [
        complex(grade * rng.uniform(0.3, 1.0) * np.exp(2j * np.pi * rng.random())) for _ in range(rng.integers(2, 4))
    ]
    springs = list(zip(machine.stiffness, machine.damping, strict=True))
    amplitude = max(
        abs(w) * s**2 / abs(k - mass * s**2 + 1j * s * c) for w in weights for s in speeds for k, c in springs
    )
    gravity = DOWN if any(name in WEIGHED for name in hidden) or rng.random() < 0.4 else (0.0, 0.0)
    rotor = _Rotor(machine, float(amplitude), float(grade), rng, gravity)
    for name in hidden:
        rotor.hide(name)
    clean = np.concatenate(np.stack([rotor.vectors(weights, float(s), orders) for s in speeds], axis=1))
    sigma = float(amplitude * 10 ** rng.uniform(-3.3, -2.0))
    noisy = clean + sigma * (rng.standard_normal(clean.shape) + 1j * rng.standard_normal(clean.shape))
    noisy = np.where(np.array(orders) == 0.0, noisy.real + 0j, noisy)
    run = np.repeat(np.arange(len(weights)), len(speeds))
    installed = np.array([[[w.real, w.imag]] for w in weights])[run]
    conditions = Conditions.at(np.tile(speeds, len(weights)), unbalance=installed)
    names = tuple(f"run{k}" for k in range(len(weights)))
    measurement = Measurement.from_arrays(noisy, conditions, run=run, runs=names, orders=orders, sigma=sigma)
    every = list(range(len(run)))
    measurement = {
        "none": lambda: measurement,
        "one probe": lambda: cut(measurement, every, probe=int(rng.integers(2))),
        "one run": lambda: cut(measurement, np.flatnonzero(run == 0).tolist()),
        "noise unknown": lambda: dataclasses.replace(measurement, sigma=None, noise="unknown"),
        "uncertain mass": lambda: dataclasses.replace(
            measurement, knowledge=Knowledge(uncertain=(Uncertain("mass_error", "error", 0.03, True, "mass"),))
        ),
    }[handicap]()
    rotor_declared = Jeffcott(declared.mass, list(declared.stiffness), list(declared.ratio), gravity=list(gravity))
    known = {*hidden, *(("mass_error",) if handicap == "uncertain mass" else ())}
    truth = {name: values for name, values in rotor.truth(declared).items() if name in known}
    model = Model(rotor_declared, layout=Layout(orders=orders))
    return Hidden(hidden, handicap, model, measurement, any(gravity), truth, sigma)
