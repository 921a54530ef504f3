"""What the measuring chain makes of the motion, and what the true speed is."""

from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from rotorjax.model.conditions import Layout
from rotorjax.model.contract import Family, OperatingPoint, Reading, ReadingEffect, SpeedEffect
from rotorjax.model.parameters import Form, one_of, only, parameter

API_670_GAIN = 0.05
"""Allowed error of a proximity probe's scale factor, interchangeability included (API 670, 5th edition, 2014)."""


def _of_track(layout: Layout, angles: Float[np.ndarray, "probe"], order: float) -> Form:
    """Real and imaginary part of one number at an order that all probes read, each later by its direction."""
    at = f"{order:g}X"
    in_phase: dict[str, float] = {}
    ahead: dict[str, float] = {}
    for probe, angle in zip(layout.probes, order * np.asarray(angles), strict=True):
        in_phase |= {f"real_m.{probe}.{at}": np.cos(angle), f"imaginary_m.{probe}.{at}": -np.sin(angle)}
        ahead |= {f"real_m.{probe}.{at}": np.sin(angle), f"imaginary_m.{probe}.{at}": np.cos(angle)}
    return in_phase, ahead


class ProbeAngle(ReadingEffect):
    """Probe p reads cos(a_p + δ_p) x + sin(a_p + δ_p) y."""

    name: ClassVar[str] = "probe_angle"
    family: ClassVar[Family] = "reading"
    meaning: ClassVar[str] = "a probe is mounted at another angle than the rig file says"
    source: ClassVar[str] = "API 670, 5th edition, 2014, section 6.1: probes within 5° of 90° apart"
    relatives: ClassVar[tuple[str, ...]] = ("phase_reference_offset",)
    angle_rad: Array = parameter("angle error, from x towards y", scale=0.0873, axes=("probe",))

    @classmethod
    def forms(cls, layout: Layout, angles: Float[np.ndarray, "probe"]) -> tuple[Form, ...]:
        return one_of(f"angle_rad.{probe}" for probe in layout.probes)

    def reading(self, point: OperatingPoint) -> Reading:
        return Reading(direction=self.angle_rad)


class Runout(ReadingEffect):
    """z += r, one complex number per probe and order, constant with speed."""

    name: ClassVar[str] = "runout"
    family: ClassVar[Family] = "reading"
    meaning: ClassVar[str] = "scratches, out-of-round or magnetised probe track: the same at every speed"
    source: ClassVar[str] = (
        "API 670, 5th edition, 2014, section 6.1; Bently, Hatch, Fundamentals of Rotating Machinery Diagnostics, 2002, "
        "chapter 6"
    )
    relatives: ClassVar[tuple[str, ...]] = ("residual_bow",)
    real_m: Array = parameter("part in phase with the reference", scale=1.0, of="runout", axes=("probe", "order"))
    imaginary_m: Array = parameter("part 90° ahead", scale=1.0, of="runout", axes=("probe", "order"))

    @classmethod
    def forms(cls, layout: Layout, angles: Float[np.ndarray, "probe"]) -> tuple[Form, ...]:
        """One shape of the track, which each probe reads when it comes by, as probes in one plane do: r_pn = s_n
        exp(-i n α_p), α_p the probe's direction; and the same, or one number per probe, at 1X only.
        """
        orders = [n for n in layout.orders if n == round(n)]
        track = tuple(part for n in orders for part in _of_track(layout, angles, n))
        if len(orders) == 1 or 1.0 not in orders:
            return (track,)
        once = _of_track(layout, angles, 1.0)
        if len(layout.probes) == 1:
            return track, once
        return track, once, only(f"{part}.{probe}.1X" for part in ("real_m", "imaginary_m") for probe in layout.probes)

    def reading(self, point: OperatingPoint) -> Reading:
        here = point.order_index
        return Reading(runout=jax.lax.complex(self.real_m[:, here], self.imaginary_m[:, here]))


class ProbeGain(ReadingEffect):
    """z_p -> z_p (1 + g_p)."""

    name: ClassVar[str] = "probe_gain"
    family: ClassVar[Family] = "reading"
    meaning: ClassVar[str] = "a probe's scale factor is off (target material, oscillator, cable length)"
    source: ClassVar[str] = "API 670, 5th edition, 2014, section 6.1: scale factor within 5 %"
    relatives: ClassVar[tuple[str, ...]] = ("chain_gain",)
    gain: Array = parameter("relative error of the scale factor", scale=API_670_GAIN, axes=("probe",))

    @classmethod
    def forms(cls, layout: Layout, angles: Float[np.ndarray, "probe"]) -> tuple[Form, ...]:
        labels = [f"gain.{probe}" for probe in layout.probes]
        return (*one_of(labels), (dict.fromkeys(labels, 1.0),))

    def reading(self, point: OperatingPoint) -> Reading:
        return Reading(gain=1.0 + self.gain)


class ChainGain(ReadingEffect):
    """z -> z |1 + g| exp(i n arg(1 + g)): one complex gain for all probes, its phase times n at order n."""

    name: ClassVar[str] = "chain_gain"
    family: ClassVar[Family] = "reading"
    meaning: ClassVar[str] = "common gain and phase of the measuring chain (filter, amplifier, units)"
    source: ClassVar[str] = "ISO 10817-1:1998, clause 5: amplitude and phase response of the measuring chain"
    relatives: ClassVar[tuple[str, ...]] = (
        "probe_gain",
        "phase_reference_offset",
        "probe_angle",
        "time_delay",
        "residual_bow",
    )
    gain_real: Array = parameter("real part of the relative error", scale=0.1)
    gain_imaginary: Array = parameter("imaginary part of the relative error", scale=0.1)
    starts: ClassVar[tuple[dict[str, float], ...]] = (
        {},
        {"gain_real": -10.0, "gain_imaginary": 10.0},
        {"gain_real": -10.0, "gain_imaginary": -10.0},
        {"gain_real": -20.0},
    )

    @classmethod
    def forms(cls, layout: Layout, angles: Float[np.ndarray, "probe"]) -> tuple[Form, ...]:
        return one_of(["gain_real"])

    def reading(self, point: OperatingPoint) -> Reading:
        size = jnp.sqrt((1.0 + self.gain_real) ** 2 + self.gain_imaginary**2)
        angle = point.order * jnp.arctan2(self.gain_imaginary, 1.0 + self.gain_real)
        return Reading(gain=jax.lax.complex(size * jnp.cos(angle), size * jnp.sin(angle)))


class TimeDelay(ReadingEffect):
    """z -> z exp(-iωτ)."""

    name: ClassVar[str] = "time_delay"
    family: ClassVar[Family] = "reading"
    meaning: ClassVar[str] = "vibration signal arrives late against the phase reference (filter, cable, converter)"
    source: ClassVar[str] = (
        "Oppenheim, Schafer, Discrete-Time Signal Processing, 3rd edition, 2010, section 2.9 (shift theorem)"
    )
    relatives: ClassVar[tuple[str, ...]] = ("phase_reference_offset",)
    delay_s: Array = parameter("delay τ of the signal", scale=0.1, of="period")
    starts: ClassVar[tuple[dict[str, float], ...]] = ({}, {"delay_s": 10.0}, {"delay_s": -10.0})

    def reading(self, point: OperatingPoint) -> Reading:
        return Reading(delay=self.delay_s)


class PhaseReferenceOffset(ReadingEffect):
    """z -> z exp(inφ): the reference mark sits elsewhere than the angles of the weights assume."""

    name: ClassVar[str] = "phase_reference_offset"
    family: ClassVar[Family] = "reading"
    meaning: ClassVar[str] = "angle between the phase reference and the zero of the weights' angles"
    source: ClassVar[str] = "API 670, 5th edition, 2014, section 6.2; ISO 21940-2:2017 (phase reference)"
    relatives: ClassVar[tuple[str, ...]] = ("time_delay", "probe_angle", "damping_error")
    angle_rad: Array = parameter("offset φ", scale=0.5)
    starts: ClassVar[tuple[dict[str, float], ...]] = tuple(
        {"angle_rad": turn * 1.5708} for turn in (0.0, 1.0, -1.0, 2.0, -2.0, 4.0)
    )

    def reading(self, point: OperatingPoint) -> Reading:
        return Reading(phase=self.angle_rad)


class SpeedError(SpeedEffect):
    """Ω -> Ω (1 + e) in the model."""

    name: ClassVar[str] = "speed_error"
    family: ClassVar[Family] = "reading"
    meaning: ClassVar[str] = "the tabulated speed is off by a constant ratio"
    source: ClassVar[str] = "ISO 10817-1:1998, clause 5: rotational speed measurement"
    relatives: ClassVar[tuple[str, ...]] = ("stiffness_error", "mass_error")
    error: Array = parameter("relative error of the speed", scale=0.01)
    starts: ClassVar[tuple[dict[str, float], ...]] = ({}, {"error": 1.0}, {"error": -1.0})

    def added_speed(self, speed: Array) -> Array:
        return self.error * speed
