"""The readings that would tell two explanations apart best, within the user's limits."""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Complex, Float

from rotorjax.arrays import numpy_pair
from rotorjax.data.measurement import is_half_order
from rotorjax.diagnosis.critical_speeds import critical_speeds_rpm
from rotorjax.diagnosis.separability import NEAR_PEAK
from rotorjax.discovery.contest import Contest
from rotorjax.inference.descent import End
from rotorjax.inference.noise import Noise
from rotorjax.inference.prediction import predict
from rotorjax.model.conditions import Conditions
from rotorjax.physics.steady_state import without_timed
from rotorjax.units import GRAM_MILLIMETRE, MICROMETRE, RPM

SPEEDS = 41
"""Speeds tried within the limits."""
MOST_RUNS = 5
"""Runs tried: those that differ most from one another in what is installed."""
MOST_READINGS = 6
"""Readings proposed at most, all in one run."""
TELLING = 2.0
"""Standard errors by which predictions must differ for readings to be worth proposing."""
SETTLES = 4.0
"""Standard errors at which no further reading is proposed: the log evidence changes by half their square, 8 ± 4."""
BARE, TRIAL = "a run with nothing installed", "a run with nothing but a trial weight of {:g} g mm at 0° (first plane)"


class Proposal(NamedTuple):
    """Readings in one run, and by how many standard errors the predictions of two explanations differ there."""

    run: str
    speeds_rpm: tuple[float, ...]
    """The most telling first, each chosen beside those before."""
    separates: tuple[tuple[str, ...], tuple[str, ...]]
    standardised_difference: float
    new_probes: tuple[str, ...] = ()
    """Probes of the rig without a reading so far, if it takes them to tell."""

    @property
    def settles(self) -> bool:
        """Whether it is to be expected that the readings settle the tie."""
        return self.standardised_difference >= SETTLES


class Shown(NamedTuple):
    """What two explanations predict at conditions that may be measured."""

    apart: Float[np.ndarray, "case cell"]
    """Difference of the vectors, real and imaginary parts [m]."""
    spread: Float[np.ndarray, "case cell free"]
    """How it is spread by what the parameters of both leave open, and by the error of the model's form [m]."""
    variance: Float[np.ndarray, "case cell"]
    """Of a reading by itself [m²]."""
    allowed: Bool[np.ndarray, "case"]

    def part(self, cases: slice, cells: Bool[np.ndarray, "cell"]) -> "Shown":
        """Of some cases, at some cells."""
        apart, spread, variance = (values[cases][:, cells] for values in (self.apart, self.spread, self.variance))
        return Shown(apart, spread, variance, self.allowed[cases])


def next_measurement(
    contest: Contest, noise: Noise, first: End, second: End, names: tuple[tuple[str, ...], tuple[str, ...]]
) -> Proposal | None:
    """The run and the speeds at which two fitted explanations differ most: as few readings as settle the tie.

    The difference counts in standard errors of noise and of what the parameters of both leave open, for all readings
    together. Near a resonance of either nothing is proposed: there the model's own error rules. Probes that were never
    read count only where the others would not tell. None if no readings within the limits would tell.
    """
    runs = _runs(contest)
    measured, limits = contest.measurement.speed_rpm, contest.measurement.knowledge.limits
    low, high = limits.speed_rpm or (0.5 * measured.min(), measured.max())
    speeds = np.linspace(low, high, SPEEDS)
    unbalance = np.repeat(np.stack([u for u, _ in runs.values()]), SPEEDS, axis=0)
    bow = np.repeat(np.stack([b for _, b in runs.values()]), SPEEDS, axis=0)
    conditions = Conditions.at_rpm(np.tile(speeds, len(runs)), unbalance=unbalance, bow=bow)
    shown = _shown(contest, noise, conditions, (first, second))
    read = contest.measurement.probes_read
    new = tuple(probe for probe in contest.measurement.probes if probe not in read)
    for further in [(), new] if new else [()]:
        cells = _cells(contest, read + further)
        proposals = []
        for k, run in enumerate(runs):
            here = slice(k * SPEEDS, (k + 1) * SPEEDS)
            chosen, differ = chosen_readings(shown.part(here, cells))
            proposals.append(Proposal(run, tuple(float(speeds[c]) for c in chosen), names, differ, further))
        best = max(
            proposals, key=lambda p: (p.settles, -len(p.speeds_rpm) if p.settles else 0, p.standardised_difference)
        )
        if best.standardised_difference >= TELLING:
            return best
    return None


def _shown(contest: Contest, noise: Noise, conditions: Conditions, ends: tuple[End, End]) -> Shown:
    shown, spread = zip(*(_prediction(contest, conditions, end) for end in ends), strict=True)
    known = np.all([np.isfinite(z).all(axis=(1, 2)) for z in (*shown, *spread)], axis=0)
    shown, spread = ([np.where(known[:, None, None], z, 0.0) for z in values] for values in (shown, spread))
    m, limits = contest.measurement, contest.measurement.knowledge.limits
    speed = np.asarray(conditions.speed) / RPM
    models = [without_timed(contest.space.model_at(end.point)).with_orders((1.0,)) for end in ends]
    peaks = np.concatenate([critical_speeds_rpm(model) for model in models])
    # Where a force depends on the motion there may be no steady state to compute.
    allowed = known & np.all(np.abs(speed[:, None] / peaks - 1.0) > NEAR_PEAK, axis=1)
    largest = max(float(np.abs(m.vectors).max()), MICROMETRE) * 3.0
    most = largest if limits.amplitude_um is None else limits.amplitude_um * MICROMETRE
    allowed &= np.all([np.abs(z).reshape(len(speed), -1).max(axis=1) <= most for z in shown], axis=0)
    middle = 0.5 * (shown[0] + shown[1])
    sigma = 0.0 if m.sigma is None else float(np.median(m.sigma[m.present]))
    size = np.sqrt(np.sum(np.abs(middle) ** 2, axis=1, keepdims=True))
    variance = sigma**2 + noise.allowance**2 + (m.knowledge.tolerance * size) ** 2
    variance = np.repeat(np.broadcast_to(variance, middle.shape).reshape(len(speed), -1), 2, axis=1)
    apart = numpy_pair(shown[0] - shown[1]).reshape(len(speed), -1)
    form = m.knowledge.tolerance * _alike(middle)
    return Shown(apart, np.concatenate([*spread, form], axis=2), variance, allowed)


def _alike(vectors: Complex[np.ndarray, "case probe order"]) -> Float[np.ndarray, "case cell error"]:
    """What relative errors of the model's form do to all readings: z becomes z + ε z at each order, ε the same at all
    speeds, one unit of each of its entries (`rotorjax.inference.covariance`).
    """
    cases, probes, orders = vectors.shape
    moved = np.zeros((cases, probes, orders, probes, probes, orders, 2), complex)
    for p, q, n in np.ndindex(probes, probes, orders):
        moved[:, p, n, p, q, n] = vectors[:, q, n, None] * np.array([1.0, 1j])
    return np.moveaxis(numpy_pair(moved), -1, 3).reshape(cases, 2 * probes * orders, -1)


def _cells(contest: Contest, probes: tuple[str, ...]) -> Bool[np.ndarray, "cell"]:
    """Real and imaginary parts that some probes read; not of half orders, which have no sign to be compared."""
    m = contest.measurement
    return np.repeat([probe in probes and not is_half_order(n) for probe in m.probes for n in m.orders], 2)


def chosen_readings(shown: Shown) -> tuple[list[int], float]:
    """Cases chosen one by one, each the most telling beside those before, and by how much the predictions differ at all
    of them, in standard errors.

    What the readings before have told about the parameters is taken into account as in a Kalman filter.
    """
    free = shown.spread.shape[2]
    mean, root = np.zeros(free), np.eye(free)
    chosen: list[int] = []
    total = 0.0
    while len(chosen) < MOST_READINGS and total < SETTLES**2:
        left = shown.apart - shown.spread @ mean
        spread = shown.spread @ root
        covariance = shown.variance[:, None] * np.eye(left.shape[1]) + spread @ np.swapaxes(spread, 1, 2)
        whitened = np.linalg.solve(covariance, left[..., None])[..., 0]
        gain = np.where(shown.allowed, np.einsum("ci,ci->c", left, whitened), -1.0)
        gain[chosen] = -1.0
        best = int(np.argmax(gain))
        if gain[best] <= 0.0:
            break
        chosen.append(best)
        total += float(gain[best])
        mean = mean + root @ spread[best].T @ whitened[best]
        told = np.eye(free) + (spread[best].T / shown.variance[best]) @ spread[best]
        root = root @ np.linalg.inv(np.linalg.cholesky(told)).T
    return chosen, math.sqrt(total)


def _runs(contest: Contest) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """What may be installed: as in some of the runs there are, nothing, or a trial weight within the limits."""
    m = contest.measurement
    first = [int(np.argmax(m.run == k)) for k in range(len(m.runs))]
    unbalance, bow = np.asarray(m.conditions.unbalance)[first], np.asarray(m.conditions.bow)[first]
    size = np.linalg.norm(unbalance.reshape(len(first), -1), axis=1)
    picked = np.unique(np.argsort(size)[np.linspace(0, len(first) - 1, min(MOST_RUNS, len(first))).round().astype(int)])
    runs = {m.runs[k]: (unbalance[k], bow[k]) for k in picked}
    if np.all((size > 0.0) | np.any(bow != 0.0, axis=1)):
        runs[BARE] = (np.zeros_like(unbalance[0]), np.zeros(2))
    if (trial := m.knowledge.limits.trial_weight_g_mm) is not None:
        weight = np.zeros_like(unbalance[0])
        weight[0] = [trial * GRAM_MILLIMETRE, 0.0]
        runs[TRIAL.format(trial)] = (weight, np.zeros(2))
    return runs


def _prediction(
    contest: Contest, conditions: Conditions, end: End
) -> tuple[np.ndarray, Float[np.ndarray, "case cell free"]]:
    """Vectors, and how the uncertainty of the free unknowns spreads them (a factor of their covariance)."""
    near = (contest.measurement.conditions, end.motions)
    found = predict(contest.space, conditions, end.point, budget=contest.budget, near=near, free=end.free)
    root = np.linalg.cholesky(np.linalg.inv(end.curvature)) if len(end.free) else np.zeros((0, 0))
    return found.shown, found.slopes @ root
