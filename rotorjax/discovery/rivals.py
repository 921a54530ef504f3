"""Would another effect have done as well? One-for-one swaps of the fitted effects with their known relatives."""

import math
from typing import NamedTuple

import numpy as np

from rotorjax.discovery.fit import Fit
from rotorjax.inference.data import Data, declared_starts, make_data, residual_vectors
from rotorjax.inference.descent import best_of, descend, starts_at
from rotorjax.inference.noise import Noise

TIE = 3.0
"""Difference in log posterior below which two explanations are not told apart by the data."""


class Rival(NamedTuple):
    """A fit with one effect swapped for another, or left out."""

    effect: str
    instead: str | None
    """None: the effect was left out and nothing put in its place."""
    rms: float
    """Root mean square |residual| then [m]."""
    loss: float
    """Log posterior lost by the swap; negative if the rival fits better, infinite where its motions do not balance."""

    @property
    def tied(self) -> bool:
        """Whether the data leave this open."""
        return self.loss < TIE


def rivals(fitted: Fit) -> list[Rival]:
    """Swap every fitted effect for each of its known relatives, and leave each out, and fit again.

    The noise stays what the fit found, all other parameters are fitted along, from the optimum and from the declared
    starts; nothing is compiled anew. **Returns** the rivals, for every effect the nearest first.
    """
    space, measurement = fitted.stage.space, fitted.stage.measurement
    data = make_data(measurement, space.model_at(fitted.end.point), Noise(fitted.misfit))
    present = {e.name: type(e) for e in space.model.effects}
    found = []
    for name in fitted.free:
        if not fitted.stage.space.only_of([name]).any():
            continue  # declared uncertain: fitted whatever is added
        others = [n for n in fitted.free if n != name]
        candidates = [r for r in present[name].relatives if r in present and r not in fitted.stage.keep]
        swaps = [_swapped(fitted, data, name, others, rival) for rival in [None, *candidates]]
        found += sorted(swaps, key=lambda rival: rival.loss)
    return found


def _swapped(fitted: Fit, data: Data, name: str, others: list[str], instead: str | None) -> Rival:
    space = fitted.stage.space
    own = space.only_of([name])
    free = space.free([*others, instead] if instead else others) & ~own
    from_here = fitted.end.point.copy()
    from_here[own] = 0.0
    starts = declared_starts(space, free, fitted.stage.measurement)
    starts = np.concatenate([np.where(starts != 0.0, starts, from_here), starts])
    null = np.where(own, 0.0, space.given_unknowns())
    training = np.ones((len(starts), len(fitted.stage.measurement.run)), bool)
    best = best_of(
        descend(
            space, data, starts_at(np.where(free, starts, null)), free, training, budget=fitted.stage.budget, kept=null
        )
    )
    left = residual_vectors(best.local.error, data)[fitted.stage.measurement.present]
    rms = float(np.sqrt(np.mean(np.abs(left) ** 2)))
    return Rival(name, instead, rms, best.cost - fitted.end.cost if best.exact else math.inf)
