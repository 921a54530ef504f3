"""The search for steady states of a rotor with nonlinear forces: followed in speed, and let go in time.

Newton's method finds the one near which it begins; so it begins with motions followed from other speeds, of several
sizes and directions, and where all that were found are unstable with what the rotor comes to when it is let go.
"""

import dataclasses
import math
import operator
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Complex, Float

from rotorjax.model.conditions import Conditions
from rotorjax.model.model import Model
from rotorjax.physics.assembly import true_speed
from rotorjax.physics.floquet import monodromy, slopes_at_gauss_points
from rotorjax.physics.harmonic_balance import Coefficients, in_full, make_grid, settled, to_complex, to_real
from rotorjax.physics.response import TOGETHER, vectors
from rotorjax.physics.restoring_forces import restoring
from rotorjax.physics.steady_state import Ready, by_order, coupled_vectors, fraction_push
from rotorjax.physics.time_integration import Linear, linear_in_time, reached

SWEEPS = (0.6, 1.5)
"""Where the steady state is followed from, in the speed of the condition: from below and from above."""
BELOW_RESONANCE = 0.8
"""From below in any case from this part of the natural frequency."""
STEPS = 40
"""Of the speed, from there to the condition."""
STARTS = (0.0, 0.3, 3.0)
"""Sizes of the free motion from which Newton's method begins at the condition itself."""
PUSHES, PHASES = (0.1, 0.3, 1.0, 3.0, 10.0, 30.0), (0.4, 0.4 + 0.5 * math.pi)
"""Sizes, in the vibration of the free motion, and phases [rad] of motions at the lowest fraction of an order with which
Newton's method begins besides.
"""
WHIRLS = ((1.0, -1.0j), (1.0, 1.0j), (1.0, 0.1j), (0.1j, 1.0))
"""Directions of these: either sense of whirl, nearly along x, nearly along y."""
DISTINCT = 1e-3
"""Difference of two motions, in the largest amplitude, from which on they are two."""
FURTHER = 1.2
"""Times the motion shown where it is unstable, from which the rotor is let go in time."""
NEAR = 0.03
"""Part of its size that may lie between a motion reached in time and the steady state that Newton's method makes of it.
"""


class Found(NamedTuple):
    """Steady states of one case; the first is that of `response`."""

    vectors: Complex[Array, "start probe order"]
    motions: Complex[Array, "start dof coefficient"]
    """Amplitudes at the orders of the grid; not a number where none was found."""
    monodromy: Float[Array, "start state state"]
    exists: Bool[Array, ""]
    rolling: Complex[Array, "probe order"]
    """Slow roll that the vectors are without."""


def _at(condition: Conditions, speed: Array) -> Conditions:
    return dataclasses.replace(condition, speed=speed)


def _shares(model: Model, condition: Conditions) -> Float[Array, "sweep"]:
    """Of the speed, from which the steady state is followed."""
    below, above = SWEEPS
    return jnp.stack(
        [jnp.minimum(below, BELOW_RESONANCE * model.rotor.natural_frequency() / condition.speed), jnp.asarray(above)]
    )


def _followed(
    model: Model, condition: Conditions, begun: Float[Array, "sweep dof coefficient"], shown: Coefficients
) -> Float[Array, "start dof coefficient"]:
    """Steady states at a condition that are reached from below and from above in speed, and from motions of several
    sizes.

    Where the grid has fractions of an order, also from the one ``shown`` with such fractions in several sizes and
    phases, and by following speeds with a push towards such fractions wherever the motion has none: where they arise
    they are then followed on.
    """
    ready = Ready.of(model, condition)
    whole = np.array([order == round(order) for order in ready.grid.orders])
    fractions = np.concatenate([whole[:1], np.repeat(whole[1:], 2)]) == 0

    def sweep(share: Array, motion: Array, pushed: Array) -> Array:
        def step(last: Array, part: Array) -> tuple[Array, None]:
            system = Ready.of(model, _at(condition, condition.speed * share ** (1.0 - part))).system
            last = jnp.where(jnp.all(jnp.isfinite(last)), last, system.free)
            lacking = jnp.max(jnp.abs(last) * fractions[None]) < DISTINCT * jnp.max(jnp.abs(system.free))
            there = settled(system, last + pushed * lacking * fraction_push(system, ready.grid))
            return jnp.where(jnp.all(jnp.isfinite(there)), there, last), None

        return jax.lax.scan(step, motion, jnp.arange(1, STEPS) / STEPS)[0]

    ways = jnp.arange(2.0 if ready.grid.turns > 1 else 1.0)
    near = jnp.concatenate(
        jax.vmap(
            lambda pushed: jax.vmap(lambda share, motion: sweep(share, motion, pushed))(
                _shares(model, condition), begun
            )
        )(ways)
    )
    system = ready.system
    push = fraction_push(system, ready.grid)
    starts = jnp.concatenate([near, jnp.asarray(STARTS)[:, None, None] * system.free[None] + push[None]])
    if ready.grid.turns > 1:
        starts = jnp.concatenate(
            [starts, jnp.where(jnp.all(jnp.isfinite(shown)), shown, system.free)[None] + _pushes(system.free)]
        )
    finer = ready.finer.system
    return jax.vmap(lambda start: settled(system, jnp.where(jnp.all(jnp.isfinite(start)), start, system.free), finer))(
        starts
    )


def _pushes(free: Coefficients) -> Float[Array, "start dof coefficient"]:
    """Motions at the lowest fraction of an order, in several sizes, phases and directions."""
    each = np.array(
        [size * np.exp(1j * phase) * np.array(whirl) for size in PUSHES for phase in PHASES for whirl in WHIRLS]
    )
    lowest = jnp.max(jnp.abs(free[:, 1:])) * jnp.asarray(np.stack([np.real(each), np.imag(each)], axis=-1))
    return jnp.zeros((len(each), *free.shape)).at[:, :, 1:3].set(lowest)


def _balanced(model: Model, condition: Conditions) -> Found:
    """Steady states of a case with nonlinear forces."""
    extra = jnp.zeros((0,)) if model.slow_roll is None else model.slow_roll[None]
    speeds = jnp.concatenate([condition.speed[None], _shares(model, condition) * condition.speed, extra])
    shown, found = jax.vmap(lambda speed: coupled_vectors(model, _at(condition, speed)))(speeds)
    rolling = jnp.zeros_like(shown[0]) if model.slow_roll is None else shown[-1]
    motions = jnp.concatenate(
        [found.coefficients[:1], _followed(model, condition, found.coefficients[1:3], found.coefficients[0])]
    )
    return _judged(Ready.of(model, condition), motions, model.layout.orders, rolling)


def _judged(
    ready: Ready,
    motions: Float[Array, "start dof coefficient"],
    orders: tuple[float, ...],
    rolling: Complex[Array, "probe order"],
) -> Found:
    """What the probes show of motions, and what becomes of their disturbances."""
    linear, fine = _linear(ready), ready.finer
    period = 2.0 * math.pi * ready.grid.turns / ready.condition.speed
    return Found(
        jax.vmap(lambda motion: ready.shown(motion, orders))(motions) - rolling[None],
        to_complex(motions),
        # One after the other, for the matrices of all steps at once would fill the memory.
        jax.lax.map(
            lambda motion: monodromy(linear, slopes_at_gauss_points(fine, in_full(fine.system, motion)), period),
            motions,
        ),
        linear.exists,
        rolling,
    )


def _linear(ready: Ready) -> Linear:
    return linear_in_time(ready.model, ready.assembled, ready.condition.speed * jnp.asarray(ready.grid.orders))


def _alone(model: Model, condition: Conditions) -> Found:
    """The only steady state of a case without such forces."""
    shown = vectors(model, jax.tree.map(lambda leaf: leaf[None], condition))
    grid = make_grid((1.0,), model.harmonic_balance)
    condition = _at(condition, true_speed(model, condition.speed))
    assembled, _ = by_order(model.with_orders(grid.orders), condition, grid)
    linear = linear_in_time(model, assembled, condition.speed * jnp.asarray(grid.orders))
    whole = monodromy(linear, jnp.zeros((2, grid.samples, 2, 2, 2)), 2.0 * math.pi / condition.speed)
    return Found(shown, jnp.zeros((1, 2, 1), complex), whole[None], linear.exists, jnp.zeros_like(shown[0]))


@eqx.filter_jit
def let_go(
    model: Model,
    conditions: Conditions,
    shown: Complex[Array, "case dof coefficient"],
    rolling: Complex[Array, "case probe order"],
) -> Found:
    """Steady states that are reached in time from near a motion ``shown``, from rest and from the motion of the linear
    rotor.
    """

    def of(
        condition: Conditions, motion: Complex[Array, "dof coefficient"], rolling: Complex[Array, "probe order"]
    ) -> Found:
        ready = Ready.of(model, condition)
        system = ready.system
        linear = _linear(ready)

        def from_one(begun: Coefficients) -> Coefficients:
            there = reached(ready, linear, begun)
            exact = settled(system, there.motion, ready.finer.system)
            lost = ~(jnp.max(jnp.abs(exact - there.motion)) <= NEAR * jnp.max(jnp.abs(there.motion)))
            return jnp.where(there.repeats & lost, there.motion, exact)

        begun = jnp.stack(
            [FURTHER * to_real(jnp.where(jnp.isfinite(motion), motion, 0.0)), jnp.zeros_like(system.free), system.free]
        )
        return _judged(ready, jax.vmap(from_one)(begun), model.layout.orders, rolling)

    return jax.vmap(of)(conditions, shown, rolling)


@eqx.filter_jit
def _found(model: Model, conditions: Conditions) -> Found:
    return jax.vmap(lambda condition: (_balanced if restoring(model) else _alone)(model, condition))(conditions)


def steady_states_found(model: Model, conditions: Conditions) -> Found:
    """Steady states of all cases; where orders depend on one another a few at a time, so that one program serves any
    number of cases.
    """
    if not restoring(model):
        return _found(model, conditions)
    count = len(conditions.speed)
    indices = [np.minimum(np.arange(first, first + TOGETHER), count - 1) for first in range(0, count, TOGETHER)]
    every = [_found(model, jax.tree.map(operator.itemgetter(index), conditions)) for index in indices]
    return jax.tree.map(lambda *parts: np.concatenate(parts)[:count], *every)
