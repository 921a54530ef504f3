"""Levenberg-Marquardt steps whose weight decay is set by the evidence: the steps of Bayesian regularisation.

Bayesian regularisation (MacKay 1992, Neural Comput. 4:448-472; Foresee, Hagan 1997, Proc. ICNN 3:1930-1935) minimises
F = β E_D + α E_W, E_D the sum of squared errors over all targets, E_W that of all weights, by Levenberg-Marquardt, and
sets α = γ / 2E_W, β = (N - γ) / 2E_D after each step. γ = Σ βλ / (βλ + α), λ the eigenvalues of JᵀJ, is the number of
weights that the data determine. JᵀJ is built from shared Gram matrices and never from J.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.flatten_util import ravel_pytree
from jaxtyping import Float
from threadpoolctl import threadpool_limits

from rotorjax.diagnosis.network import Perceptron

Progress = Callable[[int, float], None]
"""Called with the epoch and the root mean square error in scaled targets."""
LEAST_DAMPING = 1e-20


class Epoch(NamedTuple):
    """One accepted step."""

    rms: float
    """Root mean square error in scaled targets, on the cases trained on; `Whitened` weighs each target by its own
    error.
    """
    effective: float
    """γ, the number of weights that the data determine."""
    alpha: float
    """Weight of the sum of squared weights."""
    beta: float
    """Weight of the sum of squared errors."""
    damping: float
    """μ with which the next step begins."""


class Scaled(NamedTuple):
    """Training cases as the optimisers see them."""

    x: Float[Array, "sample feature"]
    target: Float[Array, "sample target"]


class Steps(NamedTuple):
    """How to make evidence steps."""

    epochs: int
    damping: float
    most_damping: float
    scaled_damping: bool = False
    """Damping in units of β: else it means less and less as β grows."""
    target: float = 0.0
    patience: int | None = None


class _Normal(NamedTuple):
    """JᵀJ, Jᵀe and the sum of squared errors, e = y - t, at some weights."""

    gram: Float[Array, "param param"]
    gradient: Float[Array, "param"]
    squares: Float[Array, ""]


@jax.jit
def normal_equations(
    p: Perceptron, x: Float[Array, "sample feature"], target: Float[Array, "sample target"]
) -> _Normal:
    """JᵀJ and Jᵀe over all samples and targets, weights in the order of `ravel_pytree`; e = y - target, in scaled
    units.

    With d = 1 - a², D = d ⊗ [x, 1] and H = [a, 1]: the blocks are G_DD ∘ W₂ᵀW₂, W₂ ∘ G_DH and I ⊗ G_HH, G = [D H]ᵀ[D
    H]; G_DD from the products of two inputs, which are symmetric, costs half of the full product.
    """
    hidden, features = p.weight_in.shape
    targets = p.weight_out.shape[0]
    a = jnp.tanh(x @ p.weight_in.T + p.bias_in[None])
    error = a @ p.weight_out.T + p.bias_out[None] - target
    d = 1.0 - a * a
    ones = jnp.ones((len(x), 1))
    inputs, outer = jnp.concatenate([x, ones], axis=1), jnp.concatenate([a, ones], axis=1)
    k, m = np.triu_indices(features + 1)
    pair = np.zeros((features + 1, features + 1), int)
    pair[k, m] = pair[m, k] = np.arange(len(k))
    products = ((inputs[:, k] * inputs[:, m])[:, :, None] * d[:, None, :]).reshape(len(x), -1)
    between = (products.T @ d).reshape(len(k), hidden, hidden) * (p.weight_out.T @ p.weight_out)[None]
    cross = ((d[:, :, None] * inputs[:, None, :]).reshape(len(x), -1).T @ outer).reshape(
        hidden, features + 1, hidden + 1
    )
    first = jnp.transpose(between[pair], (2, 0, 3, 1)).reshape(hidden * (features + 1), -1)
    mixed = jnp.einsum("oj,jkh->jkoh", p.weight_out, cross).reshape(len(first), -1)
    last = jnp.kron(jnp.eye(targets), outer.T @ outer)
    gram = jnp.block([[first, mixed], [mixed.T, last]])
    gradient = jnp.concatenate([(((error @ p.weight_out) * d).T @ inputs).ravel(), (error.T @ outer).ravel()])
    order = _flat_order(hidden, features, targets)
    return _Normal(gram[order][:, order], gradient[order], jnp.sum(error**2))


def _flat_order(hidden: int, features: int, targets: int) -> np.ndarray:
    """From each layer's rows with their bias at the end to the order of `ravel_pytree`."""
    inner = np.arange(hidden * (features + 1)).reshape(hidden, features + 1)
    outer = inner.size + np.arange(targets * (hidden + 1)).reshape(targets, hidden + 1)
    return np.concatenate([inner[:, :-1].ravel(), inner[:, -1], outer[:, :-1].ravel(), outer[:, -1]])


@jax.jit
def _squares(p: Perceptron, x: Array, target: Array) -> Array:
    return jnp.sum((jax.vmap(p)(x) - target) ** 2)


def rms_of(p: Perceptron, data: Scaled) -> float:
    """Root mean square error in scaled targets."""
    return math.sqrt(float(_squares(p, data.x, data.target)) / data.target.size)


# Threads of the linear algebra library and those of XLA, which take turns in every epoch, would wait for one another.
@threadpool_limits.wrap(limits=1, user_api="blas")
def evidence_steps(
    start: Perceptron, data: Scaled, steps: Steps, progress: Progress
) -> tuple[Perceptron, list[Epoch], str]:
    """Levenberg-Marquardt on F = β E_D + α E_W with α and β set anew after every accepted step.

    **Returns** the weights, the history, and why it stopped.
    """
    flat, unravel = ravel_pytree(start)
    weights = np.asarray(flat)
    count, numbers = len(weights), data.target.size
    at = _at(start, data)
    decay = float(weights @ weights)
    beta, alpha = _evidence(float(count), numbers, at.squares, decay)
    damping, history = steps.damping, []
    for epoch in range(steps.epochs):
        if (rms := math.sqrt(at.squares / numbers)) <= steps.target:
            return (
                unravel(jnp.asarray(weights)),
                history,
                f"the error reached its target of {steps.target:g} after {epoch} steps",
            )
        if (
            steps.patience is not None
            and len(history) > steps.patience
            and rms > 0.99 * history[-1 - steps.patience].rms
        ):
            return unravel(jnp.asarray(weights)), history, f"no progress in the last {steps.patience} of {epoch} steps"
        slope = at.axes.T @ (beta * at.gradient + alpha * weights)
        while True:
            shift = damping * (beta if steps.scaled_damping else 1.0)
            trial = weights - at.axes @ (slope / (beta * at.values + alpha + shift))
            squares = float(_squares(unravel(jnp.asarray(trial)), data.x, data.target))
            if beta * squares + alpha * float(trial @ trial) < beta * at.squares + alpha * decay:
                break
            damping *= 10.0
            if damping > steps.most_damping:
                return unravel(jnp.asarray(weights)), history, f"no step lowers the cost any more after {epoch} steps"
        damping = max(0.1 * damping, LEAST_DAMPING)
        weights, decay = trial, float(trial @ trial)
        at = _at(unravel(jnp.asarray(weights)), data)
        gamma = float(np.sum(beta * at.values / (beta * at.values + alpha)))
        beta, alpha = _evidence(gamma, numbers, at.squares, decay)
        history.append(Epoch(math.sqrt(at.squares / numbers), gamma, alpha, beta, damping))
        progress(epoch + 1, history[-1].rms)
    return unravel(jnp.asarray(weights)), history, f"all {steps.epochs} steps were made"


class _At(NamedTuple):
    """The normal equations at some weights, along the eigenvectors of JᵀJ: one decomposition serves every damping, and
    γ.
    """

    values: Float[np.ndarray, "param"]
    """Eigenvalues, those below zero by rounding clipped."""
    axes: Float[np.ndarray, "param param"]
    gradient: Float[np.ndarray, "param"]
    squares: float


def _at(p: Perceptron, data: Scaled) -> _At:
    normal = normal_equations(p, data.x, data.target)
    values, axes = np.linalg.eigh(np.asarray(normal.gram))
    return _At(np.maximum(values, 0.0), axes, np.asarray(normal.gradient), float(normal.squares))


def _evidence(gamma: float, numbers: int, squares: float, decay: float) -> tuple[float, float]:
    """β = (N - γ) / 2E_D and α = γ / 2E_W, kept finite where an error or all weights vanish."""
    return (numbers - gamma) / (2.0 * max(squares, 1e-300)), gamma / (2.0 * max(decay, 1e-300))
