"""An independent answer: the rotor integrated in time and read like a real one. Shares no code with rotorjax.

Everything that effects do is written here in the time domain, longhand, with SciPy: equations of motion over one
revolution, the periodic orbit from the fundamental matrix, waveforms sampled where a recorder would sample them.
"""

import cmath
import dataclasses
from collections.abc import Callable

import numpy as np
from scipy.integrate import solve_ivp

SAMPLES = 64


def _turned(pair: tuple[float, float], angle: float) -> np.ndarray:
    """Springs or dampers along two axes that are turned from x towards y."""
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return turn @ np.diag(pair) @ turn.T


@dataclasses.dataclass
class TimeRotor:
    """A rotor in time. Pairs are (x, y); rotating vectors are complex, their angle counted with the rotation."""

    mass: float
    stiffness: tuple[float, float]
    damping: tuple[float, float]
    sense: int = 1
    axes: float = 0.0
    """Turn of the springs' axes from x towards y."""
    damping_axes: float = 0.0
    """The same of the dampers."""
    cross: float = 0.0
    internal: float = 0.0
    gyroscopic: float = 0.0
    foundation: tuple[float, float, float] | None = None
    """Stiffness, mass, damping of the foundation, the same along x and y."""
    bow_through_damping: bool = False
    unbalance: complex = 0.0
    bow: complex = 0.0
    force_1: complex = 0.0
    force_2: tuple[complex, complex] = (0.0, 0.0)
    probes: tuple[tuple[float, float, bool], ...] = ((0.0, 1.0, False), (np.pi / 2, 1.0, False))
    """Angle, participation, whether it reads against the foundation."""
    gains: tuple[float, ...] = (1.0, 1.0)
    runout: tuple[dict[int, complex], ...] = ({}, {})
    delay: float = 0.0
    reference: float = 0.0
    """Shaft angle by which the phase reference comes later than the zero of the weights' angles."""

    def _turning(self, vector: complex, angle: float) -> np.ndarray:
        turned = vector * cmath.exp(1j * angle)
        return np.array([[turned.real], [self.sense * turned.imag]])

    def _rate(self, speed: float, driven: np.ndarray) -> Callable[[float, np.ndarray], np.ndarray]:
        """The states' rate of change, several at once: state x motion in a row. Each is ``driven`` by what excites the
        rotor, or not.
        """
        spring, damping = _turned(self.stiffness, self.axes), _turned(self.damping, self.damping_axes)
        across_of = self.sense * np.array([[0.0, 1.0], [-1.0, 0.0]])

        def rate(t: float, flat: np.ndarray) -> np.ndarray:
            state = flat.reshape(-1, len(driven))
            q, v = state[0:2], state[2:4]
            ground, ground_v = (state[4:6], state[6:8]) if self.foundation else (0.0, 0.0)
            angle = speed * t
            path = spring @ (q - driven * self._turning(self.bow, angle) - ground)
            across = across_of @ q
            damped_v = v - driven * self._turning(1j * speed * self.bow, angle) if self.bow_through_damping else v
            force = (
                -path
                - damping @ damped_v
                - self.cross * across
                - self.internal * (v + speed * across)
                - speed * self.gyroscopic * (across_of @ v)
                + driven * self._turning(self.unbalance * speed**2 + self.force_1, angle)
                + driven * np.array([[(f * cmath.exp(2j * angle)).real] for f in self.force_2])
            )
            rates = [v, force / self.mass]
            if self.foundation:
                stiffness, mass, damper = self.foundation
                rates += [ground_v, (path - stiffness * ground - damper * ground_v) / mass]
            return np.concatenate(rates).ravel()

        return rate

    def _gathered(self, speed: float, size: int, driven: np.ndarray) -> Callable[[float, np.ndarray], np.ndarray]:
        """The same rate of change, as a matrix times the state and waves of once and twice per turn: they are read off
        the equations above at unit states and at four instants, so that these need not be gone through at every step.
        """
        matrix = self._rate(speed, np.zeros(size))(0.0, np.eye(size).ravel()).reshape(size, size)
        instants = np.array([0.0, 0.7, 1.9, 3.3]) / speed
        at_rest = self._rate(speed, np.ones(1))
        seen = np.array([at_rest(t, np.zeros(size)) for t in instants])

        def waves(t: np.ndarray) -> np.ndarray:
            turn = np.exp(1j * speed * t)
            return np.stack([turn.real, turn.imag, (turn * turn).real, (turn * turn).imag], axis=-1)

        pushed = np.linalg.solve(waves(instants), seen).T

        def rate(t: float, flat: np.ndarray) -> np.ndarray:
            once = cmath.exp(1j * speed * t)
            twice = once * once
            push = pushed @ (once.real, once.imag, twice.real, twice.imag)
            return (matrix @ flat.reshape(size, -1) + push[:, None] * driven).ravel()

        return rate

    def waveforms(self, speed: float) -> tuple[np.ndarray, np.ndarray]:
        """Recorder times of one revolution and the probes' waveforms there, on the periodic orbit."""
        size, period = (8 if self.foundation else 4), 2 * np.pi / speed

        def integrate(starts: np.ndarray, driven: np.ndarray, dense: bool = False):
            rate = self._gathered(speed, size, driven)
            return solve_ivp(
                rate, (0.0, period), starts.ravel(), method="DOP853", rtol=1e-11, atol=1e-16, dense_output=dense
            )

        free = integrate(np.eye(size, size + 1), np.arange(size + 1) == size).y[:, -1].reshape(size, size + 1)
        start = np.linalg.solve(np.eye(size) - free[:, :size], free[:, size])
        orbit = integrate(start, np.ones(1), dense=True).sol
        recorder = np.arange(SAMPLES) * period / SAMPLES
        states = orbit((recorder - self.delay + self.reference / speed) % period)
        seen = []
        for (angle, participation, on_foundation), gain, runout in zip(
            self.probes, self.gains, self.runout, strict=True
        ):
            x, y = states[0:2] - (states[4:6] if on_foundation and self.foundation else 0.0)
            wave = participation * (np.cos(angle) * x + np.sin(angle) * y)
            shaft = speed * (recorder - self.delay) + self.reference
            wave = wave + sum((r * np.exp(1j * n * shaft)).real for n, r in runout.items())
            seen.append(gain * wave)
        return recorder, np.array(seen)

    def vectors(self, speed: float, orders: tuple[int, ...] = (1,)) -> np.ndarray:
        """Complex amplitude per probe and order, phase leading, from the samples of one revolution."""
        times, waves = self.waveforms(speed)
        return np.stack([2.0 * np.mean(waves * np.exp(-1j * n * speed * times), axis=1) for n in orders], axis=1)
