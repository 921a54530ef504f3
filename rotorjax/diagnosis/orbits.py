"""Orbits: the path of the shaft's centre, from the vectors of two probes in one plane or from what they recorded.

Two probes at the angles α_k read d_k = x cos α_k + y sin α_k. The motion x + iy = Σ r₊ e^{inΩt} + r₋ e^{-inΩt} is the
sum of two circular ones at each order n: r₊ = (X + iY) / 2 turns from x to y, r₋ = conj(X - iY) / 2 the other way; that
in the sense of rotation is the forward one. Source: Bently, Hatch 2002, chapters 5 and 8.
"""

import math
from collections.abc import Sequence
from fractions import Fraction
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Complex, Float

from rotorjax.arrays import Numbers
from rotorjax.data import signals
from rotorjax.model.model import Model

POINTS = 360
"""Points of an orbit in one revolution."""
LEAST_APART = 0.5
"""Sine of the angle between two probes below which they tell no orbit: errors across would be more than doubled."""
LONGEST = 12
"""Revolutions after which an orbit closes, at most."""
CERTAIN = 1.96
"""Standard errors from zero at which a sense of whirl counts as told (95 %)."""

Sense = Literal["forward", "backward", "a line"]
Pair = tuple[int, int]
"""Two probes, by their place."""


class Orbit(NamedTuple):
    """Motion of the shaft's centre in the plane of two probes, at one speed."""

    orders: tuple[float, ...]
    motion: Complex[np.ndarray, "dof order"]
    """Along x and y [m], zero-to-peak, phase leading: displacement Re[q e^{inΩt}]."""
    spin: int = 1
    """+1 for a shaft turning from x to y, else -1."""
    sigma: Float[np.ndarray, "order"] | None = None
    """Standard error of half the minor axis at each order [m]; none where it is not known."""

    @classmethod
    def of(
        cls,
        vectors: Complex[np.ndarray, "probe order"],
        orders: Sequence[float],
        angle: Sequence[float] | np.ndarray,
        *,
        spin: int = 1,
        sigma: Float[np.ndarray, "probe order"] | None = None,
    ) -> "Orbit":
        """From the vectors of two probes [m]. **Arguments:** ``angle`` of the probes, from +x towards +y [rad];
        ``sigma`` of real and of imaginary part [m]. **Errors.** ``ValueError`` for probes that are less than 30° apart.
        """
        back = _along_axes(angle)
        turning = 0.5 * (back[0] + 1j * back[1])
        error = None if sigma is None else np.sqrt(2.0 * np.abs(turning) ** 2 @ sigma**2)
        return cls(tuple(orders), back @ vectors, spin, error)

    @property
    def turns(self) -> int:
        """Revolutions after which the orbit closes: two where there is motion at a half order."""
        moves = np.any(self.motion != 0.0, axis=0)
        there = [order for order, moved in zip(self.orders, moves.tolist(), strict=True) if moved]
        parts = [Fraction(order).limit_denominator(LONGEST).denominator for order in there]
        return min(math.lcm(*parts), LONGEST)

    @property
    def forward(self) -> Float[np.ndarray, "order"]:
        """Amplitude of the circular motion in the sense of rotation, at each order [m]."""
        return 0.5 * np.abs(self.motion[0] + 1j * self.spin * self.motion[1])

    @property
    def backward(self) -> Float[np.ndarray, "order"]:
        """Amplitude of the one against it [m]."""
        return 0.5 * np.abs(self.motion[0] - 1j * self.spin * self.motion[1])

    @property
    def reach(self) -> float:
        """Largest distance from the mean position [m]."""
        return float(np.linalg.norm(self.path(), axis=1).max())

    def path(self) -> Float[np.ndarray, "sample dof"]:
        """Once along the closed orbit, from a pulse of the phase reference on, about the mean position [m]."""
        return self._at(2.0 * np.pi * np.linspace(0.0, self.turns, self.turns * POINTS + 1))

    def at_reference(self) -> Float[np.ndarray, "sample dof"]:
        """Where the shaft is when the phase reference fires, in each revolution until the orbit closes [m]."""
        return self._at(2.0 * np.pi * np.arange(self.turns))

    def at_order(self, order: float) -> "Orbit":
        """The part of one order alone."""
        k = self.orders.index(order)
        sigma = None if self.sigma is None else self.sigma[[k]]
        return Orbit((order,), self.motion[:, [k]], self.spin, sigma)

    def sense(self, order: float = 1.0) -> Sense:
        """Of whirl at one order: "a line" where the error leaves it open."""
        k = self.orders.index(order)
        minor = float(self.forward[k] - self.backward[k])
        error = 1e-6 * float(self.forward[k]) if self.sigma is None else CERTAIN * float(self.sigma[k])
        if abs(minor) <= error:
            return "a line"
        return "forward" if minor > 0.0 else "backward"

    def _at(self, angle: Float[np.ndarray, "sample"]) -> Float[np.ndarray, "sample dof"]:
        whirls = np.array(self.orders) != 0.0
        phase = np.exp(1j * np.outer(angle, np.array(self.orders)[whirls]))
        return np.real(phase @ self.motion[:, whirls].T)


class RecordedOrbit(NamedTuple):
    """Orbit of a record: as recorded, and what is left of it at 1X."""

    direct: Float[np.ndarray, "sample dof"]
    """Displacement along x and y, less its mean [m]."""
    at_reference: Float[np.ndarray, "_ dof"]
    """The same at every pulse of the phase reference."""
    filtered: Orbit
    """1X alone."""
    speed_rpm: float
    """Mean speed."""


class Centreline(NamedTuple):
    """Mean position of the shaft over speed: 0X of two probes."""

    speed_rpm: Float[np.ndarray, "case"]
    measured: Float[np.ndarray, "case dof"]
    """Along x and y [m]."""
    predicted: Float[np.ndarray, "case dof"] | None = None
    """Where the model puts it."""


def probe_pairs(model: Model, read: Sequence[str]) -> list[Pair]:
    """Probes, of those read, two by two, that see the shaft in one plane and in directions at least 30° apart.

    In one plane are those with the same participation and the same reference. Each goes with the next that suits, in
    the order of the rig file.
    """
    angle = np.asarray(model.probes.angle)
    plane = np.stack([np.asarray(model.probes.participation), np.asarray(model.probes.on_foundation)], axis=1)
    left, pairs = [model.layout.probes.index(probe) for probe in read], []
    while left:
        first = left.pop(0)
        fits = (
            k
            for k in left
            if np.array_equal(plane[k], plane[first]) and abs(math.sin(angle[k] - angle[first])) >= LEAST_APART
        )
        other = next(fits, None)
        if other is not None:
            left.remove(other)
            pairs.append((first, other))
    return pairs


def mean_position(
    vectors: Complex[np.ndarray, "case probe"], angle: Sequence[float] | np.ndarray
) -> Float[np.ndarray, "case dof"]:
    """Along x and y [m], from the 0X of two probes. **Arguments:** ``angle`` of the probes [rad]."""
    return np.real(vectors) @ _along_axes(angle).T


def recorded_orbit(
    time: Numbers,
    displacement: Numbers,
    pulses: Numbers,
    *,
    probe_angle_deg: tuple[float, float] = (0.0, 90.0),
    spin: int = 1,
) -> RecordedOrbit:
    """Orbit of a record of two probes.

    **Arguments:** ``time`` (sample) [s]; ``displacement`` (sample, 2) [m]; ``pulses`` of the phase reference [s];
    ``probe_angle_deg`` of the probes, from +x towards +y; ``spin``: +1 for a shaft turning from x to y, else -1.
    **Errors.** ``ValueError`` unless there are two probes at least 30° apart, and those of
    `rotorjax.data.signals.vectors_from_waveform`.
    """
    waves, angle = two_probes(displacement), np.radians(probe_angle_deg)
    fitted = signals.vectors_from_waveform(time, waves, pulses)
    whole = np.isfinite(fitted.angle)
    moved = (waves - waves[whole].mean(axis=0)) @ _along_axes(angle).T
    instants, marks = np.asarray(time, float), np.asarray(pulses, float)
    inside = marks[(marks >= instants[0]) & (marks <= instants[-1])]
    dots = np.stack([np.interp(inside, instants, moved[:, k]) for k in (0, 1)], axis=1)
    filtered = Orbit.of(fitted.vectors, (1.0,), angle, spin=spin, sigma=fitted.sigma)
    return RecordedOrbit(moved, dots, filtered, fitted.speed_rpm)


def two_probes(displacement: Numbers) -> Float[np.ndarray, "sample probe"]:
    """Displacement of two probes [m]. **Errors.** ``ValueError`` for another number of them."""
    waves = np.asarray(displacement, dtype=float)
    if waves.ndim != 2 or waves.shape[1] != 2:
        raise ValueError(
            f"an orbit needs the displacement of two probes, of shape (sample, 2); this one has shape {waves.shape}: "
            "choose two columns"
        )
    return waves


def _along_axes(angle: Sequence[float] | np.ndarray) -> Float[np.ndarray, "dof probe"]:
    """From what two probes read to motion along x and y."""
    if abs(math.sin(angle[1] - angle[0])) < LEAST_APART:
        raise ValueError(
            f"an orbit needs two probes at least 30° apart; these stand at {math.degrees(angle[0]):g}° and "
            f"{math.degrees(angle[1]):g}°: choose two others"
        )
    return np.linalg.inv(np.stack([np.cos(angle), np.sin(angle)], axis=1))
