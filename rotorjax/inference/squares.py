"""Half the squares of residuals as a function of the parameters to first order, what the errors of several vectors have
in common integrated out.
"""

import numpy as np
from jaxtyping import Bool, Float
from scipy.linalg import solve_triangular

from rotorjax.inference.data import Data


class Squares:
    """Cost ½ |C^(-1/2) e|², C = 1 + B Bᵀ, of a residual e(θ) = e + J dθ in standard errors; its gradient Jᵀ C⁻¹ e and
    Hessian Jᵀ C⁻¹ J.

    B: what one unit of every common error does (`rotorjax.inference.covariance`). Cases that do not count have none of
    the three.
    """

    def __init__(
        self,
        error: Float[np.ndarray, "case cell"],
        slopes: Float[np.ndarray, "case cell free"],
        common: Float[np.ndarray, "case cell common"],
    ) -> None:
        self._error, self._slopes = error, slopes
        flat, left = slopes.reshape(error.size, slopes.shape[-1]), error.ravel()
        self.cost = 0.5 * float(left @ left)
        self.gradient, self.hessian = flat.T @ left, flat.T @ flat
        self._common = None
        if common.shape[-1]:
            columns = common.reshape(error.size, common.shape[-1])
            factor = np.linalg.cholesky(np.eye(columns.shape[1]) + columns.T @ columns)
            self._common = solve_triangular(factor, columns.T, lower=True)
            taken, slope = self._common @ left, self._common @ flat
            self.cost -= 0.5 * float(taken @ taken)
            self.gradient = self.gradient - slope.T @ taken
            self.hessian = self.hessian - slope.T @ slope

    def left(self, step: Float[np.ndarray, "free"]) -> Float[np.ndarray, "case cell"]:
        """The residual after a step, less the most probable common errors: C⁻¹ (e + J dθ)."""
        left = self._error + self._slopes @ step
        if self._common is None:
            return left
        return left - (self._common.T @ (self._common @ left.ravel())).reshape(left.shape)


def squares_of(
    data: Data,
    error: Float[np.ndarray, "case cell"],
    slopes: Float[np.ndarray, "case cell free"],
    training: Bool[np.ndarray, "case"],
) -> Squares:
    """Of the cases that count."""
    counted = training[:, None]
    return Squares(error * counted, slopes * counted[..., None], data.common * counted[..., None])
