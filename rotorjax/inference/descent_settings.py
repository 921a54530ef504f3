"""How exactly a fit ends, how it goes there, and what its result codes mean."""

from typing import NamedTuple

PATIENCE = 6
"""Steps in a row that may gain nothing; steps in which motions balance, as a rule."""
STEP_LIMIT = 60
"""Steps of a descent, and of Newton's method towards balance, at most."""
FIRST_DAMPING = 1e-3
"""Damping λ of Levenberg-Marquardt at the start, on a Hessian of unit diagonal."""
CONVERGED, MAX_STEPS, NOT_FINITE, CUT_OFF, LEFT_BEHIND = 0, 1, 2, 3, 4
RESULT_TEXT = {
    CONVERGED: "converged",
    MAX_STEPS: "stopped at the step limit: values may still move within their intervals; where the data hardly "
    "determine one, give it a value, or a tighter prior",
    CUT_OFF: "stopped where the linearisations allowed were spent",
    LEFT_BEHIND: "stopped where other starts or effects did better by far",
    NOT_FINITE: "not finite at the start: check the rig file's mass, stiffness and damping, and the table's sigma",
}
"""What each result code of a fit means and what to do next."""


FINE = 1e-6
"""Fall of the cost below which a descent is at its end, over the cost and what noise alone leaves: for estimates."""
COARSE = 1e-4
"""The same for ranking, where a hundredth of a log unit decides nothing."""


class DescentSettings(NamedTuple):
    """How exactly a descent ends, and how it goes there."""

    tolerance: float
    most_steps: int = STEP_LIMIT
    first_freedom: float = 0.1
    """Of motions in the beginning, in the largest displacement measured."""
    freedom_decay: float = 0.5
    """What is left of that freedom after every step that lowers the cost."""
    cost_slack: float = 0.02
    """Relative rise of the cost that does not count while motions do not balance: theirs may be too low."""
    rescan: bool = True
    """Whether a fit begins again where none of its descents came to motions that balance."""


THOROUGH, QUICK = DescentSettings(FINE), DescentSettings(COARSE)
"""For estimates; and for ranking many hypotheses."""
