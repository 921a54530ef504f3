"""The linear inverse: unbalance and bow from measured vectors by least squares, and whether they can be told apart."""

import dataclasses
import math
from collections.abc import Iterator
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Complex, Float

from rotorjax._core import MICROMETRE, RPM, numpy_pair
from rotorjax.measurement import Measurement
from rotorjax.model import Conditions, Model
from rotorjax.response import response

ENTANGLED = 10.0
"""Growth of a standard error, by the other fault being free, above which two faults count as entangled."""
RESOLVED = 2.0
"""An entangled fault is still told apart if it is this many standard errors large."""
NEAR_CRITICAL = 0.05
"""Half width of the band around a critical speed that is not proposed for measuring."""


class Fault(NamedTuple):
    """A rotating vector as an (x, y) pair in SI, with its covariance; none where the data do not determine it."""

    pair: Float[np.ndarray, "dof"]
    covariance: Float[np.ndarray, "dof dof"] | None

    @property
    def magnitude(self) -> float:
        """Length of the vector, SI."""
        return float(np.hypot(*self.pair))

    @property
    def angle_deg(self) -> float:
        """Angle from +x in the sense of rotation."""
        return math.degrees(math.atan2(self.pair[1], self.pair[0]))

    @property
    def standard_error(self) -> float | None:
        """Of the magnitude: across-section of the error ellipse along the vector."""
        return None if self.covariance is None else self._error_along(self.pair)

    @property
    def angle_standard_error_deg(self) -> float | None:
        """Of the angle; 180 where the vector is within its error of zero."""
        if self.covariance is None:
            return None
        across = self._error_along(np.array([-self.pair[1], self.pair[0]]))
        return math.degrees(math.atan2(across, self.magnitude)) if self.magnitude > across else 180.0

    @property
    def largest_error(self) -> float:
        """Standard error along the worst direction; infinite if nothing determines it."""
        return math.inf if self.covariance is None else float(np.sqrt(np.linalg.eigvalsh(self.covariance)[-1]))

    def _error_along(self, direction: np.ndarray) -> float:
        assert self.covariance is not None
        size = np.hypot(*direction)
        unit = direction / size if size > 0.0 else np.array([1.0, 0.0])
        return float(np.sqrt(max(unit @ self.covariance @ unit, 0.0)))


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
    """The unbalance that would account for all of it without any bow."""
    reduced_chi2: float | None
    """Squared residual in squared standard errors per degree of freedom; well above one, the model does not hold."""


@dataclasses.dataclass(frozen=True)
class Diagnosis:
    """What `diagnose` found in every run, and the inherent faults where a reference was given."""

    runs: tuple[RunDiagnosis, ...]
    inherent: RunDiagnosis | None


class _Solution(NamedTuple):
    faults: Float[np.ndarray, "4"]
    covariance: Float[np.ndarray, "4 4"] | None
    information: Float[np.ndarray, "4 4"]
    alone: Fault
    rank: int
    chi2: float | None


def fault_sensitivity(model: Model, conditions: Conditions) -> Float[np.ndarray, "case probe order 2 4"]:
    """Derivative of real and imaginary parts by (U_x, U_y, s_x, s_y) on the disk [m per kg m, m per m].

    The response is linear in them, so that a difference over a large step is exact but for rounding.
    """
    zero, unit = np.zeros(2), np.eye(2)
    none = _response_to(model, conditions, zero, zero)
    faults = [(axis, zero) for axis in unit] + [(zero, axis) for axis in unit]
    columns = [_response_to(model, conditions, unbalance, bow) - none for unbalance, bow in faults]
    return np.stack([numpy_pair(c) for c in columns], axis=-1)


def _response_to(model: Model, conditions: Conditions, unbalance: np.ndarray, bow: np.ndarray) -> Complex[np.ndarray, "case probe order"]:
    """The response with these faults instead of what is installed."""
    cases, planes = conditions.unbalance.shape[:2]
    spread = np.zeros((cases, planes, 2))
    spread[:, 0] = unbalance / float(model.participation[0])
    return np.asarray(response(model, Conditions(conditions.speed, jnp.asarray(spread), jnp.asarray(np.tile(bow, (cases, 1))))))


def diagnose(model: Model, measurement: Measurement, *, reference: tuple[str, ...] = ()) -> Diagnosis:
    """Unbalance and bow of every run from its 1X vectors at all its speeds jointly, by weighted least squares.

    z - z_0 = J (U_x, U_y, s_x, s_y): the map is linear (Huang et al. 2026, Sensors 26:2565, equations 5-9). Found is
    all that drives the run, what was installed included. Covariance (JᵀWJ)⁻¹, times the reduced chi-square where
    that exceeds one; with unknown noise the residual gives it.

    **Arguments:** ``model`` of rotor and reading, its own faults not counted; ``measurement``; ``reference``: runs
    whose installed faults are known, so that what is found beyond them is inherent to the rotor and taken off the
    other runs. **Returns** a `Diagnosis`. **Errors.** ``ValueError`` for a reference that is not a run, or no 1X.
    """
    if 1.0 not in measurement.orders:
        raise ValueError("the table holds no order 1: unbalance and bow show at 1X")
    if missing := [run for run in reference if run not in measurement.runs]:
        raise ValueError(f"reference run {missing[0]!r} is not in the table, which has {', '.join(measurement.runs)}")
    full = model.with_orders(measurement.orders)
    solutions = list(_solve_runs(full, measurement))
    inherent = _inherent(measurement, full, solutions, reference) if reference else None
    runs = tuple(
        _judge(run, _shifted(solution, inherent) if inherent else solution, full, measurement, k)
        for k, (run, solution) in enumerate(zip(measurement.runs, solutions, strict=True))
    )
    found = _judge("inherent", inherent, full, measurement, measurement.runs.index(reference[0])) if inherent else None
    return Diagnosis(runs, found)


def _solve_runs(model: Model, measurement: Measurement) -> Iterator[_Solution]:
    first = measurement.orders.index(1.0)
    slopes = fault_sensitivity(model, measurement.conditions)[:, :, first]
    zero = np.zeros(2)
    driven = measurement.vectors - _response_to(model, measurement.conditions, zero, zero)
    known = measurement.sigma is not None or measurement.knowledge.tolerance > 0.0
    weight = measurement.weights(0.0 if known else MICROMETRE)[:, :, first]
    for run in range(len(measurement.runs)):
        cases = measurement.run == run
        w = weight[cases].ravel()
        z = driven[cases, :, first]
        yield _solve(slopes[cases].reshape(-1, 4)[w > 0], numpy_pair(z).ravel()[w > 0], w[w > 0], known)


def _solve(slopes: np.ndarray, right: np.ndarray, weight: np.ndarray, known: bool) -> _Solution:
    matrix, target = slopes * weight[:, None], right * weight
    scale = np.linalg.norm(matrix, axis=0)
    scale[scale == 0.0] = 1.0
    faults, _, rank, _ = np.linalg.lstsq(matrix / scale, target, rcond=1e-10)
    residual = target - matrix / scale @ faults
    freedom = len(target) - int(rank)
    chi2 = float(residual @ residual) / freedom if freedom > 0 else None
    information = matrix.T @ matrix
    if rank < 4 or (chi2 is None and not known):
        covariance = None
    else:
        covariance = np.linalg.inv((matrix / scale).T @ (matrix / scale)) / np.outer(scale, scale)
        covariance *= max(1.0, chi2 or 1.0) if known else max(chi2 or 0.0, 0.0)
    unbalance_only = matrix[:, :2]
    curvature = unbalance_only.T @ unbalance_only
    regular = len(target) >= 2 and np.linalg.cond(curvature) < 1e12
    pair = np.linalg.solve(curvature, unbalance_only.T @ target) if regular else np.full(2, np.nan)
    alone = Fault(pair, np.linalg.inv(curvature) if regular and known else None)
    return _Solution(faults / scale, covariance, information, alone, int(rank), chi2 if known else None)


def _inherent(measurement: Measurement, model: Model, solutions: list[_Solution], reference: tuple[str, ...]) -> _Solution:
    """Found less installed, averaged over the reference runs."""
    beyond, covariances, alone = [], [], []
    for run in reference:
        k = measurement.runs.index(run)
        case = int(np.argmax(measurement.run == k))
        unbalance = np.sum(np.asarray(measurement.conditions.unbalance)[case] * np.asarray(model.participation)[:, None], axis=0)
        installed = np.concatenate([unbalance, np.asarray(measurement.conditions.bow)[case]])
        beyond.append(solutions[k].faults - installed)
        covariances.append(solutions[k].covariance)
        alone.append(solutions[k].alone.pair - unbalance)
    known = [c for c in covariances if c is not None]
    covariance = np.sum(known, axis=0) / len(reference) ** 2 if len(known) == len(reference) else None
    first = solutions[measurement.runs.index(reference[0])]
    return _Solution(np.mean(beyond, axis=0), covariance, first.information, Fault(np.mean(alone, axis=0), first.alone.covariance), first.rank, None)


def _shifted(solution: _Solution, inherent: _Solution) -> _Solution:
    both = solution.covariance is not None and inherent.covariance is not None
    covariance = solution.covariance + inherent.covariance if both else None  # type: ignore[operator]
    alone = Fault(solution.alone.pair - inherent.alone.pair, solution.alone.covariance)
    return solution._replace(faults=solution.faults - inherent.faults, covariance=covariance, alone=alone)


def _judge(run: str, solution: _Solution, model: Model, measurement: Measurement, index: int) -> RunDiagnosis:
    covariance = solution.covariance
    blocks = (covariance[:2, :2], covariance[2:, 2:]) if covariance is not None else (None, None)
    unbalance, bow = Fault(solution.faults[:2], blocks[0]), Fault(solution.faults[2:], blocks[1])
    reason = _why_not(unbalance, bow, solution, model, measurement, index)
    alone = solution.alone if np.all(np.isfinite(solution.alone.pair)) else None
    if solution.rank < 4 or model.slow_roll is not None:
        # With slow roll subtracted only the damping's form tells the two apart: a value would be an artefact of the model.
        return RunDiagnosis(run, None, None, False, reason, alone, solution.chi2)
    return RunDiagnosis(run, unbalance, bow, not reason, reason, alone, solution.chi2)


def _why_not(unbalance: Fault, bow: Fault, solution: _Solution, model: Model, measurement: Measurement, index: int) -> str:
    """Why unbalance and bow cannot be told apart, with a cure; empty if they can."""
    cases = measurement.run == index
    speeds = measurement.speed_rpm[cases]
    if solution.rank < 4:
        return f"{solution.rank} independent numbers for four unknowns: measure a second probe or a second speed"
    if model.slow_roll is not None:
        return (
            "slow roll was subtracted, and with it what a bow shows there: bow and unbalance follow the same law with speed; "
            "give the vectors without that subtraction"
        )
    if solution.covariance is None:
        return "the noise is unknown and no reading is left over to judge it: give sigma_um, repeats, or a second speed"
    alone = np.linalg.inv(solution.information[:2, :2]), np.linalg.inv(solution.information[2:, 2:])
    for fault, free in ((unbalance, alone[0]), (bow, alone[1])):
        growth = fault.largest_error / math.sqrt(float(np.linalg.eigvalsh(free)[-1]))
        if growth > ENTANGLED and fault.magnitude < RESOLVED * fault.largest_error:
            return f"{_entanglement(speeds, model)}; {_cure(unbalance, solution, model, measurement, cases)}"
    return ""


def _entanglement(speeds: np.ndarray, model: Model) -> str:
    critical = np.sort(np.sqrt(np.asarray(model.rotor.stiffness) / float(model.rotor.mass)) / RPM)
    axes = f"{critical[0]:.0f} and {critical[1]:.0f} rpm"
    if np.ptp(speeds) <= 0.02 * np.min(speeds):
        return f"one speed ({np.mean(speeds):.0f} rpm) and nearly equal axes (critical speeds {axes}): bow and unbalance look alike there"
    return f"bow and unbalance look alike at {', '.join(f'{s:.0f}' for s in np.unique(speeds))} rpm within the noise (critical speeds {axes})"


def _cure(unbalance: Fault, solution: _Solution, model: Model, measurement: Measurement, cases: np.ndarray) -> str:
    """The further speed within the limits that would tell them apart best, with the error that it would leave."""
    critical = np.sqrt(np.asarray(model.rotor.stiffness) / float(model.rotor.mass)) / RPM
    low, high = measurement.knowledge.limits.speed_rpm or (0.3 * critical.min(), 0.9 * critical.min())
    candidates = np.linspace(low, high, 41)
    clear = np.all(np.abs(candidates[:, None] / critical - 1.0) > NEAR_CRITICAL, axis=1)
    candidates = candidates[clear]
    if not len(candidates):
        return "widen the limits on speed to find one that would tell them apart"
    first = measurement.orders.index(1.0)
    slopes = fault_sensitivity(model, Conditions.at_rpm(candidates, unbalance=np.zeros((len(model.layout.planes), 2))))[:, :, first]
    known = measurement.sigma is not None
    sigma = float(np.mean(measurement.sigma[cases][measurement.present[cases]])) if known else MICROMETRE  # type: ignore[index]
    errors = []
    for rows in slopes.reshape(len(candidates), -1, 4) / sigma:
        more = np.linalg.inv(solution.information + rows.T @ rows)[:2, :2]
        errors.append(math.sqrt(float(np.linalg.eigvalsh(more)[-1])))
    best = int(np.argmin(errors))
    return (
        f"a reading at {candidates[best]:.0f} rpm would bring the standard error of the unbalance "
        f"from {unbalance.largest_error * 1e6:.3g} to {errors[best] * 1e6:.3g} g mm"
    )
