"""What drives the rotor besides what was installed on purpose."""

from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from rotorjax.model.conditions import Layout
from rotorjax.model.contract import (
    AbstractRotor,
    Excitation,
    ExcitationEffect,
    Family,
    OperatingPoint,
    Plan,
    SweepEffect,
)
from rotorjax.model.parameters import Form, only, parameter
from rotorjax.units import RPM


class ResidualUnbalance(ExcitationEffect):
    """F_1 += Ω² (U_x + iU_y) f: the same in every run."""

    name: ClassVar[str] = "residual_unbalance"
    family: ClassVar[Family] = "excitation"
    meaning: ClassVar[str] = (
        "unbalance of the rotor itself, without the weights of [runs]: initial unbalance (ISO 21940-2)"
    )
    source: ClassVar[str] = "ISO 21940-11:2016, clause 4; Jeffcott, Phil. Mag. 37 (1919) 304-314"
    relatives: ClassVar[tuple[str, ...]] = ("residual_bow",)
    unbalance_x_kg_m: Array = parameter("component along x", scale=1.0, of="unbalance")
    unbalance_y_kg_m: Array = parameter("component 90° on in the sense of rotation", scale=1.0, of="unbalance")

    def excitation(self, point: OperatingPoint) -> Excitation:
        pair = jnp.stack([self.unbalance_x_kg_m, self.unbalance_y_kg_m])
        return Excitation(force=point.forward(point.at_order(1.0) * point.speed**2 * pair))


class ResidualBow(ExcitationEffect):
    """s += S_x + iS_y, an offset of the support path: F_1 = K_p s f."""

    name: ClassVar[str] = "residual_bow"
    family: ClassVar[Family] = "excitation"
    meaning: ClassVar[str] = "permanently bent shaft; at slow roll a probe reads the bow itself"
    source: ClassVar[str] = "Nicholas, Gunter, Allaire, J. Eng. Power 98 (1976) 171-181"
    relatives: ClassVar[tuple[str, ...]] = ("residual_unbalance", "misalignment")
    bow_x_m: Array = parameter("component along x", scale=2.0, of="eccentricity")
    bow_y_m: Array = parameter("component 90° on in the sense of rotation", scale=2.0, of="eccentricity")

    def excitation(self, point: OperatingPoint) -> Excitation:
        pair = jnp.stack([self.bow_x_m, self.bow_y_m])
        return Excitation(offset=point.forward(point.at_order(1.0) * pair))


class ThermalBow(ExcitationEffect):
    """s += (S_x + iS_y)(Ω/Ω_ref)², Ω_ref the mean natural frequency: heat that grows with speed bends the shaft.

    With equal stiffness along x and y the same as an unbalance. Not the Morton or Newkirk effect, whose bow follows the
    vibration and drifts.
    """

    name: ClassVar[str] = "thermal_bow"
    family: ClassVar[Family] = "excitation"
    meaning: ClassVar[str] = "bow fixed in the shaft that grows with speed squared, as by heat; no constant part"
    source: ClassVar[str] = "de Jongh, Morton, J. Eng. Gas Turbines Power 118 (1996) 816-823"
    relatives: ClassVar[tuple[str, ...]] = ("residual_unbalance", "residual_bow")
    bow_x_m: Array = parameter("component along x at the natural frequency", scale=1.0, of="eccentricity")
    bow_y_m: Array = parameter("component 90° on, likewise", scale=1.0, of="eccentricity")

    def excitation(self, point: OperatingPoint) -> Excitation:
        pair = jnp.stack([self.bow_x_m, self.bow_y_m])
        growth = (point.speed / point.rotor.natural_frequency()) ** 2
        return Excitation(offset=point.forward(point.at_order(1.0) * growth * pair))


class Misalignment(ExcitationEffect):
    """F_1 += (P_x + iP_y) f, constant with speed; F_2 += two free complex forces along x and y."""

    name: ClassVar[str] = "misalignment"
    sufficient: ClassVar[Plan] = Plan(orders=(1.0, 2.0))
    family: ClassVar[Family] = "excitation"
    meaning: ClassVar[str] = "coupling forces of misaligned shafts, once and twice per turn"
    source: ClassVar[str] = (
        "Gibbons, 5th Turbomachinery Symp. (1976) 111-116; Sekhar, Prabhu, J. Sound Vib. 185 (1995) 655-671"
    )
    relatives: ClassVar[tuple[str, ...]] = ("residual_bow",)
    force_1_x_n: Array = parameter("1X force turning with the shaft, along x", scale=1.0, of="force")
    force_1_y_n: Array = parameter("1X force turning with the shaft, 90° on", scale=1.0, of="force")
    force_2_x_real_n: Array = parameter("2X force along x, in phase", scale=1.0, of="force")
    force_2_x_imaginary_n: Array = parameter("2X force along x, 90° ahead", scale=1.0, of="force")
    force_2_y_real_n: Array = parameter("2X force along y, in phase", scale=1.0, of="force")
    force_2_y_imaginary_n: Array = parameter("2X force along y, 90° ahead", scale=1.0, of="force")

    @classmethod
    def forms(cls, layout: Layout, angles: Float[np.ndarray, "probe"]) -> tuple[Form, ...]:
        """Twice per turn only."""
        if not {1.0, 2.0} <= set(layout.orders):
            return ()
        return (only(f"force_2_{axis}_{part}_n" for axis in "xy" for part in ("real", "imaginary")),)

    def excitation(self, point: OperatingPoint) -> Excitation:
        once = point.forward(point.at_order(1.0) * jnp.stack([self.force_1_x_n, self.force_1_y_n]))
        real = jnp.stack([self.force_2_x_real_n, self.force_2_y_real_n])
        imaginary = jnp.stack([self.force_2_x_imaginary_n, self.force_2_y_imaginary_n])
        twice = point.at_order(2.0)
        return Excitation(force=once + jax.lax.complex(twice * real, twice * imaginary))


class PlaneParticipation(ExcitationEffect):
    """Unbalance installed in plane p counts (1 + g_p) times: mode shape, or its axial position, off. Of all planes but
    the first, as a factor of all of them is one of the readings, `ChainGain`.
    """

    name: ClassVar[str] = "plane_participation"
    sufficient: ClassVar[Plan] = Plan(planes=2)
    family: ClassVar[Family] = "excitation"
    meaning: ClassVar[str] = "a balancing plane drives the mode more or less, against the first, than the rig file says"
    source: ClassVar[str] = "Bishop, Gladwell, J. Mech. Eng. Sci. 1 (1959) 66-77"
    gain: Array = parameter("relative error of the participation", scale=0.1, axes=("plane",))

    def excitation(self, point: OperatingPoint) -> Excitation:
        pair = jnp.sum(self.gain[:, None] * point.unbalance[1:], axis=0)
        return Excitation(force=point.forward(point.at_order(1.0) * point.speed**2 * pair))


class SweepRate(SweepEffect):
    """dΩ/dt += a while vectors are read, as in a run-up: q = sqrt(i / 2πa) ∫ A(ν) exp(-i (ν - Ω)² / 2a) dν, A the
    steady amplitude.
    """

    name: ClassVar[str] = "sweep_rate"
    family: ClassVar[Family] = "excitation"
    meaning: ClassVar[str] = (
        "read while the speed changes: a resonance is passed late, lower and wider, and rings on beyond"
    )
    source: ClassVar[str] = (
        "Lewis, Trans. ASME 54 (1932) 253-261; Genta, Dynamics of Rotating Systems, Springer 2005, chapter 4"
    )
    relatives: ClassVar[tuple[str, ...]] = ("damping_error", "speed_error", "stiffness_error")
    sufficient: ClassVar[Plan] = Plan(speeds=(0.7, 0.9, 0.95, 1.0, 1.05, 1.1, 1.2, 1.4))
    rate_rad_per_s2: Array = parameter("rate of the speed", scale=3.0, of="sweep")
    starts: ClassVar[tuple[dict[str, float], ...]] = (
        {},
        *({"rate_rad_per_s2": sign * size} for size in (0.1, 0.4, 1.5) for sign in (1.0, -1.0)),
    )

    def added_sweep(self) -> Array:
        return self.rate_rad_per_s2

    def remark(self, rotor: AbstractRotor) -> str | None:
        rate = float(self.rate_rad_per_s2) / RPM
        if rate == 0.0:
            return None
        return (
            f"means that the speed changed by {rate:.3g} rpm/s while vectors were read: state it in a column "
            "sweep_rpm_per_s of the table, or dwell at each speed"
        )
