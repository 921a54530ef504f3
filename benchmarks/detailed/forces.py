"""Nonlinear forces, on the disk or on the deflection of the shaft: NumPy only.

Each is a function of angle [rad], place [m] and velocity [m/s] of the disk, deflection of the shaft off its bow [m],
pairs (x, y) along the last axis, and gives the force that resists, on the left-hand side of the equation of motion [N].
"""

import dataclasses
from collections.abc import Callable

import numpy as np

Law = Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray], np.ndarray]

STICTION = 6.3e-5
"""Speed over which dry friction changes its sign [m/s]: a hundredth of 6.3 mm/s, as in the catalogue."""


@dataclasses.dataclass(frozen=True)
class Force:
    """A law, and whether it acts on the shaft (between disk and journals) or on the disk (against the ground)."""

    law: Law
    on_shaft: bool


def _radius(pair: np.ndarray) -> np.ndarray:
    return np.hypot(pair[..., 0], pair[..., 1])[..., None]


def power(coefficient: float, exponent: int) -> Force:
    """c r^(n-1) (x, y): the shaft stiffens with the power n - 1 of its deflection."""
    return Force(lambda angle, q, v, d: coefficient * _radius(d) ** (exponent - 1) * d, True)


def stop(stiffness: float, gap: float, friction: float = 0.0) -> Force:
    """k (r - gap) outwards beyond the gap, and friction against a surface that moves from x to y."""

    def law(angle, q, v, d):
        radius = _radius(q)
        pressed = stiffness * np.maximum(radius - gap, 0.0) / np.maximum(radius, 1e-30)
        return pressed * (q + friction * np.stack([-q[..., 1], q[..., 0]], axis=-1))

    return Force(law, False)


def crack(loss: complex, gravity: tuple[float, float]) -> Force:
    """-Δk b e (e·d): e turns with the shaft, at first at the angle of ``loss``; b is 1 where e points down, 0 up."""
    weight, phase = np.hypot(*gravity), np.angle(loss)

    def law(angle, q, v, d):
        e = np.stack([np.cos(angle + phase), np.sin(angle + phase)], axis=-1)
        breathing = 0.5 * (1.0 + e @ np.array(gravity) / weight)
        return -abs(loss) * (breathing * np.sum(e * d, axis=-1))[..., None] * e

    return Force(law, True)


def unequal_shaft(difference: complex) -> Force:
    """Stiffer by Δk along β, softer across, turning with the shaft; β is half the angle of ``difference``."""
    phase = np.angle(difference)

    def law(angle, q, v, d):
        cosine, sine = np.cos(2 * angle + phase), np.sin(2 * angle + phase)
        x, y = d[..., 0], d[..., 1]
        return abs(difference) * np.stack([cosine * x + sine * y, sine * x - cosine * y], axis=-1)

    return Force(law, True)


def drag(coefficient: float, exponent: int = 2) -> Force:
    """c |v|^(n-1) v."""
    return Force(lambda angle, q, v, d: coefficient * _radius(v) ** (exponent - 1) * v, False)


def dry_friction(force: float) -> Force:
    """F against the velocity, its change of sign spread over `STICTION`."""
    return Force(lambda angle, q, v, d: force * v / np.sqrt(_radius(v) ** 2 + STICTION**2), False)


def slider(force: float, direction: float, spread: float) -> Force:
    """Dry friction along one direction [rad] only, its change of sign spread over a speed."""
    along = np.array([np.cos(direction), np.sin(direction)])
    return Force(lambda angle, q, v, d: force * np.tanh((v @ along) / spread)[..., None] * along, False)


def switched_stiffness(stiffness: float, phase: float, direction: float) -> Force:
    """±k along a fixed direction, switching twice per turn: a square wave, where a keyway gives a cosine."""
    along = np.array([np.cos(direction), np.sin(direction)])

    def law(angle, q, v, d):
        # A steep ramp in the place of the jump, so that steps meet it.
        sign = np.tanh(4.0 * np.cos(2 * angle + phase))
        return stiffness * (sign * (d @ along))[..., None] * along

    return Force(law, True)
