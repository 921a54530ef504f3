"""The one forward door: from a model and its conditions to complex vibration vectors.

Assembly has a fixed order, so that every set of effects gives the same model however it was written:
support path (stiffnesses summed, turned, in series with a foundation), disk-borne terms, forces, reading.
"""

import functools
import math
import operator
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Complex, Float

from rotorjax._planar import Matrix, Vector
from rotorjax.model import (
    AbstractRotor,
    Conditions,
    Excitation,
    ExcitationEffect,
    Matrices,
    MatrixEffect,
    Model,
    OperatingPoint,
    Probes,
    Reading,
    ReadingEffect,
    SpeedEffect,
    Support,
    SupportEffect,
)


class Motion(NamedTuple):
    """Motion of the disk and of the foundation under it, at one order [m]."""

    disk: Vector
    foundation: Vector


def _add(first: Any, *others: Any) -> Any:
    return functools.reduce(lambda a, b: jax.tree.map(operator.add, a, b), others, first)


def _path_stiffness(model: Model, point: OperatingPoint, added: Matrices) -> tuple[Matrix, Vector]:
    """K_p = (S⁻¹ + F⁻¹)⁻¹ with S = R(β) K R(β)ᵀ, and the foundation's compliance F⁻¹ per axis."""
    straight = Matrix.diagonal(point.rotor.stiffness[0], point.rotor.stiffness[1]) + Matrix.of(added.path_stiffness)
    effects = [e for e in model.effects if isinstance(e, SupportEffect)]
    if not effects:
        return straight, Vector(0.0, 0.0)
    support = _add(Support(), *(e.support(point) for e in effects))
    turn = Matrix.turn(support.turn)
    turned = turn @ straight @ turn.transposed
    compliance = Vector.of(support.compliance)
    series = Matrix.diagonal(1.0, 1.0) + Matrix.diagonal(compliance.x, compliance.y) @ turned
    return turned @ series.inverse(), compliance


def _motion(model: Model, point: OperatingPoint) -> Motion:
    """D q = F with D = K_p + iωC + K_disk - ω²M and F = F_unbalance + K_p bow."""
    added = _add(Matrices(), *(e.matrices(point) for e in model.effects if isinstance(e, MatrixEffect)))
    driven = _add(Excitation(), *(e.excitation(point) for e in model.effects if isinstance(e, ExcitationEffect)))
    path, compliance = _path_stiffness(model, point, added)
    rotor, omega = point.rotor, point.frequency
    path_damping = Matrix.diagonal(rotor.damping[0], rotor.damping[1]) + Matrix.of(added.path_damping)
    mass = Matrix.diagonal(rotor.mass, rotor.mass) + Matrix.of(added.mass)
    dynamic = path + 1j * omega * (path_damping + Matrix.of(added.damping)) + Matrix.of(added.stiffness) + (-(omega**2)) * mass
    once = point.at_order(1.0)
    offset = Vector.of(driven.offset) + once * Vector.of(point.forward(point.bow))
    through = path + 1j * omega * path_damping if rotor.bow_through_damping else path
    installed = once * point.speed**2 * Vector.of(point.forward(jnp.sum(point.unbalance, axis=0)))
    disk = dynamic.solve(Vector.of(driven.force) + installed + through.times(offset))
    transmitted = path.times(disk - offset)
    return Motion(disk, Vector(compliance.x * transmitted.x, compliance.y * transmitted.y))


def _read(model: Model, point: OperatingPoint, motion: Motion) -> Complex[Array, "probe"]:
    """Reading in its fixed order: direction, runout, gain, delay, phase reference."""
    readings = [e.reading(point) for e in model.effects if isinstance(e, ReadingEffect)]
    gain: Any = math.prod(r.gain for r in readings)
    total = _add(Reading(gain=0.0), *(r._replace(gain=0.0) for r in readings))
    probes: Probes = model.probes
    angle = probes.angle + total.direction
    x = motion.disk.x - probes.on_foundation * motion.foundation.x
    y = motion.disk.y - probes.on_foundation * motion.foundation.y
    along = jnp.cos(angle) * x + jnp.sin(angle) * y
    turned = jnp.exp(1j * (point.order * total.phase - point.frequency * total.delay))
    return (probes.participation * along + total.runout) * gain * turned


def _vectors(model: Model, condition: Conditions) -> Complex[Array, "probe order"]:
    """Every order of one case."""
    speed = condition.speed + sum((e.added_speed(condition.speed) for e in model.effects if isinstance(e, SpeedEffect)), jnp.zeros(()))
    orders = jnp.asarray(model.layout.orders, dtype=speed.dtype)

    def at_order(order: Float[Array, ""], index: Array) -> Complex[Array, "probe"]:
        unbalance = condition.unbalance * model.participation[:, None]
        point = OperatingPoint(model.rotor, speed, order, index, unbalance, condition.bow)
        read = _read(model, point, _motion(model, point))
        return jnp.where(order == 0.0, jnp.real(read) + 0j, read)

    return jax.vmap(at_order, out_axes=1)(orders, jnp.arange(len(orders)))


def _case(model: Model, condition: Conditions) -> Complex[Array, "probe order"]:
    if model.slow_roll is None:
        return _vectors(model, condition)
    speeds = jnp.stack([condition.speed, model.slow_roll])
    at_speed = jax.vmap(lambda speed: _vectors(model, Conditions(speed, condition.unbalance, condition.bow)))
    measured, rolling = at_speed(speeds)
    return measured - rolling


def vectors(model: Model, conditions: Conditions) -> Complex[Array, "case probe order"]:
    """`response` without its own compilation, for use inside other compiled functions."""
    return jax.vmap(_case, in_axes=(None, 0))(model, conditions)


@eqx.filter_jit
def response(model: Model | AbstractRotor, conditions: Conditions) -> Complex[Array, "case probe order"]:
    """Steady-state vibration vectors: displacement(t) = Re[z e^{inΩt}], zero-to-peak, phase leading [m].

    z_n = reading(D_n⁻¹ F_n), D_n = K_p + inΩC + K_disk - (nΩ)²M; less the same at slow roll where the model says
    that slow roll was subtracted. Differentiable in every number of model and conditions.

    **Arguments:** ``model``, or a rotor alone; ``conditions`` with one leading axis. **Returns** shape (case, probe, order), orders
    as in ``model.layout.orders``. Without damping the response at a critical speed is infinite.
    Source: Huang et al. 2026, Sensors 26:2565, equations 1-9; Genta, Dynamics of Rotating Systems, 2005, chapter 2.
    """
    return vectors(model if isinstance(model, Model) else Model(model), conditions)
