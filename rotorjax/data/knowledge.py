"""What the user states about a rig besides its numbers: what is uncertain, how amplitudes are written, and limits."""

import dataclasses
from collections.abc import Mapping
from typing import Literal, NamedTuple

SLOW_ROLL_RPM = 250.0
"""Speed of the slow roll where a rig file does not state it."""
Amplitude = Literal["peak", "peak-to-peak", "rms"]
"""How amplitudes are written in a table."""
PEAK: dict[Amplitude, float] = {"peak": 1.0, "peak-to-peak": 0.5, "rms": 2.0**0.5}
"""Zero-to-peak amplitude of a sine for one unit of what is written."""


def peak_of(amplitude: Amplitude, order: float) -> float:
    """Zero-to-peak amplitude for one unit of what is written: the rms value of a constant is the constant."""
    return 1.0 if amplitude == "rms" and order == 0.0 else PEAK[amplitude]


class Uncertain(NamedTuple):
    """A rig value that the user is unsure of, as a parameter of an effect.

    ``deviation`` is the standard deviation of the parameter in SI, or of ln(1 + parameter) if ``logarithmic``.
    Entries that share a ``group`` are one unknown.
    """

    effect: str
    label: str
    deviation: float
    logarithmic: bool
    group: str


class Limits(NamedTuple):
    """What a next measurement may be."""

    speed_rpm: tuple[float, float] | None = None
    amplitude_um: float | None = None
    trial_weight_g_mm: float | None = None
    operating_speed_rpm: tuple[float, float] | None = None
    """Lowest and highest speed at which the machine runs: what separation margins refer to."""


@dataclasses.dataclass(frozen=True)
class Knowledge:
    """What the user has declared about the rig besides its numbers."""

    uncertain: tuple[Uncertain, ...] = ()
    installed_unbalance: float = 0.0
    """Relative standard deviation of every installed unbalance; likewise `installed_bow`."""
    installed_angle_rad: float = 0.0
    installed_bow: float = 0.0
    priors: Mapping[str, Mapping[str, float]] = dataclasses.field(default_factory=dict)
    """Effect -> parameter -> standard deviation in SI of a normal prior, instead of the declared one."""
    tolerance: float = 0.0
    run_scatter: Literal["auto", "none"] = "auto"
    scatter_from_runs: int = 4
    """Runs from which on scatter between them is inferred."""
    limits: Limits = dataclasses.field(default_factory=Limits)
    slow_roll_rpm: float = SLOW_ROLL_RPM
    """Speed of the slow roll, were its vectors subtracted."""
    amplitude: Amplitude | None = "peak"
    """What the table's amplitudes are said to be; none where recordings were read, which no convention concerns."""
    plane_radii_m: tuple[float | None, ...] = ()
    """Radius at which weights sit in each balancing plane, where it is stated."""
