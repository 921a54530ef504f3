"""Healthy rotors drawn by chance."""

import dataclasses

import numpy as np

from detailed.rotor import DISK, A, Rotor
from detailed.shaft import Section, Shaft, finite_elements, two_elements

OVERHUNG = 0.25
"""Share of the finite-element rotors with the disk outside the bearings."""


@dataclasses.dataclass(frozen=True)
class Machine:
    """A healthy rotor, and what it is as one mass on a spring, nearly."""

    rotor: Rotor
    mass: float
    """That its rig file states, at first [kg]."""
    frequency: float
    """Natural frequency [rad/s]."""


def two_element_rotor(rng: np.random.Generator, gravity: tuple[float, float]) -> Machine:
    """A disk a little off midspan on a shaft of two beam elements, in two bearings that are alike."""
    mass, frequency = float(np.exp(rng.uniform(np.log(0.3), np.log(20.0)))), float(rng.uniform(80.0, 400.0))
    length, share = float(rng.uniform(0.4, 1.0)), float(rng.uniform(0.05, 0.25))
    shaft = share * mass
    disk, spring = mass - 0.5 * shaft, mass * frequency**2
    soft = float(rng.uniform(6.0, 30.0))
    bearing = soft * spring * np.array([1.0, rng.uniform(0.4, 0.95)])
    loss, outer = rng.uniform(0.05, 0.3), rng.uniform(0.006, 0.035) * np.array([1.0, rng.uniform(0.7, 1.4)])
    polar = 0.5 * disk * (length * float(rng.uniform(0.1, 0.2))) ** 2
    position = 0.5 + float(rng.choice([-1.0, 1.0]) * rng.uniform(0.01, 0.05))
    rotor = Rotor(
        disk_mass=disk, polar=polar, shaft=two_elements(length, position, spring * length**3 / 48.0, shaft),
        bearing_stiffness=tuple(map(float, bearing)), bearing_damping=tuple(map(float, loss * bearing / frequency)),
        disk_damping=tuple(map(float, 2 * outer * mass * frequency)), gravity=gravity, reference_speed=frequency,
    )  # fmt: skip
    return Machine(rotor, mass, frequency)


def finite_element_rotor(rng: np.random.Generator, gravity: tuple[float, float]) -> Machine:
    """A disk off midspan or overhung on a stepped steel shaft of finite elements, in two bearings that differ."""
    length, slender = float(rng.uniform(0.4, 1.0)), float(rng.uniform(20.0, 40.0))
    overhung = rng.random() < OVERHUNG
    sections, journals, at = _overhung(rng, length, slender) if overhung else _between(rng, length, slender)
    shaft = finite_elements(sections, journals, at)
    weight = float(np.sum(shaft.mass[:3, :3]))
    disk = float(rng.uniform(3.0, 10.0)) * weight
    radius = length * float(rng.uniform(0.05, 0.09) if overhung else rng.uniform(0.1, 0.2))
    spring, mass, frequency = _as_one_mass(shaft, disk)
    bearing = float(rng.uniform(6.0, 30.0)) * spring * np.array([1.0, rng.uniform(0.4, 0.95)])
    loss, outer = rng.uniform(0.05, 0.3), rng.uniform(0.006, 0.035) * np.array([1.0, rng.uniform(0.7, 1.4)])
    rotor = Rotor(
        disk_mass=disk, polar=0.5 * disk * radius**2, shaft=shaft, bearing_stiffness=tuple(map(float, bearing)),
        bearing_damping=tuple(map(float, loss * bearing / frequency)), second_bearing=float(rng.uniform(0.6, 1.6)),
        disk_damping=tuple(map(float, 2 * outer * mass * frequency)), gravity=gravity, reference_speed=frequency,
    )  # fmt: skip
    return Machine(rotor, mass, frequency)


def _between(
    rng: np.random.Generator, length: float, slender: float
) -> tuple[list[Section], tuple[float, float], float]:
    """Sections of a shaft with the disk between its bearings, places of the journals and of the disk [m]."""
    thick = length / slender
    journal, seat = rng.uniform(0.7, 0.9, 2) * thick, float(rng.uniform(1.1, 1.4)) * thick
    at = length * (0.5 + float(rng.choice([-1.0, 1.0]) * rng.uniform(0.02, 0.15)))
    end, half = 0.12 * length, 0.05 * length
    sections = [
        Section(end, float(journal[0])), Section(at - half - end, thick), Section(half, seat), Section(half, seat),
        Section(length - at - half - end, thick), Section(end, float(journal[1])),
    ]  # fmt: skip
    return sections, (0.0, length), at


def _overhung(
    rng: np.random.Generator, length: float, slender: float
) -> tuple[list[Section], tuple[float, float], float]:
    """The same with the disk at the free end beyond the second bearing."""
    thick = length / slender
    journal, seat = rng.uniform(0.7, 0.9, 2) * thick, float(rng.uniform(0.8, 1.1)) * thick
    beyond, end = float(rng.uniform(0.15, 0.3)) * length, 0.12 * length
    sections = [
        Section(end, float(journal[0])), Section(length - 2 * end, thick, 4), Section(end, float(journal[1])),
        Section(beyond, seat, 3),
    ]  # fmt: skip
    return sections, (0.0, length), length + beyond


def _as_one_mass(shaft: Shaft, disk: float) -> tuple[float, float, float]:
    """Stiffness that a disk feels in rigid bearings [N/m], mass that moves with it by Rayleigh's method [kg], and
    natural frequency [rad/s].
    """
    held = np.array(shaft.stiffness[2:4, 2:4])
    compliance = np.linalg.inv(held)[:, 0]
    shape = compliance / compliance[0]
    mass = disk + float(shape @ shaft.mass[2:4, 2:4] @ shape)
    spring = float(1.0 / compliance[0])
    return spring, mass, float(np.sqrt(spring / mass))


def stiffness_at_disk(rotor: Rotor) -> tuple[float, float]:
    """Of the rotor at rest, that a force on the disk feels [N/m]."""
    compliance = np.linalg.inv(rotor.matrices(0.0)[2])
    disk = rotor.at_disk()
    x, y = 1.0 / np.diag(disk @ compliance @ disk.T)
    return float(x), float(y)


def shaft_share(rotor: Rotor) -> float:
    """Deflection of the shaft over that of the disk under a force on the disk along x."""
    under_force = np.linalg.inv(rotor.matrices(0.0)[2])[DISK]
    if len(rotor.shaft.mass) == 4:
        # Bearing A for both: as the cases of the shaft of two elements were drawn.
        return 1.0 - float(under_force[A] / under_force[DISK])
    return float((rotor.shaft_deflection() @ under_force)[0] / under_force[DISK])
