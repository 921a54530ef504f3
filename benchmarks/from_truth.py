"""An oracle: what is hidden, fitted from its true values, beside the answer that `explain` gave.

Where the truth is less probable than the answer even so, no search in the same race could have named it: the data, or
what the model leaves out of a more detailed rotor, say otherwise. Where it is more probable, the search has missed it.
"""

import dataclasses
import itertools
import math
from typing import Any

import numpy as np

from rotorjax.discovery.contest import Contest, Effects
from rotorjax.discovery.explanation import Explanation
from rotorjax.discovery.race import contender_of, race
from rotorjax.inference.budget import Budget
from rotorjax.inference.descent import Start, descend
from rotorjax.inference.manner import THOROUGH

from scoring import needed, true


def lead_of_truth(found: Explanation, row: dict[str, Any]) -> float | None:
    """Log posterior of the most probable set that would be a right answer, less the answer's, under the noise that the
    answer leaves.

    None where there is no such set (forces outside the catalogue), or where the answer puts right another mistake, or
    none: it is then about other data. **Arguments:** ``row``: what is true, as `detailed.files.truth` tells it.
    """
    mistake = None if found.slip is None else found.slip.name
    if row["outside"] is not None or row["mistake"] != mistake:
        return None
    winner = found.ties.winner
    contest = dataclasses.replace(found.contest, budget=Budget())
    known = {**found.ties.raced, winner.effects: winner}
    sets = [names for names in _right_sets(row) if names <= set(contest.candidates)]
    fitted = race(contest, winner.noise, [winner.effects, *sets], known)
    own = contest.log_posterior(fitted[winner.effects])
    data = contest.data(winner.noise, winner.best.point)
    leads = []
    for effects in sets:
        start = Start(_at_truth(contest, effects, fitted[effects].best.point, row["values"]))
        mask, counted = contest.free(effects)[None], contest.training[None]
        ends = descend(contest.space, data, [start], mask, counted, budget=contest.budget, manner=THOROUGH)
        both = contender_of(contest, effects, [*fitted[effects].ends, *ends], winner.noise)
        leads.append(contest.log_posterior(both) - own)
    return max((lead for lead in leads if math.isfinite(lead)), default=None)


def _right_sets(row: dict[str, Any]) -> list[Effects]:
    """All that would be right: what can be seen at least, what is there at most."""
    least = needed(row) - {row["mistake"]}
    further = sorted(true(row) - {row["mistake"]} - least)
    sizes = range(len(further) + 1)
    return [least | set(more) for size in sizes for more in itertools.combinations(further, size)]


def _at_truth(contest: Contest, effects: Effects, point: np.ndarray, values: dict[str, float]) -> np.ndarray:
    """A point with the true values of some effects, as far as they are known."""
    moved = np.array(point)
    for entry in contest.space.entries:
        if entry.effect in effects and entry.key in values and not entry.declared_uncertain:
            moved[entry.unknown] = values[entry.key] / entry.scale
    return moved
