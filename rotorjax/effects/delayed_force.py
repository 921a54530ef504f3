"""A force that follows the motion of the rotor with a delay, as that of a control loop does."""

import math
from typing import ClassVar

import jax.numpy as jnp
from jax import Array

from rotorjax.effects.term import Term
from rotorjax.model.contract import Family, Matrices, MatrixEffect, OperatingPoint, Plan
from rotorjax.model.parameters import parameter

DELAY = "delay_s"
"""The parameter that is the delay."""
PERIODS = tuple(0.125 * k for k in range(1, 33))
"""Delays that a regression tries, in natural periods of the rotor: from one to the next the phase at the natural
frequency changes by 45°.
"""


class DelayedForce(Term, MatrixEffect):
    """D += k e^{-iωτ}: f(t) = k q(t - τ), τ the delay."""

    name: ClassVar[str] = "term_delayed_force"
    family: ClassVar[Family] = "structure"
    meaning: ClassVar[str] = "a force in proportion to the displacement some time earlier, as from a control loop"
    source: ClassVar[str] = "Stépán, Retarded Dynamical Systems, Longman 1989, chapter 3"
    words: ClassVar[str] = "force in proportion to an earlier displacement"
    relatives: ClassVar[tuple[str, ...]] = ("foundation", "damping_error", "stiffness_error")
    sufficient: ClassVar[Plan] = Plan(speeds=(0.6, 0.7, 0.8, 0.9, 1.1, 1.25, 1.4, 1.6))
    starts: ClassVar[tuple[dict[str, float], ...]] = tuple(
        {"stiffness_n_per_m": side * 0.1, DELAY: 0.25 * k} for side in (1.0, -1.0) for k in range(1, 15)
    )
    stiffness_n_per_m: Array = parameter("force per displacement", scale=0.05, of="stiffness")
    delay_s: Array = parameter("delay", scale=2.0 * math.pi, of="period", shape_only=True)

    def axis(self) -> None:
        """In every direction alike."""

    def matrices(self, point: OperatingPoint) -> Matrices:
        angle = point.frequency * self.delay_s
        # -sin(ωτ)/ω, at rest too.
        return Matrices(
            stiffness=self.stiffness_n_per_m * jnp.cos(angle) * jnp.eye(2),
            damping=-self.stiffness_n_per_m * self.delay_s * jnp.sinc(angle / math.pi) * jnp.eye(2),
        )
