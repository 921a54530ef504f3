"""One station at one order: dynamic stiffness, drive, and the measuring chain, put together in a fixed order.

Support path (stiffnesses summed, turned, in series with a foundation), disk-borne terms, forces, reading: every set of
effects gives the same model however it was written.
"""

import functools
import operator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Complex, Float

from rotorjax.model.conditions import Conditions, Probes
from rotorjax.model.contract import (
    Excitation,
    ExcitationEffect,
    Matrices,
    MatrixEffect,
    OperatingPoint,
    Reading,
    ReadingEffect,
    SpeedEffect,
    Support,
    SupportEffect,
)
from rotorjax.model.model import Model
from rotorjax.physics.planar import Matrix, Vector, product, reciprocal


class Motion(NamedTuple):
    """Motion of the disk and of the foundation under it, at one order [m]."""

    disk: Vector
    foundation: Vector


def _add(first: Any, *others: Any) -> Any:
    return functools.reduce(lambda a, b: jax.tree.map(operator.add, a, b), others, first)


def _path(model: Model, point: OperatingPoint, added: Matrices) -> tuple[Matrix, Matrix, Vector]:
    """K_p = (S⁻¹ + F⁻¹)⁻¹ with S = R(β) K R(β)ᵀ, the damping R(γ) C R(γ)ᵀ, and the foundation's compliance F⁻¹ per
    axis.
    """
    rotor = point.rotor
    straight = Matrix.diagonal(rotor.stiffness[0], rotor.stiffness[1]) + Matrix.of(added.path_stiffness)
    damping = Matrix.diagonal(rotor.damping[0], rotor.damping[1]) + Matrix.of(added.path_damping)
    effects = [e for e in model.effects if isinstance(e, SupportEffect)]
    if not effects:
        return straight, damping, Vector(0.0, 0.0)
    support = _add(Support(), *(e.support(point) for e in effects))
    turned, compliance = straight.turned(support.turn), Vector.of(support.compliance)
    # S (1 + F⁻¹ S)⁻¹, multiplied out.
    size = 1.0 + product(turned.xx, compliance.x) + product(turned.yy, compliance.y)
    size += product(turned.determinant, product(compliance.x, compliance.y))
    across = turned.determinant * Matrix.diagonal(compliance.y, compliance.x)
    return reciprocal(size) * (turned + across), damping.turned(support.damping_turn), compliance


class Whole(NamedTuple):
    """The matrices of the linear rotor: D = stiffness + iω damping - ω² mass."""

    stiffness: Matrix
    """K_p + K_disk."""
    damping: Matrix
    mass: Matrix
    path: Matrix
    """K_p."""
    path_damping: Matrix
    compliance: Vector
    """F⁻¹ of the foundation, per axis."""


def matrices_of(model: Model, point: OperatingPoint) -> Whole:
    """The matrices at one order, all effects that change them together."""
    added = _add(Matrices(), *(e.matrices(point) for e in model.effects if isinstance(e, MatrixEffect)))
    path, path_damping, compliance = _path(model, point, added)
    mass = Matrix.diagonal(point.rotor.mass, point.rotor.mass) + Matrix.of(added.mass)
    stiffness, damping = path + Matrix.of(added.stiffness), path_damping + Matrix.of(added.damping)
    return Whole(stiffness, damping, mass, path, path_damping, compliance)


class Assembled(NamedTuple):
    """The linear rotor at one order: D q = F, and what the foundation and a bow need of it."""

    dynamic: Matrix
    """D = K_p + iωC + K_disk - ω²M."""
    drive: Vector
    """F = F_unbalance + F_effects + K_p bow + weight."""
    path: Matrix
    compliance: Vector
    offset: Vector
    """Bow."""

    def motion(self) -> Motion:
        """Motion under the drive."""
        return self.motion_of(self.dynamic.solve(self.drive))

    def motion_of(self, disk: Vector) -> Motion:
        """The foundation's motion beside the disk's."""
        transmitted = self.path.times(disk - self.offset)
        return Motion(
            disk, Vector(product(self.compliance.x, transmitted.x), product(self.compliance.y, transmitted.y))
        )


def assemble(model: Model, point: OperatingPoint) -> Assembled:
    """The model at one order, everything but its restoring forces."""
    stiffness, damping, mass, path, path_damping, compliance = matrices_of(model, point)
    driven = _add(Excitation(), *(e.excitation(point) for e in model.effects if isinstance(e, ExcitationEffect)))
    rotor, omega = point.rotor, point.frequency
    dynamic = stiffness + (omega * damping).quadrature + (-(omega**2)) * mass
    once, constant = point.at_order(1.0), point.at_order(0.0)
    offset = Vector.of(driven.offset) + once * Vector.of(point.forward(point.bow))
    through = path + (omega * path_damping).quadrature if rotor.bow_through_damping else path
    installed = once * point.speed**2 * Vector.of(point.forward(jnp.sum(point.unbalance, axis=0)))
    weight = constant * mass.times(Vector.of(rotor.gravity))
    return Assembled(
        dynamic, Vector.of(driven.force) + installed + weight + through.times(offset), path, compliance, offset
    )


class Chain(NamedTuple):
    """The measuring chain at one order: what it adds to and multiplies the motion by, and how it turns and scales what
    comes out.
    """

    gain: Any
    runout: Any
    direction: Any
    turn: Any

    @classmethod
    def of(cls, model: Model, point: OperatingPoint) -> "Chain":
        """All reading effects together, in their fixed order: direction, runout, gain, then delay and
        phase reference.
        """
        readings = [e.reading(point) for e in model.effects if isinstance(e, ReadingEffect)]
        gain = functools.reduce(product, (r.gain for r in readings), 1.0)
        total = _add(Reading(gain=0.0), *(r._replace(gain=0.0) for r in readings))
        probes, constant = model.probes, point.at_order(0.0)
        scale = (1.0 - constant) * probes.scale + constant * probes.mean_scale
        angle = point.order * total.phase - point.frequency * total.delay
        turn = jax.lax.complex(scale * jnp.cos(angle), scale * jnp.sin(angle))
        return cls(gain, total.runout, total.direction, turn)

    def sensed(self, probes: Probes, motion: Motion) -> Complex[Array, "probe"]:
        """What the probes deliver, before delay and phase reference."""
        angle = probes.angle + self.direction
        x = motion.disk.x - product(probes.on_foundation, motion.foundation.x)
        y = motion.disk.y - product(probes.on_foundation, motion.foundation.y)
        along = product(jnp.cos(angle), x) + product(jnp.sin(angle), y)
        return product(product(probes.participation, along) + self.runout, self.gain)


def true_speed(model: Model, speed: Float[Array, ""]) -> Float[Array, ""]:
    """The speed with what speed effects add."""
    return speed + sum((e.added_speed(speed) for e in model.effects if isinstance(e, SpeedEffect)), jnp.zeros(()))


def point_at(model: Model, condition: Conditions, order: Array, index: Array) -> OperatingPoint:
    """All that an effect may know at one order of a case.

    **Errors.** ``ValueError`` where the conditions have another number of planes than the model.
    """
    model.layout.require_planes(condition.unbalance.shape[-2])
    unbalance = condition.unbalance * model.participation[:, None]
    return OperatingPoint(model.rotor, condition.speed, order, index, unbalance, condition.bow)
