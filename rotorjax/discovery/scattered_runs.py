"""Scatter between three runs: told where neither effects nor a mistake in what was written down explain them.

Influence coefficients leave of three runs what all three scatter, or what one of them is other than stated: they cannot
tell which. So one run that is other comes first, and scatter where that holds no better.
"""

import dataclasses
import math

from rotorjax.discovery.contest import Contender, Contest, with_floor
from rotorjax.discovery.screening import Change, Screened, screen
from rotorjax.discovery.search import wide_noise
from rotorjax.inference.covariance import NO_SCATTER
from rotorjax.inference.descent import Start
from rotorjax.inference.noise import Noise

FEWEST_RUNS = 3
"""Of fewer, influence coefficients leave nothing."""


def with_scatter(level: Screened) -> Contest | None:
    """The contest with a scatter of unbalance and bow between three runs, if all linear effects at once hold within it.

    **Arguments:** ``level``: those effects under a wide noise. **Returns** none, too, where scatter is inferred anyway,
    or is not to be.
    """
    contest = level.change.contest
    measurement = contest.measurement
    if len(measurement.runs) != FEWEST_RUNS:
        return None
    knowledge = dataclasses.replace(measurement.knowledge, scatter_from_runs=FEWEST_RUNS)
    own = dataclasses.replace(contest, measurement=dataclasses.replace(measurement, knowledge=knowledge))
    fitted = Contender(level.beside, (level.end,), -math.inf, wide_noise(measurement))
    scatter = with_floor(own, fitted).floor.scatter
    if scatter == NO_SCATTER:
        return None
    beside = screen(Change(None, own), Noise(0.0, scatter), starts=[Start.at(level.end)])
    return own if beside.holds else None
