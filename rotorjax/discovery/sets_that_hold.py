"""Small sets of effects that hold within the noise of the table, read from a fit of many linear effects at once.

A nonlinear force with an unknown unbalance beside it, say, as in most measurements: neither holds by itself, and under
a misfit wide enough for one of them many others do as well. So each force is fitted with all linear effects at once,
under the noise of the table: no set of those can do better beside it; and with those alone that excite the rotor, which
lead a strong force less astray. Where that holds, the curvature of the cost says to second order what every set of them
would leave, and the best of each size are fitted.
"""

import itertools
import math
from collections.abc import Collection, Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from rotorjax.discovery.common_noise import QuietRace, sets_under_table_noise
from rotorjax.discovery.contest import Contender, Contest, Effects, Known
from rotorjax.inference.curvature import inverse
from rotorjax.inference.data import declared_starts
from rotorjax.inference.descent import End, descend, starts_at
from rotorjax.inference.descent_settings import LEFT_BEHIND, QUICK, DescentSettings
from rotorjax.inference.noise import NO_NOISE
from rotorjax.model.contract import ExcitationEffect

BEGUN = QUICK._replace(most_steps=8, rescan=False)
"""How each force is fitted with all linear effects: it need not come to its end to show whether it may hold."""
BEGUN_BESIDE_FEW = BEGUN._replace(most_steps=16)
"""The same with those alone that excite the rotor: friction that nearly holds it comes to balance late."""
MOST_TRIED = 8
"""Best sets of one size that are fitted."""


def holding_set(contest: Contest, fits: Mapping[Effects, End], known: Known, sizes: range) -> QuietRace:
    """Sets of several effects under the noise of the table: the smallest that hold.

    **Arguments:** ``fits`` of all linear effects at once, each beside other effects, which all its sets have; ``sizes``
    of the sets.
    """
    begun, tried = {beside: _Saturated.of(contest, end) for beside, end in fits.items()}, QuietRace({}, None)
    for size in sizes:
        sets = [
            (beside | set(names), whole.without_others(names))
            for beside, whole in begun.items()
            if len(beside) <= size
            for names in itertools.combinations(whole.places, size - len(beside))
        ]
        best = sorted(sets, key=lambda one: one[1].cost)[:MOST_TRIED]
        near = {effects: Contender(effects, (end,), -math.inf, NO_NOISE) for effects, end in best}
        tried = sets_under_table_noise(contest, list(near), {**near, **known})
        if tried.leader is not None:
            break
    return tried


class _Saturated(NamedTuple):
    """A fit of linear effects, beside others."""

    end: End
    places: dict[str, Int[np.ndarray, "_"]]
    """Of every linear effect in it its unknowns among the free ones."""
    covariance: Float[np.ndarray, "free free"]

    @classmethod
    def of(cls, contest: Contest, end: End) -> "_Saturated":
        """By the curvature of the cost there."""
        linear = [name for name in contest.candidates if name not in contest.costly]
        places = {name: np.flatnonzero(contest.only_of([name])[end.free]) for name in linear}
        return cls(end, {name: own for name, own in places.items() if len(own)}, inverse(end.curvature))

    def without_others(self, kept: Collection[str]) -> End:
        """The minimum with only some of the linear effects, to second order: u - C_R (C_RR)⁻¹ u_R, R those that are
        gone, and its cost, higher by ½ u_R (C_RR)⁻¹ u_R.
        """
        gone = np.concatenate([np.zeros(0, int), *(own for name, own in self.places.items() if name not in kept)])
        values, point = self.end.point[self.end.free], self.end.point.copy()
        pull = np.linalg.solve(self.covariance[np.ix_(gone, gone)], values[gone])
        point[self.end.free] = values - self.covariance[:, gone] @ pull
        point[self.end.free[gone]] = 0.0
        return self.end._replace(point=point, cost=self.end.cost + 0.5 * float(values[gone] @ pull), exact=False)


def beside_linear(contest: Contest, *, exciting: bool = True) -> dict[Effects, End]:
    """Every nonlinear force that may hold with linear effects under the noise of the table, its best fit begun: with
    all of them at once. **Arguments:** ``exciting``: also with those alone that excite the rotor, as so many may lead a
    strong force astray.
    """
    linear = frozenset(contest.candidates) - contest.costly
    few = frozenset(e.name for e in contest.space.model.effects if isinstance(e, ExcitationEffect)) & linear
    begun = _begun_beside(contest, contest.free(few), BEGUN_BESIDE_FEW) if exciting and few else {}
    return _lower(begun, _begun_beside(contest, contest.linear, BEGUN))


def _lower(one: Mapping[Effects, End], other: Mapping[Effects, End]) -> dict[Effects, End]:
    """The lower of two fits of every force."""
    return {
        force: min((fits[force] for fits in (one, other) if force in fits), key=lambda end: end.cost)
        for force in {**one, **other}
    }


def _begun_beside(contest: Contest, linear: Bool[np.ndarray, "param"], settings: DescentSettings) -> dict[Effects, End]:
    """The same with these linear effects."""
    given, starts, owner = contest.space.given_unknowns(), [], []
    for name in (name for name in contest.candidates if name in contest.coupled):
        own = contest.only_of([name])
        for start in declared_starts(contest.space, own, contest.measurement):
            starts.append(np.where(own & (start != 0.0), start, given))
            owner.append(frozenset({name}))
    if not starts:
        return {}
    ends = descend(
        contest.space,
        contest.data(NO_NOISE, given),
        starts_at(np.stack(starts)),
        np.stack([linear | contest.only_of(force) for force in owner]),
        np.broadcast_to(contest.training, (len(starts), len(contest.training))),
        budget=contest.budget,
        settings=settings,
        hopeless=contest.far_off,
    )
    found: dict[Effects, End] = {}
    for force, end in zip(owner, ends, strict=True):
        if end.result != LEFT_BEHIND and end.cost < (found[force].cost if force in found else contest.far_off):
            found[force] = end
    return found
