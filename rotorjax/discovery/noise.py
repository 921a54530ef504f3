"""How large a residual the measurement allows: standard errors, the model's tolerance, scatter between runs."""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float

from rotorjax._core import GRAM_MILLIMETRE, MICROMETRE, numpy_pair
from rotorjax.inverse import fault_sensitivity, installed_faults, polar_covariance
from rotorjax.measurement import Measurement
from rotorjax.model import Model

FEW_RUNS = 4
"""Fewer runs say nothing useful about the scatter between runs."""
LEAST_GAIN = 2.0
"""Log likelihood that scatter between runs must gain to be believed."""


class RunScatter(NamedTuple):
    """Standard deviation per component of a random unbalance in every run, of zero mean. The bow is never told from it."""

    unbalance_kg_m: float = 0.0
    bow_m: float = 0.0
    share: float = 0.0
    """Share of the squared residual that it accounts for."""

    def as_json(self) -> dict[str, float]:
        """In engineering units."""
        return {"unbalance_g_mm": self.unbalance_kg_m / GRAM_MILLIMETRE, "bow_um": self.bow_m / MICROMETRE}


def scatter_factor(measurement: Measurement, model: Model) -> Float[np.ndarray, "run dof latent"]:
    """Factor L of the covariance L Lᵀ of the random (U_x, U_y, s_x, s_y) of each run [kg m, m].

    What the user declared of the installed weights and bows: relative size along, angle across.
    """
    known, installed = measurement.knowledge, installed_faults(model, measurement)
    factors = np.zeros((len(measurement.runs), 4, 4))
    for run, fault in enumerate(installed):
        covariance = np.zeros((4, 4))
        covariance[:2, :2] = polar_covariance(fault[:2], known.installed_unbalance, known.installed_angle_rad)
        covariance[2:, 2:] = polar_covariance(fault[2:], known.installed_bow, known.installed_angle_rad)
        values, directions = np.linalg.eigh(covariance)
        factors[run] = directions * np.sqrt(np.maximum(values, 0.0))
    return factors


def scatter_wanted(measurement: Measurement) -> bool:
    """Whether scatter between runs can be inferred: four runs, known noise, neither switched off nor declared by the user."""
    known = measurement.knowledge
    declared = known.installed_unbalance > 0.0 or known.installed_angle_rad > 0.0 or known.installed_bow > 0.0
    return len(measurement.runs) >= FEW_RUNS and known.run_scatter == "auto" and measurement.sigma is not None and not declared


def infer_run_scatter(measurement: Measurement, model: Model, residual: np.ndarray) -> RunScatter:
    """Scatter of unbalance between runs: the τ that makes the residuals of a fitted model most likely.

    Per run r = B ξ + e, ξ ~ N(0, τ²I), e ~ N(0, σ²). With BᵀB/σ² = Q Λ Qᵀ and t = Qᵀ Bᵀr/σ² the log likelihood is
    Σ -log(1 + τ²λ)/2 + τ²t²/(1 + τ²λ)/2 over runs and components, maximised on a grid of τ² (one part in a hundred).
    A random bow is told from a random unbalance by its speed law only, so that the scatter is put down to
    unbalance, in the units in which weights are installed.

    What all runs share is no scatter: the unbalance and bow common to all are taken off first.

    **Arguments:** ``residual`` measured minus predicted [m], shape (case, probe, order). **Returns** zeros where
    the scatter cannot be inferred (`scatter_wanted`) or does not gain a log likelihood of 2.
    """
    if not scatter_wanted(measurement):
        return RunScatter()
    weight = measurement.weights(0.0)
    whitened = fault_sensitivity(model, measurement.conditions) * weight[..., None]
    errors = _less_common(whitened, numpy_pair(residual) * weight)
    slopes = whitened[..., :2]
    curvature, score = [], []
    for run in range(len(measurement.runs)):
        cases = measurement.run == run
        block, error = slopes[cases].reshape(-1, 2), errors[cases].ravel()
        values, directions = np.linalg.eigh(block.T @ block)
        curvature.append(np.maximum(values, 0.0))
        score.append(directions.T @ block.T @ error)
    lam, t = np.concatenate(curvature), np.concatenate(score)
    if not np.any(lam):
        return RunScatter()
    variance = np.logspace(-3.0, 12.0, 3501)[:, None] / np.mean(lam)
    gain = 0.5 * np.sum(variance * t**2 / (1.0 + variance * lam) - np.log1p(variance * lam), axis=1)
    best = int(np.argmax(gain))
    if gain[best] <= LEAST_GAIN:
        return RunScatter()
    found = float(variance[best, 0])
    explained = np.sum(t**2 * found / (1.0 + found * lam) * (2.0 - found * lam / (1.0 + found * lam)))
    return RunScatter(math.sqrt(found), 0.0, float(np.clip(explained / np.sum(errors**2), 0.0, 1.0)))


def _less_common(slopes: Float[np.ndarray, "case probe order 2 4"], errors: Float[np.ndarray, "case probe order 2"]) -> Float[np.ndarray, "case probe order 2"]:
    """Errors less the one unbalance and bow that would serve all runs."""
    matrix = slopes.reshape(-1, 4)
    norm = np.linalg.norm(matrix, axis=0)
    matrix = matrix / np.where(norm > 0.0, norm, 1.0)
    return errors - (matrix @ np.linalg.lstsq(matrix, errors.ravel(), rcond=1e-8)[0]).reshape(errors.shape)


def whitened_residual(measurement: Measurement, model: Model, residual: Complex[np.ndarray, "case probe order"]) -> Float[np.ndarray, "cell"]:
    """Residual in standard errors with unit covariance: the declared errors of installed weights and bows are undone per run.

    **Arguments:** ``residual`` [m]; ``model``: where the sensitivity to those is taken. The noise must be known.
    """
    weight = measurement.weights(0.0)
    errors = numpy_pair(residual) * weight
    factor = scatter_factor(measurement, model)
    if not np.any(factor):
        return errors[weight > 0.0]
    slopes = fault_sensitivity(model, measurement.conditions) * weight[..., None]
    parts = []
    for run in range(len(measurement.runs)):
        cases = measurement.run == run
        counted = weight[cases].ravel() > 0.0
        block = (slopes[cases].reshape(-1, 4) @ factor[run])[counted]
        parts.append(np.linalg.solve(np.linalg.cholesky(np.eye(len(block)) + block @ block.T), errors[cases].ravel()[counted]))
    return np.concatenate(parts)


def reduced_chi2(measurement: Measurement, model: Model, residual: Complex[np.ndarray, "case probe order"], *, fitted: int = 0) -> float | None:
    """Squared residual in squared standard errors per degree of freedom; none where the noise is unknown or nothing is left over."""
    if measurement.sigma is None:
        return None
    errors = whitened_residual(measurement, model, residual)
    freedom = len(errors) - fitted
    return float(errors @ errors) / freedom if freedom > 0 else None
