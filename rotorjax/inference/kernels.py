"""The compiled part of every fit: a chunk of rows in, equations, readings and their slopes out.

A row is one set of unknowns at one case and one speed. Shapes depend on the probes, the orders and the catalogue only,
never on the number of cases, runs, starts or free unknowns: each kernel is compiled once, and every later measurement
finds it in the cache.
"""

import functools
from collections.abc import Callable, Iterable
from typing import ClassVar, NamedTuple

import numpy as np
from jax import Array
from jaxtyping import Complex, Float, Int

from rotorjax.arrays import numpy_pair
from rotorjax.effects import CATALOG
from rotorjax.effects.of_one_run import OfOneRun
from rotorjax.effects.terms import TERMS
from rotorjax.inference import linear_kernels
from rotorjax.inference.coefficients import add_dynamic, answer, as_coefficients
from rotorjax.inference.force_kernels import BALANCED_CHUNK, ForceInputs, Forces
from rotorjax.inference.parts import Part
from rotorjax.inference.programs import LINEAR_CHUNK, compiled, in_chunks
from rotorjax.inference.space import Space, once_for_each
from rotorjax.model.conditions import Conditions
from rotorjax.model.contract import (
    Effect,
    ExcitationEffect,
    MatrixEffect,
    ReadingEffect,
    RestoringEffect,
    SpeedEffect,
    SupportEffect,
    SweepEffect,
    WaveformEffect,
)
from rotorjax.physics.harmonic_balance import Grid, grid_of
from rotorjax.physics.planar import DOF

USUAL_ORDERS = (0.0, 1.0, 2.0, 3.0)
COLUMNS = 12
"""Unknowns by which slopes are taken in one go."""


class Rows(NamedTuple):
    """Where to evaluate."""

    unknowns: Float[np.ndarray, "row param"]
    columns: Int[np.ndarray, "row column"]
    """Unknowns by which slopes are wanted; -1, at the end, for none."""
    speed: Float[np.ndarray, "row"]
    unbalance: Float[np.ndarray, "row plane dof"]
    bow: Float[np.ndarray, "row dof"]
    sweep: Float[np.ndarray, "row"]
    """Rate of the speed [rad/s²]: what it does is added to what is read, by a program of its own."""

    @classmethod
    def without_slopes(
        cls,
        unknowns: Float[np.ndarray, "row param"],
        speed: Float[np.ndarray, "row"],
        unbalance: Float[np.ndarray, "row plane dof"],
        bow: Float[np.ndarray, "row dof"],
        sweep: Float[np.ndarray, "row"] | float = 0.0,
    ) -> "Rows":
        """With no unknown by which slopes are wanted."""
        columns = np.full((len(unknowns), COLUMNS), -1)
        return cls(unknowns, columns, speed, unbalance, bow, np.broadcast_to(sweep, len(unknowns)))

    @property
    def steady(self) -> tuple[np.ndarray, ...]:
        """All but the sweep."""
        return self[:-1]

    @property
    def wanted(self) -> slice:
        """Columns in which any row has an unknown: as many as slopes are given by."""
        return slice(int(np.count_nonzero(self.columns >= 0, axis=1).max(initial=0)))


class Reading(NamedTuple):
    """What the probes show [m], real and imaginary part of every probe and order in a row, and its slopes by the wanted
    unknowns.
    """

    shown: Float[np.ndarray, "row cell"]
    slopes: Float[np.ndarray, "row cell column"]


class Equations(NamedTuple):
    """The balance of forces g = D q + N(q) - F along a motion q [N], the reading s of that motion [m], and their
    slopes.
    """

    shown: Float[np.ndarray, "row cell"]
    shown_by_motion: Float[np.ndarray, "row cell equation"]
    slopes: Float[np.ndarray, "row cell column"]
    force: Float[np.ndarray, "row equation"]
    force_by_motion: Float[np.ndarray, "row equation equation"]
    force_slopes: Float[np.ndarray, "row equation column"]


class Refined(NamedTuple):
    """The same balance with the force taken along more orders at more instants, and those orders as they follow that
    force.
    """

    force: Float[np.ndarray, "row equation"]
    motion: Float[np.ndarray, "row dof wide"]


class Kernels:
    """The kernels of one parameter space."""

    dof: ClassVar[int] = DOF
    """Degrees of freedom of a motion; what fits motions takes their number from here."""

    def __init__(self, space: Space) -> None:
        orders, effects = space.model.layout.orders, space.model.effects
        self.grid: Grid = grid_of(space.model)
        null_effects = _null_effects(effects)
        # Slow roll is another row, at its own speed; names and prior scales as text would be in the compiled code.
        self._plain = Part.of(space, [e.name for e in effects if _is_linear(e)], orders, null_effects)
        self._linear, self._swept = (
            compiled(kernel, self._plain.space, self._plain.space.model, LINEAR_CHUNK, often=True)
            for kernel in (linear_kernels.linear, linear_kernels.sweep)
        )
        # Column -1 is none.
        self._sweeping = np.append(space.sweeping(), False)
        # Read at the usual orders too: whichever of them were measured, the compiled code is the same.
        usual = tuple(sorted({*orders, *USUAL_ORDERS}))
        self._read = [usual.index(order) for order in orders]
        self._moving = Part.of(space, [e.name for e in effects if not _is_force_only(e)], usual, null_effects)
        self._along, self._refined = (
            compiled(kernel, self._moving.space, self._moving.space.model, BALANCED_CHUNK, often=True)
            for kernel in (linear_kernels.along, linear_kernels.finer)
        )
        self._forces = [Forces.of(space, names, usual) for names in _sources(effects)]

    @property
    def warm(self) -> bool:
        """Whether the programs for nonlinear forces were called before."""
        return self._along.program.warm and all(forces.warm for forces in self._forces)

    def linear_makers(self, conditions: Conditions) -> list[Callable[[], None]]:
        """What makes each program without nonlinear forces, in the order in which a search needs them, for conditions
        like these.
        """
        rows = self._rows_of(self._plain, self._row_at(conditions))
        return [lambda: self._linear.make(*rows.steady), lambda: self._swept.make(*rows)]

    def balanced_makers(self, conditions: Conditions) -> list[Callable[[], None]]:
        """The same for the programs of the balance of forces."""
        unknowns, columns, *along = self._rows_of(self._moving, self._row_at(conditions)).steady
        motion, wide = (np.zeros((1, self.dof, count)) for count in (self.coefficients, self.wide))
        return [
            lambda: self._along.make(unknowns, columns, *along, motion),
            *(functools.partial(forces.make, COLUMNS, self.grid) for forces in self._forces),
            lambda: self._refined.make(unknowns, *along, wide),
            *(functools.partial(forces.make_fine, self.grid.finer) for forces in self._forces),
        ]

    def _row_at(self, conditions: Conditions) -> Rows:
        """The first case, every effect at its null."""
        first = (conditions.speed, conditions.unbalance, conditions.bow, conditions.sweeps)
        return Rows.without_slopes(
            np.zeros((1, self._sweeping.size - 1)), *(np.asarray(values)[:1] for values in first)
        )

    @property
    def coefficients(self) -> int:
        """Real numbers per direction that are balanced together."""
        return 2 * len(self.grid.orders) - 1

    @property
    def wide(self) -> int:
        """Real numbers per direction of a refined motion."""
        return 2 * len(self.grid.finer.orders) - 1

    def linear(self, rows: Rows) -> Reading:
        """Every order in closed form, nonlinear forces left out."""
        shown, slopes = self._linear(*self._rows_of(self._plain, rows).steady)
        return self._with_sweep(rows, shown, slopes[:, rows.wanted])

    def balanced(
        self, rows: Rows, motion: Float[np.ndarray, "row dof coefficient"], *, swept: bool = True
    ) -> Equations:
        """Orders that depend on one another, along a motion that need not be one. **Arguments:** ``swept``: whether
        what a sweep adds is in what is shown; it is not in the balance.
        """
        own = [part for forces in self._forces for part in forces.own(rows.unknowns, rows.columns)]
        parts = iter(
            in_chunks(
                self._balanced_chunk,
                (*self._rows_of(self._moving, rows).steady, motion, *own),
                BALANCED_CHUNK,
                warm=self.warm,
            )
        )
        size, wanted = motion[0].size, rows.wanted
        vectors, by_unknowns = next(parts)[..., self._read], next(parts)[:, wanted][..., self._read]
        shown, shown_slopes = (
            self._with_sweep(rows, vectors, by_unknowns)
            if swept
            else Reading(_cells(vectors), _cells_by_column(by_unknowns))
        )
        shown_by_motion = next(parts)[:, :, self._read]
        lacking = as_coefficients(np.stack([next(parts), next(parts)], axis=-2))
        lacking_slopes = as_coefficients(np.stack([next(parts)[:, wanted], next(parts)[:, wanted]], axis=-2))
        dynamic = [[next(parts), next(parts)], [next(parts), next(parts)]]
        force, force_slopes, force_by_motion = parts
        add_dynamic(force_by_motion, dynamic)
        return Equations(
            shown,
            shown_by_motion.reshape(*shown.shape, size),
            shown_slopes,
            (force + lacking).reshape(-1, size),
            force_by_motion.reshape(-1, size, size),
            np.moveaxis((force_slopes[:, wanted] + lacking_slopes).reshape(*shown_slopes.shape[::2], size), 1, 2),
        )

    def _balanced_chunk(self, *rows: np.ndarray) -> list[Array | np.ndarray]:
        """All parts of the balance: of the linear rotor, then the sum of the forces that act."""
        motion, own = rows[5], rows[6:]
        parts = self._along.chunk(*rows[:6])
        count = 2 * len(ForceInputs._fields)
        rest, inputs = parts[:-count], [np.asarray(part) for part in parts[-count:]]
        acting = [
            forces.slopes.chunk(values, changes, *inputs, motion)
            for forces, values, changes in zip(self._forces, own[::2], own[1::2], strict=True)
            if np.any(values) or np.any(changes)
        ]
        size, columns = motion.shape, rows[1].shape
        return [*rest, *_sum(acting, (size, (*columns, *size[1:]), (*size, *size[1:])))]

    def refined(self, rows: Rows, motion: Float[np.ndarray, "row dof wide"]) -> Refined:
        """Many orders at many instants along a refined motion."""
        unknowns, _, *conditions = self._rows_of(self._moving, rows).steady
        own = [forces.own(rows.unknowns, rows.columns)[0] for forces in self._forces]
        lacking, free, *compliance, force = in_chunks(
            self._refined_chunk, (unknowns, *conditions, motion, *own), BALANCED_CHUNK, warm=self._refined.program.warm
        )
        count = self.coefficients
        low = (lacking + force)[..., :count]
        follows = free - answer(compliance, force)
        return Refined(low.reshape(len(low), -1), np.concatenate([motion[..., :count], follows[..., count:]], axis=-1))

    def _refined_chunk(self, *rows: np.ndarray) -> list[Array | np.ndarray]:
        motion, own = rows[4], rows[5:]
        parts = self._refined.chunk(*rows[:5])
        count = len(ForceInputs._fields)
        rest, inputs = parts[:-count], [np.asarray(part) for part in parts[-count:]]
        acting = [
            forces.fine.chunk(values, *inputs, motion)
            for forces, values in zip(self._forces, own, strict=True)
            if np.any(values)
        ]
        return [*rest, *_sum(acting, (motion.shape,))]

    def _with_sweep(
        self,
        rows: Rows,
        shown: Complex[np.ndarray, "row probe order"],
        slopes: Complex[np.ndarray, "row column probe order"],
    ) -> Reading:
        """What the probes show, with what a sweep adds to it."""
        freed = self._sweeping[rows.columns].any(axis=1) | rows.unknowns[:, self._sweeping[:-1]].any(axis=1)
        moving = np.flatnonzero(freed | (rows.sweep != 0.0))
        if len(moving):
            added, by_column = self._swept(*(values[moving] for values in self._rows_of(self._plain, rows)))
            shown[moving] += added
            slopes[moving] += by_column[:, rows.wanted]
        return Reading(_cells(shown), _cells_by_column(slopes))

    def _rows_of(self, part: Part, rows: Rows) -> Rows:
        """With the unknowns of a part of the space."""
        return rows._replace(unknowns=part.unknowns(rows.unknowns), columns=part.columns(rows.columns))


@once_for_each
def kernels_of(space: Space) -> Kernels:
    """The kernels of a space, made once."""
    return Kernels(space)


def _is_linear(effect: Effect) -> bool:
    return not isinstance(effect, RestoringEffect | WaveformEffect | OfOneRun)


def _is_force_only(effect: Effect) -> bool:
    """Whether all that it does is a nonlinear force, or done by another effect: a class may be of several kinds."""
    more = SpeedEffect | SweepEffect | SupportEffect | MatrixEffect | ExcitationEffect | ReadingEffect | WaveformEffect
    return isinstance(effect, RestoringEffect | OfOneRun) and not isinstance(effect, more)


def _null_effects(effects: Iterable[Effect]) -> list[type[Effect]]:
    """Linear terms of a missing force, where the whole catalogue is there: one program then serves both."""
    whole = CATALOG.keys() <= {effect.name for effect in effects}
    return [cls for cls in TERMS.values() if not issubclass(cls, RestoringEffect)] if whole else []


def _sources(effects: Iterable[Effect]) -> list[frozenset[str]]:
    """Names of the nonlinear forces of the catalogue, of the terms, and of others: a program each, the same whatever
    is beside it.
    """
    forces = [effect for effect in effects if isinstance(effect, RestoringEffect)]
    source = [0 if CATALOG.get(e.name) is type(e) else 1 if TERMS.get(e.name) is type(e) else 2 for e in forces]
    return [frozenset(e.name for e, own in zip(forces, source, strict=True) if own == k) for k in sorted(set(source))]


def _cells(vectors: Complex[np.ndarray, "*many probe order"]) -> Float[np.ndarray, "*many cell"]:
    """Real and imaginary part of every probe and order in a row."""
    probes, orders = vectors.shape[-2:]
    return numpy_pair(vectors).reshape(*vectors.shape[:-2], 2 * probes * orders)


def _cells_by_column(slopes: Complex[np.ndarray, "row column probe order"]) -> Float[np.ndarray, "row cell column"]:
    return np.moveaxis(_cells(slopes), 1, 2)


def _sum(several: list[tuple[Array, ...]], shapes: tuple[tuple[int, ...], ...]) -> list[Array | np.ndarray]:
    """Part by part; nothing, of these shapes, where there are none."""
    if not several:
        return [np.zeros(shape) for shape in shapes]
    first, *others = several
    return [
        sum((np.asarray(part) for part in more), np.asarray(one)) for one, *more in zip(first, *others, strict=True)
    ]
