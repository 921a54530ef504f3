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
import math
from collections.abc import Iterable
from typing import Any, NamedTuple

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

TERMS = 16
"""Of the rational approximation of w: an error below 1e-6."""
FAR = 60.0
"""Squares of |z|, doubled, from which w's own expansion is as good."""
EXPANSION = (1.0, 3.0, 15.0, 105.0, 945.0, 10395.0)
"""Of w(z) z √π / i by 1 / 2z², from the first power on."""
APART = 1e-6
"""Relative difference by which two equal stiffnesses are taken apart: partial fractions need simple poles."""
ITERATIONS = 40
"""Of the search for natural frequencies."""
NODES = (0.7, 1.0, 1.3)
"""Frequencies at which forces are taken, in the mean natural frequency."""
SLOWEST = 1e-9
"""Rate over the square of the distance from a natural frequency up to which nothing rings on."""


def _rational() -> tuple[float, Float[np.ndarray, "_"]]:
    """Scale and coefficients of Weideman's approximation."""
    scale, points = np.sqrt(TERMS / np.sqrt(2.0)), 2 * TERMS
    t = scale * np.tan(np.arange(1 - points, points) * np.pi / (2 * points))
    values = np.concatenate([[0.0], np.exp(-(t**2)) * (scale**2 + t**2)])
    return float(scale), np.real(np.fft.fft(np.fft.fftshift(values)))[1 : TERMS + 1][::-1] / (2 * points)


SCALE, COEFFICIENTS = _rational()


def _polynomial(coefficients: Iterable[Any], at: Array) -> Array:
    """The highest power first, written out: a loop would cost many times as much."""
    value = jnp.zeros_like(at)
    for coefficient in coefficients:
        value = value * at + coefficient
    return value


@jax.custom_jvp
def faddeeva(z: Complex[Array, ""]) -> Complex[Array, ""]:
    """w(z) = exp(-z²) erfc(-iz) in the upper half of the plane."""
    below = SCALE - 1j * z
    rational = _polynomial(COEFFICIENTS, (SCALE + 1j * z) / below)
    return 2.0 * rational / below**2 + 1.0 / (np.sqrt(np.pi) * below)


@faddeeva.defjvp
def _slope_of_faddeeva(at: tuple[Array], change: tuple[Array]) -> tuple[Array, Array]:
    """dw/dz = -2 z w + 2i / sqrt π."""
    w = faddeeva(*at)
    return w, (2j / np.sqrt(np.pi) - 2.0 * at[0] * w) * change[0]


def pole_by_sweep(pole: Complex[Array, ""], frequency: Float[Array, ""], rate: Float[Array, ""]) -> Complex[Array, ""]:
    """What a sweep makes of 1/(ω - p), less that itself; zero without a sweep, and smooth there."""
    distance = pole - frequency
    size = jnp.real(distance) ** 2 + jnp.imag(distance) ** 2
    small = -1j * rate / distance**2
    expanded = -small * _polynomial(EXPANSION[::-1], small) / distance
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
    """The two natural frequencies at one operating point whose real parts are positive, and D there."""

    frequency: Complex[Array, "pole"]
    dynamic: Matrix
    """D there, over a stiffness; leading axis: pole."""
    slope: Complex[Array, "pole"]
    """Derivative of its determinant, times that stiffness."""


def _poles(model: Model, point: OperatingPoint) -> _Poles:
    """Zeros of det D(ω), D with what the support does at the point's own frequency."""
    own = matrices_of(model, point)
    stiffness = dataclasses.replace(own.stiffness, xx=own.stiffness.xx * (1.0 + APART))
    # Over sqrt(mean stiffness / mass), so that coefficients are of the size of one.
    unit = jnp.sqrt(jnp.real(0.5 * (stiffness.xx + stiffness.yy) / own.mass.xx))
    size = own.mass.xx * unit**2
    parts = (-(unit**2) / size) * own.mass, ((unit / size) * own.damping).quadrature, (1.0 / size) * stiffness
    xx, xy, yx, yy = ([getattr(part, name) for part in parts] for name in ("xx", "xy", "yx", "yy"))
    determinant = [a - b for a, b in zip(_product(xx, yy), _product(xy, yx), strict=True)]
    slope = [power * value for power, value in zip((4.0, 3.0, 2.0, 1.0), determinant, strict=False)]
    axes = (jnp.sqrt(jax.lax.stop_gradient(at + 0j) / size) for at in (stiffness.xx, stiffness.yy))
    roots = _roots(jax.lax.stop_gradient([value / determinant[0] for value in determinant]), *axes)
    # One more step, which takes the derivative along.
    at = roots - _polynomial(determinant, roots) / jax.lax.stop_gradient(_polynomial(slope, roots))
    dynamic = Matrix(*(_polynomial(part, at) for part in (xx, xy, yx, yy)))
    return _Poles(at * unit, dynamic, _polynomial(slope, at) * size / unit)


def _product(one: list[Array], other: list[Array]) -> list[Array]:
    """Coefficients of the product of two quadratic polynomials."""
    a, b, c = one
    d, e, f = other
    return [a * d, a * e + b * d, a * f + b * e + c * d, b * f + c * e, c * f]


def _roots(determinant: list[Array], first: Array, second: Array) -> Complex[Array, "pole"]:
    """Two roots, begun near these, by Newton's method with the others divided out, of which each is opposite to one of
    the two, as they are for real matrices (Kerner 1966, Numer. Math. 8:290-294).
    """

    def better(_: Array, roots: tuple[Array, Array]) -> tuple[Array, Array]:
        one, other = roots
        across = one + jnp.conj(other)
        apart = one - other
        return (
            one - _polynomial(determinant, one) / (apart * 2.0 * jnp.real(one) * across),
            other + _polynomial(determinant, other) / (apart * 2.0 * jnp.real(other) * jnp.conj(across)),
        )

    return jnp.stack(jax.lax.fori_loop(0, ITERATIONS, better, (first * (1.0 + 0.01j), second * (1.03 + 0.02j))))


def _added(model: Model, point: OperatingPoint, rate: Float[Array, ""]) -> Vector:
    """What a sweep adds to the motion of the disk [m]."""
    order = jnp.where(point.order == 0.0, 1.0, point.order)
    # What drives the rotor is a parabola over speed: known at three of them, it is at complex ones.
    nodes = jnp.asarray(NODES) * model.rotor.natural_frequency()

    def drive(frequency: Array) -> tuple[Array, Array]:
        force = assemble(model, point._replace(speed=frequency / order)).drive
        return force.x + 0j, force.y + 0j

    x, y = jax.vmap(drive)(nodes)

    def of_pole(frequency: Array, dynamic: Matrix, slope: Array) -> tuple[Array, Array]:
        weights = jnp.stack([
            math.prod((frequency - nodes[k]) / (nodes[own] - nodes[k]) for k in range(len(NODES)) if k != own)
            for own in range(len(NODES))
        ])  # fmt: skip
        push = Vector(jnp.sum(weights * x), jnp.sum(weights * y))
        stable = (jnp.real(frequency) > 0.0) & (jnp.imag(frequency) > 0.0)
        share = jnp.where(stable, pole_by_sweep(frequency, point.frequency, rate * point.order) / slope, 0.0)
        d = dynamic
        return share * (d.yy * push.x - d.xy * push.y), share * (d.xx * push.y - d.yx * push.x)

    return Vector(*(jnp.sum(part) for part in jax.vmap(of_pole)(*_poles(model, point))))


def rate_of(model: Model, condition: Conditions) -> Float[Array, ""]:
    """Rate of the speed [rad/s²]: what is stated, and what effects add."""
    stated = jnp.zeros(()) if condition.sweep is None else condition.sweep
    return stated + sum((e.added_sweep() for e in model.effects if isinstance(e, SweepEffect)), jnp.zeros(()))


def sweeps(model: Model, conditions: Conditions) -> bool:
    """Whether anything says that the speed changes."""
    return conditions.sweep is not None or any(isinstance(e, SweepEffect) for e in model.effects)


def added_by_sweep(model: Model, condition: Conditions) -> Complex[Array, "probe order"]:
    """What the sweep of one case adds to its vectors [m]: that of the linear rotor, where forces are nonlinear."""
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
