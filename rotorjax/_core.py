"""What every other module stands on: shape names, units for the door, the float64 guard, Levenberg-Marquardt.

Shape names used in annotations throughout the package, and nothing else:

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
======== ==========================================================
"""

import ctypes
import math
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.core import Tracer
from jaxtyping import ArrayLike, Bool, Complex, Float, Int

Numbers = ArrayLike | Sequence[Any]
"""What a user may hand over for an array: a number, nested lists, any array."""

AnyArray = Array | np.ndarray
"""An array on either side of the door to compiled code."""

RPM = 2.0 * math.pi / 60.0
"""One revolution per minute, in rad/s."""
MICROMETRE = 1e-6
GRAM_MILLIMETRE = 1e-6
"""One g mm, in kg m."""
DEGREE = math.pi / 180.0
GRAVITY = 9.80665
"""Standard acceleration of gravity, m/s² (CGPM 1901)."""

# Ending of a parameter's name -> (SI unit, unit for people, SI value of one of these). Longest ending first.
_UNITS: tuple[tuple[str, tuple[str, str, float]], ...] = (
    ("_n_per_m3", ("N/m³", "N/m³", 1.0)),
    ("_n_s2_per_m2", ("N s²/m²", "N s²/m²", 1.0)),
    ("_n_s_per_m", ("N s/m", "N s/m", 1.0)),
    ("_n_per_m", ("N/m", "N/m", 1.0)),
    ("_m_per_n", ("m/N", "µm/N", 1e-6)),
    ("_per_m", ("1/m", "1/mm", 1e3)),
    ("_kg_m", ("kg m", "g mm", GRAM_MILLIMETRE)),
    ("_kg", ("kg", "g", 1e-3)),
    ("_rad", ("rad", "deg", DEGREE)),
    ("_n", ("N", "N", 1.0)),
    ("_s", ("s", "ms", 1e-3)),
    ("_m", ("m", "µm", MICROMETRE)),
)


class Unit(NamedTuple):
    """SI unit, the unit shown to people, and the SI value of one of the latter."""

    si: str
    shown: str
    factor: float


def unit_of(name: str) -> Unit:
    """The unit that a parameter's name declares by its ending; dimensionless without one."""
    for ending, unit in _UNITS:
        if name.endswith(ending):
            return Unit(*unit)
    return Unit("1", "1", 1.0)


def require_float64(what: str) -> None:
    """Raise unless JAX computes in double precision.

    **Errors.** ``ValueError``: near resonance the normal equations of a fit lose some eight digits.
    """
    if not jax.config.read("jax_enable_x64"):
        raise ValueError(f'{what} needs double precision: jax.config.update("jax_enable_x64", True) before any array is made')


MOST_MAPS = 30_000
"""Memory maps of this process from which on compiled programs are dropped: Linux grants 65530 (vm.max_map_count)."""


def forget_compiled() -> None:
    """Drop what was compiled so far if the process nears the limit of memory maps, at which a compilation ends it (SIGSEGV).

    Each measurement of a new size adds some three thousand maps, which JAX keeps for as long as the program may be used again.
    """
    maps = Path("/proc/self/maps")
    if maps.exists() and maps.read_bytes().count(b"\n") > MOST_MAPS:
        jax.clear_caches()


def release_freed_memory() -> None:
    """Return to the system what a compilation has freed, some hundred MB, where the C library is glibc: it keeps that for each thread apart."""
    if sys.platform == "linux" and (trim := getattr(ctypes.CDLL(None), "malloc_trim", None)):
        trim(0)


FIRST_DAMPING = 1e-2
"""Damping λ of Levenberg-Marquardt at the start, on a Hessian of unit diagonal."""
CONVERGED, MAX_STEPS, NOT_FINITE, CUT_OFF = 0, 1, 2, 3
RESULT_TEXT = {
    CONVERGED: "converged",
    MAX_STEPS: "stopped at the step limit: the data hardly determine some parameter; give it a value, or a tighter prior",
    CUT_OFF: "stopped where the linearisations allowed were spent",
    NOT_FINITE: "not finite at the start: check the rig file's mass, stiffness and damping, and the table's sigma",
}
"""What each result code of a fit means and what to do next."""


class Quadratic(NamedTuple):
    """A least-squares cost at one point, with its gradient and Gauss-Newton Hessian; ``extra`` travels along."""

    cost: Float[Array, ""]
    gradient: Float[Array, "param"]
    hessian: Float[Array, "param param"]
    extra: Any = ()
    memory: Any = ()
    """What the next evaluation, near by, may begin from."""


class Tolerance(NamedTuple):
    """Fall of the cost below which a descent is at its end: absolute, and relative to the cost."""

    absolute: AnyArray | float
    relative: AnyArray | float


FINE, COARSE = Tolerance(1e-6, 1e-6), Tolerance(1e-2, 1e-4)
"""For estimates; and for ranking, where a hundredth of a log unit decides nothing."""


class Descent(NamedTuple):
    """Where Levenberg-Marquardt ended: point, quadratic there, evaluations made, result code, damping to go on with."""

    point: Float[Array, "*start param"]
    quadratic: Quadratic
    steps: Int[Array, "*start"]
    result: Int[Array, "*start"]
    damping: Float[Array, "*start"]


class _State(NamedTuple):
    point: Array
    quadratic: Quadratic
    trial: Array
    promise: Array
    damping: Array
    steps: Array
    done: Bool[Array, ""]


def levenberg_marquardt(
    quadratic: Callable[[Float[Array, "param"], Any], Quadratic],
    start: Float[Array, "param"],
    *,
    memory: Any = (),
    damping: Float[Array, ""] | float = FIRST_DAMPING,
    max_steps: int = 60,
    tolerance: Tolerance = FINE,
) -> Descent:
    """Minimise a sum of squares, given its value, gradient and Gauss-Newton Hessian in one function.

    Step p = -(H + λ diag H)⁻¹ g (Marquardt 1963, J. SIAM 11(2):431-441); λ falls tenfold on success and rises
    fourfold on failure. The descent has converged when, at small λ, the fall of the cost that the next step
    promises, or that the last one brought, is within the tolerance.

    **Arguments:** ``quadratic``: point and the ``memory`` of the best one so far -> `Quadratic`, traced once; entries that are not free have zero gradient,
    zero off-diagonals and a positive diagonal. ``start``: the point to begin with, ``memory`` that there; ``damping``: λ
    to begin with, that of an earlier descent to go on with it. **Returns** a `Descent`, under
    ``vmap`` one per start. Nothing is raised here: see ``RESULT_TEXT``.
    """

    def propose(point: Array, at: Quadratic, damping: Array) -> tuple[Array, Array]:
        """Trial point, and the fall of the cost that the quadratic promises there."""
        diagonal = jnp.diagonal(at.hessian)
        scale = 1.0 / jnp.sqrt(diagonal)
        # Jacobi scaling makes the Cholesky factor see curvatures of order one only.
        scaled = at.hessian * scale[:, None] * scale[None, :] + damping * jnp.eye(len(diagonal))
        step = -scale * jax.scipy.linalg.cho_solve(jax.scipy.linalg.cho_factor(scaled), scale * at.gradient)
        return point + step, -(at.gradient @ step + 0.5 * step @ at.hessian @ step)

    def step(state: _State) -> _State:
        there = quadratic(state.trial, state.quadratic.memory)
        better = jnp.isfinite(there.cost) & (there.cost <= state.quadratic.cost)
        moved, fall = (state.trial, there), state.quadratic.cost - there.cost
        point, best = jax.tree.map(lambda a, b: jnp.where(better, a, b), moved, (state.point, state.quadratic))
        damping = jnp.where(better, jnp.maximum(state.damping * 0.1, 1e-12), state.damping * 4.0)
        trial, promise = propose(point, best, damping)
        # A heavily damped step is short whatever remains to be gained: only a nearly free one may end the descent.
        small = jnp.minimum(jnp.where(better, fall, jnp.inf), promise) <= tolerance.absolute + tolerance.relative * best.cost
        done = (small & (damping < 1e-2)) | (damping > 1e12) | ~jnp.isfinite(best.cost)
        return _State(point, best, trial, promise, damping, state.steps + 1, done)

    quadratic = jax.jit(quadratic)  # traced once for its shapes and for the loop
    blank = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), jax.eval_shape(quadratic, start, memory))
    nowhere = blank._replace(cost=jnp.full_like(blank.cost, jnp.inf), memory=memory)
    begin = _State(start, nowhere, start, jnp.asarray(jnp.inf), jnp.asarray(damping, dtype=float), jnp.asarray(0), jnp.asarray(False))
    end = jax.lax.while_loop(lambda s: ~s.done & (s.steps < max_steps), step, begin)
    finite = jnp.isfinite(end.quadratic.cost)
    result = jnp.where(finite, jnp.where(end.done, CONVERGED, MAX_STEPS), NOT_FINITE)
    return Descent(end.point, end.quadratic, end.steps, result, end.damping)


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
    return as_array(np.array(value, dtype=jnp.result_type(float))) if is_known(value) else jnp.asarray(value, dtype=float)


def as_array(value: np.ndarray) -> Array:
    """An array of JAX's with these numbers: unlike `jnp.asarray`, it compiles nothing for their shape."""
    return jax.device_put(value)
