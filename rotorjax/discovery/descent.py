"""Descents of one least-squares cost from many starts and on many folds, compiled once per shape."""

import dataclasses
import math
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Complex, Float, Int

from rotorjax._core import COARSE, FINE, FIRST_DAMPING, MAX_STEPS, AnyArray, Descent, Quadratic, Tolerance, diagonal, levenberg_marquardt, real_pair
from rotorjax.discovery.data import LEAST_CASES, Data, filled, half_order_sign, size_class
from rotorjax.discovery.prior import Prior, prior_at, together
from rotorjax.harmonic import NEWTON_STEPS
from rotorjax.model import Conditions, Layout
from rotorjax.response import motions_of, searched_motions, vectors, vectors_from
from rotorjax.space import Space
from rotorjax.steady import without_timed

BATCH = 6
"""Descents run together: more make the fast ones wait for the slowest, fewer waste the vector units."""
TIMED_BATCH = 4
"""The same where orders are balanced together."""
LEG, LEGS, TIMED_LEG = 12, 5, 4
"""Steps that a batch makes together, and how many times those not at their end yet go on, in fuller batches."""
HOPELESS, TIMED_HOPELESS = 300.0, 40.0
"""Cost above the best known on the same cases with which a descent does not go on for more than two legs; where orders are balanced together."""
SURE = 2
"""Sets of unknowns that are descended to where orders are balanced together, however little their first order promises."""
MOST_SEARCHED = 2
"""Descents for which a motion is searched for where none was found near the one measured."""
LEAST_GAIN = 1.0
"""Fall of the cost below which an effect cannot be detected."""
KEPT_RIVALS = (3, 2, 1)
"""Starts of the same fit that go on after the first leg, the second, and all later ones."""
LEAST_UNKNOWNS, LEAST_TIMED_UNKNOWNS, LEAST_POINTS = 4, 6, 4
"""Smallest sizes that are compiled: see `size_class`."""


class Manner(NamedTuple):
    """How exactly descents are made, and how many together."""

    tolerance: Tolerance
    batch: int
    width: int = 0
    """Least number of free unknowns to make room for, so that small fits run in what is compiled for larger ones."""
    first_order: bool = False
    """Lay forces that depend on motion along the measured motion where no other is known, and leave it at that."""
    search: bool = False
    """Search for a motion where none is found near the one measured."""


THOROUGH, QUICK = Manner(FINE, BATCH, search=True), Manner(COARSE, 4 * BATCH)
"""For estimates; and for ranking many hypotheses."""


def _shown(space: Space, data: Data, unknowns: Array, motions: Array, newton_steps: Array) -> tuple[Float[Array, "case probe order 2"], Array]:
    """What the model shows, and the motions found; without motions to begin with every order has its closed form.

    **Arguments:** ``newton_steps``: most steps towards the motions; none: to first order from those given.
    """
    model = space.at(unknowns)
    if not len(motions):
        return real_pair(vectors(without_timed(model), data.conditions)), motions
    shown, found = vectors_from(model, data.conditions, motions, newton_steps)
    return real_pair(shown), jnp.where(newton_steps > 0, found, motions)


def residual(data: Data, shown: Float[Array, "case probe order 2"]) -> Float[Array, "case probe order 2"]:
    """(z_model - z) / σ; a half order is compared up to the sign that a once-per-turn reference leaves open."""
    # What was not measured need not exist.
    there = jnp.where(data.weight > 0.0, shown, 0.0)
    return jnp.asarray(data.weight) * (there - half_order_sign(there, data.pairs, data.weight, data.half_order) * data.pairs)


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
    """Hessian of the cost by those; of large sizes that are left open, the prior's weight in the place of its second derivative."""
    prior: Prior
    """The prior there, of the unknowns that were free."""
    local: Local
    """On all cases, whichever were trained on."""
    shown: Complex[np.ndarray, "case probe order"]
    """What the model shows there [m]."""
    motions: Float[np.ndarray, "near speed dof coefficient"]
    """The motions found, where orders depend on one another; else of no case."""
    steps: int
    result: int
    exact: bool
    """False where forces that depend on motion were only laid along the measured motion."""

    @property
    def data_cost(self) -> float:
        """The cost without the prior's: values many prior scales large may still be right."""
        return self.cost - float(self.prior.cost)

    @property
    def hessian(self) -> Float[np.ndarray, "param param"]:
        """Hessian by all unknowns; those that were not free have their prior's."""
        full = np.eye(len(self.point))
        full[np.ix_(self.free, self.free)] = self.curvature
        return full

    @property
    def prior_width(self) -> Float[np.ndarray, "param"]:
        """How wide the prior is there, of all unknowns: one but for large sizes that are left open."""
        full = np.ones(len(self.point))
        full[self.free] = 1.0 / np.sqrt(np.asarray(self.prior.weight))
        return full


class Start(NamedTuple):
    """Where a descent begins; the motions there where orders depend on one another and they are known."""

    point: Float[np.ndarray, "param"]
    motions: Float[np.ndarray, "near speed dof coefficient"] | None = None
    beat: float = math.inf
    """Cost without the forces that depend on motion: what to first order does not fall below it is not worth a descent."""
    least: float = math.inf
    """Least cost known of other fits to the same cases."""

    @classmethod
    def at(cls, end: End) -> "Start":
        """Where another descent ended."""
        return cls(end.point, end.motions if len(end.motions) and end.exact else None)


def starts_at(points: Float[np.ndarray, "start param"]) -> list[Start]:
    """Starts of which nothing else is known."""
    return [Start(point) for point in points]


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
    motions: Float[AnyArray, "*start near speed dof coefficient"]
    """Of every case, to begin with; of none where every order has its closed form."""


def _quadratic(space: Space, data: Data, task: _Task, newton_steps: Array) -> Callable[[Array, Array], Quadratic]:
    """Cost of the free unknowns, with the random unbalance and bow of each run integrated out (covariance σ²I + B Bᵀ per run)."""
    kept, chosen, training = task.kept, task.chosen, task.training
    member = (data.run[:, None] == jnp.arange(data.run_count)[None]).astype(float)
    of_one_size = jnp.asarray(chosen).T @ together(space.open_size) @ jnp.asarray(chosen)

    def per_case(array: Array) -> Array:
        return array.reshape(array.shape[0], math.prod(array.shape[1:4]), *array.shape[4:])

    def parts(unknowns: Array, motions: Array) -> tuple[Array, tuple[Array, Array, Array]]:
        shown, found = _shown(space, data, jnp.asarray(kept + chosen @ unknowns), motions, newton_steps)
        error = residual(data, shown)
        return error, (error, shown, found)

    def evaluate(unknowns: Array, motions: Array) -> Quadratic:
        slopes, (error, shown, found) = jax.jacfwd(parts, has_aux=True)(unknowns, motions)
        prior = prior_at(unknowns, of_one_size)
        local = per_case(error) + task.shift, per_case(slopes), shown, prior
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
        return Quadratic(cost + prior.cost, gradient + prior.weight * unknowns, hessian + diagonal(prior.weight), local, found)

    return evaluate


@eqx.filter_jit
def _descents(space: Space, data: Data, starts: AnyArray, damping: AnyArray, tasks: _Task, newton_steps: AnyArray, tolerance: Tolerance) -> Descent:
    def one(start: AnyArray, first: AnyArray, task: _Task) -> Descent:
        most = TIMED_LEG if task.motions.shape[0] else LEG
        steps = {"memory": jnp.asarray(task.motions), "damping": jnp.asarray(first), "max_steps": most, "tolerance": tolerance}
        return levenberg_marquardt(_quadratic(space, data, task, jnp.asarray(newton_steps)), jnp.asarray(start), **steps)

    return jax.vmap(one)(starts, damping, tasks)


def descend(
    space: Space,
    data: Data,
    starts: Sequence[Start],
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
    where the model has them. ``shift`` is added to the residual of each. Descents that free a force depending on motion, or keep
    one, go by harmonic balance, the others by the closed form. **Returns** one `End` per start.
    """
    points = np.stack([start.point for start in starts])
    free = np.broadcast_to(free, points.shape)
    fixed = np.where(free, 0.0, space.given_unknowns() if kept is None else kept)
    timed = space.timed() & (free | (fixed != 0.0))
    ends: list[End | None] = [None] * len(starts)
    kinds = _numbered(np.asarray(training, bool))
    least = np.array([start.least for start in starts])
    for shared in (False, True):
        chosen = np.flatnonzero(timed.any(axis=1) == shared)
        if not len(chosen):
            continue
        moved = None if shift is None else shift[chosen]
        room = manner._replace(width=max(manner.width, LEAST_TIMED_UNKNOWNS if shared else LEAST_UNKNOWNS))
        tasks = _tasks(space, data, fixed[chosen], free[chosen], np.asarray(training, bool)[chosen], moved, room)
        group = _Group(_nameless(space), filled(data), len(data.run), manner, shift is None, shared, space.motion_shape())
        for k, end in zip(chosen.tolist(), group.descend([starts[k] for k in chosen.tolist()], tasks, least[chosen]), strict=True):
            ends[k] = end
            least[kinds == kinds[k]] = np.minimum(least[kinds == kinds[k]], end.cost)
    return [end for end in ends if end is not None]


def _tasks(space: Space, data: Data, fixed: np.ndarray, free: np.ndarray, training: np.ndarray, shift: np.ndarray | None, manner: Manner) -> _Task:
    """Everything filled up to the sizes that are compiled; no motions yet."""
    columns = [np.flatnonzero(mask) for mask in free]
    width = size_class(max((manner.width, *(len(c) for c in columns))), LEAST_UNKNOWNS)
    chosen = np.zeros((*fixed.shape, width))
    for k, column in enumerate(columns):
        chosen[k, column, np.arange(len(column))] = 1.0
    cases, whole = len(data.run), filled(data)
    counted, moved = np.zeros((len(fixed), len(whole.run))), np.zeros((len(fixed), len(whole.run), math.prod(data.weight.shape[1:])))
    counted[:, :cases] = training
    if shift is not None:
        moved[:, :cases] = shift
    return _Task(fixed, chosen, counted, moved, _absorbed(whole, counted), np.zeros((len(fixed), 0)))


def _numbered(rows: AnyArray) -> Int[np.ndarray, "row"]:
    """A number for each row, the same for rows that are alike."""
    return np.unique(np.asarray(rows), axis=0, return_inverse=True)[1].ravel()


def _picked(starts: list[Start], index: np.ndarray) -> list[Start]:
    return [starts[k] for k in index.tolist()]


def _taken(tasks: _Task, index: np.ndarray) -> _Task:
    return _Task(*(np.asarray(part)[index] for part in tasks))


@dataclasses.dataclass
class _Group:
    """Descents that run in one compiled program."""

    space: Space
    data: Data
    cases: int
    manner: Manner
    rivalry: bool
    """Whether descents of the same unknowns and cases compete."""
    shared: bool
    """Whether orders share a motion, and depend on one another."""
    motion: tuple[int, int, int]
    """Shape of the motion of a case."""

    def descend(self, starts: list[Start], tasks: _Task, bar: Float[np.ndarray, "start"]) -> list[End]:
        """One end per start; ``bar``: the least cost known of other descents on the same cases."""
        point = np.einsum("spf,sp->sf", tasks.chosen, np.stack([start.point for start in starts]))
        if not self.shared:
            return self._legs(point, tasks, bar)
        ends: dict[int, End] = {}
        known = np.array([k for k, start in enumerate(starts) if start.motions is not None], int)
        if len(known):
            motions = np.stack([self._filled(starts[k].motions) for k in known.tolist()])
            found = self._legs(point[known], _taken(tasks, known)._replace(motions=motions), bar[known])
            ends |= {k: end for k, end in zip(known.tolist(), found, strict=True) if math.isfinite(end.cost)}
        fresh = np.array([k for k in range(len(starts)) if k not in ends], int)
        if len(fresh):
            ends |= dict(zip(fresh.tolist(), self._near_measured(_picked(starts, fresh), _taken(tasks, fresh), point[fresh]), strict=True))
        worth = [] if self.manner.first_order else self._worth(starts, ends, fresh, tasks, bar)
        self._balance(ends, {k: self._filled(ends[k].motions) for k in worth}, tasks, bar)
        # Near the motion measured, with its noise, there may be none that friction lets be found.
        lost = sorted((k for k in worth if self.manner.search and not ends[k].exact), key=lambda k: ends[k].cost)[:MOST_SEARCHED]
        self._balance(ends, {k: np.asarray(_searched_motions(self.space, self.data, ends[k].point)) for k in lost}, tasks, bar)
        return [ends[k] for k in range(len(starts))]

    def _balance(self, ends: dict[int, End], near: dict[int, np.ndarray], tasks: _Task, bar: np.ndarray) -> None:
        """Go on from some ends with the orders balanced, from motions ``near``; an end for which that fails stays as it is."""
        if not near:
            return
        chosen = np.array(list(near), int)
        point = np.stack([np.asarray(tasks.chosen)[k].T @ ends[k].point for k in near])
        found = self._legs(point, _taken(tasks, chosen)._replace(motions=np.stack(list(near.values()))), bar[chosen])
        ends.update({k: end for k, end in zip(near, found, strict=True) if math.isfinite(end.cost)})

    def _filled(self, motions: np.ndarray) -> np.ndarray:
        return np.concatenate([motions, np.repeat(motions[-1:], len(self.data.run) - self.cases, axis=0)])

    def _worth(self, starts: list[Start], ends: dict[int, End], fresh: np.ndarray, tasks: _Task, bar: np.ndarray) -> list[int]:
        """Those laid along the measured motion that are worth a descent: near the best known, or among the best of their kind."""
        trained = _numbered(tasks.training)
        worth: list[int] = []
        for kind in np.unique(trained[fresh]):
            own = np.flatnonzero(trained == kind).tolist()
            limit = min(bar[own[0]], *(ends[k].cost for k in own)) + TIMED_HOPELESS
            sets: dict[bytes, int] = {}
            for k in sorted((k for k in own if k in fresh), key=lambda k: ends[k].cost):
                if ends[k].cost <= starts[k].beat - LEAST_GAIN:
                    first = sets.setdefault(ends[k].free.tobytes(), k) == k
                    worth += [k] if ends[k].data_cost <= limit or (first and len(sets) <= SURE) else []
        return worth

    def _near_measured(self, starts: list[Start], tasks: _Task, point: np.ndarray) -> list[End]:
        """Where forces along the measured motion fit best, each response taken to first order from there."""
        near = np.stack([np.asarray(_measured_motions(self.space, self.data, start.point)) for start in starts])
        own, ends = tasks._replace(motions=near), {}
        columns = [np.flatnonzero(task.sum(axis=1)) for task in np.asarray(tasks.chosen)]
        for index, ended in self._batches(np.arange(len(starts)), point, np.full(len(starts), FIRST_DAMPING), own, 0):
            for k, task in enumerate(index.tolist()):
                ends[task] = _end(ended, k, np.asarray(tasks.kept[task]), columns[task], self.cases, int(ended.steps[k]), self.motion)._replace(exact=False)
        return [ends[k] for k in range(len(starts))]

    def _batches(self, waiting: np.ndarray, point: np.ndarray, damping: np.ndarray, tasks: _Task, newton_steps: int) -> Iterator[tuple[np.ndarray, Descent]]:
        """One leg of those that wait, batch by batch."""
        limits = Tolerance(*(np.asarray(limit) for limit in self.manner.tolerance))
        batch = TIMED_BATCH if self.shared else self.manner.batch
        for first in range(0, len(waiting), batch):
            # The last batch is filled up with copies of its last member: they end together with it.
            index = waiting[np.minimum(np.arange(first, first + batch), len(waiting) - 1)]
            chosen = _taken(tasks, index)
            found = _descents(self.space, self.data, point[index], damping[index], chosen, np.asarray(newton_steps), limits)
            yield index[: len(waiting) - first], jax.tree.map(np.asarray, found)

    def _legs(self, point: np.ndarray, tasks: _Task, bar: np.ndarray) -> list[End]:
        """Leg after leg; between legs those that are not worth it drop out."""
        count = len(point)
        damping, steps = np.full(count, FIRST_DAMPING), np.zeros(count, int)
        columns = [np.flatnonzero(task.sum(axis=1)) for task in np.asarray(tasks.chosen)]
        trained = _numbered(tasks.training)
        free = np.asarray(tasks.chosen).sum(axis=2) > 0.0
        rivals = _numbered(np.column_stack([free, trained])) if self.rivalry else np.arange(count)
        ends: list[End | None] = [None] * count
        waiting = np.arange(count)
        per_round = LEG // TIMED_LEG if self.shared else 1
        for leg in range(LEGS * per_round):
            for index, found in self._batches(waiting, point, damping, tasks, NEWTON_STEPS):
                for k, task in enumerate(index):
                    point[task], damping[task], steps[task] = found.point[k], found.damping[k], steps[task] + found.steps[k]
                    if self.shared:
                        np.asarray(tasks.motions)[task] = found.quadratic.memory[k]
                    ends[task] = _end(found, k, np.asarray(tasks.kept[task]), columns[task], self.cases, int(steps[task]), self.motion)
            waiting = _going_on([end for end in ends if end is not None], rivals, trained, leg // per_round, bar, strict=self.shared)
        return [end for end in ends if end is not None]


@eqx.filter_jit
def _measured_motions(space: Space, data: Data, point: AnyArray) -> Float[Array, "case speed dof coefficient"]:
    measured = jax.lax.complex(jnp.asarray(data.pairs[..., 0]), jnp.asarray(data.pairs[..., 1]))
    return motions_of(space.at(jnp.asarray(point)), data.conditions, measured, jnp.asarray(data.weight[..., 0]) > 0.0)


@eqx.filter_jit
def _searched_motions(space: Space, data: Data, point: AnyArray) -> Float[Array, "case speed dof coefficient"]:
    return searched_motions(space.at(jnp.asarray(point)), data.conditions)


def searched(space: Space, data: Data, point: Float[np.ndarray, "param"]) -> Start:
    """A start with the motions that the model has there, whatever was measured."""
    return Start(point, np.asarray(_searched_motions(_nameless(space), filled(data), point))[: len(data.run)])


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


def _going_on(ends: list[End], rivals: Int[np.ndarray, "start"], trained: Int[np.ndarray, "start"], leg: int, bar: np.ndarray, *, strict: bool) -> np.ndarray:
    """Descents worth another leg: not at their end, not hopeless, and among the best of those for the same unknowns."""
    cost, of_data = np.array([end.cost for end in ends]), np.array([end.data_cost for end in ends])
    waiting = np.array([end.result == MAX_STEPS for end in ends])
    for task in np.unique(trained) if leg > 0 or strict else ():
        own = trained == task
        waiting[own] &= of_data[own] < np.minimum(cost[own].min(), bar[own]) + (TIMED_HOPELESS if strict and leg > 0 else HOPELESS)
    for rival in np.unique(rivals[waiting]):
        own = np.flatnonzero(rivals == rival)
        ranked = own[np.argsort(cost[own], kind="stable")]
        waiting[ranked[KEPT_RIVALS[min(leg, len(KEPT_RIVALS) - 1)] :]] = False
    return np.flatnonzero(waiting)


def _end(found: Descent, k: int, fixed: np.ndarray, column: np.ndarray, cases: int, steps: int, shape: tuple[int, ...]) -> End:
    """One member of a batch, without what it was filled up with."""
    size, quadratic = len(column), found.quadratic
    point = fixed.copy()
    point[column] = found.point[k, :size]
    error, slopes, shown, prior = quadratic.extra
    cost = float(quadratic.cost[k]) if np.isfinite(quadratic.cost[k]) else math.inf
    local = Local(np.asarray(error[k, :cases]), np.asarray(slopes[k, :cases, :, :size]))
    vectors = shown[k, :cases, ..., 0] + 1j * shown[k, :cases, ..., 1]
    motions = quadratic.memory[k][:cases] if quadratic.memory[k].ndim > 1 else np.zeros((0, *shape))
    curvature = np.asarray(quadratic.hessian[k, :size, :size]) if math.isfinite(cost) else np.eye(size)
    here = Prior(prior.cost[k], prior.weight[k, :size])
    return End(point, cost, column, curvature, here, local, vectors, motions, steps, int(found.result[k]), exact=True)


@eqx.filter_jit
def _predictions(space: Space, conditions: Conditions, points: AnyArray, *, timed: bool) -> Complex[Array, "start case probe order"]:
    def at(point: Array) -> Array:
        model = space.at(point)
        return vectors(model if timed else without_timed(model), conditions)

    return jax.vmap(at)(jnp.asarray(points))


def predict(space: Space, conditions: Conditions, points: Float[np.ndarray, "start param"]) -> Complex[np.ndarray, "start case probe order"]:
    """What the model shows at each of some points [m]; compiled once for all conditions and points of one size."""
    cases, count = len(np.asarray(conditions.speed)), len(points)
    more = size_class(cases, LEAST_CASES) - cases
    repeated = jax.tree.map(lambda values: np.concatenate([np.asarray(values), np.repeat(np.asarray(values)[-1:], more, axis=0)]), conditions)
    padded = np.concatenate([points, np.repeat(points[-1:], size_class(count, LEAST_POINTS) - count, axis=0)])
    timed = bool(np.any(space.timed() & (points != 0.0)))
    return np.asarray(_predictions(_nameless(space), repeated, padded, timed=timed))[:count, :cases]


def _nameless(space: Space) -> Space:
    """The space without names and prior scales as text: the compiled code must not depend on them."""
    layout = space.model.layout
    blank = Layout(tuple(map(str, range(len(layout.probes)))), tuple(map(str, range(len(layout.planes)))), layout.orders)
    return dataclasses.replace(space, model=dataclasses.replace(space.model, layout=blank), entries=())


def best_of(ends: list[End]) -> End:
    """The descent that ended lowest."""
    return min(ends, key=lambda end: end.cost)
