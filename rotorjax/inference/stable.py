"""What it costs a fit to be stable where it was measured: nobody measures a steady state in which a rotor does not
stay.

With d the least damping ratio of all modes at all speeds measured, g its gradient and H the curvature of the cost, the
nearest values with which the rotor is stable cost ½ d² / (gᵀ H⁻¹ g) more than the optimum, to first order, where d < 0.
"""

import numpy as np
from jaxtyping import Float

from rotorjax.inference.curvature import inverse
from rotorjax.inference.descent import End
from rotorjax.inference.evidence import SEEN
from rotorjax.inference.space import Space
from rotorjax.inference.whirl_modes import STRUCTURE, RotorInTime
from rotorjax.model.contract import RestoringEffect, SweepEffect
from rotorjax.physics.stability import SELF_EXCITING

DIFFERENCE = 1e-3
"""Of an unknown in its standard deviation, for the gradient of a damping ratio."""
CLEARLY = 2.0
"""Cost of stability from which on a rotor is unstable for sure: two standard errors."""


def cost_of_stability(end: End, space: Space, speed_rpm: Float[np.ndarray, "speed"]) -> float:
    """It is zero without an effect of the linear rotor that may make it unstable, beside a nonlinear force or a sweep
    that shows, and where an effect depends on frequency as no spring or damper does.

    **Arguments:** ``speed_rpm``: speeds at which a steady state was measured.
    """
    if not len(speed_rpm) or not _may_grow(end, space) or _held(end, space):
        return 0.0
    ratio = _damping_ratios(space, end.point, speed_rpm)
    if ratio is None or np.min(ratio) >= 0.0:
        return 0.0
    worst, here = speed_rpm[[np.argmin(ratio)]], np.min(ratio)
    covariance = inverse(end.curvature)
    gradient = np.zeros(len(end.free))
    for k in np.flatnonzero(space.of_kind(STRUCTURE)[end.free]):
        step = DIFFERENCE * np.sqrt(covariance[k, k])
        there = end.point.copy()
        there[end.free[k]] += step
        moved = _damping_ratios(space, there, worst)
        gradient[k] = 0.0 if moved is None else (moved[0] - here) / step
    return float(0.5 * here**2 / max(gradient @ covariance @ gradient, np.finfo(float).tiny))


def unstable_speeds(end: End, space: Space, speed_rpm: Float[np.ndarray, "speed"]) -> int:
    """Number of the speeds at which the rotor is unstable, if it is so for sure."""
    if cost_of_stability(end, space, speed_rpm) <= CLEARLY:
        return 0
    ratio = _damping_ratios(space, end.point, speed_rpm)
    return 0 if ratio is None else int(np.count_nonzero(ratio < 0.0))


def _may_grow(end: End, space: Space) -> bool:
    """Whether an effect that may make the rotor unstable is there."""
    values = space.values(end.point)
    return any(v != 0.0 and entry.effect in SELF_EXCITING for v, entry in zip(values, space.entries, strict=True))


def _held(end: End, space: Space) -> bool:
    """Whether a nonlinear force may hold the rotor, or a sweep is through before it grows: one that changes what is
    read by as much as could be seen. One that does nothing does not.
    """
    turning = {e.name for e in space.model.effects if isinstance(e, RestoringEffect) and e.in_proportion}
    forces = space.of_kind(RestoringEffect | SweepEffect) & ~space.only_of(turning)
    kept = end.point.copy()
    kept[end.free] = 0.0
    if np.any(forces & space.there(kept)):
        return True
    own = forces[end.free]
    return bool(np.linalg.norm(end.local.slopes[..., own] @ end.point[end.free][own]) >= SEEN)


def _damping_ratios(
    space: Space, point: Float[np.ndarray, "param"], speed_rpm: Float[np.ndarray, "speed"]
) -> Float[np.ndarray, "speed"] | None:
    """The least of all modes at every speed."""
    return RotorInTime(space.model_at(point)).least_damping_ratio(speed_rpm)
