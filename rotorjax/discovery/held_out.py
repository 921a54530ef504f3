"""The error on data held out, with the selection of effects redone on the rest."""

import dataclasses
import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool

from rotorjax.discovery.descent import End, best_of, descend, make_folds, residual_vectors
from rotorjax.discovery.race import Contest, Effects, contender_of
from rotorjax.discovery.search import DETECTED, NOTHING, Selection

WORTH_TRYING = 40.0
"""Log evidence behind the best on all data up to which an effect may win on a part of them."""


class HeldOut(NamedTuple):
    """Root mean square |residual| of data predicted without them, at every step [m]; none with the reason why."""

    rms: tuple[float | None, ...]
    reason: str


def held_out(contest: Contest, selection: Selection) -> HeldOut:
    """Leave out groups of runs or of speeds in turn; select effects and fit on the rest; predict what was left out.

    Each fold makes its own choice at every step, under the noise of that step, among all effects that come near the
    best on the whole data. Where it finds "none" probable it adds nothing.
    """
    final = selection.known[selection.present].best
    folds, reason = make_folds(contest.measurement, np.einsum("cmp,cmq->cpq", final.local.slopes, final.local.slopes))
    if not len(folds):
        return HeldOut((None,) * len(selection.races), reason)
    bases: list[Effects] = [NOTHING] * len(folds)
    settled = [False] * len(folds)
    errors = []
    for step in range(len(selection.races)):
        last = step == len(selection.races) - 1
        if last:
            bases = [base | frozenset(selection.small) for base in bases]
        ends = _fit_folds(contest, selection, step, folds, bases, alone=last)
        data = contest.data(selection.races[step].noise, final.point)
        squares, cells = 0.0, 0
        for fold, left_out in enumerate(folds):
            counted = contest.measurement.present & left_out[:, None, None]
            residual = residual_vectors(ends[fold, bases[fold]].local.error, data)
            squares, cells = squares + float(np.sum(np.abs(residual[counted]) ** 2)), cells + int(counted.sum())
            if not (settled[fold] or last):
                unknown = selection.races[step].noise.allowance > contest.floor.allowance
                size = dataclasses.replace(contest, training=~left_out).independent_numbers() if unknown else None
                bases[fold], settled[fold] = _next(contest, bases[fold], {e: end for (f, e), end in ends.items() if f == fold}, size)
        errors.append(math.sqrt(squares / cells))
    return HeldOut(tuple(errors), "")


def _fit_folds(
    contest: Contest, selection: Selection, step: int, folds: Bool[np.ndarray, "fold case"], bases: list[Effects], *, alone: bool
) -> dict[tuple[int, Effects], End]:
    """Every fold's own set, and unless ``alone`` that with each effect worth trying, fitted to the rest: all in the same compiled calls."""
    race = selection.races[step]
    best = max(c.log_evidence for c in race.contenders.values())
    smallest = min(race.contenders, key=len)
    names = {name for effects, c in race.contenders.items() if c.log_evidence > best - WORTH_TRYING for name in effects - smallest}
    names = set() if alone else names | set(selection.effects)
    wanted = [(fold, base | extra) for fold, base in enumerate(bases) for extra in [NOTHING, *(frozenset([n]) for n in sorted(names - base))]]
    near = {effects: _nearest(contest, selection, effects) for _, effects in wanted}
    tasks = [(key, point) for key in wanted for point in near[key[1]]]
    masks = np.stack([contest.free(effects) for (_, effects), _ in tasks])
    training = np.stack([~folds[fold] for (fold, _), _ in tasks])
    data = contest.data(race.noise, selection.known[selection.present].best.point)
    ends = descend(contest.space, data, np.stack([p for _, p in tasks]), masks, training, manner=contest.manner())
    found: dict[tuple[int, Effects], list[End]] = {}
    for (key, _), end in zip(tasks, ends, strict=True):
        found.setdefault(key, []).append(end)
    return {key: best_of(group) for key, group in found.items()}


def _nearest(contest: Contest, selection: Selection, effects: Effects) -> list[np.ndarray]:
    """Optima on all data to begin with: of the same set, or of the nearest one."""
    if effects in selection.known:
        return [end.point for end in selection.known[effects].ends[:2]]
    nearest = min(selection.known, key=lambda other: (len(other ^ effects), -selection.known[other].log_evidence))
    return [np.where(contest.free(effects), selection.known[nearest].best.point, contest.space.given_unknowns())]


def _next(contest: Contest, base: Effects, ends: dict[Effects, End], unknown_noise: int | None) -> tuple[Effects, bool]:
    """What a fold adds, and whether it has nothing more to add."""
    scores = {e: contender_of(e, [end], unknown_noise).log_evidence + contest.log_odds(e - base) for e, end in ends.items()}
    best = max(scores, key=lambda effects: scores[effects])
    if best == base or scores[best] - scores[base] < math.log((1.0 - DETECTED) / DETECTED):
        return base, True
    return best, False
