"""The rotor in time: matrices of the linear one, and the motion to which it comes from where it is begun."""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Complex, Float

from rotorjax.model.contract import SupportEffect
from rotorjax.model.model import Model
from rotorjax.physics.assembly import Assembled
from rotorjax.physics.harmonic_balance import Coefficients, size_of
from rotorjax.physics.planar import Matrix
from rotorjax.physics.restoring_forces import Moment
from rotorjax.physics.steady_state import Ready, moments_along, total_force

TURNS, INSTANTS = 200, 256
"""How long a motion is followed, and steps per turn."""
REPEATS = 1e-6
"""Difference between the last two periods, in the size of the free motion, up to which it has come to repeat itself."""


class Linear(NamedTuple):
    """The linear rotor in time: M q̈ + C q̇ + K q = 0 for the disk, and below it the foundation where the model has a
    support effect.
    """

    inverse_mass: Float[Array, "state state"]
    damping: Float[Array, "state state"]
    stiffness: Float[Array, "state state"]
    exists: Bool[Array, ""]
    """Whether the dynamic stiffness at every order is that of these matrices."""


def _arrays(matrices: Matrix) -> Complex[Array, "order dof dof"]:
    """2x2 matrices of every order."""
    parts = jnp.broadcast_arrays(matrices.xx, matrices.xy, matrices.yx, matrices.yy)
    return jnp.stack(parts, axis=-1).reshape(-1, 2, 2) + 0j


def _inverted(matrices: Array) -> Array:
    """Of 2x2 matrices along any leading axes, in closed form."""
    a, b, c, d = matrices[..., 0, 0], matrices[..., 0, 1], matrices[..., 1, 0], matrices[..., 1, 1]
    adjugate = jnp.stack([d, -b, -c, a], axis=-1).reshape(matrices.shape)
    return adjugate / (a * d - b * c)[..., None, None]


def linear_in_time(model: Model, assembled: Assembled, omega: Float[Array, "order"]) -> Linear:
    """Matrices in time from the dynamic stiffness D = K_p + K + iωC - ω²M at orders from zero; K_p = (S⁻¹ + F⁻¹)⁻¹, F =
    (1 + iωd - ω²m) / f.

    **Arguments:** ``omega``: frequency of every order [rad/s].
    """
    path = _arrays(assembled.path)
    disk = _arrays(assembled.dynamic) - path
    last, identity = omega[-1], jnp.eye(2)
    stiffness, damping, mass = disk[0].real, disk[-1].imag / last, (disk[0] - disk[-1]).real / last**2
    iw = 1j * omega[:, None, None]
    expected = stiffness[None] + iw * damping[None] + iw**2 * mass[None]
    tolerance = 10.0 * jnp.sqrt(jnp.finfo(omega.dtype).eps)

    def alike(found: Array, there: Array) -> Array:
        return jnp.all(
            jnp.abs(found - there) <= tolerance * jnp.max(jnp.abs(path) + jnp.abs(there), axis=(1, 2), keepdims=True)
        )

    exists = alike(expected, disk)
    if not any(isinstance(e, SupportEffect) for e in model.effects):
        return Linear(_inverted(mass), damping, stiffness + path[0].real, exists & alike(path, path[:1]))
    soft = (
        jnp.stack(jnp.broadcast_arrays(assembled.compliance.x, assembled.compliance.y, omega)[:2], axis=-1) + 0j
    )  # order, dof
    # Compliance that is the same at every order, or none, has no motion of its own in time: it stays within the path.
    own = jnp.max(jnp.abs(soft - soft[:1]), axis=0) > tolerance * jnp.abs(soft[0])
    static = jnp.where(own, soft[0].real, 0.0)
    spring = jnp.where(own[None], soft[:1] / jnp.where(own[None], soft, 1.0), (1.0 + iw[..., 0] / last) ** 2)
    inertia, drag = (1.0 - spring[-1].real) / last**2, spring[-1].imag / last
    shaft = path[0].real @ _inverted(identity - static[:, None] * path[0].real)
    rebuilt = 1.0 + iw[..., 0] * drag[None] + iw[..., 0] ** 2 * inertia[None]
    series = identity[None] + (static[None] / rebuilt)[..., None] * shaft[None]
    exists &= alike(shaft[None] @ _inverted(series), path) & jnp.all(inertia > 0.0)
    zero = jnp.zeros((2, 2))
    return Linear(
        jnp.block([[_inverted(mass), zero], [zero, identity / inertia[:, None]]]),
        jnp.block([[damping, zero], [zero, identity * drag[:, None]]]),
        jnp.block([[stiffness + shaft, -shaft], [-static[:, None] * shaft, identity + static[:, None] * shaft]]),
        exists,
    )


class Reached(NamedTuple):
    """Where a motion has come to."""

    motion: Coefficients
    """Over the last period."""
    repeats: Bool[Array, ""]
    """Whether the period before was the same."""


def reached(ready: Ready, linear: Linear, begun: Coefficients) -> Reached:
    """The motion after 200 turns, from position and velocity of one at shaft angle zero, by the classical Runge-Kutta
    method.

    What is integrated is the difference from the motion of the linear rotor, δ = q - q_0: M δ̈ + C δ̇ + K δ = -N(q_0 +
    δ).
    """
    grid, condition, free = ready.grid, ready.condition, ready.system.free
    halves = 2 * INSTANTS * grid.turns
    angle = 2.0 * math.pi / (2 * INSTANTS) * np.arange(halves)
    beside = moments_along(condition, grid, ready.assembled, free, angle)
    total, angles, dof = total_force(ready.model), jnp.asarray(angle), len(linear.stiffness)
    step_size = 2.0 * math.pi / INSTANTS / condition.speed

    def rate(state: Array, half: Array) -> Array:
        apart, speed = state[:dof], state[dof:]
        here = half % halves
        moment = Moment(
            apart[:2] + beside.position[:, here],
            speed[:2] + beside.velocity[:, here],
            beside.bow[:, here],
            condition.speed,
        )
        force = jnp.zeros(dof).at[:2].set(total(moment, angles[here]))
        return jnp.concatenate(
            [speed, -linear.inverse_mass @ (linear.stiffness @ apart + linear.damping @ speed + force)]
        )

    def step(state: Array, number: Array) -> tuple[Array, Array]:
        first = rate(state, 2 * number)
        second = rate(state + 0.5 * step_size * first, 2 * number + 1)
        third = rate(state + 0.5 * step_size * second, 2 * number + 1)
        fourth = rate(state + step_size * third, 2 * number + 2)
        return state + step_size / 6.0 * (first + 2.0 * second + 2.0 * third + fourth), state[:2]

    def period(state: Array) -> tuple[Array, Array]:
        return jax.lax.scan(step, state, jnp.arange(INSTANTS * grid.turns))

    away = moments_along(condition, grid, ready.assembled, begun - free, angle[:1])
    start = jnp.zeros(2 * dof).at[:2].set(away.position[:, 0]).at[dof : dof + 2].set(away.velocity[:, 0])
    before = jax.lax.fori_loop(0, TURNS // grid.turns, lambda _, state: period(state)[0], start)
    after, path = period(before)
    motion = (path.T + beside.position[:, ::2]) @ jnp.asarray(grid._replace(samples=INSTANTS).analysis())
    return Reached(motion, jnp.max(jnp.abs(after - before)[:dof]) <= REPEATS * size_of(ready.system))
