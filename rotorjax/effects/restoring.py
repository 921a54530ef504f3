"""Nonlinear forces, stiffness that turns with the shaft, and a probe that saturates: what needs harmonic balance."""

import math
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
from jax import Array

from rotorjax.model.contract import BALANCE_GRADE, AbstractRotor, Family, Instant, Plan, RestoringEffect, WaveformEffect
from rotorjax.model.parameters import parameter
from rotorjax.units import MICROMETRE

AROUND = Plan(runs=3, speeds=(0.7, 0.85, 0.95, 1.05, 1.2, 1.4))
"""Forces that depend on amplitude need several amplitudes, on both sides of the resonance."""
ONCE_AND_TWICE = Plan(orders=(1.0, 2.0), speeds=(0.35, 0.5, 0.7, 0.9, 1.1, 1.4))
"""What turns with the shaft shows once and twice per turn, twice most of all at half the natural frequency."""
STICTION_SPEED = 0.01 * BALANCE_GRADE
"""Speed over which Coulomb friction changes its sign [m/s]: a hundredth of a speed of vibration that is usual."""
TINY = 1e-15
"""Length [m] below which a radius has no direction."""
GAP_SHARES = (0.3, 0.6, 0.9)
"""Gaps to begin with, in the largest displacement measured."""


def length(pair: Array, smallest: float = TINY) -> Array:
    """sqrt(x² + y²), with a slope at zero too."""
    return jnp.sqrt(pair[0] ** 2 + pair[1] ** 2 + smallest**2)


def beyond_gap(radius: Array, inverse_gap: Array) -> Array:
    """max(r - gap, 0), infinite the gap whose inverse is zero; of a place x on an axis and a negative gap min(x - gap,
    0).
    """
    touching = inverse_gap * radius > 1.0
    return jnp.where(touching, radius - 1.0 / jnp.where(touching, inverse_gap, 1.0), 0.0)


def pressed(instant: Instant, stiffness: Array, inverse_gap: Array) -> Array:
    """k max(r - gap, 0)/r: the force that presses beyond a gap, over the radius."""
    radius = length(instant.position)
    return stiffness * beyond_gap(radius, inverse_gap) / radius


def pull_objection(stiffness: Array) -> str | None:
    """What speaks against the stiffness of a stop."""
    return "has a negative stiffness: a stop that pulls" if float(stiffness) < 0.0 else None


def drive_objection(friction: Array) -> str | None:
    """What speaks against a coefficient or a force of friction."""
    return "has a negative friction: one that drives" if float(friction) < 0.0 else None


def stop_remark(rotor: AbstractRotor, stiffness: Array, inverse_gap: Array) -> str | None:
    """Whether the rotor at rest lies in a stop."""
    sag = float(rotor.mass) * math.hypot(*(np.asarray(rotor.gravity) / np.asarray(rotor.stiffness)))
    if float(stiffness) > 0.0 and float(inverse_gap) * sag > 1.0:
        gap, sag = 1.0 / (float(inverse_gap) * MICROMETRE), sag / MICROMETRE
        return (
            f"has a gap of {gap:.3g} µm, less than the {sag:.3g} µm by which the weight bends the shaft: the rotor "
            "lies in it even at rest"
        )
    return None


def depth_objection(rotor: AbstractRotor, loss_x: Array, loss_y: Array, where: str = "") -> str | None:
    """What speaks against a loss of stiffness that turns with the shaft: the shaft has less."""
    loss, least = math.hypot(float(loss_x), float(loss_y)), float(np.min(np.asarray(rotor.stiffness)))
    return f"takes {loss:.3g} N/m{where}, more than the {least:.3g} N/m that the shaft has" if loss > least else None


class Duffing(RestoringEffect):
    """f = k_3 r² (x, y), r the deflection of the shaft: its stiffness grows (or falls, k_3 < 0) with amplitude."""

    name: ClassVar[str] = "duffing"
    family: ClassVar[Family] = "restoring"
    meaning: ClassVar[str] = "shaft or support stiffens with amplitude (softens where negative)"
    source: ClassVar[str] = "Ishida, Yamamoto, Linear and Nonlinear Rotordynamics, 2nd edition, 2012, section 6.2"
    relatives: ClassVar[tuple[str, ...]] = ("stiffness_error", "speed_dependent_stiffness")
    sufficient: ClassVar[Plan] = AROUND
    cubic_n_per_m3: Array = parameter("cubic stiffness k_3", scale=1e-3, of="cubic")
    starts: ClassVar[tuple[dict[str, float], ...]] = ({}, {"cubic_n_per_m3": 0.3}, {"cubic_n_per_m3": -0.3})

    def force(self, instant: Instant) -> Array:
        return self.cubic_n_per_m3 * jnp.sum(instant.deflection**2) * instant.deflection


class Clearance(RestoringEffect):
    """f = k_c max(r - gap, 0) (x, y)/r: a second support that is reached at the end of a gap."""

    name: ClassVar[str] = "clearance"
    family: ClassVar[Family] = "restoring"
    meaning: ClassVar[str] = "play: beyond a gap the shaft meets a further support, without friction"
    source: ClassVar[str] = "Ehrich, Handbook of Rotordynamics, 1992, section 1.8; Ishida, Yamamoto 2012, section 6.2"
    relatives: ClassVar[tuple[str, ...]] = ("rub", "duffing")
    sufficient: ClassVar[Plan] = AROUND
    stiffness_n_per_m: Array = parameter("contact stiffness k_c", scale=1.0, of="stiffness")
    inverse_gap_per_m: Array = parameter("one over the gap", scale=0.2, of="curvature", shape_only=True)
    starts: ClassVar[tuple[dict[str, float], ...]] = tuple(
        {"stiffness_n_per_m": 0.1, "inverse_gap_per_m": 1.0 / share} for share in GAP_SHARES
    )
    over_amplitude: ClassVar[tuple[str, ...]] = ("inverse_gap_per_m",)

    def force(self, instant: Instant) -> Array:
        return pressed(instant, self.stiffness_n_per_m, self.inverse_gap_per_m) * instant.position

    def objection(self, rotor: AbstractRotor) -> str | None:
        return pull_objection(self.stiffness_n_per_m)

    def remark(self, rotor: AbstractRotor) -> str | None:
        return stop_remark(rotor, self.stiffness_n_per_m, self.inverse_gap_per_m)


class Rub(RestoringEffect):
    """f = k_c max(r - gap, 0) [(x, y) + μ (-y, x)]/r for a shaft from x to y: friction against the moving surface."""

    name: ClassVar[str] = "rub"
    family: ClassVar[Family] = "restoring"
    meaning: ClassVar[str] = (
        "the rotor touches the stator beyond a gap and is braked by friction, which drives it backward"
    )
    source: ClassVar[str] = "Muszynska, Rotordynamics, 2005, chapter 5; Choy, Padovan 1987, J. Sound Vib. 113:529-545"
    relatives: ClassVar[tuple[str, ...]] = ("clearance", "cross_coupling")
    sufficient: ClassVar[Plan] = AROUND
    stiffness_n_per_m: Array = parameter("contact stiffness k_c", scale=1.0, of="stiffness")
    inverse_gap_per_m: Array = parameter("one over the gap", scale=0.2, of="curvature", shape_only=True)
    friction: Array = parameter("coefficient of friction μ", scale=0.2, shape_only=True)
    starts: ClassVar[tuple[dict[str, float], ...]] = tuple(
        {"stiffness_n_per_m": 0.1, "inverse_gap_per_m": 1.0 / share, "friction": 1.0} for share in GAP_SHARES
    )
    over_amplitude: ClassVar[tuple[str, ...]] = ("inverse_gap_per_m",)

    def force(self, instant: Instant) -> Array:
        x, y = instant.position[0], instant.position[1]
        drag = self.friction * instant.rotor.spin
        return pressed(instant, self.stiffness_n_per_m, self.inverse_gap_per_m) * jnp.stack(
            [x - drag * y, y + drag * x]
        )

    def objection(self, rotor: AbstractRotor) -> str | None:
        return pull_objection(self.stiffness_n_per_m) or drive_objection(self.friction)

    def remark(self, rotor: AbstractRotor) -> str | None:
        return stop_remark(rotor, self.stiffness_n_per_m, self.inverse_gap_per_m)


class Crack(RestoringEffect):
    """f = -Δk b(φ) e (e·q), e the crack's direction, turning with the shaft; b = (1 + e·down)/2 breathes with the
    weight.
    """

    name: ClassVar[str] = "crack"
    family: ClassVar[Family] = "restoring"
    meaning: ClassVar[str] = (
        "a transverse crack that opens below and closes above: less stiff across it, once and twice per turn"
    )
    source: ClassVar[str] = (
        "Mayes, Davies 1984, J. Vib. Acoust. Stress Reliab. 106(1):139-145; Gasch 1993, J. Sound Vib. 160(2):313-332"
    )
    relatives: ClassVar[tuple[str, ...]] = ("asymmetric_shaft", "residual_bow", "misalignment")
    in_proportion: ClassVar[bool] = True
    sufficient: ClassVar[Plan] = ONCE_AND_TWICE
    loss_x_n_per_m: Array = parameter(
        "loss of stiffness Δk times the cosine of the crack's angle", scale=0.05, of="stiffness"
    )
    loss_y_n_per_m: Array = parameter(
        "loss of stiffness Δk times the sine of the crack's angle", scale=0.05, of="stiffness"
    )
    starts: ClassVar[tuple[dict[str, float], ...]] = tuple(
        {"loss_x_n_per_m": 0.3 * x, "loss_y_n_per_m": 0.3 * y}
        for x, y in ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))
    )

    def force(self, instant: Instant) -> Array:
        pair = jnp.stack([self.loss_x_n_per_m, self.loss_y_n_per_m])
        loss = length(pair)
        across = instant.turning(pair / loss)
        open_share = 0.5 * (1.0 + jnp.sum(across * instant.down))
        return -loss * open_share * jnp.sum(across * instant.deflection) * across

    def objection(self, rotor: AbstractRotor) -> str | None:
        said = depth_objection(rotor, self.loss_x_n_per_m, self.loss_y_n_per_m)
        return said and f"{said}: deeper than the shaft"


class AsymmetricShaft(RestoringEffect):
    """f = Δk [[cos 2ψ, sin 2ψ], [sin 2ψ, -cos 2ψ]] q, ψ = φ + β: stiffer along β, softer across, turning with the
    shaft.
    """

    name: ClassVar[str] = "asymmetric_shaft"
    family: ClassVar[Family] = "restoring"
    meaning: ClassVar[str] = (
        "two unequal bending stiffnesses turn with the shaft (keyway, two-pole rotor); weight then excites 2X"
    )
    source: ClassVar[str] = "Genta, Dynamics of Rotating Systems, Springer 2005, section 6.3"
    relatives: ClassVar[tuple[str, ...]] = ("crack", "misalignment")
    in_proportion: ClassVar[bool] = True
    sufficient: ClassVar[Plan] = ONCE_AND_TWICE
    difference_x_n_per_m: Array = parameter("half difference Δk times cos 2β", scale=0.02, of="stiffness")
    difference_y_n_per_m: Array = parameter("half difference Δk times sin 2β", scale=0.02, of="stiffness")

    def force(self, instant: Instant) -> Array:
        x, y = instant.deflection[0], instant.deflection[1]
        turned = instant.turning(jnp.stack([self.difference_x_n_per_m, self.difference_y_n_per_m]), times=2.0)
        return jnp.stack([turned[0] * x + turned[1] * y, turned[1] * x - turned[0] * y])

    def objection(self, rotor: AbstractRotor) -> str | None:
        return depth_objection(rotor, self.difference_x_n_per_m, self.difference_y_n_per_m, " on its soft side")


class QuadraticDamping(RestoringEffect):
    """f = c_2 |q̇| q̇."""

    name: ClassVar[str] = "quadratic_damping"
    family: ClassVar[Family] = "restoring"
    meaning: ClassVar[str] = "drag that grows with the square of the speed of vibration (turbulent fluid, squeeze film)"
    source: ClassVar[str] = "Rao, Mechanical Vibrations, section 3.10 (quadratic damping)"
    relatives: ClassVar[tuple[str, ...]] = ("damping_error", "coulomb_friction")
    sufficient: ClassVar[Plan] = AROUND
    damping_n_s2_per_m2: Array = parameter("drag c_2", scale=0.3, of="drag")

    def force(self, instant: Instant) -> Array:
        return self.damping_n_s2_per_m2 * length(instant.velocity) * instant.velocity


class CoulombFriction(RestoringEffect):
    """f = F_c q̇/sqrt(|q̇|² + v²), v = 6.3e-5 m/s: dry friction, its change of sign spread over a small speed."""

    name: ClassVar[str] = "coulomb_friction"
    family: ClassVar[Family] = "restoring"
    meaning: ClassVar[str] = "dry friction in seats, dampers or couplings: the smaller the vibration, the more it damps"
    source: ClassVar[str] = (
        "Rao, Mechanical Vibrations, section 3.9; regularised: Andersson et al. 2007, Tribol. Int. 40:580-587"
    )
    relatives: ClassVar[tuple[str, ...]] = ("damping_error", "quadratic_damping")
    sufficient: ClassVar[Plan] = AROUND
    force_n: Array = parameter("friction force F_c", scale=0.2, of="force")

    def force(self, instant: Instant) -> Array:
        return self.force_n * instant.velocity / length(instant.velocity, STICTION_SPEED)

    def objection(self, rotor: AbstractRotor) -> str | None:
        return drive_objection(self.force_n)


class ProbeSaturation(WaveformEffect):
    """The waveform x becomes h tanh(x/h), before delay and phase reference."""

    name: ClassVar[str] = "probe_saturation"
    family: ClassVar[Family] = "reading"
    meaning: ClassVar[str] = "a probe near the end of its range flattens large amplitudes"
    source: ClassVar[str] = "API 670, 5th edition, 2014, section 6.1: linear range"
    relatives: ClassVar[tuple[str, ...]] = ("probe_gain", "duffing")
    sufficient: ClassVar[Plan] = AROUND
    inverse_limit_per_m: Array = parameter("one over the limit h", scale=0.1, of="curvature")
    starts: ClassVar[tuple[dict[str, float], ...]] = tuple({"inverse_limit_per_m": share} for share in (0.25, 0.5, 1.0))
    over_amplitude: ClassVar[tuple[str, ...]] = ("inverse_limit_per_m",)

    def distorted(self, waveform: Array) -> Array:
        bent = self.inverse_limit_per_m * waveform
        small = jnp.abs(bent) < 1e-4
        safe = jnp.where(small, 1.0, bent)
        return waveform * jnp.where(small, 1.0 - bent**2 / 3.0, jnp.tanh(safe) / safe)
