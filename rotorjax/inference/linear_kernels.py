"""The linear rotor and what its probes read, compiled for many rows: a row is one set of unknowns at one case and one
speed.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
from jax import Array

from rotorjax.inference.force_kernels import ForceInputs
from rotorjax.inference.space import Space
from rotorjax.model.conditions import Conditions
from rotorjax.model.model import Model
from rotorjax.physics.harmonic_balance import grid_of
from rotorjax.physics.planar import Matrix, Vector
from rotorjax.physics.probe_reading import Sensed, bends_of, read_rows
from rotorjax.physics.response import linear_vectors
from rotorjax.physics.steady_state import Ready, positions, without_coupling
from rotorjax.physics.sweep import added_by_sweep

Tree = TypeVar("Tree")


def linear(space: Space, unknowns: Array, columns: Array, *conditions: Array) -> tuple[Array, Array]:
    """What the probes show without nonlinear forces, every order in closed form, and its slopes."""
    return _with_slopes(linear_vectors, space, unknowns, columns, *conditions)


def sweep(space: Space, unknowns: Array, columns: Array, *conditions: Array) -> tuple[Array, Array]:
    """What a changing speed adds to that, and its slopes."""
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


class _Followed(NamedTuple):
    """What one row along a motion depends on the unknowns by; or its changes, with a leading axis that
    counts columns.
    """

    lacking: Vector
    inputs: ForceInputs
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


def along(
    space: Space, unknowns: Array, columns: Array, speed: Array, unbalance: Array, bow: Array, motions: Array
) -> tuple[Any, ...]:
    """All but the nonlinear forces along motions: what the linear rotor lacks there, and what is read."""
    model = space.model
    grid = grid_of(model)
    conditions = (speed, unbalance, bow)

    def ready(u: Array, *condition: Array) -> Ready:
        return Ready.of(space.at(u), Conditions(*condition))

    def followed(u: Array, motion: Array, *condition: Array) -> _Followed:
        there = ready(u, *condition)
        return _Followed(there.lacking(motion), ForceInputs.of(there), there.sensed(motion))

    def by_motion_of(u: Array, *condition: Array) -> tuple[Array, Matrix]:
        there = ready(u, *condition)
        return there.sensed_by_motion(), there.assembled.dynamic

    here, moved = _with_changes(lambda at: jax.vmap(followed)(at, motions, *conditions), unknowns, columns)
    by_motion, dynamic = jax.vmap(by_motion_of)(unknowns, *conditions)
    # Not row by row: where nothing bends the waveform in any row, that is passed over.
    shown = read_rows(
        bends_of(model)[1], grid, positions(model.layout.orders, grid), here.sensed, moved.sensed, by_motion
    )
    # Parts by themselves: to put them side by side costs more in compiled code than outside.
    return (
        shown.shown, shown.slopes, shown.by_motion, here.lacking.x, here.lacking.y, moved.lacking.x, moved.lacking.y,
        dynamic.xx, dynamic.xy, dynamic.yx, dynamic.yy, *here.inputs, *moved.inputs,
    )  # fmt: skip


def finer(space: Space, unknowns: Array, speed: Array, unbalance: Array, bow: Array, motions: Array) -> tuple[Any, ...]:
    """The same at many orders: what the linear rotor lacks there, and how it answers a force."""

    def row(u: Array, speed: Array, unbalance: Array, bow: Array, motion: Array) -> tuple[Any, ...]:
        ready = Ready.of(space.at(u), Conditions(speed, unbalance, bow)).finer
        compliance = ready.assembled.dynamic.inverse()
        return (
            ready.system.lacking(motion), ready.system.free,
            compliance.xx, compliance.xy, compliance.yx, compliance.yy, *ForceInputs.of(ready),
        )  # fmt: skip

    return jax.vmap(row)(unknowns, speed, unbalance, bow, motions)
