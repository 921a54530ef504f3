"""An independent answer for nonlinear forces: the rotor integrated in time until it repeats itself. Shares
no code with rotorjax.

M q̈ + C q̇ + K (q - bow(t)) + Σ f(φ, q, q̇, q - bow(t)) = M g + Ω² U(t), everything longhand: a transient, then
Newton's method on the state over one period (shooting), then samples of that period as a recorder would take them.
"""

import cmath
import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
from scipy.integrate import solve_ivp

from hidden import Machine, Plan

Force = Callable[[float, np.ndarray, np.ndarray, np.ndarray], np.ndarray]
"""f(angle, position, velocity, deflection) [N], on the left-hand side. Pairs are (x, y) along the first axis; a second
axis holds further motions.
"""

SAMPLES = 512
"""Per turn."""
MISS = 1e-10
"""Of the state after one period, relative to the motion."""
STEP = 1e-5
"""Relative change of the state for the derivative of the map over one period."""
LEAST_STEPS = 16
"""Per turn: a short contact is not stepped over."""
STICTION = 6.3e-5
"""Speed over which dry friction changes its sign, m/s."""
FAR = 1.0
"""Displacement from which on a rotor runs away [m]."""
DOWN = (0.0, -9.80665)


@dataclasses.dataclass(frozen=True)
class Orbit:
    """A motion that repeats itself."""

    times: np.ndarray
    position: np.ndarray
    """Time x (x, y)."""
    multiplier: float
    """Largest absolute Floquet multiplier: what is left of a disturbance after one period, so that below one the motion
    is stable.
    """


@dataclasses.dataclass
class NonlinearRotor:
    """A rotor in time. Pairs are (x, y); rotating vectors are complex, their angle counted with the rotation."""

    mass: float
    stiffness: tuple[float, float]
    damping: tuple[float, float]
    sense: int = 1
    gravity: tuple[float, float] = (0.0, 0.0)
    unbalance: complex = 0.0
    bow: complex = 0.0
    forces: tuple[Force, ...] = ()
    bend: Callable[[np.ndarray], np.ndarray] | None = None
    """What a probe makes of its waveform."""
    transient: int = 40
    """Turns before the shooting begins."""

    def _equation(self, speed: float, unbalance: np.ndarray) -> Callable[[float, np.ndarray], np.ndarray]:
        """The state's rate of change; the state is flat: x, y and their velocities, each for as many motions as there
        are. **Arguments:** ``unbalance``: that of every motion.
        """
        stiffness, damping, weight = np.array([self.stiffness, self.damping, [self.mass * g for g in self.gravity]])[
            :, :, None
        ]
        unbalance, bow, sense = speed**2 * unbalance, complex(self.bow), self.sense

        def rate(t: float, flat: np.ndarray) -> np.ndarray:
            state = flat.reshape(4, -1)
            q, v = state[:2], state[2:]
            angle = speed * t
            turn = cmath.exp(1j * angle)
            pull, bent = unbalance * turn, bow * turn
            deflection = q - np.array([[bent.real], [sense * bent.imag]])
            total = weight + np.array([pull.real, sense * pull.imag]) - stiffness * deflection - damping * v
            for force in self.forces:
                resists = force(angle, q, v, deflection)
                total = total - (resists if resists.ndim == 2 else resists[:, None])
            return np.concatenate([v, total / self.mass]).ravel()

        return rate

    def _integrate(
        self, states: np.ndarray, unbalance: np.ndarray, speed: float, turns: int, *, rtol: float, **settings
    ):
        """From the start of a turn; ``states``: 4 x motion, each with its unbalance.

        **Errors.** ``RuntimeError`` where the motion runs away.
        """
        period, motions = 2 * np.pi / speed, states.shape[1]
        atol = rtol * 1e-6 * np.repeat([1.0, 1.0, speed, speed], motions)

        def near(_: float, flat: np.ndarray) -> float:
            return FAR - float(np.max(np.abs(flat[: 2 * motions])))

        near.terminal = True  # pyright: ignore
        settings = {"method": "DOP853", **settings, "rtol": rtol, "atol": atol, "events": near}
        found = solve_ivp(self._equation(speed, unbalance), (0.0, turns * period), states.ravel(), **settings)
        if found.status != 0:
            raise RuntimeError(f"the motion runs away at {speed} rad/s: {found.message}")
        return found

    def orbit(self, speed: float, turns: int = 1, start: np.ndarray | None = None) -> Orbit:
        """The motion with a period of so many turns that is reached from a state (x, y, their velocities), at rest
        unless given.

        **Errors.** ``RuntimeError`` where the motion does not settle into one.
        """
        first = np.zeros(4) if start is None else np.asarray(start, float)
        return self._orbits(speed, np.array([self.unbalance], complex), turns, first[:, None])[0]

    def _orbits(self, speed: float, unbalance: np.ndarray, turns: int, state: np.ndarray) -> list[Orbit]:
        """The motions of rotors that differ in their unbalance alone, all in one integration. **Arguments:** ``state``:
        4 x motion, where they begin.
        """
        period, units, motions = 2 * np.pi / speed, np.array([1.0, 1.0, speed, speed])[:, None], len(unbalance)
        # Friction spread over a small speed is stiff; where this ends need not be exact.
        state = (
            self._integrate(
                state, unbalance, speed, self.transient, rtol=1e-6, method="LSODA", t_eval=[self.transient * period]
            )
            .y[:, -1]
            .reshape(4, -1)
        )
        fine = {"rtol": 1e-12, "max_step": period / LEAST_STEPS}
        for _ in range(25):
            size = np.maximum(np.max(np.abs(state / units), axis=0), 1e-9)
            change = STEP * size * units * np.eye(4)[:, :, None]
            moved = np.concatenate([state[:, None], state[:, None] + change], axis=1).reshape(4, -1)
            after = self._integrate(moved, np.tile(unbalance, 5), speed, turns, **fine).y[:, -1].reshape(4, 5, motions)
            slope = np.moveaxis((after[:, 1:] - after[:, :1]) / (STEP * size * units.T[..., None]), 2, 0)
            miss = after[:, 0] - state
            if np.all(np.max(np.abs(miss / units), axis=0) < MISS * size):
                break
            state = state + np.linalg.solve(np.eye(4) - slope, miss.T[..., None])[..., 0].T
        else:
            raise RuntimeError(f"no motion that repeats itself after {turns} turns at {speed} rad/s")
        times = np.arange(SAMPLES * turns) * period / SAMPLES
        found = self._integrate(state, unbalance, speed, turns, **fine, dense_output=True).sol(times)
        position = found.reshape(4, motions, -1)[:2]
        multiplier = np.max(np.abs(np.linalg.eigvals(slope)), axis=1)
        return [Orbit(times, position[:, k].T, float(multiplier[k])) for k in range(motions)]

    def vectors(
        self, speed: float, orders: tuple[float, ...] = (1.0,), probes: tuple[float, ...] = (0.0, np.pi / 2)
    ) -> np.ndarray:
        """Complex amplitude per probe and order, displacement(t) = Re[z e^{inΩt}]; order 0 is the mean. ``probes``:
        their angles.

        **Errors.** ``RuntimeError`` where the motion is unstable.
        """
        return self.vectors_of([self.unbalance], speed, orders, probes)[0]

    def vectors_of(
        self,
        unbalances: Sequence[complex],
        speed: float,
        orders: tuple[float, ...] = (1.0,),
        probes: tuple[float, ...] = (0.0, np.pi / 2),
    ) -> np.ndarray:
        """The same of rotors that differ in their unbalance alone: motion x probe x order."""
        turns = next(k for k in (1, 2, 3, 4) if all(abs(n * k - round(n * k)) < 1e-9 for n in orders))
        own = np.array(unbalances, complex)
        found = []
        for orbit in self._orbits(speed, own, turns, np.zeros((4, len(own)))):
            if orbit.multiplier >= 1.0:
                raise RuntimeError(f"unstable at {speed} rad/s: multiplier {orbit.multiplier:.4f}")
            waves = np.array(
                [np.cos(angle) * orbit.position[:, 0] + np.sin(angle) * orbit.position[:, 1] for angle in probes]
            )
            if self.bend is not None:
                waves = self.bend(waves)
            turning = [np.exp(-1j * n * speed * orbit.times) for n in orders]
            columns = [
                (1.0 if n == 0 else 2.0) * np.mean(waves * e, axis=1) for n, e in zip(orders, turning, strict=True)
            ]
            found.append(np.stack(columns, axis=1))
        return np.array(found)


def _pair(x, y) -> np.ndarray:
    return np.array([x, y])


def duffing(cubic: float) -> Force:
    """k_3 r² (x, y) of the shaft's deflection."""
    return lambda angle, q, v, d: cubic * (d[0] ** 2 + d[1] ** 2) * d


def clearance(stiffness: float, gap: float) -> Force:
    """k_c (r - gap) outwards beyond the gap."""
    return rub(stiffness, gap, 0.0, 1)


def rub(stiffness: float, gap: float, friction: float, sense: int) -> Force:
    """The same, and friction against a shaft that turns in this sense."""

    def force(angle, q, v, d):
        x, y = q
        radius = np.hypot(x, y)
        pressed = stiffness * np.maximum(radius - gap, 0.0) / np.maximum(radius, 1e-30)
        return pressed * _pair(x - friction * sense * y, y + friction * sense * x)

    return force


def crack(loss: complex, sense: int, gravity: tuple[float, float]) -> Force:
    """-Δk b e (e·d), e at the angle of ``loss`` in the turning shaft; open below, closed above."""
    weight = np.hypot(*gravity)
    down = np.array(gravity) / weight if weight else np.zeros(2)

    phase = np.angle(loss)

    def force(angle, q, v, d):
        cosine, sine = np.cos(angle + phase), sense * np.sin(angle + phase)
        open_share = 0.5 * (1.0 + cosine * down[0] + sine * down[1])
        along = cosine * d[0] + sine * d[1]
        return -abs(loss) * open_share * _pair(cosine * along, sine * along)

    return force


def asymmetric_shaft(difference: complex, sense: int) -> Force:
    """Stiffer by Δk along β, softer across, β half the angle of ``difference``."""
    phase = np.angle(difference)

    def force(angle, q, v, d):
        twice = 2 * angle + phase
        cosine, sine = np.cos(twice), sense * np.sin(twice)
        return abs(difference) * _pair(cosine * d[0] + sine * d[1], sine * d[0] - cosine * d[1])

    return force


def quadratic_damping(drag: float) -> Force:
    """c_2 |v| v."""
    return lambda angle, q, v, d: drag * np.hypot(v[0], v[1]) * v


def spring_of_power(stiffness: float, power: float, at: float) -> Force:
    """Resists with k r (r / r₀)^(n - 1): as a spring of that stiffness does at the displacement r₀."""
    return lambda angle, q, v, u: stiffness * (np.hypot(*u) / at) ** (power - 1.0) * u


def damping_of_power(damping: float, power: float, at: float) -> Force:
    """Resists with c s (s / s₀)^(n - 1), s the speed of vibration."""
    return lambda angle, q, v, u: damping * (np.hypot(*v) / at) ** (power - 1.0) * v


def coulomb_friction(force_n: float) -> Force:
    """F against the velocity, spread over a small speed."""
    return lambda angle, q, v, d: force_n * v / np.sqrt(v[0] ** 2 + v[1] ** 2 + STICTION**2)


def saturation(limit: float) -> Callable[[np.ndarray], np.ndarray]:
    """h tanh(w / h): for `NonlinearRotor.bend`."""
    return lambda wave: limit * np.tanh(wave / limit)


def cubic_x(stiffness: float) -> Force:
    """k x³ along x only."""
    return lambda angle, q, v, d: _pair(stiffness * q[0] ** 3, 0.0 * q[1])


def dead_band_x(stiffness: float, gap: float) -> Force:
    """A spring along x that is reached beyond a gap on either side."""
    return lambda angle, q, v, d: _pair(stiffness * np.sign(q[0]) * np.maximum(np.abs(q[0]) - gap, 0.0), 0.0 * q[1])


def stop_below_y(stiffness: float, gap: float) -> Force:
    """A spring along y that is reached beyond a gap on the negative side only."""
    return lambda angle, q, v, d: _pair(0.0 * q[0], stiffness * np.minimum(q[1] + gap, 0.0))


def square_x(stiffness: float) -> Force:
    """k x² along x only."""
    return lambda angle, q, v, d: _pair(stiffness * q[0] ** 2, 0.0 * q[1])


def quadratic_damping_x(drag: float) -> Force:
    """c |v_x| v_x along x only."""
    return lambda angle, q, v, d: _pair(drag * np.abs(v[0]) * v[0], 0.0 * v[1])


def pulsating(force: complex, direction: float, times: int = 1) -> Force:
    """|F| cos(n φ + arg F) along a fixed direction [rad], n times per turn; on the left-hand side as
    every force here.
    """
    phase, across, up = np.angle(force), np.cos(direction), np.sin(direction)

    def push(angle, q, v, d):
        size = abs(force) * np.cos(times * angle + phase)
        return _pair(size * across, size * up)

    return push


def stiffness_twice_per_turn_x(stiffness: complex) -> Force:
    """|k| cos(2 φ + arg k) x along x only."""
    return lambda angle, q, v, d: _pair(abs(stiffness) * np.cos(2 * angle + np.angle(stiffness)) * q[0], 0.0 * q[1])


def measure(
    machine: Machine,
    plan: Plan,
    forces: tuple[Force, ...] | Callable[[float], tuple[Force, ...]],
    rng: np.random.Generator,
    *,
    gravity: tuple[float, float] = (0.0, 0.0),
    sense: int = 1,
    bend: Callable[[np.ndarray], np.ndarray] | None = None,
) -> np.ndarray:
    """Vectors, case x probe x order [m], runs one after the other, with Gaussian noise on real and imaginary parts;
    order 0 is real.

    ``forces``: the same at every speed, or a function of the speed.
    """
    totals, by_speed = [sum(weights) for weights in plan.weights.values()], []
    for speed in plan.speeds:
        present = tuple(forces(speed)) if callable(forces) else tuple(forces)
        rotor = NonlinearRotor(
            machine.mass, machine.stiffness, machine.damping, sense, gravity, 0.0, plan.bow, present, bend
        )
        by_speed.append(rotor.vectors_of(totals, speed, plan.orders))
    clean = np.moveaxis(np.array(by_speed), 0, 1)
    clean = clean.reshape(-1, *clean.shape[2:])
    noisy = clean + plan.sigma * (rng.standard_normal(clean.shape) + 1j * rng.standard_normal(clean.shape))
    return np.where(np.array(plan.orders) == 0, noisy.real + 0j, noisy)
