"""Simple force terms: what a force may look like that no named effect of the catalogue explains.

Most act along x or along y only (two of those that grow with a power, `rotorjax.effects.power_terms`, in every
direction), and each is an effect like any other: ``explain(..., catalog=CATALOG | TERMS)``. Restoring terms resist, on
the left-hand side beside K q, and depend on the motion of the disk in space; steady and pulsating ones push, on the
right-hand side, like unbalance.
"""

from types import MappingProxyType
from typing import ClassVar

import jax
import jax.numpy as jnp
from jax import Array

from rotorjax.effects import CATALOG
from rotorjax.effects.delayed_force import DelayedForce
from rotorjax.effects.healthy_rotor import HEALTHY
from rotorjax.effects.power_terms import AxisPowerDamping, AxisPowerSpring, PowerDamping, PowerSpring
from rotorjax.effects.restoring import AROUND, GAP_SHARES, ONCE_AND_TWICE, STICTION_SPEED, beyond_gap, pull_objection
from rotorjax.effects.term import AxisForce, Term
from rotorjax.model.contract import (
    AbstractRotor,
    Effect,
    Excitation,
    ExcitationEffect,
    Family,
    Instant,
    OperatingPoint,
    Plan,
    RestoringEffect,
)
from rotorjax.model.parameters import parameter

TWICE = ONCE_AND_TWICE._replace(orders=(0.0, 1.0, 2.0, 3.0))
"""With the mean, where a constant force acts, and 3X, where a pulsating stiffness does."""
LEAST_LENGTH = 1e-15
"""Smooths |x| at zero [m], and |v| [m/s]."""


def size(value: Array) -> Array:
    """|x|, with a slope at zero too."""
    return jnp.sqrt(value**2 + LEAST_LENGTH**2)


class Cubic(AxisForce, RestoringEffect):
    """k {a}³ along {a}: stiffens with amplitude (softens where k < 0)."""

    name: ClassVar[str] = "term_cubic_{a}"
    family: ClassVar[Family] = "restoring"
    meaning: ClassVar[str] = "a spring along {a} that stiffens with the cube of displacement (softens where negative)"
    words: ClassVar[str] = "cubic in {a}"
    source: ClassVar[str] = "Nayfeh, Mook, Nonlinear Oscillations, Wiley 1979, section 4.1"
    relatives: ClassVar[tuple[str, ...]] = ("duffing", "stiffness_error")
    sufficient: ClassVar[Plan] = AROUND
    alike: ClassVar[tuple[str, ...]] = ("term_square_{a}", "term_unsymmetrical_{a}")
    cubic_n_per_m3: Array = parameter("cubic stiffness k", scale=1e-3, of="cubic")
    starts: ClassVar[tuple[dict[str, float], ...]] = ({}, {"cubic_n_per_m3": 0.3}, {"cubic_n_per_m3": -0.3})

    def force(self, instant: Instant) -> Array:
        return self.placed(self.cubic_n_per_m3 * instant.position[self.axis()] ** 3)


class Square(AxisForce, RestoringEffect):
    """k̄ κ |{a}| {a} along {a}, k̄ the mean stiffness: the stiffness grows in proportion to the size of displacement."""

    name: ClassVar[str] = "term_square_{a}"
    family: ClassVar[Family] = "restoring"
    meaning: ClassVar[str] = "a spring along {a} whose force grows with the square of displacement, on either side"
    words: ClassVar[str] = "growing with the square of {a}, on either side"
    source: ClassVar[str] = "Nayfeh, Mook, Nonlinear Oscillations, Wiley 1979, section 2.3"
    relatives: ClassVar[tuple[str, ...]] = ("duffing", "clearance")
    sufficient: ClassVar[Plan] = AROUND
    alike: ClassVar[tuple[str, ...]] = ("term_cubic_{a}", "term_unsymmetrical_{a}")
    growth_per_m: Array = parameter(
        "growth of stiffness κ with displacement, relative to the mean stiffness", scale=0.03, of="curvature"
    )
    starts: ClassVar[tuple[dict[str, float], ...]] = ({}, {"growth_per_m": 0.3}, {"growth_per_m": -0.3})

    def force(self, instant: Instant) -> Array:
        at = instant.position[self.axis()]
        return self.placed(jnp.mean(instant.rotor.stiffness) * self.growth_per_m * size(at) * at)


class DeadBand(AxisForce, RestoringEffect):
    """k sign({a}) max(|{a}| - gap, 0) along {a}: a stop on either side at the end of a gap."""

    name: ClassVar[str] = "term_dead_band_{a}"
    family: ClassVar[Family] = "restoring"
    meaning: ClassVar[str] = "a stop along {a} on either side, reached at the end of a gap"
    words: ClassVar[str] = "two-sided stop along {a}"
    source: ClassVar[str] = (
        "Nayfeh, Mook, Nonlinear Oscillations, Wiley 1979, section 2.3; Ehrich, Handbook of Rotordynamics, 1992, "
        "section 1.8"
    )
    relatives: ClassVar[tuple[str, ...]] = ("clearance", "rub", "duffing")
    sufficient: ClassVar[Plan] = AROUND
    stiffness_n_per_m: Array = parameter("stiffness k of the stop", scale=1.0, of="stiffness")
    inverse_gap_per_m: Array = parameter("one over the gap", scale=0.2, of="curvature", shape_only=True)
    alike: ClassVar[tuple[str, ...]] = ("term_one_sided_stop_{a}",)
    starts: ClassVar[tuple[dict[str, float], ...]] = tuple(
        {"stiffness_n_per_m": 0.1, "inverse_gap_per_m": 1.0 / share} for share in GAP_SHARES
    )
    over_amplitude: ClassVar[tuple[str, ...]] = ("inverse_gap_per_m",)

    def objection(self, rotor: AbstractRotor) -> str | None:
        return pull_objection(self.stiffness_n_per_m)

    def force(self, instant: Instant) -> Array:
        at = instant.position[self.axis()]
        return self.placed(self.stiffness_n_per_m * jnp.sign(at) * beyond_gap(jnp.abs(at), self.inverse_gap_per_m))


class OneSidedStop(AxisForce, RestoringEffect):
    """k max({a} - gap, 0) along {a}, or k min({a} - gap, 0) for a negative gap: a stop on one side, with nothing
    opposite.
    """

    name: ClassVar[str] = "term_one_sided_stop_{a}"
    family: ClassVar[Family] = "restoring"
    meaning: ClassVar[str] = (
        "a stop along {a} on one side only, reached at the end of a gap: a partial rub without friction"
    )
    words: ClassVar[str] = "stop on one side along {a}"
    source: ClassVar[str] = (
        "Ehrich, Handbook of Rotordynamics, 1992, section 1.8; Muszynska, Rotordynamics, 2005, chapter 5"
    )
    relatives: ClassVar[tuple[str, ...]] = ("clearance", "rub")
    sufficient: ClassVar[Plan] = AROUND
    alike: ClassVar[tuple[str, ...]] = ("term_dead_band_{a}",)
    stiffness_n_per_m: Array = parameter("stiffness k of the stop", scale=1.0, of="stiffness")
    inverse_gap_per_m: Array = parameter(
        "one over the gap, negative where the stop is on the negative side",
        scale=0.2,
        of="curvature",
        shape_only=True,
    )
    starts: ClassVar[tuple[dict[str, float], ...]] = tuple(
        {"stiffness_n_per_m": 0.1, "inverse_gap_per_m": side / share} for share in GAP_SHARES for side in (1.0, -1.0)
    )
    over_amplitude: ClassVar[tuple[str, ...]] = ("inverse_gap_per_m",)
    sides: ClassVar[tuple[float, ...]] = (1.0, -1.0)
    reached: ClassVar[str] = "at"

    def objection(self, rotor: AbstractRotor) -> str | None:
        return pull_objection(self.stiffness_n_per_m)

    def force(self, instant: Instant) -> Array:
        return self.placed(self.stiffness_n_per_m * beyond_gap(instant.position[self.axis()], self.inverse_gap_per_m))


class Unsymmetrical(AxisForce, RestoringEffect):
    """k̄ κ {a}² along {a}, k̄ the mean stiffness: stiffer on one side than on the other."""

    name: ClassVar[str] = "term_unsymmetrical_{a}"
    family: ClassVar[Family] = "restoring"
    meaning: ClassVar[str] = (
        "a spring along {a} that is stiffer on one side than on the other, by the square of displacement"
    )
    words: ClassVar[str] = "square of {a}, stiffer on one side"
    source: ClassVar[str] = "Ishida, Yamamoto, Linear and Nonlinear Rotordynamics, 2nd edition, 2012, section 6.2"
    relatives: ClassVar[tuple[str, ...]] = ("duffing", "stiffness_error")
    sufficient: ClassVar[Plan] = TWICE
    alike: ClassVar[tuple[str, ...]] = ("term_cubic_{a}",)
    growth_per_m: Array = parameter(
        "growth of stiffness κ with displacement to one side, relative to the mean stiffness",
        scale=0.03,
        of="curvature",
    )
    # At 1X it acts by its square only, so that nothing leads away from zero.
    starts: ClassVar[tuple[dict[str, float], ...]] = (
        {},
        *({"growth_per_m": side * share} for share in (0.1, 0.3, 1.0) for side in (1.0, -1.0)),
    )
    over_amplitude: ClassVar[tuple[str, ...]] = ("growth_per_m",)

    def force(self, instant: Instant) -> Array:
        return self.placed(jnp.mean(instant.rotor.stiffness) * self.growth_per_m * instant.position[self.axis()] ** 2)


class AxisQuadraticDamping(AxisForce, RestoringEffect):
    """c |{rate}| {rate} along {a}."""

    name: ClassVar[str] = "term_quadratic_damping_{a}"
    family: ClassVar[Family] = "restoring"
    meaning: ClassVar[str] = "drag along {a} that grows with the square of velocity"
    words: ClassVar[str] = "quadratic damping along {a}"
    source: ClassVar[str] = "Rao, Mechanical Vibrations, 5th edition, 2011, section 3.10"
    relatives: ClassVar[tuple[str, ...]] = ("quadratic_damping", "damping_error")
    sufficient: ClassVar[Plan] = AROUND
    damping_n_s2_per_m2: Array = parameter("drag c", scale=0.3, of="drag")

    def force(self, instant: Instant) -> Array:
        rate = instant.velocity[self.axis()]
        return self.placed(self.damping_n_s2_per_m2 * size(rate) * rate)


class AxisDryFriction(AxisForce, RestoringEffect):
    """F {rate}/sqrt({rate}² + v²) along {a}, v = 6.3e-5 m/s: dry friction, its change of sign spread over a small
    speed.
    """

    name: ClassVar[str] = "term_dry_friction_{a}"
    family: ClassVar[Family] = "restoring"
    meaning: ClassVar[str] = "dry friction along {a}: the smaller the vibration, the more it damps"
    words: ClassVar[str] = "dry friction along {a}"
    source: ClassVar[str] = (
        "Rao, Mechanical Vibrations, 5th edition, 2011, section 3.9; Andersson et al. 2007, Tribol. Int. 40:580-587"
    )
    relatives: ClassVar[tuple[str, ...]] = ("coulomb_friction", "damping_error")
    sufficient: ClassVar[Plan] = AROUND
    force_n: Array = parameter("friction force F", scale=0.2, of="force")

    def force(self, instant: Instant) -> Array:
        rate = instant.velocity[self.axis()]
        return self.placed(self.force_n * rate / jnp.sqrt(rate**2 + STICTION_SPEED**2))


class TurningStiffness(AxisForce, RestoringEffect):
    """(a cos 2φ + b sin 2φ) {a} along {a}, φ the shaft angle."""

    name: ClassVar[str] = "term_turning_stiffness_{a}"
    family: ClassVar[Family] = "restoring"
    meaning: ClassVar[str] = "stiffness along {a} that pulsates twice per turn"
    words: ClassVar[str] = "stiffness along {a} that pulsates twice per turn"
    source: ClassVar[str] = (
        "Genta, Dynamics of Rotating Systems, Springer 2005, section 6.3; Nayfeh, Mook 1979, section 5.1"
    )
    relatives: ClassVar[tuple[str, ...]] = ("asymmetric_shaft", "crack")
    in_proportion: ClassVar[bool] = True
    sufficient: ClassVar[Plan] = TWICE
    cosine_n_per_m: Array = parameter("amplitude of the stiffness in phase with cos 2φ", scale=0.02, of="stiffness")
    sine_n_per_m: Array = parameter("amplitude in phase with sin 2φ", scale=0.02, of="stiffness")

    def force(self, instant: Instant) -> Array:
        twice = 2.0 * instant.angle
        pulse = self.cosine_n_per_m * jnp.cos(twice) + self.sine_n_per_m * jnp.sin(twice)
        return self.placed(pulse * instant.position[self.axis()])


class Steady(AxisForce, ExcitationEffect):
    """F_0 along {a}, constant."""

    name: ClassVar[str] = "term_steady_{a}"
    family: ClassVar[Family] = "excitation"
    meaning: ClassVar[str] = "a constant force along {a}: belt, gear mesh, wrong weight"
    words: ClassVar[str] = "constant along {a}"
    source: ClassVar[str] = "Ehrich, Handbook of Rotordynamics, 1992, section 1.8 (side loads)"
    relatives: ClassVar[tuple[str, ...]] = ("misalignment",)
    sufficient: ClassVar[Plan] = TWICE
    force_n: Array = parameter("constant force", scale=1.0, of="force")

    def excitation(self, point: OperatingPoint) -> Excitation:
        return Excitation(force=point.at_order(0.0) * self.placed(self.force_n) + 0j)


def _pulsating(share: Array, along: AxisForce, cosine: Array, sine: Array) -> Array:
    """The pair a - ib along an axis, times a share."""
    return jax.lax.complex(along.placed(share * cosine), -along.placed(share * sine))


class Pulsating(AxisForce, ExcitationEffect):
    """a cos φ + b sin φ along {a}, φ the shaft angle: F_1 = a - ib, its direction fixed in space."""

    name: ClassVar[str] = "term_pulsating_{a}"
    family: ClassVar[Family] = "excitation"
    meaning: ClassVar[str] = "a force along {a}, fixed in direction, that pulsates once per turn"
    words: ClassVar[str] = "constant direction along {a}, once per turn"
    source: ClassVar[str] = (
        "Ehrich, Handbook of Rotordynamics, 1992, section 1.8; Genta, Dynamics of Rotating Systems, 2005, section 2.3"
    )
    relatives: ClassVar[tuple[str, ...]] = ("residual_unbalance", "misalignment")
    sufficient: ClassVar[Plan] = Plan()
    cosine_n: Array = parameter("amplitude in phase with cos φ", scale=1.0, of="force")
    sine_n: Array = parameter("amplitude in phase with sin φ", scale=1.0, of="force")

    def excitation(self, point: OperatingPoint) -> Excitation:
        return Excitation(force=_pulsating(point.at_order(1.0), self, self.cosine_n, self.sine_n))


class PulsatingTwice(AxisForce, ExcitationEffect):
    """a cos 2φ + b sin 2φ along {a}: F_2 = a - ib."""

    name: ClassVar[str] = "term_pulsating_twice_{a}"
    family: ClassVar[Family] = "excitation"
    meaning: ClassVar[str] = "a force along {a}, fixed in direction, that pulsates twice per turn"
    words: ClassVar[str] = "constant direction along {a}, twice per turn"
    source: ClassVar[str] = "Gibbons, 5th Turbomachinery Symp. (1976) 111-116"
    relatives: ClassVar[tuple[str, ...]] = ("misalignment",)
    sufficient: ClassVar[Plan] = TWICE
    cosine_n: Array = parameter("amplitude in phase with cos 2φ", scale=1.0, of="force")
    sine_n: Array = parameter("amplitude in phase with sin 2φ", scale=1.0, of="force")

    def excitation(self, point: OperatingPoint) -> Excitation:
        return Excitation(force=_pulsating(point.at_order(2.0), self, self.cosine_n, self.sine_n))


def along(axis: int, shape: type[AxisForce]) -> type[AxisForce]:
    """The class of a shape along x (axis 0) or y (axis 1), with that axis in its name and texts."""

    def said(text: str) -> str:
        return text.format(a="xy"[axis], rate="ẋẏ"[axis])

    class Along(shape):
        __doc__ = said(shape.__doc__ or "")
        name: ClassVar[str] = said(shape.name)
        meaning: ClassVar[str] = said(shape.meaning)
        words: ClassVar[str] = said(shape.words)
        alike: ClassVar[tuple[str, ...]] = tuple(said(name) for name in shape.alike)

        def axis(self) -> int:
            return axis

    Along.__name__ = Along.__qualname__ = shape.__name__ + "XY"[axis]
    return Along


_SHAPES = (
    Cubic,
    Square,
    Unsymmetrical,
    DeadBand,
    OneSidedStop,
    AxisQuadraticDamping,
    AxisDryFriction,
    TurningStiffness,
    Steady,
    Pulsating,
    PulsatingTwice,
    AxisPowerSpring,
    AxisPowerDamping,
)
_CLASSES = tuple(along(axis, shape) for shape in _SHAPES for axis in (0, 1))
# Pickle finds a class by its name in the module.
globals().update({cls.__name__: cls for cls in _CLASSES})

TERMS: MappingProxyType[str, type[Term]] = MappingProxyType(
    {cls.name: cls for cls in (*_CLASSES, PowerSpring, PowerDamping, DelayedForce)}
)
"""Term name -> class. What the catalogue has radially (duffing, clearance, quadratic damping, friction) is not
repeated.
"""

NAMED: MappingProxyType[str, type[Effect]] = MappingProxyType({**CATALOG, **TERMS, **HEALTHY})
"""All that a rig file or a command may name: the catalogue, these terms, and how the healthy rotor differs."""
