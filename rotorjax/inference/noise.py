"""How large a residual the measurement allows: standard errors, the model's tolerance, scatter between runs."""

import dataclasses
import itertools
import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float
from scipy.linalg import solve_triangular
from scipy.optimize import minimize

from rotorjax.arrays import numpy_pair
from rotorjax.data.measurement import Measurement, cluster_speeds, is_half_order
from rotorjax.inference.covariance import (
    NO_NOISE,
    NO_SCATTER,
    Noise,
    OfRuns,
    RunScatter,
    anything_random,
    common_errors,
)
from rotorjax.inference.faults import fault_sensitivity
from rotorjax.model.model import Model

FEW_RUNS = 4
"""Fewer runs say nothing useful about the scatter between runs."""
LARGEST_HEALTHY_CHI2 = 1.5
"""Reduced chi-square up to which the noise of the table is taken to account for what is left."""
BY_CHANCE = 2.0
"""Standard deviations of chi-square that it may be above its mean by chance, where few data make that more."""
NOISE_FLOOR = 1e-6
"""Least inferred standard error, relative to the measured rms: below it, rounding of the table decides."""
LEAST_NOISE = 1e-12
"""Least standard error ever assumed, 1e-6 µm: what a table cannot resolve [m]."""
SAME_SPEED = 0.005
"""Relative difference up to which readings of different runs are at one speed for influence coefficients."""
LARGE = 0.1
"""Share of the measured size above which a residual of unknown noise is not put down to noise."""
SAME_MISFIT, MOST_ROUNDS = 0.02, 12
"""Relative change of a misfit below which it stands, and most alternations between a fit and the misfit that it leaves.
"""
LEAST_GAIN = 2.0
"""Log likelihood that scatter between runs must gain to be believed."""


def scatter_wanted(measurement: Measurement) -> bool:
    """Whether scatter between runs can be inferred: from enough runs, with known noise, neither switched off nor
    declared by the user.
    """
    known = measurement.knowledge
    return (
        len(measurement.runs) >= known.scatter_from_runs
        and known.run_scatter == "auto"
        and measurement.sigma is not None
        and not anything_random(known, NO_SCATTER)
    )


def run_floor(measurement: Measurement, model: Model, residual: Complex[np.ndarray, "case probe order"]) -> Noise:
    """Scatter between runs, told from every effect that acts alike in all of them.

    At each speed, probe and order the residual is fitted by influence coefficients: a constant, and one complex number
    per balancing plane and for the bow, times what was installed. Any linear rotor lies in what these span. What is
    left is a random unbalance and bow per run, ξ ~ N(0, diag(τ_U², τ_U², τ_s², τ_s²)), and noise N(0, σ² + a²): τ_U,
    τ_s and a maximise the restricted likelihood (Patterson, Thompson 1971, Biometrika 58:545-554), by the simplex of
    Nelder and Mead (1965); each is believed only where it gains a log likelihood of 2, unbalance before bow.

    Where nothing scatters without one of the runs, that one is other than stated, and no scatter is inferred.

    **Arguments:** ``residual`` measured minus predicted by some ``model`` [m], which takes out most of what depends on
    small differences in speed. **Returns** no noise where nothing can be inferred (`scatter_wanted`).
    """
    if not scatter_wanted(measurement):
        return NO_NOISE
    slopes = fault_sensitivity(model, measurement.conditions)
    found = _beyond_influence(measurement, slopes, residual).noise()
    return NO_NOISE if found.scatter != NO_SCATTER and _is_of_one_run(measurement, slopes, residual) else found


def _is_of_one_run(
    measurement: Measurement, slopes: Float[np.ndarray, "case probe order 2 4"], residual: np.ndarray
) -> bool:
    """Whether nothing scatters in all runs but one: then that one is other than stated."""
    for run in range(len(measurement.runs)):
        others = measurement.present & (measurement.run != run)[:, None, None]
        rows = _beyond_influence(dataclasses.replace(measurement, present=others), slopes, residual)
        if len(rows.error) and rows.noise().scatter == NO_SCATTER:
            return True
    return False


class _Rows(NamedTuple):
    """Residuals that influence coefficients leave, and how the random unbalance and bow of every run enter them."""

    error: Float[np.ndarray, "cell"]
    slopes: Float[np.ndarray, "cell latent"]
    """Latents run by run: U_x, U_y, s_x, s_y."""
    variance: Float[np.ndarray, "cell"]

    def noise(self) -> Noise:
        """The most likely noise beside that of the table, as far as it is believed."""
        if not np.any(self.error):
            return NO_NOISE
        best = self.most_likely(())
        for which in ((0,), (1,), (0, 1)):
            more = self.most_likely(which)
            if more[0] > best[0] + LEAST_GAIN:
                best = more
        misfit = best[1] if best[0] > self.value(0.0, best[2]) + LEAST_GAIN else 0.0
        return Noise(misfit, RunScatter(*(float(d) for d in best[2])))

    def value(self, allowance: float, deviation: Float[np.ndarray, "2"]) -> float:
        """Restricted log likelihood."""
        inverse = 1.0 / (self.variance + allowance**2)
        total = 0.5 * float(np.sum(np.log(inverse))) - 0.5 * float(inverse @ self.error**2)
        if not np.any(deviation):
            return total
        each = np.tile(np.repeat(deviation, 2), self.slopes.shape[1] // 4)
        latent = self.slopes[:, each > 0.0] * each[each > 0.0]
        factor = np.linalg.cholesky(np.eye(latent.shape[1]) + latent.T @ (inverse[:, None] * latent))
        score = solve_triangular(factor, latent.T @ (inverse * self.error), lower=True)
        return total + 0.5 * float(score @ score) - float(np.sum(np.log(np.diag(factor))))

    def most_likely(self, which: tuple[int, ...]) -> tuple[float, float, Float[np.ndarray, "2"]]:
        """Log likelihood, misfit and deviations at the maximum, with only these deviations free."""
        misfit = math.sqrt(float(np.mean(self.error**2)))
        slope = np.sqrt(np.sum(self.slopes**2, axis=0).reshape(-1, 2, 2).mean(axis=(0, 2)) / len(self.error))
        size = misfit / np.maximum(slope, 1e-300) / math.sqrt(self.slopes.shape[1] / 4)

        def unpack(logs: np.ndarray) -> tuple[float, np.ndarray]:
            deviation = np.zeros(2)
            deviation[list(which)] = size[list(which)] * np.exp(np.clip(logs[1:], -20.0, 10.0))
            return misfit * math.exp(min(max(logs[0], -20.0), 5.0)), deviation

        if any(slope[k] == 0.0 for k in which):
            return -math.inf, 0.0, np.zeros(2)
        options = {"xatol": 0.01, "fatol": 0.01, "maxiter": 400}
        found = minimize(
            lambda logs: -self.value(*unpack(logs)),
            np.full(1 + len(which), -1.0),
            method="Nelder-Mead",
            options=options,
        )
        return -float(found.fun), *unpack(found.x)


def _beyond_influence(
    measurement: Measurement, slopes: Float[np.ndarray, "case probe order 2 4"], residual: np.ndarray
) -> _Rows:
    """Residuals projected, at every speed, probe and order, on what influence coefficients cannot reach."""
    weight = measurement.weights(0.0)
    errors, enters, variances = [], [], []
    for (cases, probe, order), columns in _influence_blocks(measurement):
        if is_half_order(measurement.orders[order]) or measurement.orders[order] == 0.0:
            continue
        left, size, _ = np.linalg.svd(columns)
        beyond = left[:, int(np.sum(size > 1e-9 * size[0])) :].conj().T
        if not len(beyond) or len(np.unique(measurement.run[cases])) < len(cases):
            # A run read twice at nearly one speed: near a resonance the speeds' difference would pass for scatter.
            continue
        complex_slopes = slopes[cases, probe, order, 0] + 1j * slopes[cases, probe, order, 1]
        spread = np.zeros((len(cases), len(measurement.runs), 4), complex)
        spread[np.arange(len(cases)), measurement.run[cases]] = complex_slopes
        errors.append(numpy_pair(beyond @ residual[cases, probe, order]).ravel())
        enters.append(
            np.moveaxis(numpy_pair(np.einsum("ic,crl->irl", beyond, spread)), -1, 1).reshape(2 * len(beyond), -1)
        )
        variances.append(np.full(2 * len(beyond), np.mean(1.0 / weight[cases, probe, order, 0] ** 2)))
    if not errors:
        return _Rows(np.zeros(0), np.zeros((0, 4)), np.zeros(0))
    return _Rows(np.concatenate(errors), np.concatenate(enters), np.concatenate(variances))


def _influence_blocks(
    measurement: Measurement,
) -> Iterator[tuple[tuple[np.ndarray, int, int], Complex[np.ndarray, "case column"]]]:
    """Cases of one speed, with probe and order, and the columns of their influence coefficients."""
    cluster, speeds = cluster_speeds(measurement.speed_rpm, width=SAME_SPEED)
    unbalance = np.asarray(measurement.conditions.unbalance) @ np.array([1.0, 1j])
    bow = np.asarray(measurement.conditions.bow) @ np.array([1.0, 1j])
    installed = np.column_stack([unbalance, bow])
    installed = installed / np.maximum(np.abs(installed).max(axis=0), 1e-300)
    for speed, (probe, order) in itertools.product(range(len(speeds)), np.ndindex(measurement.vectors.shape[1:])):
        cases = np.flatnonzero((cluster == speed) & measurement.present[:, probe, order])
        if len(cases):
            once = [installed[cases]] if measurement.orders[order] == 1.0 else []
            yield (cases, probe, order), np.column_stack([np.ones(len(cases)), *once])


def independent_numbers(measurement: Measurement) -> int:
    """Real numbers in which a linear model that acts alike in all runs can be wrong: those of its influence
    coefficients.

    Where a model misses, the miss repeats itself in run after run: more runs are then no more evidence.
    """
    parts = {order: 1 if n == 0.0 else 2 for order, n in enumerate(measurement.orders)}
    return sum(
        parts[order] * int(np.linalg.matrix_rank(columns, tol=1e-9))
        for (_, _, order), columns in _influence_blocks(measurement)
    )


def scatter_share(
    measurement: Measurement, model: Model, residual: Complex[np.ndarray, "case probe order"], scatter: RunScatter
) -> float:
    """Share of the squared residual that a scatter between runs accounts for."""
    plain, undone = (whitened_residual(measurement, model, residual, Noise(0.0, s)) for s in (NO_SCATTER, scatter))
    total = float(plain @ plain)
    return 1.0 - float(undone @ undone) / total if total > 0.0 else 0.0


def whitened_residual(
    measurement: Measurement, model: Model, residual: Complex[np.ndarray, "case probe order"], noise: Noise = NO_NOISE
) -> Float[np.ndarray, "cell"]:
    """Residual in standard errors with unit covariance: what the errors of several vectors have in common is undone.

    **Arguments:** ``residual`` [m]; ``model``: where the sensitivity to those is taken; ``noise``: what to add to the
    table's, which must be known.
    """
    return _whitened(measurement, residual, noise.allowance, common_errors(measurement, model, noise))


def _whitened(
    measurement: Measurement,
    residual: Complex[np.ndarray, "case probe order"],
    allowance: float,
    common: Float[np.ndarray, "case cell common"],
) -> Float[np.ndarray, "number"]:
    weight = measurement.weights(allowance)
    errors, counted = numpy_pair(residual) * weight, weight.ravel() > 0.0
    common = common.reshape(len(counted), -1)[counted]
    if not common.shape[1]:
        return errors.ravel()[counted]
    factor = np.linalg.cholesky(np.eye(len(common)) + common @ common.T)
    return solve_triangular(factor, errors.ravel()[counted], lower=True)


def reduced_chi2(
    measurement: Measurement,
    model: Model,
    residual: Complex[np.ndarray, "case probe order"],
    *,
    fitted: int = 0,
    noise: Noise = NO_NOISE,
) -> float | None:
    """Squared residual in squared standard errors per degree of freedom; none where the noise is unknown or nothing is
    left over.
    """
    if measurement.sigma is None:
        return None
    errors = whitened_residual(measurement, model, residual, noise)
    freedom = len(errors) - fitted
    return float(errors @ errors) / freedom if freedom > 0 else None


def is_large(misfit: float, measurement: Measurement) -> bool:
    """Whether a misfit is too large to be the noise, where that is unknown. **Arguments:** ``misfit``: standard error
    of real and of imaginary part [m].
    """
    return math.sqrt(2.0) * misfit > LARGE * measurement.rms


def misfit_of(
    measurement: Measurement, model: Model, residual: Complex[np.ndarray, "case probe order"], fitted: int, floor: Noise
) -> float:
    """Isotropic standard error that accounts for what is left [m]: at least that of ``floor``, which is enough if the
    residual is healthy under it.

    **Arguments:** ``fitted``: number of parameters fitted; ``floor``: noise beside the table's, whose scatter between
    runs is taken off.
    """
    if measurement.sigma is None:
        counted = np.repeat(measurement.certain[..., None], 2, axis=-1)
        counted[:, :, np.array(measurement.orders) == 0.0, 1] = False
        total = float(np.sum(numpy_pair(residual)[counted] ** 2)) / max(1, int(counted.sum()) - fitted)
        return max(math.sqrt(total), NOISE_FLOOR * measurement.rms, LEAST_NOISE)
    allowance, of_runs = floor.allowance, OfRuns.of(measurement, model, floor.scatter)
    for _ in range(MOST_ROUNDS):
        common = of_runs.with_form(allowance)
        errors = _whitened(measurement, residual, allowance, common)
        freedom = max(1, len(errors) - fitted)
        chi2 = float(errors @ errors) / freedom
        healthy = max(LARGEST_HEALTHY_CHI2, 1.0 + BY_CHANCE * math.sqrt(2.0 / freedom))
        if allowance == floor.allowance and chi2 <= healthy:
            break
        weight = measurement.weights(allowance)
        variance = 1.0 / float(np.mean(weight[weight > 0.0] ** 2))
        allowance = math.sqrt(max(allowance**2 + variance * (chi2 - 1.0), floor.allowance**2))
        if not common.shape[-1]:
            break
    return allowance
