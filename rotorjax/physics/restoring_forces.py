"""Nonlinear forces, as coefficients of their orders along a motion, and the slopes of those.

Alternating frequency and time: the motion is put together at instants of one period, the force is taken there, and
analysed.
"""

import functools
import operator
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.custom_derivatives import SymbolicZero
from jax.flatten_util import ravel_pytree
from jaxtyping import Bool, Complex, Float

from rotorjax.model.contract import AbstractRotor, Instant, RestoringEffect
from rotorjax.model.model import Model
from rotorjax.physics.harmonic_balance import Coefficients, Grid
from rotorjax.physics.planar import Vector

EffectOf = Callable[[Float[Array, "param"]], RestoringEffect]
"""From parameters in a row to the effect."""
Result = TypeVar("Result")


class Inputs(NamedTuple):
    """What the coefficients of the restoring force have derivatives by."""

    own: tuple[Float[Array, "param"], ...]
    """Parameters of every effect."""
    speed: Float[Array, ""]
    motion: Coefficients
    bow: Vector
    """Complex amplitude of every order."""


class Moment(NamedTuple):
    """What the force of an effect at one instant has derivatives by; as an array of many, the last axis counts
    instants.
    """

    position: Float[Array, "dof"]
    velocity: Float[Array, "dof"]
    bow: Float[Array, "dof"]
    speed: Float[Array, ""]


Forces = Callable[[tuple[Array, ...], Moment, Array], Float[Array, "dof"]]
"""Parameters, moment, shaft angle -> sum of the forces of all effects."""


def sum_of(effects: tuple[EffectOf, ...], rotor: AbstractRotor) -> Forces:
    """The sum of the forces of some effects at one instant."""

    def at(own: tuple[Array, ...], moment: Moment, angle: Array) -> Array:
        instant = Instant(rotor, moment.speed, angle, moment.position, moment.velocity, moment.position - moment.bow)
        forces = (effect_of(values).force(instant) for effect_of, values in zip(effects, own, strict=True))
        return functools.reduce(operator.add, forces, jnp.zeros(2))

    return at


def moments_of(inputs: Inputs, grid: Grid, angle: Float[np.ndarray, "instant"] | None = None) -> Moment:
    """What forces depend on at shaft angles, by default at the instants of the grid."""
    at = grid.angle if angle is None else angle
    synthesis, rate = (jnp.asarray(m) for m in (grid.synthesis(at), grid.slope(at)))
    bow = jnp.stack(_waves_of(inputs.bow, grid, at))
    return Moment(inputs.motion @ synthesis, inputs.speed * inputs.motion @ rate, bow, inputs.speed)


def _waves_of(
    amplitudes: Vector, grid: Grid, angle: Float[np.ndarray, "instant"]
) -> tuple[Float[Array, "instant"], Float[Array, "instant"]]:
    """Both directions at shaft angles."""
    return waveform(amplitudes.x, grid, angle), waveform(amplitudes.y, grid, angle)


def waveform(
    amplitudes: Complex[Array, "*many order"], grid: Grid, angle: Float[np.ndarray, "instant"]
) -> Float[Array, "*many instant"]:
    """Re Σ a_n e^{inφ} at shaft angles."""
    phase = np.outer(grid.order_array, angle)
    return amplitudes.real @ jnp.asarray(np.cos(phase)) - amplitudes.imag @ jnp.asarray(np.sin(phase))


EVERY = Moment(-1, -1, -1, None)  # pyright: ignore
"""Which parts of a moment have an axis of instants."""


@functools.partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def coefficients_of(effects: tuple[EffectOf, ...], grid: Grid, inputs: Inputs, rotor: AbstractRotor) -> Coefficients:
    """Coefficients of the sum of all forces.

    What derivatives need, few slopes at every instant, is analysed once for all directions in which they are wanted.
    """
    along = jax.vmap(sum_of(effects, rotor), in_axes=(None, EVERY, -1), out_axes=-1)
    return along(inputs.own, moments_of(inputs, grid), jnp.asarray(grid.angle)) @ jnp.asarray(grid.analysis())


@functools.partial(coefficients_of.defjvp, symbolic_zeros=True)
def _(
    effects: tuple[EffectOf, ...], grid: Grid, primals: tuple[Any, ...], tangents: tuple[Any, ...]
) -> tuple[Array, Array]:
    inputs, rotor = primals
    moved: Inputs = tangents[0]
    synthesis, rate = (jnp.asarray(m) for m in (grid.synthesis(grid.angle), grid.slope(grid.angle)))
    by = _by_moment(effects, grid, inputs, rotor)
    change = jnp.zeros((2, len(grid.angle)))
    if not _is_zero(moved.motion):
        change += _along(by.position, *(moved.motion @ synthesis)) + _along(
            by.velocity, *(inputs.speed * moved.motion @ rate)
        )
    if not (_is_zero(moved.bow.x) and _is_zero(moved.bow.y)):
        bow = jax.tree.map(
            lambda t, value: jnp.zeros_like(value) if _is_zero(t) else t, moved.bow, inputs.bow, is_leaf=_is_zero
        )
        change += _along(by.bow, *_waves_of(bow, grid, grid.angle))
    if not _is_zero(moved.speed):
        change += (_along(by.velocity, *(inputs.motion @ rate)) + by.speed) * moved.speed
    by_rotor = jax.tree.map(lambda t: None if _is_zero(t) else t, tangents[1], is_leaf=_is_zero)
    if jax.tree.leaves(by_rotor):
        wanted, rest = eqx.partition(rotor, jax.tree.map(lambda t: not _is_zero(t), tangents[1], is_leaf=_is_zero))

        def of_rotor(part: AbstractRotor) -> Array:
            return _at_instants(sum_of(effects, eqx.combine(part, rest)), grid, inputs, inputs.own)

        change += jax.jvp(of_rotor, (wanted,), (by_rotor,))[1]
    after = change @ jnp.asarray(grid.analysis())
    for k, tangent in enumerate(moved.own):
        if not _is_zero(tangent):
            after += jnp.einsum("dpb,p->db", _by_own(effects, grid, inputs, rotor, k), tangent)
    return coefficients_of(effects, grid, inputs, rotor), after


def _at_instants(of_instant: Callable[..., Any], grid: Grid, inputs: Inputs, own: Any) -> Any:
    """Something of own parameters, moment and angle at every instant of the grid; the last axis counts those."""
    return jax.vmap(of_instant, in_axes=(None, EVERY, -1), out_axes=-1)(
        own, moments_of(inputs, grid), jnp.asarray(grid.angle)
    )


def _by_moment(effects: tuple[EffectOf, ...], grid: Grid, inputs: Inputs, rotor: AbstractRotor) -> Moment:
    """Derivatives of the sum of all forces by what it depends on, at every instant."""
    return _at_instants(jax.jacfwd(sum_of(effects, rotor), argnums=1), grid, inputs, inputs.own)


def _by_own(
    effects: tuple[EffectOf, ...], grid: Grid, inputs: Inputs, rotor: AbstractRotor, k: int
) -> Float[Array, "dof param coefficient"]:
    """Derivatives of the coefficients of one force by its own parameters: analysed once for all directions in which
    they are wanted.
    """
    single = sum_of(effects[k : k + 1], rotor)
    by_own = jax.jacfwd(lambda own, at, angle: single((own,), at, angle))
    return _at_instants(by_own, grid, inputs, inputs.own[k]) @ jnp.asarray(grid.analysis())


def _along(
    slopes: Float[Array, "dof dof instant"], x: Float[Array, "instant"], y: Float[Array, "instant"]
) -> Float[Array, "dof instant"]:
    return slopes[:, 0] * x[None] + slopes[:, 1] * y[None]


def _with_those(
    present: Bool[Array, "effect"],
    branches: Sequence[Callable[..., Result]],
    total: Result,
    *operands: Any,
) -> Result:
    """A total to which every effect that is present has added its own: what is at its null costs nothing."""
    counted = jnp.cumsum(present)

    def add(k: Array, total: Result) -> Result:
        return jax.lax.switch(jnp.argmax(counted > k), branches, total, *operands)

    return jax.lax.fori_loop(0, counted[-1], add, total)


def forces_of_rows(
    effects: Sequence[EffectOf], rotor: AbstractRotor, grid: Grid, inputs: Inputs
) -> Float[Array, "row dof coefficient"]:
    """Coefficients of the sum of all forces in many rows; an effect that is at its null in all of them
    is passed over.
    """
    if not effects:
        return jnp.zeros_like(inputs.motion)

    def added(k: int, effect: EffectOf) -> Callable[[Array, Inputs], Array]:
        def row(one: Inputs) -> Array:
            return _at_instants(sum_of((effect,), rotor), grid, one, one.own[k : k + 1])

        return lambda total, inputs: total + jax.vmap(row)(inputs)

    present = jnp.stack([jnp.any(own != 0.0) for own in inputs.own])
    branches = [added(k, effect) for k, effect in enumerate(effects)]
    nothing = jnp.zeros((len(inputs.motion), 2, len(grid.angle)))
    return _with_those(present, branches, nothing, inputs) @ jnp.asarray(grid.analysis())


class ForceSlopes(NamedTuple):
    """The coefficients of the sum of all forces along motions, and how they change."""

    force: Float[Array, "row dof coefficient"]
    by_motion: Float[Array, "row dof coefficient dof coefficient"]
    change: Float[Array, "row column dof coefficient"]
    """With changes of parameters, of speed and of bow, the motion left as it is."""


def force_slopes(
    effects: Sequence[EffectOf], rotor: AbstractRotor, grid: Grid, inputs: Inputs, moved: Inputs
) -> ForceSlopes:
    """Forces of many rows, with all their slopes from one evaluation at every instant.

    An effect that is at its null in all rows and stays there is passed over. **Arguments:** ``inputs`` with a leading
    axis that counts rows; ``moved``: changes of them with a further one that counts columns, if there are any, but for
    the motion.
    """
    motion = inputs.motion.shape
    none = ForceSlopes(
        jnp.zeros(motion), jnp.zeros((*motion, *motion[1:])), jnp.zeros((*moved.speed.shape, *motion[1:]))
    )
    if not effects:
        return none
    present = jnp.stack(
        [jnp.any(own != 0.0) | jnp.any(begun != 0.0) for own, begun in zip(inputs.own, moved.own, strict=True)]
    )

    def those(inputs: Inputs, moved: Inputs) -> ForceSlopes:
        branches = [functools.partial(_with_effect, k, effect, rotor, grid) for k, effect in enumerate(effects)]
        at, by_own = _with_those(present, branches, (_nothing(inputs, grid), none.change), inputs, moved)
        force, by_motion = jax.vmap(functools.partial(_analysed_slopes, grid))(inputs._replace(own=()), at)
        return ForceSlopes(force, by_motion, by_own + _with_speed_and_bow(grid, inputs, at, moved))

    return jax.lax.cond(jnp.any(present), those, lambda *_: none, inputs, moved)


class _AtInstants(NamedTuple):
    """Forces at every instant of the grid, and their slopes there."""

    force: Float[Array, "row dof instant"]
    by: Moment


def _nothing(inputs: Inputs, grid: Grid) -> _AtInstants:
    zero, one = (
        jnp.zeros((len(inputs.motion), 2, len(grid.angle))),
        jnp.zeros((len(inputs.motion), 2, 2, len(grid.angle))),
    )
    return _AtInstants(zero, Moment(one, one, one, zero))


def _with_effect(
    k: int,
    effect: EffectOf,
    rotor: AbstractRotor,
    grid: Grid,
    total: tuple[_AtInstants, Array],
    inputs: Inputs,
    moved: Inputs,
) -> tuple[_AtInstants, Array]:
    """The total, and what changes of its own parameters change, one effect added."""

    def row(inputs: Inputs, moved: Array) -> tuple[Array, Moment, Array]:
        force = _at_instants(sum_of((effect,), rotor), grid, inputs, inputs.own)
        by_own = (
            jnp.einsum("dpb,cp->cdb", _by_own((effect,), grid, inputs, rotor, 0), moved)
            if len(moved)
            else jnp.zeros((0, *inputs.motion.shape))
        )
        return force, _by_moment((effect,), grid, inputs, rotor), by_own

    force, by, change = jax.vmap(row)(inputs._replace(own=inputs.own[k : k + 1]), moved.own[k])
    return _AtInstants(total[0].force + force, jax.tree.map(operator.add, total[0].by, by)), total[1] + change


def _analysed_slopes(grid: Grid, inputs: Inputs, at: _AtInstants) -> tuple[Array, Array]:
    """Coefficients of the force of one row, and their slopes by those of the motion."""
    by = jnp.stack([at.by.position, inputs.speed * at.by.velocity], axis=1)
    return at.force @ jnp.asarray(grid.analysis()), analysed(by, grid)


def _with_speed_and_bow(
    grid: Grid, inputs: Inputs, at: _AtInstants, moved: Inputs
) -> Float[Array, "row column dof coefficient"]:
    """Changes of the coefficients with those of speed and bow, if there are any."""
    analysis = jnp.asarray(grid.analysis())

    def row(inputs: Inputs, at: _AtInstants, moved: Inputs) -> Array:
        by_speed = _along(at.by.velocity, *(inputs.motion @ jnp.asarray(grid.slope(grid.angle)))) + at.by.speed
        return jax.vmap(
            lambda faster, bow: (_along(at.by.bow, *_waves_of(bow, grid, grid.angle)) + by_speed * faster) @ analysis
        )(moved.speed, moved.bow)

    none = jnp.zeros((*moved.speed.shape, *inputs.motion.shape[1:]))
    if not moved.speed.shape[1]:
        return none
    moving = jnp.any(moved.speed != 0.0) | jnp.any(moved.bow.x != 0.0) | jnp.any(moved.bow.y != 0.0)
    parts = (inputs._replace(own=()), at, moved._replace(own=()))
    return jax.lax.cond(moving, jax.vmap(row), lambda *_: none, *parts)


def _is_zero(tangent: Any) -> bool:
    return isinstance(tangent, SymbolicZero)


def analysed(
    slopes: Float[Array, "dof kind dof instant"], grid: Grid
) -> Float[Array, "dof coefficient dof coefficient"]:
    """From slopes at instants, by position and by velocity, to those of the coefficients."""
    modes, products = (jnp.asarray(m) for m in grid.products())
    return jnp.einsum("ikjm,kmbc->ibjc", slopes @ modes, products[: slopes.shape[1]])


def restoring(model: Model) -> list[RestoringEffect]:
    """The restoring effects of a model, in its order."""
    return [e for e in model.effects if isinstance(e, RestoringEffect)]


def parameters_of(model: Model) -> tuple[tuple[Float[Array, "param"], ...], tuple[EffectOf, ...]]:
    """Parameters of every restoring effect, and the effects made of them."""
    flat = [ravel_pytree(effect) for effect in restoring(model)]
    return tuple(values for values, _ in flat), tuple(effect_of for _, effect_of in flat)
