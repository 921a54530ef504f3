"""Fitted parameters with their standard errors: those of the posterior, or of the scatter between runs if larger."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from rotorjax.inference.curvature import inverse
from rotorjax.inference.data import Data
from rotorjax.inference.descent import End, Local
from rotorjax.inference.noise import FEW_RUNS
from rotorjax.inference.space import Entry, Space
from rotorjax.inference.squares import squares_of

NORMAL_QUANTILE = 1.96
"""Standard errors in half a 95 % interval of the normal distribution."""
UNDETERMINED = 0.8
"""Posterior over prior standard deviation above which the data are said not to determine a parameter."""
PULLED = 3.0
"""A declared uncertain value that moves by more than this many of its standard deviations is a finding."""


class Estimate(NamedTuple):
    """A fitted parameter, in SI."""

    entry: Entry
    value: float
    standard_error: float
    determined: bool
    """False where the data leave the prior almost as wide as it was: the interval is the prior's."""
    pull: float
    """Distance from the null in prior standard deviations."""

    @property
    def finding(self) -> bool:
        """A declared uncertain value that had to move too far."""
        return self.entry.declared_uncertain and abs(self.pull) > PULLED


def independent_parts(best: End, data: Data) -> list[Local]:
    """Parts of the residual that are independent of one another: runs, or single cases where there are too few runs to
    judge what they share. What the errors of several vectors have in common is taken off the residual.
    """
    error, slopes = best.local
    every, cells = np.ones(len(error), bool), error.shape[1]
    left = squares_of(data, error, slopes, every).left(np.zeros(slopes.shape[-1]))
    label = np.arange(len(error)) if len(np.unique(data.run)) < FEW_RUNS else data.run
    parts = [np.flatnonzero(label == part) for part in np.unique(label)]
    return [Local(left[part].ravel(), slopes[part].reshape(len(part) * cells, slopes.shape[-1])) for part in parts]


def robust_covariance(best: End, clusters: list[Local]) -> Float[np.ndarray, "param param"]:
    """Posterior covariance of the unknowns, its standard errors raised to the cluster-robust ones over independent
    parts (Liang, Zeger 1986, Biometrika 73:13-22).
    """
    posterior = inverse(best.curvature)
    if len(clusters) > 1 and len(posterior):
        scores = np.stack([slope.T @ error for error, slope in clusters])
        small_sample = len(clusters) / (len(clusters) - 1.0)
        robust = posterior @ (small_sample * scores.T @ scores + np.diag(best.prior.weight)) @ posterior
        growth = np.sqrt(np.maximum(1.0, np.diag(robust) / np.diag(posterior)))
        posterior = posterior * growth[:, None] * growth[None, :]
    covariance = np.eye(len(best.point))
    covariance[np.ix_(best.free, best.free)] = posterior
    return covariance


def estimates_of(
    space: Space, best: End, covariance: Float[np.ndarray, "param param"], free: Bool[np.ndarray, "param"]
) -> tuple[Estimate, ...]:
    """Every parameter that was free, in SI, with its standard error."""
    values = space.values(best.point)
    posterior, width = np.sqrt(np.diag(inverse(best.hessian))), best.prior_width
    estimates = []
    for entry, value in zip(space.entries, values, strict=True):
        if not free[entry.unknown]:
            continue
        slope = entry.scale * (1.0 + value if entry.logarithmic else 1.0)
        deviation = min(float(width[entry.unknown]), float(np.sqrt(covariance[entry.unknown, entry.unknown])))
        determined = bool(posterior[entry.unknown] < UNDETERMINED * width[entry.unknown])
        estimates.append(
            Estimate(entry, float(value), float(slope * deviation), determined, float(best.point[entry.unknown]))
        )
    return tuple(estimates)
