"""Ranking the whole catalogue on 60 conditions, beside one SciPy fit per hypothesis.

The peer is what a user does today: a vectorised NumPy forward model, `scipy.optimize.least_squares` with finite
differences, one call per effect and declared start, the same starts, priors, noise and tolerance of the cost. Both
sides' least costs are compared first; nonlinear forces are ours alone. Called by `benchmarks/run.py`; as a
program it times one ranking in this process, for data that hide a linear effect or a nonlinear force.

    python benchmarks/ranking.py [duffing]
"""

import resource
import sys
import time
from collections.abc import Mapping

import jax
import numpy as np
from scipy.optimize import least_squares

from rotorjax import Conditions, Effect, Jeffcott, Measurement, Model, RestoringEffect, WaveformEffect, effects
from rotorjax.discovery.contest import Contest, Effects, Known, make_contest
from rotorjax.discovery.race import race
from rotorjax.effects import CATALOG
from rotorjax.inference.data import declared_starts
from rotorjax.inference.noise import NO_NOISE
from rotorjax.physics.response import response

SIGMA = 0.3e-6
NONE: Effects = frozenset()


HIDDEN: dict[str, Effect] = {"cross_coupling": effects.CrossCoupling(900.0), "duffing": effects.Duffing(2e9)}


def sixty_conditions(hidden: str = "cross_coupling") -> tuple[Model, Measurement]:
    """Four runs at fifteen speeds, with an effect that the model lacks."""
    model = Model(Jeffcott(0.9686, [56538.0, 51282.0], [0.03, 0.05]))
    weights = np.array([4e-6, 30e-6, 30e-6 * np.exp(2.1j), 20e-6 * np.exp(-1.5j)])
    speeds = np.linspace(800.0, 3000.0, 15)
    run = np.repeat(np.arange(4), 15)
    unbalance = np.stack([weights.real, weights.imag], axis=1)[run][:, None]
    conditions = Conditions.at_rpm(np.tile(speeds, 4), unbalance=unbalance, bow=[1e-5, 0.0])
    z = np.asarray(response(model + HIDDEN[hidden], conditions))
    rng = np.random.default_rng(0)
    z = z + SIGMA * (rng.standard_normal(z.shape) + 1j * rng.standard_normal(z.shape))
    present = np.ones(z.shape, bool)
    runs = ("baseline", "trial-a", "trial-b", "trial-c")
    return model, Measurement.from_arrays(np.where(present, z, np.nan), conditions, run=run, runs=runs, sigma=SIGMA)


LINEAR = {name: cls for name, cls in CATALOG.items() if not issubclass(cls, RestoringEffect | WaveformEffect)}
"""Effects without which every order has its closed form: those that the peer has."""


def rank(
    model: Model, measurement: Measurement, candidates: Mapping[str, type[Effect]] = CATALOG
) -> tuple[Contest, Known]:
    """Every effect and none, fitted under the table's noise from the declared starts."""
    contest = make_contest(model, measurement, candidates)
    return contest, race(contest, NO_NOISE, [NONE, *(frozenset([name]) for name in contest.candidates)], {})


class NumpyModel:
    """The same 21 effects on the same rotor at 1X, written as arrays over the conditions."""

    def __init__(self, model: Model, measurement: Measurement) -> None:
        rotor = model.rotor
        self.mass, self.stiffness, self.damping = (
            float(rotor.mass),
            np.asarray(rotor.stiffness),
            np.asarray(rotor.damping),
        )
        self.speed = np.asarray(measurement.conditions.speed)
        self.unbalance = np.asarray(measurement.conditions.unbalance)[:, 0] @ np.array([1.0, 1j])
        self.bow = np.asarray(measurement.conditions.bow) @ np.array([1.0, 1j])
        self.own = np.sqrt(self.stiffness.mean() / self.mass)

    def __call__(self, name: str, v: np.ndarray) -> np.ndarray:
        """Vectors, condition x probe."""
        speed = self.speed * (1.0 + (v[0] if name == "speed_error" else 0.0))
        path = self.path(name, v, speed)
        whirl, omega = np.array([[0.0, 1.0], [-1.0, 0.0]]), speed[:, None, None]
        mass = self.mass * (1.0 + (v[0] if name == "mass_error" else 0.0))
        damping = self.damping * (np.exp(v[:2]) if name == "damping_error" else 1.0)
        dynamic = path + 1j * omega * np.diag(damping) - mass * omega**2 * np.eye(2)
        if name == "cross_coupling":
            dynamic = dynamic + v[0] * whirl
        elif name == "internal_damping":
            dynamic = dynamic + v[0] * omega * (1j * np.eye(2) + whirl)
        elif name == "gyroscopic":
            dynamic = dynamic + 1j * v[0] * omega**2 * whirl
        unbalance = self.unbalance + (complex(v[0], v[1]) if name == "residual_unbalance" else 0.0)
        force = complex(v[0], v[1]) if name == "misalignment" else 0.0
        forward = np.array([1.0, -1j])
        bow = (self.bow + self.added_bow(name, v, speed))[:, None] * forward
        driven = (unbalance * speed**2 + force)[:, None] * forward + np.einsum("cij,cj->ci", path, bow)
        return self.read(name, v, np.linalg.solve(dynamic, driven[..., None])[..., 0], speed)

    def path(self, name: str, v: np.ndarray, speed: np.ndarray) -> np.ndarray:
        """Stiffness of the support path, condition x 2 x 2."""
        each = np.broadcast_to(self.stiffness, (len(speed), 2))
        if name == "stiffness_error":
            each = each * (1.0 + v[:2])
        elif name == "speed_dependent_stiffness":
            each = each * (1.0 + ((speed / self.own) ** 2)[:, None] * v[:2])
        elif name == "foundation":
            ratio = speed / (self.own * np.exp(v[1]))
            each = each / (1.0 + (v[0] / (1.0 - ratio**2 + 2j * 0.05 * np.exp(v[2]) * ratio))[:, None] * each)
        path = each[:, :, None] * np.eye(2)
        if name == "stiffness_axes":
            turn = np.array([[np.cos(v[0]), -np.sin(v[0])], [np.sin(v[0]), np.cos(v[0])]])
            path = turn @ path @ turn.T
        return path

    def added_bow(self, name: str, v: np.ndarray, speed: np.ndarray) -> np.ndarray | float:
        """Bow beyond the installed one."""
        if name == "residual_bow":
            return complex(v[0], v[1])
        return complex(v[0], v[1]) * (speed / self.own) ** 2 if name == "thermal_bow" else 0.0

    def read(self, name: str, v: np.ndarray, q: np.ndarray, speed: np.ndarray) -> np.ndarray:
        """What the probes make of the motion."""
        if name == "probe_angle":
            angle = np.array([0.0, np.pi / 2]) + v
            q = np.cos(angle) * q[:, :1] + np.sin(angle) * q[:, 1:]
        elif name == "runout":
            q = q + v[:2] + 1j * v[2:]
        elif name == "probe_gain":
            q = q * (1.0 + v)
        elif name == "chain_gain":
            q = q * (1.0 + complex(v[0], v[1]))
        elif name == "time_delay":
            q = q * np.exp(-1j * speed * v[0])[:, None]
        elif name == "phase_reference_offset":
            q = q * np.exp(1j * v[0])
        return q


def rank_with_scipy(contest: Contest, model: Model) -> tuple[dict[str, float], int]:
    """Effect -> least cost over the declared starts; and how many forward evaluations that took."""
    measurement, forward = contest.measurement, NumpyModel(model, contest.measurement)
    z, evaluations, costs = measurement.vectors[:, :, 0], 0, {}
    for name in LINEAR:
        if name not in contest.candidates:
            continue
        mask = contest.free(frozenset([name]))
        scale = np.asarray(contest.space.scale)[mask]

        def residual(u: np.ndarray, name: str = name, scale: np.ndarray = scale) -> np.ndarray:
            error = (forward(name, scale * u) - z).ravel() / SIGMA
            return np.concatenate([error.real, error.imag, u])

        best = np.inf
        for start in declared_starts(contest.space, mask, measurement):
            found = least_squares(
                residual, start[mask], method="trf", x_scale="jac", ftol=1e-4, xtol=1e-10, gtol=1e-10, max_nfev=60
            )
            best, evaluations = min(best, found.cost), evaluations + found.nfev * (1 + len(scale))
        costs[name] = float(best)
    return costs, evaluations


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    model, measurement = sixty_conditions(sys.argv[1] if len(sys.argv) > 1 else "cross_coupling")
    begin = time.perf_counter()
    _, found = rank(model, measurement)
    cold = time.perf_counter() - begin
    begin = time.perf_counter()
    rank(model, measurement)
    best = max(found, key=lambda effects: found[effects].log_evidence)
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    print(
        f"{cold:.2f} s first, {time.perf_counter() - begin:.2f} s second, {memory:.2f} GB at most; first: "
        f"{', '.join(best)}"
    )


if __name__ == "__main__":
    main()
