"""The answer of an explanation in sentences: what is missing, how far the error falls, what is left, what ties."""

from rotorjax.data.declarations import Mistake, amplitude_changes
from rotorjax.data.odd_runs import weights_that_tell_amplitudes
from rotorjax.discovery.bootstrap import UNEXPLAINED
from rotorjax.discovery.explanation import Explanation
from rotorjax.discovery.ranking import is_detected, none_left
from rotorjax.discovery.rivals import TIE
from rotorjax.inference.noise import NO_SCATTER
from rotorjax.reporting.comparison import misfit_share, sizes_by_effect
from rotorjax.reporting.healthy import model_compared
from rotorjax.reporting.missing_force import missing_force_lines
from rotorjax.reporting.tables import number
from rotorjax.reporting.wording import listed, opening, percent, plain_name, said
from rotorjax.units import MICROMETRE

SAID = 2
"""Ties with one part of the answer that a sentence names; of more the nearest, and a table lists all."""
HALVED = 2.0
"""Fall of the error from which on effects that do not explain all count as part of the answer."""
WRONG_BOOKS = (
    "Rig file or table may state a convention wrongly (sign of phase, sense of rotation, peak-to-peak or rms, unit, "
    "exchanged cables or runs): `--mistakes` tries these too."
)


def sentence(found: Explanation) -> str:
    """The answer in a few sentences."""
    named = missing_force_lines(found)
    first, fall = misses(found), fall_line(found)
    if found.verdict == "unexplained" and found.named_force is not None and found.named_force.enough:
        # What explains all comes before what explains a part.
        parts = [verdict_sentence(found), *named, first, fall, *as_if_lines(found), *tie_lines(found), left_line(found)]
    else:
        parts = [verdict_sentence(found), *as_if_lines(found), first, fall, *tie_lines(found), left_line(found), *named]
    return " ".join(part for part in parts if part)


def verdict_sentence(found: Explanation) -> str:
    """The verdict in a sentence or two."""
    by_verdict = {
        "nothing missing": _nothing,
        "explained": _missing,
        "undecided": _undecided,
        "unexplained": _unexplained,
    }
    return by_verdict[found.verdict](found)


def misses(found: Explanation) -> str:
    """How far the model as declared is off, and what fitting the values declared uncertain leaves of that."""
    story, fitted = found.story, ""
    if found.mistake is None and story.fits and story.fits[0].estimates:
        left = number(story.views[0].rms / MICROMETRE)
        fitted = f"; {left} µm rms remain once the values declared uncertain are adjusted"
    return f"{model_compared(story)} differs from the measurement by {misfit_share(story.declared)}{fitted}."


def _missing(found: Explanation) -> str:
    missing = f"The model lacks {_with_open_sizes(found)}." if found.effects else "Nothing else is missing."
    return missing if found.mistake is None else f"{_mistake(found.mistake)} {missing}"


def _with_open_sizes(found: Explanation) -> str:
    """The effects found; of one whose size the data leave open that is said."""
    every = sizes_by_effect(found.story.fits[-1], found.effects, None)
    return listed(
        [
            plain_name(name)
            + (" (of a size that is not determined)" if own and not any(s.determined for s in own) else "")
            for name, _, own in every
        ]
    )


def _mistake(mistake: Mistake) -> str:
    """What was written down wrongly, and what to change."""
    return f"Wrong entry in rig file or table: {mistake.meaning} ({mistake.name}; {mistake.cure})."


def _nothing(found: Explanation) -> str:
    if found.contest.measurement.sigma is None:
        return "No effect stands out; the noise is unknown, so that this says little."
    if found.detected_but_small:
        return "Nothing is missing that matters."
    return "Nothing is missing that these data could show."


HARDLY_MOVES = (
    "no more than noise was measured: weights that were not installed, probes or a recording that deliver nothing, and "
    "friction or a stop that holds the rotor look alike"
)
"""What is said where a rotor hardly moves that should."""


def _undecided(found: Explanation) -> str:
    groups = found.tied_groups()
    others = ["others do as well"] if any(first for first, *_ in groups) else []
    if any(tied.gap < -TIE for tied in found.ties.tied):
        others = [f"more than {found.max_effects} effects are more probable (--max-effects)"]
    if not others and found.named_force is not None:
        others = ["a force outside the catalogue does as well"]
    within = ["more may be missing within the tolerance of the model's form"] if not all(g[0] for g in groups) else []
    fails = [] if found.confirmed else ["the error does not fall on readings left out of the fit"]
    limit = ["the search limit was reached before all was tried (--limit raises it)"] if found.cost.exhausted else []
    likely = " or ".join(f"{plain_name(r.effect)} ({percent(r.probability, 0)})" for r in found.more[:SAID])
    beside = percent(1.0 - none_left(found.rankings[-1]), 0)
    more = [f"something more may be missing ({beside}), such as {likely}"] if found.more else []
    still = [HARDLY_MOVES] if found.story.hardly_moves else []
    mistake = [] if found.mistake is None else [plain_name(found.mistake.name)]
    named = [*mistake, *([_with_open_sizes(found)] if found.effects else [])]
    what = listed(named) if named else "nothing that stands out so far"
    return f"Undecided: {what}, but {listed([*others, *within, *fails, *still, *found.objections, *more, *limit])}."


def _unexplained(found: Explanation) -> str:
    if found.contest.measurement.rms == 0.0:
        return "Unexplained: every measured vector is zero; check that the probes and the recording deliver anything."
    books = "" if found.written.tried or found.written.left_out else f" {WRONG_BOOKS}"
    return f"Unexplained: {_unexplained_why(found)}{books}"


def _unexplained_why(found: Explanation) -> str:
    """How far effects come that do not explain all."""
    if (ahead := would_be_next(found)) is not None:
        return f"no more than {found.max_effects} effects were to be added, and {plain_name(ahead)} would be next."
    those = "those allowed" if found.restricted else "the catalogue"
    limit = "; the search limit was reached before all was tried (--limit raises it)" if found.cost.exhausted else ""
    if not found.named:
        tried = " that was tried" if limit else ""
        return f"no effect of {those}{tried} accounts for the difference between model and measurement{limit}."
    one = len(found.named) == 1
    accounts = "accounts" if one else "account"
    if slight(found):
        none, lower = ("no single effect", "lowers") if one else ("no effects", "together lower")
        return (
            f"{none} of {those} {accounts} for the difference between model and measurement; the best, "
            f"{said(found.named)}, {lower} the error only {number(error_fall(found), 2)}-fold, to "
            f"{number(found.story.last.rms / MICROMETRE)} µm rms{limit}."
        )
    return f"{said(found.named)} {accounts} for part of the difference between model and measurement" + (
        f"{limit}." if limit else f", and no further effect of {those} for the rest."
    )


AS_IF = 1.5
"""Half widths of the 95 % interval within which a gain may be that of a wrong convention: three standard errors."""

WELL_KNOWN = 0.05
"""Standard error of a gain up to which a factor may be read from it."""


def as_if_lines(found: Explanation) -> list[str]:
    """A gain of the chain that a wrong convention or unit would look like, and the reverse."""
    changes = amplitude_changes(found.contest.measurement.knowledge.amplitude)
    if 0.0 in found.contest.measurement.orders:
        changes = [one for one in changes if one.mean_factor == one.factor]
    if found.mistake is not None:
        weights = weights_that_tell_amplitudes(found.story.fits[-1].model, found.story.measurement)
        return [
            f"A gain of all probes of {change.factor:.3g} would do the same: check scale factors too. "
            + (f"So would installed weights all {change.factor:.3g} times as large as stated. " if len(weights) else "")
            + "Amplitudes here are as the table states them."
            for change in changes
            if (change.kind, change.about) == (found.mistake.kind, found.mistake.about)
        ]
    if "chain_gain" not in found.effects:
        return []
    fitted = found.story.fits[-1]
    parts = [fitted.estimate("chain_gain", label) for label in ("gain_real", "gain_imaginary")]
    gain = [1.0 + parts[0].value, parts[1].value]
    near = (
        one
        for one in changes
        if all(
            part.standard_error <= WELL_KNOWN and abs(value - there) <= AS_IF * fitted.quantile * part.standard_error
            for value, there, part in zip(gain, (one.factor, 0.0), parts, strict=True)
        )
    )
    return [
        f"A gain of {change.factor:.3g} is what it looks like if {change.meaning} ({change.cure})." for change in near
    ]


def would_be_next(found: Explanation) -> str | None:
    """The effect at which the limit on their number stopped the search, if it did."""
    stopped = len(found.effects) >= found.max_effects and is_detected(found.rankings[-1])
    return found.more[0].effect if stopped and found.more else None


def slight(found: Explanation) -> bool:
    """Whether what was found explains so little that it is not part of the answer."""
    ended = would_be_next(found) is None
    return found.verdict == "unexplained" and bool(found.named) and ended and error_fall(found) < HALVED


def error_fall(found: Explanation) -> float:
    """Error before anything was added over that at the end."""
    story = found.story
    after = story.last.rms
    return _before(found) / after if after > 0.0 else float("inf")


def _before(found: Explanation) -> float:
    """The error with the uncertain values fitted; as declared where what is written was wrong [m]."""
    return (found.story.views[0] if found.mistake is None else found.story.declared).rms


def fall_line(found: Explanation) -> str:
    """How far the error falls with what was found; nothing where nothing was, or nothing to speak of."""
    if not found.named or slight(found):
        return ""
    held, after = found.story.fits[-1].held_out_rms, found.story.last.rms
    held_text = f" ({number(held / MICROMETRE)} µm on readings left out of the fit)" if held else ""
    if after == 0.0:
        return f"With {said(found.named)} the error falls to nothing{held_text}."
    fold = number(error_fall(found))
    return f"With {said(found.named)} the error falls {fold}-fold to {number(after / MICROMETRE)} µm rms{held_text}."


def left_line(found: Explanation) -> str:
    """Whether what is left is more than noise."""
    p = found.p_value
    if p is None:
        return (
            "The noise is unknown, so that nothing says whether what is left is more than noise."
            if found.contest.measurement.sigma is None
            else ""
        )
    sign = "<=" if p.value <= 1.0 / (p.draws + 1) + 1e-12 else "="
    more_than = ["the tolerance of the model's form"] if found.contest.measurement.knowledge.tolerance > 0.0 else []
    more_than += ["the scatter between runs"] if found.noise.scatter != NO_SCATTER else []
    others = "".join(f" and {what}" for what in more_than)
    more = p.value <= UNEXPLAINED
    judged = "is more than" if more else "is what"
    allow = "" if more else " allow" if others else " allows"
    drawn = f"p {sign} {number(p.value, 2)} from {p.draws} simulated measurements"
    return f"What is left {judged} the noise{others}{allow} ({drawn})."


def tie_lines(found: Explanation) -> list[str]:
    """What these data cannot tell apart."""
    lines = [
        f"These data cannot tell {said(names[0])} from {_others(names[1:])}."
        if names[0]
        else _within_tolerance(names[1])
        for names in found.tied_groups()
    ]
    if found.verdict != "undecided":
        return lines
    every = dict.fromkeys(one.mistake for one in (found.written.best, *found.written.tied) if one.mistake is not None)
    return [*lines, *(f"{opening(plain_name(one.name))} means: {one.meaning} ({one.cure})." for one in every)]


def _within_tolerance(names: list[str]) -> str:
    verb = "is" if len(names) == 1 else "are"
    return (
        f"{opening(said(names))} {verb} there, or the model's form is off as much as its tolerance allows: these data "
        "cannot tell."
    )


def _others(sets: list[list[str]]) -> str:
    """Sets in a sentence; of many the nearest."""
    if len(sets) <= SAID:
        return ", or from ".join(said(names) for names in sets)
    return f"{said(sets[0])}, or from {len(sets) - 1} other sets listed below"
