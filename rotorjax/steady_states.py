"""Whether the steady state that `response` shows is stable, and whether there are others at the same speed.

A small disturbance δ of a periodic motion obeys M δ̈ + (C + N_v(t)) δ̇ + (K + N_q(t)) δ = 0 with the slopes N_q, N_v of the restoring
forces along it; after one period it is the monodromy matrix times what it was, and the eigenvalues of that are the Floquet
multipliers (Nayfeh, Balachandran, Applied Nonlinear Dynamics, Wiley 1995, chapter 3).
"""

import dataclasses
import math
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Complex, Float, Int

from rotorjax._core import RPM
from rotorjax._planar import Matrix
from rotorjax.assembly import Assembled, true_speed
from rotorjax.harmonic import BALANCED, NOT_BALANCED, SAMPLES, SMALLEST_MOTION, UNSTABLE, Coefficients, Grid, make_grid, settled, to_complex
from rotorjax.model import AbstractRotor, Conditions, Model, RestoringEffect, SupportEffect
from rotorjax.response import vectors
from rotorjax.steady import Ready, by_order, fraction_push, restoring, slopes_along, timed_vectors

SELF_EXCITING = ("cross_coupling", "internal_damping")
"""Effects of the linear rotor that may make it unstable."""
GROWTH, LINEAR_GROWTH = 1e-3, 1e-4
"""Of a disturbance in one period, up to which a motion counts as stable: forces with corners leave errors of the first size; the second is for
models without forces that depend on motion. A rotor without damping has multipliers of one."""
SWEEPS = (0.6, 1.5)
"""Where the steady state is followed from, in the speed of the condition: from below and from above."""
BELOW_RESONANCE = 0.8
"""From below in any case from this part of the natural frequency."""
STEPS = 40
"""Of the speed, from there to the condition."""
STARTS = (0.0, 0.3, 3.0)
"""Sizes of the free motion from which Newton's method begins at the condition itself."""
PUSHES, PHASES = (0.1, 0.3, 1.0, 3.0, 10.0, 30.0), (0.4, 0.4 + 0.5 * math.pi)
"""Sizes, in the vibration of the free motion, and phases [rad] of motions at the lowest fraction of an order with which Newton's method begins besides."""
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
    """BALANCED (0), NOT_BALANCED (1: no steady state was found) or UNSTABLE (2: the machine does not stay there), of `rotorjax.harmonic`."""
    multiplier: Float[np.ndarray, "case"]
    """Largest absolute Floquet multiplier over one period of the motion; not a number where none was found, or where an effect depends on
    frequency in a way that no equation of motion in time has."""
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
            (unstable & (stable > 0), "the steady state shown is unstable, but a stable one exists: the machine may run there instead"),
            (good & (stable == 1), "there are two stable steady states; which one is reached depends on how the speed was reached"),
            (good & (stable > 1), "there are three or more stable steady states; which one is reached depends on how the speed was reached"),
            (
                good & np.isnan(self.multiplier),
                "whether the steady state is stable is not known: an effect depends on frequency as no spring or damper does",
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


class _Linear(NamedTuple):
    """The linear rotor in time: M q̈ + C q̇ + K q = 0 for the disk, and below it the foundation where the model has a support effect."""

    inverse_mass: Float[Array, "state state"]
    damping: Float[Array, "state state"]
    stiffness: Float[Array, "state state"]
    exists: Bool[Array, ""]
    """Whether the dynamic stiffness at every order is that of these matrices."""


def _arrays(matrices: Matrix) -> Complex[Array, "order dof dof"]:
    """2x2 matrices of every order."""
    parts = jnp.broadcast_arrays(matrices.xx, matrices.xy, matrices.yx, matrices.yy)
    return jnp.stack(parts, axis=-1).reshape(-1, 2, 2) + 0j


def _inverse(matrices: Array) -> Array:
    """Of 2x2 matrices along any leading axes, in closed form."""
    a, b, c, d = matrices[..., 0, 0], matrices[..., 0, 1], matrices[..., 1, 0], matrices[..., 1, 1]
    adjugate = jnp.stack([d, -b, -c, a], axis=-1).reshape(matrices.shape)
    return adjugate / (a * d - b * c)[..., None, None]


def _linear(model: Model, assembled: Assembled, omega: Float[Array, "order"]) -> _Linear:
    """Matrices in time from the dynamic stiffness D = K_p + K + iωC - ω²M at orders from zero; K_p = (S⁻¹ + F⁻¹)⁻¹, F = (1 + iωd - ω²m) / f.

    **Arguments:** ``omega``: frequency of every order [rad/s].
    """
    path = _arrays(assembled.path)
    disk = _arrays(assembled.dynamic) - path
    last, identity = omega[-1], jnp.eye(2)
    stiffness, damping, mass = disk[0].real, disk[-1].imag / last, (disk[0] - disk[-1]).real / last**2
    iw = 1j * omega[:, None, None]
    expected = stiffness[None] + iw * damping[None] + iw**2 * mass[None]
    tolerance = 10.0 * jnp.sqrt(jnp.finfo(omega.dtype).eps)

    def alike(found: Array, there: Array) -> Array:
        return jnp.all(jnp.abs(found - there) <= tolerance * jnp.max(jnp.abs(path) + jnp.abs(there), axis=(1, 2), keepdims=True))

    exists = alike(expected, disk)
    if not any(isinstance(e, SupportEffect) for e in model.effects):
        return _Linear(_inverse(mass), damping, stiffness + path[0].real, exists & alike(path, path[:1]))
    soft = jnp.stack(jnp.broadcast_arrays(assembled.compliance.x, assembled.compliance.y, omega)[:2], axis=-1) + 0j  # order, dof
    # Compliance that is the same at every order, or none, has no motion of its own in time: it stays within the path.
    own = jnp.max(jnp.abs(soft - soft[:1]), axis=0) > tolerance * jnp.abs(soft[0])
    static = jnp.where(own, soft[0].real, 0.0)
    spring = jnp.where(own[None], soft[:1] / jnp.where(own[None], soft, 1.0), (1.0 + iw[..., 0] / last) ** 2)
    inertia, drag = (1.0 - spring[-1].real) / last**2, spring[-1].imag / last
    shaft = path[0].real @ _inverse(identity - static[:, None] * path[0].real)
    rebuilt = 1.0 + iw[..., 0] * drag[None] + iw[..., 0] ** 2 * inertia[None]
    series = identity[None] + (static[None] / rebuilt)[..., None] * shaft[None]
    exists &= alike(shaft[None] @ _inverse(series), path) & jnp.all(inertia > 0.0)
    zero = jnp.zeros((2, 2))
    return _Linear(
        jnp.block([[_inverse(mass), zero], [zero, identity / inertia[:, None]]]),
        jnp.block([[damping, zero], [zero, identity * drag[:, None]]]),
        jnp.block([[stiffness + shaft, -shaft], [-static[:, None] * shaft, identity + static[:, None] * shaft]]),
        exists,
    )


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


def _monodromy(linear: _Linear, slopes: Float[Array, "kind step point dof dof"], speed: Float[Array, ""]) -> Float[Array, "state state"]:
    """Of disturbances over one period, state (q, q̇): the product of exp(Ω) over its steps, Magnus' series to fourth order.

    Ω = h (A_1 + A_2)/2 + (√3/12) h² (A_2 A_1 - A_1 A_2), A at the two Gauss points of each step
    (Hairer, Lubich, Wanner, Geometric Numerical Integration, 2nd edition, 2006, section IV.7).
    """
    size = len(linear.stiffness)
    free = linear.inverse_mass @ linear.stiffness
    rate = jnp.maximum(jnp.sqrt(jnp.max(jnp.abs(free))), speed)  # velocities in this unit make all entries of one size
    beside = jnp.zeros((2, *slopes.shape[1:3], size, size)).at[..., :2, :2].set(slopes)
    total = jnp.stack([linear.stiffness, linear.damping])[:, None, None] + beside
    pulls = linear.inverse_mass[None, None, None] @ total
    above = jnp.broadcast_to(jnp.concatenate([jnp.zeros((size, size)), rate * jnp.eye(size)], axis=1), (*slopes.shape[1:3], size, 2 * size))
    matrices = jnp.concatenate([above, jnp.concatenate([-pulls[0] / rate, -pulls[1]], axis=-1)], axis=-2)
    step = 2.0 * math.pi / SAMPLES / speed
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


def _at(condition: Conditions, speed: Array) -> Conditions:
    return dataclasses.replace(condition, speed=speed)


def _shares(model: Model, condition: Conditions) -> Float[Array, "sweep"]:
    """Of the speed, from which the steady state is followed."""
    below, above = SWEEPS
    return jnp.stack([jnp.minimum(below, BELOW_RESONANCE * model.rotor.natural_frequency() / condition.speed), jnp.asarray(above)])


def _followed(model: Model, condition: Conditions, begun: Float[Array, "sweep dof coefficient"], shown: Coefficients) -> Float[Array, "start dof coefficient"]:
    """Steady states at a condition that are reached from below and from above in speed, and from motions of several sizes.

    Where the grid has fractions of an order, also from the one ``shown`` with such fractions in several sizes and phases, and by following
    speeds with a push towards such fractions wherever the motion has none: where they arise they are then followed on.
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
    near = jnp.concatenate(jax.vmap(lambda pushed: jax.vmap(lambda share, motion: sweep(share, motion, pushed))(_shares(model, condition), begun))(ways))
    system = ready.system
    push = fraction_push(system, ready.grid)
    starts = jnp.concatenate([near, jnp.asarray(STARTS)[:, None, None] * system.free[None] + push[None]])
    if ready.grid.turns > 1:
        starts = jnp.concatenate([starts, jnp.where(jnp.all(jnp.isfinite(shown)), shown, system.free)[None] + _pushes(system.free)])
    return jax.vmap(lambda start: settled(system, jnp.where(jnp.all(jnp.isfinite(start)), start, system.free), ready.finer))(starts)


def _pushes(free: Coefficients) -> Float[Array, "start dof coefficient"]:
    """Motions at the lowest fraction of an order, in several sizes, phases and directions."""
    each = np.array([size * np.exp(1j * phase) * np.array(whirl) for size in PUSHES for phase in PHASES for whirl in WHIRLS])
    lowest = jnp.max(jnp.abs(free[:, 1:])) * jnp.asarray(np.stack([np.real(each), np.imag(each)], axis=-1))
    return jnp.zeros((len(each), *free.shape)).at[:, :, 1:3].set(lowest)


def _balanced(model: Model, condition: Conditions) -> _Found:
    """Steady states of a case with forces that depend on motion."""
    extra = jnp.zeros((0,)) if model.slow_roll is None else model.slow_roll[None]
    speeds = jnp.concatenate([condition.speed[None], _shares(model, condition) * condition.speed, extra])
    shown, found = jax.vmap(lambda speed: timed_vectors(model, _at(condition, speed)))(speeds)
    rolling = jnp.zeros_like(shown[0]) if model.slow_roll is None else shown[-1]
    motions = jnp.concatenate([found.coefficients[:1], _followed(model, condition, found.coefficients[1:3], found.coefficients[0])])
    ready = Ready.of(model, condition)
    others = jax.vmap(lambda motion: ready.shown(motion, model.layout.orders))(motions[1:])
    linear = _linear(model, ready.assembled, ready.condition.speed * jnp.asarray(ready.grid.orders))
    return _Found(
        jnp.concatenate([shown[:1], others]) - rolling[None],
        to_complex(motions),
        jax.vmap(lambda motion: _monodromy(linear, _slopes(ready, motion), ready.condition.speed))(motions),
        linear.exists,
    )


def _slopes(ready: Ready, motion: Coefficients) -> Float[Array, "kind step point dof dof"]:
    """Of the restoring forces along a motion, at the Gauss points of every step."""
    steps = SAMPLES * ready.grid.turns
    angle = (2.0 * math.pi / SAMPLES * (np.arange(steps)[:, None] + np.array(GAUSS))).ravel()
    slopes = slopes_along(ready.model, ready.condition, ready.grid, ready.assembled, motion, angle=angle)
    return jnp.transpose(slopes, (1, 3, 0, 2)).reshape(2, steps, 2, 2, 2)


def _alone(model: Model, condition: Conditions) -> _Found:
    """The only steady state of a case without such forces."""
    shown = vectors(model, jax.tree.map(lambda leaf: leaf[None], condition))
    grid = make_grid((1.0,))
    condition = _at(condition, true_speed(model, condition.speed))
    assembled, _ = by_order(model.with_orders(grid.orders), condition, grid)
    linear = _linear(model, assembled, condition.speed * jnp.asarray(grid.orders))
    monodromy = _monodromy(linear, jnp.zeros((2, SAMPLES, 2, 2, 2)), condition.speed)
    return _Found(shown, jnp.zeros((1, 2, 1), complex), monodromy[None], linear.exists)


@eqx.filter_jit
def _found(model: Model, conditions: Conditions) -> _Found:
    return jax.vmap(lambda condition: (_balanced if restoring(model) else _alone)(model, condition))(conditions)


def _multiplier(monodromy: Float[np.ndarray, "state state"]) -> float:
    """Its largest absolute eigenvalue; infinite where the matrix is too large for its numbers."""
    return float(np.max(np.abs(np.linalg.eigvals(monodromy)))) if np.all(np.isfinite(monodromy)) else math.inf


def _same(one: Complex[np.ndarray, "dof coefficient"], other: Complex[np.ndarray, "dof coefficient"], grid: Grid) -> bool:
    """Whether two motions are one, begun in the same turn or in another of its period."""
    turned = [other * np.exp(2j * np.pi * grid.order_array * turn) for turn in range(grid.turns)]
    size = max(np.max(np.abs(one[:, 1:])), np.max(np.abs(other[:, 1:])), SMALLEST_MOTION)
    return bool(min(np.max(np.abs(one - there)) for there in turned) <= DISTINCT * size)


def _others(
    shown: Complex[np.ndarray, "start probe order"], motions: Complex[np.ndarray, "start dof coefficient"], multipliers: list[float], grid: Grid
) -> tuple[SteadyState, ...]:
    """The distinct ones among the further steady states of one case."""
    first = int(np.all(np.isfinite(motions[0])))
    kept = list(range(first))
    for k in range(1, len(motions)):
        finite = np.all(np.isfinite(motions[k])) and np.all(np.isfinite(shown[k]))
        if finite and not any(_same(motions[k], motions[j], grid) for j in kept):
            kept.append(k)
    states = [SteadyState(shown[k], multipliers[k]) for k in kept[first:]]
    return tuple(sorted(states, key=lambda state: not state.stable)[:MOST_OTHERS])


def steady_states(model: Model | AbstractRotor, conditions: Conditions) -> SteadyStates:
    """What `response` shows at every condition, whether it is stable, and which other steady states were found there.

    Stable: the largest absolute Floquet multiplier over one period, a turn of the shaft or two to four where the model has fractions of an
    order, is at most 1.001 (1.0001 without forces that depend on motion). Others are searched by following the steady state in speed from
    0.6 times the speed of the condition (0.8 times the natural frequency if that is less) and from 1.5 times, installed unbalance and bow
    unchanged, with a push towards fractions of an order where the model has any, and by Newton's method from motions of several sizes and, at
    fractions, directions; that none was found is no proof that there is none. Motion that does not repeat itself within such a period is not
    found. Without forces that depend on motion there is one steady state, which internal damping or cross-coupling can make unstable. Not
    differentiable.

    **Arguments:** ``model``, or a rotor alone; ``conditions`` with one leading axis. **Returns** `SteadyStates`.
    Source: Nayfeh, Balachandran, Applied Nonlinear Dynamics, Wiley 1995, chapter 3; for a shaft with two unequal stiffnesses
    Genta, Dynamics of Rotating Systems, Springer 2005, section 6.3.
    """
    model = model if isinstance(model, Model) else Model(model)
    shown, motions, matrices, exists = (np.asarray(part) for part in _found(model, conditions))
    timed = bool(restoring(model))
    good = np.all(np.isfinite(shown[:, 0]), axis=(1, 2)) & np.all(np.isfinite(motions[:, 0]), axis=(1, 2))
    each = [[_multiplier(matrix) if known else math.nan for matrix in case] for case, known in zip(matrices, exists, strict=True)]
    others: tuple[tuple[SteadyState, ...], ...] = ((),) * len(shown)
    if timed:
        grid = make_grid(model.layout.orders)
        others = tuple(_others(*case, grid) for case in zip(shown, motions, each, strict=True))
    multiplier = np.where(good, np.array([case[0] for case in each]), np.nan)
    result = np.where(good, np.where(multiplier > 1.0 + (GROWTH if timed else LINEAR_GROWTH), UNSTABLE, BALANCED), NOT_BALANCED)
    return SteadyStates(np.asarray(conditions.speed), shown[:, 0], result, multiplier, others)


def steadiness(model: Model, conditions: Conditions) -> list[str]:
    """Where a steady state does not exist, is unstable or is not the only one, in words; looked into where an effect may cause that."""
    suspects = any(isinstance(e, RestoringEffect) or e.name in SELF_EXCITING for e in model.effects)
    return steady_states(model, conditions).words() if suspects else []
