"""What a term of a missing force says of itself, beside what every effect does."""

import abc
from typing import ClassVar

import jax.numpy as jnp
from jax import Array

from rotorjax.model.contract import Effect


class Term(Effect):
    """A simple force that no named effect of the catalogue explains."""

    words: ClassVar[str]
    """What people call it, in a few words."""
    sides: ClassVar[tuple[float, ...]] = (1.0,)
    """Signs that the gap may have, if there is one."""
    alike: ClassVar[tuple[str, ...]] = ()
    """Terms that do nearly the same to some orders, so that only the response may tell them apart."""
    reached: ClassVar[str] = "of"
    """The word between these words and the size of the gap."""

    @abc.abstractmethod
    def axis(self) -> int | None:
        """0 along x, 1 along y, none in every direction."""


class AxisForce(Term):
    """A force along one axis. The texts of a shape say {a} for the axis and {rate} for the velocity along it: see
    `rotorjax.effects.terms.along`.
    """

    @abc.abstractmethod
    def axis(self) -> int:
        """0 for x, 1 for y."""

    def placed(self, value: Array) -> Array:
        """The pair that has this value along the axis."""
        zero = jnp.zeros_like(value)
        return jnp.stack([value, zero] if self.axis() == 0 else [zero, value])
