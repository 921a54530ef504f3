"""What a speed that changes steadily adds to the vectors of a linear rotor.

A resonance is passed late, lower and wider, and rings on beyond.

Under the force F(ω) e^{iφ}, dφ/dt = ω = ω_0 + a t, the amplitude of the motion is the mean of A(ω) = D(ω)⁻¹ F(ω), as it
would be at steady speeds, over a chirp: q(ω) = sqrt(i / 2πa) ∫ A(ν) exp(-i (ν - ω)² / 2a) dν. With A written in partial
fractions r / (ω - p), p the natural frequencies (a complex number, the imaginary part the rate of decay), this is

    q(ω) = A(ω) + Σ r [sqrt(i / 2πa) iπ w(z) - 1 / (ω - p)],   z = (p - ω) sqrt(i / 2a),

w(z) = exp(-z²) erfc(-iz). Exact for matrices that do not depend on speed, and for unbalance: its force on a rotor that
speeds up, m e (ω² - i a), is ω² m e in A. Source: Lewis 1932, Trans. ASME 54:253-261; w: Weideman 1994, SIAM J. Numer.
Anal. 31:1497-1518.
"""

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Complex, Float

from rotorjax.model.conditions import Conditions
from rotorjax.model.contract import OperatingPoint, SweepEffect
from rotorjax.model.model import Model
from rotorjax.physics.assembly import Assembled, Chain, assemble, matrices_of, point_at, true_speed
from rotorjax.physics.planar import Matrix, Vector

TERMS = 32
"""Of the rational approximation of w: an error below 1e-12."""
FAR = 60.0
"""Squares of |z|, doubled, from which w's own expansion is as good."""
EXPANSION = (1.0, 3.0, 15.0, 105.0, 945.0, 10395.0)
"""Of w(z) z √π / i by 1 / 2z², from the first power on."""
APART = 1e-6
"""Relative difference by which two equal stiffnesses are taken apart: partial fractions need simple poles."""
ITERATIONS = 40
"""Of the search for natural frequencies."""
SLOWEST = 1e-9
"""Rate over the square of the distance from a natural frequency up to which nothing rings on."""


def _rational() -> tuple[float, Float[np.ndarray, "_"]]:
    """Scale and coefficients of Weideman's approximation."""
    scale, points = np.sqrt(TERMS / np.sqrt(2.0)), 2 * TERMS
    t = scale * np.tan(np.arange(1 - points, points) * np.pi / (2 * points))
    values = np.concatenate([[0.0], np.exp(-(t**2)) * (scale**2 + t**2)])
    return float(scale), np.real(np.fft.fft(np.fft.fftshift(values)))[1 : TERMS + 1][::-1] / (2 * points)


SCALE, COEFFICIENTS = _rational()


def faddeeva(z: Complex[Array, ""]) -> Complex[Array, ""]:
    """w(z) = exp(-z²) erfc(-iz) in the upper half of the plane."""
    below = SCALE - 1j * z
    return 2.0 * jnp.polyval(jnp.asarray(COEFFICIENTS), (SCALE + 1j * z) / below) / below**2 + 1.0 / (
        np.sqrt(np.pi) * below
    )


def kept(pole: Complex[Array, ""], frequency: Float[Array, ""], rate: Float[Array, ""]) -> Complex[Array, ""]:
    """What a sweep makes of 1/(ω - p), less that itself; zero without a sweep, and smooth there."""
    distance = pole - frequency
    size = jnp.real(distance) ** 2 + jnp.imag(distance) ** 2
    small = -1j * rate / distance**2
    expanded = -small * jnp.polyval(jnp.asarray(EXPANSION[::-1]), small) / distance
    far = FAR * jnp.abs(rate) < size
    moves = jnp.abs(rate) > SLOWEST * size
    safe = jnp.where(moves, rate, size)
    turned = (1.0 + 1j * jnp.sign(safe)) / np.sqrt(2.0)
    z = distance * turned / jnp.sqrt(2.0 * jnp.abs(safe))
    passed = jnp.imag(z) < 0.0
    own = jnp.where(passed, -1.0, 1.0)
    each = turned / jnp.sqrt(2.0 * jnp.pi * jnp.abs(safe)) * 1j * jnp.pi
    rings = jnp.where(passed & moves, 2.0 * each * jnp.exp(-(jnp.where(passed & moves, z, 1.0) ** 2)), 0.0)
    near = own * each * faddeeva(jnp.where(far, 1j, own * z)) + 1.0 / distance
    return jnp.where(far, expanded, near) + rings


class _Poles(NamedTuple):
    """The natural frequencies at one operating point, forward or backward, and D there."""

    frequency: Complex[Array, "mode"]
    dynamic: Matrix
    """D there, over a stiffness; leading axis: mode."""
    slope: Complex[Array, "mode"]
    """Derivative of its determinant, times that stiffness."""


def _poles(model: Model, point: OperatingPoint) -> _Poles:
    """Both zeros of det D(ω) with a positive real part, D with what the support does at the point's own frequency."""
    own = matrices_of(model, point)
    stiffness = dataclasses.replace(own.stiffness, xx=own.stiffness.xx * (1.0 + APART))
    # Over sqrt(mean stiffness / mass), so that coefficients are of the size of one.
    unit = jnp.sqrt(jnp.real(0.5 * (stiffness.xx + stiffness.yy) / own.mass.xx))
    size = own.mass.xx * unit**2
    parts = [(1.0 / size) * stiffness, (1j * unit / size) * own.damping, (-(unit**2) / size) * own.mass]

    def along(name: str) -> Array:
        return jnp.stack([getattr(part, name) + 0j for part in parts[::-1]])

    determinant = jnp.convolve(along("xx"), along("yy")) - jnp.convolve(along("xy"), along("yx"))
    fixed = jax.lax.stop_gradient(determinant / determinant[0])
    axes = jnp.sqrt(jax.lax.stop_gradient(jnp.stack([stiffness.xx, stiffness.yy]) + 0j) / size)
    begun = jnp.concatenate([axes * (1.0 + 0.01j), -axes * (1.0 - 0.02j)]) * (1.0 + 0.03 * jnp.arange(4))

    def better(_: Array, roots: Array) -> Array:
        apart = roots[:, None] - roots[None] + jnp.eye(4)
        return roots - jnp.polyval(fixed, roots) / jnp.prod(apart, axis=1)

    roots = jax.lax.fori_loop(0, ITERATIONS, better, begun)
    roots = roots[jnp.argsort(-jnp.real(roots))[:2]]
    slope = jnp.polyder(determinant)
    # One more step, which takes the derivative along.
    roots = roots - jnp.polyval(determinant, roots) / jax.lax.stop_gradient(jnp.polyval(slope, roots))
    dynamic = Matrix(*(jnp.polyval(along(name), roots) for name in ("xx", "xy", "yx", "yy")))
    return _Poles(roots * unit, dynamic, jnp.polyval(slope, roots) * size / unit)


def _added(model: Model, point: OperatingPoint, rate: Float[Array, ""]) -> Vector:
    """What a sweep adds to the motion of the disk [m]."""
    poles = _poles(model, point)

    def drive(speed: Array) -> Array:
        force = assemble(model, point._replace(speed=speed)).drive
        return jnp.stack([force.x + 0j, force.y + 0j])

    order = jnp.where(point.order == 0.0, 1.0, point.order)

    def part(pole: Array, dynamic: Matrix, slope: Array) -> Array:
        force, change = jax.jvp(drive, (jnp.real(pole) / order,), (jnp.ones(()),))
        force = force + 1j * jnp.imag(pole) / order * change
        moved = jnp.stack([
            dynamic.yy * force[0] - dynamic.xy * force[1],
            dynamic.xx * force[1] - dynamic.yx * force[0],
        ])  # fmt: skip
        stable = (jnp.real(pole) > 0.0) & (jnp.imag(pole) > 0.0)
        return jnp.where(stable, moved / slope * kept(pole, point.frequency, rate * point.order), 0.0)

    both = jnp.sum(jax.vmap(part)(*poles), axis=0)
    return Vector(both[0], both[1])


def rate_of(model: Model, condition: Conditions) -> Float[Array, ""]:
    """Rate of the speed [rad/s²]: what is stated, and what effects add."""
    stated = jnp.zeros(()) if condition.sweep is None else condition.sweep
    return stated + sum((e.added_sweep() for e in model.effects if isinstance(e, SweepEffect)), jnp.zeros(()))


def sweeps(model: Model, conditions: Conditions) -> bool:
    """Whether anything says that the speed changes."""
    return conditions.sweep is not None or any(isinstance(e, SweepEffect) for e in model.effects)


def added_by_sweep(model: Model, condition: Conditions) -> Complex[Array, "probe order"]:
    """What the sweep of one case adds to its vectors [m]: that of the linear rotor, where forces depend on motion."""
    rate = rate_of(model, condition)
    condition = dataclasses.replace(condition, speed=true_speed(model, condition.speed))
    orders = jnp.asarray(model.layout.orders, dtype=condition.speed.dtype)

    def at_order(order: Float[Array, ""], index: Array) -> Complex[Array, "probe"]:
        point = point_at(model, condition, order, index)
        return _read(model, point, assemble(model, point), _added(model, point, rate))

    return jax.vmap(at_order, out_axes=1)(orders, jnp.arange(len(orders)))


def _read(model: Model, point: OperatingPoint, assembled: Assembled, added: Vector) -> Complex[Array, "probe"]:
    """What the measuring chain shows of a motion that is added."""
    chain, nothing = Chain.of(model, point), Vector(jnp.zeros((), complex), jnp.zeros((), complex))
    still = assembled.motion_of(nothing)
    moved = assembled.motion_of(added)
    return (chain.sensed(model.probes, moved) - chain.sensed(model.probes, still)) * chain.turn
