"""A rotor with more detail than the model: a disk that tilts on a flexible shaft with mass, in bearings with damping of
their own. Shares no code with rotorjax.

Degrees of freedom of each plane, x first, then y: journal A, journal B, disk, slope of the disk, modes of the shaft,
and the frame where the bearings stand on one. The shaft is free to turn in the bearings. Displacement(t) =
Re[q_n e^{inφ}], the shaft turns from x towards y.
"""

import dataclasses

import numpy as np

from detailed.shaft import Shaft

A, B, DISK, SLOPE = range(4)
"""Places in a plane."""
FRAME = -1
"""The last one, where there is a frame."""
WHIRL = np.array([[0.0, 1.0], [-1.0, 0.0]])
"""J of the equation of motion: k J drives forward whirl, g Ω J on the velocity stiffens it."""
FORWARD = np.array([1.0, -1j])
"""x and y of a vector that turns with the shaft."""


@dataclasses.dataclass(frozen=True)
class Frame:
    """What both bearings stand on, alike along x and y."""

    stiffness: float
    mass: float
    damping: float


@dataclasses.dataclass(frozen=True)
class Rotor:
    """Masses, springs and dampers in SI; pairs are along x and y. What is hidden is zero unless given."""

    disk_mass: float
    polar: float
    """Moment of inertia of the disk about the shaft [kg m²]; about a diameter it is half of that."""
    shaft: Shaft
    bearing_stiffness: tuple[float, float]
    """Of each bearing."""
    bearing_damping: tuple[float, float]
    """Of each bearing: in series with the shaft."""
    disk_damping: tuple[float, float]
    second_bearing: float = 1.0
    """Stiffness and damping of bearing B over those of bearing A."""
    gravity: tuple[float, float] = (0.0, 0.0)
    unbalance: complex = 0.0
    """Left in the disk [kg m]."""
    bow: complex = 0.0
    """Of the shaft at the disk [m]."""
    thermal_bow: complex = 0.0
    """The same at the reference speed; it grows with speed squared."""
    force_1: complex = 0.0
    """On the disk, turning with the shaft, alike at all speeds [N]."""
    force_2: tuple[complex, complex] = (0.0, 0.0)
    """On the disk, twice per turn [N]."""
    mass_added: float = 0.0
    damping_factor: tuple[float, float] = (1.0, 1.0)
    """Of all dampers."""
    spring: tuple[float, float] = (0.0, 0.0)
    """Between disk and ground [N/m]."""
    spring_growing: tuple[float, float] = (0.0, 0.0)
    """The same at the reference speed, growing with speed squared [N/m]."""
    axes: float = 0.0
    """Turn of the springs of the bearings from x towards y [rad]; their dampers stay."""
    cross: float = 0.0
    """Force on the disk across its motion; above zero it drives forward whirl [N/m]."""
    internal: float = 0.0
    """Damping of the disk that turns with the shaft [N s/m]."""
    gyroscopic: float = 0.0
    """Of a part that tilts as the disk is deflected, polar moment times (slope over deflection)² [kg]."""
    turning: float = 1.0
    """Share of the gyroscopic moments of the tilting disk and of the shaft that acts: zero to see what it brings."""
    frame: Frame | None = None
    late: tuple[float, float] = (0.0, 0.0)
    """Stiffness [N/m] and delay [s] of a force on the disk that follows its motion late."""
    reference_speed: float = 1.0
    """Speed [rad/s] at which what grows with speed has the size given."""

    @property
    def places(self) -> int:
        """Degrees of freedom of a plane."""
        return len(self.shaft.mass) + (0 if self.frame is None else 1)

    def at_disk(self) -> np.ndarray:
        """Row for x and row for y that pick the displacement of the disk."""
        return np.kron(np.eye(2), np.eye(self.places)[[DISK]])

    def shaft_deflection(self) -> np.ndarray:
        """The same for how far the disk is off the line between the journals."""
        row = np.zeros((1, self.places))
        row[0, [A, B, DISK]] = -(1.0 - self.shaft.position), -self.shaft.position, 1.0
        return np.kron(np.eye(2), row)

    def _padded(self, shaft: np.ndarray) -> np.ndarray:
        """A matrix of the shaft, among all places of a plane."""
        return np.pad(shaft, (0, self.places - len(shaft)))

    def matrices(self, speed: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Mass, damping and stiffness at a speed [rad/s]: M q̈ + C q̇ + K q = F."""
        n, growth = self.places, (speed / self.reference_speed) ** 2
        disk, shaft = self.at_disk(), np.kron(np.eye(2), self._padded(self.shaft.stiffness))
        masses = np.zeros(n)
        masses[[DISK, SLOPE]] = self.disk_mass + self.mass_added, 0.5 * self.polar
        if self.frame is not None:
            masses[FRAME] = self.frame.mass
        mass = np.kron(np.eye(2), np.diag(masses) + self._padded(self.shaft.mass))
        bearings, dampers = self._bearings(self.bearing_stiffness, self.axes), self._bearings(self.bearing_damping, 0.0)
        stiffness = shaft + bearings + disk.T @ (np.diag(self.spring) + growth * np.diag(self.spring_growing)) @ disk
        factor = np.kron(np.diag(self.damping_factor), np.eye(n))
        dampers = dampers + np.kron(np.eye(2), self._padded(self.shaft.damping))
        damping = np.sqrt(factor) @ (dampers + disk.T @ np.diag(self.disk_damping) @ disk) @ np.sqrt(factor)
        tilt = np.kron(np.eye(2), np.eye(n)[[SLOPE]])
        turning = self.turning * self.polar * tilt.T @ WHIRL @ tilt + self.gyroscopic * disk.T @ WHIRL @ disk
        turning = turning + self.turning * np.kron(WHIRL, self._padded(self.shaft.gyroscopic))
        damping = damping + speed * turning + self.internal * disk.T @ disk
        stiffness = stiffness + disk.T @ ((self.cross + speed * self.internal) * WHIRL) @ disk
        if self.frame is not None:
            below = np.kron(np.eye(2), np.eye(n)[[FRAME]])
            stiffness, damping = (
                stiffness + self.frame.stiffness * below.T @ below,
                damping + self.frame.damping * below.T @ below,
            )
        return mass, damping, stiffness

    def _bearings(self, pair: tuple[float, float], angle: float) -> np.ndarray:
        """Springs or dampers under both journals, turned from x towards y."""
        cosine, sine = np.cos(angle), np.sin(angle)
        turn = np.array([[cosine, -sine], [sine, cosine]])
        turned = turn @ np.diag(pair) @ turn.T
        total = np.zeros((2 * self.places, 2 * self.places))
        for journal, share in ((A, 1.0), (B, self.second_bearing)):
            row = np.zeros((1, self.places))
            row[0, journal] = 1.0
            if self.frame is not None:
                row[0, FRAME] = -1.0
            spread = np.kron(np.eye(2), row)
            total += spread.T @ (share * turned) @ spread
        return total

    def bent(self, speed: float) -> complex:
        """Bow of the shaft at the disk at a speed [m]."""
        return self.bow + self.thermal_bow * (speed / self.reference_speed) ** 2

    def excitation(self, speed: float, installed: complex) -> dict[int, np.ndarray]:
        """Order -> complex force on all degrees of freedom. **Arguments:** ``installed``: unbalance put on [kg m]."""
        disk = self.at_disk()
        bow = np.zeros(self.places)
        # A shaft bent so that it stays in its bearings without force.
        bow[DISK] = 1.0
        bow[SLOPE] = self._free_slope()
        once = (speed**2 * (self.unbalance + installed) + self.force_1) * disk.T @ FORWARD
        once = once + self.bent(speed) * np.kron(FORWARD, self._padded(self.shaft.stiffness) @ bow)
        # Places and probes are counted from where the frame stands, modes from the line of journals and disk.
        lifted = np.zeros(self.places)
        lifted[[A, B, DISK]] = 1.0
        weight = self.matrices(speed)[0] @ np.kron(self.gravity, lifted)
        return {0: weight.astype(complex), 1: once, 2: disk.T @ np.array(self.force_2)}

    def _free_slope(self) -> float:
        """Slope of the disk per deflection of the shaft there, no moment on it."""
        shaft = self.shaft.stiffness
        return float(-shaft[SLOPE, DISK] / shaft[SLOPE, SLOPE])

    def dynamic_stiffness(self, speed: float, order: int) -> np.ndarray:
        """K - ω²M + iωC at ω = order times speed, and what follows late."""
        mass, damping, stiffness = self.matrices(speed)
        omega, (strength, delay), disk = order * speed, self.late, self.at_disk()
        total = stiffness - omega**2 * mass + 1j * omega * damping
        return total + strength * np.exp(-1j * omega * delay) * disk.T @ disk

    def steady(self, speed: float, installed: complex) -> dict[int, np.ndarray]:
        """Order -> displacement of all degrees of freedom, in closed form."""
        return {
            order: np.linalg.solve(self.dynamic_stiffness(speed, order), force)
            for order, force in self.excitation(speed, installed).items()
        }

    def growth(self, speed: float) -> float:
        """Largest real part of the eigenvalues [1/s]: below zero where the rotor is stable. A force that follows late
        is taken to be in its worst phase.
        """
        mass, damping, stiffness = self.matrices(speed)
        disk = self.at_disk()
        damping = damping - abs(self.late[0]) / self.reference_speed * disk.T @ disk
        n = len(mass)
        inverse = np.linalg.inv(mass)
        state = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ stiffness, -inverse @ damping]])
        return float(np.max(np.linalg.eigvals(state).real))
