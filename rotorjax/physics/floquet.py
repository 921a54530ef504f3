"""What becomes of a small disturbance of a periodic motion in one period: the monodromy matrix and its multipliers.

M δ̈ + (C + N_v(t)) δ̇ + (K + N_q(t)) δ = 0, with the slopes N_q, N_v of the restoring forces along the motion; after
one period (δ, δ̇) is the monodromy matrix times what it was, and the eigenvalues of that are the Floquet multipliers
(Nayfeh, Balachandran, Applied Nonlinear Dynamics, Wiley 1995, chapter 3).
"""

import math

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from rotorjax.physics.harmonic_balance import Coefficients
from rotorjax.physics.steady_state import Ready, slopes_along
from rotorjax.physics.time_integration import Linear

TERMS, HALVINGS = 10, 8
"""Of the exponential: Taylor series of 2⁻⁸ of the argument, squared eight times."""
GAUSS = 0.5 - math.sqrt(3.0) / 6.0, 0.5 + math.sqrt(3.0) / 6.0
"""Instants of a step at which the slopes are taken."""


def _exponential(matrices: Float[Array, "step state state"]) -> Float[Array, "step state state"]:
    """Of each, by Taylor series and squaring: no factorisation."""
    small, identity = matrices / 2.0**HALVINGS, jnp.eye(matrices.shape[-1])[None]
    inner = identity
    for k in range(TERMS, 1, -1):
        inner = identity + small @ inner / k
    less = small @ inner  # the identity is left out, so that rounding errors do not grow with the squarings
    for _ in range(HALVINGS):
        less = 2.0 * less + less @ less
    return identity + less


def monodromy(
    linear: Linear, slopes: Float[Array, "kind step point dof dof"], period: Float[Array, ""]
) -> Float[Array, "state state"]:
    """Of disturbances over one ``period`` [s], state (q, q̇): the product of exp(Ω) over its steps, Magnus' series to
    fourth order.

    Ω = h (A_1 + A_2)/2 + (√3/12) h² (A_2 A_1 - A_1 A_2), A at the two Gauss points of each step
    (Hairer, Lubich, Wanner, Geometric Numerical Integration, 2nd edition, 2006, section IV.7).
    """
    size = len(linear.stiffness)
    free = linear.inverse_mass @ linear.stiffness
    rate = jnp.maximum(
        jnp.sqrt(jnp.max(jnp.abs(free))), 2.0 * math.pi / period
    )  # velocities in this unit make all entries of one size
    beside = jnp.zeros((2, *slopes.shape[1:3], size, size)).at[..., :2, :2].set(slopes)
    total = jnp.stack([linear.stiffness, linear.damping])[:, None, None] + beside
    pulls = linear.inverse_mass[None, None, None] @ total
    above = jnp.broadcast_to(
        jnp.concatenate([jnp.zeros((size, size)), rate * jnp.eye(size)], axis=1), (*slopes.shape[1:3], size, 2 * size)
    )
    matrices = jnp.concatenate([above, jnp.concatenate([-pulls[0] / rate, -pulls[1]], axis=-1)], axis=-2)
    step = period / slopes.shape[1]
    first, second = matrices[:, 0], matrices[:, 1]
    magnus = 0.5 * step * (first + second) + math.sqrt(3.0) / 12.0 * step**2 * (second @ first - first @ second)
    product = _exponential(magnus)
    while len(product) % 2 == 0:
        product = product[1::2] @ product[::2]
    whole = product[0]
    for after in product[1:]:
        whole = after @ whole
    return whole


def slopes_at_gauss_points(ready: Ready, motion: Coefficients) -> Float[Array, "kind step point dof dof"]:
    """Of the restoring forces along a motion, at the Gauss points of every step."""
    samples = ready.grid.samples
    steps = samples * ready.grid.turns
    angle = (2.0 * math.pi / samples * (np.arange(steps)[:, None] + np.array(GAUSS))).ravel()
    slopes = slopes_along(ready.model, ready.condition, ready.grid, ready.assembled, motion, angle=angle)
    return jnp.transpose(slopes, (1, 3, 0, 2)).reshape(2, steps, 2, 2, 2)


def largest_multiplier(monodromy: Float[np.ndarray, "state state"]) -> float:
    """Largest absolute eigenvalue of a monodromy matrix; infinite where the matrix is too large for its numbers."""
    return float(np.max(np.abs(np.linalg.eigvals(monodromy)))) if np.all(np.isfinite(monodromy)) else math.inf
