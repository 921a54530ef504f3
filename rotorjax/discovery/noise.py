"""How large a residual the measurement allows: standard errors, the model's tolerance, scatter between runs."""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from rotorjax._core import GRAM_MILLIMETRE, MICROMETRE, numpy_pair
from rotorjax.inverse import fault_sensitivity
from rotorjax.measurement import Measurement
from rotorjax.model import Model

MIN_RUNS_FOR_SCATTER = 4
"""Fewer runs say nothing useful about the scatter between runs."""
LEAST_GAIN = 2.0
"""Log likelihood that scatter between runs must gain to be believed."""


class RunScatter(NamedTuple):
    """Standard deviation per component of a random unbalance and a random bow in every run, of zero mean."""

    unbalance_kg_m: float = 0.0
    bow_m: float = 0.0
    share: float = 0.0
    """Share of the squared residual that it accounts for."""

    def as_json(self) -> dict[str, float]:
        """In engineering units."""
        return {"unbalance_g_mm": self.unbalance_kg_m / GRAM_MILLIMETRE, "bow_um": self.bow_m / MICROMETRE}


def scatter_factor(measurement: Measurement, model: Model) -> Float[np.ndarray, "run dof latent"]:
    """Factor L of the covariance L Lᵀ of the random (U_x, U_y, s_x, s_y) of each run [kg m, m].

    What the user declared of the installed weights and bows: relative size along, angle across, each plane on its own.
    """
    known = measurement.knowledge
    unbalance, bow = np.asarray(measurement.conditions.unbalance), np.asarray(measurement.conditions.bow)
    participation = np.asarray(model.participation)
    factors = np.zeros((len(measurement.runs), 4, 4))
    for run in range(len(measurement.runs)):
        case = int(np.argmax(measurement.run == run))
        covariance = np.zeros((4, 4))
        for pair in unbalance[case] * participation[:, None]:
            covariance[:2, :2] += _polar_covariance(pair, known.installed_unbalance, known.installed_angle_rad)
        covariance[2:, 2:] += _polar_covariance(bow[case], known.installed_bow, known.installed_angle_rad)
        values, directions = np.linalg.eigh(covariance)
        factors[run] = directions * np.sqrt(np.maximum(values, 0.0))
    return factors


def _polar_covariance(pair: np.ndarray, relative: float, angle: float) -> np.ndarray:
    across = np.array([-pair[1], pair[0]])
    return relative**2 * np.outer(pair, pair) + angle**2 * np.outer(across, across)


def scatter_wanted(measurement: Measurement) -> bool:
    """Whether scatter between runs can be inferred: four runs, known noise, not switched off by the user."""
    enough = len(measurement.runs) >= MIN_RUNS_FOR_SCATTER and measurement.knowledge.run_scatter == "auto"
    return enough and measurement.sigma is not None


def infer_run_scatter(measurement: Measurement, model: Model, residual: np.ndarray) -> RunScatter:
    """Scatter of unbalance between runs: the τ that makes the residuals of a fitted model most likely.

    Per run r = B ξ + e, ξ ~ N(0, τ²I), e ~ N(0, σ²). With BᵀB/σ² = Q Λ Qᵀ and t = Qᵀ Bᵀr/σ² the log likelihood is
    Σ -log(1 + τ²λ)/2 + τ²t²/(1 + τ²λ)/2 over runs and components, maximised on a grid of τ² (one part in a hundred).
    A random bow is told from a random unbalance by its speed law only, so that the scatter is put down to
    unbalance, in the units in which weights are installed.

    **Arguments:** ``residual`` measured minus predicted [m], shape (case, probe, order). **Returns** zeros where
    the scatter cannot be inferred (`scatter_wanted`) or does not gain a log likelihood of 2.
    """
    if not scatter_wanted(measurement):
        return RunScatter()
    weight = measurement.weights(0.0)
    slopes = fault_sensitivity(model, measurement.conditions)[..., :2] * weight[..., None]
    errors = numpy_pair(residual) * weight
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
