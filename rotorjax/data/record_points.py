"""Parts of a recording to vibration vectors: which revolutions make one, its error, and what a sweep does to it."""

import dataclasses
from collections.abc import Iterator

import numpy as np
from jaxtyping import Complex, Float

from rotorjax.data.measurement import CLUSTER_WIDTH
from rotorjax.data.pulses import TURN
from rotorjax.data.record_scan import Scan
from rotorjax.data.recordings import PIECE
from rotorjax.data.signals import common_share, vectors_from_waveform
from rotorjax.model.rotor import Jeffcott
from rotorjax.units import RPM

FEWEST_TURNS = 4
"""Whole revolutions in a vector of a run-up: a vector that changes as a parabola, a drift and an error take as many."""
PART_OF_RESONANCE = 0.5
"""Change of speed over one vector of a run-up, as a share of the distance over which the response bends: half the
half-power bandwidth at a resonance. A parabola follows the response over it to a thousandth.
"""
MANY_TURNS = 10
"""Revolutions from which a half order can be told from the drift and from 1X with an error of its own."""
NOTABLE = 2.0
"""Standard errors from which a change of speed is believed."""
PARTS, FEWEST_POINTS = 4, 8
"""Parts of a run-up whose rates are compared, and vectors that this takes."""
SAME_RATE = 0.1
"""Relative difference of their rates up to which a run-up has one."""
LEFT, MOST_LEFT = 0.2, 0.01
"""Share of the shift by the sweep that is left where the model takes the rate into account, and of the vector at most:
the vectors of simulated run-ups through two resonances at 50 to 300 rpm/s lie within 95 % limits in 89 to 98 % then.
"""


@dataclasses.dataclass(frozen=True)
class Point:
    """Vibration vectors at one speed."""

    speed_rpm: float
    vectors: Complex[np.ndarray, "probe order"]
    """z [m]: displacement Re[z e^{i n φ}]."""
    sigma: Float[np.ndarray, "probe order"]
    """Standard error of real and of imaginary part [m]."""
    bias: Float[np.ndarray, "probe order"]
    """By how much the sweep shifts the vector from that of a dwell, to first order [m]."""
    sweep: float
    """Rate of the speed [rad/s²]; zero where none can be told."""
    revolutions: int
    instant: float
    """Middle of the revolutions used [s]."""
    half_over_first: float = 0.0
    """Least ratio of the half order to 1X among the probes, where it was fitted."""


def is_steady(marks: Float[np.ndarray, "_"]) -> bool:
    """Whether mean speeds of parts of the record, of four revolutions at least, differ by less than a dwell may."""
    parts = max(1, min(8, (len(marks) - 1) // FEWEST_TURNS))
    ends = np.linspace(0, len(marks) - 1, parts + 1).astype(int)
    speeds = np.diff(ends) / np.diff(marks[ends])
    return float(np.ptp(speeds)) <= CLUSTER_WIDTH * float(speeds.mean())


Block = tuple[Float[np.ndarray, "_"], int, int]
"""All pulses, first and last of the block."""


def steady_plan(marks: Float[np.ndarray, "_"], step: float) -> list[tuple[int, int]]:
    """The whole record, in parts that fit into memory."""
    parts = max(1, int(np.ceil((marks[-1] - marks[0]) / step / PIECE)))
    ends = np.linspace(0, len(marks) - 1, parts + 1).astype(int)
    return list(zip(ends[:-1].tolist(), ends[1:].tolist(), strict=True))


def sweep_plan(
    marks: Float[np.ndarray, "_"], step: float, rotor: Jeffcott, orders: tuple[float, ...]
) -> list[tuple[int, int]]:
    """Parts over which the response changes as little as a parabola follows."""
    speed = TURN / np.diff(marks)
    size = min(5, len(speed))
    # One revolution alone is as uncertain as the two pulses that bound it.
    smooth = np.convolve(np.pad(speed, size // 2, mode="edge"), np.ones(size) / size, "valid")[: len(speed)]
    fewest = int(np.ceil(FEWEST_TURNS / min([1.0, *(order for order in orders if order)])))
    plan, start = [], 0
    while start + fewest <= len(speed):
        width = _width(smooth[start], rotor, orders)
        end = start + fewest
        while (
            end < len(speed)
            and np.ptp(smooth[start : end + 1]) <= min(width, _width(smooth[end], rotor, orders))
            and marks[end + 1] - marks[start] < PIECE * step
        ):
            end += 1
        plan.append((start, end))
        start = end
    return plan


def _width(speed: float, rotor: Jeffcott, orders: tuple[float, ...]) -> float:
    """Change of speed [rad/s] that one vector may span; more than a dwell varies by would not be one speed."""
    bends = [PART_OF_RESONANCE * np.sqrt(2.0 / bend(rotor, order * speed)) / order for order in orders if order]
    return min([CLUSTER_WIDTH * speed, *bends])


def bend(rotor: Jeffcott, frequency: float) -> float:
    """|H''/H| of the stiffer or the softer axis, whichever bends more [s²], for H = 1/(k - m ω² + iωc)."""
    k, c = np.asarray(rotor.stiffness), np.asarray(rotor.damping)
    mass = float(rotor.mass)
    stiffness = k - mass * frequency**2 + 1j * frequency * c
    slope = -2.0 * mass * frequency + 1j * c
    # An undamped resonance that is met exactly has no width at all.
    stiffness = np.where(np.abs(stiffness) > 0.0, stiffness, np.finfo(float).eps * k)
    return float(np.max(np.abs(2.0 * (slope / stiffness) ** 2 + 2.0 * mass / stiffness)))


def blocks(found: Scan, plan: list[tuple[int, int]]) -> Iterator[tuple[Block, tuple[np.ndarray, np.ndarray]]]:
    """Pulses and samples of each part; of the record, only the part is held."""
    marks, left = found.pulses.pulses, list(reversed(plan))
    time, waves = np.empty(0), np.empty((0, len(found.probes)))
    pieces = found.pieces()
    while left:
        first, last = left[-1]
        piece = next(pieces, None) if not len(time) or time[-1] <= marks[last] + found.step else None
        if piece is not None:
            time, waves = np.concatenate([time, piece[0]]), np.concatenate([waves, piece[2]])
            if time[-1] <= marks[last] + found.step:
                continue
        begin, end = np.searchsorted(time, [marks[first] - found.step, marks[last] + found.step])
        left.pop()
        yield (marks, first, last), (time[begin:end], waves[begin:end])
        keep = int(np.searchsorted(time, marks[last] - 2.0 * found.step))
        time, waves = time[keep:], waves[keep:]


# One vector


def point(found: Scan, rotor: Jeffcott, orders: tuple[float, ...], block: Block, samples: tuple, steady: bool) -> Point:
    """Vectors of one part: the orders wanted, then those that are fitted along."""
    marks, first, last = block
    time, waves = samples
    along = (1.0, 2.0, 0.5) if steady and last - first >= MANY_TURNS else (1.0, 2.0)
    each = len(time) / (last - first)
    fitted = (*orders, *(order for order in along if order not in orders and 2.0 * order < each))
    turning = tuple(order for order in fitted if order)
    used, degree = marks[first : last + 1], 0 if steady else 2
    common = found.edge_error * common_share(used, found.step)
    fit = vectors_from_waveform(time, waves, used, orders=turning, changing=degree, pulse_error=common)
    vectors = {order: (fit.vectors[:, k], fit.sigma[:, k]) for k, order in enumerate(turning)}
    vectors[0.0] = fit.constant.astype(complex), fit.constant_sigma
    z, sigma = (np.stack([vectors[order][part] for order in fitted], axis=1) for part in (0, 1))
    sweep, speed = _sweep(used), fit.speed_rpm * RPM
    instant = 0.5 * float(marks[first] + marks[last])
    # z = H - (i/2) H'' dω/dt + ... for a frequency that changes steadily: Re[z e^{iφ}] = ∫ h(τ) cos φ(t - τ) dτ.
    shift = [0.5 * abs(sweep) * order * bend(rotor, order * speed) if order else 0.0 for order in fitted]
    half = (
        float(np.min(np.abs(vectors[0.5][0]) / np.abs(vectors[1.0][0]))) if 0.5 in vectors and 1.0 in vectors else 0.0
    )
    return Point(fit.speed_rpm, z, sigma, np.abs(z) * np.array(shift), sweep, fit.revolutions, instant, half)


def _sweep(marks: Float[np.ndarray, "_"]) -> float:
    """Rate of the speed [rad/s²], less what may be an accident of the pulses."""
    count = len(marks)
    if count <= FEWEST_TURNS:
        return 0.0
    middle, half = 0.5 * (marks[0] + marks[-1]), 0.5 * (marks[-1] - marks[0])
    design = np.vander((marks - middle) / half, 3)
    turned = TURN * np.arange(count)
    solution = np.linalg.lstsq(design, turned)[0]
    left = turned - design @ solution
    error = np.sqrt(left @ left / (count - 3) * np.linalg.inv(design.T @ design)[0, 0])
    rate = max(abs(solution[0]) - NOTABLE * error, 0.0) * np.sign(solution[0])
    return float(2.0 * rate / half**2)


def rate_of(points: list[Point]) -> float | None:
    """The rate of a run-up [rad/s²] if it has one; else none."""
    if len(points) < FEWEST_POINTS:
        return None
    time, speed = (np.array(values) for values in zip(*((p.instant, p.speed_rpm * RPM) for p in points), strict=True))
    rates = [np.polyfit(time[part], speed[part], 1)[0] for part in np.array_split(np.arange(len(time)), PARTS)]
    whole = float(np.polyfit(time, speed, 1)[0])
    return whole if np.all(np.abs(np.array(rates) - whole) <= SAME_RATE * abs(whole)) else None


def together(points: list[Point]) -> Point:
    """The mean of a steady record's parts, by their revolutions; its error by theirs, or by their scatter if larger."""
    turns = np.array([point.revolutions for point in points], dtype=float)
    share = turns / turns.sum()
    z = np.tensordot(share, np.stack([p.vectors for p in points]), 1)
    variance = np.tensordot(share**2, np.stack([p.sigma**2 for p in points]), 1)
    if len(points) > 1:
        scatter = np.tensordot(share, np.stack([np.abs(p.vectors - z) ** 2 for p in points]), 1)
        variance = np.maximum(variance, 0.5 * scatter / (len(points) - 1))
    bias = np.max(np.stack([p.bias for p in points]), axis=0)
    fastest = max((p.sweep for p in points), key=abs)
    return Point(
        float(turns.sum() / np.sum(turns / [p.speed_rpm for p in points])), z, np.sqrt(variance), bias, fastest,
        int(turns.sum()), float(share @ [p.instant for p in points]), min(p.half_over_first for p in points),
    )  # fmt: skip


def ringing(points: list[Point], rotor: Jeffcott) -> list[Point]:
    """A run-up's vectors with the bias that lasts: what a resonance left rings on and dies out as e^{-ζωt}."""
    decay = float(np.min(np.asarray(rotor.damping))) / (2.0 * float(rotor.mass))
    lasting = points[:1]
    for each in points[1:]:
        left = lasting[-1].bias * np.exp(-decay * (each.instant - lasting[-1].instant))
        lasting.append(dataclasses.replace(each, bias=np.maximum(each.bias, left)))
    return lasting


def wanted(point: Point, orders: tuple[float, ...]) -> Point:
    """Without the orders that were fitted along."""
    n = len(orders)
    return dataclasses.replace(point, vectors=point.vectors[:, :n], sigma=point.sigma[:, :n], bias=point.bias[:, :n])
