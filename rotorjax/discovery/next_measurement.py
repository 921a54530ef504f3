"""The measurement that would tell two explanations apart best, within the user's limits."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

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
from rotorjax.units import GRAM_MILLIMETRE, MICROMETRE

SPEEDS = 41
"""Speeds tried within the limits."""
MOST_RUNS = 5
"""Runs tried: those that differ most from one another in what is installed."""
TELLING = 2.0
"""Standard errors by which predictions must differ for a reading to be worth proposing."""
BARE, TRIAL = "a run with nothing installed", "a run with nothing but a trial weight of {:g} g mm at 0° (first plane)"


class Proposal(NamedTuple):
    """One reading, and by how many standard errors the predictions of two explanations differ there."""

    run: str
    speed_rpm: float
    separates: tuple[tuple[str, ...], tuple[str, ...]]
    standardised_difference: float
    new_probes: tuple[str, ...] = ()
    """Probes of the rig without a reading so far, if it takes them to tell."""


def next_measurement(
    contest: Contest, noise: Noise, first: End, second: End, names: tuple[tuple[str, ...], tuple[str, ...]]
) -> Proposal | None:
    """The run and speed at which two fitted explanations differ most.

    The difference counts in standard errors of noise and of what the parameters of both leave open. Near a resonance of
    either nothing is proposed: there the model's own error rules. Probes that were never read count only where the
    others would not tell. None if no reading within the limits would tell.
    """
    runs = _runs(contest)
    peaks = np.concatenate(
        [
            critical_speeds_rpm(without_timed(contest.space.model_at(end.point)).with_orders((1.0,)))
            for end in (first, second)
        ]
    )
    measured, limits = contest.measurement.speed_rpm, contest.measurement.knowledge.limits
    low, high = limits.speed_rpm or (0.5 * measured.min(), 1.5 * measured.max())
    speeds = np.linspace(low, high, SPEEDS)
    unbalance = np.repeat(np.stack([u for u, _ in runs.values()]), SPEEDS, axis=0)
    bow = np.repeat(np.stack([b for _, b in runs.values()]), SPEEDS, axis=0)
    conditions = Conditions.at_rpm(np.tile(speeds, len(runs)), unbalance=unbalance, bow=bow)
    shown, spread = zip(*(_prediction(contest, conditions, end) for end in (first, second)), strict=True)
    known = np.all([np.isfinite(z).all(axis=(1, 2)) for z in (*shown, *spread)], axis=0)
    shown, spread = ([np.where(known[:, None, None], z, 0.0) for z in values] for values in (shown, spread))
    weight = contest.measurement.weights(noise.allowance)
    sigma = float(1.0 / np.median(weight[weight > 0.0]))
    speed = np.tile(speeds, len(runs))
    allowed = (
        np.all(np.abs(speed[:, None] / peaks - 1.0) > NEAR_PEAK, axis=1) if len(peaks) else np.ones(len(speed), bool)
    )
    largest = max(float(np.abs(contest.measurement.vectors).max()), MICROMETRE) * 3.0
    most = largest if limits.amplitude_um is None else limits.amplitude_um * MICROMETRE
    # Where a force depends on the motion there may be no steady state to compute.
    allowed &= known & np.all([np.abs(z).reshape(len(speed), -1).max(axis=1) <= most for z in shown], axis=0)
    if not allowed.any():
        return None
    read = contest.measurement.probes_read
    new = tuple(probe for probe in contest.measurement.probes if probe not in read)
    for further in [(), new] if new else [()]:
        size = np.where(allowed, _apart(contest, shown, spread, sigma, read + further), -1.0)
        best = int(np.argmax(size))
        if size[best] >= TELLING:
            return Proposal(list(runs)[best // SPEEDS], float(speed[best]), names, float(size[best]), further)
    return None


def _apart(
    contest: Contest, shown: list[np.ndarray], spread: list[np.ndarray], sigma: float, probes: tuple[str, ...]
) -> Float[np.ndarray, "case"]:
    """Standard errors by which two predictions differ at some of the probes, with what the parameters of both leave
    open.
    """
    # Half orders have no sign that a reading could be compared with.
    cells = np.repeat(
        [
            probe in probes and not is_half_order(n)
            for probe in contest.measurement.probes
            for n in contest.measurement.orders
        ],
        2,
    )
    gap = numpy_pair(shown[0] - shown[1]).reshape(len(shown[0]), -1)[:, cells]
    covariance = sigma**2 * np.eye(gap.shape[1]) + sum(s[:, cells] @ np.swapaxes(s[:, cells], 1, 2) for s in spread)
    return np.sqrt(np.maximum(np.einsum("ci,ci->c", gap, np.linalg.solve(covariance, gap[..., None])[..., 0]), 0.0))


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
