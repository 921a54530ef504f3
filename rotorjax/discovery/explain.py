"""Which physical effect is missing: the answer, how sure it is, what it cannot tell apart, what to measure next."""

from collections.abc import Callable, Iterable, Mapping
from typing import NamedTuple

import numpy as np
from scipy.special import chdtrc
from threadpoolctl import threadpool_limits

from rotorjax.arrays import require_float64
from rotorjax.data.declarations import KINDS, Mistake, reversed_rotation
from rotorjax.data.measurement import Measurement, aligned_half_orders
from rotorjax.data.names import several
from rotorjax.data.pairing import paired, require_steady
from rotorjax.data.wrong_readings import WRONG
from rotorjax.discovery.answers import Answer, MistakeRace
from rotorjax.discovery.bootstrap import UNEXPLAINED, PValue, p_value
from rotorjax.discovery.compare import Comparison, compare, compare_vectors
from rotorjax.discovery.contest import Contest, make_contest
from rotorjax.discovery.driven_orders import undriven_orders, without_orders
from rotorjax.discovery.explanation import Cost, Explanation, Small, Verdict
from rotorjax.discovery.fit import Fit
from rotorjax.discovery.healthy import calibrated
from rotorjax.discovery.held_out import HeldOut, held_out
from rotorjax.discovery.mistakes import race_of_mistakes
from rotorjax.discovery.named_force import NamedForce, name_force, other_force, other_power
from rotorjax.discovery.next_measurement import Proposal, next_measurement
from rotorjax.discovery.own_effects import check_catalog
from rotorjax.discovery.polished import fit_of, fits_of_steps
from rotorjax.discovery.progress import Progress, ProgressReporter
from rotorjax.discovery.screening import as_stated
from rotorjax.discovery.search import Selection, begin, begin_beside, change_by, noise_size, select, with_set
from rotorjax.discovery.stages import Stages
from rotorjax.discovery.story import Story
from rotorjax.discovery.ties import Ties, noise_left, settled
from rotorjax.effects import CATALOG
from rotorjax.effects.of_one_run import RUN_EFFECTS
from rotorjax.inference.ahead import make_programs_ahead
from rotorjax.inference.noise import Noise, is_large
from rotorjax.inference.prediction import predict
from rotorjax.model.contract import AbstractRotor, Effect
from rotorjax.model.model import Model
from rotorjax.units import MICROMETRE

MOST_SEPARATED = 4
"""Ties of which readings are looked for that would settle them."""
MIRRORED = 1.1
"""Misfit of the effects found in a mirror, in what they left there, up to which they are those of the rotor itself."""
LINEARISATIONS = 750_000
"""Single cases that an explanation may linearise; of tables with many cases `OF_ONE_CASE` each."""
OF_ONE_CASE = 10_000
"""How often each case may be linearised where that is more."""
FOR_THE_FORCE = 70_000
"""Of them kept for the force that is missing, where nothing explains, however long the search took."""
FOR_THE_STEPS = 20_000
"""Of these, what the fits of the steps may take where the limit of the search was reached; and what those with a
mistake put right may.
"""


@threadpool_limits.wrap(limits=1, user_api="blas")
def explain(  # noqa: PLR0913
    model: Model | AbstractRotor,
    measurement: Measurement,
    *,
    max_effects: int = 3,
    only: Iterable[str] | None = None,
    exclude: Iterable[str] = (),
    mistakes: bool | None = None,
    catalog: Mapping[str, type[Effect]] = CATALOG,
    thorough: bool = True,
    limit: int | None = None,
    progress: Callable[[str], None] = lambda _: None,
    healthy: Measurement | None = None,
) -> Explanation:
    """Find which effects a model lacks.

    Every effect of the catalogue is fitted beside what the user declared uncertain, and "none" with them; the evidence
    (MacKay 1992, Neural Comput. 4:415-447) ranks them; the best is added if it is 19 times as probable as "none".

    **Arguments:** ``model``; ``measurement``; ``max_effects`` to add; ``only`` these effects may be missing, or all but
    those in ``exclude``; ``mistakes``: whether changes of what rig file and table state are in the race
    (`rotorjax.data.declarations`), always, never, or (None) where what is stated leads to no answer that holds, or to
    an effect of the measuring chain, which looks alike; ``only`` and ``exclude`` may name them; ``catalog``: effects
    by name, ``CATALOG | {"mine": Mine}`` for one's own; ``thorough``: with held-out error and p-value, both of which
    count for the verdict, and the missing force, looked at where nothing explains and compared with what was found
    elsewhere; ``limit``: single cases that may be linearised, by default 750,000, or 10,000 times as many as there are
    cases if that is more; the last 70,000 of them (a tenth at most) for the missing force, and up to 40,000 of these
    for the fits that are shown; where it is reached the verdict is "undecided" or "unexplained", with what was not
    tried; ``progress``: called with a line of text at every stage, and while it goes on; ``healthy``: a measurement of
    the healthy rotor, on which the model is calibrated first: what is found has changed since.
    **Returns** an `Explanation`. **Errors.** ``ValueError`` in single precision, for names that the catalogue lacks, a
    negative ``max_effects``, or a measurement with other probes or planes.
    """
    require_float64("explain")
    if max_effects < 0:
        raise ValueError(f"max_effects is {max_effects}; it is the number of effects to add at most, none or more")
    known = None
    if healthy is not None:
        progress("the model on the healthy rotor")
        known = calibrated(model, healthy)
        model, measurement = known.model, known.beside(measurement)
    full = paired(model, measurement)
    check_catalog(catalog, full.with_orders(measurement.orders))
    candidates, kinds = _candidates(catalog, only, exclude, mistakes is not False)
    allowed = limit or max(LINEARISATIONS, OF_ONE_CASE * len(measurement.run))
    told = ProgressReporter(progress, allowed)
    told.budget.reserve(FOR_THE_FORCE if thorough else FOR_THE_STEPS)
    asked = _Asked(candidates, kinds, max_effects, catalog, mistakes is True, thorough)
    found = _explained(full, measurement, asked, told)
    return found if known is None else found.since(known)


class _Asked(NamedTuple):
    """What is to be found out, and how."""

    candidates: list[str]
    kinds: list[str]
    max_effects: int
    catalog: Mapping[str, type[Effect]]
    always: bool
    """Whether mistakes are raced whatever is found."""
    thorough: bool


def _explained(full: Model, measurement: Measurement, asked: _Asked, reporter: ProgressReporter) -> Explanation:
    """The race, and all that is told of its answer."""
    # A gain of zero would explain what shows nothing.
    nothing, catalog, progress = measurement.rms == 0.0, asked.catalog, reporter.stage
    candidates, kinds = ([], []) if nothing else (asked.candidates, asked.kinds)
    undriven = undriven_orders(full.plus([catalog[name]() for name in candidates]), measurement)
    kept = aligned_half_orders(without_orders(measurement, undriven))
    contest = make_contest(full, kept, candidates, catalog, reporter.budget)
    if contest.coupled & {*candidates, *(e.name for e in full.effects)}:
        make_programs_ahead(contest.space, kept)
    stated = _as_stated(contest, full)
    written = race_of_mistakes(contest, kinds, asked.max_effects, catalog, progress, always=asked.always)
    written = written._replace(ranked=tuple(answer.with_values() for answer in written.ranked))
    with reporter.budget.ahead(FOR_THE_STEPS):
        right, selection = _as_done(full, written.best, candidates, catalog, progress)
    return _answer(right, stated, written, selection, undriven, catalog, asked.thorough, progress)


def _candidates(
    catalog: Mapping[str, type[Effect]], only: Iterable[str] | None, exclude: Iterable[str], with_mistakes: bool
) -> tuple[list[str], list[str]]:
    """Effects, and kinds of mistakes in what was written down, that may be the answer; ``ValueError`` for an unknown
    name.
    """
    every = (*catalog, *(KINDS if with_mistakes else ()))
    chosen, without = every if only is None else several(only), several(exclude)
    if unknown := [name for name in (*chosen, *without) if name not in catalog and name not in KINDS]:
        raise ValueError(f"unknown effect {unknown[0]!r}; the catalogue has {', '.join((*catalog, *KINDS))}")
    allowed = [name for name in chosen if name not in without]
    return [name for name in allowed if name in catalog], [name for name in allowed if name in KINDS]


def _as_done(
    model: Model,
    answer: Answer,
    candidates: list[str],
    catalog: Mapping[str, type[Effect]],
    progress: Progress,
) -> tuple[Model, Selection]:
    """The model and the search as they are with what was written down wrongly put right."""
    selection, mistake = answer.selection, answer.mistake
    if mistake is None:
        return model, selection
    contest = selection.contest
    right, measurement = mistake.corrected(model, contest.measurement)
    if not mistake.in_mirror and mistake.kind not in {*RUN_EFFECTS, WRONG}:
        return right, selection if selection.tried_all else select(selection.begun(), selection.most, progress=progress)
    # Searched in a mirror, with values fitted along or with readings doubted: now the rotor itself, with what they came
    # to, and without those.
    model = reversed_rotation(model) if mistake.in_mirror else right
    own = make_contest(model, measurement, candidates, catalog, contest.budget)
    if selection.effects:
        effects, near = frozenset(selection.effects), None
        if not mistake.in_mirror:
            end = selection.known[selection.present].best
            point = np.where(own.free(effects), end.point, own.space.given_unknowns())
            near = end._replace(point=point, exact=False)
        begun = begin_beside(own, effects, near, progress=progress)
        if near is not None or begun.noise.allowance <= MIRRORED * answer.misfit:
            return model, select(begun, selection.most, progress=progress)
    begun = begin(own, progress=progress)
    if measurement.sigma is not None and (linear := as_stated(own)).may_hold:
        begun = with_set(begun, selection.most, {linear.beside: linear.end})
    return model, select(begun, selection.most, progress=progress)


def _as_stated(contest: Contest, model: Model) -> Comparison:
    """The model as declared against the measurement, whatever was measured."""
    m = contest.measurement
    given = contest.space.given_unknowns()
    if np.any(contest.space.coupled() & (given != 0.0)):
        return compare(model, m)
    declared = predict(contest.space, m.conditions, given, budget=contest.budget).shown
    require_steady(declared, m)
    return compare_vectors(declared, m, model)


def _answer(
    model: Model,
    stated: Comparison,
    written: MistakeRace,
    selection: Selection,
    undriven: tuple[float, ...],
    catalog: Mapping[str, type[Effect]],
    thorough: bool,
    progress: Progress,
) -> Explanation:
    budget = selection.contest.budget
    left_out = ["mistakes in rig file and table"] if written.left_out else []
    stages = Stages(budget, thorough, progress, [*left_out, "a further effect"] if budget.exhausted else [])
    selection, ties, noise = _with_ties(selection, written.best.ties, catalog, stages)
    contest, held = selection.contest, _held_out(selection, ties, stages)
    # What is shown has settled, even where the search was cut off.
    with contest.budget.ahead(FOR_THE_STEPS):
        story = _story(selection, model, stated, held, undriven, written.best.mistake)
    fits = story.fits
    p, proposal = _more_than_noise(selection, fits[-1], stages), _proposal(selection, ties, noise)
    # What is too small to be added is there all the same when it is judged what is left.
    last = fits[-1]
    if selection.small and not selection.effects:
        last = fit_of(contest, model, selection, selection.present, selection.races[-1].noise, (None, ""))
    verdict = _verdict(selection, ties, p, last, contest, story)
    contest.budget.release()
    named, verdict = _outside_the_catalogue(verdict, story, selection, catalog, stages)
    if verdict != "unexplained" and (stages.untried or written.tied):
        verdict = "undecided"
    if verdict == "nothing missing" and written.best.mistake is not None:
        verdict = "explained"
    return Explanation(
        verdict=verdict,
        effects=selection.effects,
        written=written,
        story=story,
        races=selection.races,
        ties=ties,
        detected_but_small=_small(contest, selection),
        next_measurement=proposal,
        p_value=p,
        noise=noise,
        contest=contest,
        max_effects=selection.most,
        catalog=dict(catalog),
        named_force=named,
        cost=Cost(contest.budget.spent, contest.budget.limit or 0, tuple(stages.untried)),
    )


def _held_out(selection: Selection, ties: Ties, stages: Stages) -> HeldOut:
    """Errors on data left out of the fits, as far as the budget reaches."""
    if not stages.go("error on data held out"):
        why = "the limit of linearisations was reached" if stages.thorough else "not asked for"
        return HeldOut((None,) * len(selection.races), why)
    held = held_out(selection.contest, selection, ties)
    stages.ended("error on data held out")
    return held


def _story(
    selection: Selection,
    model: Model,
    stated: Comparison,
    held: HeldOut,
    undriven: tuple[float, ...],
    mistake: Mistake | None,
) -> Story:
    """The model as declared against the measurement, and after every effect that was added."""
    contest = selection.contest
    fits = fits_of_steps(contest, model, selection, held)
    views = tuple(compare_vectors(f.predicted, contest.measurement, f.model) for f in fits)
    return Story(
        model, contest.measurement, stated, selection.effects, fits, views, (), undriven, mistake, selection.beside
    )


def _more_than_noise(selection: Selection, last: Fit, stages: Stages) -> PValue | None:
    """Probability of leaving as much as the answer does, where the noise is known."""
    contest = selection.contest
    if contest.measurement.sigma is None or not stages.go("whether what is left is more than noise"):
        return None
    best = selection.known[selection.present]
    led = best.led_by(last.end, Noise(last.misfit, contest.floor.scatter))
    p = p_value(contest, best if selection.small and not selection.effects else led)
    stages.ended("whether what is left is more than noise")
    return p


def _proposal(selection: Selection, ties: Ties, noise: Noise) -> Proposal | None:
    """Readings that would settle the nearest tie that readings would settle, or else those that tell most; where
    nothing ties, whether what may be missing beside the answer is.
    """
    best: Proposal | None = None
    open_now = [((other.instead_of, other.effects), other.contender) for other in ties.tied]
    if not open_now:
        open_now = [(((), (r.effect,)), r.contender) for r in selection.more if r.contender.balanced]
    for names, contender in open_now[:MOST_SEPARATED]:
        found = next_measurement(selection.contest, noise, ties.winner.best, contender.best, names)
        if found is None or (best is not None and best.standardised_difference >= found.standardised_difference):
            continue
        best = found
        if best.settles:
            break
    return best


def _outside_the_catalogue(
    verdict: Verdict,
    story: Story,
    selection: Selection,
    catalog: Mapping[str, type[Effect]],
    stages: Stages,
) -> tuple[NamedForce | None, Verdict]:
    """The force that is missing where nothing explains, or one that does as well: then it is undecided. None where no
    more than noise was measured.
    """
    first, last = story.fits[0], story.fits[-1]
    if story.hardly_moves:
        return None, verdict
    if verdict == "unexplained":
        asked = stages.go("the force that is missing")
        return name_force(first, last, selection.effects, catalog) if asked else None, verdict
    known = selection.contest.measurement.sigma is not None
    if (not selection.effects and known) or not stages.go("whether a force outside the catalogue would do as well"):
        return None, verdict
    named = other_force(first, last, selection.effects, catalog, doubtful=bool(last.objections(selection.effects)))
    named = named or other_power(first, last, selection.effects)
    stages.ended("whether a force outside the catalogue would do as well")
    return named, verdict if named is None else "undecided"


def _with_ties(
    selection: Selection, known: Ties | None, catalog: Mapping[str, type[Effect]], stages: Stages
) -> tuple[Selection, Ties, Noise]:
    """What else would do as well, and the noise that the answer leaves; a tie that turns out more probable is the
    answer. **Arguments:** ``known``: what ties, where that was looked at.
    """
    contest = selection.contest
    if known is None and contest.budget.exhausted:
        stages.untried.append("what else would do as well")
        return selection, Ties((), (), (), selection.known[selection.present], {}), noise_left(selection)
    if known is None:
        stages.progress("what else would do as well")
    best, ties = (selection, known) if known is not None else settled(selection, catalog)
    if contest.budget.exhausted:
        # What was linearised once only says nothing.
        stages.untried.append("part of what else would do as well")
        ties = ties._replace(tied=(), of_small=(), contains=())
    return best, ties, noise_left(best)


def _verdict(selection: Selection, ties: Ties, p: PValue | None, last: Fit, contest: Contest, story: Story) -> Verdict:
    m = contest.measurement
    if story.hardly_moves and m.rms > 0.0:
        return "undecided"
    if p is not None:
        structure = p.value <= UNEXPLAINED
    else:
        structure = _is_more_than_noise(last.misfit, contest) and (m.sigma is None or _nominal(last) <= UNEXPLAINED)
    if structure:
        return "unexplained"
    if ties.tied or not story.confirmed or last.objections(selection.effects, story.mistake) or selection.more:
        return "undecided"
    return "explained" if selection.effects else "nothing missing"


def _is_more_than_noise(misfit: float, contest: Contest) -> bool:
    """Whether an answer leaves this much misfit besides noise, at first sight."""
    m = contest.measurement
    return is_large(misfit, m) if m.sigma is None else misfit > contest.floor.allowance


def _nominal(last: Fit) -> float:
    """P-value by the chi-square distribution, where none was drawn."""
    freedom = np.count_nonzero(last.stage.measurement.weights(0.0)) - int(last.stage.free.sum())
    return float(chdtrc(freedom, freedom * last.reduced_chi2)) if last.reduced_chi2 is not None else 1.0


def _small(contest: Contest, selection: Selection) -> tuple[Small, ...]:
    """What was detected and not added, each with the size of its part in the prediction."""
    found, contender = [], selection.known[selection.present]
    for name in selection.small:
        change = change_by(contest, contender, [name])
        noise = noise_size(
            contest.measurement, selection.races[-1].noise if contest.measurement.sigma is None else contest.floor
        )
        # Found small beside fewer effects, it need not be so in the end.
        beside = "less than the noise of" if change <= noise else "against a noise of"
        found.append(
            Small(
                name,
                f"it changes the prediction by {change / MICROMETRE:.2g} µm rms, {beside} {noise / MICROMETRE:.2g} µm",
            )
        )
    return tuple(found)
