"""The fits that are shown: of every step of the search, and of the answer, polished."""

import numpy as np

from rotorjax.discovery.contest import Contest, Effects, Known
from rotorjax.discovery.fit import Fit, summarise
from rotorjax.discovery.held_out import HeldOut
from rotorjax.discovery.inferred_noise import Round, Stage
from rotorjax.discovery.race import race
from rotorjax.discovery.search import Selection
from rotorjax.inference.descent import Start, best_of, descend
from rotorjax.inference.descent_settings import THOROUGH
from rotorjax.inference.noise import NO_SCATTER, Noise
from rotorjax.model.model import Model


def fits_of_steps(contest: Contest, model: Model, selection: Selection, held: HeldOut) -> tuple[Fit, ...]:
    """The fit of every nested set, polished; in the last, beside effects, what is too small to matter by itself: left
    out, it would bias them.
    """
    sets = [frozenset(selection.effects[:step]) for step in range(len(held.rms))]
    if selection.effects:
        sets[-1] = selection.present
    every = zip(sets, selection.races, held.rms, strict=True)
    return tuple(fit_of(contest, model, selection, names, race.noise, (rms, held.reason)) for names, race, rms in every)


def fit_of(
    contest: Contest, model: Model, selection: Selection, effects: Effects, under: Noise, held: tuple[float | None, str]
) -> Fit:
    """The fit of one set of effects, polished. **Arguments:** ``held``: its error on data held out, or why there is
    none.
    """
    uncertain = {u.effect for u in contest.measurement.knowledge.uncertain}
    kept = frozenset({e.name for e in model.effects} | uncertain | effects)
    polished = _polished(contest, selection.known, effects, under, last=effects >= set(selection.effects))
    stage = Stage(
        contest.space, contest.measurement, tuple(sorted(effects)), contest.free(effects), kept, contest.budget
    )
    scatter = contest.floor.scatter if contest.floor.scatter != NO_SCATTER else None
    return summarise(stage, polished, *held, scatter=scatter)


def _polished(contest: Contest, known: Known, effects: Effects, under: Noise, *, last: bool) -> Round:
    """The best fit of one set, under the noise that it leaves; the ``last`` one under that of the table where it holds
    within that.
    """
    own = known[effects] if effects in known else race(contest, under, [effects], known)[effects]
    noise = Noise(contest.misfit_left(own), contest.floor.scatter)
    again = race(contest, noise, [effects], known)[effects]
    # A descent under another noise may end in another motion: where it came from must not be lost.
    starts = [Start.at(end) for end in (*again.ends[:2], own.best)]
    every = np.ones((len(starts), len(contest.measurement.run)), bool)

    def polish(noise: Noise) -> Round:
        data = contest.data(noise, again.best.point)
        best = best_of(
            descend(
                contest.space,
                data,
                starts,
                contest.free(effects),
                every,
                budget=contest.budget,
                kept=again.best.point,
                settings=THOROUGH,
            )
        )
        return Round(noise.allowance, data, best, starts, noise.allowance, best.cost)

    if last and noise.allowance > contest.floor.allowance and contest.measurement.sigma is not None:
        quiet = polish(contest.floor)
        if contest.misfit_left(own.led_by(quiet.best, contest.floor)) == contest.floor.allowance:
            return quiet
    return polish(noise)
