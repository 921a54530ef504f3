"""Balancing by influence coefficients, without a model of the rotor: what weights in the planes change is measured, and
weighted least squares give the weights that still the rotor (Goodman 1964, J. Eng. Ind. 86:273-279).
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float

from rotorjax.data.measurement import Measurement
from rotorjax.diagnosis.fault import Fault
from rotorjax.diagnosis.least_squares import beyond_noise


class InfluenceBalance(NamedTuple):
    """What influence coefficients say. A cell is one probe at one speed."""

    influence: Complex[np.ndarray, "cell plane"]
    """Change of the vibration vector per weight, in the unit of the vectors per unit of weight."""
    initial: Complex[np.ndarray, "cell"]
    """Vectors without any weight."""
    unbalance: tuple[Fault, ...]
    """By plane that is corrected in: opposite the weights that all together leave the least, Σ |left/σ|². It stands for
    everything that shows at 1X, a bow and a runout among it.
    """
    left: Complex[np.ndarray, "cell"]
    """Vectors predicted with these weights."""
    reduced_chi2: float | None
    """Of the runs beyond those needed: near one where the vectors are linear in the weights. None where there are none
    or the noise is not known.
    """
    linear: bool | None
    """Whether that chi-square is within the noise; none where there is none."""


def influence_balance(
    vectors: Complex[np.ndarray, "run cell"],
    weights: Complex[np.ndarray, "run plane"],
    sigma: Float[np.ndarray, "run cell"] | None = None,
    *,
    using: tuple[int, ...] | None = None,
) -> InfluenceBalance:
    """Influence coefficients from runs with different weights, and the unbalance that they show.

    z = z₀ + H w by least squares over the runs, cell by cell; then u = -w, w the minimum of Σ |(z₀ + H w)/σ|². Its
    covariance, to first order, is that of z₀ + H w through the same least squares.

    **Arguments:** ``vectors``; ``weights`` as complex numbers m e^{iα}, α counting as phases lead; ``sigma``: standard
    error of real and of imaginary part, in the unit of the vectors; without it runs beyond those needed give it, and
    without those no covariance is known; ``using``: planes that are corrected in, by default all.
    **Errors.** ``ValueError`` where the runs do not determine every plane.
    """
    design = np.column_stack([np.ones(len(weights)), weights])
    runs, unknowns = design.shape
    if np.linalg.matrix_rank(design, tol=1e-9 * np.abs(design).max()) < unknowns:
        raise ValueError(f"{runs} runs do not determine {unknowns - 1} planes: every plane needs a run of its own")
    spread = np.ones(vectors.shape) if sigma is None else sigma
    scaled = design / spread.T[:, :, None]
    squares = np.linalg.inv(np.conj(np.swapaxes(scaled, 1, 2)) @ scaled)
    answer = (squares @ np.conj(np.swapaxes(scaled, 1, 2)) @ (vectors / spread).T[:, :, None])[:, :, 0]
    initial, influence = answer[:, 0], answer[:, 1:]
    freedom = 2 * vectors.shape[1] * (runs - unknowns)
    chi2 = float(np.sum(np.abs((vectors - design @ answer.T) / spread) ** 2)) / freedom if freedom else None
    root = 1.0 / np.sqrt(np.mean(spread**2, axis=0))
    chosen = list(range(weights.shape[1]) if using is None else using)
    inverse = np.linalg.pinv(root[:, None] * influence[:, chosen]) * root
    found = -inverse @ initial
    along = np.zeros(unknowns, complex)
    along[[0, *(1 + k for k in chosen)]] = [1.0, *found]
    variance = np.abs(inverse) ** 2 @ np.real(np.einsum("i,kij,j->k", along, squares, np.conj(along)))
    scale = chi2 if sigma is None else max(1.0, chi2 or 1.0)
    unbalance = tuple(
        Fault(
            -np.array([w.real, w.imag]),
            None if scale is None else scale * v * np.eye(2),
            math.inf if sigma is not None else freedom,
        )
        for w, v in zip(found, variance, strict=True)
    )
    known = None if sigma is None else chi2
    linear = None if known is None else not beyond_noise(known, freedom)
    return InfluenceBalance(influence, initial, unbalance, initial + influence @ along[1:], known, linear)


def weighted_planes(measurement: Measurement) -> tuple[int, ...]:
    """Planes in which the weight was not the same in all runs."""
    installed = _installed(measurement)
    return tuple(int(k) for k in np.flatnonzero(np.ptp(np.abs(installed - installed[:1]), axis=0) > 0.0))


def measured_influence(measurement: Measurement, *, using: tuple[int, ...] | None = None) -> InfluenceBalance | None:
    """The same from the 1X vectors of a measurement, at the speeds that all its runs share, for `weighted_planes`; none
    where its runs do not determine them. Vectors in m, weights in kg m. **Arguments:** ``using``: of these planes those
    that are corrected in, counted among them.
    """
    planes, bow = weighted_planes(measurement), np.asarray(measurement.conditions.bow)
    cells = _common_cells(measurement)
    if not planes or cells is None or np.ptp(bow, axis=0).any() or cells[0].shape[1] < len(planes):
        return None
    vectors, sigma = cells
    weights = _installed(measurement)[:, list(planes)]
    design = np.column_stack([np.full(len(weights), np.abs(weights).max()), weights])
    if np.linalg.matrix_rank(design, tol=1e-6 * np.abs(design).max()) < len(planes) + 1:
        return None
    return influence_balance(vectors, weights, None if measurement.sigma is None else sigma, using=using)


def _installed(measurement: Measurement) -> Complex[np.ndarray, "run plane"]:
    first = [int(np.argmax(measurement.run == run)) for run in range(len(measurement.runs))]
    pair = np.asarray(measurement.conditions.unbalance)[first]
    return pair[..., 0] + 1j * pair[..., 1]


def _common_cells(
    measurement: Measurement,
) -> tuple[Complex[np.ndarray, "run cell"], Float[np.ndarray, "run cell"]] | None:
    """Vectors and standard errors of probes at speeds that were measured in every run, repeats averaged; none if none
    were.
    """
    if 1.0 not in measurement.orders:
        return None
    first, (cluster, speeds) = measurement.orders.index(1.0), measurement.speed_cluster()
    shape = len(measurement.runs), len(speeds), len(measurement.probes)
    total, variance, count = np.zeros(shape, complex), np.zeros(shape), np.zeros(shape)
    error = np.ones(measurement.vectors.shape) if measurement.sigma is None else measurement.sigma
    there = measurement.present[:, :, first]
    at = measurement.run, cluster
    np.add.at(total, at, np.where(there, measurement.vectors[:, :, first], 0.0))
    np.add.at(variance, at, np.where(there, error[:, :, first] ** 2, 0.0))
    np.add.at(count, at, there)
    shared = np.all(count > 0, axis=0)
    if not shared.any():
        return None
    return (total / np.maximum(count, 1))[:, shared], (np.sqrt(variance) / np.maximum(count, 1))[:, shared]
