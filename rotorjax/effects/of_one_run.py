"""What may be different in one run: the value of an effect of the catalogue that holds in that run only.

A weight at another place or of another mass than is stated, or one lost between two runs, is an unbalance of one run; a
shaft that had stood still is bowed for one run; a phase reference that was moved, or amplitudes that were typed in as
peak-to-peak, concern one run as well. Equations and signs are those of the effect of the catalogue.
"""

from typing import ClassVar

from jax import Array

from rotorjax.model.contract import Effect, Family
from rotorjax.model.parameters import parameter


class OfOneRun(Effect):
    """Values that add to those of another effect, under the same names, in the run that is marked
    (`rotorjax.data.Measurement.odd_run`).
    """

    like: ClassVar[str]
    """Name of that effect."""


class RunUnbalance(OfOneRun):
    """As `ResidualUnbalance`, in one run: F_1 += Ω² (U_x + iU_y) f."""

    name: ClassVar[str] = "run_unbalance"
    family: ClassVar[Family] = "excitation"
    meaning: ClassVar[str] = "unbalance of one run that is not stated: its weight is another, elsewhere, or was lost"
    source: ClassVar[str] = "as residual_unbalance"
    like: ClassVar[str] = "residual_unbalance"
    unbalance_x_kg_m: Array = parameter("component along x", scale=1.0, of="unbalance")
    unbalance_y_kg_m: Array = parameter("component 90° on in the sense of rotation", scale=1.0, of="unbalance")


class RunBow(OfOneRun):
    """As `ResidualBow`, in one run: s += S_x + iS_y."""

    name: ClassVar[str] = "run_bow"
    family: ClassVar[Family] = "excitation"
    meaning: ClassVar[str] = "bow that the shaft had in one run only: it had stood still, or was hot"
    source: ClassVar[str] = "as residual_bow"
    like: ClassVar[str] = "residual_bow"
    bow_x_m: Array = parameter("component along x", scale=2.0, of="eccentricity")
    bow_y_m: Array = parameter("component 90° on in the sense of rotation", scale=2.0, of="eccentricity")


class RunPhase(OfOneRun):
    """As `PhaseReferenceOffset`, in one run: z_n *= exp(i n φ)."""

    name: ClassVar[str] = "run_phase"
    family: ClassVar[Family] = "reading"
    meaning: ClassVar[str] = "the phase reference was at another angle in one run"
    source: ClassVar[str] = "as phase_reference_offset"
    like: ClassVar[str] = "phase_reference_offset"
    angle_rad: Array = parameter("phase added", scale=1.0)


class RunAmplitude(OfOneRun):
    """As `ChainGain`, in one run, in phase: z *= 1 + g."""

    name: ClassVar[str] = "run_amplitude"
    family: ClassVar[Family] = "reading"
    meaning: ClassVar[str] = "amplitudes of one run are in another unit, or of another kind"
    source: ClassVar[str] = "as chain_gain"
    like: ClassVar[str] = "chain_gain"
    gain_real: Array = parameter("relative error of the amplitudes", scale=1.0)


class RunSpeed(OfOneRun):
    """As `SpeedError`, in one run: Ω -> Ω (1 + e)."""

    name: ClassVar[str] = "run_speed"
    family: ClassVar[Family] = "reading"
    meaning: ClassVar[str] = "the speeds of one run are off by a constant ratio"
    source: ClassVar[str] = "as speed_error"
    like: ClassVar[str] = "speed_error"
    error: Array = parameter("relative error of the speed", scale=0.1)


RUN_EFFECTS: dict[str, type[OfOneRun]] = {
    cls.name: cls for cls in (RunUnbalance, RunBow, RunPhase, RunAmplitude, RunSpeed)
}
