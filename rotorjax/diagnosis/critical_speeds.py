"""Critical speeds and amplification factors of a rotor, read off its response to unbalance as API 684 does."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from rotorjax.inference.faults import fault_sensitivity
from rotorjax.model.conditions import Conditions
from rotorjax.model.model import Model
from rotorjax.units import RPM

COARSE, FINE = 2001, 801
"""Speeds at which peaks are looked for, and speeds about each peak."""
ABOUT = 0.06
"""Share of a peak's speed on either side of it that the second look takes."""
SAME = 0.003
"""Relative difference up to which peaks of two probes are one critical speed."""


class CriticalSpeed(NamedTuple):
    """A speed at which the response to unbalance, over speed squared, peaks."""

    speed_rpm: float
    amplification: float | None
    """Speed over the width of the peak at 0.707 of its height (API RP 684); none where the response does not fall that
    far about it.
    """

    @property
    def damping_ratio(self) -> float | None:
        """One over twice the amplification factor: what a single lightly damped mode has."""
        return None if self.amplification is None else 0.5 / self.amplification


def critical_speeds(model: Model) -> tuple[CriticalSpeed, ...]:
    """Critical speeds of the rotor without forces that depend on motion, the lowest first.

    Looked for between 0.3 and 2 times what stiffness over mass says, with probes as they are in the ``model``.
    **Source:** API RP 684 (2005), sections 1.2 and 2.2: amplification factor N_c / (N_2 - N_1), half-power method.
    """
    model = model if 1.0 in model.layout.orders else model.with_orders((1.0,))
    nominal = np.sqrt(np.asarray(model.rotor.stiffness) / float(model.rotor.mass)) / RPM
    wide = np.linspace(0.3 * nominal.min(), 2.0 * nominal.max(), COARSE)
    size, found = _size(model, wide), []
    for probe in range(size.shape[1]):
        for peak in _peaks(size[:, probe]):
            near = wide[peak] * np.linspace(1.0 - ABOUT, 1.0 + ABOUT, FINE)
            there = _size(model, near)[:, probe]
            inner = [k for k in _peaks(there) if abs(near[k] - wide[peak]) <= 2.0 * (wide[1] - wide[0])]
            if inner:
                found.append(_read_off(near, there, max(inner, key=lambda k: there[k])))
    distinct: list[CriticalSpeed] = []
    for one in sorted(found, key=lambda c: -(c.amplification or 0.0)):
        if all(abs(one.speed_rpm / other.speed_rpm - 1.0) > SAME for other in distinct):
            distinct.append(one)
    return tuple(sorted(distinct, key=lambda c: c.speed_rpm))


def critical_speeds_rpm(model: Model) -> Float[np.ndarray, "speed"]:
    """The speeds alone."""
    return np.array([one.speed_rpm for one in critical_speeds(model)])


def _size(model: Model, speed_rpm: Float[np.ndarray, "speed"]) -> Float[np.ndarray, "speed probe"]:
    """Response of every probe to a unit unbalance, over speed squared."""
    conditions = Conditions.at_rpm(speed_rpm, unbalance=np.zeros((len(model.layout.planes), 2)))
    once = fault_sensitivity(model, conditions)[:, :, model.layout.orders.index(1.0), :, 0]
    return np.linalg.norm(once, axis=-1) / speed_rpm[:, None] ** 2


def _peaks(size: Float[np.ndarray, "speed"]) -> list[int]:
    return [int(k) + 1 for k in np.flatnonzero((size[1:-1] > size[:-2]) & (size[1:-1] >= size[2:]))]


def _read_off(speed_rpm: Float[np.ndarray, "speed"], size: Float[np.ndarray, "speed"], peak: int) -> CriticalSpeed:
    """The width at half power; twice one half of it where another peak hides the other."""
    halves = []
    for side in (np.arange(peak, -1, -1), np.arange(peak, len(size))):
        below = np.flatnonzero(size[side] < np.sqrt(0.5) * size[peak])
        rises = np.flatnonzero(size[side] > size[peak])
        if len(below) and not (len(rises) and rises[0] < below[0]):
            outer, inner = side[below[0]], side[below[0] - 1]
            share = (size[inner] - np.sqrt(0.5) * size[peak]) / (size[inner] - size[outer])
            halves.append(
                abs(float(speed_rpm[inner] + share * (speed_rpm[outer] - speed_rpm[inner]) - speed_rpm[peak]))
            )
    width = 2.0 * float(np.mean(halves)) if halves else None
    return CriticalSpeed(float(speed_rpm[peak]), None if not width else float(speed_rpm[peak]) / width)
