"""The detailed rotor integrated in time until its motion repeats itself, all speeds at once. Shares no code with
rotorjax.

Linear part and excitation are stepped exactly (matrix exponential); nonlinear forces are taken as straight
lines over a step, their end found by predictor and corrector: an exponential Runge-Kutta scheme of second order
(Hochbruck, Ostermann, Acta Numerica 19 (2010) 209-286, section 2). The steady state is where Newton's method on the
state after one turn (shooting) comes to rest; what is left of a disturbance after a turn says whether it is stable.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy.linalg import expm

from detailed.forces import Force
from detailed.rotor import FORWARD, Rotor

TURNS = 6
"""Before the shooting begins."""
MISS = 1e-8
"""Of the state after one turn, relative to the motion."""
CHANGE = 1e-5
"""Relative change of the state for the derivative of the map over one turn."""
MOST_TRIALS = 20
CALM = 5
"""Trials after which a step of Newton's method is not taken whole any more where it leads nowhere."""


class NoSteadyStateError(RuntimeError):
    """No stable motion that repeats itself every turn was found."""


@dataclasses.dataclass(frozen=True)
class Condition:
    """One speed with what is installed."""

    speed: float
    """[rad/s]."""
    unbalance: complex
    """[kg m]."""


class Stepper:
    """One step of every condition, so many to a turn.

    The state of a condition: displacements, velocities, cos φ, sin φ, cos 2φ, sin 2φ, 1; further motions of the same
    condition are further columns.
    """

    def __init__(self, rotor: Rotor, forces: Sequence[Force], conditions: Sequence[Condition], steps: int):
        self.steps, self.forces = steps, tuple(forces)
        self.speeds = np.array([c.speed for c in conditions])
        self.n = 2 * rotor.places
        self._disk, self._shaft = rotor.at_disk(), rotor.shaft_deflection()
        self._bow = np.array([rotor.bent(c.speed) * FORWARD for c in conditions])
        whole = np.stack([self._generator(rotor, c) for c in conditions])
        size = whole.shape[1] - 2 * self.inputs.shape[1]
        advanced = expm(whole * (2 * np.pi / (steps * self.speeds))[:, None, None])
        self.free, total, ramp = np.split(advanced[:, :size], [size, size + self.inputs.shape[1]], axis=2)
        self.total, self.ramp = total, ramp

    def _generator(self, rotor: Rotor, condition: Condition) -> np.ndarray:
        """Rate of change of the state, of a constant force on each place, and of that force's slope per step."""
        speed, n = condition.speed, self.n
        mass, damping, stiffness = rotor.matrices(speed)
        inverse = np.linalg.inv(mass)
        rate = np.zeros((2 * n + 5, 2 * n + 5))
        rate[:n, n : 2 * n] = np.eye(n)
        rate[n : 2 * n, : 2 * n] = -inverse @ np.hstack([stiffness, damping])
        for order, force in rotor.excitation(speed, condition.unbalance).items():
            drive = inverse @ force
            if order == 0:
                rate[n : 2 * n, 2 * n + 4] = drive.real
                continue
            c = 2 * n + 2 * (order - 1)
            rate[n : 2 * n, c], rate[n : 2 * n, c + 1] = drive.real, -drive.imag
            rate[c, c + 1], rate[c + 1, c] = -order * speed, order * speed
        self.inputs = np.zeros((2 * n + 5, 4))
        self.inputs[n : 2 * n] = -inverse @ np.hstack([self._disk.T, self._shaft.T])
        zero = np.zeros((4, 2 * n + 5))
        step = 2 * np.pi / (self.steps * speed)
        return np.block([[rate, self.inputs, np.zeros_like(self.inputs)], [zero, np.zeros((4, 4)), np.eye(4) / step],
                         [zero, np.zeros((4, 8))]])  # fmt: skip

    def resists(self, state: np.ndarray, step: int) -> np.ndarray:
        """Forces on disk and shaft at a step; condition x 4 x motion."""
        n, turn = self.n, 2 * np.pi * step / self.steps
        pairs = lambda rows, part: np.swapaxes(rows @ part, 1, 2)  # noqa: E731
        place, speed = pairs(self._disk, state[:, :n]), pairs(self._disk, state[:, n : 2 * n])
        bow = (self._bow * np.exp(1j * turn)).real[:, None]
        deflection = pairs(self._shaft, state[:, :n]) - bow
        angle = np.full(place.shape[:-1], turn)
        total = np.zeros((*place.shape[:-1], 4))
        for force in self.forces:
            columns = slice(2, 4) if force.on_shaft else slice(0, 2)
            total[..., columns] += force.law(angle, place, speed, deflection)
        return np.swapaxes(total, 1, 2)

    def turn(self, state: np.ndarray, kept: list[np.ndarray] | None = None) -> np.ndarray:
        """The state one turn later. **Arguments:** ``kept``: takes the displacements of the disk at every step."""
        now = self.resists(state, 0)
        for step in range(self.steps):
            if kept is not None:
                kept.append(self._disk @ state[:, : self.n, 0, None])
            free = self.free @ state + self.total @ now
            ahead = self.resists(free, step + 1)
            state = free + self.ramp @ (ahead - now)
            now = self.resists(state, step + 1)
        return state

    def begin(self, rotor: Rotor, conditions: Sequence[Condition]) -> np.ndarray:
        """The steady state without nonlinear forces; condition x state x 1."""
        states = []
        for c in conditions:
            parts = rotor.steady(c.speed, c.unbalance)
            place = np.sum([q.real for q in parts.values()], axis=0)
            moving = np.sum([(1j * n * c.speed * q).real for n, q in parts.items()], axis=0)
            states.append([*place, *moving, 1.0, 0.0, 1.0, 0.0, 1.0])
        return np.array(states)[:, :, None]


def periodic(stepper: Stepper, state: np.ndarray, *, turns: int = TURNS) -> np.ndarray:
    """The stable state that repeats itself after one turn, reached from a state.

    **Errors.** `NoSteadyStateError`.
    """
    m = 2 * stepper.n
    for _ in range(turns):
        state = stepper.turn(state)
    units = np.repeat(np.stack([np.ones_like(stepper.speeds), stepper.speeds], axis=1), stepper.n, axis=1)
    for trial in range(MOST_TRIALS):
        if not np.all(np.isfinite(state)) or np.max(np.abs(state[:, : stepper.n])) > 1.0:
            raise NoSteadyStateError("the motion runs away")
        size = np.maximum(np.max(np.abs(state[:, :m, 0] / units), axis=1), 1e-9)
        moves = np.zeros((len(state), state.shape[1], m))
        moves[:, :m] = CHANGE * size[:, None, None] * units[:, :, None] * np.eye(m)
        after = stepper.turn(np.concatenate([state, state + moves], axis=2))
        miss = after[:, :m, 0] - state[:, :m, 0]
        slopes = (after[:, :m, 1:] - after[:, :m, :1]) / (CHANGE * size[:, None, None] * units[:, None, :])
        if np.all(np.max(np.abs(miss / units), axis=1) < MISS * size):
            if np.max(np.abs(np.linalg.eigvals(slopes))) >= 1.0:
                raise NoSteadyStateError("the motion is unstable")
            return state
        step = np.linalg.solve(np.eye(m) - slopes, miss[:, :, None])
        state = state.copy()
        state[:, :m] += step if trial < CALM else 0.5 * step
    raise NoSteadyStateError("the motion does not repeat itself after a turn")


def vectors(waves: np.ndarray, orders: Sequence[int]) -> np.ndarray:
    """Complex amplitudes of waveforms over one turn (time along the last axis), one per order along a new last axis."""
    turn = 2 * np.pi * np.arange(waves.shape[-1]) / waves.shape[-1]
    columns = [(2.0 if n else 1.0) * np.mean(waves * np.exp(-1j * n * turn), axis=-1) for n in orders]
    return np.stack(columns, axis=-1)


def waveforms(
    rotor: Rotor,
    forces: Sequence[Force],
    conditions: Sequence[Condition],
    *,
    steps: int,
    start: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Displacement of the disk over one turn, condition x (x, y) x step [m], and the state to go on from.

    Without nonlinear forces from the closed form, which the integration meets (tests).
    **Errors.** `NoSteadyStateError`.
    """
    if max(rotor.growth(c.speed) for c in conditions) >= 0.0:
        raise NoSteadyStateError("the rotor is unstable")
    if not forces:
        turn = 2 * np.pi * np.arange(steps) / steps
        disk = rotor.at_disk()
        steady = [rotor.steady(c.speed, c.unbalance) for c in conditions]
        waves = [sum((disk @ q)[:, None] * np.exp(1j * n * turn) for n, q in parts.items()) for parts in steady]
        return np.real(np.array(waves)), np.empty(0)
    stepper = Stepper(rotor, forces, conditions, steps)
    state = periodic(stepper, stepper.begin(rotor, conditions) if start is None else start)
    kept: list[np.ndarray] = []
    stepper.turn(state, kept)
    return np.concatenate(kept, axis=2), state
