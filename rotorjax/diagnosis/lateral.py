"""The lateral analysis of API 617: critical speeds with separation margins, amplitudes there, and stability."""

import math
from typing import Literal, NamedTuple

import numpy as np

from rotorjax.data.measurement import Measurement
from rotorjax.diagnosis.critical_speeds import CriticalSpeed, critical_speeds, log_decrement
from rotorjax.inference.linear_rotor import LinearRotor
from rotorjax.inference.whirl_modes import ROUNDING, RotorInTime
from rotorjax.model.conditions import Conditions
from rotorjax.model.model import Model
from rotorjax.physics.stability import SELF_EXCITING
from rotorjax.physics.steady_state import is_coupled
from rotorjax.units import MICROMETRE, RPM

SPEEDS = 201
"""Speeds at which stability is looked into."""
BEYOND = 1.5
"""Times the highest speed of the range, up to which an onset of instability is looked for."""
CRITICALLY_DAMPED = 2.5
"""Amplification factor below which no separation margin is asked for (API 617)."""
MOST_BELOW, MOST_ABOVE = 16.0, 26.0
"""Largest separation margins that API 617 asks for, below and above the range of operating speeds, %."""
STABLE = 0.1
"""Logarithmic decrement of the least stable mode that API 617 asks for at least (7th edition, chapter 1, 2.6.5)."""


class SpeedRange(NamedTuple):
    """Speeds that margins and stability refer to."""

    low_rpm: float
    high_rpm: float
    kind: Literal["operating", "measured"]

    @classmethod
    def of(cls, measurement: Measurement) -> "SpeedRange":
        """The operating speeds that the rig file's limits state, else those measured."""
        operating, speeds = measurement.knowledge.limits.operating_speed_rpm, measurement.speed_rpm
        if operating is not None:
            return cls(*operating, "operating")
        return cls(float(speeds.min()), float(speeds.max()), "measured")


class SeparationMargin(NamedTuple):
    """Distance of a critical speed from a range of speeds."""

    side: Literal["below", "inside", "above"]
    """Where the critical speed is."""
    percent: float
    """Below: of the lowest speed of the range; above: of its highest; 0 inside."""
    needed_percent: float
    """What API 617 asks for at this amplification factor."""

    @classmethod
    def of(cls, critical: CriticalSpeed, speeds: SpeedRange) -> "SeparationMargin":
        """SM below = 17 (1 - 1/(AF - 1.5)), at most 16; above = 10 + 17 (1 - 1/(AF - 1.5)), at most 26; none needed
        where AF < 2.5. **Source:** API Standard 617, 7th edition (2002), chapter 1, section 2.6.2.10.
        """
        factor, speed = critical.amplification, critical.speed_rpm
        grown = 17.0 if factor is None else 17.0 * (1.0 - 1.0 / (max(factor, CRITICALLY_DAMPED) - 1.5))
        damped = factor is not None and factor < CRITICALLY_DAMPED
        below, above = (0.0, 0.0) if damped else (min(grown, MOST_BELOW), min(10.0 + grown, MOST_ABOVE))
        if speed < speeds.low_rpm:
            return cls("below", 100.0 * (1.0 - speed / speeds.low_rpm), below)
        if speed > speeds.high_rpm:
            return cls("above", 100.0 * (speed / speeds.high_rpm - 1.0), above)
        return cls("inside", 0.0, max(below, above))


class Stability(NamedTuple):
    """The least stable whirl mode within a range of speeds."""

    log_decrement: float
    """δ = 2πζ / √(1 - ζ²), 1; negative where the mode grows."""
    speed_rpm: float
    """Where it is least."""
    frequency_rpm: float
    """Of that mode."""
    onset_rpm: float | None
    """Lowest speed from the lowest of the range to 1.5 times its highest at which a mode grows; none if none does."""


class Lateral(NamedTuple):
    """Critical speeds and stability of the rotor without nonlinear forces."""

    speeds: SpeedRange
    critical_speeds: tuple[CriticalSpeed, ...] | None
    """The lowest first; none where an effect depends on frequency as no spring, damper or mass does."""
    stability: Stability | None
    """None likewise, and where nothing whirls."""
    linearised: bool
    """Whether the model has nonlinear forces, of which this says nothing."""
    self_excited: bool
    """Whether the model has an effect of the linear rotor that may make it unstable."""
    open_axes: frozenset[str] = frozenset()
    """Of "x" and "y" those along which the data leave the damping open."""

    def damping_known(self, critical: CriticalSpeed) -> bool:
        """Whether the data determine the damping of a mode: it whirls along one axis, or about both."""
        if critical.whirl != "elliptic":
            return not self.open_axes
        along_x = abs(math.cos(math.radians(critical.direction_deg))) > math.sqrt(0.5)
        return ("x" if along_x else "y") not in self.open_axes

    def margin(self, critical: CriticalSpeed) -> SeparationMargin:
        """Its distance from the range of speeds."""
        return SeparationMargin.of(critical, self.speeds)


def lateral(model: Model, measurement: Measurement) -> Lateral:
    """Critical speeds, the amplitude there with nothing installed, and stability, over the operating speeds that the
    rig file states, or else those measured.

    **Errors.** ``ValueError`` for a measurement with other probes or planes.
    **Source:** API RP 684 (2005); API Standard 617, 7th edition (2002), chapter 1, section 2.6.
    """
    measurement.require_layout(model.layout)
    model = model if model.layout.orders == (1.0,) else model.with_orders((1.0,))
    speeds, coupled, found = SpeedRange.of(measurement), is_coupled(model), critical_speeds(model)
    if found and not coupled:
        found = _with_amplitudes(found, model, measurement.probes_read)
    driven = any(effect.name in SELF_EXCITING for effect in model.effects)
    return Lateral(speeds, found, stability(model, speeds), coupled, driven)


def _with_amplitudes(
    found: tuple[CriticalSpeed, ...], model: Model, probes: tuple[str, ...]
) -> tuple[CriticalSpeed, ...]:
    """With what the probes read at each critical speed, nothing installed; as they are where that is nothing."""
    nothing = np.zeros((len(model.layout.planes), 2))
    conditions = Conditions.at_rpm([one.speed_rpm for one in found], unbalance=nothing)
    size = np.abs(LinearRotor(model).vectors(conditions)[:, :, 0]) / MICROMETRE
    if not (np.all(np.isfinite(size)) and np.any(size > 0.0)):
        return found
    index = [(probe, model.layout.probes.index(probe)) for probe in probes]
    return tuple(
        one._replace(amplitude_um={probe: float(size[k, at]) for probe, at in index}) for k, one in enumerate(found)
    )


def stability(model: Model, speeds: SpeedRange) -> Stability | None:
    """Logarithmic decrement of the least stable mode in the range, and where instability begins, in or near it."""
    at = np.linspace(speeds.low_rpm, BEYOND * speeds.high_rpm, SPEEDS)
    inside = at <= speeds.high_rpm
    # The ends of the range are among them.
    at = np.append(at, speeds.high_rpm)
    order = np.argsort(at, kind="stable")
    at, inside = at[order], np.append(inside, True)[order]
    modes = RotorInTime(model).modes(at)
    if modes is None:
        return None
    ratio = np.where(modes.whirls & inside[:, None], modes.damping_ratio, 1.0)
    least = ratio.min()
    if least >= 1.0:
        return None
    # The highest of the speeds at which it is least: where nothing depends on speed that is the range's highest.
    k = int(np.flatnonzero(np.min(ratio, axis=1) <= least + ROUNDING)[-1])
    frequency = float(modes.frequency[k, np.argmin(ratio[k])] / RPM)
    onset = _onset(at, np.min(modes.damping_ratio, axis=1))
    return Stability(log_decrement(float(least)), float(at[k]), frequency, onset)


def _onset(speed_rpm: np.ndarray, ratio: np.ndarray) -> float | None:
    """The lowest speed at which the least damping ratio is negative, between those looked at by a straight line."""
    grows = np.flatnonzero(ratio < 0.0)
    if not len(grows):
        return None
    k = int(grows[0])
    if k == 0:
        return float(speed_rpm[0])
    share = ratio[k - 1] / (ratio[k - 1] - ratio[k])
    return float(speed_rpm[k - 1] + share * (speed_rpm[k] - speed_rpm[k - 1]))
