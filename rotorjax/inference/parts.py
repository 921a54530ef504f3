"""Parts of a parameter space: compiled code that knows some of the effects only depends on those only."""

import dataclasses
import functools
from collections.abc import Iterable
from typing import Any, NamedTuple

import jax
import numpy as np
from jax import Array
from jaxtyping import Float, Int

from rotorjax.arrays import as_array
from rotorjax.inference.programs import nameless
from rotorjax.inference.space import Space
from rotorjax.model.conditions import Layout
from rotorjax.model.contract import Effect
from rotorjax.model.model import with_null_effects


class Part(NamedTuple):
    """Some effects of a space, and where their unknowns are in the whole."""

    space: Space
    """Of these effects alone, without names of probes and planes."""
    source: Int[np.ndarray, "own"]
    """Of every unknown the one in the whole; -1 for what is not there, and at its null."""
    place: Int[np.ndarray, "param_and_none"]
    """Of every unknown in the whole the own one; -1 for what is not here, and at the end for none."""

    @classmethod
    def of(
        cls, space: Space, names: Iterable[str], orders: tuple[float, ...], null_effects: Iterable[type[Effect]] = ()
    ) -> "Part":
        """The effects of these names, for some orders. **Arguments:** ``null_effects``: classes of effects that
        are there at their null, too.
        """
        whole = nameless(space.model)
        structure = jax.tree.structure(whole.effects)
        effects, entry = _frame(structure, whole.layout, frozenset(names), orders, tuple(null_effects))
        there = entry >= 0

        def known(of_whole: Array, otherwise: int) -> np.ndarray:
            values = np.asarray(of_whole)
            found = np.full(len(entry), otherwise, values.dtype)
            found[there] = values[entry[there]]
            return found

        source = known(space.unknown, -1)
        first = {unknown: k for k, unknown in reversed(list(enumerate(source))) if unknown >= 0}
        unknown = np.array([first.get(u, k) for k, u in enumerate(source)], dtype=int)
        place = np.full(len(space.centre) + 1, -1)
        place[list(first)] = list(first.values())
        model = dataclasses.replace(whole, layout=whole.layout._replace(orders=orders), effects=effects)
        centre, scale, logarithmic = (
            as_array(known(of_whole, 0)) for of_whole in (space.centre, space.scale, space.logarithmic)
        )
        none = as_array(np.full(len(entry), -1))
        return cls(Space(model, centre, scale, logarithmic, as_array(unknown), none, none, ()), source, place)

    def unknowns(self, whole: Float[np.ndarray, "row param"]) -> Float[np.ndarray, "row own"]:
        """These of the unknowns of the whole."""
        # Not by an index, which would leave them column by column in memory.
        return np.where(self.source >= 0, np.take(whole, self.source, axis=1), 0.0)

    def columns(self, wanted: Int[np.ndarray, "row column"]) -> Int[np.ndarray, "row column"]:
        """The own numbers of unknowns by which slopes are wanted; -1 for none."""
        return self.place[wanted]

    def changes(
        self, own: Float[np.ndarray, "row own"], columns: Int[np.ndarray, "row column"]
    ) -> Float[np.ndarray, "row column own"]:
        """Slopes of every value by these unknowns."""
        space, unknown = self.space, np.asarray(self.space.unknown)
        scale, logarithmic = np.asarray(space.scale), np.asarray(space.logarithmic)
        growth = (1.0 + np.asarray(space.centre)) * np.exp(
            np.where(logarithmic, scale * np.take(own, unknown, axis=1), 0.0)
        )
        slopes = scale * np.where(logarithmic, growth, 1.0)
        return slopes[:, None, :] * (columns[..., None] == unknown)


@functools.lru_cache(maxsize=64)
def _frame(
    structure: Any,
    layout: Layout,
    names: frozenset[str],
    orders: tuple[float, ...],
    null_effects: tuple[type[Effect], ...],
) -> tuple[tuple[Effect, ...], Int[np.ndarray, "own"]]:
    """The effects of a part, at their null, and of each of their numbers the entry in the whole, or -1. **Arguments:**
    ``structure``: of all effects, as a pytree.
    """
    every: tuple[Effect, ...] = structure.unflatten([None] * structure.num_leaves)
    own, new = tuple(effect for effect in every if effect.name in names), layout._replace(orders=orders)
    nothing = [as_array(np.zeros(p.shape(new))) for effect in own for p in effect.parameters()]
    effects = with_null_effects(jax.tree.structure(own, is_leaf=_is_none).unflatten(nothing), null_effects, new)
    old = {label: k for k, label in enumerate(_labels(every, layout))}
    return effects, np.array([old.get(label, -1) for label in _labels(effects, new)], dtype=int)


def _is_none(leaf: object) -> bool:
    return leaf is None


def _labels(effects: tuple[Effect, ...], layout: Layout) -> list[tuple[str, str]]:
    """Effect and label of every number of every effect."""
    return [(e.name, label) for e in effects for p in e.parameters() for label in p.labels(layout)]
