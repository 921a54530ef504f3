"""The error on data held out, with the selection of effects redone on the rest."""

import dataclasses
import math
from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool

from rotorjax.discovery.race import Contest, Effects, contender_of
from rotorjax.discovery.search import NOTHING, PAIRED, PRICE, WORTH_TRYING, Selection, neighbours
from rotorjax.inference.data import make_folds, residual_vectors
from rotorjax.inference.descent import QUICK, End, Start, best_of, descend


class HeldOut(NamedTuple):
    """Root mean square |residual| of data predicted without them, at every step [m]; none with the reason why."""

    rms: tuple[float | None, ...]
    reason: str


def held_out(contest: Contest, selection: Selection) -> HeldOut:
    """Leave out groups of runs or of speeds in turn; select effects and fit on the rest; predict what was left out.

    Each fold makes its own choice at every step, swaps and pairs included, under the noise of that step, among all
    effects that come near the best on the whole data. Where it finds "none" probable it adds nothing.
    """
    final = selection.known[selection.present].best
    folds, reason = make_folds(contest.measurement, np.einsum("cmp,cmq->cpq", final.local.slopes, final.local.slopes))
    if not len(folds):
        return HeldOut((None,) * len(selection.races), reason)
    chosen = _chosen(contest, selection, folds)
    shown: list[Effects] = [NOTHING] * len(folds)
    errors = []
    for step in range(len(selection.races)):
        fits = _Folds(contest, selection, step, folds)
        if step == len(selection.races) - 1:
            shown = [own | frozenset(selection.small) for own in chosen]
        fits.fit({fold: [now, *(now | {name} for name in chosen[fold] - now)] for fold, now in enumerate(shown)})
        errors.append(fits.error(shown))
        shown = [fits.best(fold, [now | {name} for name in chosen[fold] - now] or [now]) for fold, now in enumerate(shown)]
    return HeldOut(tuple(errors), "")


def _chosen(contest: Contest, selection: Selection, folds: Bool[np.ndarray, "fold case"]) -> list[Effects]:
    """The set that each fold selects, with as many steps as the selection on all data."""
    chosen: list[Effects] = [NOTHING] * len(folds)
    going = [True] * len(folds)
    for step in range(len(selection.races) - 1):
        fits = _Folds(contest, selection, step, folds)
        names = fits.near()
        fits.fit({fold: [own, *(own | {name} for name in names if name not in own)] for fold, own in enumerate(chosen) if going[fold]})
        added = [fits.added(fold, own) if going[fold] else own for fold, own in enumerate(chosen)]
        going = [now != own for now, own in zip(added, chosen, strict=True)]
        chosen = fits.refined(names, chosen, added)
    return chosen


class _Folds:
    """All folds at one step: their fits, and the choice that each makes."""

    def __init__(self, contest: Contest, selection: Selection, step: int, folds: Bool[np.ndarray, "fold case"]) -> None:
        self.contest, self.selection, self.folds, self.race = contest, selection, folds, selection.races[step]
        self.data = contest.data(self.race.noise, selection.known[selection.present].best.point)
        self.ends: list[dict[Effects, End]] = [{} for _ in folds]

    def near(self) -> list[str]:
        """The effects that come near the best on the whole data, and those of the answer."""
        best = max(c.log_evidence for c in self.race.contenders.values())
        smallest = min(self.race.contenders, key=len)
        close = (effects - smallest for effects, c in self.race.contenders.items() if c.log_evidence > best - WORTH_TRYING)
        return sorted({name for names in close for name in names} | set(self.selection.effects))

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
        known = self.selection.known
        if effects in known:
            return [Start.at(end) for end in known[effects].ends[:2]]
        nearest = min(known, key=lambda other: (len(other ^ effects), -known[other].log_evidence))
        point = np.where(self.contest.free(effects), known[nearest].best.point, self.contest.space.given_unknowns())
        return [Start.at(known[nearest].best)._replace(point=point)]

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
        unknown = self.race.noise.allowance > self.contest.floor.allowance
        size = dataclasses.replace(self.contest, training=~self.folds[fold]).independent_numbers() if unknown else None
        return {e: contender_of(e, [end], size).log_evidence + self.contest.log_odds(e) for e, end in self.ends[fold].items()}

    def best(self, fold: int, sets: Iterable[Effects]) -> Effects:
        """The most probable of some sets that were fitted."""
        scores = self.scores(fold)
        return max(sets, key=lambda effects: scores[effects])

    def added(self, fold: int, own: Effects) -> Effects:
        """A fold's set with what it adds: the same if it adds nothing."""
        scores = self.scores(fold)
        best = max(scores, key=lambda effects: scores[effects])
        return own if scores[best] - scores[own] < PRICE else best

    def refined(self, names: list[str], before: list[Effects], added: list[Effects]) -> list[Effects]:
        """For each fold the best of all swaps in the set with what was added and of all pairs, less what is not needed."""
        pools = {}
        for fold, (own, now) in enumerate(zip(before, added, strict=True)):
            if now != own and (len(now) > 1 or self.race.noise.allowance > self.contest.floor.allowance):
                scores = self.scores(fold)
                best = sorted((name for name in names if name not in own), key=lambda name: -scores[own | {name}])[:PAIRED]
                pools[fold] = [e for e in self.contest.lean(neighbours(names, own, now, best), now, ()) if len(e) <= self.selection.most]
        self.fit(pools)
        return [_pruned(self.scores(fold)) if fold in pools else now for fold, now in enumerate(added)]


def _pruned(scores: dict[Effects, float]) -> Effects:
    """The best set, less what can be left out at no more than the price of a detection."""
    best = max(scores, key=lambda effects: scores[effects])
    while smaller := [e for e in scores if e < best and len(e) == len(best) - 1 and scores[best] - scores[e] <= PRICE]:
        best = max(smaller, key=lambda effects: scores[effects])
    return best
