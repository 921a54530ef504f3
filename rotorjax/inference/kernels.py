"""The compiled part of every fit: a chunk of rows in, equations, readings and their slopes out.

A row is one set of unknowns at one case and one speed. Shapes depend on the probes, the orders and the catalogue only,
never on the number of cases, runs, starts or free unknowns: each kernel is compiled once, and every later measurement
finds it in the cache.
"""

import contextvars
import dataclasses
import functools
import itertools
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Complex, Float, Int

from rotorjax.arrays import numpy_pair
from rotorjax.compilation import release_freed_memory
from rotorjax.inference.kept_programs import kept_program
from rotorjax.inference.space import Space
from rotorjax.model.conditions import Conditions, Layout
from rotorjax.model.model import Model
from rotorjax.physics.harmonic_balance import Grid, grid_of
from rotorjax.physics.planar import Matrix, Vector
from rotorjax.physics.probe_reading import Sensed, bends_of, read_rows
from rotorjax.physics.response import linear_vectors
from rotorjax.physics.restoring_forces import Inputs, force_slopes, forces_of_rows, parameters_of
from rotorjax.physics.steady_state import Ready, answer, positions, without_timed

LINEAR_CHUNK, BALANCED_CHUNK = 64, 16
"""Rows evaluated together: few of the costly ones, as the last chunk is filled up."""
USUAL_ORDERS = (0.0, 1.0, 2.0, 3.0)
COLUMNS = 12
"""Unknowns by which slopes are taken in one go."""


_WORKERS = ThreadPoolExecutor(os.cpu_count())
"""Compiled code, NumPy's too, leaves the interpreter to others while it runs."""
Item = TypeVar("Item")
Result = TypeVar("Result")


def side_by_side(function: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
    """A function of every item, on all processors."""
    if len(items) == 1:
        return [function(items[0])]
    # What NumPy does on overflow is a setting of the thread's context.
    return list(
        _WORKERS.map(
            lambda item, context: context.run(function, item), items, [contextvars.copy_context() for _ in items]
        )
    )


class Rows(NamedTuple):
    """Where to evaluate."""

    unknowns: Float[np.ndarray, "row param"]
    columns: Int[np.ndarray, "row column"]
    """Unknowns by which slopes are wanted; -1 for none."""
    speed: Float[np.ndarray, "row"]
    unbalance: Float[np.ndarray, "row plane dof"]
    bow: Float[np.ndarray, "row dof"]


class Reading(NamedTuple):
    """What the probes show [m], real and imaginary part of every probe and order in a row, and its slopes by the wanted
    unknowns.
    """

    shown: Float[np.ndarray, "row cell"]
    slopes: Float[np.ndarray, "row cell column"]


class Equations(NamedTuple):
    """The balance of forces g = D q + N(q) - F along a motion q [N], the reading s of that motion [m], and their
    slopes.
    """

    shown: Float[np.ndarray, "row cell"]
    shown_by_motion: Float[np.ndarray, "row cell equation"]
    slopes: Float[np.ndarray, "row cell column"]
    force: Float[np.ndarray, "row equation"]
    force_by_motion: Float[np.ndarray, "row equation equation"]
    force_slopes: Float[np.ndarray, "row equation column"]


class Refined(NamedTuple):
    """The same balance with the force taken along more orders at more instants, and those orders as they follow that
    force.
    """

    force: Float[np.ndarray, "row equation"]
    motion: Float[np.ndarray, "row dof wide"]


class Kernels:
    """The kernels of one parameter space."""

    def __init__(self, space: Space) -> None:
        orders = space.model.layout.orders
        self.grid: Grid = grid_of(space.model)
        # Slow roll is another row, at its own speed; names and prior scales as text would be in the compiled code.
        bare = dataclasses.replace(space, model=nameless(space.model), entries=())
        self._linear = compiled(_linear, bare, space.model, LINEAR_CHUNK)
        # Read at the usual orders too: whichever of them were measured, the compiled code is the same.
        full = bare.with_orders(tuple(sorted({*orders, *USUAL_ORDERS})))
        self._read = [full.model.layout.orders.index(order) for order in orders]
        self._more = len(full.centre) - len(bare.centre)
        self._balanced, self._refined = (
            compiled(kernel, full, space.model, BALANCED_CHUNK) for kernel in (_balanced, _refined)
        )

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
        shown, slopes = self._linear(*rows)
        return Reading(_cells(shown), _cells_by_column(slopes))

    def balanced(self, rows: Rows, motion: Float[np.ndarray, "row dof coefficient"]) -> Equations:
        """Orders that depend on one another, along a motion that need not be one."""
        parts = iter(self._balanced(*self._filled(rows), motion))
        size = motion[0].size
        shown, shown_slopes = _cells(next(parts)[..., self._read]), _cells_by_column(next(parts)[..., self._read])
        shown_by_motion = next(parts)[:, :, self._read]
        lacking, lacking_slopes = (as_coefficients(np.stack([next(parts), next(parts)], axis=-2)) for _ in range(2))
        dynamic = [[next(parts), next(parts)], [next(parts), next(parts)]]
        force, force_slopes, force_by_motion = parts
        add_dynamic(force_by_motion, dynamic)
        return Equations(
            shown,
            shown_by_motion.reshape(*shown.shape, size),
            shown_slopes,
            (force + lacking).reshape(-1, size),
            force_by_motion.reshape(-1, size, size),
            np.moveaxis((force_slopes + lacking_slopes).reshape(*shown_slopes.shape[::2], size), 1, 2),
        )

    def refined(self, rows: Rows, motion: Float[np.ndarray, "row dof wide"]) -> Refined:
        """Many orders at many instants along a refined motion."""
        return Refined(*self._refined(*self._filled(rows), motion))

    def _filled(self, rows: Rows) -> Rows:
        return rows._replace(unknowns=np.pad(rows.unknowns, ((0, 0), (0, self._more))))


class _Itself(NamedTuple):
    """A space as a key: the same only if it is the very object."""

    space: Space

    def __hash__(self) -> int:
        return id(self.space)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Itself) and other.space is self.space


def kernels_of(space: Space) -> Kernels:
    """The kernels of a space, made once."""
    return _kernels_of(_Itself(space))


@functools.lru_cache(maxsize=8)
def _kernels_of(itself: _Itself) -> Kernels:
    return Kernels(itself.space)


def _cells(vectors: Complex[np.ndarray, "*many probe order"]) -> Float[np.ndarray, "*many cell"]:
    """Real and imaginary part of every probe and order in a row."""
    return numpy_pair(vectors).reshape(*vectors.shape[:-2], -1)


def _cells_by_column(slopes: Complex[np.ndarray, "row column probe order"]) -> Float[np.ndarray, "row cell column"]:
    return np.moveaxis(_cells(slopes), 1, 2)


def as_coefficients(amplitudes: Complex[np.ndarray, "*many order"]) -> Float[np.ndarray, "*many coefficient"]:
    """`rotorjax.physics.harmonic_balance.to_real` in NumPy."""
    return np.concatenate(
        [np.real(amplitudes[..., :1]), numpy_pair(amplitudes[..., 1:]).reshape(*amplitudes.shape[:-1], -1)], axis=-1
    )


def add_dynamic(
    by_motion: Float[np.ndarray, "row dof coefficient dof coefficient"], dynamic: list[list[np.ndarray]]
) -> None:
    """Add a complex factor per order, row x order for each pair of directions, as it acts on coefficients; that of
    order 0 is real.
    """
    for (i, row), j in itertools.product(enumerate(dynamic), range(len(dynamic))):
        real, imaginary = np.real(row[j]), np.imag(row[j])
        block = by_motion[:, i, :, j]
        block[:, 0, 0] += real[:, 0]
        for order in range(1, real.shape[1]):
            re, im = 2 * order - 1, 2 * order
            block[:, re, re] += real[:, order]
            block[:, im, im] += real[:, order]
            block[:, re, im] -= imaginary[:, order]
            block[:, im, re] += imaginary[:, order]


class Program:
    """A kernel that takes the leaves of a pytree, its first argument, one by one: traced when it is first called, or
    found.
    """

    def __init__(self, kernel: Callable[..., tuple[Array, ...]], structure: Any, *, ours: bool) -> None:
        self._kernel, self._structure, self._ours = kernel, structure, ours
        self._call: Callable[..., tuple[Array, ...]] | None = None

    @property
    def warm(self) -> bool:
        """Whether it was called before."""
        return self._call is not None

    def __call__(self, leaves: list[Any], *rows: np.ndarray) -> tuple[Array, ...]:
        """One chunk."""
        if self._call is not None:
            return self._call(leaves, *rows)
        self._call = self._made(leaves, *rows)
        parts = jax.block_until_ready(self._call(leaves, *rows))
        release_freed_memory()
        return parts

    def _made(self, leaves: list[Any], *rows: np.ndarray) -> Callable[..., tuple[Array, ...]]:
        def kernel(leaves: list[Any], *rows: Array) -> tuple[Array, ...]:
            return self._kernel(jax.tree.unflatten(self._structure, leaves), *rows)

        # What a class of somebody else does is not said by its name.
        return (
            kept_program(kernel, f"{self._kernel.__name__} {self._structure}", (leaves, *rows))
            if self._ours
            else jax.jit(kernel)
        )


@functools.lru_cache
def _program(
    kernel: Callable[..., tuple[Array, ...]], structure: Any, shapes: tuple[tuple[int, ...], ...], ours: bool
) -> Program:
    """The same one whenever it is asked for."""
    del shapes  # a program for each
    return Program(kernel, structure, ours=ours)


class Compiled(NamedTuple):
    """A kernel at the values of one pytree. Called with rows, any number of them, which are evaluated in chunks of one
    size.
    """

    program: Program
    # Flat, and the structure apart: to look that up anew in every call costs as much as some rows.
    leaves: list[Any]
    size: int

    def __call__(self, *rows: np.ndarray) -> list[np.ndarray]:
        """The last chunk is filled up with copies of its last row."""
        count = len(rows[0])

        def chunk(first: int) -> list[np.ndarray]:
            index = np.minimum(np.arange(first, first + self.size), count - 1)
            return [np.asarray(part) for part in self.program(self.leaves, *(values[index] for values in rows))]

        firsts, parts = range(0, count, self.size), []
        if not self.program.warm:
            # The first by itself: it may have to be compiled.
            parts, firsts = [chunk(0)], firsts[1:]
        parts += side_by_side(chunk, firsts) if firsts else []
        return [np.concatenate(several)[:count] for several in zip(*parts, strict=True)]


def compiled(kernel: Callable[..., tuple[Array, ...]], tree: Any, model: Model, size: int) -> Compiled:
    """A kernel whose first argument is a pytree. **Arguments:** ``model``: what the tree was made of; ``size``: rows
    evaluated together.
    """
    leaves, structure = jax.tree.flatten(tree)
    ours = all(type(part).__module__.startswith("rotorjax.") for part in (model.rotor, *model.effects))
    return Compiled(_program(kernel, structure, tuple(np.shape(leaf) for leaf in leaves), ours), leaves, size)


def nameless(model: Model) -> Model:
    """The model without the names of probes and planes, which compiled code must not depend on, and
    without slow roll.
    """
    layout = model.layout
    blank = Layout(
        tuple(map(str, range(len(layout.probes)))), tuple(map(str, range(len(layout.planes)))), layout.orders
    )
    return dataclasses.replace(model, layout=blank, slow_roll=None)


def _one_hot(columns: Array, size: int) -> Float[Array, "column param"]:
    return (jnp.asarray(columns)[:, None] == jnp.arange(size)[None]).astype(float)


def _linear(
    space: Space, unknowns: Array, columns: Array, speed: Array, unbalance: Array, bow: Array
) -> tuple[Array, Array]:
    def row(u: Array, wanted: Array, *condition: Array) -> tuple[Array, Array]:
        def shown(at: Array) -> Array:
            return linear_vectors(without_timed(space.at(at)), Conditions(*condition))

        value, push = jax.linearize(shown, u)
        return value, jax.vmap(push)(_one_hot(wanted, len(u)))

    return jax.vmap(row)(unknowns, columns, speed, unbalance, bow)


class _Along(NamedTuple):
    """What one row along a motion depends on the unknowns by; or its changes, with a leading axis that
    counts columns.
    """

    lacking: Vector
    inputs: Inputs
    sensed: Sensed


def _balanced(
    space: Space, unknowns: Array, columns: Array, speed: Array, unbalance: Array, bow: Array, motions: Array
) -> tuple[Array, ...]:
    model = space.model
    grid = grid_of(model)

    def row(
        u: Array, wanted: Array, speed: Array, unbalance: Array, bow: Array, motion: Array, *, any_wanted: bool
    ) -> tuple[_Along, _Along, Array, Matrix]:
        condition = Conditions(speed, unbalance, bow)

        def along(at: Array) -> _Along:
            ready = Ready.of(space.at(at), condition)
            return _Along(ready.lacking(motion), ready.inputs(motion), ready.sensed(motion))

        here, push = jax.linearize(along, u)
        units = _one_hot(wanted, len(u))
        moved = (
            jax.vmap(push)(units)
            if any_wanted
            else jax.tree.map(lambda part: jnp.zeros((len(units), *part.shape), part.dtype), here)
        )
        ready = Ready.of(space.at(u), condition)
        return here, moved, ready.sensed_by_motion(), ready.assembled.dynamic

    every, none = (jax.vmap(functools.partial(row, any_wanted=some)) for some in (True, False))
    here, moved, by_motion, dynamic = jax.lax.cond(
        jnp.any(columns >= 0), every, none, unknowns, columns, speed, unbalance, bow, motions
    )
    # Not row by row: what is at its null in all rows is passed over.
    forces = force_slopes(parameters_of(model)[1], model.rotor, grid, here.inputs, moved.inputs)
    shown = read_rows(
        bends_of(model)[1], grid, positions(model.layout.orders, grid), here.sensed, moved.sensed, by_motion
    )
    # Parts by themselves: to put them side by side costs more in compiled code than outside.
    return (
        shown.shown, shown.slopes, shown.by_motion, here.lacking.x, here.lacking.y, moved.lacking.x, moved.lacking.y,
        dynamic.xx, dynamic.xy, dynamic.yx, dynamic.yy, forces.force, forces.change, forces.by_motion,
    )  # fmt: skip


def _refined(
    space: Space, unknowns: Array, columns: Array, speed: Array, unbalance: Array, bow: Array, motions: Array
) -> tuple[Array, Array]:
    del columns
    model = space.model
    grid = grid_of(model)

    def row(u: Array, speed: Array, unbalance: Array, bow: Array, motion: Array) -> tuple[Array, Array, Matrix, Inputs]:
        ready = Ready.of(space.at(u), Conditions(speed, unbalance, bow)).finer
        return ready.system.lacking(motion), ready.system.free, ready.assembled.dynamic.inverse(), ready.inputs(motion)

    lacking, free, compliance, inputs = jax.vmap(row)(unknowns, speed, unbalance, bow, motions)
    force = forces_of_rows(parameters_of(model)[1], model.rotor, grid.finer, inputs)
    follows = free - jax.vmap(answer)(compliance, force)
    count = 2 * len(grid.orders) - 1
    low = (lacking + force)[..., :count]
    return low.reshape(len(low), -1), jnp.concatenate([motions[..., :count], follows[..., count:]], axis=-1)
