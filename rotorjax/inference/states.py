"""Conditions at which the motion of a rotor is balanced: every case, and slow roll where that was subtracted."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from rotorjax.inference.data import Data
from rotorjax.model.conditions import Conditions


class States(NamedTuple):
    """Conditions whose motions are balanced: those of every case, then, where slow roll was subtracted, of each set of
    what is installed there.
    """

    speed: Float[np.ndarray, "state"]
    """[rad/s], with what is installed: see `rotorjax.model.Conditions`."""
    unbalance: Float[np.ndarray, "state plane dof"]
    bow: Float[np.ndarray, "state dof"]
    sweep: Float[np.ndarray, "state"]
    rolling: Int[np.ndarray, "case"] | None
    """Of every case the state at slow roll that its vectors are less, if any."""
    odd: Bool[np.ndarray, "state"]
    """As in `Data`."""

    @classmethod
    def of(cls, conditions: Conditions | Data, slow_roll: float | None) -> "States":
        """Of every condition."""
        speed, unbalance, bow = (
            np.asarray(values) for values in (conditions.speed, conditions.unbalance, conditions.bow)
        )
        given = isinstance(conditions, Conditions)
        sweep, odd = (conditions.sweeps, np.zeros(len(speed), bool)) if given else (conditions.sweep, conditions.odd)
        if slow_roll is None:
            return cls(speed, unbalance, bow, sweep, None, odd)
        installed = np.concatenate([unbalance.reshape(len(speed), -1), bow, odd[:, None]], axis=1)
        _, first, which = np.unique(installed, axis=0, return_index=True, return_inverse=True)
        slow = np.full(len(first), slow_roll)
        rolling = len(speed) + which.reshape(-1)
        return cls(
            np.concatenate([speed, slow]),
            np.concatenate([unbalance, unbalance[first]]),
            np.concatenate([bow, bow[first]]),
            np.concatenate([sweep, np.zeros(len(first))]),
            rolling,
            np.concatenate([odd, odd[first]]),
        )

    def seen_in(self, cases: Int[np.ndarray, "near"]) -> Int[np.ndarray, "one"]:
        """The states of some cases, then theirs at slow roll."""
        return cases if self.rolling is None else np.concatenate([cases, np.unique(self.rolling[cases])])

    def read(
        self, values: Float[np.ndarray, "one *cell"], cases: Int[np.ndarray, "near"]
    ) -> Float[np.ndarray, "near *cell"]:
        """What is at some cases less what is at slow roll. **Arguments:** ``values`` in the states of `seen_in`."""
        if self.rolling is None:
            return values
        rolling = self.rolling[cases]
        return values[: len(cases)] - values[len(cases) + np.searchsorted(np.unique(rolling), rolling)]

    def everywhere(self, good: Bool[np.ndarray, "state"]) -> Bool[np.ndarray, "case"]:
        """Cases all of whose states are good."""
        return good if self.rolling is None else good[: len(self.rolling)] & good[self.rolling]
