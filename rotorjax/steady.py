"""The steady state of a model with forces that depend on motion, and with probes that bend the waveform."""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jax.flatten_util import ravel_pytree
from jaxtyping import Bool, Complex, Float

from rotorjax._planar import Matrix, Vector
from rotorjax.assembly import Assembled, Chain, Motion, assemble, point_at, true_speed
from rotorjax.harmonic import BALANCED, NEWTON_STEPS, Balance, Coefficients, Grid, System, balance, make_grid, search, settled, to_complex, to_real
from rotorjax.model import AbstractRotor, Conditions, Instant, Model, RestoringEffect, WaveformEffect

FRACTION = ((0.2, 0.06), (0.12, -0.16))
"""Push of the lowest fraction of an order, in the size of the free motion: in neither symmetry nor phase with anything."""
LEAST_NORM = 1e-6
"""Squared sensitivity of the probes below which a direction counts as unseen."""


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
    for effect in model.effects:
        if isinstance(effect, RestoringEffect | WaveformEffect):
            model = model.without(effect.name)
    return model


def _pair(vector: Vector) -> Complex[Array, "dof order"]:
    return jnp.stack([vector.x, vector.y])


def _by_order(model: Model, condition: Conditions, grid: Grid) -> tuple[Assembled, Chain]:
    """The linear rotor and the measuring chain at every order of the grid; leading axis: order."""

    def at_order(order: Float[Array, ""], index: Array) -> tuple[Assembled, Chain]:
        point = point_at(model, condition, order, index)
        return assemble(model, point), Chain.of(model, point)

    orders = jnp.asarray(grid.orders, dtype=condition.speed.dtype)
    return jax.vmap(at_order)(orders, jnp.arange(len(grid.orders)))


class Course(NamedTuple):
    """What a restoring force depends on beside the motion, along one period; last axis: instant."""

    model: Model
    speed: Float[Array, ""]
    angle: Float[Array, "instant"]
    bow: Float[Array, "dof instant"]
    on: Bool[Array, "effect"] | None


Kinematics = Float[Array, "kind dof instant"]
"""Position and velocity."""


def _at_instant(motion: Float[Array, "kind dof"], angle: Array, bow: Float[Array, "dof"], course: Course) -> Float[Array, "dof"]:
    instant = Instant(course.model.rotor, course.speed, angle, motion[0], motion[1], motion[0] - bow)
    total = jnp.zeros(2)
    for k, effect in enumerate(restoring(course.model)):
        if course.on is None:
            total += effect.force(instant)
        else:
            # A condition that is the same for a whole batch leaves the other branch out.
            total += jax.lax.cond(course.on[k], lambda at, e: e.force(at), lambda _, __: jnp.zeros(2), instant, effect)
    return total


class _Inputs(NamedTuple):
    """What the force of one effect at one instant has derivatives by."""

    own: Float[Array, "param"]
    speed: Float[Array, ""]
    motion: Float[Array, "kind dof"]
    bow: Float[Array, "dof"]


EVERY = _Inputs(None, None, -1, -1)  # pyright: ignore
"""Which inputs have an axis of instants."""


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def _one_force(effect_of: EffectOf, inputs: _Inputs, angle: Array, rotor: AbstractRotor, on: Array) -> Float[Array, "dof instant"]:
    """Force of one effect at every instant (last axis), zero where it is not on.

    Its derivatives, few and the same for every direction in which they are wanted, are computed once. None by rotor and angle.
    """

    def branch(inputs: _Inputs) -> Array:
        return jax.vmap(lambda at, angle: _single(effect_of, at, angle, rotor), in_axes=(EVERY, -1), out_axes=-1)(inputs, angle)

    return jax.lax.cond(on, branch, lambda _: jnp.zeros((2, len(angle))), inputs)


@_one_force.defjvp
def _(effect_of: EffectOf, primals: tuple[Any, ...], tangents: tuple[Any, ...]) -> tuple[Array, Array]:
    inputs, angle, rotor, on = primals
    slopes_of = jax.jacfwd(lambda at, angle: _single(effect_of, at, angle, rotor))

    def branch(inputs: _Inputs) -> _Inputs:
        return jax.vmap(slopes_of, in_axes=(EVERY, -1), out_axes=-1)(inputs, angle)

    blank = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape), jax.eval_shape(branch, inputs))
    by, moved = jax.lax.cond(on, branch, lambda _: blank, inputs), tangents[0]
    change = jnp.einsum("dps,p->ds", by.own, moved.own) + by.speed * moved.speed
    change += jnp.einsum("dkjs,kjs->ds", by.motion, moved.motion) + jnp.einsum("djs,js->ds", by.bow, moved.bow)
    return _one_force(effect_of, *primals), change


def _single(effect_of: EffectOf, inputs: _Inputs, angle: Array, rotor: AbstractRotor) -> Float[Array, "dof"]:
    position, velocity = inputs.motion[0], inputs.motion[1]
    return effect_of(inputs.own).force(Instant(rotor, inputs.speed, angle, position, velocity, position - inputs.bow))


def _chosen_forces(motion: Kinematics, course: Course) -> Float[Array, "dof instant"]:
    """Forces of those effects that are on."""
    assert course.on is not None
    total = jnp.zeros((2, len(course.angle)))
    for k, effect in enumerate(restoring(course.model)):
        own, effect_of = ravel_pytree(effect)
        inputs = _Inputs(own, course.speed, motion, course.bow)
        total += _one_force(effect_of, inputs, course.angle, course.model.rotor, course.on[k])
    return total


def _at_instants(function: Callable[..., Array]) -> Callable[..., Array]:
    return jax.vmap(function, in_axes=(-1, -1, -1, None), out_axes=-1)


def _system(model: Model, condition: Conditions, grid: Grid, assembled: Assembled, on: Bool[Array, "effect"] | None) -> System:
    """The equations of harmonic balance of one case at its true speed."""
    synthesis, rate, analysis = (jnp.asarray(m) for m in (grid.synthesis(grid.angle), grid.slope(grid.angle), grid.analysis()))
    products = jnp.asarray(grid.products())
    bow = to_real(_pair(assembled.offset) + jnp.zeros((2, len(grid.orders)), complex)) @ synthesis
    course = Course(model, condition.speed, jnp.asarray(grid.angle), bow, on)

    compliance, drive = assembled.dynamic.inverse(), to_real(_pair(assembled.drive) + jnp.zeros((2, len(grid.orders)), complex))

    def moved(force: Coefficients) -> Coefficients:
        pair = to_complex(force)
        return to_real(_pair(compliance.times(Vector(pair[0], pair[1]))))

    def lacking(motion: Coefficients) -> Coefficients:
        pair = to_complex(motion)
        return to_real(_pair(assembled.dynamic.times(Vector(pair[0], pair[1])))) - drive

    def kinematics(coefficients: Coefficients) -> Kinematics:
        return jnp.stack([coefficients @ synthesis, condition.speed * coefficients @ rate])

    def slopes(coefficients: Coefficients) -> Float[Array, "dof coefficient dof coefficient"]:
        by_motion = _at_instants(jax.jacfwd(_at_instant))(kinematics(coefficients), course.angle, course.bow, course)
        weighted = by_motion * jnp.stack([jnp.ones(()), condition.speed])[None, :, None, None]
        return jnp.einsum("ikjs,ksbc->ibjc", weighted, products)

    def force(coefficients: Coefficients) -> Coefficients:
        motion = kinematics(coefficients)
        along = _at_instants(_at_instant)(motion, course.angle, course.bow, course) if on is None else _chosen_forces(motion, course)
        return along @ analysis

    def brake(coefficients: Coefficients) -> Coefficients:
        size = 2.0 * jnp.sqrt(model.rotor.mass * jnp.mean(model.rotor.stiffness))
        return to_real(size * condition.speed * 1j * jnp.asarray(grid.orders)[None] * to_complex(coefficients))

    return System(moved, lacking, force, slopes, moved(drive), brake)


class Near(NamedTuple):
    """What is known of a steady state before it is computed."""

    motion: Coefficients
    """Coefficients of a motion near by; where not a number, that of the linear rotor is taken."""
    on: Bool[Array, "effect"] | None = None
    """Restoring effects to compute, in the order of the model; by default all."""
    steps: Array | int = NEWTON_STEPS
    """Most steps of Newton's method; with none, what the equations make of the motion near by to first order."""


def timed_vectors(model: Model, condition: Conditions, near: Near | None = None) -> tuple[Complex[Array, "probe order"], Balance]:
    """Vectors of one case by harmonic balance, and the balance itself; without ``near`` after a search."""
    grid = make_grid(model.layout.orders)
    whole = model.with_orders(grid.orders)
    condition = dataclasses.replace(condition, speed=true_speed(model, condition.speed))
    assembled, chain = _by_order(whole, condition, grid)
    on = None if near is None else near.on
    system = _system(whole, condition, grid, assembled, on)
    if not restoring(model):
        found = Balance(system.free, jnp.asarray(BALANCED))
    else:
        frozen = _system(*jax.lax.stop_gradient((whole, condition)), grid, jax.lax.stop_gradient(assembled), on)
        if near is None:
            found = balance(system, frozen, _with_fractions(frozen, grid, search(frozen)))
        else:
            start = jnp.where(jnp.all(jnp.isfinite(near.motion)), near.motion, frozen.free)
            found = balance(system, frozen, jax.lax.stop_gradient(start), near.steps)
    amplitudes = to_complex(found.coefficients)
    return _read(whole, grid, assembled, chain, amplitudes)[:, [grid.orders.index(order) for order in _on_grid(model.layout.orders, grid)]], found


def _with_fractions(system: System, grid: Grid, motion: Coefficients) -> Coefficients:
    """A motion with fractions of an order, if one is near: without a push they stay absent however unstable that is."""
    if grid.turns == 1:
        return motion
    push = jnp.max(jnp.abs(system.free)) * jnp.zeros_like(motion).at[:, 1:3].set(jnp.array(FRACTION))
    pushed = settled(system, motion + push)
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
    """The motion of the linear rotor, put right as little as possible to show at every order what was measured.

    **Arguments:** ``shown``: measured vectors, whatever stands where they are not ``present``.
    """
    grid = make_grid(model.layout.orders)
    whole = without_timed(model).with_orders(grid.orders)
    condition = dataclasses.replace(condition, speed=true_speed(model, condition.speed))
    assembled, chain = _by_order(whole, condition, grid)
    motion = assembled.motion()

    def corrected(part: Assembled, link: Chain, free: Motion, vectors: Array, counted: Array) -> Array:
        rest = link.sensed(whole.probes, part.motion_of(Vector(0.0, 0.0)))
        along = [link.sensed(whole.probes, part.motion_of(unit)) - rest for unit in (Vector(1.0, 0.0), Vector(0.0, 1.0))]
        seen = jnp.stack(along, axis=1) * counted[:, None]
        miss = (vectors / link.turn - link.sensed(whole.probes, free)) * counted
        normal = seen.conj().T @ seen + LEAST_NORM * jnp.eye(2)
        step = Matrix.of(normal).solve(Vector.of(seen.conj().T @ miss))
        return jnp.stack([free.disk.x + step.x, free.disk.y + step.y])

    index = [grid.orders.index(order) for order in _on_grid(model.layout.orders, grid)]
    parts, links, frees = jax.tree.map(lambda leaf: leaf[jnp.array(index)], (assembled, chain, motion))
    disk = jax.vmap(corrected)(parts, links, frees, shown.T, present.T).T
    return to_real(_pair(motion.disk).at[:, jnp.array(index)].set(disk))
