"""How far a force outside the catalogue is from what the catalogue has: chi-square that its nearest relative leaves.

A force whose relative leaves next to nothing is explained by that, whatever its law: no measurement of this kind tells
them apart.
"""

from collections.abc import Callable

import numpy as np
from scipy.optimize import minimize

from detailed import forces as laws
from detailed.hidden import Plant, Scale
from detailed.in_time import NoSteadyStateError

FAR = 1e12
"""Chi-square where there is no steady motion."""
TRIALS = 30
GRID = 8
"""Angles to begin with."""
Cost = Callable[[np.ndarray], float]


def _relative(name: str, s: Scale) -> tuple[Callable[[np.ndarray], laws.Force], list[np.ndarray]] | None:
    """Relative of a force by its sizes, in units that make them about one, and sizes to begin with; none for a force
    whose relatives are stiffness and damping.
    """
    a, speed = s.amplitude, s.frequency * s.amplitude
    sizes = [np.array([size]) for size in (0.03, 0.3, 3.0)]
    around = [0.5 * np.array([np.cos(t), np.sin(t)]) for t in 2 * np.pi * np.arange(GRID) / GRID]
    return {
        "slider": (lambda v: laws.dry_friction(v[0] * 0.3 * s.push), sizes),
        "fifth_power": (lambda v: laws.power(v[0] * s.push / a**3, 3), sizes),
        "cubic_drag": (lambda v: laws.drag(v[0] * s.push / speed**2), sizes),
        "switched_stiffness": (lambda v: laws.unequal_shaft(complex(*v) * 0.02 * s.spring), around),
        "late_force": None,
    }[name]


def left_by_relative(name: str, scale: Scale, base: Plant, vectors: Callable[[Plant], np.ndarray], cost: Cost) -> float:
    """Chi-square that the nearest relative of a force leaves of what the force does.

    **Arguments:** ``base``: the rotor without it; ``vectors``: what is measured of a plant; ``cost``: chi-square of
    vectors against those with the force, stiffness and damping fitted.
    """
    relative = _relative(name, scale)
    if relative is None:
        return cost(vectors(base))
    make, starts = relative

    def left(v: np.ndarray) -> float:
        try:
            return cost(vectors(base.pushed(make(v))))
        except NoSteadyStateError:
            return FAR

    start = min(starts, key=left)
    return float(minimize(left, start, method="Nelder-Mead", options={"maxfev": TRIALS, "xatol": 1e-3}).fun)
