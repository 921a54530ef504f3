"""The compiled part of every fit: a chunk of rows in, equations, readings and their slopes out.

A row is one set of unknowns at one case and one speed. Shapes depend on the probes, the orders and the catalogue only,
never on the number of cases, runs, starts or free unknowns: each kernel is compiled once, and every later measurement
finds it in the cache.
"""

import dataclasses
import itertools
from collections.abc import Callable
from typing import ClassVar, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Complex, Float, Int

from rotorjax.arrays import numpy_pair
from rotorjax.inference.programs import LINEAR_CHUNK, compiled, nameless
from rotorjax.inference.space import Space, once_for_each
from rotorjax.model.conditions import Conditions
from rotorjax.model.model import Model
from rotorjax.physics.harmonic_balance import Grid, grid_of
from rotorjax.physics.planar import DOF, Matrix, Vector
from rotorjax.physics.probe_reading import Sensed, bends_of, read_rows
from rotorjax.physics.response import linear_vectors
from rotorjax.physics.restoring_forces import Inputs, force_slopes, forces_of_rows, parameters_of
from rotorjax.physics.steady_state import Ready, answer, positions, without_coupling
from rotorjax.physics.sweep import added_by_sweep

BALANCED_CHUNK = 32
"""Rows evaluated together: few, as they are costly and the last chunk is filled up."""
USUAL_ORDERS = (0.0, 1.0, 2.0, 3.0)
COLUMNS = 12
"""Unknowns by which slopes are taken in one go."""
Tree = TypeVar("Tree")


class Rows(NamedTuple):
    """Where to evaluate."""

    unknowns: Float[np.ndarray, "row param"]
    columns: Int[np.ndarray, "row column"]
    """Unknowns by which slopes are wanted; -1, at the end, for none."""
    speed: Float[np.ndarray, "row"]
    unbalance: Float[np.ndarray, "row plane dof"]
    bow: Float[np.ndarray, "row dof"]
    sweep: Float[np.ndarray, "row"]
    """Rate of the speed [rad/s²]: what it does is added to what is read, by a program of its own."""

    @property
    def steady(self) -> tuple[np.ndarray, ...]:
        """All but the sweep."""
        return self[:-1]

    @property
    def wanted(self) -> slice:
        """Columns in which any row has an unknown: as many as slopes are given by."""
        return slice(int(np.count_nonzero(self.columns >= 0, axis=1).max(initial=0)))


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

    dof: ClassVar[int] = DOF
    """Degrees of freedom of a motion; what fits motions takes their number from here."""

    def __init__(self, space: Space) -> None:
        orders = space.model.layout.orders
        self.grid: Grid = grid_of(space.model)
        # Slow roll is another row, at its own speed; names and prior scales as text would be in the compiled code.
        bare = dataclasses.replace(space, model=nameless(space.model), entries=())
        self._linear, self._swept = (
            compiled(kernel, bare, space.model, LINEAR_CHUNK, often=True) for kernel in (_linear, _sweep_of_fit)
        )
        # Column -1 is none.
        self._sweeping = np.append(space.sweeping(), False)
        # Read at the usual orders too: whichever of them were measured, the compiled code is the same.
        full = bare.with_orders(tuple(sorted({*orders, *USUAL_ORDERS})))
        self._read = [full.model.layout.orders.index(order) for order in orders]
        self._more = len(full.centre) - len(bare.centre)
        self._balanced = compiled(_balanced, full, space.model, BALANCED_CHUNK, often=True)
        self._refined = compiled(_refined, full, space.model, BALANCED_CHUNK)

    @property
    def warm(self) -> bool:
        """Whether the program for nonlinear forces was called before."""
        return self._balanced.program.warm

    def makers(self, conditions: Conditions, *, swept: bool = True) -> list[Callable[[], None]]:
        """What makes each program, in the order in which a search needs them, for conditions like these.
        **Arguments:** ``swept``: the one for what a sweep adds, too.
        """
        rows = Rows(
            np.zeros((1, self._sweeping.size - 1)),
            np.full((1, COLUMNS), -1),
            *(
                np.asarray(values)[:1]
                for values in (conditions.speed, conditions.unbalance, conditions.bow, conditions.sweeps)
            ),
        )
        steady = self._filled(rows).steady
        return [
            lambda: self._linear.make(*rows.steady),
            *([lambda: self._swept.make(*rows)] if swept else []),
            lambda: self._balanced.make(*steady, np.zeros((1, self.dof, self.coefficients))),
            lambda: self._refined.make(*steady, np.zeros((1, self.dof, self.wide))),
        ]

    @property
    def coefficients(self) -> int:
        """Real numbers per direction that are balanced together."""
        return 2 * len(self.grid.orders) - 1

    @property
    def wide(self) -> int:
        """Real numbers per direction of a refined motion."""
        return 2 * len(self.grid.finer.orders) - 1

    def linear(self, rows: Rows) -> Reading:
        """Every order in closed form, nonlinear forces left out."""
        shown, slopes = self._linear(*rows.steady)
        return self._with_sweep(rows, shown, slopes[:, rows.wanted])

    def balanced(
        self, rows: Rows, motion: Float[np.ndarray, "row dof coefficient"], *, swept: bool = True
    ) -> Equations:
        """Orders that depend on one another, along a motion that need not be one. **Arguments:** ``swept``: whether
        what a sweep adds is in what is shown; it is not in the balance.
        """
        parts = iter(self._balanced(*self._filled(rows).steady, motion))
        size, wanted = motion[0].size, rows.wanted
        vectors, by_unknowns = next(parts)[..., self._read], next(parts)[:, wanted][..., self._read]
        shown, shown_slopes = (
            self._with_sweep(rows, vectors, by_unknowns)
            if swept
            else Reading(_cells(vectors), _cells_by_column(by_unknowns))
        )
        shown_by_motion = next(parts)[:, :, self._read]
        lacking = as_coefficients(np.stack([next(parts), next(parts)], axis=-2))
        lacking_slopes = as_coefficients(np.stack([next(parts)[:, wanted], next(parts)[:, wanted]], axis=-2))
        dynamic = [[next(parts), next(parts)], [next(parts), next(parts)]]
        force, force_slopes, force_by_motion = parts
        add_dynamic(force_by_motion, dynamic)
        return Equations(
            shown,
            shown_by_motion.reshape(*shown.shape, size),
            shown_slopes,
            (force + lacking).reshape(-1, size),
            force_by_motion.reshape(-1, size, size),
            np.moveaxis((force_slopes[:, wanted] + lacking_slopes).reshape(*shown_slopes.shape[::2], size), 1, 2),
        )

    def refined(self, rows: Rows, motion: Float[np.ndarray, "row dof wide"]) -> Refined:
        """Many orders at many instants along a refined motion."""
        return Refined(*self._refined(*self._filled(rows).steady, motion))

    def _with_sweep(
        self,
        rows: Rows,
        shown: Complex[np.ndarray, "row probe order"],
        slopes: Complex[np.ndarray, "row column probe order"],
    ) -> Reading:
        """What the probes show, with what a sweep adds to it."""
        freed = self._sweeping[rows.columns].any(axis=1) | rows.unknowns[:, self._sweeping[:-1]].any(axis=1)
        moving = np.flatnonzero(freed | (rows.sweep != 0.0))
        if len(moving):
            added, by_column = self._swept(*(values[moving] for values in rows))
            shown[moving] += added
            slopes[moving] += by_column[:, rows.wanted]
        return Reading(_cells(shown), _cells_by_column(slopes))

    def _filled(self, rows: Rows) -> Rows:
        return rows._replace(unknowns=np.pad(rows.unknowns, ((0, 0), (0, self._more))))


@once_for_each
def kernels_of(space: Space) -> Kernels:
    """The kernels of a space, made once."""
    return Kernels(space)


def _cells(vectors: Complex[np.ndarray, "*many probe order"]) -> Float[np.ndarray, "*many cell"]:
    """Real and imaginary part of every probe and order in a row."""
    probes, orders = vectors.shape[-2:]
    return numpy_pair(vectors).reshape(*vectors.shape[:-2], 2 * probes * orders)


def _cells_by_column(slopes: Complex[np.ndarray, "row column probe order"]) -> Float[np.ndarray, "row cell column"]:
    return np.moveaxis(_cells(slopes), 1, 2)


def as_coefficients(amplitudes: Complex[np.ndarray, "*many order"]) -> Float[np.ndarray, "*many coefficient"]:
    """`rotorjax.physics.harmonic_balance.to_real` in NumPy."""
    pairs = numpy_pair(amplitudes[..., 1:])
    return np.concatenate(
        [np.real(amplitudes[..., :1]), pairs.reshape(*amplitudes.shape[:-1], 2 * pairs.shape[-2])], axis=-1
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


def _linear(space: Space, unknowns: Array, columns: Array, *conditions: Array) -> tuple[Array, Array]:
    return _with_slopes(linear_vectors, space, unknowns, columns, *conditions)


def _sweep_of_fit(space: Space, unknowns: Array, columns: Array, *conditions: Array) -> tuple[Array, Array]:
    return _with_slopes(added_by_sweep, space, unknowns, columns, *conditions)


def _with_slopes(
    vectors: Callable[[Model, Conditions], Array], space: Space, unknowns: Array, columns: Array, *conditions: Array
) -> tuple[Array, Array]:
    """Vectors of the rotor without nonlinear forces, and their slopes."""

    def row(u: Array, wanted: Array, *condition: Array) -> tuple[Array, Array]:
        def shown(at: Array) -> Array:
            return vectors(without_coupling(space.at(at)), Conditions(*condition))

        # Not linearised once for all columns, nor the value by itself: either takes longer to trace and to run.
        units = jax.nn.one_hot(wanted, len(u), dtype=float)
        return jax.vmap(lambda unit: jax.jvp(shown, (u,), (unit,)), out_axes=(None, 0))(units)

    return jax.vmap(row)(unknowns, columns, *conditions)


class _Along(NamedTuple):
    """What one row along a motion depends on the unknowns by; or its changes, with a leading axis that
    counts columns.
    """

    lacking: Vector
    inputs: Inputs
    sensed: Sensed


def _with_changes(function: Callable[[Array], Tree], unknowns: Array, columns: Array) -> tuple[Tree, Tree]:
    """A function of the unknowns of every row, and how its parts change with the wanted ones: a leading axis counts
    rows, in the changes a further one columns.
    """
    here = function(unknowns)
    units = jnp.moveaxis(jax.nn.one_hot(columns, unknowns.shape[-1], dtype=float), 1, 0)

    def every(unknowns: Array) -> Tree:
        # Not linearised once for all columns: to keep what they have in common takes longer to compile.
        return jax.vmap(lambda unit: jax.jvp(function, (unknowns,), (unit,))[1], out_axes=1)(units)

    def none(unknowns: Array) -> Tree:
        del unknowns
        return jax.tree.map(lambda part: jnp.zeros((len(part), len(units), *part.shape[1:]), part.dtype), here)

    return here, jax.lax.cond(jnp.any(columns >= 0), every, none, unknowns)


def _balanced(
    space: Space, unknowns: Array, columns: Array, speed: Array, unbalance: Array, bow: Array, motions: Array
) -> tuple[Array, ...]:
    model = space.model
    grid = grid_of(model)
    conditions = (speed, unbalance, bow)

    def ready(u: Array, *condition: Array) -> Ready:
        return Ready.of(space.at(u), Conditions(*condition))

    def along(u: Array, motion: Array, *condition: Array) -> _Along:
        there = ready(u, *condition)
        return _Along(there.lacking(motion), there.inputs(motion), there.sensed(motion))

    def by_motion_of(u: Array, *condition: Array) -> tuple[Array, Matrix]:
        there = ready(u, *condition)
        return there.sensed_by_motion(), there.assembled.dynamic

    here, moved = _with_changes(lambda at: jax.vmap(along)(at, motions, *conditions), unknowns, columns)
    by_motion, dynamic = jax.vmap(by_motion_of)(unknowns, *conditions)
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
