"""Half the squares of residuals as a function of the parameters to first order, what scatters between runs integrated
out.
"""

import numpy as np
from jaxtyping import Bool, Float

from rotorjax.inference.data import Data


class Squares:
    """Cost ½ |C^(-1/2) e|², C = 1 + B Bᵀ in each run, of a residual e(θ) = e + J dθ in standard errors; its gradient Jᵀ
    C⁻¹ e and Hessian Jᵀ C⁻¹ J.

    B: what random unbalance and bow of a run, in units of their scatter, do to its vectors. Cases that do not count
    have none of the three.
    """

    def __init__(
        self,
        data: Data,
        error: Float[np.ndarray, "case cell"],
        slopes: Float[np.ndarray, "case cell free"],
        scatter: Float[np.ndarray, "case cell latent"],
    ) -> None:
        self._error, self._slopes = error, slopes
        self.cost = 0.5 * float(np.sum(error**2))
        flat = slopes.reshape(error.size, slopes.shape[-1])
        self.gradient = flat.T @ error.ravel()
        self.hessian = flat.T @ flat
        self._scatter, self._run = None, data.run
        if scatter.shape[-1]:
            latents = scatter.shape[-1]
            products = np.swapaxes(scatter, 1, 2) @ np.concatenate([scatter, error[..., None], slopes], axis=-1)
            member = (data.run[:, None] == np.arange(data.run_count)).astype(float)
            by_run = (member.T @ products.reshape(len(member), -1)).reshape(data.run_count, *products.shape[1:])
            inner, both = np.eye(latents) + by_run[..., :latents], by_run[..., latents:]
            self._scatter, self._inner, self._score, self._cross = scatter, inner, both[..., 0], both[..., 1:]
            solved = np.linalg.solve(inner, both)
            taken_off = both.reshape(-1, both.shape[-1]).T @ solved.reshape(-1, both.shape[-1])
            self.cost -= 0.5 * float(taken_off[0, 0])
            self.gradient = self.gradient - taken_off[1:, 0]
            self.hessian = self.hessian - taken_off[1:, 1:]

    def left(self, step: Float[np.ndarray, "free"]) -> Float[np.ndarray, "case cell"]:
        """The residual after a step, less the most probable scatter."""
        left = self._error + self._slopes @ step
        if self._scatter is None:
            return left
        random = np.linalg.solve(self._inner, (self._score + self._cross @ step)[..., None])[..., 0]
        return left - np.einsum("cml,cl->cm", self._scatter, random[self._run])


def squares_of(
    data: Data,
    error: Float[np.ndarray, "case cell"],
    slopes: Float[np.ndarray, "case cell free"],
    training: Bool[np.ndarray, "case"],
) -> Squares:
    """Of the cases that count."""
    counted = training[:, None]
    return Squares(data, error * counted, slopes * counted[..., None], data.scatter * counted[..., None])
