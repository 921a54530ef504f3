"""The error on data held out, with the selection of effects redone on the rest."""

import dataclasses
import itertools
import math
from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool

from rotorjax.discovery.race import Contest, Effects, Known, contender_of
from rotorjax.discovery.search import NOTHING, PRICE, WORTH_TRYING, Selection
from rotorjax.discovery.ties import Ties
from rotorjax.inference.data import make_folds, residual_vectors
from rotorjax.inference.descent import QUICK, End, Start, best_of, descend
from rotorjax.inference.noise import Noise


class HeldOut(NamedTuple):
    """Root mean square |residual| of data predicted without them, at every step [m]; none with the reason why."""

    rms: tuple[float | None, ...]
    reason: str


def held_out(contest: Contest, selection: Selection, ties: Ties) -> HeldOut:
    """Leave out groups of runs or of speeds in turn; select effects and fit on the rest; predict what was left out.

    Each fold makes its own choice among all sets that come near the answer on the whole data, and parts of it; at the steps before the
    last one it adds of these effects what explains the most. **Arguments:** ``ties``: what was fitted in the place of the answer.
    """
    final = selection.known[selection.present].best
    folds, reason = make_folds(contest.measurement, np.einsum("cmp,cmq->cpq", final.local.slopes, final.local.slopes))
    if not len(folds):
        return HeldOut((None,) * len(selection.races), reason)
    near = _near(contest, selection, ties)
    known, small = {**selection.known, **ties.raced}, frozenset(selection.small)
    last = _Folds(contest, known, selection.present, selection.races[-1].noise, folds)
    last.fit(dict.fromkeys(range(len(folds)), near))
    chosen = [last.chosen(fold) for fold in range(len(folds))]
    errors, shown = [], [NOTHING] * len(folds)
    for step in selection.races[:-1]:
        fits = _Folds(contest, known, selection.present, step.noise, folds)
        further = {fold: [now | {name} for name in chosen[fold] - now - small] for fold, now in enumerate(shown)}
        fits.fit({fold: [now, *further[fold]] for fold, now in enumerate(shown)})
        errors.append(fits.error(shown))
        shown = [fits.best(fold, further[fold] or [now]) for fold, now in enumerate(shown)]
    return HeldOut((*errors, last.error(chosen)), "")


def _near(contest: Contest, selection: Selection, ties: Ties) -> list[Effects]:
    """The answer, its parts, and what comes near it on the whole data: beside it, and in the place of parts of it."""
    answer, race = selection.present, selection.races[-1]
    parts = [frozenset(part) for size in range(len(answer) + 1) for part in itertools.combinations(sorted(answer), size)]
    beside = [e for e, c in race.contenders.items() if c.log_evidence > race.contenders[answer].log_evidence - WORTH_TRYING]
    instead = [e for e, c in ties.raced.items() if c.log_evidence > ties.winner.log_evidence - WORTH_TRYING]
    return [e for e in dict.fromkeys((*parts, *beside, *instead)) if len(e) <= max(selection.most + len(selection.small), len(answer))]


class _Folds:
    """All folds under one noise: their fits, and the choice that each makes."""

    def __init__(self, contest: Contest, known: Known, answer: Effects, noise: Noise, folds: Bool[np.ndarray, "fold case"]) -> None:
        self.contest, self.known, self.noise, self.folds = contest, known, noise, folds
        self.data = contest.data(noise, known[answer].best.point)
        self.ends: list[dict[Effects, End]] = [{} for _ in folds]

    def fit(self, wanted: Mapping[int, Iterable[Effects]]) -> None:
        """Fit sets of effects to the rest of each fold, all in the same compiled calls."""
        keys = [(fold, effects) for fold, sets in wanted.items() for effects in sets if effects not in self.ends[fold]]
        tasks = [(fold, effects, start) for fold, effects in keys for start in self._starts(effects)]
        if not tasks:
            return
        masks = np.stack([self.contest.free(effects) for _, effects, _ in tasks])
        training = np.stack([~self.folds[fold] for fold, _, _ in tasks])
        starts = [start for *_, start in tasks]
        found = descend(self.contest.space, self.data, starts, masks, training, budget=self.contest.budget, manner=QUICK)
        for (fold, effects, _), end in zip(tasks, found, strict=True):
            self.ends[fold][effects] = best_of([end, *([self.ends[fold][effects]] if effects in self.ends[fold] else [])])

    def _starts(self, effects: Effects) -> list[Start]:
        """Optima on all data to begin with: of the same set, or of the nearest one."""
        if effects in self.known:
            return [Start.at(end) for end in self.known[effects].ends[:2]]
        nearest = self.known[min(self.known, key=lambda other: (len(other ^ effects), -self.known[other].log_evidence))].best
        return [Start.at(nearest)._replace(point=np.where(self.contest.free(effects), nearest.point, self.contest.space.given_unknowns()))]

    def error(self, bases: list[Effects]) -> float:
        """Root mean square |residual| of each fold's own set on what was left out [m]."""
        squares, cells = 0.0, 0
        for fold, left_out in enumerate(self.folds):
            counted = self.contest.measurement.present & left_out[:, None, None]
            residual = residual_vectors(self.ends[fold][bases[fold]].local.error, self.data)
            squares, cells = squares + float(np.sum(np.abs(residual[counted]) ** 2)), cells + int(counted.sum())
        return math.sqrt(squares / cells)

    def scores(self, fold: int) -> dict[Effects, float]:
        """Log evidence plus log prior odds of everything fitted to a fold's rest."""
        unknown = self.noise.allowance > self.contest.floor.allowance
        size = dataclasses.replace(self.contest, training=~self.folds[fold]).independent_numbers() if unknown else None
        return {e: contender_of(e, [end], size).log_evidence + self.contest.log_odds(e) for e, end in self.ends[fold].items()}

    def best(self, fold: int, sets: Iterable[Effects]) -> Effects:
        """The most probable of some sets that were fitted."""
        scores = self.scores(fold)
        return max(sets, key=lambda effects: scores[effects])

    def chosen(self, fold: int) -> Effects:
        """The most probable set of a fold, less what can be left out at no more than the price of a detection."""
        return _pruned(self.scores(fold))


def _pruned(scores: dict[Effects, float]) -> Effects:
    """The best set, less what can be left out at no more than the price of a detection."""
    best = max(scores, key=lambda effects: scores[effects])
    while smaller := [e for e in scores if e < best and len(e) == len(best) - 1 and scores[best] - scores[e] <= PRICE]:
        best = max(smaller, key=lambda effects: scores[effects])
    return best
