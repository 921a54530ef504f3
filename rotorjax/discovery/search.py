"""The search: forward selection among sets of effects, with swaps, pairs and backward pruning."""

import dataclasses
import itertools
import math
from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np

from rotorjax.data.measurement import Measurement
from rotorjax.discovery.common_noise import QuietRace, Race, settle, under_table_noise
from rotorjax.discovery.contest import Contender, Contest, Effects, Known, with_floor
from rotorjax.discovery.progress import Progress
from rotorjax.discovery.race import WORTH_TRYING
from rotorjax.discovery.ranking import PRICE, Ranked, is_detected, may_be_missing, ranking, showing
from rotorjax.discovery.sets_that_hold import beside_linear, holding_set
from rotorjax.inference.descent import End
from rotorjax.inference.descent_settings import LEFT_BEHIND
from rotorjax.inference.noise import NO_NOISE, Noise
from rotorjax.inference.prediction import predict

PAIRED = 8
"""Best effects of a race of which all pairs are tried."""
WIDE = 0.1
"""Misfit that the search begins with, in the size of what was measured."""
MOST_SMALL = 3
"""Effects that are detected without mattering, at most."""
NOTHING: Effects = frozenset()


class Selection(NamedTuple):
    """What the search found."""

    contest: Contest
    """With the noise floor that was inferred on the way."""
    effects: tuple[str, ...]
    """Detected, and they matter; in the order added."""
    small: tuple[str, ...]
    """Detected, but they change the prediction by less than the noise."""
    most: int
    """How many effects were to be added at most."""
    races: tuple[Race, ...]
    """From each of the nested sets of ``effects`` on, the empty one first: what a further effect would bring."""
    known: Known

    @property
    def beside(self) -> tuple[str, ...]:
        """The small ones that are fitted along with effects, which they would bias if left out."""
        return self.small if self.effects else ()

    def among(self, candidates: tuple[str, ...]) -> "Selection":
        """The same where these effects may be missing, of which some were not tried."""
        return self._replace(contest=dataclasses.replace(self.contest, candidates=candidates))

    @property
    def more(self) -> list[Ranked]:
        """What may be missing beside all that was detected, as in `may_be_missing`."""
        return may_be_missing(showing(self.contest, self.races[-1], self.present))

    @property
    def tried_all(self) -> bool:
        """Whether every effect that may be missing was tried beside all that was detected."""
        return {*self.contest.candidates} <= {name for effects in self.races[-1].contenders for name in effects}

    def begun(self) -> "SearchStart":
        """A search that goes on from its effects."""
        found = frozenset(self.effects)
        return SearchStart(self.contest, self.known, self.races[-1].noise, QuietRace({}, None), found)

    @property
    def present(self) -> Effects:
        """All that was detected."""
        return frozenset(self.effects) | frozenset(self.small)


class SearchStart(NamedTuple):
    """A search before its first step: nothing is added, and every effect was tried under the noise of the table."""

    contest: Contest
    """With the noise floor beside nothing added, or beside the ``found``."""
    known: Known
    noise: Noise
    """That the model as declared leaves, or the ``found``."""
    quiet_race: QuietRace
    found: Effects = NOTHING
    """Effects that hold within that noise together, where no single one does."""

    @property
    def holds(self) -> bool:
        """Whether one effect or that set holds within the noise of the table."""
        return self.quiet_race.leader is not None or bool(self.found)


def begin(contest: Contest, *, known: Known | None = None, progress: Progress = lambda _: None) -> SearchStart:
    """What `select` goes on from. **Arguments:** ``known``: what was fitted before."""
    table: Known = dict(known or {})
    start = settle(contest, [NOTHING], table, wide_noise(contest.measurement))
    contest = with_floor(contest, start.contenders[NOTHING])
    table.update(start.contenders)
    progress(_beside(NOTHING))
    return SearchStart(contest, table, start.noise, under_table_noise(contest, _with_one_more(contest, NOTHING), table))


def with_set(
    begun: SearchStart, most: int, fits: Mapping[Effects, End] | None = None, *, least: int = 2
) -> SearchStart:
    """A start with a set of effects that holds, from ``least`` to ``most`` together, if there is one and all of it
    matter. **Arguments:** ``fits`` of all linear effects at once from which it is read, as for `holding_set`; by
    default one beside every nonlinear force.
    """
    if most < least or begun.holds or not begun.contest.tries_table_noise:
        return begun
    quiet = dataclasses.replace(begun.contest, floor=NO_NOISE)
    quiet_race = holding_set(quiet, beside_linear(quiet) if fits is None else fits, begun.known, range(least, most + 1))
    if quiet_race.leader is None:
        return begun
    best = quiet_race.contenders[quiet_race.leader]
    if not all(matters(quiet, best, name, NO_NOISE) for name in quiet_race.leader):
        return begun
    known = {**begun.known, **quiet_race.contenders}
    # From where they all end together, what was left behind by itself may hold.
    lost = [e for e, c in begun.quiet_race.contenders.items() if c.best.result == LEFT_BEHIND]
    behind = frozenset(e for e in lost if not e <= quiet_race.leader)
    contest = with_floor(dataclasses.replace(quiet, cannot_hold=behind), best)
    needed, noise = _pruned(contest, quiet_race.leader, NOTHING, known, NO_NOISE)
    return begun._replace(contest=contest, known=known, noise=noise, found=needed)


def begin_beside(
    contest: Contest, effects: Effects, near: End | None, *, progress: Progress = lambda _: None
) -> SearchStart:
    """What `select` goes on from where effects were found under other conditions, less those not needed here.
    **Arguments:** ``near``: where they ended there, if that is near where they end here.
    """
    progress(_beside(effects))
    table: Known = {}
    if near is not None:
        table[effects] = Contender(effects, (near,), -math.inf, NO_NOISE, foreseen=True)
    there = settle(contest, [effects], table, wide_noise(contest.measurement))
    table.update(there.contenders)
    needed, noise = _pruned(contest, effects, NOTHING, table, there.noise)
    return SearchStart(with_floor(contest, table[needed]), table, noise, QuietRace({}, None), needed)


def _beside(present: Effects) -> str:
    return f"what is missing beside {', '.join(sorted(present)) or 'the model as declared'}"


def select(begun: SearchStart, most: int, *, progress: Progress = lambda _: None) -> Selection:
    """Add effects one after the other until "none" is probable.

    After each addition all one-for-one swaps and all pairs of the best eight are tried (`Contest.lean` leaves out
    forces that cost more than they promise), unless a first effect holds within the noise by itself; then effects that
    are not needed go. **Arguments:** ``most`` effects at most.
    """
    contest, table, noise = begun.contest, dict(begun.known), begun.noise
    present, small = begun.found, NOTHING
    tried: set[Effects] = {NOTHING, present}
    seen: dict[Effects, Race] = {}
    while True:
        progress(_beside(present))
        race = seen[present | small] = forward(
            contest, present | small, table, noise, quiet_race=None if present | small else begun.quiet_race
        )
        table.update(race.contenders)
        leader = showing(contest, race, present | small)
        if not is_detected(leader) or len(present) >= most or contest.budget.exhausted:
            return _selection_of(contest, most, present, small, table, seen)
        added = leader[0].effect if leader[0].effect != "none" else leader[1].effect
        if not matters(contest, table[present | small | {added}], added, race.noise):
            if len(small) >= MOST_SMALL:
                return _selection_of(contest, most, present, small, table, seen)
            small |= {added}
            present, noise = _pruned(contest, present, small, table, race.noise)
            present -= small
            continue
        chosen, needed, noise = present | {added}, small, race.noise
        if noise.allowance > contest.floor.allowance or len(chosen | small) > 1:
            chosen, needed, noise = _refined(contest, chosen, small, race, table, most)
            slight = too_small(contest, table[chosen | needed], chosen, noise)
            chosen, needed = chosen - slight, needed | slight
        if chosen | needed in tried:
            return _selection_of(contest, most, present, small, table, seen)
        present, small = chosen, needed
        tried.add(present | small)
        contest = with_floor(contest, table[present | small])


def wide_noise(measurement: Measurement) -> Noise:
    """A misfit to begin with: data that a fit cannot meet would drag it into a corner."""
    return Noise(WIDE * max(measurement.rms, 1e-9))


def forward(
    contest: Contest, base: Effects, table: Known, noise: Noise, *, quiet_race: QuietRace | None = None
) -> Race:
    """The race of all that may be added to a set. **Arguments:** ``quiet_race``: as for `settle`."""
    wanted = _with_one_more(contest, base)
    return settle(contest, wanted, table, noise, quiet_race=quiet_race or under_table_noise(contest, wanted, table))


def _with_one_more(contest: Contest, base: Effects) -> list[Effects]:
    return [base, *(base | {name} for name in contest.candidates if name not in base)]


def _refined(
    contest: Contest, chosen: Effects, small: Effects, race: Race, table: Known, most: int
) -> tuple[Effects, Effects, Noise]:
    """The best of all one-for-one swaps and all pairs of the best eight, and the small ones, less what is not
    needed.
    """
    before = min(race.contenders, key=len)
    best = [r.effect for r in ranking(contest, race, before) if r.effect != "none"][:PAIRED]
    pool = contest.lean(
        neighbours(contest.candidates, before, chosen | small, best, kept=small), chosen | small, _near(race)
    )
    found = settle(contest, [effects for effects in pool if len(effects - small) <= most], table, race.noise)
    table.update(found.contenders)
    needed, noise = _pruned(contest, found.winner, NOTHING, table, found.noise)
    return needed - small, needed & small, noise


def _near(race: Race) -> list[str]:
    """Effects that came near the best of a race."""
    best = max(c.log_evidence for c in race.contenders.values())
    return [name for effects, c in race.contenders.items() if c.log_evidence > best - WORTH_TRYING for name in effects]


def neighbours(
    candidates: Iterable[str], before: Effects, chosen: Effects, best: list[str], *, kept: Effects = NOTHING
) -> list[Effects]:
    """A set, all its one-for-one swaps and what it is without each part, and the set before with every pair of the
    best.

    **Arguments:** ``kept``: effects of the set that are not swapped.
    """
    pool: list[Effects] = [chosen]
    for gone in sorted(chosen - kept):
        rest = chosen - {gone}
        pool += [rest, *(rest | {name} for name in candidates if name not in rest)]
    pool += [before | set(pair) for pair in itertools.combinations(best, 2)]
    return list(dict.fromkeys(pool))


def _pruned(contest: Contest, present: Effects, kept: Effects, table: Known, noise: Noise) -> tuple[Effects, Noise]:
    """Less, one after the other, what can be left out at no more than the price of a detection; with what is kept."""
    winner = present | kept
    while winner - kept:
        without = {name: winner - {name} for name in winner - kept}
        again = settle(contest, [winner, *without.values()], table, noise)
        table.update(again.contenders)
        noise = again.noise
        gain = {
            name: contest.log_posterior(again.contenders[winner]) - contest.log_posterior(again.contenders[rest])
            for name, rest in without.items()
        }
        least = min(gain, key=lambda name: gain[name])
        if gain[least] > PRICE:
            break
        winner = without[least]
    return winner, noise


def _selection_of(
    contest: Contest,
    most: int,
    present: Effects,
    small: Effects,
    table: Known,
    seen: dict[Effects, Race],
    later: frozenset[Effects] = frozenset(),
) -> Selection:
    """The story of a set: its effects in the order in which each next one brings the most, with the race at every step:
    that of the search, or of the set's own effects alone where the search came by another way.

    What was too small to matter beside less, and matters now, is one of them, as long as there are no more than the
    ``most``.
    **Arguments:** ``later``: sets that the table has from after the races ``seen``.
    """
    whole = table[present | small]
    for name in sorted(small - too_small(contest, whole, small, whole.noise)):
        if len(present) < most:
            present, small = present | {name}, small - {name}
    order: list[str] = []
    races: list[Race] = []
    noise = wide_noise(contest.measurement)
    while True:
        done = len(order) == len(present)
        base = frozenset(order) | (small if done else NOTHING)
        # Of linear effects the first step tells of all, as they cost little.
        cheap = frozenset(contest.candidates) - contest.costly if not (order or present & contest.costly) else NOTHING
        own = [base, *(base | {name} for name in sorted((present | cheap) - base))]
        wanted = _with_one_more(contest, base) if done else own
        # A step of another answer has the effects of that alone.
        shown = base in seen and seen[base].contenders.keys() >= set(wanted)
        if shown:
            race = seen[base]
        elif done:
            race = forward(contest, base, table, noise)
        else:
            race = settle(contest, own, table, _next_left(contest, base, present, table, noise))
        table.update({effects: c for effects, c in race.contenders.items() if not shown or effects not in later})
        races.append(race)
        if done:
            return Selection(contest, tuple(order), tuple(sorted(small)), most, tuple(races), table)
        noise = race.noise
        order.append(
            next(r.effect for r in ranking(contest, race, base) if r.effect in present and r.effect not in order)
        )


def _next_left(contest: Contest, base: Effects, present: Effects, table: Known, noise: Noise) -> Noise:
    """The misfit that the best of the next effects leaves, as far as they were fitted before: where the noise of their
    race will end, or near it.
    """
    known = [table[base | {name}] for name in present - base if base | {name} in table]
    left = [contest.misfit_left(contender) for contender in known if contender.best.exact]
    return noise._replace(allowance=min(left, default=noise.allowance))


def with_answer(selection: Selection, present: Effects, found: Known) -> Selection:
    """The search with another answer, which ``found``, fitted afterwards, shows to do better."""
    contest, known = selection.contest, {**selection.known, **found}
    if (present | selection.present) & contest.coupled:
        contest = with_floor(contest, known[present])
    new = present - set(selection.effects) - set(selection.small)
    slight = too_small(contest, known[present], new, known[present].noise)
    small = frozenset(selection.small) & present | slight
    seen = {min(race.contenders, key=len): race for race in selection.races}
    return _selection_of(contest, selection.most, present - small, small, known, seen, frozenset(found))


def matters(contest: Contest, contender: Contender, name: str, noise: Noise) -> bool:
    """Whether the prediction without this effect differs by more than the noise, or has no steady motion.

    **Arguments:** ``noise`` that counts where the table does not say it.
    """
    return not change_by(contest, contender, [name]) <= _noise_that_counts(contest, noise)


def too_small(contest: Contest, contender: Contender, names: Iterable[str], noise: Noise) -> Effects:
    """Those of some effects that do not matter together: the smallest ones, as long as the prediction without all of
    them differs by less than the noise. **Arguments:** as for `matters`.
    """
    least, slight = _noise_that_counts(contest, noise), NOTHING
    alone = {name: change_by(contest, contender, [name]) for name in sorted(names)}
    for name in sorted((name for name, change in alone.items() if change <= least), key=alone.__getitem__):
        if slight and not change_by(contest, contender, slight | {name}) <= least:
            break
        slight |= {name}
    return slight


def _noise_that_counts(contest: Contest, noise: Noise) -> float:
    return noise_size(contest.measurement, noise if contest.measurement.sigma is None else contest.floor)


def noise_size(measurement: Measurement, noise: Noise) -> float:
    """Root mean square |z| of pure noise over the cells [m]: the table's, the tolerance of the model, and what is added
    to them.
    """
    weight = measurement.weights(noise.allowance)
    return float(np.sqrt(np.sum(1.0 / weight[weight > 0.0] ** 2) / max(1, np.count_nonzero(measurement.present))))


def change_by(contest: Contest, contender: Contender, names: Iterable[str]) -> float:
    """Root mean square change of the prediction without some effects [m]; not a number where no steady motion is found
    without them.
    """
    m, best = contest.measurement, contender.best
    without = np.where(contest.only_of(names), 0.0, best.point)
    there = predict(
        contest.space, m.conditions, without, budget=contest.budget, near=(m.conditions, best.motions)
    ).shown
    return float(np.sqrt(np.mean(np.abs((best.shown - there)[m.present]) ** 2)))
