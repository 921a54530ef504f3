"""What is other in one run, or in single readings: its values, where a search ended, or from one fit."""

from collections.abc import Iterable

import numpy as np

from rotorjax.data.declarations import Mistake
from rotorjax.data.measurement import Measurement
from rotorjax.data.odd_runs import Value, settled
from rotorjax.data.wrong_readings import WRONG, with_ratios
from rotorjax.discovery.common_noise import settle
from rotorjax.discovery.contest import Contender, Contest, make_contest
from rotorjax.discovery.screening import Change
from rotorjax.discovery.search import wide_noise
from rotorjax.model.model import Model


def with_values(mistake: Mistake, contest: Contest, contender: Contender) -> Mistake:
    """A mistake about one run, or about readings, with the values that a fit beside it came to; any other as it is."""
    if mistake.kind == WRONG:
        return with_ratios(mistake, contest.measurement, contender.best.shown)
    if not mistake.uncertain:
        return mistake
    end, space = contender.best, contest.space
    values, covariance = space.values(end.point), np.linalg.inv(end.curvature)
    found = {}
    for k, entry in enumerate(space.entries):
        if entry.effect == mistake.kind:
            place = int(np.flatnonzero(end.free == entry.unknown)[0])
            found[entry.label] = Value(float(values[k]), entry.scale * float(np.sqrt(covariance[place, place])))
    return settled(mistake, contest.measurement, found)


def fitted_in_one_run(mistake: Mistake, model: Model, measurement: Measurement, effects: Iterable[str]) -> Mistake:
    """The same from one fit, with some effects beside it."""
    if not mistake.uncertain:
        return mistake
    names = frozenset(effects)
    contest = Change.of(make_contest(model, measurement, names), mistake, 0.0).contest
    return with_values(mistake, contest, settle(contest, [names], {}, wide_noise(measurement)).contenders[names])
