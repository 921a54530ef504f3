"""The linear inverse: unbalance and bow from measured vectors by least squares, and whether they are separable."""

import dataclasses
import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from rotorjax.arrays import numpy_pair, require_float64
from rotorjax.data.measurement import Measurement
from rotorjax.diagnosis.critical_speeds import critical_speeds_rpm, natural_speeds_rpm
from rotorjax.diagnosis.fault import Fault
from rotorjax.inference.faults import fault_sensitivity, installed_faults, polar_covariance, response_to
from rotorjax.inference.space import Space, make_space, with_company
from rotorjax.model.conditions import Conditions
from rotorjax.model.model import Model
from rotorjax.units import MICROMETRE

HEALTHY_SPREADS = 4.0
"""Standard deviations of a reduced chi-square above one at which a model counts as failing."""
ENTANGLED = 10.0
"""Growth of a standard error, by the other fault being free, above which two faults count as entangled."""
RESOLVED = 2.0
"""An entangled fault is still separable if it is this many standard errors large."""
NEAR_PEAK = 0.1
"""Half width of the band around a resonance that is not proposed for measuring: there the model's own error rules."""
MODEL_FAILS = "the model does not hold here"
"""How the reason begins where the misfit is above the noise."""
PASSES = 3
"""Gauss-Newton passes over the uncertain values; without any the map is linear and one is exact."""


@dataclasses.dataclass(frozen=True)
class RunDiagnosis:
    """Unbalance [kg m] and bow [m] of one run; either is none where not even a least-squares value exists."""

    run: str
    unbalance: Fault | None
    bow: Fault | None
    identifiable: bool
    reason: str
    """Why not, and what would help; empty if identifiable."""
    unbalance_alone: Fault | None
    """If not identifiable: the unbalance that would account for the most of it without any bow."""
    reduced_chi2: float | None
    """Squared residual in squared standard errors per degree of freedom; well above one, the model does not hold."""
    model_holds: bool | None
    """Whether the misfit is within the noise; none where the noise is not known, or no reading is left over."""


@dataclasses.dataclass(frozen=True)
class Diagnosis:
    """What `diagnose` found in every run, and the inherent faults where a reference was given."""

    runs: tuple[RunDiagnosis, ...]
    inherent: RunDiagnosis | None


class _Solution(NamedTuple):
    """Faults of one run; covariances in units of the squared standard errors given (or µm² where unknown)."""

    faults: Float[np.ndarray, "4"]
    covariance: Float[np.ndarray, "4 4"]
    information: Float[np.ndarray, "4 4"]
    """JᵀWJ of the run alone, nothing uncertain."""
    alone: Fault
    rank: int
    freedom: int
    chi2: float | None
    scale: float | None
    """Factor from `covariance` to the covariance to report; none if nothing gives it."""


class _Rows(NamedTuple):
    """The 1X readings of one run, weighted: target = slopes faults + others uncertain."""

    target: Float[np.ndarray, "cell"]
    slopes: Float[np.ndarray, "cell 4"]
    others: Float[np.ndarray, "cell param"]
    weight: Float[np.ndarray, "cell"]


def diagnose(model: Model, measurement: Measurement, *, reference: tuple[str, ...] = ()) -> Diagnosis:
    """Unbalance and bow of every run from its 1X vectors at all its speeds jointly, by weighted least squares.

    z - z_0 = J (U_x, U_y, s_x, s_y): the map is linear (Huang et al. 2026, Sensors 26:2565, equations 5-9). Found is
    all that drives the run, what was installed included. What the user declared uncertain of rotor and probes is
    fitted beside, one value for all runs, and widens the errors. Covariance from the joint normal equations, times
    the reduced chi-square where that exceeds one; with unknown noise the residual gives it.

    **Arguments:** ``model`` of rotor and reading, its own faults not counted; ``measurement``; ``reference``: runs
    whose installed faults are known, so that what is found beyond them is inherent to the rotor and taken off the
    other runs. **Returns** a `Diagnosis`. **Errors.** ``ValueError`` in single precision, for a reference that is not
    a run, or without 1X.
    """
    require_float64("diagnose")
    if 1.0 not in measurement.orders:
        raise ValueError("the table holds no order 1: unbalance and bow show at 1X")
    if missing := [run for run in reference if run not in measurement.runs]:
        raise ValueError(f"reference run {missing[0]!r} is not in the table, which has {', '.join(measurement.runs)}")
    full = with_company(model.with_orders(measurement.orders), {u.effect for u in measurement.knowledge.uncertain})
    solutions, fitted = _solve(make_space(full, measurement.knowledge), measurement)
    inherent = _inherent(measurement, fitted, solutions, reference) if reference else None
    runs = []
    for k, (run, solution) in enumerate(zip(measurement.runs, solutions, strict=True)):
        beyond = solution if inherent is None or run in reference else _shifted(solution, inherent)
        runs.append(_judge(run, beyond, fitted, measurement, k))
    found = (
        _judge("inherent", inherent, fitted, measurement, measurement.runs.index(reference[0])) if inherent else None
    )
    return Diagnosis(tuple(runs), found)


class _Pass(NamedTuple):
    """One joint least-squares solution: faults of every run, uncertain values, and the covariance of both."""

    model: Model
    rows: list[_Rows]
    answer: Float[np.ndarray, "unknown"]
    covariance: Float[np.ndarray, "unknown unknown"]
    faults: Float[np.ndarray, "run 4"]
    point: Float[np.ndarray, "param"]
    excess: float


def _solve(space: Space, measurement: Measurement) -> tuple[list[_Solution], Model]:
    """Faults of every run and the uncertain values, by Gauss-Newton over the latter; and the model at them."""
    uncertain = sorted({e.unknown for e in space.entries if e.declared_uncertain})
    nothing = np.zeros((len(measurement.runs), 4))
    now = _pass(space, measurement, [], nothing, space.given_unknowns(), 1.0)
    for _ in range(PASSES if uncertain else 0):
        now = _pass(space, measurement, uncertain, now.faults, now.point, now.excess)
    known = measurement.sigma is not None
    return [_solution(k, rows, now.answer, now.covariance, known) for k, rows in enumerate(now.rows)], now.model


def _pass(
    space: Space, measurement: Measurement, moved: list[int], faults: np.ndarray, point: np.ndarray, excess: float
) -> _Pass:
    rows = _rows(space, point, moved, measurement, faults)
    matrix, target = _joint(rows, point[moved], excess)
    norm = np.linalg.norm(matrix, axis=0)
    norm[norm == 0.0] = 1.0
    scaled = matrix / norm
    answer = np.linalg.lstsq(scaled, target, rcond=1e-10)[0] / norm
    covariance = np.linalg.pinv(scaled.T @ scaled, rcond=1e-14, hermitian=True) / np.outer(norm, norm)
    left = (target - matrix @ answer)[: len(target) - len(moved)]
    after = point.copy()
    after[moved] += answer[faults.size :]
    model = space.model_at(point)
    return _Pass(
        model,
        rows,
        answer,
        covariance,
        answer[: faults.size].reshape(faults.shape),
        after,
        max(1.0, float(left @ left) / max(1, len(left) - faults.size)),
    )


def _rows(
    space: Space, point: np.ndarray, uncertain: list[int], measurement: Measurement, faults: np.ndarray
) -> list[_Rows]:
    first = measurement.orders.index(1.0)
    model, conditions = space.model_at(point), measurement.conditions
    slopes = fault_sensitivity(model, conditions)[:, :, first]
    if model.slow_roll is not None:
        slopes[..., 2:] = 0.0  # only the damping's form would tell a bow from an unbalance: all goes to the unbalance
    driven = measurement.vectors - response_to(model, conditions, np.zeros((len(measurement.run), 4)))
    target = numpy_pair(driven[:, :, first])
    others = np.zeros((*target.shape, len(uncertain)))
    for column, unknown in enumerate(uncertain):
        step = 1e-3 * np.eye(len(point))[unknown]
        up, down = (response_to(space.model_at(point + s), conditions, faults[measurement.run]) for s in (step, -step))
        others[..., column] = numpy_pair((up - down)[:, :, first]) / 2e-3
    # Uncertain values move J and z_0; the slope is taken at the faults found so far.
    weight = measurement.weights(0.0 if measurement.sigma is not None else MICROMETRE)[:, :, first]
    found = []
    for run in range(len(measurement.runs)):
        cases = measurement.run == run
        w = weight[cases].ravel()
        parts = target[cases].ravel(), slopes[cases].reshape(len(w), 4), others[cases].reshape(len(w), len(uncertain))
        t, j, o = (part[w > 0.0] for part in parts)
        w = w[w > 0.0]
        found.append(_Rows(w * t, w[:, None] * j, w[:, None] * o, w))
    return found


def _joint(rows: list[_Rows], point: np.ndarray, excess: float) -> tuple[np.ndarray, np.ndarray]:
    """All runs' equations below one another, and the prior of the uncertain values: unknowns faults, then increments.

    ``excess``, the reduced chi-square that the model leaves, weighs the prior up: a misfit must not drag those values.
    """
    runs, width = len(rows), rows[0].others.shape[1]
    matrix = np.zeros((sum(len(r.target) for r in rows) + width, 4 * runs + width))
    start = 0
    for k, r in enumerate(rows):
        stop = start + len(r.target)
        matrix[start:stop, 4 * k : 4 * k + 4] = r.slopes
        matrix[start:stop, 4 * runs :] = r.others
        start = stop
    matrix[start:, 4 * runs :] = math.sqrt(excess) * np.eye(width)
    return matrix, np.concatenate([*(r.target for r in rows), -math.sqrt(excess) * point])


def _solution(index: int, rows: _Rows, answer: np.ndarray, covariance: np.ndarray, known: bool) -> _Solution:
    own = slice(4 * index, 4 * index + 4)
    faults = answer[own]
    width = rows.others.shape[1]
    left = rows.target - rows.slopes @ faults - rows.others @ answer[len(answer) - width :]
    norm = np.linalg.norm(rows.slopes, axis=0)
    norm[norm == 0.0] = 1.0
    rank = int(np.linalg.matrix_rank(rows.slopes / norm, tol=1e-9))
    freedom = len(rows.target) - rank
    chi2 = float(left @ left) / freedom if freedom > 0 else None
    if known:
        scale: float | None = max(1.0, chi2 or 1.0)
    else:
        scale = chi2 or None
    curvature = rows.slopes[:, :2].T @ rows.slopes[:, :2]
    regular = len(rows.target) >= 2 and np.linalg.cond(curvature) < 1e12
    pair = np.linalg.solve(curvature, rows.slopes[:, :2].T @ rows.target) if regular else np.full(2, np.nan)
    lost = math.inf if known else freedom
    alone = Fault(pair, np.linalg.inv(curvature) * scale if regular and scale else None, lost)
    return _Solution(
        faults, covariance[own, own], rows.slopes.T @ rows.slopes, alone, rank, freedom, chi2 if known else None, scale
    )


def _inherent(
    measurement: Measurement, model: Model, solutions: list[_Solution], reference: tuple[str, ...]
) -> _Solution:
    """Found less installed, averaged over the reference runs; declared errors of the installed ones widen it."""
    installed, known = installed_faults(model, measurement), measurement.knowledge
    chosen = [measurement.runs.index(run) for run in reference]
    each = [solutions[k] for k in chosen]
    covariance = np.zeros((4, 4))
    for k, solution in zip(chosen, each, strict=True):
        covariance += solution.covariance
        covariance[:2, :2] += polar_covariance(
            installed[k, :2], known.installed_unbalance, known.installed_angle_rad
        ) / (solution.scale or 1.0)
        covariance[2:, 2:] += polar_covariance(installed[k, 2:], known.installed_bow, known.installed_angle_rad) / (
            solution.scale or 1.0
        )
    scales = [s.scale for s in each if s.scale is not None]
    return each[0]._replace(
        faults=np.mean([s.faults - installed[k] for k, s in zip(chosen, each, strict=True)], axis=0),
        covariance=covariance / len(each) ** 2,
        alone=Fault(
            np.mean([s.alone.pair - installed[k, :2] for k, s in zip(chosen, each, strict=True)], axis=0),
            each[0].alone.covariance,
            each[0].alone.freedom,
        ),
        scale=max(scales) if len(scales) == len(each) else None,
        chi2=max((s.chi2 for s in each if s.chi2 is not None), default=None),
    )


def _shifted(solution: _Solution, inherent: _Solution) -> _Solution:
    ratio = (inherent.scale or 1.0) / (solution.scale or 1.0)
    return solution._replace(
        faults=solution.faults - inherent.faults,
        covariance=solution.covariance + ratio * inherent.covariance,
        alone=solution.alone._replace(pair=solution.alone.pair - inherent.alone.pair),
    )


def _judge(run: str, solution: _Solution, model: Model, measurement: Measurement, index: int) -> RunDiagnosis:
    covariance = None if solution.scale is None else solution.scale * solution.covariance
    blocks = (covariance[:2, :2], covariance[2:, 2:]) if covariance is not None else (None, None)
    lost = math.inf if measurement.sigma is not None else solution.freedom
    unbalance, bow = (Fault(solution.faults[k : k + 2], blocks[k // 2], lost) for k in (0, 2))
    reason = _why_not(unbalance, bow, solution, model, measurement, index)
    alone = solution.alone if reason and np.all(np.isfinite(solution.alone.pair)) else None
    holds = None if solution.chi2 is None else not _fails(solution)
    if solution.rank < 4 or model.slow_roll is not None:
        return RunDiagnosis(run, None, None, False, reason, alone, solution.chi2, holds)
    return RunDiagnosis(run, unbalance, bow, not reason, reason, alone, solution.chi2, holds)


def _why_not(
    unbalance: Fault, bow: Fault, solution: _Solution, model: Model, measurement: Measurement, index: int
) -> str:
    """Why unbalance and bow are not separable, with a cure; empty if they are."""
    if hopeless := _hopeless(solution, model):
        return hopeless
    resolved = all(fault.magnitude >= RESOLVED * fault.largest_error for fault in (unbalance, bow))
    unchecked = solution.freedom == 0 and not measurement.knowledge.uncertain
    if _growth(solution.covariance) <= ENTANGLED or (resolved and not unchecked):
        return ""
    entangled = _entanglement(measurement.speed_rpm[measurement.run == index], model)
    if unchecked:
        entangled += ", and no reading is left over to check the model by"
    return f"{entangled}; {_cure(solution, model, measurement, index)}"


def _hopeless(solution: _Solution, model: Model) -> str:
    """Reasons that lie in the plan or the model, not in the size of the noise."""
    if model.slow_roll is not None:
        return (
            "slow roll was subtracted, and with it what a bow shows there: bow and unbalance follow the same law with "
            "speed; "
            "give the vectors without that subtraction"
        )
    if solution.rank < 4:
        return f"{solution.rank} independent numbers for four unknowns: measure a second probe or a second speed"
    if solution.scale is None:
        return "the noise is unknown and nothing is left over to judge it by: give sigma_um, repeats, or a second speed"
    if solution.chi2 is not None and _fails(solution):
        return (
            f"{MODEL_FAILS}: it misses the readings by {math.sqrt(solution.chi2):.3g} times their "
            "standard error, so that what it lacks is counted as unbalance and bow; `rotorjax explain` looks for what "
            "it lacks"
        )
    return ""


def _fails(solution: _Solution) -> bool:
    """Whether the misfit is above the noise."""
    return solution.chi2 is not None and beyond_noise(solution.chi2, solution.freedom)


def beyond_noise(reduced_chi2: float, freedom: int) -> bool:
    """Whether a reduced chi-square is larger than noise makes it."""
    return reduced_chi2 > 1.0 + HEALTHY_SPREADS * math.sqrt(2.0 / freedom)


def _growth(covariance: Float[np.ndarray, "4 4"]) -> float:
    """How much larger the standard error of either fault is than it would be if the other were known."""

    def one(own: slice, other: slice) -> float:
        crossed = covariance[own, other]
        known = covariance[own, own] - crossed @ np.linalg.solve(covariance[other, other], crossed.T)
        return _largest(covariance[own, own]) / max(_largest(known), 1e-300)

    unbalance, bow = slice(0, 2), slice(2, 4)
    return max(one(unbalance, bow), one(bow, unbalance))


def _largest(covariance: np.ndarray) -> float:
    """Standard error along the worst direction."""
    return math.sqrt(max(float(np.linalg.eigvalsh(covariance)[-1]), 0.0))


def _peaks_rpm(model: Model) -> Float[np.ndarray, "_"]:
    """Critical speeds, or where damping leaves none the natural frequencies of the axes."""
    peaks = critical_speeds_rpm(model)
    return peaks if len(peaks) else natural_speeds_rpm(model)


def _entanglement(speeds: np.ndarray, model: Model) -> str:
    axes = " and ".join(f"{speed:.0f}" for speed in _peaks_rpm(model))
    if np.ptp(speeds) <= 0.02 * np.min(speeds):
        return (
            f"one speed ({np.mean(speeds):.0f} rpm) and nearly equal axes (critical speeds {axes} rpm): bow and "
            "unbalance look alike there"
        )
    listed = ", ".join(f"{speed:.0f}" for speed in np.unique(speeds))
    return (
        f"bow and unbalance look alike at {listed} rpm, within the noise and what is uncertain (critical speeds {axes} "
        "rpm)"
    )


def _cure(solution: _Solution, model: Model, measurement: Measurement, index: int) -> str:
    """The further speed within the limits that would tell them apart best, with the error that it would leave."""
    peaks, limits = _peaks_rpm(model), measurement.knowledge.limits
    low, high = limits.speed_rpm or (0.3 * peaks.min(), 1.7 * peaks.max())
    candidates = np.linspace(low, high, 57)
    conditions = Conditions.at_rpm(candidates, unbalance=np.zeros((len(model.layout.planes), 2)))
    first = measurement.orders.index(1.0)
    clear = np.all(np.abs(candidates[:, None] / peaks - 1.0) > NEAR_PEAK, axis=1)
    if limits.amplitude_um is not None:
        expected = np.abs(response_to(model, conditions, np.tile(solution.faults, (len(candidates), 1)))[:, :, first])
        clear &= np.all(expected < limits.amplitude_um * MICROMETRE, axis=1)
    if not clear.any():
        return "no speed within the limits would separate them"
    cells = measurement.weights(0.0 if measurement.sigma is not None else MICROMETRE)[measurement.run == index][
        :, :, first
    ]
    weight = float(np.median(cells[cells > 0.0]))
    factor = math.sqrt(solution.scale or 1.0) * 1e6
    before = factor * _largest(np.linalg.inv(solution.information)[:2, :2])
    after = np.full(len(candidates), np.inf)
    for k, rows in enumerate(
        weight * fault_sensitivity(model, conditions)[:, :, first].reshape(len(candidates), -1, 4)
    ):
        after[k] = (
            factor * _largest(np.linalg.inv(solution.information + rows.T @ rows)[:2, :2]) if clear[k] else np.inf
        )
    best = int(np.argmin(after))
    if measurement.knowledge.uncertain:
        return f"a reading at {candidates[best]:.0f} rpm would separate them best"
    return (
        f"a reading at {candidates[best]:.0f} rpm would bring the standard error of the unbalance from {before:.3g} to "
        f"{after[best]:.3g} g mm"
    )
