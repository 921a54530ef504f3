"""Arrays on either side of compiled code, and what their axes are called.

Shape names used in annotations throughout the package (a name used in one function only says what it counts):

======== ==========================================================
case     one operating condition: a run at a speed (one reading)
run      one state of the machine: what is installed in it
speed    a cluster of nearly equal speeds
order    multiple of the shaft's rotation (1X, 2X, ...)
probe    displacement probe
plane    balancing plane
dof      lateral degree of freedom, x then y
param    entry of a parameter vector
latent   random component of a run (scatter of unbalance and bow)
start    starting point of a fit
fold     fold of a cross-validation
free     entry of a parameter vector that is fitted
sample   one training case, or one sample of a record
feature  input of a network: f1, f2, f3, f4
target   output of a network: U_x, U_y, s_x, s_y
hidden   neuron of a network's hidden layer
row      one evaluation of compiled code: unknowns at a case
column   unknown by which a slope is taken
cell     real or imaginary part of one probe at one order, in a row
coefficient
         of a motion: order 0, then real and imaginary part of others
wide     the same of a motion with more orders
motion   coefficients of both directions in a row
equation balance of forces at one coefficient and direction
unknown  what is solved for
instant  shaft angle at which forces are evaluated
state    a motion that is fitted: every case, then each slow roll
near     some of the cases, by their numbers
common   error that several vectors have in common
part     unknown of one group that is averaged over together
own      parameter of the effects that a program knows
step     of a history, or in time
======== ==========================================================
"""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.core import Tracer
from jaxtyping import ArrayLike, Complex, Float

Numbers = ArrayLike | Sequence[Any]
"""What a user may hand over for an array: a number, nested lists, any array."""


AnyArray = Array | np.ndarray
"""An array on either side of the door to compiled code."""


def require_float64(what: str) -> None:
    """Raise unless JAX computes in double precision.

    **Errors.** ``ValueError``: near resonance the normal equations of a fit lose some eight digits.
    """
    if not jax.config.read("jax_enable_x64"):
        raise ValueError(
            f'{what} needs double precision: jax.config.update("jax_enable_x64", True) before any array is made'
        )


def diagonal(values: Float[Array, "dof"]) -> Float[Array, "dof dof"]:
    """Diagonal matrix by multiplication: `jnp.diag` becomes a scatter, several times slower under ``vmap``."""
    return jnp.eye(len(values)) * values[:, None]


def real_pair(vector: Array) -> Float[Array, "*shape 2"]:
    """Complex array -> real array with real and imaginary part along a last axis."""
    return jnp.stack([vector.real, vector.imag], axis=-1)


def numpy_pair(vector: Complex[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape 2"]:
    """`real_pair` outside compiled code."""
    return np.stack([np.real(vector), np.imag(vector)], axis=-1)


def is_known(*values: Any) -> bool:
    """Whether these are numbers, not stand-ins for them while a function is traced."""
    return not any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(values))


def as_float(value: Numbers) -> Array:
    """Number or nested numbers -> floating array of JAX's default precision."""
    return (
        as_array(np.array(value, dtype=jnp.result_type(float))) if is_known(value) else jnp.asarray(value, dtype=float)
    )


def as_array(value: np.ndarray) -> Array:
    """An array of JAX's with these numbers: unlike `jnp.asarray`, it compiles nothing for their shape."""
    return jax.device_put(value)
