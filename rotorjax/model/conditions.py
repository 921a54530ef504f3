"""What a model is asked for: names along its axes, its probes, and the conditions of every case."""

from typing import Literal, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from rotorjax.arrays import AnyArray, Numbers, as_float, is_known
from rotorjax.units import RPM

Axis = Literal["probe", "order", "plane"]


class Layout(NamedTuple):
    """The names along the axes of a model's arrays."""

    probes: tuple[str, ...] = ("X", "Y")
    planes: tuple[str, ...] = ("disk",)
    orders: tuple[float, ...] = (1.0,)

    def names(self, axis: Axis) -> tuple[str, ...]:
        """Labels along an axis. A parameter per ``plane`` has none for the first: that one defines the scale."""
        if axis == "probe":
            return self.probes
        if axis == "plane":
            return self.planes[1:]
        return tuple(f"{order:g}X" for order in self.orders)

    def require_planes(self, given: int) -> None:
        """``ValueError`` unless conditions give the unbalance of this many planes."""
        planes = len(self.planes)
        if given != planes:
            raise ValueError(
                f"unbalance is given for {given} plane{'s' * (given != 1)}, the model has {planes}: give a pair along "
                "x and y for each, zeros where nothing is installed; where it differs per case, axes (case, plane, "
                "dof), which for one plane is u[:, None]"
            )


class HarmonicBalance(NamedTuple):
    """How finely the steady state is balanced under nonlinear forces."""

    least_order: int = 7
    """Highest order balanced, at least: a crack at a third of the resonance needs 7X."""
    margin: int = 4
    """Orders balanced beyond the highest one of the model."""
    fine_order: int = 24
    """Highest order in the final refinement, which a hard stop needs."""
    samples: int = 64
    """Instants per turn of the shaft, at least, while a motion is looked for."""
    fine_samples: int = 256
    """The same in the final refinement: corners of a force fall between instants."""
    tolerance: float = 1e-6
    """Step of Newton's method, relative to the largest amplitude, at which one more step ends it."""
    newton_steps: int = 12
    """Steps of Newton's method, at most."""
    corrections: int = 24
    """Steps of the final refinement at more orders and instants, at most."""
    diverges: float = 4.0
    """Growth of a step of the final refinement, over the smallest so far, at which it ends."""


def _along_x_and_y(value: Numbers, what: str) -> AnyArray:
    """The value as an array of pairs, zero for none."""
    array = np.asarray(value) if is_known(value) else jnp.asarray(value)
    if np.issubdtype(array.dtype, np.complexfloating):
        raise ValueError(f"{what} is complex: write u as a pair along x and y, np.stack([u.real, u.imag], axis=-1)")
    if array.shape[-1:] == (2,) or (array.ndim == 0 and is_known(array) and not array):
        return array
    shown = "one number" if array.ndim == 0 else f"of shape {array.shape}"
    raise ValueError(f"{what} is {shown}: its last axis is a pair along x and y, as in {what}=[3e-5, 0.0]")


class Conditions(eqx.Module):
    """Operating conditions: how fast, and what is deliberately installed. Make one with `Conditions.at`."""

    speed: Float[Array, "*case"]
    """Ω, rad/s."""
    unbalance: Float[Array, "*case plane dof"]
    """Installed unbalance, kg m: along x and 90° on in the sense of rotation, at t = 0."""
    bow: Float[Array, "*case dof"]
    """Installed bow, m, likewise."""
    sweep: Float[Array, "*case"] | None = None
    """Rate at which the speed changes while it is read, rad/s²; none where all speeds are steady."""

    @classmethod
    def at(
        cls, speed: Numbers, *, unbalance: Numbers = 0.0, bow: Numbers = 0.0, sweep: Numbers | None = None
    ) -> "Conditions":
        """Conditions at these speeds.

        **Arguments:** ``speed`` [rad/s], a number or an array; ``unbalance`` [kg m], last axes (plane, dof), or
        (dof,) for a single plane; ``bow`` [m], last axis (dof,); ``sweep`` [rad/s²]. They are repeated over the speeds
        where needed.
        **Errors.** ``ValueError`` for an unbalance or a bow that is complex, or not a pair along x and y.
        """
        # For numbers nothing need be compiled.
        numbers, array = (
            (np, np.asarray) if is_known(speed, unbalance, bow, 0.0 if sweep is None else sweep) else (jnp, as_float)
        )
        omega = numbers.atleast_1d(array(speed))
        mass_distance, offset = (_along_x_and_y(v, what) for v, what in ((unbalance, "unbalance"), (bow, "bow")))
        if mass_distance.ndim < 2:
            mass_distance = numbers.broadcast_to(mass_distance, (1, 2))
        planes = mass_distance.shape[-2:]
        everywhere = as_float(numbers.broadcast_to(mass_distance, (*omega.shape, *planes)))
        rate = None if sweep is None else as_float(numbers.broadcast_to(array(sweep), omega.shape))
        return cls(as_float(omega), everywhere, as_float(numbers.broadcast_to(offset, (*omega.shape, 2))), rate)

    @property
    def sweeps(self) -> Float[np.ndarray, "*case"]:
        """Rate of every speed, zero where it is steady."""
        return np.zeros(np.shape(self.speed)) if self.sweep is None else np.asarray(self.sweep)

    @classmethod
    def at_rpm(
        cls, speed_rpm: Numbers, *, unbalance: Numbers = 0.0, bow: Numbers = 0.0, sweep_rpm_per_s: Numbers | None = None
    ) -> "Conditions":
        """The same with speeds in revolutions per minute."""
        speed = (np.asarray if is_known(speed_rpm) else as_float)(speed_rpm) * RPM
        rate = None if sweep_rpm_per_s is None else np.asarray(sweep_rpm_per_s) * RPM
        return cls.at(speed, unbalance=unbalance, bow=bow, sweep=rate)


class Probes(eqx.Module):
    """Displacement probes: direction from +x towards +y [rad], mode shape there relative to the disk, reference."""

    angle: Float[Array, "probe"] = eqx.field(converter=as_float)
    participation: Float[Array, "probe"] = eqx.field(converter=as_float)
    on_foundation: Float[Array, "probe"] = eqx.field(converter=as_float)
    """One where the probe reads against the foundation, zero where against the ground."""
    scale: Float[Array, ""] = eqx.field(converter=as_float, default=1.0)
    """What the measurement shows over what the probes read: one, but where amplitudes are tried as written otherwise
    than stated.
    """
    mean_scale: Float[Array, ""] = eqx.field(converter=as_float, default=1.0)
    """The same at order 0: the rms value of a constant is the constant."""


def two_probes() -> Probes:
    """At 0° and at 90°, fixed to the ground."""
    return Probes(jnp.array([0.0, jnp.pi / 2.0]), jnp.ones(2), jnp.zeros(2))
