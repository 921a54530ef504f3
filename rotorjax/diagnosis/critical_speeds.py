"""Critical speeds of a rotor: where one of its whirl modes comes into resonance with unbalance."""

import math
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Complex, Float

from rotorjax.inference.whirl_modes import RotorInTime, WhirlModes
from rotorjax.model.model import Model
from rotorjax.units import RPM

LOWEST, HIGHEST = 0.1, 3.0
"""Where critical speeds are looked for, in the speeds that stiffness over mass says."""
COARSE, FINE = 641, 641
"""Speeds at which crossings are looked for, and speeds about a peak from which its width is read."""
STEPS, SETTLED = 6, 1e-7
"""Secant steps to a crossing, and the relative difference of frequency and speed there."""
SAME = 1e-6
"""Relative difference of eigenvalues up to which two modes are one: those of a rotor that is the same all round."""
MOST_DAMPED = math.sqrt(0.5)
"""Damping ratio from which on a mode has no peak in its response (Genta 2005, section 1.3)."""
EXCITED = 0.1
"""Part of the response at its own critical speed below which a mode shows no peak: it whirls against the unbalance."""
ALONE = 5.0
"""Half-power widths to the next mode from which on a peak's width is its own: the other mode changes it by
(1 / (2 · 5))², 1 %.
"""
CIRCULAR, STRAIGHT = 0.5, 0.02
"""Minor over major axis of a mode's orbit from which on it is called forward or backward whatever its direction; below
the second it is a line.
"""

Whirl = Literal["forward", "backward", "elliptic"]


class CriticalSpeed(NamedTuple):
    """A speed that equals the natural frequency of a whirl mode which unbalance excites."""

    speed_rpm: float
    """Ω = |s(Ω)|: the undamped natural frequency of the mode, at the speed itself."""
    damping_ratio: float
    """ζ = -Re(s) / |s| of the mode's eigenvalue s at this speed; negative where the mode grows."""
    amplification: float | None
    """Amplification factor; none without damping, and where the mode grows."""
    from_width: bool
    """Whether the amplification factor is speed over the width of the peak at 0.707 of its height (half-power method,
    API RP 684); else, where another mode is too near, it is 1 / (2ζ).
    """
    direction_deg: float
    """Of the major axis of the disk's orbit, from +x towards +y, above -90° up to 90°."""
    axis_ratio: float
    """Minor over major axis of this orbit, negative where it is run through against the rotation."""
    amplitude_um: dict[str, float] | None = None
    """Amplitude at 1X, zero-to-peak, probe by probe, with nothing installed; none where the model has nothing that
    excites it, or nonlinear forces.
    """

    @property
    def whirl(self) -> Whirl:
        """ "elliptic" where the orbit is flatter than one half."""
        if abs(self.axis_ratio) < CIRCULAR:
            return "elliptic"
        return "forward" if self.axis_ratio > 0.0 else "backward"

    @property
    def log_decrement(self) -> float:
        """δ = 2πζ / √(1 - ζ²), 1: logarithmic decrement of the mode (API RP 684)."""
        return log_decrement(self.damping_ratio)


def log_decrement(damping_ratio: float) -> float:
    """δ = 2πζ / √(1 - ζ²), 1; infinite from critical damping on."""
    return math.inf if damping_ratio >= 1.0 else 2.0 * math.pi * damping_ratio / math.sqrt(1.0 - damping_ratio**2)


def critical_speeds(model: Model) -> tuple[CriticalSpeed, ...] | None:
    """Critical speeds of the rotor without nonlinear forces, the lowest first; without amplitudes.

    Looked for between 0.1 and 3 times what stiffness over mass says. Modes that are damped out (ζ above 0.707), and
    modes that unbalance does not excite, such as backward whirl of a rotor that is the same all round, have none.
    **Returns** none where an effect depends on frequency as no spring, damper or mass does.
    **Source:** eigenvalues as in Genta, Dynamics of Rotating Systems, Springer 2005, sections 1.3 and 2.3; API RP 684
    (2005), sections 1.2 and 2.2.
    """
    rotor = RotorInTime(model)
    nominal = natural_speeds_rpm(model)
    speeds = np.geomspace(LOWEST * nominal.min(), HIGHEST * nominal.max(), COARSE)
    wide = rotor.modes(speeds)
    if wide is None:
        return None
    crossings = _crossings(rotor, speeds, np.sort(wide.frequency, axis=1) - wide.speed[:, None])
    if not len(crossings):
        return ()
    there = rotor.modes(crossings)
    if there is None:
        return None
    found = [one for k, speed in enumerate(crossings) for one in _resonant(there, k, speed)]
    return tuple(_with_width(rotor, one, found) for one in found)


def critical_speeds_rpm(model: Model) -> Float[np.ndarray, "speed"]:
    """The speeds alone; none where they are not known."""
    return np.array([one.speed_rpm for one in critical_speeds(model) or ()])


def natural_speeds_rpm(model: Model) -> Float[np.ndarray, "dof"]:
    """√(k / M) along x and y of the rotor without effects, whatever its damping."""
    return np.sqrt(np.asarray(model.rotor.stiffness) / float(model.rotor.mass)) / RPM


def _crossings(
    rotor: RotorInTime, speeds: Float[np.ndarray, "speed"], beyond: Float[np.ndarray, "speed state"]
) -> Float[np.ndarray, "_"]:
    """Speeds at which a natural frequency equals the speed, rising. **Arguments:** ``beyond``: the natural frequencies
    less the speed, sorted, so that each column is continuous.
    """
    at, column = np.nonzero((beyond[:-1] > 0.0) != (beyond[1:] > 0.0))
    if not len(at):
        return np.zeros(0)
    low, high = speeds[at], speeds[at + 1]
    below, above = beyond[at, column], beyond[at + 1, column]
    middle, rest = low, below
    for _ in range(STEPS):
        middle = low - below * (high - low) / np.where(above == below, 1.0, above - below)
        modes = rotor.modes(middle)
        if modes is None:
            return np.zeros(0)
        rest = np.take_along_axis(np.sort(modes.frequency, axis=1), column[:, None], 1)[:, 0] - modes.speed
        same = (rest > 0.0) == (below > 0.0)
        low, below = np.where(same, middle, low), np.where(same, rest, below)
        high, above = np.where(same, high, middle), np.where(same, above, rest)
    settled = np.sort(middle[np.abs(rest) <= SETTLED * middle * RPM])
    return settled[np.diff(settled, prepend=0.0) > SETTLED * settled]


def _resonant(modes: WhirlModes, k: int, speed_rpm: float) -> list[CriticalSpeed]:
    """Modes whose natural frequency is the speed, at one of several speeds."""
    speed, values, shares = modes.speed[k], modes.eigenvalue[k], modes.unbalance_share[k]
    here = modes.whirls[k] & (np.abs(modes.frequency[k] / speed - 1.0) <= 10.0 * SETTLED)
    here &= modes.damping_ratio[k] < MOST_DAMPED
    whole, found = float(np.linalg.norm(shares.sum(axis=0))), []
    for alike in _groups(values, here):
        share = shares[alike].sum(axis=0)
        if np.linalg.norm(share) >= EXCITED * whole:
            ratio = float(np.mean(modes.damping_ratio[k][alike]))
            factor = 0.5 / ratio if ratio > 0.0 else None
            found.append(CriticalSpeed(float(speed_rpm), ratio, factor, False, *orbit_of(share, modes.spin)))
    return sorted(found, key=lambda one: one.direction_deg)


def _groups(values: Complex[np.ndarray, "state"], here: Bool[np.ndarray, "state"]) -> list[list[int]]:
    """Indices of the eigenvalues chosen, equal ones together."""
    groups: list[list[int]] = []
    for i in np.flatnonzero(here):
        group = next((g for g in groups if abs(values[i] - values[g[0]]) <= SAME * abs(values[i])), None)
        if group is None:
            groups.append([int(i)])
        else:
            group.append(int(i))
    return groups


def orbit_of(motion: Complex[np.ndarray, "dof"], spin: int) -> tuple[float, float]:
    """Direction of the major axis of an orbit Re[(x, y) e^{iωt}] [degrees], and minor over major axis, negative where
    it is run through against the rotation.
    """
    turning = 0.5 * (motion[0] + 1j * motion[1])
    against = 0.5 * np.conj(motion[0] - 1j * motion[1])
    major, minor = abs(turning) + abs(against), (abs(turning) - abs(against)) * spin
    direction = math.degrees(0.5 * (np.angle(turning) + np.angle(against)))
    return 90.0 - (90.0 - direction) % 180.0, minor / major


def whirl_in_words(direction_deg: float, axis_ratio: float) -> str:
    """ "forward", "backward, major axis 30°" or "straight line, 90°". **Arguments:** as `orbit_of` returns them."""
    if abs(axis_ratio) < STRAIGHT:
        return f"straight line, {round(direction_deg)}°"
    sense = "forward" if axis_ratio > 0.0 else "backward"
    return sense if abs(axis_ratio) >= CIRCULAR else f"{sense}, major axis {round(direction_deg)}°"


def _with_width(rotor: RotorInTime, one: CriticalSpeed, every: list[CriticalSpeed]) -> CriticalSpeed:
    """The amplification factor from the width of the peak, where no other mode is near."""
    width = 2.0 * one.damping_ratio * one.speed_rpm
    others = [other for other in every if other is not one]
    if width <= 0.0 or any(abs(other.speed_rpm - one.speed_rpm) < ALONE * width for other in others):
        return one
    near = np.linspace(max(one.speed_rpm - 2.0 * width, 0.2 * one.speed_rpm), one.speed_rpm + 2.0 * width, FINE)
    motion = rotor.unbalance_response(near)
    factor = None if motion is None else _half_power(near, _major(motion))
    return one if factor is None else one._replace(amplification=factor, from_width=True)


def _major(motion: Complex[np.ndarray, "speed dof"]) -> Float[np.ndarray, "speed"]:
    """Half the major axis of every orbit."""
    return 0.5 * (np.abs(motion[:, 0] + 1j * motion[:, 1]) + np.abs(motion[:, 0] - 1j * motion[:, 1]))


def _half_power(speed_rpm: Float[np.ndarray, "speed"], size: Float[np.ndarray, "speed"]) -> float | None:
    """N_c / (N_2 - N_1) of the peak within these speeds; none where the response does not fall to 0.707 on both
    sides.
    """
    peak = int(np.argmax(size))
    half, edges = math.sqrt(0.5) * size[peak], []
    for side in (np.arange(peak, -1, -1), np.arange(peak, len(size))):
        below = np.flatnonzero(size[side] < half)
        if not len(below):
            return None
        outer, inner = side[below[0]], side[below[0] - 1]
        share = (size[inner] - half) / (size[inner] - size[outer])
        edges.append(speed_rpm[inner] + share * (speed_rpm[outer] - speed_rpm[inner]))
    return float(speed_rpm[peak] / (edges[1] - edges[0]))
