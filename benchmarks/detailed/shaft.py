"""Shafts of the detailed rotor: two beam elements, or finite elements reduced to what the rest acts on. Shares no code
with rotorjax.

Coordinates of one plane: journal A, journal B, disk, slope of the disk, then modes of the shaft between them. Slopes
are the derivatives of the deflection, so that both planes have the same matrices.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy.linalg import eigh

STEEL = {"density": 7810.0, "young": 2.11e11, "shear": 8.12e10}
"""[kg/m³], [Pa], [Pa]."""
MODES = 3
"""Modes of the shaft held at journals and disk that are kept: all of them change no vector by 1e-4 (tests)."""
MODE_DAMPING = 0.01
"""Damping ratio of these."""


@dataclasses.dataclass(frozen=True, eq=False)
class Shaft:
    """A shaft in one plane: matrices in its coordinates, in SI."""

    position: float
    """Of the disk from journal A, over the distance of the journals; above one it is overhung."""
    stiffness: np.ndarray
    mass: np.ndarray
    gyroscopic: np.ndarray
    """Moments of inertia about the axis: times the speed, it couples the rates of change of the slopes of both planes
    [kg m²].
    """
    damping: np.ndarray
    """Of the modes."""


@dataclasses.dataclass(frozen=True)
class Section:
    """A piece of a shaft of one diameter."""

    length: float
    """[m]."""
    diameter: float
    """[m]."""
    elements: int = 2


def beam_stiffness(length: float, bending: float, shear: float = 0.0) -> np.ndarray:
    """Of a beam element in displacement and slope at both ends.

    **Arguments:** ``bending``: E I [N m²]; ``shear``: 12 E I / (κ G A L²), zero for a beam stiff in shear (Euler,
    Bernoulli).
    """
    s, p = length, shear
    pattern = [[12, 6 * s, -12, 6 * s], [6 * s, (4 + p) * s**2, -6 * s, (2 - p) * s**2], [-12, -6 * s, 12, -6 * s],
               [6 * s, (2 - p) * s**2, -6 * s, (4 + p) * s**2]]  # fmt: skip
    return bending / ((1 + p) * s**3) * np.array(pattern)


def element(length: float, diameter: float, material: dict[str, float]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Stiffness, mass and gyroscopic matrix of a round beam element (Timoshenko: shear, rotary inertia) in displacement
    and slope at both ends.

    **Source:** Friswell, Penny, Garvey, Lees, Dynamics of Rotating Machines (2010), section 5.4; Nelson, J. Mech. Des.
    102 (1980) 793-803. The shear coefficient is that of Cowper, J. Appl. Mech. 33 (1966) 335-340.
    """
    rho, young, shear, s = material["density"], material["young"], material["shear"], length
    area, second = np.pi * diameter**2 / 4, np.pi * diameter**4 / 64
    poisson = young / (2 * shear) - 1
    kappa = 6 * (1 + poisson) / (7 + 6 * poisson)
    p = 12 * young * second / (kappa * shear * area * s**2)
    a, b, c = 312 + 588 * p + 280 * p**2, (44 + 77 * p + 35 * p**2) * s, 108 + 252 * p + 140 * p**2
    d, e, f = -(26 + 63 * p + 35 * p**2) * s, (8 + 14 * p + 7 * p**2) * s**2, -(6 + 14 * p + 7 * p**2) * s**2
    moved = np.array([[a, b, c, d], [b, e, -d, f], [c, -d, a, -b], [d, f, -b, e]])
    g, h = (3 - 15 * p) * s, (4 + 5 * p + 10 * p**2) * s**2
    k = (-1 - 5 * p + 5 * p**2) * s**2
    tilted = np.array([[36, g, -36, g], [g, h, -g, k], [-36, -g, 36, -g], [g, k, -g, h]])
    rotary = rho * second / (30 * s * (1 + p) ** 2) * tilted
    return beam_stiffness(s, young * second, p), rho * area * s / (840 * (1 + p) ** 2) * moved + rotary, 2 * rotary


def assembled(sections: Sequence[Section], material: dict[str, float] = STEEL) -> tuple[np.ndarray, ...]:
    """Places of the nodes [m], and stiffness, mass and gyroscopic matrix of a free shaft in displacement and slope of
    every node.
    """
    spans = [(s.length / s.elements, s.diameter) for s in sections for _ in range(s.elements)]
    matrices = np.zeros((3, 2 * len(spans) + 2, 2 * len(spans) + 2))
    for k, (length, diameter) in enumerate(spans):
        matrices[:, 2 * k : 2 * k + 4, 2 * k : 2 * k + 4] += element(length, diameter, material)
    return np.cumsum([0.0, *(length for length, _ in spans)]), *matrices


def finite_elements(
    sections: Sequence[Section], journals: tuple[float, float], disk: float, *, modes: int = MODES
) -> Shaft:
    """A shaft of beam elements, reduced to the displacements of both journals and of the disk, its slope, and the modes
    of the shaft held there (component modes).

    **Arguments:** ``journals``, ``disk``: where they are, at nodes, from the first end [m].
    **Source:** Craig, Bampton, AIAA J. 6 (1968) 1313-1319.
    """
    places, stiffness, mass, gyroscopic = assembled(sections)
    a, b, d = (int(np.argmin(np.abs(places - at))) for at in (*journals, disk))
    kept = [2 * a, 2 * b, 2 * d, 2 * d + 1]
    free = np.setdiff1d(np.arange(len(stiffness)), kept)
    inner = stiffness[np.ix_(free, free)]
    squares, shapes = eigh(inner, mass[np.ix_(free, free)], subset_by_index=(0, modes - 1))
    basis = np.zeros((len(stiffness), 4 + modes))
    basis[kept, :4] = np.eye(4)
    basis[free, :4] = -np.linalg.solve(inner, stiffness[np.ix_(free, kept)])
    basis[free, 4:] = shapes
    stiffness, mass, gyroscopic = (basis.T @ whole @ basis for whole in (stiffness, mass, gyroscopic))
    # The modes have unit mass.
    damping = np.diag([0.0] * 4 + [2 * MODE_DAMPING * float(w) for w in np.sqrt(squares)])
    return Shaft((disk - journals[0]) / (journals[1] - journals[0]), stiffness, mass, gyroscopic, damping)


def two_elements(length: float, position: float, bending: float, mass: float) -> Shaft:
    """Two beam elements (Euler, Bernoulli) between disk and journals, the slopes at the journals condensed; half of the
    mass at the disk and a quarter at each journal.

    **Arguments:** ``length`` between the bearings [m]; ``bending``: stiffness E I [N m²].
    """
    whole = np.zeros((6, 6))
    left, right = position * length, (1.0 - position) * length
    # Displacement and slope at A, at the disk, at B.
    for first, span in ((0, left), (2, right)):
        whole[first : first + 4, first : first + 4] += beam_stiffness(span, bending)
    kept, free = [0, 4, 2, 3], [1, 5]
    coupling = whole[np.ix_(kept, free)]
    stiffness = whole[np.ix_(kept, kept)] - coupling @ np.linalg.solve(whole[np.ix_(free, free)], coupling.T)
    half = 0.5 * mass
    nothing = np.zeros((4, 4))
    return Shaft(position, stiffness, np.diag([half / 2, half / 2, half, 0.0]), nothing, nothing)
