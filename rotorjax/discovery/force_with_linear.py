"""A force that depends on motion with one linear effect beside it: an unknown unbalance, say, as in most measurements.

Neither holds by itself, and under a misfit wide enough for one of them many others do as well. So each force is fitted
with all linear effects at once, under the noise of the table: no set of those can do better beside it.
"""

import math

import numpy as np

from rotorjax.discovery.contest import Contender, Contest, Effects, Known
from rotorjax.discovery.race import Exact, exact_of
from rotorjax.inference.data import declared_starts
from rotorjax.inference.descent import End, descend, starts_at
from rotorjax.inference.manner import LEFT_BEHIND, QUICK
from rotorjax.inference.noise import NO_NOISE

BEGUN = QUICK._replace(most_steps=8)
"""How each force is fitted with all linear effects: it need not come to its end to show whether it may hold."""


def holding_pair(contest: Contest, known: Known) -> Exact:
    """Pairs of a force that depends on motion and a linear effect under the noise of the table, as far as they may
    hold.
    """
    pairs, near = list[Effects](), dict(known)
    for force, end in _beside_all_linear(contest).items():
        near[frozenset({force})] = Contender(frozenset({force}), (end,), -math.inf, NO_NOISE)
        pairs += [frozenset({force, name}) for name in contest.candidates if name not in contest.timed]
    return exact_of(contest, pairs, near)


def _beside_all_linear(contest: Contest) -> dict[str, End]:
    """Of every force that may hold with all linear effects its best fit, begun."""
    given, starts, owner = contest.space.given_unknowns(), [], []
    for name in (name for name in contest.candidates if name in contest.timed):
        own = contest.only_of([name])
        for start in declared_starts(contest.space, own, contest.measurement.reach):
            starts.append(np.where(own & (start != 0.0), start, given))
            owner.append(name)
    if not starts:
        return {}
    ends = descend(
        contest.space,
        contest.data(NO_NOISE, given),
        starts_at(np.stack(starts)),
        np.stack([contest.linear | contest.only_of([name]) for name in owner]),
        np.broadcast_to(contest.training, (len(starts), len(contest.training))),
        budget=contest.budget,
        manner=BEGUN,
        hopeless=contest.far_off,
    )
    found: dict[str, End] = {}
    for name, end in zip(owner, ends, strict=True):
        if end.result != LEFT_BEHIND and end.cost < (found[name].cost if name in found else contest.far_off):
            found[name] = end
    return found
