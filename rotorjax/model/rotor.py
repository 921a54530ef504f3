"""The Jeffcott rotor with unequal stiffness along x and y."""

from typing import Any, Literal

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from rotorjax.arrays import Numbers, as_float, is_known
from rotorjax.model.contract import AbstractRotor
from rotorjax.units import RPM


def _pair(value: Numbers) -> Array:
    pair = as_float(value)
    return jnp.stack([pair, pair]) if pair.ndim == 0 else pair


def _require_finite(what: str, value: Array, unit: str) -> None:
    if is_known(value) and not np.all(np.isfinite(np.asarray(value))):
        raise ValueError(f"{what} of a rotor is {np.asarray(value).tolist()}: give finite numbers [{unit}]")


def _squared(critical_speed_rpm: Numbers) -> Array:
    """Square of a critical speed [rad²/s²]."""
    speed = as_float(critical_speed_rpm)
    if is_known(speed) and not np.all(np.isfinite(np.asarray(speed)) & (np.asarray(speed) > 0.0)):
        raise ValueError(f"critical_speed_rpm is {np.asarray(speed).tolist()}: it must be positive and finite")
    return (speed * RPM) ** 2


class Jeffcott(AbstractRotor):
    """A disk of mass M on a light shaft: M q̈ + C q̇ + K q = F, C and K diagonal with unequal entries.

    c_i = 2 ζ_i sqrt(k_i M); natural frequencies sqrt(k_i / M) are the critical speeds of the undamped rotor.
    (Jeffcott 1919, Phil. Mag. 37:304-314; Huang et al. 2026, Sensors 26:2565, equations 1-4.)

    **Fields:** ``mass`` [kg]; ``stiffness`` [N/m] and ``damping_ratio`` [1], along x and y, or one number for
    both; ``gravity`` [m/s²] along x and y, zero for a vertical shaft; ``rotation``: sense of rotation;
    ``bow_through_damping``: the damper stands in series with the bent shaft, as bearings do, and a bow drives
    through K + iωC instead of K (the paper's equation).
    **Errors.** ``ValueError`` for other shapes; where these are known numbers, for mass or stiffness that is not
    positive, a negative damping ratio, and any of them or gravity that is not finite.
    """

    mass: Float[Array, ""] = eqx.field(converter=as_float)
    stiffness: Float[Array, "dof"] = eqx.field(converter=_pair)
    damping_ratio: Float[Array, "dof"] = eqx.field(converter=_pair)
    gravity: Float[Array, "dof"] = eqx.field(converter=_pair, default=0.0)
    rotation: Literal["x-to-y", "y-to-x"] = eqx.field(static=True, default="x-to-y")
    bow_through_damping: bool = eqx.field(static=True, default=False)

    def __check_init__(self) -> None:
        if self.rotation not in ("x-to-y", "y-to-x"):
            raise ValueError(f"rotation is {self.rotation!r}: write x-to-y or y-to-x")
        if self.stiffness.shape != (2,) or self.damping_ratio.shape != (2,):
            raise ValueError(
                f"stiffness and damping ratio have shapes {self.stiffness.shape} and {self.damping_ratio.shape}: "
                "give one number, or one along x and one along y"
            )
        if self.mass.shape != () or self.gravity.shape != (2,):
            raise ValueError(
                f"mass and gravity have shapes {self.mass.shape} and {self.gravity.shape}: the mass is one number "
                "[kg], gravity one along x and one along y [m/s²], as in [0.0, -9.81]"
            )
        _require_finite("mass", self.mass, "kg")
        _require_finite("stiffness", self.stiffness, "N/m")
        _require_finite("damping ratio", self.damping_ratio, "a share of the critical damping, as in 0.02")
        _require_finite("gravity", self.gravity, "m/s², zero for a vertical shaft")
        if is_known(self.mass, self.stiffness) and not (
            float(self.mass) > 0.0 and np.all(np.asarray(self.stiffness) > 0.0)
        ):
            raise ValueError("mass [kg] and stiffness [N/m] of a rotor must be positive")
        if is_known(self.damping_ratio) and not np.all(np.asarray(self.damping_ratio) >= 0.0):
            raise ValueError(
                "a damping ratio must not be negative: write an unstable rotor with cross_coupling or internal_damping"
            )

    @property
    def damping(self) -> Float[Array, "dof"]:
        """Viscous damping c_i [N s/m]."""
        if is_known(self.damping_ratio, self.stiffness, self.mass):
            return as_float(
                2.0 * np.asarray(self.damping_ratio) * np.sqrt(np.asarray(self.stiffness) * np.asarray(self.mass))
            )
        return 2.0 * self.damping_ratio * jnp.sqrt(self.stiffness * self.mass)

    @property
    def spin(self) -> int:
        """+1 for a shaft turning from x to y, else -1."""
        return 1 if self.rotation == "x-to-y" else -1

    def critical_speeds_rpm(self) -> Float[Array, "dof"]:
        """Undamped critical speeds sqrt(k_i / M) along x and y [rpm]."""
        return jnp.sqrt(self.stiffness / self.mass) / RPM

    @classmethod
    def from_critical_speed(
        cls, *, mass: Numbers, critical_speed_rpm: Numbers, damping_ratio: Numbers, **settings: Any
    ) -> "Jeffcott":
        """The rotor whose undamped critical speeds along x and y are these: k = M ω².

        **Errors.** ``ValueError`` for a critical speed that is not positive, and as for the rotor.
        """
        stiffness = as_float(mass) * _squared(critical_speed_rpm)
        return cls(mass, stiffness, damping_ratio, **settings)  # pyright: ignore


def in_series(*stiffnesses: Numbers) -> Float[Array, "*dof"]:
    """Stiffness of springs one after the other, (Σ 1/k)⁻¹ [N/m]: a shaft in its bearings."""
    return 1.0 / sum(1.0 / as_float(k) for k in stiffnesses)  # pyright: ignore


def bearing_stiffness(*, critical_speed_rpm: Numbers, mass: Numbers, shaft_stiffness: Numbers) -> Float[Array, "*dof"]:
    """Bearings' stiffness from a measured first critical speed: 1/k_b = 1/(M ω²) - 1/k_s [N/m].

    **Errors.** ``ValueError`` for a critical speed that is not positive, and where it is as high as that of the shaft
    in rigid bearings, or higher.
    """
    whole, shaft = as_float(mass) * _squared(critical_speed_rpm), as_float(shaft_stiffness)
    if not np.all(np.asarray(whole) < np.asarray(shaft)):
        raise ValueError(
            f"M ω² = {np.max(np.asarray(whole)):.5g} N/m reaches the shaft's own stiffness: check mass, critical speed "
            "and shaft stiffness"
        )
    return 1.0 / (1.0 / whole - 1.0 / shaft)


SHAFT_SHARE = 17.0 / 35.0
"""Part of a simply supported uniform shaft's mass that moves with a disk at midspan, by Rayleigh's method with the
static deflection line (Rao, Mechanical Vibrations, section 2.5).
"""


def effective_mass(disk: Numbers, shaft: Numbers) -> Float[Array, "*dof"]:
    """Mass of a disk at midspan with its part of the shaft [kg]."""
    return as_float(disk) + SHAFT_SHARE * as_float(shaft)
