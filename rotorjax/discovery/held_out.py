"""The error on data held out, with the selection of effects redone on the rest."""

import dataclasses
import itertools
import math
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool

from rotorjax.discovery.contest import Contest, Effects, Known
from rotorjax.discovery.race import WORTH_TRYING, anew, contender_of
from rotorjax.discovery.ranking import PRICE
from rotorjax.discovery.search import NOTHING, Selection
from rotorjax.discovery.ties import Ties
from rotorjax.inference.data import make_folds, residual_vectors
from rotorjax.inference.descent import End, Start, best_of, descend
from rotorjax.inference.descent_settings import QUICK
from rotorjax.inference.influence import CLEAR, influenced
from rotorjax.inference.noise import Noise


class HeldOut(NamedTuple):
    """Root mean square |residual| of data predicted without them, at every step [m]; none with the reason why."""

    rms: tuple[float | None, ...]
    reason: str


def held_out(contest: Contest, selection: Selection, ties: Ties) -> HeldOut:
    """Leave out groups of runs or of speeds in turn; select effects and fit on the rest; predict what was left out.

    Each fold makes its own choice among all sets that come near the answer on the whole data, and parts of it; at the
    steps before the last one it adds of these effects what explains the most. **Arguments:** ``ties``: what was fitted
    in the place of the answer.
    """
    final = selection.known[selection.present].best
    folds, reason = make_folds(contest.measurement, np.einsum("cmp,cmq->cpq", final.local.slopes, final.local.slopes))
    if not len(folds):
        return HeldOut((None,) * len(selection.races), reason)
    near = _near(selection, ties)
    known, small = {**selection.known, **ties.raced}, frozenset(selection.small)
    last = _Folds(contest, known, selection.present, selection.races[-1].noise, folds)
    chosen = last.choose([near] * len(folds), _pruned)
    errors, shown = [], [NOTHING] * len(folds)
    for step in selection.races[:-1]:
        fits = _Folds(contest, known, selection.present, step.noise, folds)
        fits.choose([[now] for now in shown], _most_probable)
        errors.append(fits.error(shown))
        further = [[now | {name} for name in chosen[fold] - now - small] for fold, now in enumerate(shown)]
        shown = fits.choose([several or [now] for several, now in zip(further, shown, strict=True)], _most_probable)
    return HeldOut((*errors, last.error(chosen)), "")


def _near(selection: Selection, ties: Ties) -> list[Effects]:
    """The answer, its parts, and what comes near it on the whole data: beside it, and in the place of parts of it."""
    answer, race = selection.present, selection.races[-1]
    parts = [
        frozenset(part) for size in range(len(answer) + 1) for part in itertools.combinations(sorted(answer), size)
    ]
    beside = [
        e for e, c in race.contenders.items() if c.log_evidence > race.contenders[answer].log_evidence - WORTH_TRYING
    ]
    instead = [e for e, c in ties.raced.items() if c.log_evidence > ties.winner.log_evidence - WORTH_TRYING]
    return [
        e
        for e in dict.fromkeys((*parts, *beside, *instead))
        if len(e) <= max(selection.most + len(selection.small), len(answer))
    ]


Scores = dict[Effects, float]
"""Log evidence plus log prior odds."""


class _Folds:
    """All folds under one noise: their fits, and the choice that each makes.

    What the whole data's fits say of a fold to first order (`rotorjax.inference.influence`) rules out most sets; those
    that may be chosen are fitted without it.
    """

    def __init__(
        self, contest: Contest, known: Known, answer: Effects, noise: Noise, folds: Bool[np.ndarray, "fold case"]
    ) -> None:
        self.contest, self.known, self.noise, self.folds = contest, dict(known), noise, folds
        self.data = contest.data(noise, known[answer].best.point)
        self.rests = [dataclasses.replace(contest, training=~left_out) for left_out in folds]
        self.whole: dict[Effects, list[End]] = {}
        self.first: list[dict[Effects, End]] = [{} for _ in folds]
        self.fitted: list[dict[Effects, End]] = [{} for _ in folds]
        self.scored: list[dict[Effects, tuple[End, float]]] = [{} for _ in folds]

    def choose(self, wanted: Sequence[Sequence[Effects]], choice: Callable[[Scores], Effects]) -> list[Effects]:
        """What each fold chooses among some sets."""
        self._on_all(dict.fromkeys(itertools.chain(*wanted)))
        while tasks := [
            (fold, effects) for fold, sets in enumerate(wanted) for effects in self._doubtful(fold, sets, choice)
        ]:
            ends = self._descended(
                [
                    (effects, Start.at(end), self.rests[fold].training)
                    for fold, effects in tasks
                    for end in self.whole[effects]
                ]
            )
            for fold, effects in tasks:
                self.fitted[fold][effects] = best_of([ends.pop(0) for _ in self.whole[effects]])
        return [choice(self._scores(fold, sets)) for fold, sets in enumerate(wanted)]

    def _on_all(self, sets: Iterable[Effects]) -> None:
        """All data's fits of sets of effects, to first order where they were made under another noise; and each fold
        taken out of them so.
        """
        new = [effects for effects in sets if effects not in self.whole]
        again = {e for e in new if e not in self.known or not self.known[e].balanced}
        again.update(anew(self.contest, self.noise, [e for e in new if e not in again], self.known, lambda _: False))
        self.whole.update({e: list(self.known[e].ends[:2]) for e in new if e not in again})
        tasks = [(effects, start) for effects in new if effects in again for start in self._starts(effects)]
        ends = self._descended([(effects, start, self.contest.training) for effects, start in tasks])
        for (effects, _), end in zip(tasks, ends, strict=True):
            self.whole.setdefault(effects, []).append(end)
        for effects in new:
            for fold, rest in enumerate(self.rests):
                every = [influenced(self.data, end, rest.training) for end in self.whole[effects]]
                self.first[fold][effects] = best_of(every)

    def _doubtful(self, fold: int, sets: Sequence[Effects], choice: Callable[[Scores], Effects]) -> list[Effects]:
        """Those that are not fitted without a fold and may be its choice, or decide it."""
        scores, first = self._scores(fold, sets), self.first[fold]
        least, chosen = max(scores.values()) - PRICE - CLEAR, choice(scores)

        def doubtful(effects: Effects) -> bool:
            near = effects == chosen or scores[effects] > least or not first[effects].exact
            return near or choice({**scores, effects: scores[effects] + CLEAR}) == effects

        return [effects for effects in sets if effects not in self.fitted[fold] and doubtful(effects)]

    def _descended(self, tasks: list[tuple[Effects, Start, np.ndarray]]) -> list[End]:
        if not tasks:
            return []
        masks, training = (
            np.stack([self.contest.free(effects) for effects, *_ in tasks]),
            np.stack([cases for *_, cases in tasks]),
        )
        starts = [start for _, start, _ in tasks]
        return descend(
            self.contest.space, self.data, starts, masks, training, budget=self.contest.budget, settings=QUICK
        )

    def _starts(self, effects: Effects) -> list[Start]:
        """Optima on all data to begin with: of the same set, or of the nearest one."""
        if effects in self.known:
            return [Start.at(end) for end in self.known[effects].ends[:2]]
        nearest = self.known[
            min(self.known, key=lambda other: (len(other ^ effects), -self.known[other].log_evidence))
        ].best
        return [
            Start.at(nearest)._replace(
                point=np.where(self.contest.free(effects), nearest.point, self.contest.space.given_unknowns())
            )
        ]

    def error(self, bases: list[Effects]) -> float:
        """Root mean square |residual| of each fold's own choice on what was left out [m]."""
        squares, cells = 0.0, 0
        for fold, left_out in enumerate(self.folds):
            counted = self.contest.measurement.present & left_out[:, None, None]
            residual = residual_vectors(self.fitted[fold][bases[fold]].local.error, self.data)
            squares, cells = squares + float(np.sum(np.abs(residual[counted]) ** 2)), cells + int(counted.sum())
        return math.sqrt(squares / cells)

    def _scores(self, fold: int, sets: Iterable[Effects]) -> Scores:
        """Of some sets on a fold's rest."""
        return {effects: self._score(fold, effects) for effects in sets}

    def _score(self, fold: int, effects: Effects) -> float:
        end, scored = self.fitted[fold].get(effects, self.first[fold][effects]), self.scored[fold]
        if effects not in scored or scored[effects][0] is not end:
            evidence = contender_of(self.rests[fold], effects, [end], self.noise).log_evidence
            scored[effects] = end, evidence + self.contest.log_odds(effects)
        return scored[effects][1]


def _most_probable(scores: Scores) -> Effects:
    return max(scores, key=lambda effects: scores[effects])


def _pruned(scores: Scores) -> Effects:
    """The best set, less what can be left out at no more than the price of a detection."""
    best = _most_probable(scores)
    while smaller := [e for e in scores if e < best and len(e) == len(best) - 1 and scores[best] - scores[e] <= PRICE]:
        best = max(smaller, key=lambda effects: scores[effects])
    return best
