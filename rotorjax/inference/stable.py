"""How probable it is that the rotor is stable where it was measured: nobody measures a steady state in which a rotor
does not stay.

By the posterior about an optimum, normal to first order: with d the least damping ratio of all modes at all speeds
measured, g its gradient and H the curvature of the cost, it is Φ(d / √(gᵀ H⁻¹ g)).
"""

import math

import numpy as np
from jaxtyping import Float
from scipy.special import log_ndtr

from rotorjax.inference.curvature import inverse
from rotorjax.inference.descent import End
from rotorjax.inference.space import Space
from rotorjax.inference.whirl_modes import RotorInTime
from rotorjax.model.contract import MatrixEffect, SpeedEffect, SupportEffect
from rotorjax.physics.stability import SELF_EXCITING

DIFFERENCE = 1e-3
"""Of an unknown in its standard deviation, for the gradient of a damping ratio."""
HARDLY = 0.05
"""Probability of a stable rotor below which an answer speaks against itself."""


def log_probability_stable(end: End, space: Space, speed_rpm: Float[np.ndarray, "speed"]) -> float:
    """Its logarithm; zero without an effect of the linear rotor that may make it unstable, beside forces that
    depend on motion or a sweep, and where an effect depends on frequency as no spring or damper does.

    **Arguments:** ``speed_rpm``: speeds at which a steady state was measured.
    """
    if not len(speed_rpm) or not space.is_linear_at(end.point) or not _may_grow(end, space):
        return 0.0
    ratio = _damping_ratios(space, end.point, speed_rpm)
    if ratio is None:
        return 0.0
    worst, here = speed_rpm[[np.argmin(ratio)]], float(np.min(ratio))
    covariance = inverse(end.curvature)
    gradient = np.zeros(len(end.free))
    for k in np.flatnonzero(space.of_kind(MatrixEffect | SupportEffect | SpeedEffect)[end.free]):
        step = DIFFERENCE * math.sqrt(covariance[k, k])
        there = end.point.copy()
        there[end.free[k]] += step
        moved = _damping_ratios(space, there, worst)
        gradient[k] = 0.0 if moved is None else (moved[0] - here) / step
    deviation = math.sqrt(gradient @ covariance @ gradient)
    return float(log_ndtr(here / max(deviation, np.finfo(float).tiny)))


def unstable_speeds(end: End, space: Space, speed_rpm: Float[np.ndarray, "speed"]) -> int:
    """Number of the speeds at which the rotor is unstable, if it hardly can be stable at all of them."""
    if log_probability_stable(end, space, speed_rpm) > math.log(HARDLY):
        return 0
    ratio = _damping_ratios(space, end.point, speed_rpm)
    return 0 if ratio is None else int(np.count_nonzero(ratio < 0.0))


def _may_grow(end: End, space: Space) -> bool:
    """Whether an effect that may make the rotor unstable is there, and no sweep."""
    values = space.values(end.point)
    there = {entry.effect for value, entry in zip(values, space.entries, strict=True) if value != 0.0}
    return not there.isdisjoint(SELF_EXCITING) and not np.any(space.sweeping() & (end.point != 0.0))


def _damping_ratios(
    space: Space, point: Float[np.ndarray, "param"], speed_rpm: Float[np.ndarray, "speed"]
) -> Float[np.ndarray, "speed"] | None:
    """The least of all modes at every speed."""
    return RotorInTime(space.model_at(point)).least_damping_ratio(speed_rpm)
