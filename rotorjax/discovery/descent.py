"""Descents of one least-squares cost from many starts and on many folds, compiled once per shape."""

import dataclasses
import itertools
import math
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Complex, Float, Int

from rotorjax._core import COARSE, FINE, FIRST_DAMPING, MAX_STEPS, AnyArray, Descent, Quadratic, Tolerance, levenberg_marquardt, numpy_pair, real_pair
from rotorjax.discovery.noise import Noise, scatter_factor
from rotorjax.inverse import fault_sensitivity
from rotorjax.measurement import Measurement, is_half_order
from rotorjax.model import Conditions, Layout, Model
from rotorjax.response import vectors
from rotorjax.space import Space

MAX_STARTS = 32
MAX_FOLDS, LEAST_RUN_FOLDS = 5, 4
BATCH = 6
"""Descents run together: more make the fast ones wait for the slowest, fewer waste the vector units."""
LEG, LEGS = 12, 5
"""Steps that a batch makes together, and how many times those not at their end yet go on, in fuller batches."""
HOPELESS = 300.0
"""Cost above the best of a call on the same cases with which a descent does not go on for more than two legs."""
KEPT_RIVALS = (3, 2, 1)
"""Starts of the same fit that go on after the first leg, the second, and all later ones."""
LEAST_CASES, LEAST_RUNS, LEAST_UNKNOWNS, LEAST_POINTS = 16, 4, 4, 4
"""Smallest sizes that are compiled: see `size_class`."""


class Manner(NamedTuple):
    """How exactly descents are made, and how many together."""

    tolerance: Tolerance
    batch: int
    width: int = 0
    """Least number of free unknowns to make room for, so that small fits run in what is compiled for larger ones."""


THOROUGH, QUICK = Manner(FINE, BATCH), Manner(COARSE, 4 * BATCH)
"""For estimates; and for ranking many hypotheses."""


class Data(NamedTuple):
    """A measurement as the compiled code wants it."""

    conditions: Conditions
    pairs: Float[AnyArray, "case probe order 2"]
    weight: Float[AnyArray, "case probe order 2"]
    half_order: Bool[AnyArray, "order"]
    run: Int[AnyArray, "case"]
    scatter: Float[AnyArray, "case probe order 2 latent"]
    """Whitened sensitivity to the random unbalance and bow of the case's run; zero if there is none."""
    run_count: int


def make_data(measurement: Measurement, model: Model, noise: Noise) -> Data:
    """A measurement in units of its noise.

    **Arguments:** ``model``: where the sensitivity to what is random in a run is taken; ``noise``: what to
    add to the table's.
    """
    weight = measurement.weights(noise.allowance)
    factor = scatter_factor(measurement, model, noise.scatter)
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
    for label, count, least in ((measurement.run, len(measurement.runs), LEAST_RUN_FOLDS), (cluster, len(speeds), 3)):
        if count >= least:
            fold = label % min(MAX_FOLDS, count)
            folds = np.stack([fold == k for k in range(min(MAX_FOLDS, count))])
            if all(_rank(np.sum(information[~left_out], axis=0)) == whole for left_out in folds):
                return folds, ""
    runs = "1 run" if len(measurement.runs) == 1 else f"{len(measurement.runs)} runs"
    at = "1 speed" if len(speeds) == 1 else f"{len(speeds)} speeds"
    reason = f"{runs} at {at} leave no part of the data out of which the rest could be predicted: take four runs or three speeds that each show all"
    return np.zeros((0, len(measurement.run)), bool), reason


def _rank(information: Float[np.ndarray, "param param"]) -> int:
    """Number of directions that the data determine better than a hundredth of the prior."""
    return int(np.count_nonzero(np.linalg.eigvalsh(information) > 1e-2)) if len(information) else 0


def residual(space: Space, data: Data, unknowns: Array) -> Float[Array, "case probe order 2"]:
    """(z_model - z) / σ; a half order is compared up to the sign that a once-per-turn reference leaves open."""
    model = real_pair(vectors(space.at(unknowns), data.conditions))
    return jnp.asarray(data.weight) * (model - half_order_sign(model, data.pairs, data.weight, data.half_order) * data.pairs)


def half_order_sign(model: AnyArray, measured: AnyArray, weight: AnyArray, half_order: AnyArray) -> Float[Array, "case 1 order 1"]:
    """The sign, one per case, that brings a measured half order nearer to the model; one for whole orders."""
    along = jnp.sum(weight**2 * model * measured, axis=(1, 3), keepdims=True)
    return jnp.where(half_order[None, None, :, None] & (along < 0.0), -1.0, 1.0)


class Local(NamedTuple):
    """Residual in standard errors and its slopes by the free unknowns, in their order."""

    error: Float[np.ndarray, "*case cell"]
    slopes: Float[np.ndarray, "*case cell param"]


class End(NamedTuple):
    """Where one descent ended."""

    point: Float[np.ndarray, "param"]
    cost: float
    free: Int[np.ndarray, "free"]
    """The unknowns that were free."""
    curvature: Float[np.ndarray, "free free"]
    """Hessian of the cost by those."""
    local: Local
    """On all cases, whichever were trained on."""
    steps: int
    result: int

    @property
    def hessian(self) -> Float[np.ndarray, "param param"]:
        """Hessian by all unknowns; those that were not free have their prior's."""
        full = np.eye(len(self.point))
        full[np.ix_(self.free, self.free)] = self.curvature
        return full


class _Task(NamedTuple):
    """What sets one descent apart from the others of its batch."""

    kept: Float[AnyArray, "*start param"]
    """Values of the unknowns that are not free."""
    chosen: Float[AnyArray, "*start param free"]
    """One 1 per column; a column of zeros fills up to the size that is compiled."""
    training: Float[AnyArray, "*start case"]
    shift: Float[AnyArray, "*start case cell"]
    """Added to the residual: another draw of the noise."""
    absorbed: Float[AnyArray, "*start case cell latent"]
    """G with C⁻¹ = I - G Gᵀ per run, C the covariance that the run's random unbalance and bow cause."""


def _quadratic(space: Space, data: Data, task: _Task) -> Callable[[Array], Quadratic]:
    """Cost of the free unknowns, with the random unbalance and bow of each run integrated out (covariance σ²I + B Bᵀ per run)."""
    kept, chosen, training = task.kept, task.chosen, task.training
    member = (data.run[:, None] == jnp.arange(data.run_count)[None]).astype(float)

    def per_case(array: Array) -> Array:
        return array.reshape(array.shape[0], math.prod(array.shape[1:4]), *array.shape[4:])

    def evaluate(unknowns: Array) -> Quadratic:
        slopes, error = jax.jacfwd(lambda u: (residual(space, data, kept + chosen @ u),) * 2, has_aux=True)(unknowns)
        local = per_case(error) + task.shift, per_case(slopes)
        error, slopes = local[0] * training[:, None], local[1] * training[:, None, None]
        cost = 0.5 * jnp.sum(error**2)
        gradient = jnp.einsum("cm,cmp->p", error, slopes)
        hessian = jnp.einsum("cmp,cmq->pq", slopes, slopes)
        if task.absorbed.shape[-1]:
            # Cᵀ⁻¹ = I - G Gᵀ per run; a one-hot product sums over a run's cases faster than a scatter does.
            score = jnp.einsum("cr,cml,cm->rl", member, task.absorbed, error)
            cross = jnp.einsum("cr,clp->rlp", member, jnp.einsum("cml,cmp->clp", task.absorbed, slopes))
            cost -= 0.5 * jnp.sum(score**2)
            gradient -= jnp.einsum("rlp,rl->p", cross, score)
            hessian -= jnp.einsum("rlp,rlq->pq", cross, cross)
        return Quadratic(cost + 0.5 * unknowns @ unknowns, gradient + unknowns, hessian + jnp.eye(len(unknowns)), local)

    return evaluate


@eqx.filter_jit
def _descents(space: Space, data: Data, starts: AnyArray, damping: AnyArray, tasks: _Task, tolerance: Tolerance) -> Descent:
    def one(start: AnyArray, first: AnyArray, task: _Task) -> Descent:
        return levenberg_marquardt(_quadratic(space, data, task), jnp.asarray(start), damping=jnp.asarray(first), max_steps=LEG, tolerance=tolerance)

    return jax.vmap(one)(starts, damping, tasks)


def descend(
    space: Space,
    data: Data,
    starts: Float[np.ndarray, "start param"],
    free: Bool[np.ndarray, "*start param"],
    training: Bool[np.ndarray, "start case"],
    *,
    kept: Float[np.ndarray, "param"] | None = None,
    shift: Float[np.ndarray, "start case cell"] | None = None,
    manner: Manner = THOROUGH,
) -> list[End]:
    """Levenberg-Marquardt from every start, each on its own cases and with its own free unknowns.

    Cases, runs and free unknowns are filled up to a few sizes and names are left out, so that it compiles once for all
    measurements of one size; ``manner``: how exactly, and how many together. Unknowns that are not free stay at ``kept``, by default
    where the model has them. ``shift`` is added to the residual of each. **Returns** one `End` per start.
    """
    free = np.broadcast_to(free, starts.shape)
    fixed = np.where(free, 0.0, space.given_unknowns() if kept is None else kept)
    columns = [np.flatnonzero(mask) for mask in free]
    width = size_class(max((manner.width, *(len(c) for c in columns))), LEAST_UNKNOWNS)
    chosen = np.zeros((*starts.shape, width))
    for k, column in enumerate(columns):
        chosen[k, column, np.arange(len(column))] = 1.0
    cases = len(data.run)
    nameless, filled = _nameless(space), _filled(data)
    counted, moved = np.zeros((len(starts), len(filled.run))), np.zeros((len(starts), len(filled.run), math.prod(data.weight.shape[1:])))
    counted[:, :cases] = training
    if shift is not None:
        moved[:, :cases] = shift
    tasks = _Task(fixed, chosen, counted, moved, _absorbed(filled, counted))
    point, damping, steps = np.einsum("spf,sp->sf", chosen, starts), np.full(len(starts), FIRST_DAMPING), np.zeros(len(starts), int)
    trained = np.unique(np.asarray(training, bool), axis=0, return_inverse=True)[1].ravel()
    rivals = np.unique(np.column_stack([free, trained]), axis=0, return_inverse=True)[1].ravel() if shift is None else np.arange(len(starts))
    ends: list[End | None] = [None] * len(starts)
    waiting = np.arange(len(starts))
    limits, batch = Tolerance(*(np.asarray(limit) for limit in manner.tolerance)), manner.batch
    for leg in range(LEGS):
        for first in range(0, len(waiting), batch):
            # The last batch is filled up with copies of its last member: they end together with it.
            index = waiting[np.minimum(np.arange(first, first + batch), len(waiting) - 1)]
            found = jax.tree.map(np.asarray, _descents(nameless, filled, point[index], damping[index], _Task(*(part[index] for part in tasks)), limits))
            for k, task in enumerate(index[: len(waiting) - first]):
                point[task], damping[task], steps[task] = found.point[k], found.damping[k], steps[task] + found.steps[k]
                ends[task] = _end(found, k, fixed[task], columns[task], cases, int(steps[task]))
        waiting = _going_on([end for end in ends if end is not None], rivals, trained, leg)
    return [end for end in ends if end is not None]


def _absorbed(data: Data, training: Float[np.ndarray, "start case"]) -> Float[np.ndarray, "start case cell latent"]:
    """B (I + BᵀB)^(-1/2) per run, B the scatter on the cases trained on: C⁻¹ = (I + BBᵀ)⁻¹ is the unit matrix less its square."""
    scatter = np.asarray(data.scatter)
    flat = scatter.reshape(len(scatter), math.prod(scatter.shape[1:4]), scatter.shape[-1])
    if not flat.size:
        return np.zeros((len(training), *flat.shape))
    absorbed = np.empty((len(training), *flat.shape))
    member = (np.asarray(data.run)[:, None] == np.arange(data.run_count)).astype(float)
    for cases in np.unique(training, axis=0):
        block = flat * cases[:, None, None]
        inner = np.eye(flat.shape[-1]) + np.einsum("cr,cml,cmk->rlk", member, block, block, optimize=True)
        values, directions = np.linalg.eigh(inner)
        root = (directions / np.sqrt(values)[:, None, :]) @ np.swapaxes(directions, 1, 2)
        absorbed[(training == cases).all(axis=1)] = block @ root[np.asarray(data.run)]
    return absorbed


def _going_on(ends: list[End], rivals: Int[np.ndarray, "start"], trained: Int[np.ndarray, "start"], leg: int) -> np.ndarray:
    """Descents worth another leg: not at their end, not hopeless, and among the best of those for the same unknowns."""
    cost = np.array([end.cost for end in ends])
    waiting = np.array([end.result == MAX_STEPS for end in ends])
    for task in np.unique(trained) if leg > 0 else ():
        own = trained == task
        waiting[own] &= cost[own] < cost[own].min() + HOPELESS
    for rival in np.unique(rivals[waiting]):
        own = np.flatnonzero(rivals == rival)
        ranked = own[np.argsort(cost[own], kind="stable")]
        waiting[ranked[KEPT_RIVALS[min(leg, len(KEPT_RIVALS) - 1)] :]] = False
    return np.flatnonzero(waiting)


def _end(found: Descent, k: int, fixed: np.ndarray, column: np.ndarray, cases: int, steps: int) -> End:
    """One member of a batch, without what it was filled up with."""
    size, quadratic = len(column), found.quadratic
    point = fixed.copy()
    point[column] = found.point[k, :size]
    error, slopes = quadratic.extra
    cost = float(quadratic.cost[k]) if np.isfinite(quadratic.cost[k]) else math.inf
    local = Local(np.asarray(error[k, :cases]), np.asarray(slopes[k, :cases, :, :size]))
    return End(point, cost, column, np.asarray(quadratic.hessian[k, :size, :size]), local, steps, int(found.result[k]))


@eqx.filter_jit
def _predictions(space: Space, conditions: Conditions, points: AnyArray) -> Complex[Array, "start case probe order"]:
    return jax.vmap(lambda point: vectors(space.at(point), conditions))(points)


def predict(space: Space, conditions: Conditions, points: Float[np.ndarray, "start param"]) -> Complex[np.ndarray, "start case probe order"]:
    """What the model shows at each of some points [m]; compiled once for all conditions and points of one size."""
    cases, count = len(np.asarray(conditions.speed)), len(points)
    more = size_class(cases, LEAST_CASES) - cases
    filled = jax.tree.map(lambda values: np.concatenate([np.asarray(values), np.repeat(np.asarray(values)[-1:], more, axis=0)]), conditions)
    padded = np.concatenate([points, np.repeat(points[-1:], size_class(count, LEAST_POINTS) - count, axis=0)])
    return np.asarray(_predictions(_nameless(space), filled, padded))[:count, :cases]


def size_class(count: int, least: int) -> int:
    """The next of ``least`` times 1, 2, 3, 4, 6, 8, 12, 16, ..."""
    size = least
    while size < count:
        half = size + size // 2
        if size > least and count <= half:
            return half
        size *= 2
    return size


def _nameless(space: Space) -> Space:
    """The space without names and prior scales as text: the compiled code must not depend on them."""
    layout = space.model.layout
    blank = Layout(tuple(map(str, range(len(layout.probes)))), tuple(map(str, range(len(layout.planes)))), layout.orders)
    return dataclasses.replace(space, model=dataclasses.replace(space.model, layout=blank), entries=())


def _filled(data: Data) -> Data:
    """Cases filled up with copies of the last that weigh nothing, to one of a few sizes."""
    cases = len(data.run)
    more = size_class(cases, LEAST_CASES) - cases

    def repeat(values: AnyArray) -> np.ndarray:
        array = np.asarray(values)
        return np.concatenate([array, np.repeat(array[-1:], more, axis=0)])

    def nothing(values: AnyArray) -> np.ndarray:
        array = np.asarray(values)
        return np.concatenate([array, np.zeros((more, *array.shape[1:]))])

    return Data(
        jax.tree.map(repeat, data.conditions), repeat(data.pairs), nothing(data.weight), data.half_order, repeat(data.run), nothing(data.scatter),
        size_class(data.run_count, LEAST_RUNS),
    )  # fmt: skip


def residual_vectors(error: Float[np.ndarray, "case cell"], data: Data) -> Complex[np.ndarray, "case probe order"]:
    """Model minus measured [m] from the residual in standard errors, zero where nothing was measured."""
    weight = np.asarray(data.weight)
    pairs = np.divide(error.reshape(weight.shape), weight, out=np.zeros(weight.shape), where=weight > 0.0)
    return pairs[..., 0] + 1j * pairs[..., 1]


def best_of(ends: list[End]) -> End:
    """The descent that ended lowest."""
    return min(ends, key=lambda end: end.cost)
