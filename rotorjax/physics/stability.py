"""Whether the steady state that `response` shows is stable, and whether there are others at the same speed.

A small disturbance δ of a periodic motion obeys M δ̈ + (C + N_v(t)) δ̇ + (K + N_q(t)) δ = 0 with the slopes N_q, N_v of
the restoring forces along it; after one period it is the monodromy matrix times what it was, and the eigenvalues of
that are the Floquet multipliers (Nayfeh, Balachandran, Applied Nonlinear Dynamics, Wiley 1995, chapter 3).
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
from jaxtyping import Bool, Complex, Float, Int

from rotorjax.model.conditions import Conditions
from rotorjax.model.contract import AbstractRotor, RestoringEffect
from rotorjax.model.model import Model
from rotorjax.physics.assembly import true_speed
from rotorjax.physics.harmonic_balance import (
    BALANCED,
    NOT_BALANCED,
    SAMPLES,
    SMALLEST_MOTION,
    UNSTABLE,
    Coefficients,
    Grid,
    in_full,
    make_grid,
    settled,
    to_complex,
    to_real,
)
from rotorjax.physics.response import TOGETHER, vectors
from rotorjax.physics.restoring_forces import restoring
from rotorjax.physics.steady_state import Ready, by_order, fraction_push, slopes_along, timed_vectors
from rotorjax.physics.time_integration import Linear, linear_in_time, reached
from rotorjax.units import RPM

SELF_EXCITING = ("cross_coupling", "internal_damping")
"""Effects of the linear rotor that may make it unstable."""
GROWTH, LINEAR_GROWTH = 1e-3, 1e-4
"""Of a disturbance in one period, up to which a motion counts as stable: forces with corners leave errors of the first
size; the second is for models without forces that depend on motion. A rotor without damping has multipliers of one.
"""
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
MOST_OTHERS = 3
"""Further steady states that are reported per condition."""
MOST_LISTED = 4
"""Speeds that a line of words lists one by one."""
TERMS, HALVINGS = 10, 8
"""Of the exponential: Taylor series of 2⁻⁸ of the argument, squared eight times."""
FURTHER = 1.2
"""Times the motion shown where it is unstable, from which the rotor is let go in time."""
NEAR = 0.03
"""Part of its size that may lie between a motion reached in time and the steady state that Newton's method makes of it.
"""
BATCH = 8
"""Cases that are followed in time at once."""
GAUSS = 0.5 - math.sqrt(3.0) / 6.0, 0.5 + math.sqrt(3.0) / 6.0
"""Instants of a step at which the slopes are taken."""


class SteadyState(NamedTuple):
    """One steady state of one case."""

    vectors: Complex[np.ndarray, "probe order"]
    """As `response` gives them [m]."""
    multiplier: float
    """Largest absolute Floquet multiplier over one period; not a number where stability cannot be judged."""

    @property
    def stable(self) -> bool:
        """Whether disturbances of the motion die away."""
        return self.multiplier <= 1.0 + GROWTH


class SteadyStates(NamedTuple):
    """What `response` shows, whether the machine stays there, and where else it may run."""

    speed: Float[np.ndarray, "case"]
    """Ω as tabulated [rad/s]."""
    vectors: Complex[np.ndarray, "case probe order"]
    """The same as from `response` [m]."""
    result: Int[np.ndarray, "case"]
    """BALANCED (0), NOT_BALANCED (1: no steady state was found) or UNSTABLE (2: the machine does not stay there), of
    `rotorjax.physics.harmonic_balance`.
    """
    multiplier: Float[np.ndarray, "case"]
    """Largest absolute Floquet multiplier over one period of the motion; not a number where none was found, or where an
    effect depends on frequency in a way that no equation of motion in time has.
    """
    others: tuple[tuple[SteadyState, ...], ...]
    """Per case further steady states at the same speed, stable ones first."""

    def words(self) -> list[str]:
        """What is not as it should be, one line for each kind; none where all is well."""
        stable = np.array([sum(other.stable for other in others) for others in self.others], int)
        missing, unstable, good = (self.result == code for code in (NOT_BALANCED, UNSTABLE, BALANCED))
        kinds = (
            (missing & (stable == 0), "no steady state was found"),
            (missing & (stable > 0), "no steady state is shown, but following it from other speeds found a stable one"),
            (unstable & (stable == 0), "the steady state is unstable: the machine does not stay there"),
            (
                unstable & (stable > 0),
                "the steady state shown is unstable, but a stable one exists: the machine may run there instead",
            ),
            (
                good & (stable == 1),
                "there are two stable steady states; which one is reached depends on how the speed was reached",
            ),
            (
                good & (stable > 1),
                "there are three or more stable steady states; which one is reached depends on how the speed was "
                "reached",
            ),
            (
                good & np.isnan(self.multiplier),
                "whether the steady state is stable is not known: an effect depends on frequency as no spring or "
                "damper does",
            ),
        )
        return [f"At {self._where(there)} {what}." for there, what in kinds if np.any(there)]

    def _where(self, there: Bool[np.ndarray, "case"]) -> str:
        """Number of conditions, and their speeds in rpm."""
        speeds = sorted({f"{speed / RPM:.0f}": speed for speed in self.speed[there]}.items(), key=lambda item: item[1])
        shown = [text for text, _ in speeds]
        each = [part for part in (", ".join(shown[:-1]), shown[-1]) if part]
        listed = " and ".join(each) if len(shown) <= MOST_LISTED else f"{shown[0]} to {shown[-1]}"
        if len(self.speed) == 1:
            return f"{listed} rpm"
        return f"{np.sum(there)} of {len(self.speed)} conditions (speed{'s' if len(shown) > 1 else ''} {listed} rpm)"


def _exponential(matrices: Float[Array, "step state state"]) -> Float[Array, "step state state"]:
    """Of each, by Taylor series and squaring: no factorisation."""
    small, identity = matrices / 2.0**HALVINGS, jnp.eye(matrices.shape[-1])[None]
    inner = identity
    for k in range(TERMS, 1, -1):
        inner = identity + small @ inner / k
    less = small @ inner  # the identity is left out, so that rounding errors do not grow with the squarings
    for _ in range(HALVINGS):
        less = 2.0 * less + less @ less
    return identity + less


def _monodromy(
    linear: Linear, slopes: Float[Array, "kind step point dof dof"], period: Float[Array, ""]
) -> Float[Array, "state state"]:
    """Of disturbances over one ``period`` [s], state (q, q̇): the product of exp(Ω) over its steps, Magnus' series to
    fourth order.

    Ω = h (A_1 + A_2)/2 + (√3/12) h² (A_2 A_1 - A_1 A_2), A at the two Gauss points of each step
    (Hairer, Lubich, Wanner, Geometric Numerical Integration, 2nd edition, 2006, section IV.7).
    """
    size = len(linear.stiffness)
    free = linear.inverse_mass @ linear.stiffness
    rate = jnp.maximum(
        jnp.sqrt(jnp.max(jnp.abs(free))), 2.0 * math.pi / period
    )  # velocities in this unit make all entries of one size
    beside = jnp.zeros((2, *slopes.shape[1:3], size, size)).at[..., :2, :2].set(slopes)
    total = jnp.stack([linear.stiffness, linear.damping])[:, None, None] + beside
    pulls = linear.inverse_mass[None, None, None] @ total
    above = jnp.broadcast_to(
        jnp.concatenate([jnp.zeros((size, size)), rate * jnp.eye(size)], axis=1), (*slopes.shape[1:3], size, 2 * size)
    )
    matrices = jnp.concatenate([above, jnp.concatenate([-pulls[0] / rate, -pulls[1]], axis=-1)], axis=-2)
    step = period / slopes.shape[1]
    first, second = matrices[:, 0], matrices[:, 1]
    magnus = 0.5 * step * (first + second) + math.sqrt(3.0) / 12.0 * step**2 * (second @ first - first @ second)
    product = _exponential(magnus)
    while len(product) % 2 == 0:
        product = product[1::2] @ product[::2]
    whole = product[0]
    for after in product[1:]:
        whole = after @ whole
    return whole


class _Found(NamedTuple):
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


def _balanced(model: Model, condition: Conditions) -> _Found:
    """Steady states of a case with forces that depend on motion."""
    extra = jnp.zeros((0,)) if model.slow_roll is None else model.slow_roll[None]
    speeds = jnp.concatenate([condition.speed[None], _shares(model, condition) * condition.speed, extra])
    shown, found = jax.vmap(lambda speed: timed_vectors(model, _at(condition, speed)))(speeds)
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
) -> _Found:
    """What the probes show of motions, and what becomes of their disturbances."""
    linear, fine = _linear(ready), ready.finer
    period = 2.0 * math.pi * ready.grid.turns / ready.condition.speed
    return _Found(
        jax.vmap(lambda motion: ready.shown(motion, orders))(motions) - rolling[None],
        to_complex(motions),
        # One after the other, for the matrices of all steps at once would fill the memory.
        jax.lax.map(lambda motion: _monodromy(linear, _slopes(fine, in_full(fine.system, motion)), period), motions),
        linear.exists,
        rolling,
    )


def _linear(ready: Ready) -> Linear:
    return linear_in_time(ready.model, ready.assembled, ready.condition.speed * jnp.asarray(ready.grid.orders))


def _slopes(ready: Ready, motion: Coefficients) -> Float[Array, "kind step point dof dof"]:
    """Of the restoring forces along a motion, at the Gauss points of every step."""
    samples = ready.grid.samples
    steps = samples * ready.grid.turns
    angle = (2.0 * math.pi / samples * (np.arange(steps)[:, None] + np.array(GAUSS))).ravel()
    slopes = slopes_along(ready.model, ready.condition, ready.grid, ready.assembled, motion, angle=angle)
    return jnp.transpose(slopes, (1, 3, 0, 2)).reshape(2, steps, 2, 2, 2)


def _alone(model: Model, condition: Conditions) -> _Found:
    """The only steady state of a case without such forces."""
    shown = vectors(model, jax.tree.map(lambda leaf: leaf[None], condition))
    grid = make_grid((1.0,))
    condition = _at(condition, true_speed(model, condition.speed))
    assembled, _ = by_order(model.with_orders(grid.orders), condition, grid)
    linear = linear_in_time(model, assembled, condition.speed * jnp.asarray(grid.orders))
    monodromy = _monodromy(linear, jnp.zeros((2, SAMPLES, 2, 2, 2)), 2.0 * math.pi / condition.speed)
    return _Found(shown, jnp.zeros((1, 2, 1), complex), monodromy[None], linear.exists, jnp.zeros_like(shown[0]))


@eqx.filter_jit
def _let_go(
    model: Model,
    conditions: Conditions,
    shown: Complex[Array, "case dof coefficient"],
    rolling: Complex[Array, "case probe order"],
) -> _Found:
    """Steady states that are reached in time from near a motion ``shown``, from rest and from the motion of the linear
    rotor.
    """

    def of(
        condition: Conditions, motion: Complex[Array, "dof coefficient"], rolling: Complex[Array, "probe order"]
    ) -> _Found:
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
def _found(model: Model, conditions: Conditions) -> _Found:
    return jax.vmap(lambda condition: (_balanced if restoring(model) else _alone)(model, condition))(conditions)


def _all_found(model: Model, conditions: Conditions) -> _Found:
    """Steady states of all cases; where orders depend on one another a few at a time, so that one program serves any
    number of cases.
    """
    if not restoring(model):
        return _found(model, conditions)
    count = len(conditions.speed)
    indices = [np.minimum(np.arange(first, first + TOGETHER), count - 1) for first in range(0, count, TOGETHER)]
    every = [_found(model, jax.tree.map(operator.itemgetter(index), conditions)) for index in indices]
    return jax.tree.map(lambda *parts: np.concatenate(parts)[:count], *every)


def _multiplier(monodromy: Float[np.ndarray, "state state"]) -> float:
    """Its largest absolute eigenvalue; infinite where the matrix is too large for its numbers."""
    return float(np.max(np.abs(np.linalg.eigvals(monodromy)))) if np.all(np.isfinite(monodromy)) else math.inf


def _same(
    one: Complex[np.ndarray, "dof coefficient"], other: Complex[np.ndarray, "dof coefficient"], grid: Grid
) -> bool:
    """Whether two motions are one, begun in the same turn or in another of its period."""
    turned = [other * np.exp(2j * np.pi * grid.order_array * turn) for turn in range(grid.turns)]
    size = max(np.max(np.abs(one[:, 1:])), np.max(np.abs(other[:, 1:])), SMALLEST_MOTION)
    return bool(min(np.max(np.abs(one - there)) for there in turned) <= DISTINCT * size)


class _Case(NamedTuple):
    """Steady states of one case, as in `_Found`."""

    vectors: Complex[np.ndarray, "start probe order"]
    motions: Complex[np.ndarray, "start dof coefficient"]
    multipliers: tuple[float, ...]
    """Not a number where no equation of motion in time is known."""

    @classmethod
    def of(cls, found: _Found) -> "_Case":
        """Of one case of what was found."""
        multipliers = (_multiplier(matrix) if found.exists else math.nan for matrix in np.asarray(found.monodromy))
        return cls(np.asarray(found.vectors), np.asarray(found.motions), tuple(multipliers))

    def there(self, number: int) -> bool:
        """Whether such a steady state was found."""
        return bool(np.all(np.isfinite(self.motions[number])) and np.all(np.isfinite(self.vectors[number])))

    @property
    def restless(self) -> bool:
        """Whether nothing was found in which the machine would stay, although that could be told."""
        told = [self.multipliers[k] for k in range(len(self.motions)) if self.there(k)]
        return not np.any(np.isnan(self.multipliers)) and all(multiplier > 1.0 + GROWTH for multiplier in told)

    def joined(self, other: "_Case") -> "_Case":
        """With further ones."""
        vectors, motions = np.concatenate([self.vectors, other.vectors]), np.concatenate([self.motions, other.motions])
        return _Case(vectors, motions, self.multipliers + other.multipliers)

    def others(self, grid: Grid) -> tuple[SteadyState, ...]:
        """The distinct ones beside the first."""
        first = int(np.all(np.isfinite(self.motions[0])))
        kept = list(range(first))
        for k in range(1, len(self.motions)):
            if self.there(k) and not any(_same(self.motions[k], self.motions[j], grid) for j in kept):
                kept.append(k)
        states = [SteadyState(self.vectors[k], self.multipliers[k]) for k in kept[first:]]
        return tuple(sorted(states, key=lambda state: not state.stable)[:MOST_OTHERS])


def _cases(found: _Found) -> list[_Case]:
    """One by one."""
    each = (_Found(*parts) for parts in zip(*(np.asarray(part) for part in found), strict=True))
    return [_Case.of(one) for one in each]


def _settling(model: Model, conditions: Conditions, found: _Found, cases: list[_Case]) -> list[_Case]:
    """The cases, with what the machine comes to in time where nothing stable was found."""
    after, restless = list(cases), np.flatnonzero([case.restless for case in cases])
    for first in range(0, len(restless), BATCH):
        # The last batch is filled up, so that one program serves all.
        index = restless[np.minimum(np.arange(first, first + BATCH), len(restless) - 1)]
        chosen = jax.tree.map(operator.itemgetter(index), conditions)
        let_go = _let_go(model, chosen, found.motions[index, 0], found.rolling[index])
        for k, more in zip(index, _cases(let_go), strict=True):
            after[k] = cases[k].joined(more)
    return after


def steady_states(model: Model | AbstractRotor, conditions: Conditions) -> SteadyStates:
    """What `response` shows at every condition, whether it is stable, and which other steady states were found there.

    Stable: the largest absolute Floquet multiplier over one period, a turn of the shaft or two to four where the model
    has fractions of an order, is at most 1.001 (1.0001 without forces that depend on motion). Others are searched by
    following the steady state in speed from
    0.6 times the speed of the condition (0.8 times the natural frequency if that is less) and from 1.5 times, installed
    unbalance and bow unchanged, with a push towards fractions of an order where the model has any, and by Newton's
    method from motions of several sizes and, at fractions, directions; where nothing stable was found so, by
    integration in time over 200 turns from near the motion shown, from rest and from the motion of the linear rotor.
    That none was found is no proof that there is none. Motion that does not repeat itself within such a period is not
    found. Without forces that depend on motion there is one steady state, which internal damping or cross-coupling can
    make unstable. Not differentiable.

    **Arguments:** ``model``, or a rotor alone; ``conditions`` with one leading axis. **Returns** `SteadyStates`.
    Source: Nayfeh, Balachandran, Applied Nonlinear Dynamics, Wiley 1995, chapter 3; for a shaft with two unequal
    stiffnesses Genta, Dynamics of Rotating Systems, Springer 2005, section 6.3.
    """
    model = model if isinstance(model, Model) else Model(model)
    found, timed = _all_found(model, conditions), bool(restoring(model))
    cases = _cases(found)
    others: tuple[tuple[SteadyState, ...], ...] = ((),) * len(cases)
    if timed:
        grid = make_grid(model.layout.orders)
        others = tuple(case.others(grid) for case in _settling(model, conditions, found, cases))
    good = np.array([case.there(0) for case in cases], bool)
    multiplier = np.where(good, np.array([case.multipliers[0] for case in cases]), np.nan)
    result = np.where(
        good, np.where(multiplier > 1.0 + (GROWTH if timed else LINEAR_GROWTH), UNSTABLE, BALANCED), NOT_BALANCED
    )
    return SteadyStates(np.asarray(conditions.speed), np.asarray(found.vectors)[:, 0], result, multiplier, others)


def steadiness(model: Model, conditions: Conditions) -> list[str]:
    """Where a steady state does not exist, is unstable or is not the only one, in words; looked into where an effect
    may cause that.
    """
    suspects = any(isinstance(e, RestoringEffect) or e.name in SELF_EXCITING for e in model.effects)
    return steady_states(model, conditions).words() if suspects else []
