"""The compiled part of every fit: a chunk of rows in, equations, readings and their slopes out.

A row is one set of unknowns at one case and one speed. Shapes depend on the probes, the orders and the catalogue only, never on the
number of cases, runs, starts or free unknowns: each kernel is compiled once, and every later measurement finds it in the cache.
"""

import dataclasses
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int

from rotorjax._core import AnyArray, real_pair
from rotorjax.harmonic import Grid, make_grid
from rotorjax.model import Conditions, Layout
from rotorjax.response import linear_vectors
from rotorjax.space import Space
from rotorjax.steady import Ready, without_timed

CHUNK, COLUMNS = 32, 4
"""Rows evaluated together, and unknowns by which slopes are taken in one go."""


_WORKERS = ThreadPoolExecutor(os.cpu_count())
"""Compiled code leaves the interpreter to others while it runs."""


class Rows(NamedTuple):
    """Where to evaluate."""

    unknowns: Float[np.ndarray, "row param"]
    columns: Int[np.ndarray, "row column"]
    """Unknowns by which slopes are wanted; -1 for none."""
    speed: Float[np.ndarray, "row"]
    unbalance: Float[np.ndarray, "row plane dof"]
    bow: Float[np.ndarray, "row dof"]


class Reading(NamedTuple):
    """What the probes show [m], real and imaginary part of every probe and order in a row, and its slopes by the wanted unknowns."""

    shown: Float[np.ndarray, "row cell"]
    slopes: Float[np.ndarray, "row cell column"]


class Equations(NamedTuple):
    """The balance of forces g = D q + N(q) - F along a motion q [N], the reading s of that motion [m], and their slopes."""

    shown: Float[np.ndarray, "row cell"]
    shown_by_motion: Float[np.ndarray, "row cell equation"]
    slopes: Float[np.ndarray, "row cell column"]
    force: Float[np.ndarray, "row equation"]
    force_by_motion: Float[np.ndarray, "row equation equation"]
    force_slopes: Float[np.ndarray, "row equation column"]


class Refined(NamedTuple):
    """The same balance with the force taken along more orders at more instants, and those orders as they follow that force."""

    force: Float[np.ndarray, "row equation"]
    motion: Float[np.ndarray, "row dof wide"]


class Kernels:
    """The kernels of one parameter space, and how many rows they have evaluated."""

    def __init__(self, space: Space) -> None:
        self.space = _nameless(space)
        self.grid: Grid = make_grid(space.model.layout.orders)

    @property
    def coefficients(self) -> int:
        """Real numbers per direction that are balanced together."""
        return 2 * len(self.grid.orders) - 1

    @property
    def wide(self) -> int:
        """Real numbers per direction of a refined motion."""
        return 2 * len(self.grid.finer.orders) - 1

    def linear(self, rows: Rows) -> Reading:
        """Every order in closed form, forces that depend on motion left out."""
        return Reading(*_in_chunks(_linear, self.space, rows))

    def balanced(self, rows: Rows, motion: Float[np.ndarray, "row dof coefficient"]) -> Equations:
        """Orders that depend on one another, along a motion that need not be one."""
        return Equations(*_in_chunks(_balanced, self.space, (*rows, motion)))

    def refined(self, rows: Rows, motion: Float[np.ndarray, "row dof wide"]) -> Refined:
        """Many orders at many instants along a refined motion."""
        return Refined(*_in_chunks(_refined, self.space, (*rows, motion)))


def _in_chunks(kernel: Callable[..., tuple[Array, ...]], space: Space, rows: tuple[np.ndarray, ...]) -> list[np.ndarray]:
    """A kernel at any number of rows; the last chunk is filled up with copies of its last row."""
    count = len(rows[0])

    def chunk(first: int) -> list[np.ndarray]:
        index = np.minimum(np.arange(first, first + CHUNK), count - 1)
        return [np.asarray(part) for part in kernel(space, *(values[index] for values in rows))]

    firsts = range(0, count, CHUNK)
    # The first by itself: it may have to be compiled.
    parts = [chunk(0), *_WORKERS.map(chunk, firsts[1:])]
    return [np.concatenate(several)[:count] for several in zip(*parts, strict=True)]


def _nameless(space: Space) -> Space:
    """The space without names and prior scales as text: the compiled code must not depend on them."""
    layout = space.model.layout
    blank = Layout(tuple(map(str, range(len(layout.probes)))), tuple(map(str, range(len(layout.planes)))), layout.orders)
    # Slow roll is another row, at its own speed.
    return dataclasses.replace(space, model=dataclasses.replace(space.model, layout=blank, slow_roll=None), entries=())


def _one_hot(columns: AnyArray, size: int) -> Float[Array, "column param"]:
    return (jnp.asarray(columns)[:, None] == jnp.arange(size)[None]).astype(float)


def _cells(vectors: Array) -> Array:
    return real_pair(vectors).reshape(-1)


@eqx.filter_jit
def _linear(space: Space, unknowns: AnyArray, columns: AnyArray, speed: AnyArray, unbalance: AnyArray, bow: AnyArray) -> tuple[Array, Array]:
    def row(u: Array, wanted: Array, *condition: Array) -> tuple[Array, Array]:
        def shown(at: Array) -> Array:
            return _cells(linear_vectors(without_timed(space.at(at)), Conditions(*condition)))

        value, push = jax.linearize(shown, u)
        return value, jax.vmap(push, out_axes=-1)(_one_hot(wanted, len(u)))

    return jax.vmap(row)(*map(jnp.asarray, (unknowns, columns, speed, unbalance, bow)))


@eqx.filter_jit
def _balanced(space: Space, unknowns: AnyArray, columns: AnyArray, speed: AnyArray, unbalance: AnyArray, bow: AnyArray, motions: AnyArray) -> tuple[Array, ...]:
    orders = space.model.layout.orders

    def row(u: Array, wanted: Array, speed: Array, unbalance: Array, bow: Array, motion: Array) -> tuple[Array, ...]:
        condition = Conditions(speed, unbalance, bow)

        def both(at: Array) -> tuple[Array, Array]:
            ready = Ready.of(space.at(at), condition)
            system = ready.system
            return _cells(ready.shown(motion, orders)), (system.lacking(motion) + system.force(motion)).ravel()

        (shown, force), push = jax.linearize(both, u)
        slopes, force_slopes = jax.vmap(push, out_axes=-1)(_one_hot(wanted, len(u)))
        ready = Ready.of(space.at(u), condition)
        by_motion = jax.jacfwd(lambda q: _cells(ready.shown(q, orders)))(motion)
        system = ready.system
        stiffness = jax.jacfwd(system.lacking)(motion) + system.slopes(motion)
        size = motion.size
        return shown, by_motion.reshape(-1, size), slopes, force, stiffness.reshape(size, size), force_slopes

    return jax.vmap(row)(*map(jnp.asarray, (unknowns, columns, speed, unbalance, bow, motions)))


@eqx.filter_jit
def _refined(
    space: Space, unknowns: AnyArray, columns: AnyArray, speed: AnyArray, unbalance: AnyArray, bow: AnyArray, motions: AnyArray
) -> tuple[Array, Array]:
    del columns

    def row(u: Array, speed: Array, unbalance: Array, bow: Array, motion: Array) -> tuple[Array, Array]:
        ready = Ready.of(space.at(u), Conditions(speed, unbalance, bow))
        count = 2 * len(ready.grid.orders) - 1
        system = ready.finer.system
        force = system.force(motion)
        low = (system.lacking(motion) + force)[:, :count]
        follows = system.free - system.moved(force)
        return low.ravel(), jnp.concatenate([motion[:, :count], follows[:, count:]], axis=1)

    return jax.vmap(row)(*map(jnp.asarray, (unknowns, speed, unbalance, bow, motions)))
