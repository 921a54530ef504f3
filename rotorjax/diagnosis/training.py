"""Training the fault network: Bayesian regularisation as published, our default, and Optax with L2 for comparison."""

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
from jaxtyping import Float

from rotorjax.arrays import AnyArray, require_float64
from rotorjax.diagnosis.dataset import Dataset
from rotorjax.diagnosis.evidence_steps import Epoch, Progress, Scaled, Steps, evidence_steps, rms_of
from rotorjax.diagnosis.network import FaultNetwork, Perceptron, Range


class Training(NamedTuple):
    """A trained network, how it got there, and why it stopped."""

    network: FaultNetwork
    history: tuple[Epoch, ...]
    stopped: str


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
        return evidence_steps(start, data, Steps(self.epochs, self.damping, self.most_damping), progress)


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
        found, history, stopped = evidence_steps(
            dataclasses.replace(start, weight_out=start.weight_out / unit[:, None], bias_out=start.bias_out / unit),
            white._replace(target=white.target / unit[None]),
            Steps(self.epochs, 1e-3, 1e10, scaled_damping=True, target=self.target, patience=self.patience),
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
            rms = rms_of(weights, data)
            history.append(Epoch(rms, math.nan, self.decay, 1.0, math.nan))
            progress(block + count, rms)
            if not math.isfinite(float(loss)):
                return (
                    weights,
                    history,
                    f"not finite after {block + count} steps: a smaller weight range or another start may help",
                )
        return weights, history, f"all {self.steps} steps were made"


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


def rms_errors(network: Callable[[AnyArray], np.ndarray], data: Dataset) -> Float[np.ndarray, "target"]:
    """Root mean square error of each fault component [kg m, kg m, m, m]."""
    return np.sqrt(np.mean((network(data.features) - np.asarray(data.faults)) ** 2, axis=0))
