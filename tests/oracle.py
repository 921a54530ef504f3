"""An independent answer: the rotor integrated in time and read like a real one. Shares no code with rotorjax.

Everything that effects do is written here in the time domain, longhand, with SciPy: equations of motion over one
revolution, the periodic orbit from the fundamental matrix, waveforms sampled where a recorder would sample them.
"""

import dataclasses

import numpy as np
from scipy.integrate import solve_ivp

SAMPLES = 64


@dataclasses.dataclass
class TimeRotor:
    """A rotor in time. Pairs are (x, y); rotating vectors are complex, their angle counted with the rotation."""

    mass: float
    stiffness: tuple[float, float]
    damping: tuple[float, float]
    sense: int = 1
    axes: float = 0.0
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
        turned = vector * np.exp(1j * angle)
        return np.array([turned.real, self.sense * turned.imag])

    def _derivative(self, t: float, state: np.ndarray, speed: float, driven: float) -> np.ndarray:
        q, v = state[0:2], state[2:4]
        ground, ground_v = (state[4:6], state[6:8]) if self.foundation else (np.zeros(2), np.zeros(2))
        angle = speed * t
        bow = driven * self._turning(self.bow, angle)
        turn = np.array([[np.cos(self.axes), -np.sin(self.axes)], [np.sin(self.axes), np.cos(self.axes)]])
        spring = turn @ np.diag(self.stiffness) @ turn.T
        path = spring @ (q - bow - ground)
        across = self.sense * np.array([q[1], -q[0]])
        across_v = self.sense * np.array([v[1], -v[0]])
        damped_v = v - driven * self._turning(1j * speed * self.bow, angle) if self.bow_through_damping else v
        force = (
            -path
            - np.array(self.damping) * damped_v
            - self.cross * across
            - self.internal * (v + speed * across)
            - speed * self.gyroscopic * across_v
            + driven * self._turning(self.unbalance * speed**2 + self.force_1, angle)
            + driven * np.array([(f * np.exp(2j * angle)).real for f in self.force_2])
        )
        rates = [v, force / self.mass]
        if self.foundation:
            stiffness, mass, damping = self.foundation
            rates += [ground_v, (path - stiffness * ground - damping * ground_v) / mass]
        return np.concatenate(rates)

    def waveforms(self, speed: float) -> tuple[np.ndarray, np.ndarray]:
        """Recorder times of one revolution and the probes' waveforms there, on the periodic orbit."""
        size, period = (8 if self.foundation else 4), 2 * np.pi / speed

        def integrate(start: np.ndarray, driven: float, dense: bool = False):
            return solve_ivp(self._derivative, (0.0, period), start, method="DOP853", rtol=1e-11, atol=1e-16, args=(speed, driven), dense_output=dense)

        unit = np.column_stack([integrate(column, 0.0).y[:, -1] for column in np.eye(size)])
        start = np.linalg.solve(np.eye(size) - unit, integrate(np.zeros(size), 1.0).y[:, -1])
        orbit = integrate(start, 1.0, dense=True).sol
        recorder = np.arange(SAMPLES) * period / SAMPLES
        states = orbit((recorder - self.delay + self.reference / speed) % period)
        seen = []
        for (angle, participation, on_foundation), gain, runout in zip(self.probes, self.gains, self.runout, strict=True):
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
