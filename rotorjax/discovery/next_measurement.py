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
from rotorjax.inference.covariance import random_in_run
from rotorjax.inference.descent import End
from rotorjax.inference.faults import fault_sensitivity
from rotorjax.inference.noise import LEAST_NOISE, Noise
from rotorjax.inference.prediction import predict
from rotorjax.model.conditions import Conditions
from rotorjax.physics.steady_state import without_coupling
from rotorjax.units import GRAM_MILLIMETRE, MICROMETRE

SPEEDS = 41
"""Speeds tried within the limits."""
LOWEST = 0.5
"""Of the lowest speed measured: from there to the highest readings are proposed where the rig file has no limits."""
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
    def speed_rpm(self) -> float:
        """The most telling speed."""
        return self.speeds_rpm[0]

    @property
    def settles(self) -> bool:
        """Whether it is to be expected that the readings settle the tie."""
        return self.standardised_difference >= SETTLES


class Differences(NamedTuple):
    """How two explanations differ at conditions that may be measured."""

    apart: Float[np.ndarray, "case cell"]
    """Difference of the predicted vectors, real and imaginary parts, in standard errors of a reading by itself."""
    common: Float[np.ndarray, "case cell error"]
    """What one unit of every error that readings have in common does to it: parameters of both that are left open,
    errors of the model's form, what is random in the run.
    """
    allowed: Bool[np.ndarray, "case"]


class _Run(NamedTuple):
    """What may be installed, and what is random in it."""

    name: str
    unbalance: Float[np.ndarray, "plane 2"]
    bow: Float[np.ndarray, "2"]
    random: Float[np.ndarray, "4 error"]
    """A factor of the covariance of the unbalance and the bow that nobody knows exactly."""


def next_measurement(
    contest: Contest, noise: Noise, first: End, second: End, names: tuple[tuple[str, ...], tuple[str, ...]]
) -> Proposal | None:
    """The run and the speeds at which two fitted explanations differ most: as few readings as settle the tie.

    The difference counts in standard errors, for all readings together: of noise, of what the parameters of both and a
    calibration on the healthy rotor leave open, of the model's form (`Measurement.form`) and of what is random in a
    run. Near a resonance of either nothing is proposed: there the model's own error rules. Probes that were never read
    are asked for only where the others would not settle it. None if no readings within the limits would tell.
    """
    m, proposals = contest.measurement, []
    low, high = m.knowledge.limits.speed_rpm or (LOWEST * m.speed_rpm.min(), m.speed_rpm.max())
    speeds = np.linspace(low, high, SPEEDS)
    new = tuple(probe for probe in m.probes if probe not in m.probes_read)
    clear = _clear_of_resonances(contest, speeds, (first, second))
    for run in _runs(contest, noise):
        compared = _Compared.of(contest, run, speeds, clear, (first, second))
        for further in [(), new] if new else [()]:
            chosen, differ = chosen_readings(compared.read_by(noise, m.probes_read + further))
            proposals.append(Proposal(run.name, tuple(float(speeds[c]) for c in chosen), names, differ, further))
    best = max(proposals, key=_worth)
    return best if best.standardised_difference >= TELLING else None


def _clear_of_resonances(
    contest: Contest, speeds: Float[np.ndarray, "case"], ends: tuple[End, End]
) -> Bool[np.ndarray, "case"]:
    models = [without_coupling(contest.space.model_at(end.point)).with_orders((1.0,)) for end in ends]
    peaks = np.concatenate([critical_speeds_rpm(model) for model in models])
    return np.all(np.abs(speeds[:, None] / peaks - 1.0) > NEAR_PEAK, axis=1)


def _worth(proposal: Proposal) -> tuple[bool, bool, int, float]:
    """What settles the tie comes first, without new probes, with few readings."""
    fewer = -len(proposal.speeds_rpm) if proposal.settles else 0
    return proposal.settles, not proposal.new_probes, fewer, proposal.standardised_difference


class _Compared(NamedTuple):
    """Two explanations at the speeds of one run, as they predict it."""

    contest: Contest
    shown: tuple[Complex[np.ndarray, "case probe order"], Complex[np.ndarray, "case probe order"]]
    form: Complex[np.ndarray, "case part order"]
    """What errors of the model's form multiply (`Measurement.form`)."""
    spread: Float[np.ndarray, "case cell error"]
    allowed: Bool[np.ndarray, "case"]

    @classmethod
    def of(
        cls,
        contest: Contest,
        run: _Run,
        speeds: Float[np.ndarray, "case"],
        clear: Bool[np.ndarray, "case"],
        ends: tuple[End, End],
    ) -> "_Compared":
        """**Arguments:** ``clear``: speeds that are clear of resonances."""
        count = len(speeds)
        conditions = Conditions.at_rpm(
            speeds, unbalance=np.tile(run.unbalance, (count, 1, 1)), bow=np.tile(run.bow, (count, 1))
        )
        shown, spread = zip(*(_prediction(contest, conditions, end) for end in ends), strict=True)
        known = np.all([np.isfinite(z).all(axis=(1, 2)) for z in (*shown, *spread)], axis=0)
        shown, spread = ([np.where(known[:, None, None], z, 0.0) for z in values] for values in (shown, spread))
        model = contest.space.model_at(ends[0].point)
        random = fault_sensitivity(model, conditions).reshape(count, -1, 4) @ run.random
        m, limits = contest.measurement, contest.measurement.knowledge.limits
        left_open = [] if m.calibration is None else [m.calibration.columns(model, conditions, m.orders)]
        largest = max(float(np.abs(m.vectors).max()), MICROMETRE) * 3.0
        most = largest if limits.amplitude_um is None else limits.amplitude_um * MICROMETRE
        # Where a force is nonlinear there may be no steady state to compute.
        allowed = clear & known & np.all([np.abs(z).reshape(count, -1).max(axis=1) <= most for z in shown], axis=0)
        form = m.form_of(0.5 * (shown[0] + shown[1]), conditions)
        common = np.concatenate([*spread, random, *left_open], axis=2)
        return cls(contest, (shown[0], shown[1]), form, common, allowed)

    def read_by(self, noise: Noise, probes: tuple[str, ...]) -> Differences:
        """As some of the probes would read it. Half orders do not count: they have no sign to be compared."""
        m = self.contest.measurement
        read = np.array([probe in probes for probe in m.probes])
        form = np.where(np.resize(read, self.form.shape[1])[:, None], self.form, 0.0)
        given = 0.0 if m.sigma is None else float(np.median(m.sigma[m.present]))
        # As in `rotorjax.inference.covariance`: noise of every vector, half of ε alike at all speeds, and half at
        # neighbouring ones, which counts as noise here.
        size = np.sqrt(np.sum(np.abs(form) ** 2, axis=1, keepdims=True))
        variance = np.maximum(given, LEAST_NOISE) ** 2 + noise.allowance**2 + 1.5 * size**2
        shape = self.shown[0].shape
        sigma = np.repeat(np.broadcast_to(np.sqrt(variance), shape).reshape(len(form), -1), 2, axis=1)
        apart = numpy_pair(self.shown[0] - self.shown[1]).reshape(len(form), -1)
        alike = math.sqrt(0.5) * form_errors(form, shape[1])
        cells = np.repeat([r and not is_half_order(n) for r in read for n in m.orders], 2)
        common = np.concatenate([self.spread, alike], axis=2) / sigma[:, :, None]
        return Differences((apart / sigma)[:, cells], common[:, cells], self.allowed)


def form_errors(form: Complex[np.ndarray, "case part order"], probes: int) -> Float[np.ndarray, "case cell error"]:
    """What relative errors of the model's form do to the vectors of the probes: what they multiply is added to these,
    z + ε f at each order, ε the same at all speeds; one unit of real and imaginary part of each of its entries.
    """
    cases, parts, orders = form.shape
    moved = np.zeros((cases, probes, orders, probes, parts, orders, 2), complex)
    for p, q, n in np.ndindex(probes, parts, orders):
        moved[:, p, n, p, q, n] = form[:, q, n, None] * np.array([1.0, 1j])
    return np.moveaxis(numpy_pair(moved), -1, 3).reshape(cases, 2 * probes * orders, -1)


def chosen_readings(differences: Differences) -> tuple[list[int], float]:
    """Cases chosen one by one, each the most telling beside those before, and by how much the predictions differ at all
    of them, in standard errors.

    What the readings before have told about the common errors is taken into account as in a Kalman filter.
    """
    errors = differences.common.shape[2]
    mean, root = np.zeros(errors), np.eye(errors)
    chosen: list[int] = []
    total = 0.0
    while len(chosen) < MOST_READINGS and total < SETTLES**2:
        left, common = differences.apart - differences.common @ mean, differences.common @ root
        covariance = np.eye(left.shape[1]) + common @ np.swapaxes(common, 1, 2)
        whitened = np.linalg.solve(covariance, left[..., None])[..., 0]
        gain = np.where(differences.allowed, np.einsum("ci,ci->c", left, whitened), 0.0)
        gain[chosen] = 0.0
        best = int(np.argmax(gain))
        if gain[best] <= 0.0:
            break
        chosen.append(best)
        total += float(gain[best])
        mean = mean + root @ common[best].T @ whitened[best]
        _, seen, directions = np.linalg.svd(common[best], full_matrices=False)
        root = root @ (np.eye(errors) - directions.T @ np.diag(1.0 - 1.0 / np.hypot(1.0, seen)) @ directions)
    return chosen, math.sqrt(total)


def _runs(contest: Contest, noise: Noise) -> list[_Run]:
    """What may be installed: as in some of the runs there are, nothing, or a trial weight within the limits."""
    m = contest.measurement
    first = [int(np.argmax(m.run == k)) for k in range(len(m.runs))]
    unbalance, bow = np.asarray(m.conditions.unbalance)[first], np.asarray(m.conditions.bow)[first]
    size = np.linalg.norm(unbalance.reshape(len(first), -1), axis=1)
    picked = np.unique(np.argsort(size)[np.linspace(0, len(first) - 1, min(MOST_RUNS, len(first))).round().astype(int)])
    installed = [(m.runs[k], unbalance[k], bow[k]) for k in picked]
    if np.all((size > 0.0) | np.any(bow != 0.0, axis=1)):
        installed.append((BARE, np.zeros_like(unbalance[0]), np.zeros(2)))
    if (trial := m.knowledge.limits.trial_weight_g_mm) is not None:
        weight = np.zeros_like(unbalance[0])
        weight[0] = [trial * GRAM_MILLIMETRE, 0.0]
        installed.append((TRIAL.format(trial), weight, np.zeros(2)))
    share = np.asarray(contest.space.model.participation)
    return [
        _Run(name, u, s, random_in_run(m.knowledge, np.concatenate([share @ u, s]), noise.scatter))
        for name, u, s in installed
    ]


def _prediction(
    contest: Contest, conditions: Conditions, end: End
) -> tuple[np.ndarray, Float[np.ndarray, "case cell free"]]:
    """Vectors, and how the uncertainty of the free unknowns spreads them (a factor of their covariance)."""
    near = (contest.measurement.conditions, end.motions)
    found = predict(contest.space, conditions, end.point, budget=contest.budget, near=near, free=end.free)
    return found.shown, found.slopes @ covariance_root(end.curvature, float(np.min(end.prior.weight, initial=1.0)))


def covariance_root(curvature: Float[np.ndarray, "free free"], least: float) -> Float[np.ndarray, "free free"]:
    """R with R Rᵀ the inverse of a curvature whose eigenvalues are ``least`` at least, that of the prior, whatever
    rounding makes of them where the data say a million times more.
    """
    values, directions = np.linalg.eigh(curvature)
    return directions / np.sqrt(np.maximum(values, least))
