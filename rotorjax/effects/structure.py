"""What the rotor and its support do differently from the nominal rotor."""

from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from rotorjax.arrays import diagonal
from rotorjax.model.conditions import Layout
from rotorjax.model.contract import (
    AbstractRotor,
    Family,
    Matrices,
    MatrixEffect,
    OperatingPoint,
    Support,
    SupportEffect,
)
from rotorjax.model.parameters import Form, one_of, parameter

FOUNDATION_DAMPING_RATIO = 0.05
"""Damping ratio of a foundation whose ``log_damping`` is null: usual for bolted steel frames (Gasch et al.,
Rotordynamik, 2006).
"""


def alike_or_one(x: str, y: str) -> tuple[Form, ...]:
    """Forms of an effect along x and y: the same along both, or along one of them only."""
    return ({x: 1.0, y: 1.0},), *one_of([x, y])


def either_side(name: str) -> tuple[dict[str, float], ...]:
    """Starts at the null and a prior scale to either side: near a resonance the way from the null may be barred."""
    return ({}, {name: 1.0}, {name: -1.0})


def _with_speed_squared(point: OperatingPoint) -> Array:
    """(Ω/ω_ref)², ω_ref the mean natural frequency."""
    return (point.speed / point.rotor.natural_frequency()) ** 2


class StiffnessError(MatrixEffect):
    """k_i -> k_i (1 + e_i); C and M stay."""

    name: ClassVar[str] = "stiffness_error"
    family: ClassVar[Family] = "structure"
    meaning: ClassVar[str] = "shaft and bearings stiffer or softer than the rig file says, per axis"
    source: ClassVar[str] = "Genta, Dynamics of Rotating Systems, Springer 2005, section 2.2"
    relatives: ClassVar[tuple[str, ...]] = ("mass_error", "speed_error")
    error_x: Array = parameter("relative error along x", scale=0.05)
    error_y: Array = parameter("relative error along y", scale=0.05)

    @classmethod
    def forms(cls, layout: Layout, angles: Float[np.ndarray, "probe"]) -> tuple[Form, ...]:
        return alike_or_one("error_x", "error_y")

    def matrices(self, point: OperatingPoint) -> Matrices:
        return Matrices(path_stiffness=diagonal(jnp.stack([self.error_x, self.error_y]) * point.rotor.stiffness))

    def objection(self, rotor: AbstractRotor) -> str | None:
        return "makes a stiffness negative" if min(float(self.error_x), float(self.error_y)) <= -1.0 else None


class MassError(MatrixEffect):
    """M -> M (1 + e)."""

    name: ClassVar[str] = "mass_error"
    family: ClassVar[Family] = "structure"
    meaning: ClassVar[str] = "effective mass of disk and shaft differs from what is stated"
    source: ClassVar[str] = "Genta, Dynamics of Rotating Systems, Springer 2005, section 2.2"
    relatives: ClassVar[tuple[str, ...]] = ("stiffness_error", "gyroscopic", "speed_error")
    error: Array = parameter("relative error", scale=0.05)
    starts: ClassVar[tuple[dict[str, float], ...]] = either_side("error")

    def matrices(self, point: OperatingPoint) -> Matrices:
        return Matrices(mass=self.error * point.rotor.mass * jnp.eye(2))

    def objection(self, rotor: AbstractRotor) -> str | None:
        return "makes the mass negative" if float(self.error) <= -1.0 else None


class DampingError(MatrixEffect):
    """c_i -> c_i exp(e_i)."""

    name: ClassVar[str] = "damping_error"
    family: ClassVar[Family] = "structure"
    meaning: ClassVar[str] = "damping more or less than the rig file says, per axis"
    source: ClassVar[str] = "Genta, Dynamics of Rotating Systems, Springer 2005, section 2.3"
    relatives: ClassVar[tuple[str, ...]] = ("phase_reference_offset", "speed_dependent_damping")
    log_ratio_x: Array = parameter("natural logarithm of true over nominal, along x", scale=0.5)
    log_ratio_y: Array = parameter("natural logarithm of true over nominal, along y", scale=0.5)

    @classmethod
    def forms(cls, layout: Layout, angles: Float[np.ndarray, "probe"]) -> tuple[Form, ...]:
        return alike_or_one("log_ratio_x", "log_ratio_y")

    def matrices(self, point: OperatingPoint) -> Matrices:
        growth = jnp.expm1(jnp.stack([self.log_ratio_x, self.log_ratio_y]))
        return Matrices(path_damping=diagonal(growth * point.rotor.damping))

    def objection(self, rotor: AbstractRotor) -> str | None:
        true = np.asarray(rotor.damping) * np.exp([float(self.log_ratio_x), float(self.log_ratio_y)])
        ratio = true / (2.0 * np.sqrt(np.asarray(rotor.stiffness) * float(rotor.mass)))
        if not np.any(ratio > 1.0):
            return None
        axis = int(np.argmax(ratio))
        held = "friction, a stop or a stiff support would hold the rotor as well"
        return f"makes the damping along {'xy'[axis]} {ratio[axis]:.2g} times the critical one: {held}"


class StiffnessAxes(SupportEffect):
    """K -> R(β) K R(β)ᵀ, C -> R(γ) C R(γ)ᵀ, R the turn from x towards y: γ = 0 where the dampers stay, γ = β where the
    support is turned as a whole.
    """

    name: ClassVar[str] = "stiffness_axes"
    family: ClassVar[Family] = "structure"
    meaning: ClassVar[str] = "principal axes of the support, of stiffness and of damping, turned against x and y"
    source: ClassVar[str] = "Genta, Dynamics of Rotating Systems, Springer 2005, section 6.2"
    relatives: ClassVar[tuple[str, ...]] = ("probe_angle",)
    angle_rad: Array = parameter("turn of the stiffness β from x towards y", scale=0.2)
    damping_angle_rad: Array = parameter("turn of the damping γ from x towards y", scale=0.2)
    starts: ClassVar[tuple[dict[str, float], ...]] = ({}, {"angle_rad": 3.0}, {"angle_rad": -3.0})

    @classmethod
    def forms(cls, layout: Layout, angles: Float[np.ndarray, "probe"]) -> tuple[Form, ...]:
        return ({"angle_rad": 1.0},), ({"angle_rad": 1.0, "damping_angle_rad": 1.0},)

    def support(self, point: OperatingPoint) -> Support:
        return Support(turn=self.angle_rad, damping_turn=self.damping_angle_rad)


class CrossCoupling(MatrixEffect):
    """D += k J: a force across the motion, k > 0 drives forward whirl."""

    name: ClassVar[str] = "cross_coupling"
    family: ClassVar[Family] = "structure"
    meaning: ClassVar[str] = "seal, impeller or bearing force across the motion; drives forward whirl"
    source: ClassVar[str] = (
        "Alford, J. Eng. Power 87 (1965) 333-334; Childs, Turbomachinery Rotordynamics, Wiley 1993, chapter 1"
    )
    relatives: ClassVar[tuple[str, ...]] = ("damping_error", "internal_damping", "speed_dependent_cross_coupling")
    cross_stiffness_n_per_m: Array = parameter("cross-coupled stiffness k", scale=0.02, of="stiffness")
    starts: ClassVar[tuple[dict[str, float], ...]] = either_side("cross_stiffness_n_per_m")

    def matrices(self, point: OperatingPoint) -> Matrices:
        return Matrices(stiffness=self.cross_stiffness_n_per_m * point.whirl)


class SpeedDependentStiffness(MatrixEffect):
    """k_i -> k_i (1 + e_i Ω²/ω_ref²), ω_ref the mean natural frequency."""

    name: ClassVar[str] = "speed_dependent_stiffness"
    family: ClassVar[Family] = "structure"
    meaning: ClassVar[str] = "bearings or shaft stiffen with speed"
    source: ClassVar[str] = "Childs, Turbomachinery Rotordynamics, Wiley 1993, chapter 3"
    relatives: ClassVar[tuple[str, ...]] = ("mass_error", "gyroscopic")
    error_x: Array = parameter("relative growth along x at the natural frequency", scale=0.1)
    error_y: Array = parameter("relative growth along y at the natural frequency", scale=0.1)

    @classmethod
    def forms(cls, layout: Layout, angles: Float[np.ndarray, "probe"]) -> tuple[Form, ...]:
        return alike_or_one("error_x", "error_y")

    def matrices(self, point: OperatingPoint) -> Matrices:
        growth = _with_speed_squared(point)
        return Matrices(
            path_stiffness=growth * diagonal(jnp.stack([self.error_x, self.error_y]) * point.rotor.stiffness)
        )


class SpeedDependentDamping(MatrixEffect):
    """c_i -> c_i (1 + e (ω_ref/Ω - 1)), ω_ref the mean natural frequency: e = 1 is a loss factor, whose force at 1X is
    c_i ω_ref whatever the speed.
    """

    name: ClassVar[str] = "speed_dependent_damping"
    family: ClassVar[Family] = "structure"
    meaning: ClassVar[str] = "damping falls as speed rises: structural damping (a loss factor) at 1X, or a fluid film"
    source: ClassVar[str] = "Genta, Dynamics of Rotating Systems, Springer 2005, section 2.3: structural damping"
    relatives: ClassVar[tuple[str, ...]] = ("damping_error", "phase_reference_offset", "time_delay")
    share: Array = parameter("part of the damping at the natural frequency that falls with speed", scale=0.5)
    starts: ClassVar[tuple[dict[str, float], ...]] = either_side("share")

    def matrices(self, point: OperatingPoint) -> Matrices:
        growth = self.share * (point.rotor.natural_frequency() / point.speed - 1.0)
        return Matrices(path_damping=growth * diagonal(point.rotor.damping))


class SpeedDependentCrossCoupling(MatrixEffect):
    """D += k (Ω/ω_ref)² J, ω_ref the mean natural frequency: k grows with the pressure across a seal or impeller."""

    name: ClassVar[str] = "speed_dependent_cross_coupling"
    family: ClassVar[Family] = "structure"
    meaning: ClassVar[str] = "force across the motion that grows with the square of speed: seals and impellers of pumps"
    source: ClassVar[str] = "Childs, Turbomachinery Rotordynamics, Wiley 1993, chapter 4"
    relatives: ClassVar[tuple[str, ...]] = ("cross_coupling", "internal_damping", "damping_error")
    cross_stiffness_n_per_m: Array = parameter(
        "cross-coupled stiffness k at the natural frequency", scale=0.02, of="stiffness"
    )
    starts: ClassVar[tuple[dict[str, float], ...]] = either_side("cross_stiffness_n_per_m")

    def matrices(self, point: OperatingPoint) -> Matrices:
        growth = _with_speed_squared(point)
        return Matrices(stiffness=growth * self.cross_stiffness_n_per_m * point.whirl)


class InternalDamping(MatrixEffect):
    """D += c_r (iω I + Ω J): damping that turns with the shaft; nothing on a circular 1X orbit."""

    name: ClassVar[str] = "internal_damping"
    family: ClassVar[Family] = "structure"
    meaning: ClassVar[str] = (
        "damping that turns with the rotor: friction in shaft, fits or couplings, or a fluid film that turns along"
    )
    source: ClassVar[str] = (
        "Kimball, Gen. Electr. Rev. 27 (1924) 244-251; Genta, Dynamics of Rotating Systems, 2005, section 2.5"
    )
    relatives: ClassVar[tuple[str, ...]] = ("cross_coupling", "damping_error", "speed_dependent_cross_coupling")
    damping_n_s_per_m: Array = parameter("rotating damping c_r", scale=1.0, of="damping")
    starts: ClassVar[tuple[dict[str, float], ...]] = either_side("damping_n_s_per_m")

    def matrices(self, point: OperatingPoint) -> Matrices:
        turning = point.speed * self.damping_n_s_per_m * point.whirl
        return Matrices(damping=self.damping_n_s_per_m * jnp.eye(2), stiffness=turning)

    def objection(self, rotor: AbstractRotor) -> str | None:
        negative = float(self.damping_n_s_per_m) < 0.0
        return "would be negative, and damping that turns with the shaft is not" if negative else None


class Gyroscopic(MatrixEffect):
    """D += iωΩ g J: g = polar moment times the square of slope per deflection; g > 0 stiffens forward whirl."""

    name: ClassVar[str] = "gyroscopic"
    family: ClassVar[Family] = "structure"
    meaning: ClassVar[str] = "disk tilts as it whirls (off mid-span, overhung)"
    source: ClassVar[str] = "Genta, Dynamics of Rotating Systems, Springer 2005, section 2.6"
    relatives: ClassVar[tuple[str, ...]] = ("mass_error", "speed_dependent_stiffness")
    inertia_ratio_kg: Array = parameter("polar moment of inertia times (slope / deflection)²", scale=0.05, of="mass")
    starts: ClassVar[tuple[dict[str, float], ...]] = either_side("inertia_ratio_kg")

    def matrices(self, point: OperatingPoint) -> Matrices:
        return Matrices(damping=point.speed * self.inertia_ratio_kg * point.whirl)

    def objection(self, rotor: AbstractRotor) -> str | None:
        return "would be of a negative moment of inertia" if float(self.inertia_ratio_kg) < 0.0 else None


class Foundation(SupportEffect):
    """Per axis S -> (S⁻¹ + F⁻¹)⁻¹, S the stiffness of shaft and bearings, with F = k_f - ω²m_f + iωc_f, that is
    k_f (1 - ω²/ω_f² + 2iζ_f ω/ω_f).

    The damping of the rotor acts against the ground, not against the foundation.

    Parameters are 1/k_f, ln(ω_f/ω_n) and ln(ζ_f/0.05): two more degrees of freedom in time.
    """

    name: ClassVar[str] = "foundation"
    family: ClassVar[Family] = "structure"
    meaning: ClassVar[str] = "pedestal or frame gives way under the bearings, with a resonance of its own"
    source: ClassVar[str] = "Kirk, Gunter, J. Eng. Ind. 94 (1972) 221-232"
    relatives: ClassVar[tuple[str, ...]] = ("stiffness_error", "mass_error")
    compliance_m_per_n: Array = parameter("static compliance 1/k_f, equal along x and y", scale=0.1, of="compliance")
    log_frequency: Array = parameter("ln of foundation over rotor natural frequency", scale=0.7, shape_only=True)
    log_damping: Array = parameter("ln of foundation damping ratio over 0.05", scale=1.0, shape_only=True)
    starts: ClassVar[tuple[dict[str, float], ...]] = tuple(
        {"compliance_m_per_n": 0.3, "log_frequency": frequency} for frequency in (-1.5, -0.5, 0.0, 0.5, 1.5)
    )

    def support(self, point: OperatingPoint) -> Support:
        own = point.rotor.natural_frequency() * jnp.exp(self.log_frequency)
        ratio = point.frequency / own
        damping = FOUNDATION_DAMPING_RATIO * jnp.exp(self.log_damping)
        real, imaginary = 1.0 - ratio**2, 2.0 * damping * ratio
        each = self.compliance_m_per_n / (real**2 + imaginary**2)
        compliance = jax.lax.complex(each * real, -each * imaginary)
        return Support(compliance=jnp.stack([compliance, compliance]))

    def objection(self, rotor: AbstractRotor) -> str | None:
        return "has a negative stiffness" if float(self.compliance_m_per_n) < 0.0 else None
