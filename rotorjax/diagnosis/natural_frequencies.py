"""Natural frequencies over speed: what a Campbell diagram shows."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float
from scipy.optimize import linear_sum_assignment

from rotorjax.diagnosis.critical_speeds import SAME, orbit_of, whirl_in_words
from rotorjax.inference.whirl_modes import RotorInTime, WhirlModes
from rotorjax.model.model import Model
from rotorjax.units import RPM


class NaturalFrequencies(NamedTuple):
    """Whirl modes of the linear rotor, each followed over speed; not a number where a mode does not oscillate."""

    speed_rpm: Float[np.ndarray, "speed"]
    frequency_hz: Float[np.ndarray, "speed state"]
    """Undamped natural frequency |s| / 2π of the mode's eigenvalue s, which at a critical speed equals the speed."""
    damping_ratio: Float[np.ndarray, "speed state"]
    """ζ = -Re(s) / |s|, negative where the mode grows."""
    whirl: tuple[str, ...]
    """Of the disk, at the highest speed at which the mode oscillates: forward, backward, or the direction of a flat
    orbit ("along 12°").
    """


def natural_frequencies(model: Model, speed_rpm: Float[np.ndarray, "speed"]) -> NaturalFrequencies | None:
    """Eigenvalues of M q̈ + C q̇ + K q = 0 at each of these speeds, rising, without nonlinear forces.

    A mode is followed by its eigenvalue, which goes on as it went between the two speeds before. **Returns** none where
    an effect depends on frequency as no spring, damper or mass does. **Source:** Genta, Dynamics of Rotating Systems,
    Springer 2005, section 2.3; API RP 684 (2005), section 1.2.
    """
    modes = RotorInTime(model if model.layout.orders == (1.0,) else model.with_orders((1.0,))).modes(speed_rpm)
    if modes is None:
        return None
    place = _followed(np.where(modes.whirls, modes.eigenvalue, np.nan))
    rows = np.arange(len(speed_rpm))[:, None]
    there = place >= 0
    frequency = np.where(there, modes.frequency[rows, place], np.nan) / (2.0 * np.pi)
    damping = np.where(there, modes.damping_ratio[rows, place], np.nan)
    whirl = tuple(_whirl(modes, place[:, k]) for k in range(place.shape[1]))
    return NaturalFrequencies(modes.speed / RPM, frequency, damping, whirl)


def _followed(eigenvalue: Complex[np.ndarray, "speed state"]) -> np.ndarray:
    """At each speed the place of every mode's eigenvalue, -1 where it has none."""
    whirls = np.isfinite(eigenvalue)
    place = np.full((len(eigenvalue), int(whirls.sum(axis=1).max(initial=0))), -1)
    last = np.full((2, place.shape[1]), np.nan + 0j)
    for k, values in enumerate(eigenvalue):
        here = np.flatnonzero(whirls[k])
        here = here[np.argsort(np.abs(values[here]), kind="stable")]
        onward = np.where(np.isfinite(last[0]), 2.0 * last[1] - last[0], last[1])
        # A mode of which nothing is known yet takes what the others leave.
        apart = np.abs(onward[:, None] - values[here])
        most = np.nanmax(apart, initial=1.0)
        modes, chosen = linear_sum_assignment(np.where(np.isfinite(apart), apart, 10.0 * most))
        place[k, modes] = here[chosen]
        now = last[1].copy()
        now[modes] = values[here[chosen]]
        last = np.stack([last[1], now])
    return place


def _whirl(modes: WhirlModes, place: np.ndarray) -> str:
    """In a word or two, at the highest speed at which the mode oscillates."""
    k = int(np.flatnonzero(place >= 0)[-1])
    values, own = modes.eigenvalue[k], int(place[k])
    alike = np.abs(values - values[own]) <= SAME * abs(values[own])
    if alike.sum() > 1:
        return "forward and backward"
    return whirl_in_words(*orbit_of(modes.shape[k, own], modes.spin))
