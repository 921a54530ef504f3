"""The balance of forces of a rotor along given motions, at many values of all that may act on it."""

import dataclasses
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from rotorjax.arrays import as_array
from rotorjax.data.knowledge import Knowledge
from rotorjax.effects import CATALOG
from rotorjax.effects.terms import TERMS
from rotorjax.inference.kernels import Kernels, Rows
from rotorjax.inference.programs import MOST_ROWS
from rotorjax.inference.space import make_space, values_of
from rotorjax.model.conditions import Conditions
from rotorjax.model.model import Model


class Balances(NamedTuple):
    """D q + N(q) - F [N], and its derivative by the motion; for every set of values, in every case."""

    force: Float[np.ndarray, "set case equation"]
    by_motion: Float[np.ndarray, "set case equation equation"]


class ForceBalance:
    """All forces of the catalogue and all terms, with those of a model."""

    def __init__(self, model: Model) -> None:
        full = dataclasses.replace(model, slow_roll=None).with_null_effects((CATALOG | TERMS).values())
        space = make_space(full, Knowledge())
        self.index = {(entry.effect, entry.label): k for k, entry in enumerate(space.entries)}
        """Effect and label of every value."""
        self.values = values_of(full)
        """Of the model."""
        # Unknowns that are the values themselves.
        self._kernels = Kernels(dataclasses.replace(space, scale=as_array(np.ones(len(space.entries)))))

    def make(self, conditions: Conditions) -> None:
        """Make its programs for conditions like these, as far as no fit has made them."""
        for make in self._kernels.balanced_makers(conditions):
            make()

    def at(
        self,
        values: Float[np.ndarray, "set param"],
        conditions: Conditions,
        motion: Float[np.ndarray, "case dof coefficient"],
        measured: Int[np.ndarray, "_"],
    ) -> Balances:
        """Along a motion at every case. **Arguments:** ``measured``: the coefficients whose equations count, and by
        which derivatives are taken.
        """
        most = max(1, MOST_ROWS // len(motion))
        parts = [
            self._at(values[first : first + most], conditions, motion, measured)
            for first in range(0, len(values), most)
        ]
        return Balances(*(np.concatenate(several) for several in zip(*parts, strict=True)))

    def _at(self, values: np.ndarray, conditions: Conditions, motion: np.ndarray, measured: np.ndarray) -> Balances:
        """In the same compiled calls."""
        cases = np.tile(np.arange(len(motion)), len(values))
        each = (np.asarray(leaf)[cases] for leaf in (conditions.speed, conditions.unbalance, conditions.bow))
        rows = Rows.without_slopes(np.repeat(values, len(motion), axis=0), *each)
        found = self._kernels.balanced(rows, motion[cases], swept=False)
        directions, coefficients = motion.shape[1:]
        force = found.force.reshape(-1, directions, coefficients)[..., measured]
        by_motion = found.force_by_motion.reshape(-1, directions, coefficients, directions, coefficients)
        by_motion = by_motion[:, :, measured][..., measured]
        count = directions * len(measured)
        return Balances(
            force.reshape(len(values), len(motion), count), by_motion.reshape(len(values), len(motion), count, count)
        )
