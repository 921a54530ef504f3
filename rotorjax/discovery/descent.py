"""Descents of one least-squares cost from many starts and on many folds, compiled once per shape."""

import itertools
import math
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float, Int

from rotorjax._core import Descent, Quadratic, levenberg_marquardt, numpy_pair, real_pair
from rotorjax.discovery.noise import scatter_factor
from rotorjax.inverse import fault_sensitivity
from rotorjax.measurement import Measurement, is_half_order
from rotorjax.model import Conditions, Model
from rotorjax.response import vectors
from rotorjax.space import Space

MAX_STARTS = 32
MAX_FOLDS = 5
BATCH = 6
"""Descents run together: more make the fast ones wait for the slowest, fewer waste the vector units."""


class Data(NamedTuple):
    """A measurement as the compiled code wants it."""

    conditions: Conditions
    pairs: Float[Array, "case probe order 2"]
    weight: Float[Array, "case probe order 2"]
    half_order: Bool[Array, "order"]
    run: Int[Array, "case"]
    scatter: Float[Array, "case probe order 2 latent"]
    """Whitened sensitivity to the random unbalance and bow of the case's run; zero if there is none."""
    run_count: int


def make_data(measurement: Measurement, model: Model, allowance: float) -> Data:
    """A measurement in units of its noise.

    **Arguments:** ``model``: where the sensitivity to what is random in a run is taken; ``allowance``: standard error
    to add to that of the table [m].
    """
    weight = measurement.weights(allowance)
    factor = scatter_factor(measurement, model)
    if np.any(factor):
        slopes = fault_sensitivity(model, measurement.conditions)
        scatter = weight[..., None] * np.einsum("cpokd,cdl->cpokl", slopes, factor[measurement.run])
    else:
        scatter = np.zeros((*weight.shape, 0))
    return Data(
        measurement.conditions,
        jnp.asarray(numpy_pair(measurement.vectors)),
        jnp.asarray(weight),
        jnp.asarray(np.array([is_half_order(order) for order in measurement.orders])),
        jnp.asarray(measurement.run),
        jnp.asarray(scatter),
        len(measurement.runs),
    )


def declared_starts(space: Space, free: Bool[np.ndarray, "param"]) -> Float[np.ndarray, "start param"]:
    """Where to begin: the null, the values given, every start that a free effect declares, then combinations, at most `MAX_STARTS`."""
    names = {e.effect for e in space.entries if free[e.unknown]}
    options = []
    for effect in space.model.effects:
        if effect.name in names:
            index = {e.label.split(".")[0]: e.unknown for e in space.entries if e.effect == effect.name}
            options.append([{index[name]: value for name, value in start.items()} for start in type(effect).starts])
    first = [chosen[0] for chosen in options]
    singly = [[*first[:k], other, *first[k + 1 :]] for k, chosen in enumerate(options) for other in chosen[1:]]
    starts = [np.where(free, space.given_unknowns(), 0.0)]
    for combination in itertools.chain([first], singly, itertools.product(*options)):
        start = np.zeros(len(space.entries))
        for unknown, value in ((u, v) for chosen in combination for u, v in chosen.items()):
            start[unknown] = value
        if not any(np.array_equal(start, other) for other in starts):
            starts.append(start)
        if len(starts) == MAX_STARTS:
            break
    return np.stack(starts)


def make_folds(measurement: Measurement, information: Float[np.ndarray, "case param param"]) -> tuple[Bool[np.ndarray, "fold case"], str]:
    """Cases to leave out together: whole runs if there are enough of them, else groups of speeds.

    A split is honest only if every training fold determines all that the whole data determine: leaving out the one run
    with a weight in a plane would condemn what only that run shows. **Arguments:** ``information``: of every case on
    the free unknowns. **Returns** one mask per fold, none with the reason where no honest split exists.
    """
    cluster, speeds = measurement.speed_cluster()
    whole = _rank(np.sum(information, axis=0))
    for label, count, least in ((measurement.run, len(measurement.runs), MAX_FOLDS), (cluster, len(speeds), 3)):
        if count >= least:
            fold = label % min(MAX_FOLDS, count)
            folds = np.stack([fold == k for k in range(min(MAX_FOLDS, count))])
            if all(_rank(np.sum(information[~left_out], axis=0)) == whole for left_out in folds):
                return folds, ""
    runs = "1 run" if len(measurement.runs) == 1 else f"{len(measurement.runs)} runs"
    at = "1 speed" if len(speeds) == 1 else f"{len(speeds)} speeds"
    reason = f"{runs} at {at} leave no part of the data out of which the rest could be predicted: take five runs or three speeds that each show all"
    return np.zeros((0, len(measurement.run)), bool), reason


def _rank(information: Float[np.ndarray, "param param"]) -> int:
    """Number of directions that the data determine better than a hundredth of the prior."""
    return int(np.count_nonzero(np.linalg.eigvalsh(information) > 1e-2)) if len(information) else 0


def residual(space: Space, data: Data, unknowns: Array) -> Float[Array, "case probe order 2"]:
    """(z_model - z) / σ; a half order is compared up to the sign that a once-per-turn reference leaves open."""
    model = real_pair(vectors(space.at(unknowns), data.conditions))
    return data.weight * (model - half_order_sign(model, data.pairs, data.weight, data.half_order) * data.pairs)


def half_order_sign(model: Array, measured: Array, weight: Array, half_order: Array) -> Float[Array, "case 1 order 1"]:
    """The sign, one per case, that brings a measured half order nearer to the model; one for whole orders."""
    along = jnp.sum(weight**2 * model * measured, axis=(1, 3), keepdims=True)
    return jnp.where(half_order[None, None, :, None] & (along < 0.0), -1.0, 1.0)


class Local(NamedTuple):
    """Residual in standard errors and its slopes by every unknown, free or not."""

    error: Float[np.ndarray, "*case cell"]
    slopes: Float[np.ndarray, "*case cell param"]


class End(NamedTuple):
    """Where one descent ended."""

    point: Float[np.ndarray, "param"]
    cost: float
    hessian: Float[np.ndarray, "param param"]
    local: Local
    """On all cases, whichever were trained on."""
    steps: int
    result: int


def _quadratic(space: Space, data: Data, free: Array, training: Array) -> Callable[[Array], Quadratic]:
    """Cost with the random unbalance and bow of each run integrated out (covariance σ²I + B Bᵀ per run)."""

    def per_run(values: Array) -> Array:
        return jax.ops.segment_sum(values, data.run, data.run_count)

    def per_case(array: Array) -> Array:
        return array.reshape(array.shape[0], math.prod(array.shape[1:4]), *array.shape[4:])

    def evaluate(unknowns: Array) -> Quadratic:
        slopes, error = jax.jacfwd(lambda u: (residual(space, data, u),) * 2, has_aux=True)(unknowns)
        local = per_case(error), per_case(slopes)
        error, slopes = local[0] * training[:, None], local[1] * training[:, None, None] * free[None, None, :]
        cost = 0.5 * jnp.sum(error**2)
        gradient = jnp.einsum("cm,cmp->p", error, slopes)
        hessian = jnp.einsum("cmp,cmq->pq", slopes, slopes)
        if data.scatter.shape[-1]:
            random = per_case(data.scatter) * training[:, None, None]
            inner = jnp.eye(random.shape[-1])[None] + per_run(jnp.einsum("cml,cmk->clk", random, random))
            score = per_run(jnp.einsum("cml,cm->cl", random, error))
            cross = per_run(jnp.einsum("cml,cmp->clp", random, slopes))
            solved = jnp.linalg.solve(inner, jnp.concatenate([score[..., None], cross], axis=-1))
            cost -= 0.5 * jnp.sum(score * solved[..., 0])
            gradient -= jnp.einsum("rlp,rl->p", cross, solved[..., 0])
            hessian -= jnp.einsum("rlp,rlq->pq", cross, solved[..., 1:])
        prior = jnp.where(free, unknowns, 0.0)
        return Quadratic(cost + 0.5 * prior @ prior, gradient + prior, hessian + jnp.eye(len(free)), local)

    return evaluate


@eqx.filter_jit
def _descents(space: Space, data: Data, starts: Array, free: Array, training: Array) -> Descent:
    def one(start: Array, cases: Array) -> Descent:
        return levenberg_marquardt(_quadratic(space, data, free, cases), start)

    return jax.vmap(one)(starts, training)


def descend(
    space: Space,
    data: Data,
    starts: Float[np.ndarray, "start param"],
    free: Bool[np.ndarray, "param"],
    training: Bool[np.ndarray, "start case"],
    *,
    kept: Float[np.ndarray, "param"] | None = None,
) -> list[End]:
    """Levenberg-Marquardt from every start, each on its own cases; batches of `BATCH`, so that it compiles once.

    Unknowns that are not free stay at ``kept``, by default where the model has them. **Returns** one `End` per start.
    """
    begin = np.where(free, starts, space.given_unknowns() if kept is None else kept)
    ends = []
    for first in range(0, len(starts), BATCH):
        # The last batch is filled up with copies of its last member: they end together with it.
        index = np.minimum(np.arange(first, first + BATCH), len(starts) - 1)
        found = _descents(space, data, jnp.asarray(begin[index]), jnp.asarray(free), jnp.asarray(training[index], dtype=float))
        point, quadratic, steps, result = jax.tree.map(np.asarray, found)
        error, slopes = quadratic.extra
        for k in range(min(BATCH, len(starts) - first)):
            cost = float(quadratic.cost[k]) if np.isfinite(quadratic.cost[k]) else math.inf
            ends.append(End(point[k], cost, quadratic.hessian[k], Local(error[k], slopes[k]), int(steps[k]), int(result[k])))
    return ends


def best_of(ends: list[End]) -> End:
    """The descent that ended lowest."""
    return min(ends, key=lambda end: end.cost)
