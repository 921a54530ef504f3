"""Balancing: the mass that corrects an unbalance, with its error, and the balance quality grade before and after (ISO
21940-11).
"""

import dataclasses
import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float

from rotorjax.data.rig_sections import Convention, Plane
from rotorjax.diagnosis.fault import Fault
from rotorjax.inference.faults import fault_sensitivity, response_to
from rotorjax.model.conditions import Conditions
from rotorjax.model.model import Model


class InHole(NamedTuple):
    """A part of a correction."""

    hole: int
    """Counted from one, the first at `Plane.first_hole_deg`, in the direction in which angles count."""
    angle_deg: float
    """Where it is, as the rig file counts."""
    mass_kg: float


@dataclasses.dataclass(frozen=True)
class Correction:
    """What corrects an unbalance in one plane alone, the rotor being one disk."""

    name: str
    plane: Plane
    unbalance: Fault
    """In this plane, (x, y) [kg m]."""
    mass: float
    """Of the rotor [kg]."""
    speed: float
    """At which the grade counts [rad/s]."""
    convention: Convention
    speed_is: str = "the highest operating speed"
    """Which speed that is, in words."""
    beside: tuple[str, ...] = ()
    """Effects other than an unbalance that it acts against too."""

    @property
    def size(self) -> float:
        """Of the unbalance, and of the correction [kg m]."""
        return self.unbalance.magnitude

    @property
    def angle_deg(self) -> float:
        """Where the unbalance is, as the rig file counts."""
        return self.convention.angle_deg(self.unbalance.pair) % 360.0

    @property
    def correction_angle_deg(self) -> float:
        """Where the correction goes: opposite."""
        return (self.angle_deg + 180.0) % 360.0

    @property
    def left(self) -> float:
        """Unbalance to be expected after the correction: the root mean square of its error [kg m]."""
        assert self.unbalance.covariance is not None
        return math.sqrt(float(np.trace(self.unbalance.covariance)))

    @property
    def left_below(self) -> float:
        """Bound (95 %) of the unbalance after the correction, if it is installed exactly [kg m]."""
        return self.unbalance.reach

    def grade(self, unbalance: float) -> float:
        """Balance quality grade G = e Ω [mm/s], e the unbalance that acts on the disk over the rotor's mass."""
        return 1e3 * abs(self.plane.participation) * unbalance / self.mass * self.speed

    def mass_at_radius(self, unbalance: float) -> float | None:
        """Mass [kg] of an unbalance at the plane's radius, where the rig file has one."""
        return None if self.plane.radius_m is None else unbalance / self.plane.radius_m

    @property
    def in_holes(self) -> tuple[InHole, ...]:
        """The correction in the two holes next to its angle; empty where the rig file has no radius or no holes."""
        mass, holes = self.mass_at_radius(self.size), self.plane.holes
        if mass is None or holes is None:
            return ()
        pitch = 2.0 * math.pi / holes
        place, share = divmod(
            math.radians(self.correction_angle_deg - self.plane.first_hole_deg) % (2.0 * math.pi), pitch
        )
        parts = math.sin(pitch - share) / math.sin(pitch), math.sin(share) / math.sin(pitch)
        found = []
        for k, part in enumerate(parts):
            hole = (int(place) + k) % holes
            angle = (self.plane.first_hole_deg + hole * 360.0 / holes) % 360.0
            found.append(InHole(hole + 1, angle, mass * part))
        return tuple(found)


class Prediction(NamedTuple):
    """Vibration vectors with nothing installed, before and after a correction [m]."""

    before: Complex[np.ndarray, "speed probe order"]
    after: Complex[np.ndarray, "speed probe order"]
    error: Float[np.ndarray, "speed probe order"]
    """Bound (95 %) of what the error of the unbalance adds to the size of `after`."""


def predicted(model: Model, correction: Correction, speed_rpm: Float[np.ndarray, "speed"]) -> Prediction:
    """What the probes show with nothing installed, and with the correction.

    The error is the largest |J e| over the 95 % region of the unbalance, J its influence on the vector, of the model
    without nonlinear forces.
    """
    conditions = Conditions.at_rpm(speed_rpm, unbalance=np.zeros((len(model.layout.planes), 2)))
    share, none = correction.plane.participation, np.zeros((len(speed_rpm), 4))
    corrected = none - np.concatenate([share * correction.unbalance.pair, np.zeros(2)])
    before, after = (response_to(model, conditions, faults) for faults in (none, corrected))
    slopes = share * fault_sensitivity(model, conditions)[..., :2]
    error = np.linalg.norm(slopes @ correction.unbalance.region, axis=(-2, -1), ord=2)
    return Prediction(before, after, error)
