"""Pulses of a phase reference, and the shaft angle between them."""

from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline, PchipInterpolator
from scipy.ndimage import median_filter

from rotorjax.arrays import Numbers

TURN = 2.0 * np.pi
TAIL = 0.002
"""Share of samples at either end that may be outliers of a reference channel: the shortest pulse, in revolutions."""
HYSTERESIS = 0.4
"""Share of the way from threshold to either level that a reference must go before it counts as low or high."""
PLATEAU = 0.8
"""Quantile of the samples above the middle that stands for the high level, and the mirror image for the low one.

Past the median, because a band-limited pulse has much of its samples on its edges; the outward error by noise is
alike on both sides and leaves the threshold in the middle.
"""
TWO_LEVELS = 4.5
"""Distance of the levels over their scatter: 3.4 for Gaussian noise alone, 4 for uniform noise, 5 for a sine."""
IRREGULAR = 1.5
"""A revolution this much longer or shorter than those around it is a missing or a double pulse, not a speed."""

CUBIC_ORDER = 4
"""Power of a step's share of an edge with which a cubic's error falls; where one step is the edge, all is open."""
BISECTIONS = 40
"""Halvings of a step between samples: to its 1e-12."""
NEIGHBOURS = 11
"""Revolutions among which the median period is the usual one: five of them may be broken."""
MOST_LOST = 3
"""Pulses missing in a row that are put in: a longer gap says too little of what the shaft did in it."""
MOST_MENDED = 0.1
"""Share of the pulses that may be missing or double, about one among ``NEIGHBOURS``."""


def pulse_times(
    time: Numbers, reference: Numbers, *, threshold: float | None = None, edge: Literal["rising", "falling"] = "rising"
) -> Float[np.ndarray, "_"]:
    """Instants at which a phase-reference channel crosses its threshold, interpolated between samples by a cubic.

    A crossing counts once the channel has gone from clearly low to clearly high (``HYSTERESIS``), so that noise on
    an edge does not count twice. On an edge shorter than a sample the error is up to half a sample, and the same at
    every pulse where a revolution is a whole number of samples (2 kHz: 1500 and 2500 rpm): no scatter shows it then.

    **Arguments:** ``time`` (sample) [s], rising; ``reference`` (sample) in any unit; ``threshold`` in that unit, by
    default midway between the levels, where a pulse lasts at least 0.2 % of a revolution; ``edge`` that marks the
    angle zero. **Returns** the instants [s], at least two. **Errors.** ``ValueError`` for a channel without two
    levels, a threshold that it never crosses, fewer than two pulses, and arrays that do not fit together.
    """
    instants, columns = record_of(time, np.reshape(np.asarray(reference, dtype=float), (-1, 1)), "reference")
    trigger = Trigger(columns[:, 0], threshold=threshold, edge=edge)
    fired = trigger.feed(instants, columns[:, 0])
    trigger.require_pulses(len(fired))
    return fired


class Trigger:
    """Crossings of a threshold with hysteresis in a phase-reference channel that comes piece by piece.

    The levels are those of the first piece.
    """

    def __init__(
        self,
        first: Float[np.ndarray, "sample"],
        *,
        threshold: float | None = None,
        edge: Literal["rising", "falling"] = "rising",
    ):
        self.level, low, high = _levels(first, threshold)
        self.edge = edge
        # A falling edge is a rising one of the channel upside down.
        self._sign = 1.0 if edge == "rising" else -1.0
        self._middle = self._sign * self.level
        self._low, self._high = (low, high) if edge == "rising" else (-high, -low)
        self._time, self._channel = np.empty(0), np.empty(0)
        self._fired, self._squares = 0, 0.0

    def feed(self, time: Float[np.ndarray, "sample"], channel: Float[np.ndarray, "sample"]) -> Float[np.ndarray, "_"]:
        """Instants of the pulses that end within the next piece [s]."""
        instants = np.concatenate([self._time, time])
        values = np.concatenate([self._channel, self._sign * channel])
        middle = self._middle
        state = np.where(values >= middle + HYSTERESIS * (self._high - middle), 1, 0) - np.where(
            values <= middle - HYSTERESIS * (middle - self._low), 1, 0
        )
        clear = np.flatnonzero(state)
        fired = clear[1:][(state[clear][:-1] < 0) & (state[clear][1:] > 0)]
        # What follows the last sample that was clearly low or high may still become a pulse.
        kept = clear[-1] if len(clear) else 0
        self._time, self._channel = instants[kept:], values[kept:]
        crossing = np.flatnonzero((values[:-1] < middle) & (values[1:] >= middle))
        before = crossing[np.searchsorted(crossing, fired) - 1]
        share = _crossing(values - middle, before)
        wide = instants[before + 1] - instants[before]
        height = np.clip((values[before + 1] - values[before]) / (self._high - self._low), 0.0, 1.0)
        self._fired += len(fired)
        self._squares += float(np.sum((wide * height**CUBIC_ORDER) ** 2)) / 12.0
        return instants[before] + share * wide

    @property
    def edge_error(self) -> float:
        """Standard error of a pulse for not knowing its edge between samples [s]: one sample / √12, times the fourth
        power of the share of the edge that one step makes. All pulses at the same place between samples have the same.
        """
        return float(np.sqrt(self._squares / max(self._fired, 1)))

    def require_pulses(self, count: int) -> None:
        """**Errors.** ``ValueError`` for fewer pulses than a shaft angle needs."""
        if count < 2:
            raise ValueError(
                f"the reference channel has {count} {self.edge} edge(s) through {self.level:g}; a shaft angle needs at "
                "least two pulses: record more revolutions, or give a threshold within the pulses' height"
            )


def _crossing(values: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Where between a sample and the next a cubic through them and their neighbours is zero, as a share of the step.

    By bisection, since the middle samples differ in sign. On an edge two samples long a straight line would be off by
    some hundredths of a sample, differently for each place of the pulse between samples.
    """
    padded = np.pad(values, (1, 2), mode="edge")
    a, b, c, d = (padded[before + k] for k in range(4))
    cubic = (-a / 6.0 + b / 2.0 - c / 2.0 + d / 6.0, a / 2.0 - b + c / 2.0, -a / 3.0 - b / 2.0 + c - d / 6.0, b)
    low, high = np.zeros(len(before)), np.ones(len(before))
    for _ in range(BISECTIONS):
        share = 0.5 * (low + high)
        below = ((cubic[0] * share + cubic[1]) * share + cubic[2]) * share + cubic[3] < 0.0
        low, high = np.where(below, share, low), np.where(below, high, share)
    return 0.5 * (low + high)


class Mended(NamedTuple):
    """Pulses one per revolution, and what was done to have them so."""

    pulses: Float[np.ndarray, "_"]
    """Instants [s]."""
    missing: Float[np.ndarray, "_"]
    """Where pulses were put in [s]."""
    double: Float[np.ndarray, "_"]
    """Where pulses were left out [s]."""


def mended(pulses: Numbers) -> Mended:
    """Pulses with double ones left out and missing ones put in between their neighbours.

    Of two pulses less than 1 / ``IRREGULAR`` of the usual revolution apart, the one that makes the revolution before
    them more unusual is left out. Where a revolution lasts a whole number of usual ones, the instants between are
    those of a cubic spline through the others (monotone: Fritsch and Carlson 1980).

    **Arguments:** ``pulses`` instants [s], rising. **Errors.** ``ValueError`` where more than ``MOST_LOST`` pulses
    are missing in a row, a long revolution is no whole number of usual ones, or more than ``MOST_MENDED`` of all
    pulses had to be mended: then this is no signal of one pulse per revolution.
    """
    marks = rising(pulses, "pulses")
    period = np.diff(marks)
    usual = _usual(period, NEIGHBOURS)
    kept, double = _without_double(marks, usual)
    period = np.diff(kept)
    ratio = period / _usual(period, NEIGHBOURS)
    turns = np.where(ratio > IRREGULAR, np.round(ratio), 1.0)
    for k in np.flatnonzero((turns > MOST_LOST + 1) | (np.abs(ratio - turns) > 0.25) & (ratio > IRREGULAR)):
        raise ValueError(
            f"pulses must come once per revolution; from t = {kept[k]:.6g} to {kept[k + 1]:.6g} s none came for "
            f"{ratio[k]:.3g} revolutions: cut the record there, or lower the threshold"
        )
    count = np.concatenate([[0.0], np.cumsum(turns)])
    every = np.arange(count[-1] + 1.0)
    absent = ~np.isin(every, count)
    whole = np.asarray(PchipInterpolator(count, kept)(every)) if absent.any() else kept
    broken = int(absent.sum()) + len(double)
    if broken > max(1.0, MOST_MENDED * len(whole)):
        raise ValueError(
            f"pulses do not come once per revolution: among {len(whole)} revolutions {int(absent.sum())} pulses are "
            f"missing and {len(double)} too many: check the threshold, and that the reference sees one mark only"
        )
    return Mended(whole, whole[absent], double)


def _usual(period: Float[np.ndarray, "_"], size: int) -> Float[np.ndarray, "_"]:
    """Median period around each: against the neighbours, so that a slow run-up passes. A mirror, because repeating
    the end would let a broken end judge itself.
    """
    if len(period) <= 2:
        return np.full(len(period), period.min(initial=np.inf))
    return median_filter(period, size=size, mode="mirror")


def _without_double(marks: np.ndarray, usual: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pulses without those that follow or precede another too soon, and those."""
    if not np.any(np.diff(marks) < usual / IRREGULAR):
        return marks, np.empty(0)
    kept, double = [float(marks[0])], []
    for k, mark in enumerate(marks[1:].tolist()):
        if mark - kept[-1] >= usual[k] / IRREGULAR:
            kept.append(mark)
            continue
        before = kept[-2] if len(kept) > 1 else kept[-1] - usual[k]
        later_fits = abs(mark - before - usual[k]) < abs(kept[-1] - before - usual[k])
        double.append(kept.pop() if later_fits else mark)
        if later_fits:
            kept.append(mark)
    return np.array(kept), np.array(double)


def shaft_angle(time: Numbers, pulses: Numbers) -> Float[np.ndarray, "sample"]:
    """Shaft angle at every sample: a cubic spline through (pulse k, 2π k), a straight line between only two.

    Where the periods are so uneven that the spline turns back, a monotone cubic (Fritsch and Carlson 1980, SIAM J.
    Numer. Anal. 17:238-246), less exact for a smoothly varying speed.

    **Arguments:** ``time`` (sample) [s]; ``pulses`` instants of the phase reference [s], one per revolution.
    **Returns** the angle [rad] from the first pulse, always rising; NaN before the first and after the last pulse.
    **Errors.** ``ValueError`` for times that do not rise, and for missing or double pulses.
    """
    instants = rising(time, "time")
    marks = regular(pulses)
    turns = TURN * np.arange(len(marks))
    spline = CubicSpline(marks, turns, extrapolate=False)
    if len(spline.derivative().roots(extrapolate=False)):
        spline = PchipInterpolator(marks, turns, extrapolate=False)
    return spline(instants)


def _levels(channel: Float[np.ndarray, "sample"], threshold: float | None) -> tuple[float, float, float]:
    """Threshold, low and high level, blind to single spikes."""
    bottom, top = channel.min(), channel.max()
    if bottom == top:
        raise ValueError(
            f"the reference channel is constant at {top:g}: check that the phase reference is connected and that this "
            "is its channel"
        )
    if threshold is not None and not bottom < threshold < top:
        raise ValueError(
            f"the reference channel never crosses the threshold {threshold:g}, it stays from {bottom:g} to {top:g}: "
            "give a threshold inside the pulses' height, or none"
        )
    middle = 0.5 * float(np.sum(np.quantile(channel, [TAIL, 1.0 - TAIL]))) if threshold is None else threshold
    # With pulses shorter than ``TAIL`` the middle is the level between them: low if they rise, high if they fall.
    high = channel > middle if channel.mean() >= middle else channel >= middle
    below, above = channel[~high], channel[high]
    centres = np.median(below), np.median(above)
    scatter = max(np.median(np.abs(below - centres[0])), np.median(np.abs(above - centres[1])))
    if threshold is None and centres[1] - centres[0] < TWO_LEVELS * scatter:
        raise ValueError(
            "the reference channel shows noise and no two levels: check that the phase reference is connected; if its "
            "pulses are there, give a threshold"
        )
    low, high = float(np.quantile(below, 1.0 - PLATEAU)), float(np.quantile(above, PLATEAU))
    return (0.5 * (low + high) if threshold is None else threshold), low, high


def rising(values: Numbers, name: str) -> Float[np.ndarray, "sample"]:
    """One-dimensional, finite and rising, or a refusal that says where not."""
    array = np.asarray(values, dtype=float)
    if array.ndim != 1 or len(array) < 2:
        raise ValueError(
            f"{name} must be a list of at least two instants [s]; it has shape {array.shape}: give one column"
        )
    if not np.all(np.isfinite(array)):
        raise ValueError(
            f"{name} must be finite; entry {np.flatnonzero(~np.isfinite(array))[0]} is not: "
            "leave the broken samples out"
        )
    fall = np.flatnonzero(np.diff(array) <= 0.0)
    if len(fall):
        raise ValueError(
            f"{name} must rise; entry {fall[0] + 1} = {array[fall[0] + 1]:.6g} s does not: sort the record, or join "
            "parts with their true times"
        )
    return array


def record_of(
    time: Numbers, columns: Numbers, name: str
) -> tuple[Float[np.ndarray, "sample"], Float[np.ndarray, "sample probe"]]:
    """Times and channels that belong together, or a refusal."""
    instants, waves = rising(time, "time"), np.asarray(columns, dtype=float)
    if waves.ndim != 2 or waves.shape[0] != len(instants):
        raise ValueError(
            f"{name} must have one row per sample; it has shape {waves.shape} beside {len(instants)} times: "
            "take both from one record, transpose it, or write displacement[:, None] for a single probe"
        )
    broken = np.argwhere(~np.isfinite(waves))
    if len(broken):
        row, column = broken[0]
        raise ValueError(
            f"{name} must be finite; column {column} is not at t = {instants[row]:.6g} s: cut the record there or "
            "leave these samples out"
        )
    return instants, waves


def regular(pulses: Numbers) -> Float[np.ndarray, "_"]:
    """Pulses one per revolution, or a refusal that says where one is missing or double."""
    marks = rising(pulses, "pulses")
    period = np.diff(marks)
    usual = _usual(period, 5)
    ratio = period / usual
    long, short = np.flatnonzero(ratio > IRREGULAR), np.flatnonzero(ratio < 1.0 / IRREGULAR)
    if len(short) and (not len(long) or short[0] < long[0]):
        k = short[0]
        raise ValueError(
            f"pulses must come once per revolution; a double pulse near t = {marks[k + 1]:.6g} s ends a revolution of "
            f"{ratio[k]:.2g} times the usual "
            f"{usual[k]:.4g} s: leave that pulse out, or raise the threshold"
        )
    if len(long):
        k = long[0]
        raise ValueError(
            f"pulses must come once per revolution; missing pulse at t = {marks[k] + usual[k]:.6g} s, a revolution "
            f"lasts {ratio[k]:.2g} times the usual "
            f"{usual[k]:.4g} s: cut the record there, or lower the threshold; a mark that passes in less than a sample "
            "needs a faster sampling or a wider mark"
        )
    return marks
