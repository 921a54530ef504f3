"""Stable motions of one and of two turns beside a stop: those that time integration reaches, and how many of them
`steady_states` finds.

Rotors, stops and speeds are drawn by seed, horizontal, so that the weight presses the shaft towards the stop. Each is
integrated from 24 random states by classical Runge-Kutta steps in NumPy until the transient is gone; motions that
repeat themselves after one turn or two, and did so already at half the time, are counted once each. Some two minutes;
exits with 1 if one is missed.

    python benchmarks/half_orders.py
"""

import argparse
import sys
from typing import NamedTuple

import jax
import numpy as np

from rotorjax import Conditions, Jeffcott, Layout, Model, effects, steady_states
from rotorjax.reporting.tables import Table

WEIGHT = 9.80665
ORDERS = (0.0, 0.5, 1.0, 2.0)
STARTS, STEPS, LEFT = 24, 192, 24.0
"""States to begin with; steps per turn; e^-24 of the free rotor's transient is left. Near a bifurcation transients are
slower.
"""
REPEATS, SAME = 1e-4, 1e-2
"""Parts of the largest vibration: to which a motion repeats itself, and to which two are one."""
SHARES = (1.7, 1.9, 2.1, 2.3, 2.5)
"""Speeds in the natural frequency, near twice which a loose support makes half orders."""


class Drawn(NamedTuple):
    """A rotor with a stop."""

    mass: float
    stiffness: np.ndarray
    damping: np.ndarray
    contact: float
    gap: float
    unbalance: float

    @property
    def frequency(self) -> float:
        """Natural frequency [rad/s]."""
        return float(np.sqrt(self.stiffness.mean() / self.mass))

    def model(self) -> Model:
        """The same in rotorjax."""
        ratio = self.damping / (2.0 * np.sqrt(self.stiffness * self.mass))
        rotor = Jeffcott(self.mass, self.stiffness.tolist(), ratio.tolist(), gravity=[0.0, -WEIGHT])
        return Model(rotor, layout=Layout(orders=ORDERS)) + effects.Clearance(self.contact, 1.0 / self.gap)


def draw(rng: np.random.Generator) -> Drawn:
    mass, frequency, split = (
        np.exp(rng.uniform(np.log(0.5), np.log(10.0))),
        rng.uniform(150.0, 350.0),
        rng.uniform(0.0, 0.1),
    )
    mean = mass * frequency**2
    stiffness = mean * np.array([1.0 + 0.5 * split, 1.0 - 0.5 * split])
    damping = 2.0 * rng.uniform(0.01, 0.03) * np.sqrt(stiffness * mass)
    sag = mass * WEIGHT / mean
    return Drawn(
        float(mass),
        stiffness,
        damping,
        float(rng.uniform(0.3, 1.5) * mean),
        float(rng.uniform(0.9, 1.15) * sag),
        float(mass * sag * rng.uniform(0.03, 0.2)),
    )


def rate(rotor: Drawn, speed: float, t: float, state: np.ndarray) -> np.ndarray:
    """State: x, y and their velocities, by start."""
    q, v = state[:2], state[2:]
    radius = np.hypot(q[0], q[1]) + 1e-30
    pressed = rotor.contact * np.maximum(1.0 - rotor.gap / radius, 0.0) * q
    pull = rotor.unbalance * speed**2 * np.array([[np.cos(speed * t)], [np.sin(speed * t)]]) - np.array(
        [[0.0], [rotor.mass * WEIGHT]]
    )
    return np.concatenate(
        [v, (pull - rotor.damping[:, None] * v - rotor.stiffness[:, None] * q - pressed) / rotor.mass]
    )


def reached(rotor: Drawn, speed: float, rng: np.random.Generator) -> tuple[list[np.ndarray], int]:
    """Amplitudes (x, y at 1/2X, then at 1X) of every motion of one or two turns, each once; and how many starts ended
    in another motion.
    """
    period = 2.0 * np.pi / speed
    turns = 2 * int(np.ceil(LEFT / (rotor.damping.min() / (2.0 * rotor.mass)) / period / 2.0))
    h = period / STEPS
    state = np.concatenate(
        [2.0 * rotor.gap * rng.standard_normal((2, STARTS)), rotor.gap * speed * rng.standard_normal((2, STARTS))]
    )
    path, halfway = [], turns // 4 * 2 * STEPS
    earlier = state[:2]
    for k in range((turns + 4) * STEPS):
        if k == halfway:
            earlier = state[:2]
        if k >= turns * STEPS:
            path.append(state[:2])
        t = k * h
        a = rate(rotor, speed, t, state)
        b = rate(rotor, speed, t + h / 2, state + h / 2 * a)
        c = rate(rotor, speed, t + h / 2, state + h / 2 * b)
        d = rate(rotor, speed, t + h, state + h * c)
        state = state + h / 6 * (a + 2 * b + 2 * c + d)
    whole = np.array(path)
    size = np.max(np.abs(whole - whole.mean(axis=0)))
    settled = np.max(np.abs(whole[2 * STEPS :] - whole[: 2 * STEPS]), axis=(0, 1)) < REPEATS * size
    settled &= np.max(np.abs(whole[0] - earlier), axis=0) < REPEATS * size
    wave = whole[2 * STEPS :]
    angle = 2.0 * np.pi * np.arange(2 * STEPS) / STEPS
    found: list[np.ndarray] = []
    for k in np.flatnonzero(settled):
        amplitudes = np.concatenate(
            [np.abs(2.0 * np.mean(wave[:, :, k] * np.exp(-1j * n * angle)[:, None], axis=0)) for n in (0.5, 1.0)]
        )
        if not any(np.max(np.abs(amplitudes - other)) < SAME * size for other in found):
            found.append(amplitudes)
    return found, int(np.sum(~settled))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rotors", type=int, default=8, help="how many (%(default)s)")
    parser.add_argument(
        "--seed",
        type=int,
        default=2,
        help="to draw them; 1 was looked at while the method was made, 3 while this script was (%(default)s)",
    )
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    rng = np.random.default_rng(arguments.seed)
    rows, counts = [], np.zeros(4, int)
    for k in range(arguments.rotors):
        rotor = draw(rng)
        speeds = np.array(SHARES) * rotor.frequency
        states = steady_states(rotor.model(), Conditions.at(speeds, unbalance=[rotor.unbalance, 0.0]))
        for case, speed in enumerate(speeds):
            expected, others = reached(rotor, float(speed), rng)
            shown = [states.vectors[case], *(other.vectors for other in states.others[case])]
            ours = [np.concatenate([np.abs(z[:, 1]), np.abs(z[:, 2])]) for z in shown if np.all(np.isfinite(z))]
            missed = [e for e in expected if not any(np.max(np.abs(e - o)) < SAME * np.max(e) for o in ours)]
            half = sum(np.max(e[:2]) > SAME * np.max(e) for e in expected)
            counts += np.array([len(expected), half, len(missed), others])
            rows.append([str(k), f"{SHARES[case]:g}", str(len(expected)), str(half), str(len(missed)), str(others)])
    heads = [
        "rotor",
        "speed / natural frequency",
        "stable motions reached",
        "of two turns",
        "missed",
        f"starts of {STARTS} that end in another motion",
    ]
    print(Table("", heads, [*rows, ["all", "", *map(str, counts)]]).text())
    sys.exit(int(counts[2] > 0))


if __name__ == "__main__":
    main()
