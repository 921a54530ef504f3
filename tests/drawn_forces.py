"""Machines, plans and forces along one axis drawn by seed, integrated in time: what is drawn shares nothing with the
code under test.
"""

import dataclasses

import numpy as np

from rotorjax import Conditions, Jeffcott, Layout, Measurement, Model

import nonlinear_oracle as in_time
from hidden import Machine, Plan

SHAPES = {
    "cubic": "term_cubic",
    "dead band": "term_dead_band",
    "stop on one side": "term_one_sided_stop",
    "square, stiffer on one side": "term_unsymmetrical",
    "quadratic damping": "term_quadratic_damping",
    "dry friction": "term_dry_friction",
    "constant direction, once per turn": "term_pulsating",
    "constant direction, twice per turn": "term_pulsating_twice",
    "stiffness twice per turn": "term_turning_stiffness",
    "fifth power": "term_power_spring",
    "stiffened by the other direction": None,
    "cubic damping": "term_power_damping",
}
"""What is drawn -> the term that is this force, less its axis; none where no term is."""
ORDERS = ((1,), (1, 2), (1, 2, 3), (0, 1, 2, 3), (0, 1, 2, 3, 4, 5))
WEIGHT = 9.80665


@dataclasses.dataclass(frozen=True)
class Drawn:
    """What is hidden, and what it lets be measured."""

    shape: str
    axis: str
    machine: Machine
    plan: Plan
    gravity: tuple[float, float]
    vectors: np.ndarray
    """Case x probe x order [m]."""
    signal: float
    """Largest amplitude of the rotor without the force, over the noise."""

    @property
    def term(self) -> str | None:
        """Name of the term that is this force."""
        return None if SHAPES[self.shape] is None else f"{SHAPES[self.shape]}_{self.axis}"


def draw(seed: int) -> Drawn:
    """Shapes take turns; all else is drawn anew until the rotor settles into a motion that repeats
    itself every turn.
    """
    rng = np.random.default_rng([2026, seed])
    shape = list(SHAPES)[seed % len(SHAPES)]
    while True:
        mass, frequency, split, ratio = (
            np.exp(rng.uniform(np.log(0.3), np.log(20.0))),
            rng.uniform(80.0, 400.0),
            rng.uniform(0.0, 0.12),
            rng.uniform(0.01, 0.05),
        )
        stiffness = mass * frequency**2
        machine = Machine(
            float(mass),
            (stiffness * (1 + split / 2), stiffness * (1 - split / 2)),
            (ratio, ratio * rng.uniform(0.7, 1.4)),
        )
        orders = ORDERS[rng.integers(len(ORDERS))]
        speeds = tuple(float(s) for s in np.sort(rng.uniform(0.5, 1.5, rng.integers(5, 9))) * frequency)
        eccentricity = rng.uniform(1e-5, 8e-5)
        weights = {
            f"run{k}": [complex(mass * eccentricity * rng.uniform(0.3, 1.0) * np.exp(2j * np.pi * rng.random()))]
            for k in range(rng.integers(2, 4))
        }
        amplitude = _largest(machine, speeds, [w[0] for w in weights.values()])
        axis = int(rng.integers(2))
        force = _force(shape, axis, stiffness, ratio, frequency, amplitude, rng)
        gravity = (0.0, -WEIGHT) if rng.random() < 0.4 else (0.0, 0.0)
        plan = Plan(weights, speeds, orders, sigma=float(amplitude * 10 ** rng.uniform(-3.3, -2.0)))
        try:
            vectors = in_time.measure(machine, plan, (force,), rng, gravity=gravity)
        except (RuntimeError, np.linalg.LinAlgError):
            continue
        return Drawn(shape, "xy"[axis], machine, plan, gravity, vectors, float(amplitude / plan.sigma))


def _largest(machine: Machine, speeds: tuple[float, ...], unbalance: list[complex]) -> float:
    pairs = list(zip(machine.stiffness, machine.damping, strict=True))
    return max(
        abs(u) * s**2 / abs(k - machine.mass * s**2 + 1j * s * c) for u in unbalance for s in speeds for k, c in pairs
    )


def _force(
    shape: str, axis: int, stiffness: float, ratio: float, frequency: float, a: float, rng: np.random.Generator
) -> in_time.Force:
    """Of a size between half and three times the damping force at the largest amplitude ``a``."""
    push = 2 * ratio * stiffness * a * rng.uniform(0.5, 3.0)
    phase, side, share = rng.uniform(0.0, 2 * np.pi), rng.choice([-1.0, 1.0]), rng.uniform(0.4, 0.8)
    stop, pulse, sign = (
        rng.uniform(0.05, 0.4) * stiffness,
        rng.uniform(0.03, 0.1) * stiffness,
        -1.0 if rng.random() < 0.3 else 1.0,
    )
    along = {
        "cubic": lambda angle, q, v, other: sign * push * (q / a) ** 3,
        "dead band": lambda angle, q, v, other: stop * np.sign(q) * np.maximum(abs(q) - share * a, 0.0),
        "stop on one side": lambda angle, q, v, other: side * stop * np.maximum(side * q - share * a, 0.0),
        "square, stiffer on one side": lambda angle, q, v, other: side * push * (q / a) ** 2,
        "quadratic damping": lambda angle, q, v, other: push * abs(v) * v / (frequency * a) ** 2,
        "dry friction": lambda angle, q, v, other: 0.5 * push * v / np.sqrt(v**2 + in_time.STICTION**2),
        "constant direction, once per turn": lambda angle, q, v, other: push * np.cos(angle + phase) + 0.0 * q,
        "constant direction, twice per turn": lambda angle, q, v, other: (
            3.0 * push * np.cos(2 * angle + phase) + 0.0 * q
        ),
        "stiffness twice per turn": lambda angle, q, v, other: pulse * np.cos(2 * angle + phase) * q,
        "fifth power": lambda angle, q, v, other: push * (q / a) ** 5,
        "stiffened by the other direction": lambda angle, q, v, other: 2.0 * push * q * other**2 / a**3,
        "cubic damping": lambda angle, q, v, other: push * (v / (frequency * a)) ** 3,
    }[shape]

    def force(angle, q, v, deflection):
        parts = [0.0 * q[0], 0.0 * q[0]]
        parts[axis] = along(angle, q[axis], v[axis], q[1 - axis])
        return np.array(parts)

    return force


def measured(drawn: Drawn) -> tuple[Model, Measurement]:
    """The model that knows nothing of the force, and what was measured."""
    machine, plan = drawn.machine, drawn.plan
    orders = tuple(float(order) for order in plan.orders)
    rotor = Jeffcott(machine.mass, list(machine.stiffness), list(machine.ratio), gravity=list(drawn.gravity))
    run = np.repeat(np.arange(len(plan.weights)), len(plan.speeds))
    unbalance = np.array([[[w.real, w.imag] for w in planes] for planes in plan.weights.values()])[run]
    conditions = Conditions.at(np.tile(plan.speeds, len(plan.weights)), unbalance=unbalance)
    measurement = Measurement.from_arrays(
        drawn.vectors, conditions, run=run, runs=tuple(plan.weights), orders=orders, sigma=plan.sigma or None
    )
    return Model(rotor, layout=Layout(orders=orders)), measurement
