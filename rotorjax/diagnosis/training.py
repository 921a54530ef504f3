"""Training the fault network: Bayesian regularisation as published, our default, and Optax with L2 for comparison.

Bayesian regularisation (MacKay 1992, Neural Comput. 4:448-472; Foresee, Hagan 1997, Proc. ICNN 3:1930-1935) minimises
F = β E_D + α E_W, E_D the sum of squared errors over all targets, E_W that of all weights, by Levenberg-Marquardt, and
sets α = γ / 2E_W, β = (N - γ) / 2E_D after each step. γ = Σ βλ / (βλ + α), λ the eigenvalues of JᵀJ, is the number of
weights that the data determine. JᵀJ is built from shared Gram matrices and never from J.
"""

import dataclasses
import math
from collections.abc import Callable
from typing import NamedTuple, Protocol, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax import Array
from jax.flatten_util import ravel_pytree
from jaxtyping import Float
from threadpoolctl import threadpool_limits

from rotorjax.arrays import AnyArray, require_float64
from rotorjax.diagnosis.dataset import Dataset
from rotorjax.diagnosis.network import FaultNetwork, Perceptron, Range

Progress = Callable[[int, float], None]
"""Called with the epoch and the root mean square error in scaled targets."""


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


class Training(NamedTuple):
    """A trained network, how it got there, and why it stopped."""

    network: FaultNetwork
    history: tuple[Epoch, ...]
    stopped: str


class Scaled(NamedTuple):
    """Training cases as the optimisers see them."""

    x: Float[Array, "sample feature"]
    target: Float[Array, "sample target"]


@runtime_checkable
class Method(Protocol):
    """A way to train: from scaled cases to weights."""

    def fit(self, data: Scaled, hidden: int, key: Array, progress: Progress) -> tuple[Perceptron, list[Epoch], str]:
        """Weights, history, and why it stopped."""
        ...


def train(
    data: Dataset,
    *,
    key: Array,
    method: Method | None = None,
    hidden: int = 40,
    progress: Progress = lambda epoch, rms: None,
) -> Training:
    """Train a perceptron on features and faults, both scaled to -1 to 1.

    **Arguments:** ``data``: the cases to train on; ``key``: for the first weights; ``method``: `Whitened` (default),
    `BayesianRegularisation` as published, or `OptaxL2`. **Returns** a `Training`. **Errors.** ``ValueError`` in single
    precision, for numbers that are not finite, a constant column, or fewer cases than weights.
    """
    require_float64("training")
    if np.ndim(data.features) != 2 or np.ndim(data.faults) != 2 or len(data.features) != len(data.faults):
        shapes = f"{np.shape(data.features)} and {np.shape(data.faults)}"
        raise ValueError(
            f"features and faults have shapes {shapes}: give one row per case in both, as many in one as in the other"
        )
    inputs, outputs = Range.of(data.features, "features"), Range.of(data.faults, "faults")
    scaled = Scaled(
        jax.vmap(inputs.scaled)(jnp.asarray(data.features)), jax.vmap(outputs.scaled)(jnp.asarray(data.faults))
    )
    count = hidden * (scaled.x.shape[1] + 1) + scaled.target.shape[1] * (hidden + 1)
    if scaled.target.size <= count:
        raise ValueError(
            f"{len(scaled.x)} cases hold no more numbers than the network has weights ({count}): draw more cases, or "
            "take fewer neurons"
        )
    perceptron, history, stopped = (method or Whitened()).fit(scaled, hidden, key, progress)
    return Training(FaultNetwork(perceptron, inputs, outputs), tuple(history), stopped)


@dataclasses.dataclass(frozen=True)
class BayesianRegularisation:
    """As published, and as users of MATLAB know it: one weight decay, Nguyen-Widrow start, damping not scaled by β."""

    epochs: int = 1000
    damping: float = 0.005
    most_damping: float = 1e10

    def fit(self, data: Scaled, hidden: int, key: Array, progress: Progress) -> tuple[Perceptron, list[Epoch], str]:
        """Nguyen-Widrow weights, then evidence steps."""
        start = nguyen_widrow(key, data.x.shape[1], hidden, data.target.shape[1])
        return _evidence_steps(start, data, _Steps(self.epochs, self.damping, self.most_damping), progress)


@dataclasses.dataclass(frozen=True)
class Whitened:
    """Ours: whitened inputs, a small first layer, the output layer by linear least squares, then evidence steps.

    For maps that are linear or weakly curved, as this one; for others take `BayesianRegularisation`. Nearly linear
    neurons hold the linear part of the map, and their curvature what is odd and not linear. On noise-free data the
    least-squares start meets the target as it is, and no evidence step is made. The whitening is folded into the first
    layer: what is returned takes the same inputs as the others.
    """

    epochs: int = 100
    first_layer: float = 0.01
    """Size of the first layer's weights on whitened inputs."""
    target: float = 1e-8
    """Root mean square error in scaled targets that is good enough: below it rounding rules."""
    patience: int = 10
    """Steps over which the error must fall by a hundredth."""

    def fit(self, data: Scaled, hidden: int, key: Array, progress: Progress) -> tuple[Perceptron, list[Epoch], str]:
        """Least squares, then evidence steps on whitened inputs."""
        mean = jnp.mean(data.x, axis=0)
        values, axes = jnp.linalg.eigh(jnp.atleast_2d(jnp.cov(data.x.T)))
        if not float(values[0]) > 1e-14 * float(values[-1]):
            raise ValueError(
                "some features are linear combinations of others: the cases do not show all faults; draw them anew, "
                "or, if the axes are equally stiff, use two speeds"
            )
        whiten = axes / jnp.sqrt(values)[None]
        white = data._replace(x=(data.x - mean[None]) @ whiten)
        inner = self.first_layer * jax.random.normal(key, (hidden, data.x.shape[1])) / math.sqrt(data.x.shape[1])
        start = output_by_least_squares(
            Perceptron(
                inner, jnp.zeros(hidden), jnp.zeros((data.target.shape[1], hidden)), jnp.zeros(data.target.shape[1])
            ),
            white,
        )
        unit = _noise_units(start, white)
        found, history, stopped = _evidence_steps(
            dataclasses.replace(start, weight_out=start.weight_out / unit[:, None], bias_out=start.bias_out / unit),
            white._replace(target=white.target / unit[None]),
            _Steps(self.epochs, 1e-3, 1e10, scaled_damping=True, target=self.target, patience=self.patience),
            progress,
        )
        weight = found.weight_in @ whiten.T
        return (
            Perceptron(weight, found.bias_in - weight @ mean, found.weight_out * unit[:, None], found.bias_out * unit),
            history,
            stopped,
        )


@dataclasses.dataclass(frozen=True)
class OptaxL2:
    """L-BFGS by Optax on the mean square error plus a fixed weight decay, from Nguyen-Widrow weights."""

    steps: int = 2000
    decay: float = 1e-9

    def fit(self, data: Scaled, hidden: int, key: Array, progress: Progress) -> tuple[Perceptron, list[Epoch], str]:
        """Full-batch steps, all of them compiled in blocks of a hundred."""
        start = nguyen_widrow(key, data.x.shape[1], hidden, data.target.shape[1])
        optimiser = optax.lbfgs()
        state, weights, history = optimiser.init(start), start, []  # pyright: ignore
        for block in range(0, self.steps, _BLOCK):
            count = min(_BLOCK, self.steps - block)
            weights, state, loss = _optax_block(weights, state, data, self.decay, optimiser, count)
            rms = _rms(weights, data)
            history.append(Epoch(rms, math.nan, self.decay, 1.0, math.nan))
            progress(block + count, rms)
            if not math.isfinite(float(loss)):
                return (
                    weights,
                    history,
                    f"not finite after {block + count} steps: a smaller weight range or another start may help",
                )
        return weights, history, f"all {self.steps} steps were made"


LEAST_DAMPING = 1e-20
_BLOCK = 100
"""Steps of Optax that are compiled together."""


@eqx.filter_jit
def _optax_block(
    weights: Perceptron,
    state: optax.OptState,
    data: Scaled,
    decay: float,
    optimiser: optax.GradientTransformationExtraArgs,
    count: int,
):
    def loss(p: Perceptron) -> Array:
        return jnp.mean((jax.vmap(p)(data.x) - data.target) ** 2) + decay * sum(
            jnp.sum(leaf**2) for leaf in jax.tree.leaves(p)
        )

    value_and_grad = optax.value_and_grad_from_state(loss)

    def step(carry: tuple, _: None) -> tuple:
        p, s = carry
        value, gradient = value_and_grad(p, state=s)  # pyright: ignore
        updates, s = optimiser.update(gradient, s, p, value=value, grad=gradient, value_fn=loss)
        return (optax.apply_updates(p, updates), s), value

    (weights, state), values = jax.lax.scan(step, (weights, state), None, length=count)
    return weights, state, values[-1]


def nguyen_widrow(key: Array, features: int, hidden: int, targets: int) -> Perceptron:
    """First weights that spread the neurons' active ranges over inputs in -1 to 1 (Nguyen, Widrow 1990, Proc. IJCNN
    3:21-26).

    Rows of W₁ have random directions and length 0.7 h^(1/n); biases are spread evenly; the output layer is uniform in
    -1 to 1.
    **Arguments:** ``key``; how many ``features`` n, ``hidden`` neurons h and ``targets``. **Returns** a `Perceptron`.
    """
    directions, outer, bias = jax.random.split(key, 3)
    length = 0.7 * hidden ** (1.0 / features)
    inner = jax.random.uniform(directions, (hidden, features), minval=-1.0, maxval=1.0)
    inner = length * inner / jnp.linalg.norm(inner, axis=1, keepdims=True)
    spread = length * jnp.linspace(-1.0, 1.0, hidden) * jnp.sign(inner[:, 0])
    return Perceptron(
        inner,
        spread,
        jax.random.uniform(outer, (targets, hidden), minval=-1.0, maxval=1.0),
        jax.random.uniform(bias, (targets,), minval=-1.0, maxval=1.0),
    )


def output_by_least_squares(perceptron: Perceptron, data: Scaled) -> Perceptron:
    """The output layer that is best for this first layer: least squares by SVD of the scaled columns, never by normal
    equations.

    Each target takes as many singular directions, largest first, as its Bayesian information criterion n log RSS + k
    log n (Schwarz 1978, Ann. Stat. 6:461-464) asks for: all of them would fit noise by weights of 1e9.
    **Arguments:** ``perceptron`` whose first layer stays; ``data``, scaled. **Returns** it with another output layer.
    """
    design = np.concatenate(
        [np.tanh(np.asarray(data.x @ perceptron.weight_in.T + perceptron.bias_in[None])), np.ones((len(data.x), 1))],
        axis=1,
    )
    size = np.linalg.norm(design, axis=0)
    left, values, right = np.linalg.svd(design / size, full_matrices=False)
    left, values, right = (part[..., : np.sum(values > 1e-13 * values[0])] for part in (left, values, right.T))
    target = np.asarray(data.target)
    along = left.T @ target
    gains = np.concatenate([np.cumsum(along[::-1] ** 2, axis=0)[::-1], np.zeros((1, target.shape[1]))])
    squares = np.maximum(np.sum((target - left @ along) ** 2, axis=0) + gains, 1e-300)
    directions = np.arange(len(values) + 1)[:, None]
    rank = np.argmin(len(target) * np.log(squares) + directions * math.log(len(target)), axis=0)
    answer = right @ (np.where(directions[:-1] < rank, along, 0.0) / values[:, None]) / size[:, None]
    return dataclasses.replace(perceptron, weight_out=jnp.asarray(answer[:-1].T), bias_out=jnp.asarray(answer[-1]))


def _noise_units(perceptron: Perceptron, data: Scaled) -> Float[Array, "target"]:
    """Each target's error beside that of all: in these units one β serves targets that the data determine unequally
    well.
    """
    errors = jnp.sqrt(jnp.mean((jax.vmap(perceptron)(data.x) - data.target) ** 2, axis=0))
    whole = jnp.sqrt(jnp.mean(errors**2))
    return jnp.where(whole > 0.0, jnp.maximum(errors / whole, 1e-6), 1.0)


class _Steps(NamedTuple):
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


def _rms(p: Perceptron, data: Scaled) -> float:
    return math.sqrt(float(_squares(p, data.x, data.target)) / data.target.size)


# Threads of the linear algebra library and those of XLA, which take turns in every epoch, would wait for one another.
@threadpool_limits.wrap(limits=1, user_api="blas")
def _evidence_steps(
    start: Perceptron, data: Scaled, steps: _Steps, progress: Progress
) -> tuple[Perceptron, list[Epoch], str]:
    """Levenberg-Marquardt on F = β E_D + α E_W with α and β set anew after every accepted step."""
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


def rms_errors(network: Callable[[AnyArray], np.ndarray], data: Dataset) -> Float[np.ndarray, "target"]:
    """Root mean square error of each fault component [kg m, kg m, m, m]."""
    return np.sqrt(np.mean((network(data.features) - np.asarray(data.faults)) ** 2, axis=0))
