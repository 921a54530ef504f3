"""Forces that grow with a power of displacement or of velocity, whatever power that is, in every direction alike or
along one axis.

The catalogue has the powers that are usual: a cubic spring, quadratic damping. These tell whether another one would do
better.
"""

import math
from typing import ClassVar

import jax.numpy as jnp
from jax import Array

from rotorjax.arrays import as_float
from rotorjax.effects.restoring import AROUND, length
from rotorjax.effects.term import AxisForce, Term
from rotorjax.model.contract import BALANCE_GRADE, AbstractRotor, Family, Instant, Plan, RestoringEffect
from rotorjax.model.parameters import parameter

POWER = "power_less_two"
"""The parameter that is the power less two: zero where the force grows with the square, which has a slope at zero."""
LEAST_SHARE = 1e-6
"""Smooths a size at zero, in the size at which the force equals that of the rotor."""


class PowerTerm(Term, RestoringEffect):
    """A force that grows with a power of a size."""

    usual: ClassVar[tuple[float, ...]]
    """Powers, less two, of which there are effects or terms of their own."""
    tried: ClassVar[tuple[float, ...]]
    """Powers, less two, that a regression tries."""

    def power_of(self, pair: Array, inverse_size: Array, power_less_two: Array) -> Array:
        """κ s |κ s|^p (x, y), s the length of (x, y), or of what is along the axis."""
        axis = self.axis()
        seen = pair if axis is None else pair * jnp.eye(2)[axis]
        return inverse_size * length(seen) * length(inverse_size * seen, LEAST_SHARE) ** power_less_two * seen


class SpringTerm(PowerTerm):
    """One that grows with a power of displacement."""

    family: ClassVar[Family] = "restoring"
    source: ClassVar[str] = "Nayfeh, Mook, Nonlinear Oscillations, Wiley 1979, section 2.3"
    relatives: ClassVar[tuple[str, ...]] = ("duffing", "stiffness_error")
    sufficient: ClassVar[Plan] = AROUND
    inverse_size_per_m: Array = parameter(
        "one over the displacement at which its force equals that of the shaft", scale=0.1, of="curvature"
    )
    power_less_two: Array = parameter("power of displacement, less two", scale=2.0, shape_only=True)
    starts: ClassVar[tuple[dict[str, float], ...]] = tuple(
        {"inverse_size_per_m": side * 0.5, POWER: 1.0} for side in (1.0, -1.0)
    )
    over_amplitude: ClassVar[tuple[str, ...]] = ("inverse_size_per_m",)

    def force(self, instant: Instant) -> Array:
        stiffness, axis = jnp.mean(instant.rotor.stiffness), self.axis()
        moved = instant.deflection if axis is None else instant.position
        return stiffness * self.power_of(moved, self.inverse_size_per_m, self.power_less_two)


class DampingTerm(PowerTerm):
    """One that grows with a power of the speed of vibration."""

    family: ClassVar[Family] = "restoring"
    source: ClassVar[str] = "Rao, Mechanical Vibrations, 5th edition, 2011, section 3.10"
    relatives: ClassVar[tuple[str, ...]] = ("quadratic_damping", "damping_error")
    sufficient: ClassVar[Plan] = AROUND
    inverse_speed_s_per_m: Array = parameter(
        "one over the speed of vibration at which it damps critically", scale=0.03, of="slowness"
    )
    power_less_two: Array = parameter("power of the speed of vibration, less two", scale=2.0, shape_only=True)
    starts: ClassVar[tuple[dict[str, float], ...]] = ({"inverse_speed_s_per_m": 1.0, POWER: 0.5},)

    def force(self, instant: Instant) -> Array:
        critical = 2.0 * jnp.sqrt(jnp.mean(instant.rotor.stiffness) * instant.rotor.mass)
        return critical * self.power_of(instant.velocity, self.inverse_speed_s_per_m, self.power_less_two)


class PowerSpring(SpringTerm):
    """f = k̄ κ r |κ r|^p (x, y), p the power less two, r the deflection of the shaft, k̄ the mean stiffness."""

    name: ClassVar[str] = "term_power_spring"
    meaning: ClassVar[str] = "a spring that stiffens with some power of displacement (softens where negative)"
    words: ClassVar[str] = "restoring force in proportion to a power of displacement"
    usual: ClassVar[tuple[float, ...]] = (-1.0, 1.0)
    tried: ClassVar[tuple[float, ...]] = (-0.5, 0.0, 2.0, 3.0, 4.0)

    def axis(self) -> None:
        """In every direction alike."""


class AxisPowerSpring(AxisForce, SpringTerm):
    """k̄ κ |{a}| |κ {a}|^p {a} along {a}, p the power less two, k̄ the mean stiffness."""

    name: ClassVar[str] = "term_power_spring_{a}"
    meaning: ClassVar[str] = "a spring along {a} that stiffens with some power of displacement (softens where negative)"
    words: ClassVar[str] = "restoring force along {a} in proportion to a power of displacement"
    usual: ClassVar[tuple[float, ...]] = (-1.0, 0.0, 1.0)
    tried: ClassVar[tuple[float, ...]] = (-0.5, 0.5, 2.0, 3.0, 4.0)


class PowerDamping(DampingTerm):
    """f = 2 sqrt(k̄ M) κ s |κ s|^p (ẋ, ẏ), p the power less two, s the speed of vibration, k̄ the mean stiffness, M the
    mass.
    """

    name: ClassVar[str] = "term_power_damping"
    meaning: ClassVar[str] = "damping that grows with some power of the speed of vibration"
    words: ClassVar[str] = "damping force in proportion to a power of the speed of vibration"
    usual: ClassVar[tuple[float, ...]] = (-2.0, -1.0, 0.0)
    tried: ClassVar[tuple[float, ...]] = (-0.5, 0.5, 1.0, 2.0)

    def axis(self) -> None:
        """In every direction alike."""


class AxisPowerDamping(AxisForce, DampingTerm):
    """2 sqrt(k̄ M) κ |{rate}| |κ {rate}|^p {rate} along {a}, p the power less two, k̄ the mean stiffness, M the mass."""

    name: ClassVar[str] = "term_power_damping_{a}"
    meaning: ClassVar[str] = "damping along {a} that grows with some power of the speed of vibration"
    words: ClassVar[str] = "damping force along {a} in proportion to a power of the speed of vibration"
    usual: ClassVar[tuple[float, ...]] = (-2.0, -1.0, 0.0)
    tried: ClassVar[tuple[float, ...]] = (-0.5, 0.5, 1.0, 2.0)


POWERS: dict[str, type[PowerSpring | PowerDamping]] = {cls.name: cls for cls in (PowerSpring, PowerDamping)}
"""Those that act in every direction: name -> class."""
OPENED: dict[str, tuple[type[PowerSpring | PowerDamping], float]] = {
    "duffing": (PowerSpring, 1.0),
    "quadratic_damping": (PowerDamping, 0.0),
}
"""Effects of the catalogue that grow with a power: the term in which that is open, and the power, less two."""


def with_power_open(effect: RestoringEffect, rotor: AbstractRotor) -> PowerSpring | PowerDamping:
    """The term that is the same force as an effect that grows with a power (one of `OPENED`)."""
    cls, power = OPENED[effect.name]
    moves = jnp.array([BALANCE_GRADE, 0.0])
    instant = Instant(rotor, jnp.asarray(1.0), jnp.asarray(0.0), moves, moves, moves)
    one, exponent = as_float(1.0), as_float(power)
    share = float(effect.force(instant)[0] / cls(one, exponent).force(instant)[0])
    return cls(as_float(math.copysign(abs(share) ** (1.0 / (1.0 + power)), share)), exponent)
