"""Which readings may be wrong: those without which all linear effects leave far less."""

import numpy as np
from jaxtyping import Float

from rotorjax.data.wrong_readings import MOST_WRONG, Cell, log_odds_of, wrong_readings
from rotorjax.discovery.contest import Contender, Contest
from rotorjax.discovery.race import race
from rotorjax.discovery.screening import FAR_LESS, HALVED, Change, Screened, screen, under_table_noise
from rotorjax.discovery.search import wide_noise

TRIED = 3
"""Readings that are left out one at a time."""
SINGULAR = 1e-9
"""What is added where a reading alone tells a value, and leaves nothing to compare it with."""


def doubtful_readings(level: Screened, odds: float) -> list[Change]:
    """Changes by which the fewest readings are wrong with which all linear effects hold within the noise, or leave far
    less where it is unknown; each has to halve what they leave. A force that acts at few speeds may do as much to one
    reading, so that what does not get there is left to the effects.

    **Arguments:** ``level``: all linear effects beside what is stated, under a wide noise; ``odds`` beforehand of the
    kind of mistake.
    """
    contest, cells, enough = level.change.contest, tuple[Cell, ...](), FAR_LESS * level.end.cost
    noise, known = wide_noise(contest.measurement), contest.measurement.sigma is not None
    while len(cells) < MOST_WRONG:
        without = {cell: screen(_change(contest, (*cells, cell), odds), noise) for cell in _most_gained(level)}
        near = {cell: one for cell, one in without.items() if one.end.cost < HALVED * level.end.cost}
        if not near:
            break
        held = [
            one.change for one in near.values() if (under_table_noise(one).holds if known else one.end.cost < enough)
        ]
        if held:
            return held
        nearest = min(near, key=lambda cell: near[cell].end.cost)
        cells, level = (*cells, nearest), near[nearest]
    return []


def doubtful_beside(contest: Contest, answer: Contender, odds: float) -> list[Screened]:
    """The reading that is wrong beside the effects of an answer, if without it they leave less than half as much."""
    noise, stated = answer.noise, Screened(Change(None, contest), answer.best)
    for cell in _most_gained(stated)[:1]:
        change = _change(contest, (cell,), odds)
        start = {answer.effects: answer._replace(foreseen=True)}
        fitted = race(change.contest, noise, [answer.effects], start)[answer.effects]
        if fitted.balanced and fitted.best.data_cost < HALVED * answer.best.data_cost:
            return [Screened(change._replace(known={fitted.effects: fitted}), fitted.best)]
    return []


def _change(contest: Contest, cells: tuple[Cell, ...], odds: float) -> Change:
    mistake = wrong_readings(contest.measurement, cells)
    return Change.of(contest, mistake, log_odds_of(contest.measurement, cells, odds))


def _most_gained(level: Screened) -> list[Cell]:
    """The readings without which a fit would leave least, the first first."""
    gained = gain_without(level)
    order = np.argsort(-gained, axis=None)[:TRIED]
    places = zip(*np.unravel_index(order, gained.shape), strict=True)
    cells: list[Cell] = [(int(case), int(probe), int(of_order)) for case, probe, of_order in places]
    return [cell for cell in cells if gained[cell] > 0.0]


def gain_without(fitted: Screened) -> Float[np.ndarray, "case probe order"]:
    """What the squared residual would be less without each reading, to first order: r' (1 - H)⁻¹ r, r the residual of
    its two numbers in standard errors and H = J C⁻¹ J' their part of the hat matrix, J the slopes and C the curvature
    (Cook and Weisberg, Residuals and Influence in Regression, 1982).
    """
    m, end = fitted.change.contest.measurement, fitted.end
    error = end.local.error.reshape(*m.vectors.shape, 2)
    slopes = end.local.slopes.reshape(*m.vectors.shape, 2, -1)
    hat = slopes @ np.linalg.solve(end.curvature, np.swapaxes(slopes, -1, -2))
    left = (1.0 + SINGULAR) * np.eye(2) - hat
    gained = np.einsum("...i,...i->...", error, np.linalg.solve(left, error[..., None])[..., 0])
    return np.where(m.certain, gained, 0.0)
