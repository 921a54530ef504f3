"""A model linearised about motions that need not balance: the motion of every case is eliminated by its own small solve.

Unknowns are the parameters θ and the motion q of every case. With the balance of forces g(q, θ) = D q + N(q) - F and the reading s(q, θ),

    minimise  ½ |(s - z)/σ|² + ½ |W g|²/ε² + prior(θ),     W = 1/(k + m (nΩ)²) turns a force into a displacement,

to first order in (dq, dθ). Without its own freedom the motion would follow the balance, dq = -G⁻¹ (g + g_θ dθ), G = ∂g/∂q; what
freedom ε leaves it is a force h on the rotor, of standard error ε/W. Integrated out, as h is, it adds to the covariance of the
vectors:

    residual r - X g, slopes s_θ - X g_θ, covariance 1 + ε² (X/W)(X/W)ᵀ,     X = s_q G⁻¹ / σ.

ε = 0 is the model itself, linearised as implicit differentiation would. (Direct collocation; parameter cascading: Ramsay, Hooker, Campbell,
Cao 2007, J. R. Stat. Soc. B 69:741-796.)
"""

import contextlib
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Complex, Float, Int

from rotorjax.inference.data import Data, half_order_sign
from rotorjax.inference.kernels import COLUMNS, Equations, Kernels, Rows, side_by_side
from rotorjax.space import Space


class Point(NamedTuple):
    """Where to linearise."""

    unknowns: Float[np.ndarray, "param"]
    motions: Float[np.ndarray, "case speed dof wide"] | None
    """Of every case, at its speed and at slow roll where that was subtracted; none where every order has its closed form."""
    refined: bool = False
    """Whether the force is taken along more orders and at more instants."""


class Freedom(NamedTuple):
    """How motions answer, where orders depend on one another."""

    newton: Float[np.ndarray, "case motion"]
    """G⁻¹ g: what the motions are off balance by [m]."""
    newton_slopes: Float[np.ndarray, "case motion free"]
    by_force: Float[np.ndarray, "case motion motion"]
    """G⁻¹ W⁻¹: motion per force that is left, that force as a displacement."""
    seen: Float[np.ndarray, "case cell motion"]
    """s_q / σ: what is seen of a motion, in standard errors per metre."""
    reach: Float[np.ndarray, "case cell motion"]
    """X W⁻¹: the same in the vectors, in standard errors per metre."""
    size: Float[np.ndarray, "case"]
    """|W g|: the force that is lacking, as a displacement [m]."""
    off: Float[np.ndarray, "case"]
    """Largest |X g|: standard errors by which the reading is off what balance will make of it."""
    followed: Float[np.ndarray, "case speed dof wide"]
    """The motions, their higher orders as they follow the force."""


class Imbalance(NamedTuple):
    """How far some motions are from balance, each a case at some parameters."""

    size: Float[np.ndarray, "row"]
    """As in `Freedom`."""
    off: Float[np.ndarray, "row"]
    """As there."""
    step: Float[np.ndarray, "row speed dof coefficient"]
    """Newton's, towards balance."""
    followed: Float[np.ndarray, "row speed dof wide"]


class Linearised(NamedTuple):
    """A model at one point."""

    point: Point
    shown: Float[np.ndarray, "case cell"]
    """What the probes show [m], to first order balanced."""
    error: Float[np.ndarray, "case cell"]
    """(shown - measured) / σ."""
    slopes: Float[np.ndarray, "case cell free"]
    freedom: Freedom | None

    def with_cases(self, cases: Int[np.ndarray, "near"], other: "Linearised") -> "Linearised":
        """Some cases in the place of their own, linearised at other motions."""
        assert self.freedom is not None
        assert other.freedom is not None
        freedom = Freedom(*(_replaced(old, cases, new) for old, new in zip(self.freedom, other.freedom, strict=True)))
        shown, error, slopes = (_replaced(getattr(self, part), cases, getattr(other, part)) for part in ("shown", "error", "slopes"))
        return Linearised(other.point, shown, error, slopes, freedom)

    @property
    def finite(self) -> bool:
        """Whether it can be used at all."""
        return bool(np.all(np.isfinite(self.error)) and np.all(np.isfinite(self.slopes)))


class Budget:
    """Single cases linearised so far, and how many may be."""

    def __init__(self, limit: int | None = None) -> None:
        self.limit, self.spent = limit, 0

    @property
    def exhausted(self) -> bool:
        """Whether the limit is reached."""
        return self.limit is not None and self.spent >= self.limit


class _Task(NamedTuple):
    """What is evaluated together."""

    point: Point
    free: Int[np.ndarray, "free"]
    cases: Int[np.ndarray, "near"]

    @property
    def blocks(self) -> int:
        """As many evaluations as slopes by all that is free take."""
        return max(1, math.ceil(len(self.free) / COLUMNS))

    @property
    def motions(self) -> Float[np.ndarray, "near speed dof wide"]:
        """Of these cases."""
        return np.asarray(self.point.motions)[self.cases]


class Linearisation:
    """One measurement and one parameter space: linearises at many points in the same compiled calls."""

    def __init__(self, space: Space, data: Data, budget: Budget) -> None:
        self.space, self.data, self.budget = space, data, budget
        self.kernels, self.even = Kernels(space), space.even()
        model = space.model
        speeds = [np.asarray(data.speed)]
        if model.slow_roll is not None:
            speeds.append(np.full(len(data.speed), float(model.slow_roll)))
        self.speeds: Float[np.ndarray, "case speed"] = np.stack(speeds, axis=1)
        """Two per case where slow roll was subtracted: both are balanced, and read as one less the other."""
        order = np.concatenate([[0.0], np.repeat(self.kernels.grid.order_array[1:], 2)])
        stiffness, mass = float(np.mean(np.asarray(model.rotor.stiffness))), float(model.rotor.mass)
        self._per_force = 1.0 / (stiffness + mass * (order * self.speeds[..., None]) ** 2)
        self._weight = np.asarray(data.weight).reshape(len(data.speed), -1)

    @property
    def cases(self) -> int:
        """Number of cases."""
        return len(self.speeds)

    def at(self, points: Sequence[Point], free: Sequence[Int[np.ndarray, "_"]]) -> list[Linearised]:
        """Linearise at every point, by the unknowns that are free there."""
        found: list[Linearised | None] = [None] * len(points)
        timed = [k for k, point in enumerate(points) if point.motions is not None]
        plain = [k for k, point in enumerate(points) if point.motions is None]
        for group, linearise in ((plain, self._plain), (timed, self.timed_at)):
            if group:
                for k, one in zip(group, linearise([points[k] for k in group], [free[k] for k in group]), strict=True):
                    found[k] = one
        return [one for one in found if one is not None]

    def _tasks(self, points: Sequence[Point], free: Sequence[np.ndarray], cases: Sequence[np.ndarray] | None = None) -> list[_Task]:
        """All that is evaluated, counted."""
        every = np.arange(self.cases)
        tasks = [_Task(point, own, every if cases is None else cases[k]) for k, (point, own) in enumerate(zip(points, free, strict=True))]
        self.budget.spent += sum(task.blocks * len(task.cases) for task in tasks)
        return tasks

    def _rows(self, tasks: list[_Task]) -> Rows:
        """Rows of all tasks: block of free unknowns by block, in each case by case, in each speed by speed."""
        kinds, unknowns, wanted, which = self.speeds.shape[1], [], [], []
        for task in tasks:
            count = len(task.cases) * kinds
            padded = np.full(task.blocks * COLUMNS, -1)
            padded[: len(task.free)] = task.free
            unknowns.append(np.broadcast_to(task.point.unknowns, (task.blocks * count, len(task.point.unknowns))))
            wanted.append(np.repeat(padded.reshape(task.blocks, COLUMNS), count, axis=0))
            which.append(np.tile(task.cases, task.blocks))
        case = np.concatenate(which)
        conditions = (np.repeat(np.asarray(values)[case], kinds, axis=0) for values in (self.data.unbalance, self.data.bow))
        return Rows(np.concatenate(unknowns), np.concatenate(wanted), self.speeds[case].ravel(), *conditions)

    def _split(self, values: np.ndarray, tasks: list[_Task]) -> list[np.ndarray]:
        """Back to one array a task: block x case x speed x what follows."""
        kinds = self.speeds.shape[1]
        ends = np.cumsum([task.blocks * len(task.cases) * kinds for task in tasks])[:-1]
        parts = np.split(values, ends)
        return [part.reshape(task.blocks, len(task.cases), kinds, *values.shape[1:]) for part, task in zip(parts, tasks, strict=True)]

    def _plain(self, points: list[Point], free: list[np.ndarray]) -> list[Linearised]:
        tasks = self._tasks(points, free)
        shown, slopes = (self._split(part, tasks) for part in self.kernels.linear(self._rows(tasks)))
        found = []
        for k, task in enumerate(tasks):
            read = self._less_slow_roll(shown[k][0])
            by_free = self._less_slow_roll(_joined(slopes[k], len(task.free)))
            found.append(self._held_against(task, read, by_free, None))
        return found

    def timed_at(self, points: Sequence[Point], free: Sequence[Int[np.ndarray, "_"]], cases: Sequence[Int[np.ndarray, "_"]] | None = None) -> list[Linearised]:
        """The same where orders depend on one another; on some ``cases`` of each point only, if so wanted."""
        tasks = self._tasks(points, free, cases)
        count = self.kernels.coefficients
        wide = np.concatenate([np.concatenate([self._flat(task)] * task.blocks) for task in tasks])
        parts = [self._split(part, tasks) for part in self.kernels.balanced(self._rows(tasks), wide[..., :count])]
        refined = self._refined(tasks)
        return side_by_side(lambda k: self._eliminated(tasks[k], Equations(*(part[k] for part in parts)), refined.get(k)), range(len(tasks)))

    def imbalance(
        self, unknowns: Float[np.ndarray, "row param"], cases: Int[np.ndarray, "row"], motions: Float[np.ndarray, "row speed dof wide"], *, refined: bool
    ) -> Imbalance:
        """The balance of single cases, without slopes by the unknowns."""
        kinds, count = self.speeds.shape[1], self.kernels.coefficients
        each = (np.repeat(np.asarray(values)[cases], kinds, axis=0) for values in (self.data.unbalance, self.data.bow))
        rows = Rows(np.repeat(unknowns, kinds, axis=0), np.full((len(cases) * kinds, COLUMNS), -1), self.speeds[cases].ravel(), *each)
        wide = motions.reshape(-1, *motions.shape[2:])
        equations = self.kernels.balanced(rows, wide[..., :count])
        force, followed = (equations.force, wide) if not refined else self.kernels.refined(rows, wide)
        self.budget.spent += len(cases)
        step = -_solved(equations.force_by_motion, force[..., None])[..., 0]
        per_force = np.repeat(self._per_force[cases].reshape(len(wide), 1, count), motions.shape[2], axis=1)
        size = np.linalg.norm((force * per_force.reshape(force.shape)).reshape(len(cases), -1), axis=1)
        read = np.einsum("rmi,ri->rm", equations.shown_by_motion, step).reshape(len(cases), kinds, -1)
        off = np.abs(self._less_slow_roll(read) * self._weight[cases]).max(axis=1)
        return Imbalance(size, off, step.reshape(*motions.shape[:3], count), followed.reshape(motions.shape))

    def _flat(self, task: _Task) -> Float[np.ndarray, "row dof wide"]:
        motions = task.motions
        return motions.reshape(-1, *motions.shape[2:])

    def _refined(self, tasks: list[_Task]) -> dict[int, tuple[np.ndarray, np.ndarray]]:
        """Force and motion of those tasks that want the refined one."""
        fine = [k for k, task in enumerate(tasks) if task.point.refined]
        if not fine:
            return {}
        own = [tasks[k]._replace(free=np.zeros(0, int)) for k in fine]
        force, motion = self.kernels.refined(self._rows(own), np.concatenate([self._flat(task) for task in own]))
        forces, motions = self._split(force, own), self._split(motion, own)
        return {k: (forces[i][0], motions[i][0]) for i, k in enumerate(fine)}

    def _eliminated(self, task: _Task, eq: Equations, refined: tuple[np.ndarray, np.ndarray] | None) -> Linearised:
        """The motions eliminated, case by case. Leading axes of the equations: block, case, speed."""
        free, cases, weight = len(task.free), len(task.cases), self._weight[task.cases]
        force = eq.force[0] if refined is None else refined[0]
        by_motion = eq.force_by_motion[0]
        inverse = _solved(by_motion, np.broadcast_to(np.eye(by_motion.shape[-1]), by_motion.shape))
        per_force = np.tile(self._per_force[task.cases], eq.force.shape[-1] // self.kernels.coefficients)
        by_force, size = inverse / per_force[:, :, None, :], np.linalg.norm((force * per_force).reshape(cases, -1), axis=1)
        newton = np.einsum("csij,csj->csi", inverse, force)
        newton_slopes = inverse @ _joined(eq.force_slopes, free)
        read = eq.shown_by_motion[0]
        off = np.einsum("csmi,csi->csm", read, newton)
        shown = self._less_slow_roll(eq.shown[0] - off)
        slopes = self._less_slow_roll(_joined(eq.slopes, free) - read @ newton_slopes)
        sign = np.array([1.0, -1.0])[: self.speeds.shape[1], None, None]
        seen, reach = (np.concatenate(np.moveaxis(sign * by_motion, 1, 0), axis=-1) * weight[..., None] for by_motion in (read, read @ by_force))
        unread = np.abs(self._less_slow_roll(off) * weight).max(axis=1)
        freedom = Freedom(
            newton.reshape(cases, -1), newton_slopes.reshape(cases, reach.shape[-1], free), _block_diagonal(by_force), seen, reach, size, unread,
            task.motions if refined is None else refined[1],
        )  # fmt: skip
        return self._held_against(task, shown, slopes, freedom)

    def _less_slow_roll(self, values: Float[np.ndarray, "case speed *cell"]) -> Float[np.ndarray, "case *cell"]:
        return values[:, 0] if values.shape[1] == 1 else values[:, 0] - values[:, 1]

    def _held_against(self, task: _Task, shown: np.ndarray, slopes: np.ndarray, freedom: Freedom | None) -> Linearised:
        """In standard errors; a half order is compared up to the sign that a once-per-turn reference leaves open."""
        weight, pairs = self._weight[task.cases], self.data.pairs[task.cases]
        # What was not measured need not exist.
        there = np.where(weight > 0.0, shown, 0.0)
        sign = half_order_sign(there.reshape(pairs.shape), pairs, self.data.weight[task.cases], self.data.half_order)
        measured = (sign * pairs).reshape(weight.shape)
        by_free = np.where(weight[..., None] > 0.0, slopes, 0.0)
        return Linearised(task.point, shown, weight * (there - measured), weight[..., None] * by_free, freedom)

    def vectors(self, shown: Float[np.ndarray, "case cell"]) -> Complex[np.ndarray, "case probe order"]:
        """Cells as complex vectors [m]; order 0 is real."""
        pairs = shown.reshape(self.data.pairs.shape)
        return pairs[..., 0] + 1j * pairs[..., 1]

    def moved(self, one: Linearised, step: Float[np.ndarray, "case motion"]) -> Float[np.ndarray, "case speed dof wide"]:
        """The motions after a step of what is balanced; higher orders as they follow the force."""
        assert one.freedom is not None
        motions = one.freedom.followed.copy()
        motions[..., : self.kernels.coefficients] += step.reshape(*motions.shape[:3], -1)
        return motions

    def timed(self, unknowns: Float[np.ndarray, "param"], free: Bool[np.ndarray, "param"]) -> bool:
        """Whether orders depend on one another."""
        return bool(np.any(self.space.timed() & (free | (unknowns != 0.0))))


def _replaced(old: np.ndarray, cases: np.ndarray, new: np.ndarray) -> np.ndarray:
    changed = old.copy()
    changed[cases] = new
    return changed


def _joined(slopes: Float[np.ndarray, "block case speed line column"], free: int) -> Float[np.ndarray, "case speed line free"]:
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


def _block_diagonal(blocks: Float[np.ndarray, "case speed one one"]) -> Float[np.ndarray, "case motion motion"]:
    """The motions of the speeds of one case side by side."""
    cases, count, size, _ = blocks.shape
    if count == 1:
        return blocks[:, 0]
    full = np.zeros((cases, count, size, count, size))
    for k in range(count):
        full[:, k, :, k] = blocks[:, k]
    return full.reshape(cases, count * size, count * size)
