"""The rotor without nonlinear forces, and its measuring chain, at any number of conditions.

One program serves every model, measurement and number of conditions: its shape depends on the probes, the orders and
the number of planes.
"""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Complex, Float

from rotorjax.arrays import numpy_pair
from rotorjax.effects import CATALOG
from rotorjax.inference.programs import LINEAR_CHUNK, compiled, nameless
from rotorjax.model.conditions import Conditions
from rotorjax.model.contract import RestoringEffect, SweepEffect, WaveformEffect
from rotorjax.model.model import Model
from rotorjax.physics.assembly import true_speed
from rotorjax.physics.harmonic_balance import grid_of, to_real
from rotorjax.physics.planar import Vector
from rotorjax.physics.response import linear_vectors
from rotorjax.physics.steady_state import by_order, in_space, positions, without_coupling
from rotorjax.physics.sweep import added_by_sweep


class ProbeMap(NamedTuple):
    """How the probes see the disk: z / turn = along q + rest."""

    along: Complex[np.ndarray, "case order probe dof"]
    rest: Complex[np.ndarray, "case order probe"]
    turn: Complex[np.ndarray, "case order"]
    free: Float[np.ndarray, "case dof coefficient"]
    """Motion of the linear rotor."""
    speed: Float[np.ndarray, "case"]
    """What the rotor turns at, where the speed read is off."""


def with_null_linear_effects(model: Model) -> Model:
    """The model without nonlinear forces, with all linear effects of the catalogue: the compiled code is
    then the same for every model.
    """
    linear = (cls for cls in CATALOG.values() if not issubclass(cls, RestoringEffect | WaveformEffect))
    return without_coupling(model).with_null_effects(linear)


class LinearRotor:
    """A model in company of all linear effects of the catalogue, which are at their null where it does
    not have them.
    """

    def __init__(self, model: Model) -> None:
        full = with_null_linear_effects(model)
        self._slow_roll = None if model.slow_roll is None else float(model.slow_roll)
        self._rotor, self._swept = (
            compiled(kernel, nameless(full), full, LINEAR_CHUNK) for kernel in (_linear_rotor, _sweep_of_rotor)
        )
        self._rate = sum(float(e.added_sweep()) for e in model.effects if isinstance(e, SweepEffect))

    def make(self, conditions: Conditions) -> None:
        """Make its program, for conditions like these."""
        self._rotor.make(*(np.asarray(v) for v in (conditions.speed, conditions.unbalance, conditions.bow)))

    def sight(self, conditions: Conditions) -> ProbeMap:
        """How the probes see the disk at each of these conditions."""
        return ProbeMap(*self._at(conditions)[2:])

    def vectors(self, conditions: Conditions) -> Complex[np.ndarray, "case probe order"]:
        """`rotorjax.physics.response` [m]."""
        return self._above_slow_roll(conditions, 0)

    def sensitivity(self, conditions: Conditions) -> Float[np.ndarray, "case probe order 2 4"]:
        """Derivative of real and imaginary parts by (U_x, U_y, s_x, s_y) on the disk [m per kg m, m per m]."""
        return np.moveaxis(numpy_pair(self._above_slow_roll(conditions, 1)), 1, -1)

    def at_slow_roll(self, conditions: Conditions) -> Complex[np.ndarray, "case probe order"] | float:
        """The vectors at slow roll, if those were subtracted."""
        return 0.0 if self._slow_roll is None else self._at(conditions, self._slow_roll)[0]

    def added_by_sweep(self, conditions: Conditions) -> Complex[np.ndarray, "case probe order"] | float:
        """What a changing speed adds to the vectors, if it changes."""
        return self._of_sweep(conditions, 0)

    def _of_sweep(self, conditions: Conditions, part: int) -> np.ndarray | float:
        if not np.any(conditions.sweeps + self._rate):
            return 0.0
        every = (conditions.speed, conditions.unbalance, conditions.bow, conditions.sweeps)
        return self._swept(*(np.asarray(values) for values in every))[part]

    def _above_slow_roll(self, conditions: Conditions, part: int) -> np.ndarray:
        shown = self._at(conditions)[part] + self._of_sweep(conditions, part)
        return shown if self._slow_roll is None else shown - self._at(conditions, self._slow_roll)[part]

    def _at(self, conditions: Conditions, speed: float | None = None) -> list[np.ndarray]:
        speeds = np.asarray(conditions.speed) if speed is None else np.full(np.shape(conditions.speed), speed)
        return self._rotor(speeds, np.asarray(conditions.unbalance), np.asarray(conditions.bow))


def _on_disk(vectors: Callable[[Model, Conditions], Array], model: Model, at: Conditions) -> Array:
    """Derivative of vectors by (U_x, U_y, s_x, s_y) on the disk."""
    on_disk = eqx.tree_at(lambda m: m.participation, model, jnp.ones_like(model.participation))

    def driven(fault: Float[Array, "4"]) -> Complex[Array, "probe order"]:
        unbalance = jnp.zeros_like(at.unbalance).at[0].set(fault[:2])
        return vectors(on_disk, Conditions(at.speed, unbalance, fault[2:], at.sweep))

    _, push = jax.linearize(driven, jnp.zeros(4))
    return jax.vmap(push)(jnp.eye(4))


def _sweep_of_rotor(model: Model, *conditions: Array) -> tuple[Array, ...]:
    def row(*condition: Array) -> tuple[Array, ...]:
        at = Conditions(*condition)
        return added_by_sweep(model, at), _on_disk(added_by_sweep, model, at)

    return jax.vmap(row)(*conditions)


def _linear_rotor(model: Model, speed: Array, unbalance: Array, bow: Array) -> tuple[Array, ...]:
    grid = grid_of(model)
    index = np.array(positions(model.layout.orders, grid))
    whole = model.with_orders(grid.orders)

    def row(speed: Array, unbalance: Array, bow: Array) -> tuple[Array, ...]:
        at = Conditions(speed, unbalance, bow)
        turning = true_speed(model, speed)
        assembled, chain = by_order(whole, Conditions(turning, unbalance, bow), grid)
        sensed = jax.vmap(lambda part, link, disk: link.sensed(whole.probes, part.motion_of(disk)))
        zero, unit = jnp.zeros(len(grid.orders), complex), jnp.ones(len(grid.orders), complex)
        rest = sensed(assembled, chain, Vector(zero, zero))
        along = jnp.stack(
            [sensed(assembled, chain, disk) - rest for disk in (Vector(unit, zero), Vector(zero, unit))], axis=-1
        )
        turn = chain.turn + zero
        free = to_real(in_space(assembled.motion().disk))
        vectors, by_fault = linear_vectors(model, at), _on_disk(linear_vectors, model, at)
        return vectors, by_fault, along[index], rest[index], turn[index], free, turning

    return jax.vmap(row)(speed, unbalance, bow)
