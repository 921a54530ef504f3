"""2x2 linear algebra by components: under ``vmap`` each component is one long vector, eight times faster than (2, 2)
arrays.
"""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Inexact


def product(a: Any, b: Any) -> Any:
    """Of two numbers, real or complex. That of a real and a complex one part by part: compiled, the real one would be
    made complex first, and half of the work would be with zero.
    """
    if jnp.iscomplexobj(a) and not jnp.iscomplexobj(b):
        a, b = b, a
    if jnp.iscomplexobj(b) and not jnp.iscomplexobj(a):
        return jax.lax.complex(a * jnp.real(b), a * jnp.imag(b))
    return a * b


def reciprocal(value: Any) -> Any:
    """1/value. Of a complex one without the care for infinite numbers that compiled division takes."""
    if not jnp.iscomplexobj(value):
        return 1.0 / value
    real, imaginary = jnp.real(value), jnp.imag(value)
    size = real**2 + imaginary**2
    return jax.lax.complex(real / size, -imaginary / size)


def quadrature(value: Any) -> Any:
    """i times a number."""
    if jnp.iscomplexobj(value):
        return jax.lax.complex(-jnp.imag(value), jnp.real(value))
    return jax.lax.complex(jnp.zeros_like(value), jnp.asarray(value))


DOF = 2
"""Degrees of freedom of a disk: along x and along y."""


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Vector:
    """A pair along x and y; components are scalars, real or complex."""

    x: Any
    y: Any

    @classmethod
    def of(cls, pair: Inexact[Array, "dof"] | float) -> "Vector":
        """From an array, or a number for both components."""
        return cls(pair, pair) if isinstance(pair, float | int) else cls(pair[0], pair[1])

    def __add__(self, other: "Vector") -> "Vector":
        return Vector(self.x + other.x, self.y + other.y)

    def __sub__(self, other: "Vector") -> "Vector":
        return Vector(self.x - other.x, self.y - other.y)

    def __rmul__(self, factor: Any) -> "Vector":
        return Vector(product(factor, self.x), product(factor, self.y))


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Matrix:
    """A 2x2 matrix; components are scalars, real or complex."""

    xx: Any
    xy: Any
    yx: Any
    yy: Any

    @classmethod
    def of(cls, array: Inexact[Array, "dof dof"] | float) -> "Matrix":
        """From an array; zero from the number zero."""
        return (
            cls(0.0, 0.0, 0.0, 0.0)
            if isinstance(array, float | int)
            else cls(array[0, 0], array[0, 1], array[1, 0], array[1, 1])
        )

    @classmethod
    def diagonal(cls, x: Any, y: Any) -> "Matrix":
        """Nothing off the diagonal."""
        return cls(x, 0.0, 0.0, y)

    def __add__(self, other: "Matrix") -> "Matrix":
        return Matrix(self.xx + other.xx, self.xy + other.xy, self.yx + other.yx, self.yy + other.yy)

    def __rmul__(self, factor: Any) -> "Matrix":
        return Matrix(*(product(factor, value) for value in (self.xx, self.xy, self.yx, self.yy)))

    @property
    def determinant(self) -> Any:
        """xx yy - xy yx."""
        return product(self.xx, self.yy) - product(self.xy, self.yx)

    @property
    def quadrature(self) -> "Matrix":
        """i times the matrix."""
        return Matrix(*(quadrature(value) for value in (self.xx, self.xy, self.yx, self.yy)))

    def turned(self, angle: Any) -> "Matrix":
        """R M Rᵀ, R the turn by an angle from x towards y: half the trace and the skew part stay, the rest turns by
        twice the angle.
        """
        cosine, sine = jnp.cos(2.0 * angle), jnp.sin(2.0 * angle)
        mean, half = 0.5 * (self.xx + self.yy), 0.5 * (self.xx - self.yy)
        symmetric, skew = 0.5 * (self.xy + self.yx), 0.5 * (self.xy - self.yx)
        along, across = half * cosine - symmetric * sine, half * sine + symmetric * cosine
        return Matrix(mean + along, across + skew, across - skew, mean - along)

    def times(self, vector: Vector) -> Vector:
        """Matrix times vector."""
        return Vector(
            product(self.xx, vector.x) + product(self.xy, vector.y),
            product(self.yx, vector.x) + product(self.yy, vector.y),
        )

    def solve(self, vector: Vector) -> Vector:
        """Inverse times vector, in closed form."""
        return reciprocal(self.determinant) * Vector(
            product(self.yy, vector.x) - product(self.xy, vector.y),
            product(self.xx, vector.y) - product(self.yx, vector.x),
        )

    def inverse(self) -> "Matrix":
        """In closed form."""
        return reciprocal(self.determinant) * Matrix(self.yy, -self.xy, -self.yx, self.xx)
