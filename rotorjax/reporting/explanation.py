"""What people read of an explanation: the verdict in a sentence, rankings, ties, the next measurement, JSON."""

import math

from rotorjax.data.rig import Rig
from rotorjax.data.rig_sections import Convention
from rotorjax.discovery.explanation import Explanation
from rotorjax.discovery.next_measurement import Proposal
from rotorjax.discovery.probable import CREDIBLE, credible
from rotorjax.discovery.ranking import DETECTED, Ranked
from rotorjax.discovery.rivals import TIE
from rotorjax.discovery.ties import Alternative
from rotorjax.inference.covariance import anything_random
from rotorjax.reporting.answer import (
    as_if_lines,
    fall_line,
    left_line,
    misses,
    sentence,
    slight,
    tie_lines,
    verdict_sentence,
    would_be_next,
)
from rotorjax.reporting.balance import predicted_table
from rotorjax.reporting.comparison import (
    CHI2,
    SUSPICIOUS_CHI2,
    findings,
    measurement_line,
    share_table,
    sizes_by_effect,
    step_tables,
    worst_cells,
)
from rotorjax.reporting.correction import balance_of, correction_lines
from rotorjax.reporting.critical_speeds import critical_speeds_lines, critical_speeds_table
from rotorjax.reporting.healthy import healthy_lines, healthy_table
from rotorjax.reporting.missing_force import missing_force_lines, missing_force_table
from rotorjax.reporting.page import Headline, Page, Picture
from rotorjax.reporting.tables import Table, laid_out, number
from rotorjax.reporting.wording import listed, opening, percent, plain_name, said

SHOWN = 6
"""Rows shown of a ranking."""
SLIGHT = 0.05
"""Share of what was measured below which an unexplained rest may be a question of the declared noise."""
ALIKE = 1.0
"""Standard errors rms up to which two predictions are the same within the noise."""
CERTAIN = 0.99
"""P-value from which on an answer leaves less than the noise of the table."""
OVERSTATED = 0.5
"""Reduced chi-square up to which standard errors are called too large then."""
MOST_TOLD = 3
"""Mistakes told that were not searched to the end."""
MOST_CONTAINS = 3
"""Larger sets named as containing the answer."""


def _critical_speeds(found: Explanation) -> list[str]:
    return critical_speeds_lines(found.story, explains=found.verdict != "unexplained")


def ties_table(found: Explanation) -> Table | None:
    """What the data leave open, the nearest first."""
    if not found.ties.tied:
        return None
    tied = sorted(found.ties.tied, key=lambda t: t.instead_of)
    rows = [
        [listed(t.instead_of) or "nothing", listed(t.effects), f"{t.gap:.1f}", number(t.apart, 2), _why_tied(t)]
        for t in tied
    ]
    headers = ["instead of", "fits as well", "log evidence behind", "predictions differ by", "remark"]
    note = (
        "Predictions differ, at the readings taken, by so many standard errors rms, with what the answer leaves "
        "counted as error."
    )
    spare = ["predictions differ by", "log evidence behind"]
    return Table("What these data cannot tell apart", headers, rows, note, spare=spare)


def probable_table(found: Explanation) -> Table | None:
    """The most probable explanations as wholes, until they have 95 % together."""
    chosen = credible(found.probable)
    rows = [[" + ".join(one.names) or "none", percent(one.probability)] for one in chosen[:SHOWN]]
    if not rows:
        return None
    more = [f"{len(chosen) - SHOWN} more are needed for {percent(CREDIBLE, 0)}."] if len(chosen) > SHOWN else []
    tried = [] if found.written.tried else ["Mistakes in rig file and table were not tried."]
    limit = ["The search limit was reached before all was fitted."] if found.cost.exhausted else []
    note = " ".join(["Among all sets of effects that were fitted.", *more, *tried, *limit])
    return Table("The most probable explanations", ["explanation", "probability"], rows, note)


def _why_tied(tied: Alternative) -> str:
    if not tied.instead_of:
        return "within the tolerance of the model's form"
    if tied.gap < -TIE:
        return "more probable, but more effects than were to be added (--max-effects)"
    same = (
        "predictions differ, the overall fit is as good" if tied.apart > ALIKE else "predicts the same within the noise"
    )
    return same if tied.gap < TIE else f"{same}; only with prior scales three times as wide, or without the tolerance"


def notes(found: Explanation) -> list[str]:
    """What else a user must know."""
    contains = [_contains(other) for other in found.ties.contains[:MOST_CONTAINS]]
    left = [
        *_of_what_is_left(found),
        *_less_than_noise(found),
        *_orders_lacking(found),
        *_small(found),
        *_cut_off(found),
    ]
    return [*_same_bow(found), *contains, *next_lines(found), *left, *findings(found.story)]


def next_lines(found: Explanation) -> list[str]:
    """What to measure next, where something is open."""
    if found.next_measurement is not None:
        n = found.next_measurement
        one, other = (said(names) for names in n.separates)
        differ = f"{one} and {other} differ by" if one else f"{other} would show by"
        there = "there" if len(n.speeds_rpm) == 1 else "at these together"
        doubt = "" if n.settles else "; that need not settle it"
        return [
            f"Measure next: {readings_in_words(n)}; {there} {differ} "
            f"{number(n.standardised_difference, 2)} standard errors{doubt}."
        ]
    if not found.ties.tied:
        first = found.more[:1] if found.verdict == "undecided" else ()
        return [f"A few more readings would not show whether {plain_name(r.effect)} is missing." for r in first]
    names, advice = _open_names(found), ""
    if (
        found.story.model.slow_roll is not None
        and "residual_unbalance" in names
        and names & {"residual_bow", "thermal_bow"}
    ):
        advice = "; vectors without the slow-roll subtraction would tell a bow from an unbalance"
    where = "within the limits"
    if found.contest.measurement.knowledge.limits.speed_rpm is None:
        where = "up to the highest speed measured"
        advice += "; readings at higher speeds may, if the machine allows them ([limits] speed_rpm in the rig file)"
    return [f"No readings {where} would settle the tie{advice}."]


def readings_in_words(proposal: Proposal) -> str:
    """The readings proposed: run, speeds, probes not read so far."""
    speeds = listed([f"{speed:.0f}" for speed in sorted(proposal.speeds_rpm)])
    probes = f", with {listed(proposal.new_probes)}, not read so far" if proposal.new_probes else ""
    return f"{proposal.run} at {speeds} rpm{probes}"


def _open_names(found: Explanation) -> set[str]:
    """Effects that tie with others."""
    return {name for group in found.ties.groups() for names in group for name in names}


def _of_what_is_left(found: Explanation) -> list[str]:
    """Whether an unexplained rest is small beside what was measured."""
    share = found.story.last.rms / found.contest.measurement.rms if found.contest.measurement.rms > 0.0 else 1.0
    if found.verdict != "unexplained" or share >= SLIGHT:
        return []
    return [
        f"What is left is only {number(100.0 * share, 2)} % of what was measured: if sigma_um is too small, or the "
        "model's form need not be better than that ([model] tolerance), it is explained."
    ]


def _less_than_noise(found: Explanation) -> list[str]:
    """Whether much less is left than the standard errors of the table say, where nothing else is declared or found that
    would be random.
    """
    last, p, knowledge = found.story.last, found.p_value, found.contest.measurement.knowledge
    if knowledge.tolerance > 0.0 or anything_random(knowledge, found.contest.floor.scatter):
        return []
    if p is None or p.value < CERTAIN or last.reduced_chi2 is None:
        return []
    # Of what is less `findings` tells.
    if not SUSPICIOUS_CHI2 <= last.reduced_chi2 <= OVERSTATED:
        return []
    times = number(1.0 / math.sqrt(last.reduced_chi2), 2)
    return [
        f"Much less is left than the standard errors say: they may be stated {times} times too large (repeated "
        "readings tell); smaller ones would tell apart more."
    ]


def _small(found: Explanation) -> list[str]:
    along = "; it is fitted along, so that it does not bias what was found" if found.story.beside else ""
    lines = [
        f"Detected, but too small to matter: {plain_name(small.effect)} ({small.why}{along})."
        for small in found.detected_but_small
    ]
    return lines + [
        f"In the place of {said(part)}, {' or '.join(map(said, others))} would do as well."
        for part, *others in found.ties.small_groups()
    ]


def _cut_off(found: Explanation) -> list[str]:
    """Mistakes in what was written down that were not searched to the end."""
    if not found.written.cut_off:
        return []
    every = [f"whether {mistake.meaning}" for mistake in found.written.cut_off]
    more = [f"{len(every) - MOST_TOLD} more of the kind"] if len(every) > MOST_TOLD + 1 else []
    meant = listed([*every[:MOST_TOLD], *more] if more else every)
    return [f"Not searched to the end, as the linearisations allowed for it were spent: {meant}."]


def _orders_lacking(found: Explanation) -> list[str]:
    """Orders by which effects in question are told, and that were not measured."""
    names = [*found.effects, *(name for group in found.ties.groups() for names in group for name in names)]
    measured = set(found.story.measurement.orders) | set(found.story.undriven)
    lines = []
    for name in dict.fromkeys(names):
        lacking = [order for order in found.catalog[name].sufficient.orders if order not in measured]
        if lacking:
            orders = listed([f"{order:g}X" for order in lacking])
            lines.append(
                f"{opening(plain_name(name))} shows at {orders} too, which was not measured: measure it to make "
                "the answer more certain."
            )
    return lines


def _same_bow(found: Explanation) -> list[str]:
    """Why a bow ties with a gain where every run carries the same installed bow."""
    open_names = {name for group in found.ties.groups() for names in group for name in names}
    ratios = found.bow_over_unbalance() if {"residual_bow", "chain_gain"} <= open_names else {}
    if not ratios:
        return []
    listed_ratios = listed([f"{number(ratio, 2)} times at {speed:.0f} rpm" for speed, ratio in ratios.items()])
    return [
        f"Every run carries the same installed bow, whose response is {listed_ratios} that of the installed unbalance: "
        "an inherent bow and a gain "
        "and phase of the chain change all vectors alike, so that the unbalance is not determined."
    ]


def _contains(other: Alternative) -> str:
    verbs = ("does", "is") if len(other.effects) == 1 else ("together do", "are")
    answer = f"{said(other.instead_of)} {'does' if len(other.instead_of) == 1 else 'do'}"
    behind = number(other.gap, 2)
    return (
        f"{opening(said(other.effects))} {verbs[0]} what {answer}, with more determined parameters, and {verbs[1]} not "
        f"needed (log evidence {behind} behind)."
    )


def ranking_tables(found: Explanation) -> list[Table]:
    """What a further effect would bring, at every step."""
    tables = []
    for step, ranked in enumerate(found.rankings):
        there = [
            *found.effects[:step],
            *(small.effect for small in found.detected_but_small if step == len(found.effects)),
        ]
        beside = f"beside {said(there)}" if there else "in the model as declared"
        rows = [[r.effect, percent(r.probability), number(found.chi2(r))] for r in _shown(ranked)]
        stopped = [_why_stopped(found, ranked)] if step == len(found.effects) else []
        note = " ".join([*stopped, *_not_fitted(found, step)])
        headers = ["effect", "probability", CHI2]
        tables.append(Table(f"What is missing {beside}", headers, rows, note, spare=[CHI2]))
    return tables


def _not_fitted(found: Explanation, step: int) -> list[str]:
    """What was not tried at a step, as where effects are found together, or beside a mistake."""
    contest, fitted = found.contest, frozenset().union(*found.races[step].contenders)
    missing = frozenset(contest.candidates) - fitted
    kinds = (
        ("other linear effects", missing - contest.costly),
        ("nonlinear forces", missing & contest.coupled),
        ("a changing speed", missing & contest.sweeping),
    )
    words = [kind for kind, some in kinds if some]
    return [f"Not fitted at this step: {listed(words)}."] if words else []


def _why_stopped(found: Explanation, ranked: tuple[Ranked, ...]) -> str:
    if would_be_next(found) is not None:
        return f"No more than {found.max_effects} effects were to be added."
    return f'An effect is added only if it is {(1.0 - DETECTED) / DETECTED:.0f} times as probable as "none".'


def _shown(ranked: tuple[Ranked, ...]) -> list[Ranked]:
    none = [r for r in ranked[SHOWN:] if r.effect == "none"]
    return [*ranked[:SHOWN], *none]


def explanation_tables(found: Explanation, rig: Rig | None = None) -> list[Table]:
    """Error fall, parameters, critical speeds, probable explanations, what ties, terms of the missing force, rankings.
    **Arguments:** ``rig`` for angles.
    """
    terms = None if found.named_force is None else missing_force_table(found.named_force)
    critical, healthy = critical_speeds_table(found.story), healthy_table(found.story.healthy)
    return [
        *step_tables(found.story, _convention(found, rig)),
        *(table for table in (critical, probable_table(found), ties_table(found), terms) if table is not None),
        *ranking_tables(found),
        *([] if healthy is None else [healthy]),
    ]


def cost_line(found: Explanation) -> str:
    """What the explanation took, and what the limit left out."""
    cost = found.cost
    line = (
        f"Search effort: {cost.linearisations:,} linearisations (one run at one speed each) of {cost.limit:,} allowed."
    )
    return (
        f"{line} Not tried when the limit of the search was reached: {listed(cost.untried)}."
        if cost.exhausted
        else line
    )


def _convention(found: Explanation, rig: Rig | None) -> Convention:
    """How angles and phases count once what was written down wrongly is put right."""
    return Convention() if rig is None else rig.put_right(found.mistake).convention


def explanation_text(found: Explanation, rig: Rig | None = None, *, width: int | None = None) -> str:
    """Everything that `rotorjax explain` prints. **Arguments:** ``rig``: for what would balance the rotor; ``width``:
    columns of the terminal, if it is one.
    """
    parts: list[str | Table] = [measurement_line(found.story.declared.measurement), *healthy_lines(found.story)]
    parts += [sentence(found)]
    parts += ["\n".join(f"- {line}" for line in notes(found))] if notes(found) else []
    parts += [*_critical_speeds(found), *correction_lines(found, rig)]
    parts += explanation_tables(found, rig)
    where, convention = "Where it still fails" if found.named else "Where it fails", _convention(found, rig)
    parts.append(worst_cells(found.story.last, where, convention))
    parts.append(cost_line(found))
    return laid_out(parts, width, everything="--report FILE.html")


def explanation_page(
    found: Explanation,
    *,
    title: str,
    pictures: list[tuple[str, bytes]],
    first: list[tuple[str, bytes]] | None = None,
    rig: Rig | None = None,
) -> Page:
    """The report of `explain`.

    **Arguments:** ``pictures``: pairs of caption and SVG; ``first``: likewise, to be seen without scrolling; ``rig``:
    for its angles and planes.
    """
    story, convention = found.story, _convention(found, rig)
    stated = None if rig is None else rig.convention
    where = [worst_cells(story.declared, "Where the model as declared fails", stated)]
    where += [worst_cells(story.last, "Where it fails with what was added", convention)] if story.changed else []
    where.append(share_table(story.last, "Share of what is left"))
    top, tables = headline(found, first or [], rig), explanation_tables(found, rig)
    model = found.model.with_orders(story.measurement.orders)
    told_above, drawn = next_lines(found), Picture.every(pictures)
    rest = healthy_lines(story) + [line for line in notes(found) if line not in told_above]
    speeds = story.measurement.speed_cluster()[1]
    if found.verdict != "unexplained":
        tables += [predicted_table(model, one, speeds) for one in balance_of(found, rig).corrections]
    return Page(
        title,
        top,
        measurement_line(story.declared.measurement),
        rest,
        tables,
        drawn,
        where,
        cost_line(found),
        convention.phase,
    )


def headline(found: Explanation, pictures: list[tuple[str, bytes]], rig: Rig | None = None) -> Headline:
    """What is seen without scrolling."""
    named = () if slight(found) else found.effects
    effects = sizes_by_effect(found.story.fits[-1], named, _convention(found, rig))
    lines = [*as_if_lines(found), *correction_lines(found, rig), *_critical_speeds(found), *tie_lines(found)]
    force, enough = missing_force_lines(found), found.named_force is not None and found.named_force.enough
    lines = [*force, *lines, *next_lines(found)] if enough else [*lines, *next_lines(found), *force]
    fall = " ".join(filter(None, (misses(found), fall_line(found), left_line(found))))
    return Headline(
        found.verdict, verdict_sentence(found), fall, effects, list(filter(None, lines)), Picture.every(pictures)
    )
