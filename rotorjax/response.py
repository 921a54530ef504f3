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

    disk: Complex[Array, "dof"]
    foundation: Complex[Array, "dof"]


def _add(first: Any, *others: Any) -> Any:
    return functools.reduce(lambda a, b: jax.tree.map(operator.add, a, b), others, first)


def _solve(matrix: Complex[Array, "dof dof"], vector: Complex[Array, "dof"]) -> Complex[Array, "dof"]:
    """Closed form of a 2x2 solve: seven times faster than a batched LU."""
    (a, b), (c, d) = matrix
    return jnp.stack([d * vector[0] - b * vector[1], a * vector[1] - c * vector[0]]) / (a * d - b * c)


def _inverse(matrix: Complex[Array, "dof dof"]) -> Complex[Array, "dof dof"]:
    (a, b), (c, d) = matrix
    return jnp.stack([jnp.stack([d, -b]), jnp.stack([-c, a])]) / (a * d - b * c)


def _path_stiffness(model: Model, point: OperatingPoint, added: Matrices) -> tuple[Complex[Array, "dof dof"], Complex[Array, "dof"]]:
    """K_p = (S⁻¹ + F⁻¹)⁻¹ with S = R(β) K R(β)ᵀ, and the foundation's compliance F⁻¹ per axis."""
    straight = jnp.diag(point.rotor.stiffness) + added.path_stiffness
    effects = [e for e in model.effects if isinstance(e, SupportEffect)]
    if not effects:
        return straight.astype(complex), jnp.zeros(2, complex)
    support = _add(Support(), *(e.support(point) for e in effects))
    cosine, sine = jnp.cos(support.turn), jnp.sin(support.turn)
    turn = jnp.stack([jnp.stack([cosine, -sine]), jnp.stack([sine, cosine])])
    turned = (turn @ straight @ turn.T).astype(complex)
    compliance = jnp.broadcast_to(jnp.asarray(support.compliance, complex), (2,))
    series = _inverse(jnp.eye(2) + compliance[:, None] * turned)
    return turned @ series, compliance


def _motion(model: Model, point: OperatingPoint) -> Motion:
    """D q = F with D = K_p + iωC + K_disk - ω²M and F = F_unbalance + K_p bow."""
    added = _add(Matrices(), *(e.matrices(point) for e in model.effects if isinstance(e, MatrixEffect)))
    driven = _add(Excitation(), *(e.excitation(point) for e in model.effects if isinstance(e, ExcitationEffect)))
    path, compliance = _path_stiffness(model, point, added)
    damper = jnp.diag(point.rotor.damping) + added.path_damping
    dynamic = path + 1j * point.frequency * (damper + added.damping) + added.stiffness - point.frequency**2 * (point.rotor.mass * jnp.eye(2) + added.mass)
    once = point.at_order(1.0)
    offset = driven.offset + once * point.forward(point.bow)
    through = path + 1j * point.frequency * damper if point.rotor.bow_through_damping else path
    installed = once * point.speed**2 * point.forward(jnp.sum(point.unbalance, axis=0))
    disk = _solve(dynamic, driven.force + installed + through @ offset)
    return Motion(disk, compliance * (path @ (disk - offset)))


def _read(model: Model, point: OperatingPoint, motion: Motion) -> Complex[Array, "probe"]:
    """Reading in its fixed order: direction, runout, gain, delay, phase reference."""
    readings = [e.reading(point) for e in model.effects if isinstance(e, ReadingEffect)]
    gain: Any = math.prod(r.gain for r in readings)
    total = _add(Reading(gain=0.0), *(r._replace(gain=0.0) for r in readings))
    probes: Probes = model.probes
    angle = probes.angle + total.direction
    seen = motion.disk[None, :] - probes.on_foundation[:, None] * motion.foundation[None, :]
    along = jnp.cos(angle) * seen[:, 0] + jnp.sin(angle) * seen[:, 1]
    turned = jnp.exp(1j * (point.order * total.phase - point.frequency * total.delay))
    return (probes.participation * along + total.runout) * gain * turned


def _vectors(model: Model, condition: Conditions) -> Complex[Array, "probe order"]:
    """Every order of one case."""
    speed = condition.speed + sum((e.added_speed(condition.speed) for e in model.effects if isinstance(e, SpeedEffect)), jnp.zeros(()))
    orders = jnp.asarray(model.layout.orders, dtype=speed.dtype)

    def at_order(order: Float[Array, ""], index: Array) -> Complex[Array, "probe"]:
        unbalance = condition.unbalance * model.participation[:, None]
        point = OperatingPoint(model.rotor, speed, order, index, unbalance, condition.bow)
        return _read(model, point, _motion(model, point))

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
