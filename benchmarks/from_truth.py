"""An oracle: what is hidden, fitted from its true values, beside the answer that `explain` gave.

Where the truth is less probable than the answer even so, no search in the same race could have named it: the data, or
what the model leaves out of a more detailed rotor, say otherwise. Where it is more probable, the search has missed it.
What each thing hidden brings is told once more, with the parameters of all others fitted anew without it: an unbalance
beside a bow may improve chi-square by 500 and be replaced, all but 5, by a slightly larger bow.
"""

import dataclasses
import itertools
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from rotorjax import read_measurement, read_rig
from rotorjax.discovery.contest import Contender, Contest, Effects, Known
from rotorjax.discovery.explanation import Explanation
from rotorjax.discovery.race import contender_of, race
from rotorjax.inference.budget import Budget
from rotorjax.inference.descent import Start, descend
from rotorjax.inference.descent_settings import THOROUGH
from rotorjax.inference.noise import Noise

from detailed.case import Case
from detailed.files import write_case
from scoring import needed, true


def against_truth(found: Explanation, row: dict[str, Any]) -> dict[str, Any]:
    """The truth in the race that `explain` ran, under the noise that the answer leaves.

    **Returns** ``lead_of_truth``: log posterior of the most probable set that would be a right answer, less the
    answer's; ``brings``: what each effect hidden that this set has improves chi-square by, the others fitted anew
    without it. None where there is no such set (forces outside the catalogue), or where the answer puts right another
    mistake, or none: it is then about other data. **Arguments:** ``row``: what is true, as `detailed.files.truth` tells
    it.
    """
    mistake = None if found.mistake is None else found.mistake.name
    if row["outside"] is not None or row["mistake"] != mistake:
        return {"lead_of_truth": None, "brings": None}
    contest = dataclasses.replace(found.contest, budget=Budget())
    winner = found.ties.winner
    known = {**found.ties.raced, winner.effects: winner}
    sets = [names for names in _right_sets(row) if names <= set(contest.candidates)]
    fitted = _from_truth(contest, winner.noise, [winner.effects, *sets], known, row["values"])
    best = max(sets, key=lambda names: contest.log_posterior(fitted[names]), default=None)
    if best is None or not (fitted[best].balanced and fitted[winner.effects].balanced):
        return {"lead_of_truth": None, "brings": None}
    lead = contest.log_posterior(fitted[best]) - contest.log_posterior(fitted[winner.effects])
    parts = sorted(best & set(row["effects"]))
    without = _from_truth(contest, winner.noise, [best - {name} for name in parts], fitted, row["values"])
    least = _chi_square(contest, fitted[best])
    brings = {name: _chi_square(contest, without[best - {name}]) - least for name in parts}
    return {"lead_of_truth": lead, "brings": brings}


def left_by_answer(case: Case, found: Explanation) -> float | None:
    """Chi-square that the answer leaves when it is fitted to the vectors without their noise: what tells it, at these
    readings, from a force that the catalogue does not have. None where that is not what was hidden, or not explained.
    """
    if case.outside is None or found.verdict != "explained" or found.mistake is not None:
        return None
    with tempfile.TemporaryDirectory() as folder:
        quiet = dataclasses.replace(case, vectors=case.bench.settled(case.plant))
        rig_file, table = write_case(quiet, Path(folder))
        measurement = read_measurement(table, read_rig(rig_file))
    vectors = measurement.vectors[:, :, [measurement.orders.index(n) for n in found.contest.measurement.orders]]
    own = dataclasses.replace(found.contest.measurement, vectors=vectors)
    contest, winner = dataclasses.replace(found.contest, budget=Budget(), measurement=own), found.ties.winner
    again = race(contest, winner.noise, [winner.effects], {winner.effects: winner._replace(foreseen=True)})
    return _chi_square(contest, again[winner.effects])


def _from_truth(
    contest: Contest, noise: Noise, sets: list[Effects], known: Known, values: Mapping[str, float]
) -> Known:
    """Sets fitted from what is known and from the true values, whichever leads further."""
    fitted = race(contest, noise, sets, known)
    for effects in sets:
        start = Start(_at_truth(contest, effects, fitted[effects].best.point, values))
        data = contest.data(noise, start.point)
        mask, counted = contest.free(effects)[None], contest.training[None]
        ends = descend(contest.space, data, [start], mask, counted, budget=contest.budget, settings=THOROUGH)
        fitted[effects] = contender_of(contest, effects, [*fitted[effects].ends, *ends], noise)
    return fitted


def _chi_square(contest: Contest, contender: Contender) -> float:
    """Of the data, and of what the rig file calls uncertain."""
    end = contender.best
    uncertain = [e.unknown for e in contest.space.entries if e.declared_uncertain]
    return 2.0 * end.data_cost + float(np.sum(end.point[uncertain] ** 2))


def _right_sets(row: dict[str, Any]) -> list[Effects]:
    """All that would be right: what can be seen at least, what is there at most."""
    least = needed(row) - {row["mistake"]}
    further = sorted(true(row) - {row["mistake"]} - least)
    sizes = range(len(further) + 1)
    return [least | set(more) for size in sizes for more in itertools.combinations(further, size)]


def _at_truth(contest: Contest, effects: Effects, point: np.ndarray, values: Mapping[str, float]) -> np.ndarray:
    """A point with the true values of some effects, as far as they are known."""
    moved = np.array(point)
    for entry in contest.space.entries:
        if entry.effect in effects and entry.key in values and not entry.declared_uncertain:
            moved[entry.unknown] = values[entry.key] / entry.scale
    return moved
