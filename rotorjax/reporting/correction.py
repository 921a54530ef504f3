"""What would balance the rotor by an explanation, with what must hold for it, or why there is no correction."""

import numpy as np

from rotorjax.data.odd_runs import ABOUT_WEIGHTS
from rotorjax.data.rig import Rig
from rotorjax.discovery.explanation import Explanation
from rotorjax.reporting.balance import balance_lines
from rotorjax.reporting.to_correct import Balance, balance_of_fit, held_unbalance
from rotorjax.reporting.wording import said

MOST_LEFT = 0.1
"""Share of what was measured that an answer which does not explain it leaves at most for a correction by it."""

SINCE_HEALTHY = (
    "No correction: the unbalance found has come since the rotor was healthy, beside what it had before; influence "
    "coefficients (`rotorjax diagnose`), or an explanation without the healthy rotor, correct both."
)


def correction_lines(found: Explanation, rig: Rig | None) -> list[str]:
    """The corrections in sentences, where an unbalance was found."""
    open_names = {name for group in found.ties.groups() for names in group for name in names}
    doubt = ""
    if "residual_unbalance" in open_names:
        doubt = ", if it is an unbalance indeed"
    elif found.verdict == "undecided" and found.more:
        doubt = ", if nothing else is missing"
    if any(ABOUT_WEIGHTS in words for words in found.objections):
        doubt = ", if the installed weights are as stated"
    if found.verdict == "unexplained":
        doubt = (
            ", although what was found does not explain the data, so that more than these errors may be wrong "
            "(influence coefficients, by `rotorjax diagnose`, need no rotor model)"
        )
    return balance_lines(balance_of(found, rig)._replace(proviso=doubt))


def balance_of(found: Explanation, rig: Rig | None) -> Balance:
    """What corrects the unbalance found, plane by plane; nothing without a rig."""
    if rig is None:
        return Balance()
    if found.story.healthy is not None:
        return Balance(why_none=SINCE_HEALTHY if "residual_unbalance" in found.named else "")
    return _by_the_answer(found, rig)


def _by_the_answer(found: Explanation, rig: Rig) -> Balance:
    story = found.story
    left = story.last.rms / story.measurement.rms if story.measurement.rms > 0.0 else 0.0
    if found.verdict == "unexplained" and not story.fits[-1].converged and "residual_unbalance" in found.named:
        return Balance(
            why_none="No correction: the fit has not settled. Influence coefficients (`rotorjax diagnose`) need no "
            "rotor model."
        )
    if found.verdict == "unexplained" and left > MOST_LEFT and "residual_unbalance" in found.named:
        return Balance(
            why_none=f"No correction: what was found leaves {100.0 * left:.0f} % of what was measured. Influence "
            "coefficients (`rotorjax diagnose`) need no rotor model."
        )
    tied = [t for t in found.ties.tied if "residual_unbalance" in t.effects]
    if tied and "residual_unbalance" not in found.named:
        return Balance(
            why_none=f"No correction: {said(tied[0].instead_of)} was found, and {said(tied[0].effects)} does as well; "
            "influence coefficients (`rotorjax diagnose`) correct what was read, whichever it is."
        )
    if "residual_unbalance" not in found.named and np.any(held_unbalance(rig)):
        return Balance(why_none="No correction: the rig file holds the unbalance already; see `rotorjax diagnose`.")
    return balance_of_fit(found.story.fits[-1], rig.put_right(found.mistake), found.story.measurement)
