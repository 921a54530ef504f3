"""Simple force terms along one axis: what a force may look like that no named effect of the catalogue explains.

Each acts along x or along y only, and is an effect like any other: ``explain(..., catalog=CATALOG | TERMS)``. Restoring
terms resist, on the left-hand side beside K q, and depend on the motion of the disk in space; steady and pulsating ones
push, on the right-hand side, like unbalance.
"""

import abc
import math
from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import ClassVar, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from rotorjax.effects.restoring import GAP_SHARES, STICTION_SPEED, beyond_gap
from rotorjax.model import (
    AbstractRotor,
    Effect,
    Excitation,
    ExcitationEffect,
    Family,
    Instant,
    MatrixEffect,
    OperatingPoint,
    Plan,
    ReadingEffect,
    RestoringEffect,
    SpeedEffect,
    SupportEffect,
    parameter,
)

AROUND = Plan(runs=3, speeds=(0.7, 0.85, 0.95, 1.05, 1.2, 1.4))
"""Forces that depend on amplitude need several, on both sides of the resonance."""
TWICE = Plan(orders=(0.0, 1.0, 2.0, 3.0), speeds=(0.35, 0.5, 0.7, 0.9, 1.1, 1.4))
LEAST_LENGTH = 1e-15
"""Smooths |x| at zero [m], and |v| [m/s]."""


def size(value: Array) -> Array:
    """|x|, with a slope at zero too."""
    return jnp.sqrt(value**2 + LEAST_LENGTH**2)


class AxisForce(RestoringEffect):
    """A force along one axis that depends on displacement and velocity along it and on the shaft angle."""

    @abc.abstractmethod
    def axis(self) -> int:
        """0 for x, 1 for y."""

    def placed(self, value: Array) -> Array:
        """The pair that has this value along the axis."""
        return jnp.stack([value, jnp.zeros_like(value)] if self.axis() == 0 else [jnp.zeros_like(value), value])


class AxisPush(ExcitationEffect):
    """A force along one axis that depends on the shaft angle only."""

    @abc.abstractmethod
    def axis(self) -> int:
        """0 for x, 1 for y."""

    def placed(self, value: Array) -> Array:
        """The pair that has this value along the axis."""
        return jnp.stack([value, jnp.zeros_like(value)] if self.axis() == 0 else [jnp.zeros_like(value), value])


class Cubic(AxisForce):
    """k x³ along one axis: stiffens with amplitude (softens where k < 0)."""

    family: ClassVar[Family] = "restoring"
    source: ClassVar[str] = "Nayfeh, Mook, Nonlinear Oscillations, Wiley 1979, section 4.1"
    relatives: ClassVar[tuple[str, ...]] = ("duffing", "stiffness_error")
    sufficient: ClassVar[Plan] = AROUND
    cubic_n_per_m3: Array = parameter("cubic stiffness k", scale=1e-3, of="cubic")
    starts: ClassVar[tuple[dict[str, float], ...]] = ({}, {"cubic_n_per_m3": 0.3}, {"cubic_n_per_m3": -0.3})

    def force(self, instant: Instant) -> Array:
        return self.placed(self.cubic_n_per_m3 * instant.position[self.axis()] ** 3)


class CubicX(Cubic):
    """k x³ along x."""

    name: ClassVar[str] = "term_cubic_x"
    meaning: ClassVar[str] = "a spring along x that stiffens with the cube of displacement (softens where negative)"

    def axis(self) -> int:
        return 0


class CubicY(Cubic):
    """k y³ along y."""

    name: ClassVar[str] = "term_cubic_y"
    meaning: ClassVar[str] = "a spring along y that stiffens with the cube of displacement (softens where negative)"

    def axis(self) -> int:
        return 1


class Square(AxisForce):
    """k̄ κ |x| x along one axis, k̄ the mean stiffness: the stiffness grows in proportion to the size of displacement."""

    family: ClassVar[Family] = "restoring"
    source: ClassVar[str] = "Nayfeh, Mook, Nonlinear Oscillations, Wiley 1979, section 2.3"
    relatives: ClassVar[tuple[str, ...]] = ("duffing", "clearance")
    sufficient: ClassVar[Plan] = AROUND
    growth_per_m: Array = parameter("growth of stiffness κ with displacement, relative to the mean stiffness", scale=0.03, of="curvature")
    starts: ClassVar[tuple[dict[str, float], ...]] = ({}, {"growth_per_m": 0.3}, {"growth_per_m": -0.3})

    def force(self, instant: Instant) -> Array:
        at = instant.position[self.axis()]
        return self.placed(jnp.mean(instant.rotor.stiffness) * self.growth_per_m * size(at) * at)


class SquareX(Square):
    """k̄ κ |x| x along x."""

    name: ClassVar[str] = "term_square_x"
    meaning: ClassVar[str] = "a spring along x whose force grows with the square of displacement, on either side"

    def axis(self) -> int:
        return 0


class SquareY(Square):
    """k̄ κ |y| y along y."""

    name: ClassVar[str] = "term_square_y"
    meaning: ClassVar[str] = "a spring along y whose force grows with the square of displacement, on either side"

    def axis(self) -> int:
        return 1


class DeadBand(AxisForce):
    """k sign(x) max(|x| - gap, 0) along one axis: a stop on either side at the end of a gap."""

    family: ClassVar[Family] = "restoring"
    source: ClassVar[str] = "Nayfeh, Mook, Nonlinear Oscillations, Wiley 1979, section 2.3; Ehrich, Handbook of Rotordynamics, 1992, section 1.8"
    relatives: ClassVar[tuple[str, ...]] = ("clearance", "rub", "duffing")
    sufficient: ClassVar[Plan] = AROUND
    stiffness_n_per_m: Array = parameter("stiffness k of the stop", scale=1.0, of="stiffness")
    inverse_gap_per_m: Array = parameter("one over the gap", scale=0.2, of="curvature")
    starts: ClassVar[tuple[dict[str, float], ...]] = tuple({"stiffness_n_per_m": 0.1, "inverse_gap_per_m": 1.0 / share} for share in GAP_SHARES)
    over_amplitude: ClassVar[tuple[str, ...]] = ("inverse_gap_per_m",)

    def force(self, instant: Instant) -> Array:
        at = instant.position[self.axis()]
        return self.placed(self.stiffness_n_per_m * jnp.sign(at) * beyond_gap(jnp.abs(at), self.inverse_gap_per_m))


class DeadBandX(DeadBand):
    """k sign(x) max(|x| - gap, 0) along x."""

    name: ClassVar[str] = "term_dead_band_x"
    meaning: ClassVar[str] = "a stop along x on either side, reached at the end of a gap"

    def axis(self) -> int:
        return 0


class DeadBandY(DeadBand):
    """k sign(y) max(|y| - gap, 0) along y."""

    name: ClassVar[str] = "term_dead_band_y"
    meaning: ClassVar[str] = "a stop along y on either side, reached at the end of a gap"

    def axis(self) -> int:
        return 1


class AxisQuadraticDamping(AxisForce):
    """c |ẋ| ẋ along one axis."""

    family: ClassVar[Family] = "restoring"
    source: ClassVar[str] = "Rao, Mechanical Vibrations, 5th edition, 2011, section 3.10"
    relatives: ClassVar[tuple[str, ...]] = ("quadratic_damping", "damping_error")
    sufficient: ClassVar[Plan] = AROUND
    damping_n_s2_per_m2: Array = parameter("drag c", scale=0.3, of="drag")

    def force(self, instant: Instant) -> Array:
        rate = instant.velocity[self.axis()]
        return self.placed(self.damping_n_s2_per_m2 * size(rate) * rate)


class AxisQuadraticDampingX(AxisQuadraticDamping):
    """c |ẋ| ẋ along x."""

    name: ClassVar[str] = "term_quadratic_damping_x"
    meaning: ClassVar[str] = "drag along x that grows with the square of velocity"

    def axis(self) -> int:
        return 0


class AxisQuadraticDampingY(AxisQuadraticDamping):
    """c |ẏ| ẏ along y."""

    name: ClassVar[str] = "term_quadratic_damping_y"
    meaning: ClassVar[str] = "drag along y that grows with the square of velocity"

    def axis(self) -> int:
        return 1


class AxisDryFriction(AxisForce):
    """F ẋ/sqrt(ẋ² + v²) along one axis, v = 6.3e-5 m/s: dry friction, its change of sign spread over a small speed."""

    family: ClassVar[Family] = "restoring"
    source: ClassVar[str] = "Rao, Mechanical Vibrations, 5th edition, 2011, section 3.9; Andersson et al. 2007, Tribol. Int. 40:580-587"
    relatives: ClassVar[tuple[str, ...]] = ("coulomb_friction", "damping_error")
    sufficient: ClassVar[Plan] = AROUND
    force_n: Array = parameter("friction force F", scale=1.0, of="damping_force")

    def force(self, instant: Instant) -> Array:
        rate = instant.velocity[self.axis()]
        return self.placed(self.force_n * rate / jnp.sqrt(rate**2 + STICTION_SPEED**2))


class AxisDryFrictionX(AxisDryFriction):
    """F ẋ/sqrt(ẋ² + v²) along x, v = 6.3e-5 m/s."""

    name: ClassVar[str] = "term_dry_friction_x"
    meaning: ClassVar[str] = "dry friction along x: the smaller the vibration, the more it damps"

    def axis(self) -> int:
        return 0


class AxisDryFrictionY(AxisDryFriction):
    """F ẏ/sqrt(ẏ² + v²) along y, v = 6.3e-5 m/s."""

    name: ClassVar[str] = "term_dry_friction_y"
    meaning: ClassVar[str] = "dry friction along y: the smaller the vibration, the more it damps"

    def axis(self) -> int:
        return 1


class TurningStiffness(AxisForce):
    """(a cos 2φ + b sin 2φ) x along one axis, φ the shaft angle."""

    family: ClassVar[Family] = "restoring"
    source: ClassVar[str] = "Genta, Dynamics of Rotating Systems, Springer 2005, section 6.3; Nayfeh, Mook 1979, section 5.1"
    relatives: ClassVar[tuple[str, ...]] = ("asymmetric_shaft", "crack")
    sufficient: ClassVar[Plan] = TWICE
    cosine_n_per_m: Array = parameter("amplitude of the stiffness in phase with cos 2φ", scale=0.02, of="stiffness")
    sine_n_per_m: Array = parameter("amplitude in phase with sin 2φ", scale=0.02, of="stiffness")

    def force(self, instant: Instant) -> Array:
        twice = 2.0 * instant.angle
        pulse = self.cosine_n_per_m * jnp.cos(twice) + self.sine_n_per_m * jnp.sin(twice)
        return self.placed(pulse * instant.position[self.axis()])


class TurningStiffnessX(TurningStiffness):
    """(a cos 2φ + b sin 2φ) x along x."""

    name: ClassVar[str] = "term_turning_stiffness_x"
    meaning: ClassVar[str] = "stiffness along x that pulsates twice per turn"

    def axis(self) -> int:
        return 0


class TurningStiffnessY(TurningStiffness):
    """(a cos 2φ + b sin 2φ) y along y."""

    name: ClassVar[str] = "term_turning_stiffness_y"
    meaning: ClassVar[str] = "stiffness along y that pulsates twice per turn"

    def axis(self) -> int:
        return 1


class Steady(AxisPush):
    """F_0 along one axis, constant."""

    family: ClassVar[Family] = "excitation"
    source: ClassVar[str] = "Ehrich, Handbook of Rotordynamics, 1992, section 1.8 (side loads)"
    relatives: ClassVar[tuple[str, ...]] = ("misalignment",)
    sufficient: ClassVar[Plan] = TWICE
    force_n: Array = parameter("constant force", scale=1.0, of="force")

    def excitation(self, point: OperatingPoint) -> Excitation:
        return Excitation(force=point.at_order(0.0) * self.placed(self.force_n) + 0j)


class SteadyX(Steady):
    """F_0 along x."""

    name: ClassVar[str] = "term_steady_x"
    meaning: ClassVar[str] = "a constant force along x: belt, gear mesh, wrong weight"

    def axis(self) -> int:
        return 0


class SteadyY(Steady):
    """F_0 along y."""

    name: ClassVar[str] = "term_steady_y"
    meaning: ClassVar[str] = "a constant force along y: belt, gear mesh, wrong weight"

    def axis(self) -> int:
        return 1


class Pulsating(AxisPush):
    """a cos φ + b sin φ along one axis, φ the shaft angle: F_1 = a - ib, its direction fixed in space."""

    family: ClassVar[Family] = "excitation"
    source: ClassVar[str] = "Ehrich, Handbook of Rotordynamics, 1992, section 1.8; Genta, Dynamics of Rotating Systems, 2005, section 2.3"
    relatives: ClassVar[tuple[str, ...]] = ("residual_unbalance", "misalignment")
    sufficient: ClassVar[Plan] = Plan()
    cosine_n: Array = parameter("amplitude in phase with cos φ", scale=1.0, of="force")
    sine_n: Array = parameter("amplitude in phase with sin φ", scale=1.0, of="force")

    def excitation(self, point: OperatingPoint) -> Excitation:
        amplitude = self.placed(self.cosine_n) - 1j * self.placed(self.sine_n)
        return Excitation(force=point.at_order(1.0) * amplitude)


class PulsatingX(Pulsating):
    """a cos φ + b sin φ along x."""

    name: ClassVar[str] = "term_pulsating_x"
    meaning: ClassVar[str] = "a force along x, fixed in direction, that pulsates once per turn"

    def axis(self) -> int:
        return 0


class PulsatingY(Pulsating):
    """a cos φ + b sin φ along y."""

    name: ClassVar[str] = "term_pulsating_y"
    meaning: ClassVar[str] = "a force along y, fixed in direction, that pulsates once per turn"

    def axis(self) -> int:
        return 1


class PulsatingTwice(AxisPush):
    """a cos 2φ + b sin 2φ along one axis: F_2 = a - ib."""

    family: ClassVar[Family] = "excitation"
    source: ClassVar[str] = "Gibbons, 5th Turbomachinery Symp. (1976) 111-116"
    relatives: ClassVar[tuple[str, ...]] = ("misalignment",)
    sufficient: ClassVar[Plan] = TWICE
    cosine_n: Array = parameter("amplitude in phase with cos 2φ", scale=1.0, of="force")
    sine_n: Array = parameter("amplitude in phase with sin 2φ", scale=1.0, of="force")

    def excitation(self, point: OperatingPoint) -> Excitation:
        amplitude = self.placed(self.cosine_n) - 1j * self.placed(self.sine_n)
        return Excitation(force=point.at_order(2.0) * amplitude)


class PulsatingTwiceX(PulsatingTwice):
    """a cos 2φ + b sin 2φ along x."""

    name: ClassVar[str] = "term_pulsating_twice_x"
    meaning: ClassVar[str] = "a force along x, fixed in direction, that pulsates twice per turn"

    def axis(self) -> int:
        return 0


class PulsatingTwiceY(PulsatingTwice):
    """a cos 2φ + b sin 2φ along y."""

    name: ClassVar[str] = "term_pulsating_twice_y"
    meaning: ClassVar[str] = "a force along y, fixed in direction, that pulsates twice per turn"

    def axis(self) -> int:
        return 1


_CLASSES: tuple[type[Effect], ...] = (
    CubicX,
    CubicY,
    SquareX,
    SquareY,
    DeadBandX,
    DeadBandY,
    AxisQuadraticDampingX,
    AxisQuadraticDampingY,
    AxisDryFrictionX,
    AxisDryFrictionY,
    TurningStiffnessX,
    TurningStiffnessY,
    SteadyX,
    SteadyY,
    PulsatingX,
    PulsatingY,
    PulsatingTwiceX,
    PulsatingTwiceY,
)

TERMS: MappingProxyType[str, type[Effect]] = MappingProxyType({cls.name: cls for cls in _CLASSES})
"""Term name -> class. What the catalogue has radially (duffing, clearance, quadratic damping, friction) is not repeated."""

GAPS = tuple(float(share) for share in np.linspace(0.2, 0.95, 12))
"""Gaps to try, in the largest displacement."""
CRACK_ANGLES = 12
RUB_FRICTION = 0.2
STEP = 1e-2
"""In prior scales: size at which a force is taken that is, or nearly, linear in its parameters."""
BY_AXIS = ("stiffness_error", "damping_error", "speed_dependent_stiffness")
"""Effects whose axes are tried one by one."""

_WORDS = {
    "term_cubic": "cubic in {a}",
    "term_square": "growing with the square of {a}, on either side",
    "term_dead_band": "dead band along {a}",
    "term_quadratic_damping": "quadratic damping along {a}",
    "term_dry_friction": "dry friction along {a}",
    "term_turning_stiffness": "stiffness along {a} that pulsates twice per turn",
    "term_steady": "constant along {a}",
    "term_pulsating": "constant direction along {a}, once per turn",
    "term_pulsating_twice": "constant direction along {a}, twice per turn",
}


class Reach(NamedTuple):
    """Largest displacement along x, along y and radially [m]."""

    x: float
    y: float
    radius: float


class Shape(NamedTuple):
    """A force up to a few factors: parameters that are held, and what each factor multiplies."""

    term: str
    held: dict[str, float]
    factors: tuple[dict[str, float], ...]
    positive: bool = False
    """Whether the factors must be."""
    gap: str | None = None
    """The held parameter that is one over a gap."""

    @property
    def unknowns(self) -> int:
        """Factors, and the gap."""
        return len(self.factors) + (self.gap is not None)

    @property
    def plain(self) -> str:
        """What people call it, without the gap."""
        stem, _, axis = self.term.rpartition("_")
        words = _WORDS[stem].format(a=axis) if stem in _WORDS else self.term.replace("_", " ")
        keys = [key for factor in self.factors for key in factor]
        if len(keys) == 1 and keys[0][-2:] in {"_x", "_y"}:
            words = f"{words.removesuffix(' error')} along {keys[0][-1]}"
        return words

    @property
    def words(self) -> str:
        """What people call it, with the gap."""
        if self.gap is None:
            return self.plain
        return f"{self.plain} {'of' if self.term in TERMS else 'beyond'} {1e3 / self.held[self.gap]:.2g} mm"


def shapes(catalog: Mapping[str, type[Effect]], rotor: AbstractRotor, reach: Reach) -> Iterator[Shape]:
    """Forces to try: effects that enter linearly, one axis at a time where the axes are apart, and a scan of gaps and crack angles."""
    for name, cls in catalog.items():
        hooks = issubclass(cls, ExcitationEffect | MatrixEffect | RestoringEffect)
        if not hooks or issubclass(cls, SupportEffect | SpeedEffect | ReadingEffect) or any(p.axes for p in cls.parameters()):
            continue
        scale = {p.name: STEP * p.prior_scale(rotor) for p in cls.parameters()}
        if cls.over_amplitude:
            yield from (beyond(cls, rotor, reach, share) for share in GAPS)
        elif name == "crack":
            for angle in 2.0 * math.pi * np.arange(CRACK_ANGLES) / CRACK_ANGLES:
                pair = zip(scale.items(), (math.cos(angle), math.sin(angle)), strict=True)
                yield Shape(name, {}, ({key: size * part for (key, size), part in pair},), positive=True)
        elif name in BY_AXIS:
            yield from (Shape(name, {}, ({key: size},)) for key, size in scale.items())
        else:
            yield Shape(name, {}, tuple({key: size} for key, size in scale.items()))


def beyond(cls: type[Effect], rotor: AbstractRotor, reach: Reach, share: float) -> Shape:
    """A force beyond a gap that is this share of the largest displacement, along the term's axis or radially."""
    largest = reach[cls().axis()] if issubclass(cls, AxisForce) else reach.radius
    gap = cls.over_amplitude[0]
    held = {gap: 1.0 / (share * largest)} | ({"friction": RUB_FRICTION} if cls.name == "rub" else {})
    free = {p.name: STEP * p.prior_scale(rotor) for p in cls.parameters() if p.name not in held}
    return Shape(cls.name, held, tuple({key: size} for key, size in free.items()), positive=True, gap=gap)
