"""Least squares for motion and parameters together, from many starts, on many subsets of the cases:
Levenberg-Marquardt.

Where forces depend on motion a descent begins with the motion that was measured, which need not balance, and the
balance is enforced more and more strictly as it goes on (`rotorjax.inference.linearised`). No equation of motion is
solved on the way, so that none can fail; at the end the balance is exact, or the cases are named in which it is not.
"""

import dataclasses
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Complex, Float, Int

from rotorjax.inference.budget import Budget
from rotorjax.inference.data import Data
from rotorjax.inference.linearised import Linearisation, Linearised, Point
from rotorjax.inference.manner import CONVERGED, CUT_OFF, FIRST_DAMPING, MAX_STEPS, NOT_FINITE, THOROUGH, Manner
from rotorjax.inference.motions import BALANCED, balanced, first_motions
from rotorjax.inference.normal import Normal, Task
from rotorjax.inference.prior import Prior, prior_at, together
from rotorjax.inference.scan import scan
from rotorjax.inference.space import Space

HOPELESS = 300.0
"""Cost above the best known of the same cases with which a descent does not go on, once its motions balance."""
DISTINCT = 3.0
"""Posterior standard deviations apart from which two optima count as two."""


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
    manner: Manner = THOROUGH,
    hopeless: float = math.inf,
) -> list[End]:
    """Levenberg-Marquardt from every start, each on its own cases and with its own free unknowns.

    Unknowns that are not free stay at ``kept``, by default where the model has them. ``shift`` is added to the residual
    of each; without it, descents of the same unknowns on the same cases compete. Once the ``budget`` is spent each
    start is linearised once and left at that. A trial whose numbers overflow is not taken. Where no descent of a fit
    comes to motions that balance, the lowest begins again: with motions as measured if they were known, then at the
    best strength of a scan (`rotorjax.inference.scan`). ``hopeless``: cost with which a descent does not go on.
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
        lin, [start._replace(point=point) for start, point in zip(starts, points, strict=True)], tasks, manner, hopeless
    )
    if shift is None:
        for begin in (_as_measured, _scanned):
            lost = _lost(running)
            if budget.exhausted:
                for k in lost:
                    running[k].result = CUT_OFF
                break
            anew = {k: start for k in lost if (start := begin(running[k])) is not None}
            for k, one in zip(
                anew, _run(lin, list(anew.values()), [tasks[k] for k in anew], manner, hopeless), strict=True
            ):
                running[k] = min(running[k], one, key=lambda d: (not d.settled, d.cost))
    return [d.end() for d in running]


def _run(
    lin: Linearisation, starts: list[Start], tasks: "list[Task]", manner: Manner, hopeless: float
) -> "list[_Descent]":
    """All descents to their ends, or until the budget is spent."""
    timed = [
        lin.timed(start.point, np.isin(np.arange(len(start.point)), task.free))
        for start, task in zip(starts, tasks, strict=True)
    ]
    known = [start.motions is not None for start in starts]
    fresh = first_motions(
        lin, [start.point for start, orders, near in zip(starts, timed, known, strict=True) if orders and not near]
    )
    running = []
    for k, (start, task) in enumerate(zip(starts, tasks, strict=True)):
        motions = start.motions if known[k] else fresh.pop(0) if timed[k] else None
        running.append(
            _Descent(lin, task, manner, Point(start.point, motions if timed[k] else None, known[k]), known=known[k])
        )
    while going := [d for d in running if not d.done]:
        if lin.budget.exhausted and all(d.here is not None for d in going):
            for one in going:
                one.result = CUT_OFF
            break
        for one, there in zip(going, _linearised(lin, going), strict=True):
            one.advance(there)
        if going[0].task.shift is None:
            _give_up(running, hopeless)
    return running


def _lost(running: "list[_Descent]") -> list[int]:
    """Of each fit in which no descent came to motions that balance the lowest."""
    lost = []
    for kind in dict.fromkeys(d.task.kind for d in running):
        own = [k for k, d in enumerate(running) if d.task.kind == kind]
        if not any(running[k].settled for k in own):
            lost.append(min(own, key=lambda k: running[k].cost))
    return lost


def _as_measured(one: "_Descent") -> Start | None:
    """Where a descent ended, with motions as measured, if it began with known ones: those may have led it astray."""
    return Start(one.here.point.unknowns) if one.known and one.here is not None else None


def _scanned(one: "_Descent") -> Start | None:
    """At the best strength of its force, with the motions there."""
    found = scan(one.lin, one.trial.unknowns, one.task.free, one.task.training)
    return None if found is None else Start(*found)


def _linearised(lin: Linearisation, going: "list[_Descent]") -> list[Linearised]:
    """The trials linearised; those whose motions have no freedom any more at motions that balance, as far as these are
    found.
    """
    found = lin.at([d.trial for d in going], [d.task.free for d in going])
    astray = [
        k
        for k, one in enumerate(found)
        if going[k].freedom == 0.0 and one.freedom is not None and np.any(one.freedom.off > BALANCED)
    ]
    if astray:
        trials, cases = balanced(lin, [found[k] for k in astray], BALANCED)
        again = lin.timed_at(trials, [going[k].task.free for k in astray], cases)
        for k, near, one in zip(astray, cases, again, strict=True):
            found[k] = found[k].with_cases(lin.states, near, one)
    return found


def _give_up(running: "list[_Descent]", hopeless: float) -> None:
    """End descents that others have left far behind, by costs of motions that balance only."""
    for cases in {d.task.kind[1] for d in running}:
        own = [d for d in running if d.task.kind[1] == cases]
        most = min([hopeless, *(d.cost + HOPELESS for d in own if d.settled)])
        for one in own:
            one.give_up((one.patient and one.data_cost > most) or one.promises_no_less_than(most))
    for kind in {d.task.kind for d in running}:
        rivals = [d for d in running if d.task.kind == kind]
        if len(rivals) > 1:
            ranked = sorted((d for d in rivals if d.settled), key=lambda d: d.cost)
            for place, one in enumerate(ranked):
                one.give_up(one.patient and any(one.joins(other) for other in ranked[:place]))


@dataclasses.dataclass
class _Descent:
    """One descent under way."""

    lin: Linearisation
    task: Task
    manner: Manner
    trial: Point
    known: bool
    """Whether it began with motions that balance, or nearly."""
    cost: float = math.inf
    steps: int = 0
    done: bool = False
    result: int = MAX_STEPS

    def __post_init__(self) -> None:
        self.timed = self.trial.motions is not None
        self.freedom = 0.0 if self.known or not self.timed else self.manner.first_freedom * self._reach()
        self.damping, self.cap = FIRST_DAMPING, self.manner.largest_step
        self.judged = self.lin.states.seen_in(np.flatnonzero(self.task.training))
        self.parts = together(np.asarray(self.lin.space.open_size)[self.task.free])
        self.here: Linearised | None = None
        self.prior = Prior(0.0, np.ones(len(self.task.free)))
        self.normal: Normal | None = None
        self.best: tuple[Linearised, Normal, Prior, float] | None = None
        self.since = self.stalled = 0
        self.promised = self.decrement = self.foreseen = 0.0

    def _reach(self) -> float:
        return max(float(np.abs(self.lin.data.pairs).max()), 1e-9)

    @property
    def data_cost(self) -> float:
        """The cost without the prior's."""
        return self.cost - self.prior.cost

    @property
    def settled(self) -> bool:
        """Whether the cost is that of motions that balance."""
        return self.here is not None and self.freedom == 0.0 and self._off() < BALANCED and math.isfinite(self.cost)

    @property
    def patient(self) -> bool:
        """Whether it was given its steps."""
        return self.freedom == 0.0 and self.since >= self.manner.patience

    def promises_no_less_than(self, cost: float) -> bool:
        """Whether even a step without damping promises no cost of the data below one: near balance it promises too
        much, as a rule.
        """
        return self.settled and self.patient and self.foreseen > cost

    def give_up(self, hopeless: bool) -> None:
        """End it where it stands."""
        self.done = self.done or hopeless

    def joins(self, other: "_Descent") -> bool:
        """Whether it comes to where another is."""
        if other.normal is None or not other.settled:
            return False
        gap = (
            (self.here.point.unknowns - other.here.point.unknowns)[self.task.free]
            if self.here and other.here
            else np.ones(1)
        )
        return bool(gap @ (other.normal.hessian + np.diag(other.prior.weight)) @ gap < 1.0)

    def _off(self) -> float:
        """Standard errors by which what is read is off balance, at most."""
        freedom = None if self.here is None else self.here.freedom
        return 0.0 if freedom is None else float(np.max(freedom.off[self.judged], initial=0.0))

    def advance(self, there: Linearised) -> None:
        """Take the trial or leave it, and propose the next one."""
        self.steps += 1
        self.since += self.freedom == 0.0
        before, first = self.cost, self.here is None or there.point.refined != self.here.point.refined
        taken = self._take(there, first)
        if self.here is None or self.normal is None:
            self.result, self.done = NOT_FINITE, True
            return
        if taken and not first:
            self.damping, self.cap = max(0.1 * self.damping, 1e-12), min(2.0 * self.cap, self.manner.largest_step)
        elif not taken:
            self.damping, self.cap = 4.0 * self.damping, 0.5 * self.cap
        if taken:
            self._firmer()
        self.decrement = self._propose()
        limit = self._limit()
        fall = before - self.cost if taken and not first else 0.0
        self.stalled = 0 if first or self.freedom > 0.0 or fall > limit else self.stalled + 1
        fallen = taken and not first and fall <= limit and self.damping < 1e-2
        stuck = self.stalled >= self.manner.most_stalled
        balanced = self.freedom == 0.0 and self._off() < BALANCED
        if self.steps >= self.manner.most_steps:
            self.done = True
        elif balanced and (self.decrement <= limit or fallen):
            self._arrived()
        elif stuck:
            self._give_in(balanced)

    def _take(self, there: Linearised, first: bool) -> bool:
        """Go on from a trial, if it is better."""
        if not there.finite:
            return False
        try:
            normal = Normal(self.lin, there, self.task, self.freedom)
        except np.linalg.LinAlgError:
            # Motions that answer a force without bound.
            return False
        prior = prior_at(there.point.unknowns[self.task.free], self.parts)
        cost = normal.cost + prior.cost
        if not math.isfinite(cost) or not (first or cost <= self.cost + self._slack()):
            return False
        self.here, self.normal, self.prior, self.cost = there, normal, prior, cost
        if self.timed and there.point.refined and self.settled and (self.best is None or cost < self.best[-1]):
            self.best = there, normal, prior, cost
        return True

    def _slack(self) -> float:
        """Rise of the cost that is put down to motions that do not balance yet, or to rounding."""
        return self._limit() if self.settled else self._limit() + self.manner.lenient * self.cost

    def _limit(self) -> float:
        """Change of the cost that counts as none."""
        return float(self.manner.tolerance.absolute + self.manner.tolerance.relative * self.cost)

    def _firmer(self) -> None:
        """Less freedom of the motions, and the cost as it is then."""
        if self.freedom == 0.0 or self.here is None or self.here.freedom is None:
            return
        size = float(np.max(np.linalg.norm(self.here.freedom.reach, axis=2)[self.task.training], initial=0.0))
        enough = 0.5 * np.count_nonzero(self.lin.data.weight[self.task.training])
        while self.freedom > 0.0:
            self.freedom *= self.manner.firmer
            self.freedom = 0.0 if self.freedom * size < BALANCED else self.freedom
            self.normal = Normal(self.lin, self.here, self.task, self.freedom)
            self.cost = self.normal.cost + self.prior.cost
            # More than enough freedom explains anything, and leaves the parameters to their prior.
            if self.normal.cost > enough:
                break

    def _arrived(self) -> None:
        """At an end; where orders depend on one another once more with more of them."""
        assert self.here is not None
        if self.timed and not self.here.point.refined:
            self.trial = self.here.point._replace(refined=True)
            self.since = 0
        else:
            self.result, self.done = CONVERGED, True

    def _give_in(self, balanced: bool) -> None:
        """Where no step is better: less freedom of the motions, or more orders if those so far are balanced, or the
        end.
        """
        assert self.here is not None
        self.damping, self.cap = FIRST_DAMPING, self.manner.largest_step
        if self.freedom > 0.0:
            self._firmer()
            self.decrement = self._propose()
        elif balanced and self.timed and not self.here.point.refined:
            self._arrived()
        else:
            self.done = True

    def _propose(self) -> float:
        """The next trial. **Returns** the fall of the cost that a step without damping promises."""
        assert self.here is not None
        assert self.normal is not None
        free, point = self.task.free, self.here.point
        unknowns, step = point.unknowns.copy(), np.zeros(len(free))
        gradient = self.normal.gradient + self.prior.weight * unknowns[free]
        hessian = self.normal.hessian + np.diag(self.prior.weight)
        decrement, self.foreseen = 0.0, self.normal.cost
        if len(free):
            scale = 1.0 / np.sqrt(np.diag(hessian))
            scaled = hessian * scale[:, None] * scale[None]
            downhill = scale * gradient
            full = -scale * np.linalg.solve(scaled + 1e-12 * np.eye(len(free)), downhill)
            decrement = -0.5 * float(gradient @ full)
            self.foreseen = float(
                self.normal.cost + self.normal.gradient @ full + 0.5 * full @ self.normal.hessian @ full
            )
            step = -scale * np.linalg.solve(scaled + self.damping * np.eye(len(free)), downhill)
            self.promised = float(-gradient @ step - 0.5 * step @ hessian @ step)
        unknowns[free] += step
        motions = None
        if self.timed:
            motions = self._capped(self.normal.motion_step(step))
        self.trial = Point(unknowns, motions, point.refined)
        return decrement

    def _capped(self, change: Float[np.ndarray, "state motion"]) -> Float[np.ndarray, "state dof wide"]:
        """The motions after a step that is no longer than a share of each."""
        assert self.here is not None
        size = np.linalg.norm(np.asarray(self.here.point.motions).reshape(len(change), -1), axis=1)
        most = self.cap * np.maximum(size, 0.1 * self._reach())
        return self.lin.moved(
            self.here, change * np.minimum(1.0, most / np.maximum(np.linalg.norm(change, axis=1), 1e-300))[:, None]
        )

    def end(self) -> End:
        """Where it is now."""
        if self.best is not None and not self.settled:
            # It went on from motions that balance, and came to some that do not.
            self.here, self.normal, self.prior, self.cost = self.best
        lin, here, free = self.lin, self.here, self.task.free
        if here is None or not math.isfinite(self.cost):
            shape = lin.data.pairs.shape
            nothing = Local(
                np.full((lin.cases, math.prod(shape[1:])), np.nan),
                np.zeros((lin.cases, math.prod(shape[1:]), len(free))),
            )
            shown, prior = np.full(shape[:-1], np.nan + 0j), Prior(0.0, np.ones(len(free)))
            return End(
                self.trial.unknowns,
                math.inf,
                free,
                np.eye(len(free)),
                prior,
                nothing,
                shown,
                None,
                self.steps,
                NOT_FINITE,
                False,
            )
        normal = self.normal if self.freedom == 0.0 and self.normal else Normal(lin, here, self.task, 0.0)
        curvature = normal.hessian + np.diag(self.prior.weight)
        error = here.error if self.task.shift is None else here.error + self.task.shift
        exact = not self.timed or (self._off() < BALANCED and here.point.refined)
        return End(
            here.point.unknowns, normal.cost + self.prior.cost, free, curvature, self.prior, Local(error, here.slopes),
            lin.vectors(here.shown),
            here.point.motions, self.steps, self.result, exact,
        )  # fmt: skip


def distinct_of(ends: Sequence[End]) -> list[End]:
    """Optima further apart than `DISTINCT`, the lowest first: of descents whose motions balance."""
    found: list[End] = []
    for end in sorted(ends, key=lambda end: end.cost):
        if not math.isfinite(end.cost) or not end.exact:
            continue
        gaps = [(end.point - other.point)[end.free] for other in found]
        if all(gap @ end.curvature @ gap > DISTINCT**2 for gap in gaps):
            found.append(end)
    return found


def best_of(ends: list[End]) -> End:
    """The descent that ended lowest: among those whose motions balance, if there are."""
    return min(ends, key=lambda end: (not math.isfinite(end.cost), not end.exact, end.cost))
