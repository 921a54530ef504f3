"""Measurements with an effect hidden in them, by time integration: nothing here is shared with the code under test.

`hide` gives a rotor in time the effect of a name at given values; `measure` runs it through a plan and adds noise.
"""

import dataclasses

import numpy as np

from oracle import TimeRotor


@dataclasses.dataclass(frozen=True)
class Machine:
    """A rotor as its rig file declares it."""

    mass: float = 0.9686
    stiffness: tuple[float, float] = (56538.0, 51282.0)
    ratio: tuple[float, float] = (0.03, 0.05)

    @property
    def damping(self) -> tuple[float, float]:
        return tuple(2 * z * np.sqrt(k * self.mass) for z, k in zip(self.ratio, self.stiffness, strict=True))

    @property
    def frequency(self) -> float:
        """Mean natural frequency, rad/s."""
        return float(np.sqrt(np.mean(self.stiffness) / self.mass))


def hide(
    rotor: TimeRotor, machine: Machine, name: str, v: list[float], speed: float, weights: list[complex]
) -> TimeRotor:
    """The rotor with an effect; ``v``: its values in SI, in the order of the catalogue page; ``weights``: unbalance per
    plane.
    """
    growth = (speed / machine.frequency) ** 2
    x, y = rotor.stiffness
    changes = {
        "residual_unbalance": lambda: {"unbalance": rotor.unbalance + complex(v[0], v[1])},
        "residual_bow": lambda: {"bow": rotor.bow + complex(v[0], v[1])},
        "thermal_bow": lambda: {"bow": rotor.bow + complex(v[0], v[1]) * growth},
        "misalignment": lambda: {"force_1": complex(v[0], v[1]), "force_2": (complex(v[2], v[3]), complex(v[4], v[5]))},
        "plane_participation": lambda: {"unbalance": rotor.unbalance + v[0] * weights[1]},
        "stiffness_error": lambda: {"stiffness": (x * (1 + v[0]), y * (1 + v[1]))},
        "mass_error": lambda: {"mass": rotor.mass * (1 + v[0])},
        "damping_error": lambda: {"damping": tuple(c * np.exp(e) for c, e in zip(rotor.damping, v, strict=True))},
        "stiffness_axes": lambda: {"axes": v[0], "damping_axes": v[1]},
        "cross_coupling": lambda: {"cross": v[0]},
        "speed_dependent_stiffness": lambda: {"stiffness": (x * (1 + v[0] * growth), y * (1 + v[1] * growth))},
        "speed_dependent_damping": lambda: {
            "damping": tuple(c * (1.0 + v[0] * (machine.frequency / speed - 1.0)) for c in rotor.damping)
        },
        "speed_dependent_cross_coupling": lambda: {"cross": v[0] * growth},
        "internal_damping": lambda: {"internal": v[0]},
        "gyroscopic": lambda: {"gyroscopic": v[0]},
        "foundation": lambda: {"foundation": _foundation(machine, *v)},
        "probe_gain": lambda: {"gains": tuple(g * (1 + e) for g, e in zip(rotor.gains, v, strict=True))},
        "chain_gain": lambda: {
            "gains": tuple(g * abs(1 + complex(*v)) for g in rotor.gains),
            "delay": -np.angle(1 + complex(*v)) / speed,
        },
        "probe_angle": lambda: {"probes": tuple((a + e, p, f) for (a, p, f), e in zip(rotor.probes, v, strict=True))},
        "phase_reference_offset": lambda: {"reference": v[0]},
        "time_delay": lambda: {"delay": v[0]},
        "runout": lambda: {"runout": ({1: complex(v[0], v[2])}, {1: complex(v[1], v[3])})},
        "speed_error": dict,
    }
    return dataclasses.replace(rotor, **changes[name]())


def _foundation(
    machine: Machine, compliance: float, log_frequency: float, log_damping: float
) -> tuple[float, float, float]:
    stiffness, own = 1.0 / compliance, machine.frequency * np.exp(log_frequency)
    return stiffness, stiffness / own**2, 2 * 0.05 * np.exp(log_damping) * stiffness / own


@dataclasses.dataclass(frozen=True)
class Plan:
    """What is measured: unbalance per run and plane [kg m], speeds [rad/s], orders, noise [m]."""

    weights: dict[str, list[complex]]
    speeds: tuple[float, ...]
    orders: tuple[int, ...] = (1,)
    bow: complex = 0.0
    sigma: float = 0.3e-6


def measure(machine: Machine, plan: Plan, hidden: dict[str, list[float]], rng: np.random.Generator) -> np.ndarray:
    """Vectors, case x probe x order [m], runs one after the other, with Gaussian noise."""
    vectors = []
    for weights in plan.weights.values():
        for speed in plan.speeds:
            true = speed * (1 + hidden["speed_error"][0]) if "speed_error" in hidden else speed
            rotor = TimeRotor(machine.mass, machine.stiffness, machine.damping, unbalance=sum(weights), bow=plan.bow)
            for name, values in hidden.items():
                rotor = hide(rotor, machine, name, values, true, weights)
            vectors.append(rotor.vectors(true, plan.orders))
    clean = np.array(vectors)
    return clean + plan.sigma * (rng.standard_normal(clean.shape) + 1j * rng.standard_normal(clean.shape))


def sufficient(cls, *, seed: int, factor: float = 1.0, machine: Machine = Machine(), hidden: bool = True):
    """A nominal model, and a measurement by the plan that the catalogue calls sufficient, with an effect of one prior
    scale hidden.
    """
    from rotorjax import Conditions, Jeffcott, Layout, Measurement, Model

    rng = np.random.default_rng(seed)
    plan = cls.sufficient
    layout = Layout(planes=tuple(f"disk{k + 1}" for k in range(plan.planes)), orders=plan.orders)
    model = Model(
        Jeffcott(machine.mass, list(machine.stiffness), list(machine.ratio)),
        participation=np.ones(plan.planes),
        layout=layout,
    )
    grade = model.rotor.quantities()["unbalance"]
    weights = {}
    for run, weight in enumerate(
        grade * np.array([1.0, 5.0, 5.0, 5.0])[: plan.runs] * np.exp(2.1j * np.arange(plan.runs))
    ):
        weights[f"run{run}"] = [complex(weight) if plane == run % plan.planes else 0j for plane in range(plan.planes)]
    values: list[float] = []
    for p in cls.parameters():
        count = len(p.labels(layout))
        values += (p.prior_scale(model.rotor) * factor * rng.choice([-1.0, 1.0], count)).tolist()
    if cls.name == "foundation":
        values[0] = abs(values[0])
    speeds = tuple(s * machine.frequency for s in plan.speeds)
    done = Plan(weights, speeds, tuple(int(n) for n in plan.orders))
    z = measure(machine, done, {cls.name: values} if hidden else {}, rng)
    run = np.repeat(np.arange(plan.runs), len(speeds))
    installed = np.array([[[w.real, w.imag] for w in planes] for planes in weights.values()])[run]
    conditions = Conditions.at(np.tile(speeds, plan.runs), unbalance=installed)
    present = np.ones(z.shape, bool)
    measurement = Measurement.from_arrays(
        np.where(present, z, np.nan), conditions, run=run, runs=tuple(weights), orders=plan.orders, sigma=done.sigma
    )
    return model, measurement, values
