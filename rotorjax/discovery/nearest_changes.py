"""Changes of what is stated with which linear effects hold, or leave far less, where they do not hold without."""

from collections.abc import Callable, Sequence

import numpy as np

from rotorjax.discovery.rivals import TIE
from rotorjax.discovery.screening import FAR_LESS, HALVED, SAME, Change, Screened, as_stated, screen, under_table_noise
from rotorjax.discovery.search import wide_noise
from rotorjax.inference.data import declared_starts
from rotorjax.inference.descent import HOPELESS, Start, starts_at
from rotorjax.inference.descent_settings import CONVERGED, LEFT_BEHIND, QUICK
from rotorjax.inference.noise import Noise
from rotorjax.inference.prediction import predict

BEGUN = QUICK._replace(most_steps=5)
"""How changes begin: what they leave after some steps is the order in which they go on."""
MOST_SHAPED = 3
"""Nearest changes that begin from the declared starts of effects with a shape, too."""


def of_what_fails(
    stated: Screened, level: Screened, changes: list[Change]
) -> tuple[Screened, list[Screened], list[Screened]]:
    """What is stated, where linear effects do not hold within the noise with it, changes that may be near, and those
    ahead, the nearest first.

    All are fitted under a wide noise first: data that a fit cannot meet drag it into a corner. What is behind what is
    stated under that noise stays so. **Arguments:** ``level``: what is stated under the wide noise.
    """
    enough = stated.change.contest.far_off
    feels = {change.mistake: _feels(change, level) for change in changes}
    possible = _not_behind(level, [change for change in changes if feels[change.mistake]])
    screened = list[Screened]()
    for one in possible:
        screened.append(under_table_noise(one, hopeless=enough))
        if screened[-1].holds:
            enough = min(enough, screened[-1].end.cost + HOPELESS)
    if changes and not any(one.holds for one in screened):
        # How far off all are decides then.
        if stated.end.result == LEFT_BEHIND:
            stated = as_stated(stated.change.contest, level=level, to_the_end=True)
        screened = [under_table_noise(one, hopeless=max(enough, HALVED * stated.end.cost)) for one in screened]
    ahead = [
        fitted
        for rough, fitted in zip(possible, screened, strict=True)
        if fitted.holds or rough.end.cost < HALVED * level.end.cost or fitted.end.cost < HALVED * stated.end.cost
    ]
    ahead.sort(key=lambda one: (0, one.cost) if one.holds else (1, 0.0))
    # What linear effects do not feel, a weight for instance, leaves them as they are.
    alike = [Screened(change, stated.end) for change in changes if not feels[change.mistake]]
    return stated, [*screened, *alike], ahead


def _not_behind(level: Screened, changes: list[Change]) -> list[Screened]:
    """Changes that leave no more than what is stated under the wide noise of its fit, the nearest first.

    None goes on once it promises twice as much as what is stated leaves. Where none leaves far less than what is
    stated, which is off by more than that noise, they are begun where that ended, too, and the nearest at the declared
    starts of effects with a shape.
    """
    wide, most = wide_noise(level.change.contest.measurement), level.end.cost + TIE
    fitted = in_order(changes, wide, hopeless=most / HALVED)
    lost = level.end.cost > level.change.contest.most_held
    if lost and all(one.end.cost > FAR_LESS * level.end.cost for one in fitted):
        fitted = [_from(level, one, wide) for one in fitted]
        nearest = sorted(fitted, key=lambda one: one.end.cost)[:MOST_SHAPED]
        fitted = [_with_shapes(one, wide) if one in nearest else one for one in fitted]
    return sorted((one for one in fitted if one.end.cost < most), key=lambda one: one.cost)


def in_order(
    changes: Sequence[Change],
    noise: Noise,
    *,
    starts: Callable[[Change], Sequence[Start]] = lambda _: (),
    hopeless: float,
) -> list[Screened]:
    """All linear effects at once beside changes: all are begun, and go on in the order of what they leave, not once
    they promise far more than the best, or a cost with which they are ``hopeless``.
    """
    begun = [screen(one, noise, starts=starts(one), settings=BEGUN, hopeless=hopeless) for one in changes]
    fitted = list[Screened]()
    for one in sorted(begun, key=lambda one: one.end.cost):
        going_on = one.end.result != CONVERGED and one.end.steps == BEGUN.most_steps
        again = [Start.at(one.end)]
        fitted.append(screen(one.change, noise, starts=again, hopeless=hopeless) if going_on else one)
        hopeless = min(hopeless, fitted[-1].end.cost + HOPELESS)
    return fitted


def _from(level: Screened, one: Screened, noise: Noise) -> Screened:
    """A fit, or a better one from where what is stated ended: after some steps it promises to leave half as much."""
    *_, kept = one.change.near(level.end)
    begun = screen(one.change, noise, starts=[kept], settings=BEGUN)
    if begun.end.cost > HALVED * min(level.end.cost, one.end.cost):
        return one
    return begun if begun.end.result == CONVERGED else screen(one.change, noise, starts=[Start.at(begun.end)])


def _with_shapes(one: Screened, noise: Noise) -> Screened:
    """A fit, or a better one from the declared starts of effects that have a shape, such as a foundation with its
    natural frequency: at no strength no shape shows.
    """
    contest = one.change.contest
    shaped = contest.only_of(contest.shaped - contest.costly)
    if not np.any(shaped):
        return one
    declared = declared_starts(contest.space, shaped, contest.measurement)[1:]
    starts = starts_at(np.where(shaped, declared, contest.space.given_unknowns()))
    begun = screen(one.change, noise, starts=starts, settings=BEGUN, hopeless=one.end.cost / HALVED)
    return min(one, screen(one.change, noise, starts=[Start.at(begun.end)]), key=lambda fit: fit.end.cost)


def _feels(change: Change, level: Screened) -> bool:
    """Whether a change makes any difference to linear effects fitted to what is stated: to what was measured, or to
    what they show.
    """
    contest, stated = change.contest, level.change.contest
    if contest.measurement is not stated.measurement:
        return True
    shown = predict(contest.space, contest.measurement.conditions, level.end.point, budget=contest.budget).shown
    return not np.allclose(shown, level.end.shown, rtol=SAME, atol=0.0, equal_nan=True)
