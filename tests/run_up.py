"""A rotor whose speed changes, integrated in time."""

import numpy as np
from scipy.integrate import solve_ivp

from hidden import Machine

FORWARD = np.array([1.0, -1j])


def swept(
    speeds: np.ndarray, rate: float, machine: Machine, unbalance: complex, bow: complex = 0.0, cross: float = 0.0
) -> np.ndarray:
    """Amplitudes of x and y at some speeds [rad/s] on the way, of a rotor that begins in steady motion far off.

    The motion is complex, its real part the rotor's.
    """
    path, damping = np.diag(machine.stiffness), np.diag(machine.damping)
    stiffness = path + cross * np.array([[0.0, 1.0], [-1.0, 0.0]])
    begin = 40.0 if rate > 0.0 else 500.0
    instants = (speeds - begin) / rate
    order = np.argsort(instants)

    def turned(t):
        return begin * t + 0.5 * rate * t**2

    def change(t, state):
        speed = begin + rate * t
        # The mass centre at e^{iφ} from the shaft's: minus its acceleration pushes.
        push = unbalance * (speed**2 - 1j * rate) * FORWARD + path @ (bow * FORWARD)
        back = damping @ state[2:] + stiffness @ state[:2]
        return np.concatenate([state[2:], (push * np.exp(1j * turned(t)) - back) / machine.mass])

    dynamic = stiffness + 1j * begin * damping - begin**2 * machine.mass * np.eye(2)
    steady = np.linalg.solve(dynamic, unbalance * begin**2 * FORWARD + path @ (bow * FORWARD))
    start = np.concatenate([steady, 1j * begin * steady])
    found = solve_ivp(change, (0.0, instants.max() + 1e-6), start, "DOP853", instants[order], rtol=1e-9, atol=1e-15)
    amplitudes = np.empty((len(speeds), 2), complex)
    amplitudes[order] = (found.y[:2] * np.exp(-1j * turned(found.t))).T
    return amplitudes
