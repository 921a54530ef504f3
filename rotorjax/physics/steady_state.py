"""The steady state of a model with nonlinear forces, and with probes that bend the waveform."""

import dataclasses
import functools
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Complex, Float

from rotorjax.model.conditions import Conditions
from rotorjax.model.contract import RestoringEffect, WaveformEffect
from rotorjax.model.model import Model
from rotorjax.physics.assembly import Assembled, Chain, assemble, point_at, true_speed
from rotorjax.physics.continuation import search
from rotorjax.physics.harmonic_balance import (
    BALANCED,
    Balance,
    Coefficients,
    Grid,
    System,
    balance,
    grid_of,
    settled,
    to_complex,
    to_real,
)
from rotorjax.physics.planar import Matrix, Vector
from rotorjax.physics.probe_reading import Sensed, bends_of, read
from rotorjax.physics.restoring_forces import (
    EVERY,
    Inputs,
    Moment,
    analysed,
    coefficients_of,
    moments_of,
    parameters_of,
    restoring,
    sum_of,
)

FRACTION = ((0.2, 0.06), (0.12, -0.16))
"""Push of the lowest fraction of an order, in the size of the free motion: in neither symmetry nor phase with anything.
"""


def is_coupled(model: Model) -> bool:
    """Whether the orders of a model depend on one another."""
    return any(isinstance(e, RestoringEffect | WaveformEffect) for e in model.effects)


def without_coupling(model: Model) -> Model:
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


def _bow(assembled: Assembled, grid: Grid) -> Vector:
    nothing = jnp.zeros(len(grid.orders), complex)
    return Vector(assembled.offset.x + nothing, assembled.offset.y + nothing)


def total_force(model: Model) -> Callable[[Moment, Array], Float[Array, "dof"]]:
    """Moment, shaft angle -> sum of all restoring forces [N]."""
    own, effects = parameters_of(model)
    return functools.partial(sum_of(effects, model.rotor), own)


def moments_along(
    condition: Conditions, grid: Grid, assembled: Assembled, motion: Coefficients, angle: Float[np.ndarray, "instant"]
) -> Moment:
    """What forces depend on along a motion, at shaft angles."""
    return moments_of(Inputs((), condition.speed, motion, _bow(assembled, grid)), grid, angle)


def slopes_along(
    model: Model,
    condition: Conditions,
    grid: Grid,
    assembled: Assembled,
    motion: Coefficients,
    *,
    angle: Float[np.ndarray, "instant"],
) -> Float[Array, "dof kind dof instant"]:
    """Derivatives of the sum of all restoring forces along a motion, by position [N/m] and by velocity [N s/m]
    (``kind``), at shaft angles.
    """
    total = total_force(model)

    def at(by_motion: Array, moment: Moment, phi: Array) -> Array:
        return total(moment._replace(position=by_motion[0], velocity=by_motion[1]), phi)

    moments = moments_along(condition, grid, assembled, motion, angle)
    along = jnp.stack([moments.position, moments.velocity])
    return jax.vmap(jax.jacfwd(at), in_axes=(-1, EVERY, -1), out_axes=-1)(along, moments, jnp.asarray(angle))


def answer(compliance: Matrix, force: Coefficients) -> Coefficients:
    """Motion of a linear rotor under forces; its compliance order by order."""
    pair = to_complex(force)
    return to_real(in_space(compliance.times(Vector(pair[0], pair[1]))))


def restoring_system(model: Model, condition: Conditions, grid: Grid, assembled: Assembled) -> System:
    """The equations of harmonic balance of one case at its true speed."""
    own, effects = parameters_of(model)
    whole = jnp.zeros((2, len(grid.orders)), complex)
    compliance, drive, bow = (
        assembled.dynamic.inverse(),
        to_real(in_space(assembled.drive) + whole),
        _bow(assembled, grid),
    )

    def moved(force: Coefficients) -> Coefficients:
        return answer(compliance, force)

    def lacking(motion: Coefficients) -> Coefficients:
        pair = to_complex(motion)
        return to_real(in_space(assembled.dynamic.times(Vector(pair[0], pair[1])))) - drive

    def force(motion: Coefficients) -> Coefficients:
        return coefficients_of(effects, grid, Inputs(own, condition.speed, motion, bow), model.rotor)

    def slopes(motion: Coefficients) -> Float[Array, "dof coefficient dof coefficient"]:
        by_motion = slopes_along(model, condition, grid, assembled, motion, angle=grid.angle)
        return analysed(by_motion * jnp.stack([jnp.ones(()), condition.speed])[None, :, None, None], grid)

    def brake(coefficients: Coefficients) -> Coefficients:
        size = 2.0 * jnp.sqrt(model.rotor.mass * jnp.mean(model.rotor.stiffness))
        return to_real(size * condition.speed * 1j * jnp.asarray(grid.orders)[None] * to_complex(coefficients))

    return System(moved, lacking, force, slopes, moved(drive), brake, grid.settings)


def _per_coefficient(factors: Complex[Array, "*many order"]) -> Float[Array, "*many coefficient coefficient"]:
    """Coefficients of a factor per order times a motion with one coefficient only; the last axis but
    one counts those.
    """
    units = to_complex(jnp.eye(2 * factors.shape[-1] - 1))
    return to_real(factors[..., None, :] * jnp.broadcast_to(units, (*factors.shape[:-1], *units.shape)))


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
        grid = grid_of(model)
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

    @property
    def bow(self) -> Vector:
        """Complex amplitude of the bow at every order."""
        return _bow(self.assembled, self.grid)

    def lacking(self, motion: Coefficients) -> Vector:
        """D q - F, order by order: the force that the linear rotor and its own excitation lack along a motion."""
        pair = to_complex(motion)
        return self.assembled.dynamic.times(Vector(pair[0], pair[1])) - self.assembled.drive

    def sensed(self, motion: Coefficients) -> Sensed:
        """What the probes deliver of a motion."""
        amplitudes = to_complex(motion)
        disk = self.assembled.motion_of(Vector(amplitudes[0], amplitudes[1]))
        delivered = jax.vmap(lambda link, part: link.sensed(self.model.probes, part), out_axes=1)(self.chain, disk)
        return Sensed(delivered, self.chain.turn + jnp.zeros(len(self.grid.orders), complex), bends_of(self.model)[0])

    def sensed_by_motion(self) -> Float[Array, "dof probe coefficient coefficient"]:
        """Coefficients of the amplitudes that the probes deliver of a motion with one coefficient only; the last axis
        but one counts those.
        """
        probes = self.model.probes

        def along(link: Chain, part: Assembled) -> Array:
            rest = link.sensed(probes, part.motion_of(Vector(0.0, 0.0)))
            return jnp.stack(
                [link.sensed(probes, part.motion_of(unit)) - rest for unit in (Vector(1.0, 0.0), Vector(0.0, 1.0))]
            )

        return _per_coefficient(jax.vmap(along, out_axes=-1)(self.chain, self.assembled))

    def shown(self, motion: Coefficients, orders: tuple[float, ...]) -> Complex[Array, "probe order"]:
        """What the probes show of a motion, at some orders of the grid."""
        return read(bends_of(self.model)[1], self.grid, positions(orders, self.grid), self.sensed(motion))


def coupled_vectors(model: Model, condition: Conditions) -> tuple[Complex[Array, "probe order"], Balance]:
    """Vectors of one case by harmonic balance, and the balance itself."""
    ready = Ready.of(model, condition)
    whole, condition, grid, assembled, chain = ready
    system = ready.system
    if not restoring(model):
        found = Balance(system.free, jnp.asarray(BALANCED))
    else:
        fixed = Ready(*jax.lax.stop_gradient((whole, condition)), grid, *jax.lax.stop_gradient((assembled, chain)))
        frozen, finer = fixed.system, fixed.finer.system
        found = balance(system, frozen, finer, _with_fractions(frozen, grid, search(frozen)))
    return ready.shown(found.coefficients, model.layout.orders), found


def fraction_push(system: System, grid: Grid) -> Coefficients:
    """Motion at the lowest fraction of an order, in the size of the free motion; none where the grid
    has no fractions.
    """
    if grid.turns == 1:
        return jnp.zeros_like(system.free)
    return jnp.max(jnp.abs(system.free)) * jnp.zeros_like(system.free).at[:, 1:3].set(jnp.array(FRACTION))


def _with_fractions(system: System, grid: Grid, motion: Coefficients) -> Coefficients:
    """A motion with fractions of an order, if one is near: without a push they stay absent however unstable that is."""
    if grid.turns == 1:
        return motion
    pushed = settled(system, motion + fraction_push(system, grid))
    return jnp.where(jnp.all(jnp.isfinite(pushed)), pushed, motion)


def positions(orders: tuple[float, ...], grid: Grid) -> list[int]:
    """Where some orders are among those of a grid."""
    return [min(range(len(grid.orders)), key=lambda k: abs(grid.orders[k] - order)) for order in orders]
