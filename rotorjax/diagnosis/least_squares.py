"""Weighted least squares for unbalance and bow of all runs jointly, with the values of the rotor that are uncertain."""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from rotorjax.arrays import numpy_pair
from rotorjax.data.measurement import Measurement
from rotorjax.diagnosis.fault import Fault
from rotorjax.inference.faults import fault_sensitivity, response_to
from rotorjax.inference.space import Space
from rotorjax.model.model import Model
from rotorjax.units import MICROMETRE

HEALTHY_SPREADS = 4.0
"""Standard deviations of a reduced chi-square above one at which a model counts as failing."""
PASSES = 3
"""Gauss-Newton passes over the uncertain values; without any the map is linear and one is exact."""


def beyond_noise(reduced_chi2: float, freedom: int) -> bool:
    """Whether a reduced chi-square is larger than noise makes it."""
    return reduced_chi2 > 1.0 + HEALTHY_SPREADS * math.sqrt(2.0 / freedom)


class Solution(NamedTuple):
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

    @property
    def model_fails(self) -> bool:
        """Whether the misfit is above the noise, as far as that is known."""
        return self.chi2 is not None and beyond_noise(self.chi2, self.freedom)


class Rows(NamedTuple):
    """The 1X readings of one run, weighted: target = slopes faults + others uncertain."""

    target: Float[np.ndarray, "cell"]
    slopes: Float[np.ndarray, "cell 4"]
    others: Float[np.ndarray, "cell param"]
    weight: Float[np.ndarray, "cell"]


class _Pass(NamedTuple):
    """One joint least-squares solution: faults of every run, uncertain values, and the covariance of both."""

    model: Model
    rows: list[Rows]
    answer: Float[np.ndarray, "unknown"]
    covariance: Float[np.ndarray, "unknown unknown"]
    faults: Float[np.ndarray, "run 4"]
    point: Float[np.ndarray, "param"]
    excess: float


def solve(space: Space, measurement: Measurement) -> tuple[list[Solution], Model]:
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
) -> list[Rows]:
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
        found.append(Rows(w * t, w[:, None] * j, w[:, None] * o, w))
    return found


def _joint(rows: list[Rows], point: np.ndarray, excess: float) -> tuple[np.ndarray, np.ndarray]:
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


def _solution(index: int, rows: Rows, answer: np.ndarray, covariance: np.ndarray, known: bool) -> Solution:
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
    return Solution(
        faults, covariance[own, own], rows.slopes.T @ rows.slopes, alone, rank, freedom, chi2 if known else None, scale
    )
