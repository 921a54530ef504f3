"""Least squares for motion and parameters together, from many starts, on many subsets of the cases:
Levenberg-Marquardt.

Where forces are nonlinear a descent begins with the motion that was measured, which need not balance, and the
balance is enforced more and more strictly as it goes on (`rotorjax.inference.linearised`). Once little freedom is left
the motions are brought to balance after every step (`rotorjax.inference.motions`); a fit whose motions do not balance
at the end is not exact, and says so.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Complex, Float, Int
from threadpoolctl import ThreadpoolController

from rotorjax.inference.budget import Budget
from rotorjax.inference.data import Data
from rotorjax.inference.descent_settings import CUT_OFF, LEFT_BEHIND, NOT_FINITE, THOROUGH, DescentSettings
from rotorjax.inference.levenberg_marquardt import Descent
from rotorjax.inference.linearised import Linearisation, Linearised, Point
from rotorjax.inference.motions import BALANCED, balanced, first_motions
from rotorjax.inference.normal import Task
from rotorjax.inference.prior import Prior
from rotorjax.inference.scan import scan
from rotorjax.inference.space import Space

MANY = 5
"""Descents of one fit from which on it has many optima, as a foundation has by its natural frequency."""
HOPELESS = 300.0
"""Cost above the best known of the same cases with which a descent does not go on, once its motions balance."""


class Local(NamedTuple):
    """Residual in standard errors and its slopes by the free unknowns, in their order."""

    error: Float[np.ndarray, "*case cell"]
    slopes: Float[np.ndarray, "*case cell param"]


class End(NamedTuple):
    """Where one descent ended."""

    point: Float[np.ndarray, "param"]
    cost: float
    free: Int[np.ndarray, "free"]
    """The unknowns that were free."""
    curvature: Float[np.ndarray, "free free"]
    """Hessian of the cost by those; of large sizes that are left open, the prior's weight in the place of its second
    derivative.
    """
    prior: Prior
    """The prior there, of the unknowns that were free."""
    local: Local
    """On all cases, whichever were trained on."""
    shown: Complex[np.ndarray, "case probe order"]
    """What the model shows there [m]."""
    motions: Float[np.ndarray, "state dof wide"] | None
    """The motions found, where orders depend on one another."""
    steps: int
    result: int
    exact: bool
    """False where motions are left that do not balance."""
    spread: float = 0.0
    """`Data.spread` of what it was fitted to."""

    @property
    def data_curvature(self) -> Float[np.ndarray, "free free"]:
        """The curvature of the data alone."""
        return self.curvature - np.diag(self.prior.weight)

    @property
    def determined(self) -> Float[np.ndarray, "free determined"]:
        """Directions that the data determine more than the prior does, orthonormal in units of its width there."""
        width = self.prior_width[self.free]
        curvatures, directions = np.linalg.eigh(width[:, None] * self.data_curvature * width)
        return directions[:, curvatures > 1.0]

    @property
    def data_cost(self) -> float:
        """The cost without the prior's: values many prior scales large may still be right."""
        return self.cost - self.prior.cost

    @property
    def hessian(self) -> Float[np.ndarray, "param param"]:
        """Hessian by all unknowns; those that were not free have their prior's."""
        full = np.eye(len(self.point))
        full[np.ix_(self.free, self.free)] = self.curvature
        return full

    @property
    def prior_width(self) -> Float[np.ndarray, "param"]:
        """How wide the prior is there, of all unknowns: one but for large sizes that are left open."""
        full = np.ones(len(self.point))
        full[self.free] = 1.0 / np.sqrt(self.prior.weight)
        return full


class Start(NamedTuple):
    """Where a descent begins; the motions there where orders depend on one another and they are known."""

    point: Float[np.ndarray, "param"]
    motions: Float[np.ndarray, "state dof wide"] | None = None

    @classmethod
    def at(cls, end: End) -> "Start":
        """Where another descent ended."""
        return cls(end.point, end.motions if end.exact else None)


def starts_at(points: Float[np.ndarray, "start param"]) -> list[Start]:
    """Starts of which nothing else is known."""
    return [Start(point) for point in points]


@ThreadpoolController().wrap(limits=1, user_api="blas")
@np.errstate(over="ignore", invalid="ignore")
def descend(  # noqa: PLR0913
    space: Space,
    data: Data,
    starts: Sequence[Start],
    free: Bool[np.ndarray, "*start param"],
    training: Bool[np.ndarray, "start case"],
    *,
    budget: Budget,
    kept: Float[np.ndarray, "param"] | None = None,
    shift: Float[np.ndarray, "start case cell"] | None = None,
    settings: DescentSettings = THOROUGH,
    hopeless: float = math.inf,
) -> list[End]:
    """Levenberg-Marquardt from every start, each on its own cases and with its own free unknowns.

    Unknowns that are not free stay at ``kept``, by default where the model has them. ``shift`` is added to the residual
    of each; without it, descents of the same unknowns on the same cases compete. Once the ``budget`` is spent each
    start is linearised once and left at that. A trial whose numbers overflow is not taken. Where no descent of a fit
    comes to motions that balance, the lowest begins again at the best strength of a scan (`rotorjax.inference.scan`).
    ``hopeless``: cost with which a descent does not go on.
    **Returns** one `End` per start.
    """
    lin = Linearisation(space, data, budget)
    free = np.broadcast_to(free, (len(starts), len(starts[0].point)))
    points = np.where(
        free, np.stack([start.point for start in starts]), space.given_unknowns() if kept is None else kept
    )
    tasks = [
        Task(np.flatnonzero(own), np.asarray(training[k], bool), None if shift is None else shift[k])
        for k, own in enumerate(free)
    ]
    running = _run(
        lin,
        [start._replace(point=point) for start, point in zip(starts, points, strict=True)],
        tasks,
        settings,
        hopeless,
    )
    if shift is None and settings.rescan:
        lost = _lost(running)
        if budget.exhausted:
            for k in lost:
                running[k].result = CUT_OFF
        else:
            anew = {k: start for k in lost if (start := _scanned(running[k])) is not None}
            for k, one in zip(
                anew, _run(lin, list(anew.values()), [tasks[k] for k in anew], settings, hopeless), strict=True
            ):
                running[k] = min(running[k], one, key=lambda d: (not d.settled, d.cost))
    return [_end_of(one) for one in running]


def _run(
    lin: Linearisation, starts: list[Start], tasks: list[Task], settings: DescentSettings, hopeless: float
) -> list[Descent]:
    """All descents to their ends, or until the budget is spent."""
    coupled = [lin.coupled(start.point, task.free) for start, task in zip(starts, tasks, strict=True)]
    # Motions with those at slow roll, or without, are of another reading of the table.
    known = [start.motions is not None and len(start.motions) == len(lin.states.speed) for start in starts]
    fresh = first_motions(
        lin, [start.point for start, orders, near in zip(starts, coupled, known, strict=True) if orders and not near]
    )
    running = []
    for k, (start, task) in enumerate(zip(starts, tasks, strict=True)):
        motions = start.motions if known[k] else fresh.pop(0) if coupled[k] else None
        running.append(
            Descent(lin, task, settings, Point(start.point, motions if coupled[k] else None, known[k]), known=known[k])
        )
    rivals = _Rivals.of(running)
    while going := [d for d in running if not d.done]:
        if lin.budget.exhausted and all(d.here is not None for d in going):
            for one in going:
                one.result = CUT_OFF
            break
        for one, there in zip(going, _linearised(lin, going), strict=True):
            one.advance(there)
        if going[0].task.shift is None:
            rivals.give_up(hopeless)
    return running


def _lost(running: list[Descent]) -> list[int]:
    """Of each fit in which no descent came to motions that balance the lowest, if none was left behind."""
    lost = []
    for kind in dict.fromkeys(d.task.kind for d in running):
        own = [k for k, d in enumerate(running) if d.task.kind == kind]
        if not any(running[k].settled or running[k].result == LEFT_BEHIND for k in own):
            lost.append(min(own, key=lambda k: running[k].cost))
    return lost


def _scanned(one: Descent) -> Start | None:
    """At the best strength of its force, with the motions there."""
    found = scan(one.lin, one.trial.unknowns, one.task.free, one.task.training)
    return None if found is None else Start(*found)


def _linearised(lin: Linearisation, going: list[Descent]) -> list[Linearised]:
    """The trials linearised; those whose motions have no freedom any more at motions that balance, as far as these are
    found.
    """
    found = lin.at([d.trial for d in going], [d.task.free for d in going])
    astray = [
        k
        for k, one in enumerate(found)
        if going[k].freedom == 0.0 and one.response is not None and np.any(one.response.off > BALANCED)
    ]
    if astray:
        trials, cases = balanced(lin, [found[k] for k in astray], BALANCED)
        again = lin.coupled_at(trials, [going[k].task.free for k in astray], cases)
        for k, near, one in zip(astray, cases, again, strict=True):
            found[k] = found[k].with_cases(lin.states, near, one)
    return found


class _Rivals(NamedTuple):
    """Descents that compete: on the same cases, and of those of the same fit."""

    on_same_cases: list[list[list[Descent]]]
    """Groups of descents on the same cases, each as lists of the descents of one fit."""

    @classmethod
    def of(cls, running: list[Descent]) -> "_Rivals":
        """Sorted into groups."""
        cases: dict[bytes, dict[bytes, list[Descent]]] = {}
        for one in running:
            unknowns, training = one.task.kind
            cases.setdefault(training, {}).setdefault(unknowns, []).append(one)
        return cls([list(fits.values()) for fits in cases.values()])

    def give_up(self, hopeless: float) -> None:
        """End descents that others have left far behind, by costs of motions that balance only, and those that come to
        where another of their fit is.
        """
        for fits in self.on_same_cases:
            most = min([hopeless, *(d.cost + HOPELESS for own in fits for d in own if d.settled)])
            for own in fits:
                for one in own:
                    if not one.done and one.promises_no_less_than(most, among_many=len(own) >= MANY):
                        one.give_up(LEFT_BEHIND)
                _balance_best(own, most)
                _join(own)


def _balance_best(own: list[Descent], most: float) -> None:
    """Where all descents of a fit that are under way seem to come to no cost below ``most``, but motions have freedom
    left, their costs say little: the one that promises most goes on with motions that balance, if none of the fit has
    such. The others end.
    """
    going = [one for one in own if not one.done]
    seeming = sorted((one for one in going if one.seems_no_less_than(most)), key=lambda one: one.foreseen)
    if seeming and len(seeming) == len(going) and all(one.freedom > 0.0 for one in own):
        seeming.pop(0).balance()
    for one in seeming:
        one.give_up(LEFT_BEHIND)


def _join(own: list[Descent]) -> None:
    """End descents that would step to the optimum of a lower one."""
    if all(one.done for one in own):
        return
    ranked = sorted((one for one in own if one.settled), key=lambda one: one.cost)
    for place, one in enumerate(ranked):
        if not one.done and any(one.joins(other) for other in ranked[:place]):
            one.give_up()


def _end_of(one: Descent) -> End:
    """Where a descent is now; if it went on from motions that balance and came to some that do not, where it was."""
    one.back_to_balance()
    lin, here, free, normal = one.lin, one.here, one.task.free, one.balanced_normal()
    if here is None or normal is None:
        shape = lin.data.pairs.shape
        nothing = Local(
            np.full((lin.cases, math.prod(shape[1:])), np.nan),
            np.zeros((lin.cases, math.prod(shape[1:]), len(free))),
        )
        shown, prior = np.full(shape[:-1], np.nan + 0j), Prior(0.0, np.ones(len(free)))
        return End(
            one.trial.unknowns, math.inf, free, np.eye(len(free)), prior, nothing, shown, None, one.steps, NOT_FINITE,
            False,
        )  # fmt: skip
    curvature = normal.hessian + np.diag(one.prior.weight)
    error = here.error if one.task.shift is None else here.error + one.task.shift
    return End(
        here.point.unknowns, normal.cost + one.prior.cost, free, curvature, one.prior, Local(error, here.slopes),
        lin.vectors(here.shown), here.point.motions, one.steps, one.result, one.exact,
        lin.data.spread,
    )  # fmt: skip


def distinct_of(ends: Sequence[End]) -> list[End]:
    """Optima further apart than a posterior standard deviation, the lowest first: of descents whose motions balance."""
    found: list[End] = []
    for end in sorted(ends, key=lambda end: end.cost):
        if not math.isfinite(end.cost) or not end.exact:
            continue
        gaps = [(end.point - other.point)[end.free] for other in found]
        if all(gap @ end.curvature @ gap > 1.0 for gap in gaps):
            found.append(end)
    return found


def best_of(ends: Sequence[End]) -> End:
    """The descent that ended lowest: among those whose motions balance, if there are."""
    return min(ends, key=lambda end: (not math.isfinite(end.cost), not end.exact, end.cost))
