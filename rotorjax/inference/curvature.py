"""Curvatures of a cost, by unknowns of any sizes: what data tell of one direction may be so much more than the prior's
weight of another that rounding takes that, and leaves a singular matrix.
"""

import numpy as np
from jaxtyping import Float

ROUNDING = 1e-12
"""Part of a curvature that is rounding."""


def unit_diagonal(
    curvature: Float[np.ndarray, "*many free free"],
) -> tuple[Float[np.ndarray, "*many free free"], Float[np.ndarray, "*many free"]]:
    """A curvature in units that make its diagonal one, and these units."""
    scale = 1.0 / np.sqrt(np.diagonal(curvature, axis1=-2, axis2=-1))
    return curvature * scale[..., :, None] * scale[..., None, :], scale


def _regular(
    curvature: Float[np.ndarray, "*many free free"],
) -> tuple[Float[np.ndarray, "*many free free"], Float[np.ndarray, "*many free"]]:
    """The same, with rounding added to the diagonal."""
    scaled, scale = unit_diagonal(curvature)
    return scaled + ROUNDING * np.eye(scaled.shape[-1]), scale


def solved(
    curvature: Float[np.ndarray, "*many free free"], right: Float[np.ndarray, "*any free column"]
) -> Float[np.ndarray, "*many free column"]:
    """The inverse of a curvature times columns, up to rounding."""
    regular, scale = _regular(curvature)
    return scale[..., None] * np.linalg.solve(regular, scale[..., None] * right)


def inverse(curvature: Float[np.ndarray, "free free"]) -> Float[np.ndarray, "free free"]:
    """The covariance that a curvature stands for."""
    return solved(curvature, np.eye(len(curvature)))


def log_determinant(curvature: Float[np.ndarray, "*many free free"]) -> Float[np.ndarray, "*many"]:
    """Its logarithm, up to rounding."""
    regular, scale = _regular(curvature)
    return np.asarray(np.linalg.slogdet(regular)[1] - 2.0 * np.sum(np.log(scale), axis=-1))
