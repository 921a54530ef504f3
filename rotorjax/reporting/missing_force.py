"""The force that no named effect explains, in words and in a table."""

import numpy as np

from rotorjax.discovery.explanation import Explanation
from rotorjax.discovery.fit import Fit
from rotorjax.discovery.missing_force import MissingForce
from rotorjax.discovery.named_force import NamedForce
from rotorjax.reporting.sizes import sizes
from rotorjax.reporting.tables import Table, number
from rotorjax.reporting.wording import said
from rotorjax.units import MICROMETRE, unit_of

LESS = 0.999
"""Of what an answer leaves, what something else leaves at most that does better."""


def missing_force_lines(found: Explanation) -> list[str]:
    """What the missing force looks like, and what the terms do in the response."""
    named = found.named_force
    if named is None:
        return []
    if named.force.reason is not None:
        return [f"The missing force cannot be shown: {named.force.reason}."]
    held = [
        f"Along {'xy'[axis]} the rotor hardly moves, though without the missing force it would: friction, a stop or a "
        "stiff spring may do that, so that its shape there is doubtful."
        for axis in named.force.held
    ]
    if named.fit is None:
        return held or [f"The missing force has no simple shape; it is {_how_large(named.force)}."]
    return [*held, _named(found, named, named.fit)]


def _how_large(force: MissingForce) -> str:
    """Its size, and where it is largest."""
    m, size = force.measurement, np.where(force.usable, force.rms, 0.0)
    case = int(np.argmax(size))
    mean = float(np.sqrt(np.mean(size[force.usable] ** 2)))
    return (
        f"{number(mean, 2)} N rms over all readings, and {number(float(size[case]), 2)} N in run {m.runs[m.run[case]]} "
        f"at {m.speed_rpm[case]:.0f} rpm, where it is largest"
    )


def _does_better(found: Explanation, fitted: Fit) -> bool:
    """Whether a fit leaves less than the answer, which leaves more than the noise."""
    return fitted.stage.measurement.rms_of(fitted.predicted) < LESS * found.story.last.rms


def _tells_more(found: Explanation, named: NamedForce, fitted: Fit) -> bool:
    """Whether terms that are not enough, either, do more than the answer: there are others among them, they leave less
    of what was read, and of data held out.
    """
    held, theirs = fitted.held_out_rms, found.story.fits[-1].held_out_rms
    if held is not None and theirs is not None and held > LESS * theirs:
        return False
    return bool({term.term for term in named.terms} - set(found.effects)) and _does_better(found, fitted)


def _named(found: Explanation, named: NamedForce, fitted: Fit) -> str:
    """The terms, and the error with them."""
    after = number(found.story.measurement.rms_of(fitted.predicted) / MICROMETRE)
    held = (
        f" ({number(fitted.held_out_rms / MICROMETRE)} µm on data held out)" if fitted.held_out_rms is not None else ""
    )
    beside = f"beside {said(named.beside)}" if named.beside else "beside the model as declared"
    # Terms of one kind, one taken where the other was tried, read alike.
    rivals = [words for words in dict.fromkeys(named.rivals) if words != named.words]
    words = f"{named.words} (nearly as well: {', or '.join(rivals)})" if rivals else named.words
    if found.verdict != "unexplained":
        how = (
            "A simpler force would do as well"
            if len(named.terms) + len(named.beside) < len(found.effects)
            else "A force outside the catalogue would do better"
        )
        alone = "" if named.beside else " alone"
        own, theirs = fitted.reduced_chi2, found.story.fits[-1].reduced_chi2
        compared = (
            ""
            if own is None or theirs is None
            else f", reduced chi² {number(own)} (that of the answer: {number(theirs)})"
        )
        return f"{how}, {beside}: {words}. With it{alone} the error is {after} µm rms{held}{compared}."
    rest = (
        ", which is what the noise allows"
        if named.enough and _does_better(found, fitted)
        else ""
        if found.contest.measurement.sigma is None
        else ", still more than the noise"
    )
    if not named.enough and not _tells_more(found, named, fitted):
        return f"The missing force has no simple shape; it is {_how_large(named.force)}."
    return (
        f"The missing force, {beside}, looks like this: {words}. Added as a term it brings the error to {after} "
        f"µm rms{held}{rest}."
    )


def missing_force_table(named: NamedForce) -> Table | None:
    """Terms of the missing force with their sizes: in the equation of motion, then fitted in the response."""
    if named.fit is None:
        return None
    plain = {term.term: term for term in named.terms}
    rows = []
    for size in sizes(named.fit, tuple(plain)):
        term = plain[size.effect]
        seen = [
            f"{number(term.coefficients[label] / unit_of(label).factor)} {unit_of(label).shown}"
            for label in size.labels
            if label in term.coefficients
        ]
        rows.append([size.effect, term.plain, size.what, ", ".join(seen), size.value, ", ".join(size.labels)])
    note = (
        "Add a term by `rotorjax compare --effect NAME`, or hand it to explain by catalog=CATALOG | TERMS "
        "(rotorjax.effects.terms)."
    )
    others = sorted({words for term in named.terms for words in term.rivals})
    note += f" Nearly as well in the equation of motion: {'; '.join(others)}." if others else ""
    headers = ["term", "meaning", "size of", "in the equation", "in the response (95 % interval)", "in rig files"]
    spare = ["in the equation", "meaning", "in rig files"]
    return Table("Terms of the missing force", headers, rows, note, spare=spare)
