"""What else would do as well: ties between sets of effects, and sets that contain more than is needed."""

import itertools
import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from rotorjax.arrays import numpy_pair
from rotorjax.data.measurement import is_half_order
from rotorjax.discovery.contest import Contender, Contest, Effects, Known
from rotorjax.discovery.race import WORTH_TRYING, anew, contender_of, of_other_strengths, race
from rotorjax.discovery.ranking import PRICE
from rotorjax.discovery.rivals import TIE
from rotorjax.discovery.search import Selection, with_answer
from rotorjax.inference.covariance import common_errors
from rotorjax.inference.data import Data, half_order_sign
from rotorjax.inference.descent import HOPELESS, End
from rotorjax.inference.influence import CLEAR, influenced
from rotorjax.inference.noise import NO_NOISE, Noise
from rotorjax.model.contract import Effect

NEAR = 15.0
"""Log evidence behind the winner up to which an alternative is fitted again, and compared under other errors."""
AS_GOOD = 2.0
"""Difference of cost up to which a larger set is said to fit neither better nor worse than the one that it contains."""
TRIED_PAIRS = 5
"""Best replacements of an effect of which pairs are tried in its place."""


class Alternative(NamedTuple):
    """A set of effects in the place of one in the answer."""

    instead_of: tuple[str, ...]
    effects: tuple[str, ...]
    gap: float
    """Log evidence that it lacks."""
    contender: Contender
    apart: float
    """Root mean square difference of its predictions from the answer's, in standard errors of the measured cells."""


class Ties(NamedTuple):
    """What the data leave open."""

    tied: tuple[Alternative, ...]
    of_small: tuple[Alternative, ...]
    """The same in the place of what was detected without mattering."""
    contains: tuple[Alternative, ...]
    """Sets that do what the answer does with more determined parameters, which are not needed."""
    winner: Contender
    raced: Known
    """All that was fitted for it."""

    def groups(self) -> list[list[list[str]]]:
        """For every part of the answer that is open: itself, then what ties with it."""
        return _by_part(self.tied)

    def small_groups(self) -> list[list[list[str]]]:
        """The same of what was detected without mattering."""
        return _by_part(self.of_small)


class Swapped(NamedTuple):
    """The answer, and what it is with one effect in the place of another, under the noise that it leaves."""

    noise: Noise
    winner: Contender
    swaps: dict[str, list[Effects]]
    """Of every effect of the answer the sets without it."""
    found: Known
    """All that was fitted for it."""

    def better(self, contest: Contest, most: int) -> Effects | None:
        """What is more probable than the answer, as it may be where it was fitted only after the search; with ``most``
        effects at most.
        """
        allowed = max(most, len(self.winner.effects))
        fitted = [c for c in self.found.values() if c.fitted_under(self.noise) and len(c.effects) <= allowed]
        best = max([self.winner, *fitted], key=contest.log_posterior)
        return None if best.effects == self.winner.effects else best.effects


def _by_part(tied: tuple[Alternative, ...]) -> list[list[list[str]]]:
    groups: dict[tuple[str, ...], list[list[str]]] = {}
    for other in tied:
        groups.setdefault(other.instead_of, [list(other.instead_of)]).append(list(other.effects))
    return list(groups.values())


def noise_left(selection: Selection) -> Noise:
    """The noise that an answer leaves."""
    contest = selection.contest
    return Noise(contest.misfit_left(selection.known[selection.present]), contest.floor.scatter)


def settled(selection: Selection, catalog: Mapping[str, type[Effect]]) -> tuple[Selection, Ties]:
    """The answer with what ties with it: what turns out more probable among all that was raced takes its place."""
    answered = {selection.present}
    while True:
        contest = selection.contest
        swapped = swap_each(contest, selection, noise_left(selection))
        better = swapped.better(contest, selection.most)
        if contest.budget.exhausted or better is None or better in answered:
            # Pairs are tried beside what no swap beats.
            ties = find_ties(contest, selection, swapped, catalog)
            better = swapped.better(contest, selection.most)
            # Each under the noise that it leaves itself: two may each be ahead under the other's.
            if contest.budget.exhausted:
                # What was linearised once only takes no place of what the search fitted.
                return selection, ties
            if better is None or better in answered:
                changed = _selection_with(selection, swapped)
                return changed._replace(known={**selection.known, **ties.raced}), ties
        answered.add(better)
        selection = with_answer(selection, better, swapped.found)


def _selection_with(selection: Selection, swapped: Swapped) -> Selection:
    """The story with all that was tried in the place of the last effect as its step, where that is of the answer alone:
    its effects were found together.
    """
    if not selection.effects or selection.small:
        return selection
    *before, last, end = selection.races
    if last.noise != swapped.noise or len(last.contenders) > 2:
        return selection
    tried = {effects: swapped.found[effects] for effects in swapped.swaps[selection.effects[-1]]}
    return selection._replace(races=(*before, last._replace(contenders={**tried, **last.contenders}), end))


def swap_each(contest: Contest, selection: Selection, noise: Noise) -> Swapped:
    """Race everything in the place of each effect of the answer, under the noise that the answer leaves."""
    answer = selection.present
    found = race(contest, noise, [answer], selection.known)
    winner = found[answer]
    swaps = {
        gone: [answer - {gone} | {name} for name in contest.candidates if name not in answer]
        for gone in (*selection.effects, *selection.small)
    }
    _fit_where_open(contest, selection, noise, list(itertools.chain(*swaps.values())), found, winner)
    # Begun where the winner ended, if it is ahead: not left at what the search foresaw.
    special = [
        effects
        for gone, sets in swaps.items()
        for effects in sets
        if contest.is_special_case(effects - answer, frozenset({gone}))
    ]
    also = {effects: of_other_strengths(contest, winner, effects) for effects in special}
    found.update(race(contest, noise, special, {**selection.known, **found}, also=also))
    return Swapped(noise, winner, swaps, found)


def find_ties(contest: Contest, selection: Selection, swapped: Swapped, catalog: Mapping[str, type[Effect]]) -> Ties:
    """Race pairs in the place of one effect and one in the place of pairs, too, and compare all with the answer.

    An alternative ties if its log evidence is less than 3 behind, also if only where all effects may be three times as
    strong as declared, or if it leads where the tolerance of the model's form is noise of every vector by itself.
    Whether it then predicts the same, or differs and fits no worse, is told with it. One further behind, with more
    determined parameters, that fits no better, or not by so much that these would pay, contains the answer, as does one
    nearer of which the answer is a special case: that is no tie.
    """
    answer = selection.present
    noise, winner, swaps, found = swapped
    wider = [h for h in _wider(contest, selection, swaps, found, catalog) if _worth(contest, h, found, winner)]
    wider = [h for h in wider if noise != NO_NOISE or h not in contest.cannot_hold]
    _fit_where_open(contest, selection, noise, [h for h in wider if h not in found], found, winner)
    others = [c for effects, c in found.items() if effects != answer and winner.log_evidence - c.log_evidence < NEAR]
    by_itself = _tolerance_by_itself(contest, noise, winner)
    otherwise = _leads_under(contest, by_itself, winner, others) | _near_if_strong(contest, noise, winner, others)
    tied, contains = [], []
    for other in sorted(others, key=lambda c: -c.log_evidence):
        gone, instead = answer - other.effects, other.effects - answer
        gap = winner.log_evidence - other.log_evidence
        alternative = Alternative(
            tuple(sorted(gone)), tuple(sorted(instead)), gap, other, _apart(contest, noise, winner.best, other.best)
        )
        larger = gap > 0.0 and other.best.determined.shape[1] > winner.best.determined.shape[1]
        better = winner.best.cost - other.best.cost
        more = not gone or contest.is_special_case(gone, instead)
        if (gap < TIE or other.effects in otherwise) and not (more and larger and abs(better) < AS_GOOD):
            tied.append(alternative)
        elif larger and better > -AS_GOOD and _takes_the_place(instead, gone, catalog):
            contains.append(alternative)
    tied += _within_tolerance(contest, selection, noise, by_itself, winner)
    every, small = _simplest(tied), frozenset(selection.small)
    of_small = tuple(t for t in every if t.instead_of and small >= set(t.instead_of))
    return Ties(tuple(t for t in every if t not in of_small), of_small, _minimal(contains), winner, found)


def _takes_the_place(instead: Effects, gone: Effects, catalog: Mapping[str, type[Effect]]) -> bool:
    """Whether effects are no more than those that they replace, or relatives of these."""
    relatives = itertools.chain.from_iterable(catalog[name].relatives for name in gone)
    return len(instead) <= len(gone) or instead <= set(relatives)


def _tolerance_by_itself(contest: Contest, noise: Noise, winner: Contender) -> Data | None:
    """The data with the tolerance of the model's form as noise of every vector by itself, not alike in all runs; none
    where there is no tolerance.
    """
    if contest.measurement.knowledge.tolerance == 0.0:
        return None
    common = common_errors(contest.measurement, contest.model_at(winner), noise, form=False)
    return contest.data(noise, winner.best.point)._replace(common=common)


def _leads_under(contest: Contest, data: Data | None, winner: Contender, others: list[Contender]) -> set[Effects]:
    """Those of the others that lead the winner with other common errors, if there are any."""
    if data is None:
        return set()
    own = _evidence_under(contest, data, winner)
    return {c.effects for c in others if _evidence_under(contest, data, c) > own}


def _near_if_strong(contest: Contest, noise: Noise, winner: Contender, others: list[Contender]) -> set[Effects]:
    """Those of the others that tie where effects may be three times as strong as declared, or whatever what the healthy
    rotor leaves open would do: by nothing but a declared scale an effect that fits as well is not excluded.
    """

    def wide(contender: Contender) -> float:
        return contender_of(contest, contender.effects, contender.ends, noise, wide=True).log_evidence

    def whatever(contender: Contender) -> float:
        return contender.log_evidence + contender.best.spread

    return {c.effects for c in others for scored in (wide, whatever) if scored(winner) - scored(c) < TIE}


def _evidence_under(contest: Contest, data: Data, contender: Contender) -> float:
    """Log evidence with other common errors, to first order about where it was fitted."""
    ends = [influenced(data, end, contest.training) for end in contender.ends]
    return contender_of(contest, contender.effects, ends, contender.noise).log_evidence


def _within_tolerance(
    contest: Contest, selection: Selection, noise: Noise, data: Data | None, winner: Contender
) -> list[Alternative]:
    """The further effect that would be detected first if the error of the model's form were not alike in all runs.
    **Arguments:** ``data``: see `_tolerance_by_itself`.
    """
    race, answer = selection.races[-1], selection.present
    added = [c for effects, c in race.contenders.items() if effects > answer and c.balanced and c.noise == race.noise]
    if data is None or race.noise != noise or not added:
        return []
    own = _evidence_under(contest, data, winner)
    gains = {c.effects: _evidence_under(contest, data, c) + contest.log_odds(c.effects - answer) - own for c in added}
    best = max(added, key=lambda c: gains[c.effects])
    if gains[best.effects] < PRICE:
        return []
    apart = _apart(contest, noise, winner.best, best.best)
    names = tuple(sorted(best.effects - answer))
    return [Alternative((), names, winner.log_evidence - best.log_evidence, best, apart)]


def _fit_where_open(
    contest: Contest, selection: Selection, noise: Noise, sets: list[Effects], found: Known, winner: Contender
) -> None:
    """Fit sets under the noise of the winner; of those that the search fitted under another only what may do as well,
    to first order.
    """
    found.update({h: selection.known[h] for h in sets if h in selection.known})
    near = [h for h in sets if h in found and _near(found[h].log_evidence, winner)]
    again = anew(contest, noise, near, found, lambda there: there.log_evidence > winner.log_evidence - NEAR - CLEAR)
    found.update(
        race(
            contest,
            noise,
            [*again, *(h for h in sets if h not in found)],
            {**selection.known, **found},
            hopeless=winner.best.cost + HOPELESS,
        )
    )


def _worth(contest: Contest, effects: Effects, found: Known, winner: Contender) -> bool:
    """Whether a set may do as well: one with a force depending on motion only if a part of it comes near."""
    coupled = contest.coupled & effects
    parts = (c.log_evidence for other, c in found.items() if other < effects and coupled & other)
    return not coupled or _near(max(parts, default=math.inf), winner)


def _near(log_evidence: float, winner: Contender) -> bool:
    """Whether a set, or its best part, is near enough to the winner to be fitted again."""
    return log_evidence > winner.log_evidence - WORTH_TRYING


def _wider(
    contest: Contest,
    selection: Selection,
    swaps: dict[str, list[Effects]],
    found: Known,
    catalog: Mapping[str, type[Effect]],
) -> list[Effects]:
    """Pairs in the place of one effect, and one in the place of pairs: chain gain and its parts."""
    answer, wider = selection.present, []
    for gone, others in swaps.items():
        best = sorted(others, key=lambda effects: -found[effects].log_evidence)[:TRIED_PAIRS]
        names = {next(iter(effects - answer)) for effects in best} | set(catalog[gone].relatives)
        usable = [name for name in sorted(names) if name in contest.candidates and name not in answer]
        wider += [answer - {gone} | set(pair) for pair in itertools.combinations(usable, 2)]
    for gone in itertools.combinations(swaps, 2):
        wider += [answer - set(gone) | {name} for name in contest.candidates if name not in answer]
    return wider


def _simplest(tied: list[Alternative]) -> tuple[Alternative, ...]:
    """The nearest first; larger sets in the place of a part only where no set of its size ties with it."""
    ranked = sorted(tied, key=lambda t: (len(t.effects) - len(t.instead_of), t.gap))
    excess: dict[tuple[str, ...], int] = {}
    for other in ranked:
        excess.setdefault(other.instead_of, len(other.effects) - len(other.instead_of))
    return tuple(other for other in ranked if len(other.effects) - len(other.instead_of) == excess[other.instead_of])


def _minimal(contains: list[Alternative]) -> tuple[Alternative, ...]:
    """Without those that hold another one, in the same place, and more."""
    return tuple(
        one
        for one in contains
        if not any(one.instead_of == other.instead_of and set(one.effects) > set(other.effects) for other in contains)
    )


def _apart(contest: Contest, noise: Noise, one: End, other: End) -> float:
    """Root mean square difference of two predictions in standard errors, over the measured cells."""
    m = contest.measurement
    weight = m.weights(noise.allowance)
    here, there = numpy_pair(one.shown), numpy_pair(other.shown)
    gap = weight * (
        here - half_order_sign(here, there, weight, np.array([is_half_order(order) for order in m.orders])) * there
    )
    return float(np.sqrt(np.mean(gap[weight > 0.0] ** 2))) if np.any(weight) else 0.0
