"""The one forward door: from a model and its conditions to complex vibration vectors.

Without nonlinear forces every order has a closed form; with them the orders are balanced together.
"""

import dataclasses
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Complex, Float

from rotorjax.model.conditions import Conditions
from rotorjax.model.contract import AbstractRotor
from rotorjax.model.model import Model
from rotorjax.physics.assembly import Chain, assemble, point_at, true_speed
from rotorjax.physics.steady_state import coupled_vectors, is_coupled, without_coupling
from rotorjax.physics.sweep import added_by_sweep, sweeps

TOGETHER = 4
"""Cases whose orders are balanced in one go."""


def linear_vectors(model: Model, condition: Conditions) -> Complex[Array, "probe order"]:
    """Every order of one case by itself."""
    condition = dataclasses.replace(condition, speed=true_speed(model, condition.speed))
    orders = jnp.asarray(model.layout.orders, dtype=condition.speed.dtype)

    def at_order(order: Float[Array, ""], index: Array) -> Complex[Array, "probe"]:
        point = point_at(model, condition, order, index)
        chain = Chain.of(model, point)
        read = chain.sensed(model.probes, assemble(model, point).motion()) * chain.turn
        return jnp.where(order == 0.0, jnp.real(read) + 0j, read)

    return jax.vmap(at_order, out_axes=1)(orders, jnp.arange(len(orders)))


def _coupled_vectors(model: Model, condition: Conditions) -> Complex[Array, "probe order"]:
    return coupled_vectors(model, condition)[0]


def _case(
    model: Model, condition: Conditions, vectors_of: Callable[[Model, Conditions], Complex[Array, "probe order"]]
) -> Complex[Array, "probe order"]:
    """One case, less what it shows at slow roll where that was subtracted, and with what a sweep adds."""
    added = added_by_sweep(without_coupling(model), condition) if sweeps(model, condition) else 0.0
    condition = dataclasses.replace(condition, sweep=None)
    if model.slow_roll is None:
        return vectors_of(model, condition) + added
    at_speed = jax.vmap(lambda speed: vectors_of(model, Conditions(speed, condition.unbalance, condition.bow)))
    measured, rolling = at_speed(_speeds(model, condition))
    return measured - rolling + added


def vectors(model: Model, conditions: Conditions) -> Complex[Array, "case probe order"]:
    """`response` without its own compilation, for use inside other compiled functions."""
    of_case = _coupled_vectors if is_coupled(model) else linear_vectors
    if of_case is linear_vectors:
        return jax.vmap(lambda condition: _case(model, condition, of_case))(conditions)
    return _by_few(lambda condition: _case(model, condition, of_case), conditions)


def _by_few(of_case: Callable[..., Any], cases: Any) -> Any:
    """A function of one case at all cases, a few at a time: together, all would wait for the slowest of Newton's
    iterations.
    """
    count = len(jax.tree.leaves(cases)[0])
    more = -count % TOGETHER
    filled = (
        jax.tree.map(lambda leaf: jnp.concatenate([leaf, jnp.repeat(leaf[-1:], more, axis=0)]), cases)
        if more
        else cases
    )
    return jax.tree.map(lambda leaf: leaf[:count], jax.lax.map(of_case, filled, batch_size=TOGETHER))


def _speeds(model: Model, condition: Conditions) -> Float[Array, "speed"]:
    return condition.speed[None] if model.slow_roll is None else jnp.stack([condition.speed, model.slow_roll])


@eqx.filter_jit
def response(model: Model | AbstractRotor, conditions: Conditions) -> Complex[Array, "case probe order"]:
    """Steady-state vibration vectors: displacement(t) = Re[z e^{inΩt}], zero-to-peak, phase leading [m].

    z_n = reading(D_n⁻¹ F_n), D_n = K_p + inΩC + K_disk - (nΩ)²M; less the same at slow roll where the model says
    that slow roll was subtracted. Where the speed changes, the linear rotor's answer to that is added
    (`rotorjax.physics.sweep`). Differentiable in every number of model and conditions.

    **Arguments:** ``model``, or a rotor alone; ``conditions`` with one leading axis. **Returns** shape (case, probe,
    order), orders as in ``model.layout.orders``; not a number where forces are nonlinear and no steady state was
    found: `steady_states` says of every condition what was found (``result``). Without damping the response at a
    critical speed is infinite. Source: Huang et al. 2026, Sensors 26:2565, equations 1-9; Genta, Dynamics of Rotating
    Systems, 2005, chapter 2.
    """
    return vectors(model if isinstance(model, Model) else Model(model), conditions)
