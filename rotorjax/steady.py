"""The steady state of a model with forces that depend on motion, and with probes that bend the waveform."""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.custom_derivatives import SymbolicZero
from jax.flatten_util import ravel_pytree
from jaxtyping import Bool, Complex, Float

from rotorjax._planar import Matrix, Vector
from rotorjax.assembly import Assembled, Chain, Motion, assemble, point_at, true_speed
from rotorjax.continuation import search
from rotorjax.harmonic import (
    BALANCED,
    NEWTON_STEPS,
    SMALLEST_MOTION,
    Balance,
    Coefficients,
    Grid,
    System,
    balance,
    make_grid,
    settled,
    to_complex,
    to_real,
)
from rotorjax.model import AbstractRotor, Conditions, Instant, Model, RestoringEffect, WaveformEffect

FRACTION = ((0.2, 0.06), (0.12, -0.16))
"""Push of the lowest fraction of an order, in the size of the free motion: in neither symmetry nor phase with anything."""
LEAST_NORM = 1e-6
"""Squared sensitivity of the probes below which a direction counts as unseen."""
UNLIKE = 0.99
"""An unseen direction changes as the other does, in the shape of the free motion: what is left of the price of that shape is one less this."""


EffectOf = Callable[[Float[Array, "param"]], RestoringEffect]
"""From parameters in a row to the effect."""


def is_timed(model: Model) -> bool:
    """Whether the orders of a model depend on one another."""
    return any(isinstance(e, RestoringEffect | WaveformEffect) for e in model.effects)


def restoring(model: Model) -> list[RestoringEffect]:
    """The restoring effects of a model, in its order."""
    return [e for e in model.effects if isinstance(e, RestoringEffect)]


def without_timed(model: Model) -> Model:
    """The model without restoring forces and bent waveforms."""
    return model.without(*(e.name for e in model.effects if isinstance(e, RestoringEffect | WaveformEffect)))


def in_space(vector: Vector) -> Complex[Array, "dof order"]:
    """Both directions in one array."""
    return jnp.stack([vector.x, vector.y])


def by_order(model: Model, condition: Conditions, grid: Grid) -> tuple[Assembled, Chain]:
    """The linear rotor and the measuring chain at every order of the grid; leading axis: order."""

    def at_order(order: Float[Array, ""], index: Array) -> tuple[Assembled, Chain]:
        point = point_at(model, condition, order, index)
        return assemble(model, point), Chain.of(model, point)

    orders = jnp.asarray(grid.orders, dtype=condition.speed.dtype)
    return jax.vmap(at_order)(orders, jnp.arange(len(grid.orders)))


class Inputs(NamedTuple):
    """What the coefficients of the restoring force have derivatives by."""

    own: tuple[Float[Array, "param"], ...]
    """Parameters of every effect."""
    speed: Float[Array, ""]
    motion: Coefficients
    bow: Coefficients


class Moment(NamedTuple):
    """What the force of an effect at one instant has derivatives by; as an array of many, the last axis counts instants."""

    position: Float[Array, "dof"]
    velocity: Float[Array, "dof"]
    bow: Float[Array, "dof"]
    speed: Float[Array, ""]


Forces = Callable[[tuple[Array, ...], Moment, Array], Float[Array, "effect dof"]]
"""Parameters, moment, shaft angle -> force of every effect."""


def _forces(effects: tuple[EffectOf, ...], rotor: AbstractRotor) -> Forces:
    def at(own: tuple[Array, ...], moment: Moment, angle: Array) -> Array:
        instant = Instant(rotor, moment.speed, angle, moment.position, moment.velocity, moment.position - moment.bow)
        return jnp.stack([effect_of(values).force(instant) for effect_of, values in zip(effects, own, strict=True)])

    return at


def _moments(inputs: Inputs, grid: Grid, angle: Float[np.ndarray, "instant"] | None = None) -> Moment:
    at = grid.angle if angle is None else angle
    synthesis, rate = (jnp.asarray(m) for m in (grid.synthesis(at), grid.slope(at)))
    return Moment(inputs.motion @ synthesis, inputs.speed * inputs.motion @ rate, inputs.bow @ synthesis, inputs.speed)


EVERY = Moment(-1, -1, -1, None)  # pyright: ignore
"""Which parts of a moment have an axis of instants."""


@functools.partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def _force(effects: tuple[EffectOf, ...], grid: Grid, inputs: Inputs, rotor: AbstractRotor) -> Coefficients:
    """Coefficients of the sum of all forces.

    What derivatives need, few slopes at every instant, is analysed once for all directions in which they are wanted.
    """
    along = jax.vmap(_forces(effects, rotor), in_axes=(None, EVERY, -1), out_axes=-1)
    total = jnp.sum(along(inputs.own, _moments(inputs, grid), jnp.asarray(grid.angle)), axis=0)
    return total @ jnp.asarray(grid.analysis())


@functools.partial(_force.defjvp, symbolic_zeros=True)
def _(effects: tuple[EffectOf, ...], grid: Grid, primals: tuple[Any, ...], tangents: tuple[Any, ...]) -> tuple[Array, Array]:
    inputs, rotor = primals
    moved: Inputs = tangents[0]
    forces, moments = _forces(effects, rotor), _moments(inputs, grid)
    angle, synthesis, rate = (jnp.asarray(m) for m in (grid.angle, grid.synthesis(grid.angle), grid.slope(grid.angle)))
    over_instants = {"in_axes": (None, EVERY, -1), "out_axes": -1}

    def along(slopes: Array, waves: Array) -> Array:
        return jnp.einsum("djs,js->ds", slopes, waves)

    change = jnp.zeros((2, len(angle)))
    analysis = jnp.asarray(grid.analysis())
    by = jax.vmap(jax.jacfwd(lambda own, at, phi: jnp.sum(forces(own, at, phi), axis=0), argnums=1), **over_instants)(inputs.own, moments, angle)
    if not _is_zero(moved.motion):
        change += along(by.position, moved.motion @ synthesis) + along(by.velocity, inputs.speed * moved.motion @ rate)
    if not _is_zero(moved.bow):
        change += along(by.bow, moved.bow @ synthesis)
    if not _is_zero(moved.speed):
        change += (along(by.velocity, inputs.motion @ rate) + by.speed) * moved.speed
    by_rotor = jax.tree.map(lambda t: None if _is_zero(t) else t, tangents[1], is_leaf=_is_zero)
    if jax.tree.leaves(by_rotor):
        wanted, rest = eqx.partition(rotor, jax.tree.map(lambda t: not _is_zero(t), tangents[1], is_leaf=_is_zero))

        def of_rotor(part: AbstractRotor) -> Array:
            along_turn = jax.vmap(_forces(effects, eqx.combine(part, rest)), **over_instants)
            return jnp.sum(along_turn(inputs.own, moments, angle), axis=0)

        change += jax.jvp(of_rotor, (wanted,), (by_rotor,))[1]
    by_own, tangents_own = [], []
    for k, (own, tangent) in enumerate(zip(inputs.own, moved.own, strict=True)):
        if not _is_zero(tangent):
            single = jax.jacfwd(lambda own, at, phi, k=k: _forces(effects[k : k + 1], rotor)((own,), at, phi)[0])
            by_own.append(jax.vmap(single, **over_instants)(own, moments, angle))
            tangents_own.append(tangent)
    after = change @ analysis
    if by_own:
        # Analysed before they are combined: once for all directions.
        after += jnp.einsum("dpb,p->db", jnp.concatenate(by_own, axis=1) @ analysis, jnp.concatenate(tangents_own))
    return _force(effects, grid, inputs, rotor), after


def _is_zero(tangent: Any) -> bool:
    return isinstance(tangent, SymbolicZero)


def _analysed(slopes: Float[Array, "dof kind dof instant"], grid: Grid) -> Float[Array, "dof coefficient dof coefficient"]:
    """From slopes at instants, by position and by velocity, to those of the coefficients."""
    return jnp.einsum("ikjs,ksbc->ibjc", slopes, jnp.asarray(grid.products()[: slopes.shape[1]]))


def _parameters(model: Model) -> tuple[tuple[Float[Array, "param"], ...], tuple[EffectOf, ...]]:
    """Parameters of every restoring effect, and the effects made of them."""
    flat = [ravel_pytree(effect) for effect in restoring(model)]
    return tuple(values for values, _ in flat), tuple(effect_of for _, effect_of in flat)


def _bow(assembled: Assembled, grid: Grid) -> Coefficients:
    return to_real(in_space(assembled.offset) + jnp.zeros((2, len(grid.orders)), complex))


def total_force(model: Model) -> Callable[[Moment, Array], Float[Array, "dof"]]:
    """Moment, shaft angle -> sum of all restoring forces [N]."""
    own, effects = _parameters(model)
    each = _forces(effects, model.rotor)
    return lambda moment, angle: jnp.sum(each(own, moment, angle), axis=0)


def moments_along(condition: Conditions, grid: Grid, assembled: Assembled, motion: Coefficients, angle: Float[np.ndarray, "instant"]) -> Moment:
    """What forces depend on along a motion, at shaft angles."""
    return _moments(Inputs((), condition.speed, motion, _bow(assembled, grid)), grid, angle)


def slopes_along(
    model: Model, condition: Conditions, grid: Grid, assembled: Assembled, motion: Coefficients, *, angle: Float[np.ndarray, "instant"]
) -> Float[Array, "dof kind dof instant"]:
    """Derivatives of the sum of all restoring forces along a motion, by position [N/m] and by velocity [N s/m] (``kind``), at shaft angles."""
    total = total_force(model)

    def at(by_motion: Array, moment: Moment, phi: Array) -> Array:
        return total(moment._replace(position=by_motion[0], velocity=by_motion[1]), phi)

    moments = moments_along(condition, grid, assembled, motion, angle)
    along = jnp.stack([moments.position, moments.velocity])
    return jax.vmap(jax.jacfwd(at), in_axes=(-1, EVERY, -1), out_axes=-1)(along, moments, jnp.asarray(angle))


def restoring_system(model: Model, condition: Conditions, grid: Grid, assembled: Assembled) -> System:
    """The equations of harmonic balance of one case at its true speed."""
    own, effects = _parameters(model)
    whole = jnp.zeros((2, len(grid.orders)), complex)
    compliance, drive, bow = assembled.dynamic.inverse(), to_real(in_space(assembled.drive) + whole), _bow(assembled, grid)

    def moved(force: Coefficients) -> Coefficients:
        pair = to_complex(force)
        return to_real(in_space(compliance.times(Vector(pair[0], pair[1]))))

    def lacking(motion: Coefficients) -> Coefficients:
        pair = to_complex(motion)
        return to_real(in_space(assembled.dynamic.times(Vector(pair[0], pair[1])))) - drive

    def force(motion: Coefficients) -> Coefficients:
        if not effects:
            return jnp.zeros_like(motion)
        return _force(effects, grid, Inputs(own, condition.speed, motion, bow), model.rotor)

    def slopes(motion: Coefficients) -> Float[Array, "dof coefficient dof coefficient"]:
        by_motion = slopes_along(model, condition, grid, assembled, motion, angle=grid.angle)
        return _analysed(by_motion * jnp.stack([jnp.ones(()), condition.speed])[None, :, None, None], grid)

    def brake(coefficients: Coefficients) -> Coefficients:
        size = 2.0 * jnp.sqrt(model.rotor.mass * jnp.mean(model.rotor.stiffness))
        return to_real(size * condition.speed * 1j * jnp.asarray(grid.orders)[None] * to_complex(coefficients))

    return System(moved, lacking, force, slopes, moved(drive), brake)


class Near(NamedTuple):
    """What is known of a steady state before it is computed."""

    motion: Coefficients
    """Coefficients of a motion near by; where not a number, that of the linear rotor is taken."""
    steps: Array | int = NEWTON_STEPS
    """Most steps of Newton's method; with none, what the equations make of the motion near by to first order."""


class Ready(NamedTuple):
    """One case made ready for harmonic balance."""

    model: Model
    """With the orders of the grid."""
    condition: Conditions
    """At its true speed."""
    grid: Grid
    assembled: Assembled
    chain: Chain

    @classmethod
    def of(cls, model: Model, condition: Conditions) -> "Ready":
        """The case at the speed of a condition as tabulated."""
        grid = make_grid(model.layout.orders)
        whole = model.with_orders(grid.orders)
        condition = dataclasses.replace(condition, speed=true_speed(model, condition.speed))
        return cls(whole, condition, grid, *by_order(whole, condition, grid))

    @property
    def system(self) -> System:
        """The equations of harmonic balance."""
        return restoring_system(self.model, self.condition, self.grid, self.assembled)

    @property
    def finer(self) -> "Ready":
        """The same with more orders and instants."""
        grid = self.grid.finer
        whole = self.model.with_orders(grid.orders)
        return Ready(whole, self.condition, grid, *by_order(whole, self.condition, grid))

    def shown(self, motion: Coefficients, orders: tuple[float, ...]) -> Complex[Array, "probe order"]:
        """What the probes show of a motion, at some orders of the grid."""
        read = _read(self.model, self.grid, self.assembled, self.chain, to_complex(motion))
        return read[:, [self.grid.orders.index(order) for order in _on_grid(orders, self.grid)]]


def timed_vectors(model: Model, condition: Conditions, near: Near | None = None) -> tuple[Complex[Array, "probe order"], Balance]:
    """Vectors of one case by harmonic balance, and the balance itself; without ``near`` after a search."""
    ready = Ready.of(model, condition)
    whole, condition, grid, assembled, chain = ready
    system = ready.system
    if not restoring(model):
        found = Balance(system.free, jnp.asarray(BALANCED))
    else:
        fixed = Ready(*jax.lax.stop_gradient((whole, condition)), grid, *jax.lax.stop_gradient((assembled, chain)))
        frozen, finer = fixed.system, fixed.finer.system
        if near is None:
            found = balance(system, frozen, finer, _with_fractions(frozen, grid, search(frozen)))
        else:
            start = jnp.where(jnp.all(jnp.isfinite(near.motion)), near.motion, frozen.free)
            found = balance(system, frozen, finer, jax.lax.stop_gradient(start), near.steps)
    return ready.shown(found.coefficients, model.layout.orders), found


def fraction_push(system: System, grid: Grid) -> Coefficients:
    """Motion at the lowest fraction of an order, in the size of the free motion; none where the grid has no fractions."""
    if grid.turns == 1:
        return jnp.zeros_like(system.free)
    return jnp.max(jnp.abs(system.free)) * jnp.zeros_like(system.free).at[:, 1:3].set(jnp.array(FRACTION))


def _with_fractions(system: System, grid: Grid, motion: Coefficients) -> Coefficients:
    """A motion with fractions of an order, if one is near: without a push they stay absent however unstable that is."""
    if grid.turns == 1:
        return motion
    pushed = settled(system, motion + fraction_push(system, grid))
    return jnp.where(jnp.all(jnp.isfinite(pushed)), pushed, motion)


def _on_grid(orders: tuple[float, ...], grid: Grid) -> list[float]:
    return [min(grid.orders, key=lambda known: abs(known - order)) for order in orders]


def _read(model: Model, grid: Grid, assembled: Assembled, chain: Chain, amplitudes: Complex[Array, "dof order"]) -> Complex[Array, "probe order"]:
    """What the measuring chain makes of a motion, at every order of the grid."""
    motion = assembled.motion_of(Vector(amplitudes[0], amplitudes[1]))
    sensed = jax.vmap(lambda link, part: link.sensed(model.probes, part), out_axes=1)(chain, motion)
    bending = [e for e in model.effects if isinstance(e, WaveformEffect)]
    if bending:
        waves = to_real(sensed) @ jnp.asarray(grid.synthesis(grid.angle))
        for effect in bending:
            waves = jax.vmap(effect.distorted, in_axes=1, out_axes=1)(waves)
        sensed = to_complex(waves @ jnp.asarray(grid.analysis()))
    read = sensed * chain.turn[None]
    return read.at[:, 0].set(read[:, 0].real + 0j)


def measured_motion(model: Model, condition: Conditions, shown: Complex[Array, "probe order"], present: Bool[Array, "probe order"]) -> Coefficients:
    """The motion of the linear rotor, put right as little as possible, and most in its own shape, to show at every order what was measured.

    **Arguments:** ``shown``: measured vectors, whatever stands where they are not ``present``.
    """
    grid = make_grid(model.layout.orders)
    whole = without_timed(model).with_orders(grid.orders)
    condition = dataclasses.replace(condition, speed=true_speed(model, condition.speed))
    assembled, chain = by_order(whole, condition, grid)
    motion = assembled.motion()

    def corrected(part: Assembled, link: Chain, free: Motion, vectors: Array, counted: Array) -> Array:
        rest = link.sensed(whole.probes, part.motion_of(Vector(0.0, 0.0)))
        along = [link.sensed(whole.probes, part.motion_of(unit)) - rest for unit in (Vector(1.0, 0.0), Vector(0.0, 1.0))]
        seen = jnp.stack(along, axis=1) * counted[:, None]
        miss = (vectors / link.turn - link.sensed(whole.probes, free)) * counted
        own = jnp.stack([free.disk.x, free.disk.y])
        alike = jnp.outer(own, own.conj()) / jnp.maximum(jnp.sum(jnp.abs(own) ** 2), SMALLEST_MOTION**2)
        normal = seen.conj().T @ seen + LEAST_NORM * (jnp.eye(2) - UNLIKE * alike)
        step = Matrix.of(normal).solve(Vector.of(seen.conj().T @ miss))
        return jnp.stack([free.disk.x + step.x, free.disk.y + step.y])

    index = [grid.orders.index(order) for order in _on_grid(model.layout.orders, grid)]
    parts, links, frees = jax.tree.map(lambda leaf: leaf[jnp.array(index)], (assembled, chain, motion))
    disk = jax.vmap(corrected)(parts, links, frees, shown.T, present.T).T
    return to_real(in_space(motion.disk).at[:, jnp.array(index)].set(disk))
