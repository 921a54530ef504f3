"""The balance of forces of a rotor along given motions, at many values of all that may act on it.

One program serves every model, measurement and number of terms: its shape depends on the orders that are balanced and
on the number of planes.
"""

import dataclasses
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.flatten_util import ravel_pytree
from jaxtyping import Float, Int

from rotorjax.effects import CATALOG
from rotorjax.effects.terms import TERMS
from rotorjax.inference.kernels import add_dynamic, as_coefficients
from rotorjax.inference.programs import MOST_ROWS, compiled, nameless
from rotorjax.inference.space import labels_of, values_of
from rotorjax.model.conditions import Conditions, Probes
from rotorjax.model.contract import ReadingEffect, WaveformEffect
from rotorjax.model.model import Model
from rotorjax.physics.assembly import true_speed
from rotorjax.physics.harmonic_balance import grid_of, make_grid
from rotorjax.physics.planar import DOF, Matrix, Vector
from rotorjax.physics.restoring_forces import Inputs, force_slopes, parameters_of
from rotorjax.physics.steady_state import Ready, by_order

CHUNK = 16
"""Rows evaluated together: a force that is at its null in all of them is passed over."""


class Balances(NamedTuple):
    """D q + N(q) - F [N], and its derivative by the motion; for every set of values, in every case."""

    force: Float[np.ndarray, "set case equation"]
    by_motion: Float[np.ndarray, "set case equation equation"]


class ForceBalance:
    """All forces of the catalogue and all terms, with those of a model; what only changes the reading is left out."""

    def __init__(self, model: Model) -> None:
        grid = grid_of(model)
        own = [e for e in model.effects if not isinstance(e, ReadingEffect | WaveformEffect)]
        classes = [cls for cls in (CATALOG | TERMS).values() if not issubclass(cls, ReadingEffect | WaveformEffect)]
        bare = dataclasses.replace(model, effects=tuple(own), slow_roll=None)
        full = bare.with_orders(grid.orders).in_company(classes)
        self.index = {label: k for k, label in enumerate(labels_of(full))}
        """Effect and label of every value."""
        self.values = values_of(full)
        """Of the model."""
        blind = dataclasses.replace(
            full, probes=Probes(np.zeros(0), np.zeros(0), np.zeros(0)), layout=full.layout._replace(probes=())
        )
        self._coefficients = 2 * len(grid.orders) - 1
        self._balance = compiled(_balance, nameless(blind), full, CHUNK)

    def make(self, conditions: Conditions) -> None:
        """Make its program, for conditions like these."""
        each = (np.asarray(values) for values in (conditions.speed, conditions.unbalance, conditions.bow))
        self._balance.make(self.values[None], *each, np.zeros((1, DOF, self._coefficients)))

    def at(
        self,
        values: Float[np.ndarray, "set param"],
        conditions: Conditions,
        motion: Float[np.ndarray, "case dof coefficient"],
        measured: Int[np.ndarray, "_"],
    ) -> Balances:
        """Along a motion at every case. **Arguments:** ``measured``: the coefficients whose equations count, and by
        which derivatives are taken.
        """
        most = max(1, MOST_ROWS // len(motion))
        parts = [
            self._at(values[first : first + most], conditions, motion, measured)
            for first in range(0, len(values), most)
        ]
        return Balances(*(np.concatenate(several) for several in zip(*parts, strict=True)))

    def _at(self, values: np.ndarray, conditions: Conditions, motion: np.ndarray, measured: np.ndarray) -> Balances:
        """In the same compiled calls."""
        cases = np.tile(np.arange(len(motion)), len(values))
        each = (np.asarray(leaf)[cases] for leaf in (conditions.speed, conditions.unbalance, conditions.bow))
        lacking_x, lacking_y, *dynamic, force, by_motion = self._balance(
            np.repeat(values, len(motion), axis=0), *each, motion[cases]
        )
        add_dynamic(by_motion, [dynamic[:2], dynamic[2:]])
        force = (force + as_coefficients(np.stack([lacking_x, lacking_y], axis=-2)))[..., measured]
        by_motion = by_motion[:, :, measured][..., measured]
        count = 2 * len(measured)
        return Balances(
            force.reshape(len(values), len(motion), count), by_motion.reshape(len(values), len(motion), count, count)
        )


def _balance(
    model: Model, values: Array, speed: Array, unbalance: Array, bow: Array, motions: Array
) -> tuple[Array, ...]:
    orders, settings = model.layout.orders, model.harmonic_balance
    grid = make_grid(orders, settings)._replace(orders=orders)
    _, unravel = ravel_pytree(model.effects)

    def row(values: Array, speed: Array, unbalance: Array, bow: Array, motion: Array) -> tuple[Vector, Matrix, Inputs]:
        at = eqx.tree_at(lambda m: m.effects, model, unravel(values))
        condition = Conditions(true_speed(at, speed), unbalance, bow)
        ready = Ready(at, condition, grid, *by_order(at, condition, grid))
        return ready.lacking(motion), ready.assembled.dynamic, ready.inputs(motion)

    lacking, dynamic, inputs = jax.vmap(row)(values, speed, unbalance, bow, motions)
    still: Any = jax.tree.map(lambda leaf: jnp.zeros((len(leaf), 0, *leaf.shape[1:]), leaf.dtype), inputs)
    forces = force_slopes(parameters_of(model)[1], model.rotor, grid, inputs, still)
    return lacking.x, lacking.y, dynamic.xx, dynamic.xy, dynamic.yx, dynamic.yy, forces.force, forces.by_motion
