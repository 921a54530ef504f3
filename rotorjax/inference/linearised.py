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

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Complex, Float, Int

from rotorjax.inference.data import Data, half_order_sign
from rotorjax.inference.kernels import COLUMNS, Equations, Kernels, Rows
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
    reach: Float[np.ndarray, "case cell motion"]
    """X W⁻¹: the same in the vectors, in standard errors per metre."""
    off: Float[np.ndarray, "case"]
    """Largest |X g|: standard errors by which the reading is off what balance will make of it."""
    followed: Float[np.ndarray, "case speed dof wide"]
    """The motions, their higher orders as they follow the force."""


class Imbalance(NamedTuple):
    """How far some motions are from balance, each a case at some parameters."""

    size: Float[np.ndarray, "row"]
    """|W g|: the force that is lacking, as a displacement [m]."""
    off: Float[np.ndarray, "row"]
    """As in `Freedom`."""
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


class Linearisation:
    """One measurement and one parameter space: linearises at many points in the same compiled calls."""

    def __init__(self, space: Space, data: Data, budget: Budget) -> None:
        self.space, self.data, self.budget = space, data, budget
        self.kernels = Kernels(space)
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
        for group, linearise in ((plain, self._plain), (timed, self._timed)):
            if group:
                for k, one in zip(group, linearise([points[k] for k in group], [free[k] for k in group]), strict=True):
                    found[k] = one
        return [one for one in found if one is not None]

    def _rows(self, points: Sequence[Point], free: Sequence[np.ndarray]) -> tuple[Rows, list[int]]:
        """Rows of all points, block of free unknowns by block; and the number of blocks of each point."""
        blocks = [max(1, math.ceil(len(columns) / COLUMNS)) for columns in free]
        per = self.speeds.size
        unknowns, wanted = [], []
        for point, columns, count in zip(points, free, blocks, strict=True):
            padded = np.full(count * COLUMNS, -1)
            padded[: len(columns)] = columns
            unknowns += [np.broadcast_to(point.unknowns, (per, len(point.unknowns)))] * count
            wanted += [np.broadcast_to(block, (per, COLUMNS)) for block in padded.reshape(count, COLUMNS)]
        total, kinds = sum(blocks), self.speeds.shape[1]
        conditions = (np.repeat(np.asarray(values), kinds, axis=0) for values in (self.data.unbalance, self.data.bow))
        each = [np.tile(values, (total,) + (1,) * (values.ndim - 1)) for values in (self.speeds.ravel(), *conditions)]
        self.budget.spent += total * self.cases
        return Rows(np.concatenate(unknowns), np.concatenate(wanted), *each), blocks

    def _split(self, values: np.ndarray, blocks: list[int]) -> list[np.ndarray]:
        """Back to one array a point: block x case x speed x what follows."""
        shaped = values.reshape(sum(blocks), *self.speeds.shape, *values.shape[1:])
        return np.split(shaped, np.cumsum(blocks)[:-1])

    def _plain(self, points: list[Point], free: list[np.ndarray]) -> list[Linearised]:
        rows, blocks = self._rows(points, free)
        shown, slopes = (self._split(part, blocks) for part in self.kernels.linear(rows))
        found = []
        for k, point in enumerate(points):
            read = self._less_slow_roll(shown[k][0])
            by_free = self._less_slow_roll(_joined(slopes[k], len(free[k])))
            found.append(self._held_against(point, read, by_free, None))
        return found

    def _timed(self, points: list[Point], free: list[np.ndarray]) -> list[Linearised]:
        rows, blocks = self._rows(points, free)
        count = self.kernels.coefficients
        wide = np.concatenate([np.repeat(self._flat(point)[None], n, axis=0).reshape(-1, *self._flat(point).shape[1:])
                               for point, n in zip(points, blocks, strict=True)])  # fmt: skip
        parts = [self._split(part, blocks) for part in self.kernels.balanced(rows, wide[..., :count])]
        refined = self._refined(points, free)
        found = []
        for k, point in enumerate(points):
            found.append(self._eliminated(point, Equations(*(part[k] for part in parts)), refined.get(k), len(free[k])))
        return found

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
        step = -np.einsum("rij,rj->ri", _inverse(equations.force_by_motion[None])[0], force)
        per_force = np.repeat(self._per_force[cases].reshape(len(wide), 1, count), motions.shape[2], axis=1)
        size = np.linalg.norm((force * per_force.reshape(force.shape)).reshape(len(cases), -1), axis=1)
        read = np.einsum("rmi,ri->rm", equations.shown_by_motion, step).reshape(len(cases), kinds, -1)
        off = np.abs(self._less_slow_roll(read) * self._weight[cases]).max(axis=1)
        return Imbalance(size, off, step.reshape(*motions.shape[:3], count), followed.reshape(motions.shape))

    def _flat(self, point: Point) -> Float[np.ndarray, "row dof wide"]:
        motions = np.asarray(point.motions)
        return motions.reshape(-1, *motions.shape[2:])

    def _refined(self, points: list[Point], free: list[np.ndarray]) -> dict[int, tuple[np.ndarray, np.ndarray]]:
        """Force and motion of those points that want the refined one."""
        fine = [k for k, point in enumerate(points) if point.refined]
        if not fine:
            return {}
        none = [np.zeros(0, int)] * len(fine)
        spent = self.budget.spent
        rows, blocks = self._rows([points[k] for k in fine], none)
        self.budget.spent = spent
        force, motion = self.kernels.refined(rows, np.concatenate([self._flat(points[k]) for k in fine]))
        forces, motions = self._split(force, blocks), self._split(motion, blocks)
        return {k: (forces[i][0], motions[i][0]) for i, k in enumerate(fine)}

    def _eliminated(self, point: Point, eq: Equations, refined: tuple[np.ndarray, np.ndarray] | None, free: int) -> Linearised:
        """The motions eliminated, case by case. Leading axes of the equations: block, case, speed."""
        force = eq.force[0] if refined is None else refined[0]
        inverse = _inverse(eq.force_by_motion[0])
        dof = eq.force.shape[-1] // self.kernels.coefficients
        by_force = inverse / np.tile(self._per_force, dof)[:, :, None, :]
        newton = np.einsum("csij,csj->csi", inverse, force)
        newton_slopes = inverse @ _joined(eq.force_slopes, free)
        read = eq.shown_by_motion[0]
        off = np.einsum("csmi,csi->csm", read, newton)
        shown = self._less_slow_roll(eq.shown[0] - off)
        slopes = self._less_slow_roll(_joined(eq.slopes, free) - read @ newton_slopes)
        sign = np.array([1.0, -1.0])[: self.speeds.shape[1], None, None]
        reach = np.concatenate(np.moveaxis(sign * (read @ by_force), 1, 0), axis=-1) * self._weight[..., None]
        unread = np.abs(self._less_slow_roll(off) * self._weight).max(axis=1)
        freedom = Freedom(
            newton.reshape(self.cases, -1), newton_slopes.reshape(self.cases, reach.shape[-1], free), _block_diagonal(by_force), reach, unread,
            np.asarray(point.motions) if refined is None else refined[1],
        )  # fmt: skip
        return self._held_against(point, shown, slopes, freedom)

    def _less_slow_roll(self, values: Float[np.ndarray, "case speed *cell"]) -> Float[np.ndarray, "case *cell"]:
        return values[:, 0] if values.shape[1] == 1 else values[:, 0] - values[:, 1]

    def _held_against(self, point: Point, shown: np.ndarray, slopes: np.ndarray, freedom: Freedom | None) -> Linearised:
        """In standard errors; a half order is compared up to the sign that a once-per-turn reference leaves open."""
        data, weight = self.data, self._weight
        # What was not measured need not exist.
        there = np.where(weight > 0.0, shown, 0.0)
        sign = half_order_sign(there.reshape(data.pairs.shape), data.pairs, data.weight, data.half_order)
        measured = (sign * data.pairs).reshape(weight.shape)
        by_free = np.where(weight[..., None] > 0.0, slopes, 0.0)
        return Linearised(point, shown, weight * (there - measured), weight[..., None] * by_free, freedom)

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


def _joined(slopes: Float[np.ndarray, "block case speed line column"], free: int) -> Float[np.ndarray, "case speed line free"]:
    """Blocks of columns side by side, without what filled up the last."""
    return np.concatenate(list(slopes), axis=-1)[..., :free]


def _inverse(matrices: Float[np.ndarray, "case speed equation equation"]) -> Float[np.ndarray, "case speed equation equation"]:
    """Inverses; not a number where there is none."""
    try:
        return np.linalg.inv(matrices)
    except np.linalg.LinAlgError:
        found = np.full(matrices.shape, np.nan)
        for index in np.ndindex(matrices.shape[:2]):
            if np.linalg.matrix_rank(matrices[index]) == matrices.shape[-1]:
                found[index] = np.linalg.inv(matrices[index])
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
