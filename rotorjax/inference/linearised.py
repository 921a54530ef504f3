"""A model linearised about motions that need not balance: the motion of every case is eliminated by its own small
solve.

Unknowns are the parameters θ and the motion q of every case. With the balance of forces g(q, θ) = D q + N(q) - F and
the reading s(q, θ),

    minimise  ½ |(s - z)/σ|² + ½ |W g|²/ε² + prior(θ),     W = 1/(k + m (nΩ)²) turns a force into a displacement,

to first order in (dq, dθ). Without its own freedom the motion would follow the balance, dq = -G⁻¹ (g + g_θ dθ), G =
∂g/∂q; what freedom ε leaves it is a force h on the rotor, of standard error ε/W. Integrated out, as h is, it adds to
the covariance of the vectors:

    residual r - X g, slopes s_θ - X g_θ, covariance 1 + ε² (X/W)(X/W)ᵀ,     X = s_q G⁻¹ / σ.

ε = 0 is the model itself, linearised as implicit differentiation would. (Direct collocation; parameter cascading:
Ramsay, Hooker, Campbell, Cao 2007, J. R. Stat. Soc. B 69:741-796.)
"""

import contextlib
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float, Int

from rotorjax.inference.budget import Budget
from rotorjax.inference.data import Data, half_order_sign
from rotorjax.inference.kernels import COLUMNS, Equations, Rows, kernels_of
from rotorjax.inference.programs import MOST_ROWS, side_by_side
from rotorjax.inference.space import Space
from rotorjax.inference.states import States


class Point(NamedTuple):
    """Where to linearise."""

    unknowns: Float[np.ndarray, "param"]
    motions: Float[np.ndarray, "state dof wide"] | None
    """Of every case, then at slow roll where that was subtracted (`States`); none where every order has its closed
    form.
    """
    refined: bool = False
    """Whether the force is taken along more orders and at more instants."""
    slack: bool = False
    """Whether the motions of the cases have a freedom of their own, whose effect is linearised, too."""


class ForceSlack(NamedTuple):
    """What a force that is left on the rotor does to the motions, and to what is read of them."""

    by_force: Float[np.ndarray, "case motion motion"]
    """G⁻¹ W⁻¹: motion per force that is left, that force as a displacement."""
    seen: Float[np.ndarray, "case cell motion"]
    """s_q / σ: what is seen of a motion, in standard errors per metre."""
    reach: Float[np.ndarray, "case cell motion"]
    """X W⁻¹: the same in the vectors, in standard errors per metre."""


class MotionResponse(NamedTuple):
    """How motions answer, where orders depend on one another. Those at slow roll have no freedom of their own."""

    newton: Float[np.ndarray, "state motion"]
    """G⁻¹ g: what the motions are off balance by [m]."""
    newton_slopes: Float[np.ndarray, "state motion free"]
    size: Float[np.ndarray, "state"]
    """|W g|: the force that is lacking, as a displacement [m]."""
    off: Float[np.ndarray, "state"]
    """Standard errors by which the reading is off what balance will make of it (`_off_balance`)."""
    followed: Float[np.ndarray, "state dof wide"]
    """The motions, their higher orders as they follow the force."""
    own: ForceSlack | None = None
    """Where the point is `Point.slack`."""


class Imbalance(NamedTuple):
    """How far some motions are from balance, each of a state at some parameters."""

    size: Float[np.ndarray, "row"]
    """As in `MotionResponse`."""
    off: Float[np.ndarray, "row"]
    """As there."""
    step: Float[np.ndarray, "row dof coefficient"]
    """Newton's, towards balance."""
    followed: Float[np.ndarray, "row dof wide"]


class Linearised(NamedTuple):
    """A model at one point."""

    point: Point
    shown: Float[np.ndarray, "case cell"]
    """What the probes show [m], to first order balanced."""
    error: Float[np.ndarray, "case cell"]
    """(shown - measured) / σ."""
    slopes: Float[np.ndarray, "case cell free"]
    response: MotionResponse | None

    def with_cases(self, states: States, cases: Int[np.ndarray, "near"], other: "Linearised") -> "Linearised":
        """Some cases in the place of their own, linearised at other motions, which have no freedom of their own."""
        place = states.seen_in(cases)
        parts = [
            _replaced(getattr(self.response, part), place, getattr(other.response, part))
            for part in MotionResponse._fields
            if part != "own"
        ]
        response = MotionResponse(*parts, own=None)
        shown, error, slopes = (
            _replaced(getattr(self, part), cases, getattr(other, part)) for part in ("shown", "error", "slopes")
        )
        return Linearised(other.point, shown, error, slopes, response)

    @property
    def finite(self) -> bool:
        """Whether it can be used at all."""
        return bool(np.all(np.isfinite(self.error)) and np.all(np.isfinite(self.slopes)))


class _Task(NamedTuple):
    """What is evaluated together."""

    point: Point
    free: Int[np.ndarray, "free"]
    cases: Int[np.ndarray, "near"]
    states: Int[np.ndarray, "one"]
    """In which these cases are seen."""

    @property
    def blocks(self) -> int:
        """As many evaluations as slopes by all that is free take."""
        return max(1, math.ceil(len(self.free) / COLUMNS))

    @property
    def motions(self) -> Float[np.ndarray, "one dof wide"]:
        """Of these states."""
        return np.asarray(self.point.motions)[self.states]


class Linearisation:
    """One measurement and one parameter space: linearises at many points in the same compiled calls."""

    def __init__(self, space: Space, data: Data, budget: Budget) -> None:
        self.space, self.data, self.budget = space, data, budget
        self.kernels = kernels_of(space)
        self._coupled, model = space.coupled(), space.model
        self.states = States.of(data, None if model.slow_roll is None else float(model.slow_roll))
        order = np.concatenate([[0.0], np.repeat(self.kernels.grid.order_array[1:], 2)])
        stiffness, mass = float(np.mean(np.asarray(model.rotor.stiffness))), float(model.rotor.mass)
        self._per_force = np.tile(
            1.0 / (stiffness + mass * (order * self.states.speed[:, None]) ** 2), self.kernels.dof
        )
        self._weight = np.asarray(data.weight).reshape(len(data.speed), -1)
        # That of a state at slow roll is the largest of the cases that are less it.
        self._state_weight = np.zeros((len(self.states.speed), self._weight.shape[1]))
        self._state_weight[: self.cases] = self._weight
        if self.states.rolling is not None:
            np.maximum.at(self._state_weight, self.states.rolling, self._weight)

    @property
    def cases(self) -> int:
        """Number of cases."""
        return len(self.data.speed)

    @property
    def at_rest(self) -> Float[np.ndarray, "state dof wide"]:
        """Motions of nothing."""
        return np.zeros((len(self.states.speed), self.kernels.dof, self.kernels.wide))

    def at(self, points: Sequence[Point], free: Sequence[Int[np.ndarray, "_"]]) -> list[Linearised]:
        """Linearise at every point, by the unknowns that are free there."""
        found: list[Linearised | None] = [None] * len(points)
        coupled = [k for k, point in enumerate(points) if point.motions is not None]
        plain = [k for k, point in enumerate(points) if point.motions is None]
        for group, linearise in ((plain, self._plain), (coupled, self.coupled_at)):
            if group:
                for k, one in zip(group, linearise([points[k] for k in group], [free[k] for k in group]), strict=True):
                    found[k] = one
        return [one for one in found if one is not None]

    def _tasks(
        self, points: Sequence[Point], free: Sequence[np.ndarray], cases: Sequence[np.ndarray] | None = None
    ) -> list[_Task]:
        """All that is evaluated, counted."""
        every = [np.arange(self.cases)] * len(points) if cases is None else cases
        tasks = [
            _Task(point, own, near, self.states.seen_in(near))
            for point, own, near in zip(points, free, every, strict=True)
        ]
        self.budget.spend(sum(task.blocks * len(task.cases) for task in tasks))
        return tasks

    def _rows(self, tasks: list[_Task]) -> Rows:
        """Rows of all tasks: block of free unknowns by block, in each state by state."""
        unknowns, wanted, which = [], [], []
        for task in tasks:
            count = len(task.states)
            padded = np.full(task.blocks * COLUMNS, -1)
            padded[: len(task.free)] = task.free
            unknowns.append(np.broadcast_to(task.point.unknowns, (task.blocks * count, len(task.point.unknowns))))
            wanted.append(np.repeat(padded.reshape(task.blocks, COLUMNS), count, axis=0))
            which.append(np.tile(task.states, task.blocks))
        return self._rows_of(np.concatenate(unknowns), np.concatenate(wanted), np.concatenate(which))

    def _rows_of(
        self,
        unknowns: Float[np.ndarray, "row param"],
        wanted: Int[np.ndarray, "row column"],
        states: Int[np.ndarray, "row"],
    ) -> Rows:
        in_one_run, odd = self.space.in_one_run(), self.states.odd[states]
        if np.any(odd):
            unknowns = in_one_run.added(unknowns, odd)
        return Rows(unknowns, in_one_run.taken_by(wanted), *(values[states] for values in self.states[:4]))

    def _shares(self, task: _Task) -> Float[np.ndarray, "one 1 free"]:
        """Of the slopes by what is free, in the states of a task."""
        return self.space.in_one_run().shares(task.free, self.states.odd[task.states])

    def _split(self, values: np.ndarray, tasks: list[_Task]) -> list[np.ndarray]:
        """Back to one array a task: block x state x what follows."""
        ends = np.cumsum([task.blocks * len(task.states) for task in tasks])[:-1]
        parts = np.split(values, ends)
        return [
            part.reshape(task.blocks, len(task.states), *values.shape[1:])
            for part, task in zip(parts, tasks, strict=True)
        ]

    def _plain(self, points: list[Point], free: list[np.ndarray]) -> list[Linearised]:
        tasks = self._tasks(points, free)
        shown, slopes = (self._split(part, tasks) for part in self.kernels.linear(self._rows(tasks)))
        found = []
        for k, task in enumerate(tasks):
            read = self.states.read(shown[k][0], task.cases)
            by_free = self.states.read(_joined(slopes[k], len(task.free)) * self._shares(task), task.cases)
            found.append(self._held_against(task, read, by_free, None))
        return found

    def coupled_at(
        self,
        points: Sequence[Point],
        free: Sequence[Int[np.ndarray, "_"]],
        cases: Sequence[Int[np.ndarray, "_"]] | None = None,
    ) -> list[Linearised]:
        """The same where orders depend on one another; on some ``cases`` of each point only, if so wanted."""
        tasks = self._tasks(points, free, cases)
        ends = np.cumsum([task.blocks * len(task.states) for task in tasks])
        which = (ends - 1) // MOST_ROWS
        groups = [[tasks[k] for k in np.flatnonzero(which == group)] for group in np.unique(which)]
        return [one for group in groups for one in self._coupled_together(group)]

    def _coupled_together(self, tasks: list[_Task]) -> list[Linearised]:
        """In the same compiled calls."""
        wide = np.concatenate([np.concatenate([task.motions] * task.blocks) for task in tasks])
        parts = [
            self._split(part, tasks)
            for part in self.kernels.balanced(self._rows(tasks), wide[..., : self.kernels.coefficients])
        ]
        refined = self._refined(tasks)
        return side_by_side(
            lambda k: self._eliminated(tasks[k], Equations(*(part[k] for part in parts)), refined.get(k)),
            range(len(tasks)),
        )

    def imbalance(
        self,
        unknowns: Float[np.ndarray, "row param"],
        states: Int[np.ndarray, "row"],
        motions: Float[np.ndarray, "row dof wide"],
        *,
        refined: bool,
    ) -> Imbalance:
        """The balance of single states, without slopes by the unknowns."""
        self.budget.spend(len(states))
        groups = [slice(first, first + MOST_ROWS) for first in range(0, len(states), MOST_ROWS)]
        parts = [self._imbalance(unknowns[g], states[g], motions[g], refined=refined) for g in groups]
        return Imbalance(*(np.concatenate(several) for several in zip(*parts, strict=True)))

    def _imbalance(self, unknowns: np.ndarray, states: np.ndarray, motions: np.ndarray, *, refined: bool) -> Imbalance:
        """In the same compiled calls."""
        count = self.kernels.coefficients
        rows = self._rows_of(unknowns, np.full((len(states), COLUMNS), -1), states)
        equations = self.kernels.balanced(rows, motions[..., :count], swept=False)
        force, followed = (equations.force, motions) if not refined else self.kernels.refined(rows, motions)
        step = -_solved(equations.force_by_motion, force[..., None])
        read = (equations.shown_by_motion @ step)[..., 0]
        off = _off_balance(read, step[..., 0], motions[..., :count], self._state_weight[states])
        size = np.linalg.norm(force * self._per_force[states], axis=1)
        return Imbalance(size, off, step.reshape(*motions.shape[:2], count), followed)

    def _refined(self, tasks: list[_Task]) -> dict[int, tuple[np.ndarray, np.ndarray]]:
        """Force and motion of those tasks that want the refined one."""
        fine = [k for k, task in enumerate(tasks) if task.point.refined]
        if not fine:
            return {}
        own = [tasks[k]._replace(free=np.zeros(0, int)) for k in fine]
        force, motion = self.kernels.refined(self._rows(own), np.concatenate([task.motions for task in own]))
        forces, motions = self._split(force, own), self._split(motion, own)
        return {k: (forces[i][0], motions[i][0]) for i, k in enumerate(fine)}

    def _eliminated(self, task: _Task, eq: Equations, refined: tuple[np.ndarray, np.ndarray] | None) -> Linearised:
        """The motions eliminated, state by state. Leading axes of the equations: block, state."""
        free, count, weight = len(task.free), len(task.cases), self._weight[task.cases][..., None]
        force, followed = (eq.force[0], task.motions) if refined is None else refined
        by_motion, read, per_force = eq.force_by_motion[0], eq.shown_by_motion[0], self._per_force[task.states]
        inverse = _solved(by_motion, np.broadcast_to(np.eye(by_motion.shape[-1]), by_motion.shape))
        shares = self._shares(task)
        newton, newton_slopes = (
            (inverse @ force[..., None])[..., 0],
            inverse @ (_joined(eq.force_slopes, free) * shares),
        )
        off = (read @ newton[..., None])[..., 0]
        shown = self.states.read(eq.shown[0] - off, task.cases)
        slopes = self.states.read(_joined(eq.slopes, free) * shares - read @ newton_slopes, task.cases)
        own = None
        if task.point.slack:
            by_force, seen = inverse[:count] / per_force[:count, None, :], read[:count] * weight
            own = ForceSlack(by_force, seen, seen @ by_force)
        response = MotionResponse(
            newton, newton_slopes, np.linalg.norm(force * per_force, axis=1),
            _off_balance(off, newton, task.motions[..., : self.kernels.coefficients], self._state_weight[task.states]),
            followed, own,
        )  # fmt: skip
        return self._held_against(task, shown, slopes, response)

    def _held_against(
        self, task: _Task, shown: np.ndarray, slopes: np.ndarray, response: MotionResponse | None
    ) -> Linearised:
        """In standard errors; a half order is compared up to the sign that a once-per-turn reference leaves open."""
        weight, pairs = self._weight[task.cases], self.data.pairs[task.cases]
        # What was not measured need not exist.
        there = np.where(weight > 0.0, shown, 0.0)
        sign = half_order_sign(there.reshape(pairs.shape), pairs, self.data.weight[task.cases], self.data.half_order)
        measured = (sign * pairs).reshape(weight.shape)
        by_free = np.where(weight[..., None] > 0.0, slopes, 0.0)
        return Linearised(task.point, shown, weight * (there - measured), weight[..., None] * by_free, response)

    def vectors(self, shown: Float[np.ndarray, "case cell"]) -> Complex[np.ndarray, "case probe order"]:
        """Cells as complex vectors [m]; order 0 is real."""
        pairs = shown.reshape(self.data.pairs.shape)
        return pairs[..., 0] + 1j * pairs[..., 1]

    def moved(self, one: Linearised, step: Float[np.ndarray, "state motion"]) -> Float[np.ndarray, "state dof wide"]:
        """The motions after a step of what is balanced; higher orders as they follow the force."""
        assert one.response is not None
        motions = one.response.followed.copy()
        motions[..., : self.kernels.coefficients] += step.reshape(*motions.shape[:2], -1)
        return motions

    def coupled(self, unknowns: Float[np.ndarray, "param"], free: Int[np.ndarray, "free"]) -> bool:
        """Whether orders depend on one another."""
        return bool(np.any(self._coupled[free]) or np.any(self._coupled & (unknowns != 0.0)))


def _replaced(old: np.ndarray, cases: np.ndarray, new: np.ndarray) -> np.ndarray:
    changed = old.copy()
    changed[cases] = new
    return changed


def _joined(slopes: Float[np.ndarray, "block state line column"], free: int) -> Float[np.ndarray, "state line free"]:
    """Blocks of columns side by side, without what filled up the last."""
    return np.concatenate(list(slopes), axis=-1)[..., :free]


def _solved(
    matrices: Float[np.ndarray, "*many equation equation"], right: Float[np.ndarray, "*many equation column"]
) -> Float[np.ndarray, "*many equation column"]:
    """Solutions of linear equations; not a number where there is none."""
    try:
        return np.linalg.solve(matrices, right)
    except np.linalg.LinAlgError:
        found = np.full(right.shape, np.nan)
        for index in np.ndindex(matrices.shape[:-2]):
            with contextlib.suppress(np.linalg.LinAlgError):
                found[index] = np.linalg.solve(matrices[index], right[index])
        return found


def _off_balance(
    read: Float[np.ndarray, "state cell"],
    step: Float[np.ndarray, "state motion"],
    motions: Float[np.ndarray, "state dof coefficient"],
    weight: Float[np.ndarray, "state cell"],
) -> Float[np.ndarray, "state"]:
    """Standard errors by which the reading is off what balance will make of it: the larger of |X g|, to first order,
    and |dq|²/|q| / σ, the order of the second: by symmetry the first may be zero however far off the motion is, as at
    1X that of a sag through a cubic spring.

    **Arguments:** ``read``: X g [m]; ``step``: Newton's dq [m]; ``motions`` q; ``weight``: 1/σ.
    """
    size = np.maximum(np.linalg.norm(motions.reshape(len(motions), -1), axis=1), 1e-300)
    second = np.sum(step**2, axis=1) / size * weight.max(axis=1)
    return np.maximum(np.abs(read * weight).max(axis=1), second)
