"""Measurements with a force hidden in them that depends on motion, by time integration, on the plan that its catalogue
page calls sufficient.
"""

import numpy as np

from rotorjax import Conditions, Jeffcott, Layout, Measurement, Model

import nonlinear_oracle as in_time
from hidden import Machine, Plan

NEEDS_WEIGHT = {"crack", "asymmetric_shaft"}
MACHINE = Machine()
SIGMA = 0.3e-6


def force_of(name: str, v: list[float], gravity: tuple[float, float]) -> tuple[in_time.Force, ...]:
    """The force of an effect at values in SI, in the order of its page."""
    forces = {
        "duffing": lambda: in_time.duffing(v[0]),
        "clearance": lambda: in_time.clearance(v[0], 1.0 / v[1]),
        "rub": lambda: in_time.rub(v[0], 1.0 / v[1], v[2], 1),
        "crack": lambda: in_time.crack(complex(v[0], v[1]), 1, gravity),
        "asymmetric_shaft": lambda: in_time.asymmetric_shaft(complex(v[0], v[1]), 1),
        "quadratic_damping": lambda: in_time.quadratic_damping(v[0]),
        "coulomb_friction": lambda: in_time.coulomb_friction(v[0]),
    }
    return (forces[name](),) if name in forces else ()


def measured(
    forces: tuple[in_time.Force, ...], plan: Plan, rng: np.random.Generator, gravity: tuple[float, float], bend=None
) -> tuple[Model, Measurement]:
    """The model that knows nothing of the forces, and what they let be measured."""
    rotor = Jeffcott(MACHINE.mass, list(MACHINE.stiffness), list(MACHINE.ratio), gravity=list(gravity))
    z = in_time.measure(MACHINE, plan, forces, rng, gravity=gravity, bend=bend)
    run = np.repeat(np.arange(len(plan.weights)), len(plan.speeds))
    installed = np.array([[[w.real, w.imag] for w in planes] for planes in plan.weights.values()])[run]
    conditions = Conditions.at(np.tile(plan.speeds, len(plan.weights)), unbalance=installed)
    orders = tuple(float(n) for n in plan.orders)
    measurement = Measurement.from_arrays(
        z, conditions, run=run, runs=tuple(plan.weights), orders=orders, sigma=plan.sigma or None
    )
    return Model(rotor, layout=Layout(orders=orders)), measurement


def sufficient(cls, *, seed: int, factor: float = 1.0, gravity: tuple[float, float] | None = None):
    """A nominal model, a measurement with an effect of a few prior scales hidden, and its values."""
    rng = np.random.default_rng(seed)
    weight = gravity if gravity is not None else in_time.DOWN if cls.name in NEEDS_WEIGHT else (0.0, 0.0)
    rotor = Jeffcott(MACHINE.mass, list(MACHINE.stiffness), list(MACHINE.ratio))
    plan = cls.sufficient
    grade = rotor.quantities()["unbalance"]
    size = grade * np.array([1.0, 5.0, 5.0, 5.0])[: plan.runs] * np.exp(2.1j * np.arange(plan.runs))
    speeds = tuple(s * MACHINE.frequency for s in plan.speeds)
    values = [p.prior_scale(rotor) * factor for p in cls.parameters()]
    done = Plan(
        {f"run{k}": [complex(w)] for k, w in enumerate(size)}, speeds, tuple(int(n) for n in plan.orders), sigma=SIGMA
    )
    bend = in_time.saturation(1.0 / values[0]) if cls.name == "probe_saturation" else None
    model, measurement = measured(force_of(cls.name, values, weight), done, rng, weight, bend)
    return model, measurement, values
