"""The race: sets of effects fitted to one measurement under one noise, and how probable each of them is."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from rotorjax.discovery.contest import Contender, Contest, Effects, Known
from rotorjax.inference.data import MOST_STARTS, Data, declared_starts
from rotorjax.inference.descent import HOPELESS, End, Local, Start, best_of, descend, distinct_of, starts_at
from rotorjax.inference.descent_settings import CONVERGED, CUT_OFF, QUICK
from rotorjax.inference.evidence import log_evidence
from rotorjax.inference.influence import CLEAR, influenced
from rotorjax.inference.noise import Noise
from rotorjax.inference.squares import squares_of
from rotorjax.inference.stable import cost_of_stability

MOST_PARENTS = 2
"""Known neighbours of a set of effects whose optima its starts come from."""
STRENGTHS = (1.0, 3.0, 1.0 / 3.0)
"""Of a force in the place of one that contains it, in those of that one, with which it begins."""
NOISE_FALL = 0.5
"""What is left of the noise from which on nonlinear forces begin at measured motions, too."""
WORTH_TRYING = 40.0
"""Log evidence behind the best on all data up to which an effect may win beside others, or on a part of the data."""


def race(
    contest: Contest,
    noise: Noise,
    hypotheses: Iterable[Effects],
    known: Known,
    *,
    also: Known | None = None,
    afresh: bool = False,
    hopeless: float = math.inf,
) -> Known:
    """Fit every hypothesis under one noise, from what is known of it and of its neighbours, in the same compiled calls.

    The influence of what scatters between runs is taken at the most probable that is known, that of what a calibration
    on the healthy rotor leaves open where each hypothesis ends. What was fitted under this very noise is not fitted
    again, but for what was cut off. **Arguments:** ``also``: where forces that depend on motion ended under another
    noise, as further starts; ``afresh``: begin at the parameters known with motions as measured, too: those that
    balanced where much was allowed for misfit may lie beyond a wall; ``hopeless``: cost with which a descent does not
    go on.
    """
    further = {effects: other.ends for effects, other in (also or {}).items() if effects & contest.coupled}
    every = list(dict.fromkeys(hypotheses))
    stands = [] if afresh else [e for e in every if e in known and known[e].fitted_under(noise) and e not in further]
    if not contest.budget.exhausted:
        stands = [effects for effects in stands if known[effects].best.result != CUT_OFF]
    found = {effects: contender_of(contest, effects, list(known[effects].ends), noise) for effects in stands}
    wanted = [effects for effects in every if effects not in found]
    if not wanted:
        return found
    reference = (
        max(known.values(), key=lambda c: c.log_evidence).best.point if known else contest.space.given_unknowns()
    )
    data = contest.data(noise, reference)
    # The smaller sets first: the larger ones begin where those ended.
    for size in sorted({len(effects) for effects in wanted}):
        level = [effects for effects in wanted if len(effects) == size]
        for effects, ends in _fitted(
            contest, noise, data, level, {**known, **found}, further, afresh=afresh, hopeless=hopeless
        ).items():
            found[effects] = contender_of(contest, effects, ends, noise)
    every_known = {**known, **found}
    special = _special_cases(contest, found, every_known, noise) | _below_larger(contest, found, every_known, noise)
    for effects, ends in _fitted(
        contest, noise, data, list(special), special, {}, afresh=False, hopeless=hopeless
    ).items():
        found[effects] = contender_of(contest, effects, [*found[effects].ends, *ends], noise)
    return found


def _special_cases(contest: Contest, sets: Iterable[Effects], known: Known, noise: Noise) -> Known:
    """Where to begin with sets that others contain, a clearance in the place of a rub, if those are ahead: far from the
    truth a further parameter may lead past a point from which fewer do not lead on.
    """
    found: Known = {}
    for effects in sets:
        for name in sorted(effects & contest.coupled):
            for general in sorted(contest.containing[name] - effects):
                other = known.get(effects - {name} | {general})
                if other is None or not other.fitted_under(noise):
                    continue
                if not known[effects].balanced or other.best.cost < known[effects].best.cost - CLEAR:
                    end = other.best._replace(point=_as_special_case(contest, other.best.point, name, general))
                    found[effects] = Contender(effects, (end,), -math.inf, noise)
    return found


def of_other_strengths(contest: Contest, winner: Contender, effects: Effects) -> Contender:
    """Where to begin with a special case of one effect of a winner: as strong as that effect is there, and stronger and
    weaker, for a stop has optima at several stiffnesses.
    """
    (general,), (name,) = winner.effects - effects, effects - winner.effects
    point = _as_special_case(contest, winner.best.point, name, general)
    strength = contest.only_of([name]) & (np.asarray(contest.space.strength) >= 0)
    points = [np.where(strength, by * point, point) for by in STRENGTHS]
    ends = tuple(winner.best._replace(point=there, exact=False) for there in points)
    return Contender(effects, ends, -math.inf, winner.noise)


def _below_larger(contest: Contest, sets: Iterable[Effects], known: Known, noise: Noise) -> Known:
    """Where to begin with sets of linear effects that are behind what one effect more leads to expect of them: that
    effect is hardly needed, and they stopped at a worse optimum.
    """
    found: Known = {}
    for effects in sets:
        if effects & contest.coupled or not known[effects].balanced:
            continue
        for name in contest.candidates:
            larger = known.get(effects | {name}) if name not in effects else None
            if larger is None or not larger.fitted_under(noise) or not larger.balanced:
                continue
            end, own = larger.best, np.isin(larger.best.free, np.flatnonzero(contest.only_of([name])))
            if not end.exact or end.cost > known[effects].best.cost - CLEAR:
                continue
            moved = end.point[end.free[own]]
            covariance = np.linalg.inv(end.curvature)[np.ix_(own, own)]
            without = end.cost + 0.5 * float(moved @ np.linalg.solve(covariance, moved))
            if without < known[effects].best.cost - CLEAR:
                point = np.where(contest.only_of([name]), contest.space.given_unknowns(), end.point)
                found[effects] = Contender(effects, (end._replace(point=point, exact=False),), -math.inf, noise)
                break
    return found


def _as_special_case(
    contest: Contest, point: Float[np.ndarray, "param"], name: str, general: str
) -> Float[np.ndarray, "param"]:
    """A point with an effect in the place of one that contains it: parameters of the same name have its values."""
    there = {e.label: e for e in contest.space.entries if e.effect == general}
    special = np.where(contest.only_of([general]), 0.0, point)
    for own in contest.space.entries:
        if own.effect == name:
            special[own.unknown] = point[there[own.label].unknown] * there[own.label].scale / own.scale
    return special


def _fitted(
    contest: Contest,
    noise: Noise,
    data: Data,
    wanted: list[Effects],
    known: Known,
    further: Mapping[Effects, tuple[End, ...]],
    *,
    afresh: bool,
    hopeless: float,
) -> dict[Effects, list[End]]:
    """Ends of all descents of each set. **Arguments:** ``further``: where to begin, too."""
    if not wanted:
        return {}
    starts, masks, owner = [], [], []
    for effects in wanted:
        mask = contest.free(effects)
        for start in (*_starts(contest, effects, mask, known, afresh=afresh), *map(Start.at, further.get(effects, ()))):
            starts.append(start)
            masks.append(mask)
            owner.append(effects)
    training = np.broadcast_to(contest.training, (len(starts), len(contest.training)))
    ends = descend(
        contest.space, data, starts, np.stack(masks), training, budget=contest.budget, settings=QUICK, hopeless=hopeless
    )
    ends = _as_felt_there(contest, noise, ends)
    return {effects: [end for own, end in zip(owner, ends, strict=True) if own == effects] for effects in wanted}


def _as_felt_there(contest: Contest, noise: Noise, ends: list[End]) -> list[End]:
    """Ends with what a calibration leaves open felt at each: where an error of the mass has moved a resonance, an error
    of what the healthy rotor showed moves the vectors otherwise. To first order about where the fit ended.
    """
    if contest.measurement.calibration is None:
        return ends
    finite = [k for k, end in enumerate(ends) if math.isfinite(end.cost)]
    there = list(ends)
    for k, data in zip(finite, contest.data_at(noise, [ends[k].point for k in finite]), strict=True):
        there[k] = influenced(data, ends[k], contest.training)
    return there


def _starts(contest: Contest, effects: Effects, mask: np.ndarray, known: Known, *, afresh: bool) -> list[Start]:
    """Points to begin with: the optima known, or else those of the nearest known sets with the declared starts of what
    differs.
    """
    if effects in known:
        ends = known[effects].ends
        again = [Start(end.point) for end in ends] if afresh and effects & contest.coupled else []
        return [Start.at(end) for end in ends] + again
    near = sorted(
        (contender for other, contender in known.items() if len(effects ^ other) <= 2),
        key=lambda parent: (len(effects ^ parent.effects), -parent.log_evidence),
    )
    # From one farther, or far behind, nothing is found that is not found from the first.
    parents = [
        parent
        for parent in near[: 1 if effects & contest.coupled else MOST_PARENTS]
        if len(effects ^ parent.effects) == len(effects ^ near[0].effects)
        and not parent.log_evidence < near[0].log_evidence - HOPELESS
    ]
    starts: list[Start] = []
    for parent in parents:
        # Where a force is gone that the motion depended on, those that stay have sizes to be found anew.
        changed = (effects - parent.effects) | (
            effects & contest.coupled if (parent.effects - effects) & contest.coupled else frozenset()
        )
        new = contest.only_of(changed)
        here = np.where(mask, parent.best.point, contest.space.given_unknowns())
        # A parent's motion is near unless a force, whose size is to be found first, changes it.
        same = Start.at(parent.best) if not (effects ^ parent.effects) & contest.coupled else Start(here)
        declared = declared_starts(contest.space, new, contest.measurement)
        starts += [same._replace(point=np.where(new & (start != 0.0), start, here)) for start in declared]
        if parent is parents[0] and len(declared) > 1 and not effects & contest.coupled:
            # What is declared uncertain may have moved in the place of an effect: a stiffness for a foundation.
            back = np.where(contest.free(frozenset()), contest.space.given_unknowns(), here)
            starts = [Start(np.where(new & (start != 0.0), start, back)) for start in declared] + starts
    starts = starts or starts_at(declared_starts(contest.space, mask, contest.measurement))
    distinct: list[Start] = []
    for start in starts:
        if not any(np.allclose(start.point, other.point, atol=1e-3) for other in distinct):
            distinct.append(start)
    return distinct[:MOST_STARTS]


def log_likelihood(contest: Contest, noise: Noise) -> Callable[[float], float]:
    """Its logarithm as a function of the cost: where the noise is a misfit of unknown size, marginalised over that."""
    numbers = contest.independent_numbers if noise.allowance > contest.floor.allowance else None

    def log_of(cost: float) -> float:
        return -cost if numbers is None else -0.5 * numbers * math.log(max(2.0 * cost / numbers, 1e-300))

    return log_of


def contender_of(
    contest: Contest, effects: Effects, ends: Sequence[End], noise: Noise, *, wide: bool = False
) -> Contender:
    """Distinct optima, and the evidence summed over them: of descents whose motions balance, if there is one, else
    none.

    Beside the lowest only those are kept that are at their end: of one given up on the way nobody knows where it leads.

    See `rotorjax.inference.evidence`, for ``wide`` too. Where the noise is a misfit of unknown size it is marginalised
    (Jeffreys prior): (n/2) log(2 cost / n) in the place of the cost, n the number of independent data.
    """
    log_of = log_likelihood(contest, noise)
    distinct = distinct_of(ends)
    if not distinct:
        return Contender(effects, (best_of(ends),), -math.inf, noise)
    counted = [distinct[0], *(end for end in distinct[1:] if end.result == CONVERGED)]
    terms = [
        log_evidence(end, contest.space, log_of, wide=wide) - cost_of_stability(end, contest.space, contest.steady_rpm)
        for end in counted
    ]
    return Contender(effects, tuple(counted), float(np.logaddexp.reduce(terms)), noise)


def share_counted(contest: Contest, noise: Noise) -> float:
    """Share of the cost of the data that counts: where a misfit is allowed for, that of independent numbers."""
    numbers = np.count_nonzero(contest.measurement.weights(noise.allowance))
    return min(1.0, contest.independent_numbers / numbers) if noise.allowance > 0.0 else 1.0


class Scored(NamedTuple):
    """How probable a contender is, so that those under different noises compare."""

    likelihood: float
    """Logarithm, of all data, at the optimum."""
    share: float
    """Of the data that counts, as in `share_counted`."""
    prior: float
    """Logarithm of prior odds, and of the share of the prior that the data leave."""

    @property
    def log_posterior(self) -> float:
        """Log evidence and prior odds, up to a constant."""
        return self.share * self.likelihood + self.prior

    def lead(self, other: "Scored") -> float:
        """Log odds against another, both counted by the smaller share: a misfit that one of them leaves narrowly must
        not make it lose by data that repeat themselves.
        """
        share = min(self.share, other.share)
        return share * (self.likelihood - other.likelihood) + self.prior - other.prior


def score(contest: Contest, contender: Contender, noise: Noise, *, normalised: bool = True) -> Scored:
    """Under some noise, ``normalised`` by its size, so that different noises compare.

    Where a misfit is allowed for, only independent data count: a misfit repeats itself from run to run.
    """
    end = contender.best
    data = contest.data(noise, end.point)
    old, weight = contest.measurement.weights(contender.noise.allowance), data.weight
    ratio = np.divide(weight, old, out=np.zeros_like(old), where=old > 0.0).reshape(len(old), -1)
    error, used = end.local.error * ratio, weight[weight > 0.0]
    logarithm = -float(np.sum(np.log(used)))
    logarithm += data.half_log_determinant
    every = np.ones(len(error), bool)
    cost = squares_of(data, error, np.zeros((*error.shape, 0)), every).cost
    prior = float(log_evidence(end._replace(spread=0.0), contest.space, lambda cost: -cost) + end.data_cost)
    prior -= cost_of_stability(end, contest.space, contest.steady_rpm)
    return Scored(
        float(-(cost + normalised * logarithm)),
        float(share_counted(contest, noise)),
        prior + contest.log_odds(contender.effects),
    )


def foreseen(contest: Contest, data: Data, contender: Contender, noise: Noise) -> Contender:
    """A contender under another noise to first order about where it was fitted. **Arguments:** ``data`` in units of
    that noise.
    """
    if not contender.balanced or contender.noise == noise:
        return contender
    old = contest.measurement.weights(contender.noise.allowance)
    ratio = np.divide(data.weight, old, out=np.zeros_like(old), where=old > 0.0).reshape(len(old), -1)
    ends = [
        end._replace(local=Local(end.local.error * ratio, end.local.slopes * ratio[..., None]))
        for end in contender.ends
    ]
    ends = _as_felt_there(contest, noise, [influenced(data, end, contest.training) for end in ends])
    return contender_of(contest, contender.effects, ends, noise)._replace(foreseen=True)


def falls(after: Noise, before: Noise) -> bool:
    """Whether a noise is so much smaller that what was fitted under the larger one says little."""
    return after.allowance < NOISE_FALL * before.allowance


def anew(
    contest: Contest, noise: Noise, sets: Iterable[Effects], found: Known, near: Callable[[Contender], bool]
) -> list[Effects]:
    """Those of some sets that are to be fitted again under another noise: as what they are to first order is ``near``.

    The others are ``found`` to first order from then on. Sets that were fitted under a much larger noise are always
    fitted again.
    """
    data = contest.data(noise, max(found.values(), key=lambda c: c.log_evidence).best.point)
    again = []
    for effects in sets:
        there = foreseen(contest, data, found[effects], noise)
        if near(there) or falls(noise, found[effects].noise):
            again.append(effects)
        else:
            found[effects] = there
    return again
