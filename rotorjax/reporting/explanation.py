"""What people read of an explanation: the verdict in a sentence, rankings, ties, the next measurement, JSON."""

from rotorjax.data.declarations import Slip
from rotorjax.data.rig import Rig
from rotorjax.diagnosis.critical_speeds import CriticalSpeed, critical_speeds
from rotorjax.discovery.explain import Explanation
from rotorjax.discovery.fit import Fit
from rotorjax.discovery.named_force import NamedForce
from rotorjax.discovery.rivals import TIE
from rotorjax.discovery.search import DETECTED, Ranked, none_left
from rotorjax.discovery.ties import Alternative
from rotorjax.inference.noise import NO_SCATTER
from rotorjax.model.model import Model
from rotorjax.reporting.balance import Balance, balance_lines, balance_of_fit, predicted_table
from rotorjax.reporting.comparison import (
    findings,
    measurement_line,
    share_table,
    sizes_by_effect,
    step_tables,
    worst_cells,
)
from rotorjax.reporting.page import Headline, Page, Picture
from rotorjax.reporting.tables import Table, laid_out, number
from rotorjax.units import MICROMETRE, unit_of

SHOWN = 6
"""Effects shown in a ranking."""
SLIGHT = 0.05
"""Share of what was measured below which an unexplained rest may be a question of the declared noise."""
ALIKE = 1.0
"""Standard errors rms up to which two predictions are the same within the noise."""
SAID = 2
"""Ties with one part of the answer that a sentence names; of more the nearest, and a table lists all."""
MOST_CONTAINS = 3
"""Larger sets named as containing the answer."""


def listed(names: tuple[str, ...] | list[str]) -> str:
    """Names in a sentence."""
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def sentence(found: Explanation) -> str:
    """The answer in a few sentences."""
    first = _misses(found)
    parts = {
        "nothing missing": [_nothing(found), first],
        "explained": [_missing(found), first, _fall(found)],
        "undecided": [_undecided(found), first, _fall(found) if found.named else ""],
        "unexplained": [_unexplained(found), first, _fall(found) if found.named else ""],
    }[found.verdict]
    named = _missing_force(found)
    if found.verdict == "unexplained" and found.named_force is not None and found.named_force.enough:
        # What explains all comes before what explains a part.
        parts = [parts[0], *named, *parts[1:], *_ties(found), _left(found)]
    else:
        parts = [*parts, *_ties(found), _left(found), *named]
    return " ".join(part for part in parts if part)


def _misses(found: Explanation) -> str:
    """How far the model as declared is off."""
    before, size = found.story.declared.rms / MICROMETRE, found.story.measurement.rms / MICROMETRE
    share = f", {number(100.0 * before / size, 2)} % of the measured {number(size)} µm" if size > 0.0 else ""
    return f"The model as declared misses by {number(before)} µm rms{share}."


def _missing(found: Explanation) -> str:
    missing = f"Missing: {listed(found.effects)}." if found.effects else "Nothing is missing beside."
    return missing if found.slip is None else f"{_slip(found.slip)} {missing}"


def _slip(slip: Slip) -> str:
    """What was written down wrongly, and what to change."""
    return f"Written down wrongly: {slip.name}, {slip.meaning} ({slip.cure})."


def _nothing(found: Explanation) -> str:
    if found.contest.measurement.sigma is None:
        return "No effect stands out; the noise is unknown, so that this says little."
    if found.detected_but_small:
        return "Nothing is missing that matters."
    return "Nothing is missing that these data could show."


def _undecided(found: Explanation) -> str:
    others = ["others do as well"] if found.tied_groups() or found.named_force is not None else []
    fails = [] if found.confirmed else ["on data held out the error does not fall"]
    limit = ["the limit of linearisations was reached"] if found.cost.exhausted else []
    likely = " or ".join(f"{r.effect} ({100.0 * r.probability:.0f} %)" for r in found.more[:SAID])
    more = [f"something more is probable, such as {likely}"] if found.more else []
    what = listed(found.named) if found.named else "nothing that stands out so far"
    return f"Undecided: {what}, but {listed([*others, *fails, *found.objections, *more, *limit])}."


def _unexplained(found: Explanation) -> str:
    if found.contest.measurement.rms == 0.0:
        return "Unexplained: every measured vector is zero; check that the probes and the recording deliver anything."
    if (ahead := _would_be_next(found)) is not None:
        return f"Unexplained: no more than {found.max_effects} effects were to be added, and {ahead} would be next."
    those = "those allowed" if found.restricted else "the catalogue"
    if not found.named:
        return f"Unexplained: no effect of {those} accounts for what the model misses."
    accounts = "accounts" if len(found.named) == 1 else "account"
    return (
        f"Unexplained: {listed(found.named)} {accounts} for part of what the model misses, and no further effect of "
        f"{those} for the rest."
    )


def _would_be_next(found: Explanation) -> str | None:
    """The effect at which the limit on their number stopped the search, if it did."""
    return found.more[0].effect if found.more and len(found.effects) >= found.max_effects else None


def _fall(found: Explanation) -> str:
    story = found.story
    before, after = (story.views[0] if found.slip is None else story.declared).rms, story.last.rms
    held = story.fits[-1].held_out_rms
    fold = f"{number(before / after)}-fold" if after > 0.0 else "to nothing"
    held_text = f" ({number(before / held)}-fold on data held out)" if held else ""
    return f"With {listed(found.named)} the error falls {fold}{held_text} to {number(after / MICROMETRE)} µm rms."


def _left(found: Explanation) -> str:
    p = found.p_value
    if p is None:
        return (
            "The noise is unknown, so that nothing says whether what is left is more than noise."
            if found.contest.measurement.sigma is None
            else ""
        )
    sign = "<=" if p.value <= 1.0 / (p.draws + 1) + 1e-12 else ""
    scatter = " and the scatter between runs" if found.noise.scatter != NO_SCATTER else ""
    judged = "is more than" if found.verdict == "unexplained" else "is what"
    allow = "" if found.verdict == "unexplained" else " allow" if scatter else " allows"
    return f"What is left {judged} the noise{scatter}{allow} (p {sign or '='} {number(p.value, 2)}, {p.draws} draws)."


def _missing_force(found: Explanation) -> list[str]:
    """What the missing force looks like, and what the terms do in the response."""
    named = found.named_force
    if named is None:
        return []
    if named.force.reason is not None:
        return [f"The missing force cannot be shown: {named.force.reason}."]
    held = [
        f"Along {'xy'[axis]} the rotor hardly moves, though without the missing force it would: friction, a stop or a "
        "stiff spring may do that, "
        "so that its shape there is doubtful."
        for axis in named.force.held
    ]
    if named.fit is None:
        return held or ["The force that is missing has no simple shape."]
    return [*held, _named(found, named, named.fit)]


def _named(found: Explanation, named: NamedForce, fitted: Fit) -> str:
    """The terms, and the error with them."""
    after = number(found.story.measurement.rms_of(fitted.predicted) / MICROMETRE)
    held = (
        f" ({number(fitted.held_out_rms / MICROMETRE)} µm on data held out)" if fitted.held_out_rms is not None else ""
    )
    beside = f"beside {listed(named.beside)}" if named.beside else "beside the model as declared"
    words = f"{named.words} (or, hardly worse, {', or '.join(named.rivals)})" if named.rivals else named.words
    if found.verdict != "unexplained":
        how = (
            "A simpler force would do as well"
            if len(named.terms) < len(found.effects)
            else "A force outside the catalogue would do better"
        )
        return f"{how}, {beside}: {words}. With it alone the error is {after} µm rms{held}."
    rest = (
        ", which is what the noise allows"
        if named.enough
        else ""
        if found.contest.measurement.sigma is None
        else ", still more than the noise"
    )
    return (
        f"The force that is missing {beside} looks like this: {words}. Added as a term it brings the error to {after} "
        f"µm rms{held}{rest}."
    )


def missing_force_table(named: NamedForce) -> Table | None:
    """Terms of the missing force with their values: in the equation of motion, then fitted in the response."""
    if named.fit is None:
        return None
    values = {(e.entry.effect, e.entry.label): e for e in named.fit.estimates}
    rows = []
    for term in named.terms:
        for name in dict.fromkeys([*term.coefficients, *(label for effect, label in values if effect == term.term)]):
            unit, value, e = unit_of(name), term.coefficients.get(name), values.get((term.term, name))
            fitted = (
                [number(e.value / unit.factor), number(e.standard_error / unit.factor, 2)]
                if e is not None
                else ["", ""]
            )
            rows.append(
                [
                    f"{term.term}.{name}",
                    term.plain,
                    "" if value is None else number(value / unit.factor),
                    *fitted,
                    unit.shown,
                ]
            )
    note = (
        "Add a term by `rotorjax compare --effect NAME`, or hand it to explain by catalog=CATALOG | TERMS "
        "(rotorjax.effects.terms)."
    )
    others = sorted({words for term in named.terms for words in term.rivals})
    note += f" Nearly as well in the equation of motion: {'; '.join(others)}." if others else ""
    headers = ["term", "meaning", "in the equation", "in the response", "±", "unit"]
    return Table("Terms of the missing force", headers, rows, note, spare=["in the equation", "meaning"])


def _ties(found: Explanation) -> list[str]:
    return [f"These data cannot tell {listed(names[0])} from {_others(names[1:])}." for names in found.tied_groups()]


def _others(sets: list[list[str]]) -> str:
    """Sets in a sentence; of many the nearest."""
    if len(sets) <= SAID:
        return ", or from ".join(listed(names) for names in sets)
    return f"{listed(sets[0])}, or from {len(sets) - 1} other sets listed below"


def critical_speeds_line(found: Explanation) -> str:
    """Critical speeds with what was added, and as declared where they differ."""
    before, after = (critical_speeds(model) for model in before_and_after(found))
    if not after:
        return ""
    told = f"Critical speeds: {_told(after)}"
    return (
        f"{told}; as declared {_told(before)}."
        if found.effects and before and _told(before) != _told(after)
        else f"{told}."
    )


def _told(speeds: tuple[CriticalSpeed, ...]) -> str:
    """Speeds in a sentence, with their amplification factors and damping ratios."""
    factors = [
        f"{one.speed_rpm:.0f} rpm"
        + (
            ""
            if one.amplification is None
            else f" (amplification factor {number(one.amplification)}, damping ratio "
            f"{number(50.0 / one.amplification, 2)} %)"
        )
        for one in speeds
    ]
    return listed(factors)


def before_and_after(found: Explanation) -> tuple[Model, Model]:
    """The model as declared, and with what was added, for the orders measured."""
    orders = found.story.measurement.orders
    return found.story.model.with_orders(orders), found.model.with_orders(orders)


def _to_balance(found: Explanation, rig: Rig | None) -> list[str]:
    """What would balance the rotor, where an unbalance was found."""
    open_names = {name for group in found.ties.groups() for names in group for name in names}
    doubt = ", if it is an unbalance indeed" if "residual_unbalance" in open_names else ""
    return balance_lines(balance_of(found, rig)._replace(proviso=doubt))


def balance_of(found: Explanation, rig: Rig | None) -> Balance:
    """What corrects the unbalance found, plane by plane; nothing without a rig."""
    return Balance() if rig is None else balance_of_fit(found.story.fits[-1], rig, found.story.measurement)


def ties_table(found: Explanation) -> Table | None:
    """What the data leave open, the nearest first."""
    if not found.ties.tied:
        return None
    tied = sorted(found.ties.tied, key=lambda t: t.instead_of)
    rows = [[listed(t.instead_of), listed(t.effects), f"{t.gap:.1f}", number(t.apart, 2), _why_tied(t)] for t in tied]
    headers = ["in the place of", "would do as well", "log evidence behind", "predictions differ by", "remark"]
    note = (
        "Predictions differ, at the readings taken, by so many standard errors rms, with what the answer leaves "
        "counted as error."
    )
    spare = ["predictions differ by", "log evidence behind"]
    return Table("What these data cannot tell apart", headers, rows, note, spare=spare)


def _why_tied(tied: Alternative) -> str:
    same = "misses elsewhere, not less" if tied.apart > ALIKE else "predicts the same within the error"
    return same if tied.gap < TIE else f"{same}; leads where priors are three times as wide or as narrow"


def notes(found: Explanation) -> list[str]:
    """What else a user must know."""
    lines = []
    lines += _same_bow(found)
    lines += [_contains(other) for other in found.ties.contains[:MOST_CONTAINS]]
    if found.next_measurement is not None:
        n = found.next_measurement
        one, other = (listed(names) for names in n.separates)
        where = f"{n.run} at {n.speed_rpm:.0f} rpm" + (
            f", with {listed(n.new_probes)}, not read so far" if n.new_probes else ""
        )
        lines.append(
            f"Measure next: {where}; there {one} and {other} differ by {number(n.standardised_difference, 2)} standard "
            "errors."
        )
    elif found.ties.tied:
        advice = ""
        names = {name for group in found.ties.groups() for names in group for name in names}
        if (
            found.story.model.slow_roll is not None
            and "residual_unbalance" in names
            and names & {"residual_bow", "thermal_bow"}
        ):
            advice = "; vectors without the slow-roll subtraction would tell a bow from an unbalance"
        lines.append(f"No reading within the limits would settle the tie{advice}.")
    share = found.story.last.rms / found.contest.measurement.rms if found.contest.measurement.rms > 0.0 else 1.0
    if found.verdict == "unexplained" and share < SLIGHT:
        lines.append(
            f"What is left is only {number(100.0 * share, 2)} % of what was measured: if sigma_um is too small, or the "
            "model's form need not be better "
            "than that ([model] tolerance), it is explained."
        )
    lines += _orders_lacking(found)
    lines += [f"Detected, but not added: {small.effect} ({small.why})." for small in found.detected_but_small]
    return lines + findings(found.story)


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
                f"{name} is told by {orders} too, which these data do not hold: measure that order, and the answer is "
                "surer."
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
        "and phase of the chain change all vectors alike, and neither pins the unbalance."
    ]


def _contains(other: Alternative) -> str:
    verbs = ("does", "is") if len(other.effects) == 1 else ("together do", "are")
    answer = f"{listed(other.instead_of)} {'does' if len(other.instead_of) == 1 else 'do'}"
    behind = number(other.gap, 2)
    return (
        f"{listed(other.effects)} {verbs[0]} what {answer}, with more determined parameters, and {verbs[1]} not needed "
        f"(log evidence {behind} behind)."
    )


def ranking_tables(found: Explanation) -> list[Table]:
    """What a further effect would bring, at every step."""
    tables = []
    for step, ranked in enumerate(found.rankings):
        there = [
            *found.effects[:step],
            *(small.effect for small in found.detected_but_small if step == len(found.effects)),
        ]
        beside = f"beside {listed(there)}" if there else "in the model as declared"
        rows = [
            [r.effect, _probability(r.probability), number(r.log_evidence, 5), _chi2(found, r)] for r in _shown(ranked)
        ]
        note = "" if step < len(found.effects) else _why_stopped(found, ranked)
        headers, spare = ["effect", "probability", "log evidence", "chi² / freedom"], ["chi² / freedom", "log evidence"]
        tables.append(Table(f"What is missing {beside}", headers, rows, note, spare=spare))
    return tables


def _why_stopped(found: Explanation, ranked: tuple[Ranked, ...]) -> str:
    if none_left(ranked) >= DETECTED:
        return f'Nothing is added while "none" has a probability of {100.0 * DETECTED:g} % or more.'
    if _would_be_next(found) is not None:
        return f"No more than {found.max_effects} effects were to be added."
    return "None of these is detected by itself: nothing is added."


def _shown(ranked: tuple[Ranked, ...]) -> list[Ranked]:
    none = [r for r in ranked[SHOWN:] if r.effect == "none"]
    return [*ranked[:SHOWN], *none]


def _probability(value: float) -> str:
    return f"{value:.4f}" if value >= 1e-4 else f"{value:.1e}" if value > 1e-99 else "0"


def _chi2(found: Explanation, ranked: Ranked) -> str:
    return number(found.chi2(ranked), 3)


def explanation_tables(found: Explanation) -> list[Table]:
    """Error fall, parameters, what ties, terms of the missing force, rankings."""
    terms = None if found.named_force is None else missing_force_table(found.named_force)
    return [
        *step_tables(found.story),
        *(table for table in (ties_table(found), terms) if table is not None),
        *ranking_tables(found),
    ]


def cost_line(found: Explanation) -> str:
    """What the explanation took, and what the limit left out."""
    cost = found.cost
    line = f"{cost.linearisations:,} linearisations of single cases, of {cost.limit:,} allowed."
    return f"{line} Not tried when the limit was reached: {listed(cost.untried)}." if cost.exhausted else line


def explanation_text(found: Explanation, rig: Rig | None = None, *, width: int | None = None) -> str:
    """Everything that `rotorjax explain` prints. **Arguments:** ``rig``: for what would balance the rotor; ``width``:
    columns of the terminal, if it is one.
    """
    parts: list[str | Table] = [measurement_line(found.story.measurement), sentence(found)]
    parts += ["\n".join(f"- {line}" for line in notes(found))] if notes(found) else []
    parts += [line for line in (critical_speeds_line(found), *_to_balance(found, rig)) if line]
    parts += explanation_tables(found)
    parts.append(worst_cells(found.story.last, "Where it still fails" if found.named else "Where it fails"))
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
    story = found.story
    where = [worst_cells(story.declared, "Where the model as declared fails")]
    where += [worst_cells(story.last, "Where it fails with what was added")] if story.changed else []
    where.append(share_table(story.last, "Share of what is left"))
    said, drawn = notes(found), Picture.every(pictures)
    top, tables, model = headline(found, first or [], rig), explanation_tables(found), before_and_after(found)[1]
    speeds = story.measurement.speed_cluster()[1]
    tables += [predicted_table(model, one, speeds) for one in balance_of(found, rig).corrections]
    return Page(
        title, top, sentence(found), measurement_line(story.measurement), said, tables, drawn, where, cost_line(found)
    )


def headline(found: Explanation, pictures: list[tuple[str, bytes]], rig: Rig | None = None) -> Headline:
    """What is seen without scrolling."""
    told = {"nothing missing": _nothing, "explained": _missing, "undecided": _undecided, "unexplained": _unexplained}[
        found.verdict
    ](found)
    effects = sizes_by_effect(found.story.fits[-1], found.effects, None if rig is None else rig.convention)
    next_one = [line for line in notes(found) if line.startswith(("Measure next", "No reading within"))]
    lines = [line for line in (*_to_balance(found, rig), critical_speeds_line(found), *_ties(found), *next_one) if line]
    fall = " ".join(filter(None, (_misses(found), _fall(found) if found.named else "", _left(found))))
    return Headline(found.verdict, told, fall, effects, lines, Picture.every(pictures))
