"""Balancing: the mass that corrects an unbalance, with its error, and the balance quality grade before and after (ISO
21940-11).
"""

import dataclasses
import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float

from rotorjax.data.rig_sections import Convention, Plane
from rotorjax.inference.faults import response_to
from rotorjax.model.conditions import Conditions
from rotorjax.model.model import Model


class InHole(NamedTuple):
    """A part of a correction."""

    hole: int
    """Counted from one, the first at `Plane.first_hole_deg`, in the direction in which angles count."""
    mass_kg: float


@dataclasses.dataclass(frozen=True)
class Correction:
    """What corrects an unbalance in one plane alone, the rotor being one disk."""

    name: str
    plane: Plane
    unbalance: Float[np.ndarray, "dof"]
    """In this plane, (x, y) [kg m]."""
    covariance: Float[np.ndarray, "dof dof"]
    """Of it [kg² m²]."""
    mass: float
    """Of the rotor [kg]."""
    speed: float
    """At which the grade counts [rad/s]."""
    convention: Convention

    @property
    def size(self) -> float:
        """Of the unbalance, and of the correction [kg m]."""
        return float(np.hypot(*self.unbalance))

    @property
    def angle_deg(self) -> float:
        """Where the unbalance is, as the rig file counts."""
        return self.convention.angle_deg(self.unbalance) % 360.0

    @property
    def correction_angle_deg(self) -> float:
        """Where the correction goes: opposite."""
        return (self.angle_deg + 180.0) % 360.0

    @property
    def standard_error(self) -> float:
        """Of the correction's size [kg m]."""
        along = self.unbalance / self.size if self.size > 0.0 else np.array([1.0, 0.0])
        return math.sqrt(float(along @ self.covariance @ along))

    @property
    def left(self) -> float:
        """Unbalance to be expected after the correction: the root mean square of its error [kg m]."""
        return math.sqrt(float(np.trace(self.covariance)))

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
        return tuple(InHole((int(place) + k) % holes + 1, mass * part) for k, part in enumerate(parts))


def before_and_after(
    model: Model, correction: Correction, speed_rpm: Float[np.ndarray, "speed"]
) -> tuple[Complex[np.ndarray, "speed probe order"], ...]:
    """What the probes show with nothing installed, and with the correction [m]."""
    conditions = Conditions.at_rpm(speed_rpm, unbalance=np.zeros((len(model.layout.planes), 2)))
    none = np.zeros((len(speed_rpm), 4))
    corrected = none - np.concatenate([correction.plane.participation * correction.unbalance, np.zeros(2)])
    return tuple(response_to(model, conditions, faults) for faults in (none, corrected))
