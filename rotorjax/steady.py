"""The steady state of a model with forces that depend on motion, and with probes that bend the waveform."""

import dataclasses
import functools
import operator
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
    bow: Vector
    """Complex amplitude of every order."""


class Moment(NamedTuple):
    """What the force of an effect at one instant has derivatives by; as an array of many, the last axis counts instants."""

    position: Float[Array, "dof"]
    velocity: Float[Array, "dof"]
    bow: Float[Array, "dof"]
    speed: Float[Array, ""]


Forces = Callable[[tuple[Array, ...], Moment, Array], Float[Array, "dof"]]
"""Parameters, moment, shaft angle -> sum of the forces of all effects."""


def _forces(effects: tuple[EffectOf, ...], rotor: AbstractRotor) -> Forces:
    def at(own: tuple[Array, ...], moment: Moment, angle: Array) -> Array:
        instant = Instant(rotor, moment.speed, angle, moment.position, moment.velocity, moment.position - moment.bow)
        forces = (effect_of(values).force(instant) for effect_of, values in zip(effects, own, strict=True))
        return functools.reduce(operator.add, forces, jnp.zeros(2))

    return at


def _moments(inputs: Inputs, grid: Grid, angle: Float[np.ndarray, "instant"] | None = None) -> Moment:
    at = grid.angle if angle is None else angle
    synthesis, rate = (jnp.asarray(m) for m in (grid.synthesis(at), grid.slope(at)))
    bow = jnp.stack(_waves_of(inputs.bow, grid, at))
    return Moment(inputs.motion @ synthesis, inputs.speed * inputs.motion @ rate, bow, inputs.speed)


def _waves_of(amplitudes: Vector, grid: Grid, angle: Float[np.ndarray, "instant"]) -> tuple[Float[Array, "instant"], Float[Array, "instant"]]:
    """Both directions at shaft angles."""
    return waveform(amplitudes.x, grid, angle), waveform(amplitudes.y, grid, angle)


def waveform(amplitudes: Complex[Array, "*many order"], grid: Grid, angle: Float[np.ndarray, "instant"]) -> Float[Array, "*many instant"]:
    """Re Σ a_n e^{inφ} at shaft angles."""
    phase = np.outer(grid.order_array, angle)
    return amplitudes.real @ jnp.asarray(np.cos(phase)) - amplitudes.imag @ jnp.asarray(np.sin(phase))


EVERY = Moment(-1, -1, -1, None)  # pyright: ignore
"""Which parts of a moment have an axis of instants."""


@functools.partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def _force(effects: tuple[EffectOf, ...], grid: Grid, inputs: Inputs, rotor: AbstractRotor) -> Coefficients:
    """Coefficients of the sum of all forces.

    What derivatives need, few slopes at every instant, is analysed once for all directions in which they are wanted.
    """
    along = jax.vmap(_forces(effects, rotor), in_axes=(None, EVERY, -1), out_axes=-1)
    return along(inputs.own, _moments(inputs, grid), jnp.asarray(grid.angle)) @ jnp.asarray(grid.analysis())


@functools.partial(_force.defjvp, symbolic_zeros=True)
def _(effects: tuple[EffectOf, ...], grid: Grid, primals: tuple[Any, ...], tangents: tuple[Any, ...]) -> tuple[Array, Array]:
    inputs, rotor = primals
    moved: Inputs = tangents[0]
    synthesis, rate = (jnp.asarray(m) for m in (grid.synthesis(grid.angle), grid.slope(grid.angle)))
    by = _by_moment(effects, grid, inputs, rotor)
    change = jnp.zeros((2, len(grid.angle)))
    if not _is_zero(moved.motion):
        change += _along(by.position, *(moved.motion @ synthesis)) + _along(by.velocity, *(inputs.speed * moved.motion @ rate))
    if not (_is_zero(moved.bow.x) and _is_zero(moved.bow.y)):
        bow = jax.tree.map(lambda t, value: jnp.zeros_like(value) if _is_zero(t) else t, moved.bow, inputs.bow, is_leaf=_is_zero)
        change += _along(by.bow, *_waves_of(bow, grid, grid.angle))
    if not _is_zero(moved.speed):
        change += (_along(by.velocity, *(inputs.motion @ rate)) + by.speed) * moved.speed
    by_rotor = jax.tree.map(lambda t: None if _is_zero(t) else t, tangents[1], is_leaf=_is_zero)
    if jax.tree.leaves(by_rotor):
        wanted, rest = eqx.partition(rotor, jax.tree.map(lambda t: not _is_zero(t), tangents[1], is_leaf=_is_zero))

        def of_rotor(part: AbstractRotor) -> Array:
            return _at_instants(_forces(effects, eqx.combine(part, rest)), grid, inputs, inputs.own)

        change += jax.jvp(of_rotor, (wanted,), (by_rotor,))[1]
    after = change @ jnp.asarray(grid.analysis())
    for k, tangent in enumerate(moved.own):
        if not _is_zero(tangent):
            after += jnp.einsum("dpb,p->db", _by_own(effects, grid, inputs, rotor, k), tangent)
    return _force(effects, grid, inputs, rotor), after


def _at_instants(of_instant: Callable[..., Any], grid: Grid, inputs: Inputs, own: Any) -> Any:
    """Something of own parameters, moment and angle at every instant of the grid; the last axis counts those."""
    return jax.vmap(of_instant, in_axes=(None, EVERY, -1), out_axes=-1)(own, _moments(inputs, grid), jnp.asarray(grid.angle))


def _by_moment(effects: tuple[EffectOf, ...], grid: Grid, inputs: Inputs, rotor: AbstractRotor) -> Moment:
    """Derivatives of the sum of all forces by what it depends on, at every instant."""
    return _at_instants(jax.jacfwd(_forces(effects, rotor), argnums=1), grid, inputs, inputs.own)


def _by_own(effects: tuple[EffectOf, ...], grid: Grid, inputs: Inputs, rotor: AbstractRotor, k: int) -> Float[Array, "dof param coefficient"]:
    """Derivatives of the coefficients of one force by its own parameters: analysed once for all directions in which they are wanted."""
    single = _forces(effects[k : k + 1], rotor)
    by_own = jax.jacfwd(lambda own, at, angle: single((own,), at, angle))
    return _at_instants(by_own, grid, inputs, inputs.own[k]) @ jnp.asarray(grid.analysis())


def _along(slopes: Float[Array, "dof dof instant"], x: Float[Array, "instant"], y: Float[Array, "instant"]) -> Float[Array, "dof instant"]:
    return slopes[:, 0] * x[None] + slopes[:, 1] * y[None]


class ForceSlopes(NamedTuple):
    """The coefficients of the sum of all forces along a motion, and their derivatives."""

    force: Coefficients
    by_motion: Float[Array, "dof coefficient dof coefficient"]
    moved: Callable[[tuple[Float[Array, "param"], ...], Array, Vector], Coefficients]
    """Change of parameters, of speed and of bow -> change of the coefficients, the motion left as it is."""


def _force_slopes(effects: tuple[EffectOf, ...], grid: Grid, inputs: Inputs, rotor: AbstractRotor) -> ForceSlopes:
    """All derivatives from one evaluation of the forces' slopes at every instant."""
    by = _by_moment(effects, grid, inputs, rotor)
    by_own = [_by_own(effects, grid, inputs, rotor, k) for k in range(len(effects))]
    by_speed = _along(by.velocity, *(inputs.motion @ jnp.asarray(grid.slope(grid.angle)))) + by.speed
    analysis = jnp.asarray(grid.analysis())

    def moved(own: tuple[Array, ...], speed: Array, bow: Vector) -> Coefficients:
        change = (_along(by.bow, *_waves_of(bow, grid, grid.angle)) + by_speed * speed) @ analysis
        return functools.reduce(operator.add, (jnp.einsum("dpb,p->db", part, one) for part, one in zip(by_own, own, strict=True)), change)

    slopes = jnp.stack([by.position, inputs.speed * by.velocity], axis=1)
    return ForceSlopes(_force(effects, grid, inputs, rotor), _analysed(slopes, grid), moved)


def _is_zero(tangent: Any) -> bool:
    return isinstance(tangent, SymbolicZero)


def _analysed(slopes: Float[Array, "dof kind dof instant"], grid: Grid) -> Float[Array, "dof coefficient dof coefficient"]:
    """From slopes at instants, by position and by velocity, to those of the coefficients."""
    return jnp.einsum("ikjs,ksbc->ibjc", slopes, jnp.asarray(grid.products()[: slopes.shape[1]]))


def _parameters(model: Model) -> tuple[tuple[Float[Array, "param"], ...], tuple[EffectOf, ...]]:
    """Parameters of every restoring effect, and the effects made of them."""
    flat = [ravel_pytree(effect) for effect in restoring(model)]
    return tuple(values for values, _ in flat), tuple(effect_of for _, effect_of in flat)


def _bow(assembled: Assembled, grid: Grid) -> Vector:
    nothing = jnp.zeros(len(grid.orders), complex)
    return Vector(assembled.offset.x + nothing, assembled.offset.y + nothing)


def total_force(model: Model) -> Callable[[Moment, Array], Float[Array, "dof"]]:
    """Moment, shaft angle -> sum of all restoring forces [N]."""
    own, effects = _parameters(model)
    return functools.partial(_forces(effects, model.rotor), own)


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


def _per_coefficient(factors: Complex[Array, "*many order"]) -> Float[Array, "*many coefficient coefficient"]:
    """Coefficients of a factor per order times a motion with one coefficient only; the last axis but one counts those."""
    units = to_complex(jnp.eye(2 * factors.shape[-1] - 1))
    return to_real(factors[..., None, :] * jnp.broadcast_to(units, (*factors.shape[:-1], *units.shape)))


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

    def inputs(self, motion: Coefficients) -> Inputs:
        """What the restoring forces depend on along a motion."""
        return Inputs(_parameters(self.model)[0], self.condition.speed, motion, _bow(self.assembled, self.grid))

    def lacking(self, motion: Coefficients) -> Vector:
        """D q - F, order by order: the force that the linear rotor and its own excitation lack along a motion."""
        pair = to_complex(motion)
        return self.assembled.dynamic.times(Vector(pair[0], pair[1])) - self.assembled.drive

    def force_slopes(self, motion: Coefficients) -> ForceSlopes:
        """The restoring forces along a motion with all their derivatives."""
        return _force_slopes(_parameters(self.model)[1], self.grid, self.inputs(motion), self.model.rotor)

    def shown(self, motion: Coefficients, orders: tuple[float, ...]) -> Complex[Array, "probe order"]:
        """What the probes show of a motion, at some orders of the grid."""
        read = _read(self.model, self.grid, self.assembled, self.chain, to_complex(motion))
        return read[:, self._index(orders)]

    def shown_slopes(self, motion: Coefficients, orders: tuple[float, ...]) -> Float[Array, "probe order 2 dof coefficient"]:
        """Derivatives of real and imaginary parts of `shown` by the coefficients of the motion."""
        probes, chain, grid = self.model.probes, self.chain, self.grid

        def along(link: Chain, part: Assembled) -> Array:
            rest = link.sensed(probes, part.motion_of(Vector(0.0, 0.0)))
            return jnp.stack([link.sensed(probes, part.motion_of(unit)) - rest for unit in (Vector(1.0, 0.0), Vector(0.0, 1.0))])

        sensed = _per_coefficient(jax.vmap(along, out_axes=-1)(chain, self.assembled))
        index = self._index(orders)
        analysis = grid.analysis()
        complete = np.stack([analysis[:, [max(2 * k - 1, 0) for k in index]], analysis[:, [2 * k for k in index]] * (np.array(index) > 0)], axis=-1)
        synthesis = grid.synthesis(grid.angle)
        if [e for e in self.model.effects if isinstance(e, WaveformEffect)]:
            waves = _waves(self.model, grid, self.assembled, chain, to_complex(motion))
            by_wave = jax.vmap(jax.jacfwd(functools.partial(_bent, self.model)), in_axes=1, out_axes=-1)(waves)
            products = np.einsum("son,cs->sonc", complete, synthesis)
            analysed = jnp.einsum("pqs,sonc->pqonc", by_wave, jnp.asarray(products))
            read = jnp.einsum("pqonc,dqkc->pondk", analysed, sensed)
        else:
            read = jnp.einsum("onc,dpkc->pondk", jnp.asarray(np.einsum("son,cs->onc", complete, synthesis)), sensed)
        turn = chain.turn[jnp.array(index)][None, :, None, None]
        real, imaginary = read[:, :, 0], read[:, :, 1]
        turned = jnp.stack([turn.real * real - turn.imag * imaginary, turn.imag * real + turn.real * imaginary], axis=2)
        # Order 0 is real.
        there = np.stack([np.ones(len(index)), (np.array(index) > 0).astype(float)], axis=1)
        return turned * jnp.asarray(there)[None, :, :, None, None]

    def _index(self, orders: tuple[float, ...]) -> list[int]:
        return [self.grid.orders.index(order) for order in _on_grid(orders, self.grid)]


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
    if any(isinstance(e, WaveformEffect) for e in model.effects):
        waves = jax.vmap(functools.partial(_bent, model), in_axes=1, out_axes=1)(_waves(model, grid, assembled, chain, amplitudes))
        analysis = grid.analysis()
        # Of order 0 there is no imaginary part.
        imaginary = np.concatenate([np.zeros((len(analysis), 1)), analysis[:, 2::2]], axis=1)
        real = np.concatenate([analysis[:, :1], analysis[:, 1::2]], axis=1)
        sensed = jax.lax.complex(waves @ jnp.asarray(real), waves @ jnp.asarray(imaginary))
    else:
        sensed = _sensed(model, assembled, chain, amplitudes)
    read = sensed * chain.turn[None]
    return read.at[:, 0].set(read[:, 0].real + 0j)


def _sensed(model: Model, assembled: Assembled, chain: Chain, amplitudes: Complex[Array, "dof order"]) -> Complex[Array, "probe order"]:
    """What the probes deliver of a motion, before anything bends the waveform."""
    motion = assembled.motion_of(Vector(amplitudes[0], amplitudes[1]))
    return jax.vmap(lambda link, part: link.sensed(model.probes, part), out_axes=1)(chain, motion)


def _waves(model: Model, grid: Grid, assembled: Assembled, chain: Chain, amplitudes: Complex[Array, "dof order"]) -> Float[Array, "probe instant"]:
    return waveform(_sensed(model, assembled, chain, amplitudes), grid, grid.angle)


def _bent(model: Model, waveform: Float[Array, "probe"]) -> Float[Array, "probe"]:
    """What the probes make of it at one instant."""
    for effect in model.effects:
        if isinstance(effect, WaveformEffect):
            waveform = effect.distorted(waveform)
    return waveform


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
