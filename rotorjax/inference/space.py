"""The parameter vector of a fit: every entry of every effect in the model, in units of its prior scale."""

import dataclasses
import functools
import math
from collections.abc import Callable, Iterable, Mapping
from itertools import pairwise
from types import UnionType
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.flatten_util import ravel_pytree
from jaxtyping import Bool, Float, Int

from rotorjax.arrays import as_array
from rotorjax.data.knowledge import Knowledge, Uncertain
from rotorjax.effects.of_one_run import OfOneRun
from rotorjax.model.contract import Effect, RestoringEffect, SweepEffect, WaveformEffect
from rotorjax.model.model import Model
from rotorjax.units import Unit, unit_of

Result = TypeVar("Result")


class InOneRun(NamedTuple):
    """Unknowns that count in one run only (`rotorjax.effects.of_one_run`), as changes of those of the effects that they
    add to.
    """

    own: Int[np.ndarray, "few"]
    changed: Int[np.ndarray, "few"]
    share: Float[np.ndarray, "param"]
    """What one unit of an unknown is in units of the one that it changes; one for all others."""

    def added(
        self, unknowns: Float[np.ndarray, "row param"], odd: Bool[np.ndarray, "row"]
    ) -> Float[np.ndarray, "row param"]:
        """Unknowns of every row with what is added in the rows of that run."""
        there = unknowns.copy()
        there[:, self.changed] += np.where(odd[:, None], self.share[self.own] * unknowns[:, self.own], 0.0)
        return there

    def taken_by(self, wanted: Int[np.ndarray, "*many"]) -> Int[np.ndarray, "*many"]:
        """By which unknowns slopes are taken where those by some, or by none (-1), are wanted."""
        place = np.append(np.arange(len(self.share)), -1)
        place[self.own] = self.changed
        return place[wanted]

    def shares(self, free: Int[np.ndarray, "free"], odd: Bool[np.ndarray, "row"]) -> Float[np.ndarray, "row 1 free"]:
        """What slopes are to be multiplied by that were so taken."""
        there = np.where(np.isin(free, self.own), odd[:, None], True)
        return (self.share[free] * there)[:, None]


class Entry(NamedTuple):
    """One number of one effect: scale of its prior (`rotorjax.inference.prior`) in SI, or of ln(1 + value) if
    logarithmic.
    """

    effect: str
    label: str
    scale: float
    logarithmic: bool
    declared_uncertain: bool
    unknown: int
    """Index of the unknown that moves it; entries that the user tied share one."""

    @property
    def key(self) -> str:
        """Effect and label, as people write it."""
        return f"{self.effect}.{self.label}"

    @property
    def parameter(self) -> str:
        """The label without its axes."""
        return self.label.split(".", 1)[0]

    @property
    def unit(self) -> Unit:
        """Declared by the parameter's name."""
        return unit_of(self.parameter)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Space:
    """Maps a vector of unknowns, each in units of its prior scale, to a model.

    Value of entry i: scale_i u_j, where j is its unknown; the null of every effect is u = 0. A value that the user
    declared uncertain is given_i + scale_i u_j, or (1 + given_i) exp(scale_i u_j) - 1 if it is a positive quantity:
    what the model says is its centre.
    """

    model: Model
    centre: Float[Array, "param"]
    scale: Float[Array, "param"]
    logarithmic: Bool[Array, "param"]
    unknown: Int[Array, "param"]
    open_size: Int[Array, "param"]
    """Of every unknown: a number for what it is a part of, if the size of that is left open
    (`rotorjax.inference.prior`); else -1.
    """
    strength: Int[Array, "param"]
    """Of every unknown: a number for the strength that it is a part of, whose prior scale is known within decades only
    (`rotorjax.inference.evidence`); else -1.
    """
    entries: tuple[Entry, ...] = dataclasses.field(metadata={"static": True})

    def at(self, unknowns: Float[Array, "param"]) -> Model:
        """The model at these unknowns."""
        moved = self.scale * unknowns[self.unknown]
        # The inner choice keeps an overflow of the branch not taken out of the gradient.
        factor = jnp.expm1(jnp.where(self.logarithmic, moved, 0.0))
        values = self.centre + jnp.where(self.logarithmic, (1.0 + self.centre) * factor, moved)
        _, unravel = ravel_pytree(self.model.effects)
        return eqx.tree_at(lambda m: m.effects, self.model, unravel(values))

    def values(self, unknowns: Float[np.ndarray, "*many param"]) -> Float[np.ndarray, "*many param"]:
        """Value of every entry [SI]."""
        moved, centre = (
            np.asarray(self.scale) * np.take(unknowns, np.asarray(self.unknown), axis=-1),
            np.asarray(self.centre),
        )
        factor = np.expm1(np.where(self.logarithmic, moved, 0.0))
        return centre + np.where(self.logarithmic, (1.0 + centre) * factor, moved)

    def model_at(self, unknowns: Float[np.ndarray, "param"]) -> Model:
        """`at` for known numbers, outside compiled code; without forces depending on motion, and a sweep, that are at
        their null, and without what is in one run only.
        """
        values, first = self.values(unknowns), 0
        kept: list[Any] = []
        numbers: list[list[np.ndarray]] = []
        for structure, shapes, costly, in_all_runs in _effects_of(self):
            ends = np.cumsum([first, *(math.prod(shape) for shape in shapes)])
            first = int(ends[-1])
            if not in_all_runs:
                continue
            if not costly or values[ends[0] : first].any():
                kept.append(structure)
                spans = zip(pairwise(ends), shapes, strict=True)
                numbers.append([values[a:b].reshape(shape) for (a, b), shape in spans])
        parts = jax.device_put(numbers)
        effects = tuple(jax.tree.unflatten(structure, leaves) for structure, leaves in zip(kept, parts, strict=True))
        return dataclasses.replace(self.model, effects=effects)

    def in_one_run(self) -> InOneRun:
        """Unknowns that count in one run only."""
        return _in_one_run(self)

    def with_uncertain(self, uncertain: Iterable[Uncertain]) -> "Space":
        """The same with further values declared uncertain, which then are fitted in every comparison."""
        known = {f"{u.effect}.{u.label}": u.deviation for u in uncertain}
        own = np.array([entry.key in known for entry in self.entries])
        entries = tuple(
            e._replace(declared_uncertain=True, scale=known[e.key]) if e.key in known else e for e in self.entries
        )
        return dataclasses.replace(
            self,
            entries=entries,
            scale=as_array(np.array([e.scale for e in entries], dtype=float)),
            open_size=as_array(np.where(own, -1, np.asarray(self.open_size))),
            strength=as_array(np.where(own, -1, np.asarray(self.strength))),
        )

    def given_unknowns(self) -> Float[np.ndarray, "param"]:
        """Unknowns at which the entries have the values that the model came with."""
        return _given_unknowns(self).copy()

    def coupled(self) -> Bool[np.ndarray, "param"]:
        """Unknowns of effects that make the orders depend on one another."""
        return self.of_kind(RestoringEffect | WaveformEffect)

    def is_linear_at(self, point: Float[np.ndarray, "param"]) -> bool:
        """Whether no such effect is there: what is shown is then linear in what is installed."""
        return not np.any(self.coupled() & self.there(point))

    def there(self, point: Float[np.ndarray, "param"]) -> Bool[np.ndarray, "param"]:
        """Unknowns that have a value."""
        found = np.asarray(point) != 0.0
        found[np.asarray(self.unknown)[np.asarray(self.centre) != 0.0]] = True
        return found

    def sweeping(self) -> Bool[np.ndarray, "param"]:
        """Unknowns of effects by which the speed changes."""
        return self.of_kind(SweepEffect)

    def of_kind(self, kind: type[Effect] | UnionType) -> Bool[np.ndarray, "param"]:
        """Unknowns of effects of a class."""
        names = {e.name for e in self.model.effects if isinstance(e, kind)}
        mask = np.zeros(len(self.entries), dtype=bool)
        mask[[e.unknown for e in self.entries if e.effect in names]] = True
        return mask

    def effects_of(self, mask: Bool[np.ndarray, "param"]) -> set[str]:
        """Names of the effects that these unknowns belong to."""
        return {e.effect for e in self.entries if mask[e.unknown]}

    def free(self, effects: list[str], fixed: frozenset[str] = frozenset()) -> np.ndarray:
        """Mask of the unknowns of these effects and of all that the user declared uncertain, less fixed keys."""
        mask = np.zeros(len(self.entries), dtype=bool)
        for entry in self.entries:
            if (entry.effect in effects or entry.declared_uncertain) and entry.key not in fixed:
                mask[entry.unknown] = True
        return mask

    def only_of(self, effects: Iterable[str]) -> Bool[np.ndarray, "param"]:
        """Mask of the unknowns of these effects that the user did not declare uncertain."""
        names, mask = frozenset(effects), np.zeros(len(self.entries), dtype=bool)
        for entry in self.entries:
            if entry.effect in names and not entry.declared_uncertain:
                mask[entry.unknown] = True
        return mask


class _Itself(NamedTuple):
    """A space as a key: the same only if it is the very object."""

    space: Space

    def __hash__(self) -> int:
        return id(self.space)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Itself) and other.space is self.space


def once_for_each(function: Callable[[Space], Result]) -> Callable[[Space], Result]:
    """A function of a space that is called once for each, of the last eight."""
    kept = functools.lru_cache(maxsize=8)(lambda itself: function(itself.space))
    return functools.wraps(function)(lambda space: kept(_Itself(space)))


@once_for_each
def _given_unknowns(space: Space) -> Float[np.ndarray, "param"]:
    unknowns = np.zeros(len(space.entries))
    unknowns[np.asarray(space.unknown)] = (values_of(space.model) - np.asarray(space.centre)) / np.asarray(space.scale)
    return unknowns


@once_for_each
def _in_one_run(space: Space) -> InOneRun:
    place = {(e.effect, e.label): e for e in space.entries}
    like = {e.name: e.like for e in space.model.effects if isinstance(e, OfOneRun)}
    pairs = [(e, place[like[e.effect], e.label]) for e in space.entries if e.effect in like]
    share = np.ones(len(space.entries))
    share[[own.unknown for own, _ in pairs]] = [own.scale / changed.scale for own, changed in pairs]
    own, changed = (np.array([pair[k].unknown for pair in pairs], dtype=int) for k in (0, 1))
    return InOneRun(own, changed, share)


@once_for_each
def _effects_of(space: Space) -> list[tuple[Any, list[tuple[int, ...]], bool, bool]]:
    """Of every effect its structure, the shapes of its parameters, whether it is left out where it is at its null, and
    whether it is in all runs.
    """
    found = []
    for effect in space.model.effects:
        leaves, structure = jax.tree.flatten(effect)
        costly = isinstance(effect, RestoringEffect | WaveformEffect | SweepEffect)
        found.append((structure, [leaf.shape for leaf in leaves], costly, not isinstance(effect, OfOneRun)))
    return found


def values_of(model: Model) -> Float[np.ndarray, "param"]:
    """These numbers [SI]."""
    leaves = jax.tree.leaves(model.effects)
    return np.concatenate([np.ravel(leaf) for leaf in leaves]) if leaves else np.zeros(0)


def make_space(model: Model, knowledge: Knowledge) -> Space:
    """The parameter space of a model: all entries of its effects, those of uncertain rig values among them.

    **Arguments:** ``model`` with every effect whose parameters may be freed; ``knowledge``: what the user declared
    uncertain (its effects must be in the model) and prior scales to use instead of the effects' own.
    """
    uncertain = {f"{u.effect}.{u.label}": u for u in knowledge.uncertain}
    groups: dict[str, int] = {}
    entries: list[Entry] = []
    for effect in model.effects:
        priors: Mapping[str, float] = knowledge.priors.get(effect.name, {})
        for declared in effect.parameters():
            own = priors.get(declared.name, declared.prior_scale(model.rotor))
            for label in declared.labels(model.layout):
                known = uncertain.get(f"{effect.name}.{label}")
                unknown = len(entries) if known is None else groups.setdefault(known.group, len(entries))
                scale, logarithmic = (own, False) if known is None else (known.deviation, known.logarithmic)
                entries.append(Entry(effect.name, label, scale, logarithmic, known is not None, unknown))
    declared = np.array([e.declared_uncertain for e in entries], dtype=bool)
    return Space(
        model,
        as_array(np.where(declared, values_of(model), 0.0)),
        as_array(np.array([e.scale for e in entries], dtype=float)),
        as_array(np.array([e.logarithmic for e in entries], dtype=bool)),
        as_array(np.array([e.unknown for e in entries], dtype=int)),
        as_array(_open_sizes(model, knowledge, entries)),
        as_array(_strengths(model, knowledge, entries)),
        tuple(entries),
    )


def _open_sizes(model: Model, knowledge: Knowledge, entries: list[Entry]) -> Int[np.ndarray, "param"]:
    """As in `Space.open_size`: parameters of an effect with one unit together, for they may be components of one
    vector.

    A number without a unit, like a coefficient of friction, has a size that is known beforehand, and so has what the
    user gave a scale.
    """
    sized = {e.name for e in model.effects if isinstance(e, RestoringEffect | WaveformEffect)}
    return _numbered(entries, knowledge, lambda entry: entry.effect in sized and entry.unit.si != "1")


def _strengths(model: Model, knowledge: Knowledge, entries: list[Entry]) -> Int[np.ndarray, "param"]:
    """As in `Space.strength`: all parameters of an effect with one unit together, but for those that are its shape."""
    shapes = {(e.name, p.name) for e in model.effects for p in e.parameters() if p.shape_only}
    return _numbered(entries, knowledge, lambda entry: (entry.effect, entry.parameter) not in shapes)


def _numbered(entries: list[Entry], knowledge: Knowledge, counts: Callable[[Entry], bool]) -> Int[np.ndarray, "param"]:
    """A number for every effect and unit that counts, at its unknowns, -1 elsewhere and where the user gave a scale."""
    numbers: dict[tuple[str, str], int] = {}
    found = np.full(len(entries), -1)
    for entry in entries:
        told = entry.declared_uncertain or entry.parameter in knowledge.priors.get(entry.effect, {})
        if not told and counts(entry):
            found[entry.unknown] = numbers.setdefault((entry.effect, entry.unit.si), len(numbers))
    return found
