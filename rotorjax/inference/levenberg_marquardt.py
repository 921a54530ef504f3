"""One descent by Levenberg-Marquardt: a trial is linearised, taken or left, and the next one is proposed.

(Levenberg 1944, Q. Appl. Math. 2:164-168; Marquardt 1963, J. Soc. Ind. Appl. Math. 11:431-441.) After a trial that is
taken the damping is multiplied by 1 - (2 ρ - 1)³, a tenth at least, with ρ the fall of the cost over what was promised;
each further one that is not raises it by two, four, eight (Nielsen 1999, Damping parameter in Marquardt's method, IMM,
DTU): along a curved valley a damping that falls with every success is too small every other time. Where forces depend
on motion no motion may change by more than a share of itself in one step, and its freedom of balance ends step by step.
"""

import dataclasses
import math

import numpy as np
from jaxtyping import Float

from rotorjax.inference.curvature import ROUNDING, unit_diagonal
from rotorjax.inference.descent_settings import (
    CONVERGED,
    FIRST_DAMPING,
    MAX_STEPS,
    NOT_FINITE,
    PATIENCE,
    DescentSettings,
)
from rotorjax.inference.linearised import Linearisation, Linearised, Point
from rotorjax.inference.motions import BALANCED
from rotorjax.inference.normal import Normal, Task
from rotorjax.inference.prior import Prior, prior_at, together

STAYS = 0.5
"""Share of the cost that a step must promise to leave at least, far from motions that balance, for nothing to be hoped
for.
"""


@dataclasses.dataclass(eq=False)
class Descent:
    """One descent under way."""

    lin: Linearisation
    task: Task
    settings: DescentSettings
    trial: Point
    known: bool
    """Whether it began with motions that balance, or nearly."""
    cost: float = math.inf
    steps: int = 0
    done: bool = False
    result: int = MAX_STEPS
    early: bool = False
    """Whether its motions were brought to balance before their freedom had ended."""

    def __post_init__(self) -> None:
        self.coupled = self.trial.motions is not None
        self.freedom = 0.0 if self.known or not self.coupled else self.settings.first_freedom * self._reach()
        self.trial = self.trial._replace(slack=self.freedom > 0.0)
        self.of_noise = 0.5 * np.count_nonzero(self.lin.data.weight[self.task.training])
        self.damping, self.growth, self.cap = FIRST_DAMPING, 2.0, 1.0
        self.judged = self.lin.states.seen_in(np.flatnonzero(self.task.training))
        self.parts = together(np.asarray(self.lin.space.open_size)[self.task.free])
        self.here: Linearised | None = None
        self.prior = Prior(0.0, np.ones(len(self.task.free)))
        self.normal: Normal | None = None
        self.best: tuple[Linearised, Normal, Prior, float] | None = None
        self.since = self.stalled = 0
        self.promised = self.decrement = self.foreseen = 0.0
        self.hessian, self.full = np.eye(len(self.task.free)), np.zeros(len(self.task.free))

    def _reach(self) -> float:
        return max(float(np.abs(self.lin.data.pairs).max()), 1e-9)

    @property
    def settled(self) -> bool:
        """Whether the cost is that of motions that balance."""
        return self.here is not None and self.freedom == 0.0 and self._off() < BALANCED and math.isfinite(self.cost)

    @property
    def under_way(self) -> bool:
        """Whether a step was seen whose motions balance: from where a descent begins too little may be promised."""
        return self.settled and self.since > 1

    def promises_no_less_than(self, cost: float, *, among_many: bool = False) -> bool:
        """Whether even a step without damping promises no cost of the data below one: near balance it promises too
        much, as a rule. Where motions did not come to balance in several steps, or were brought to it far from an
        optimum, a step that promises to halve the cost is waited for; likewise where there are no motions, but many
        starts, for optima are many then. **Arguments:** ``among_many`` descents of its fit.
        """
        if self.since > PATIENCE or (self.early and self.under_way):
            return self.foreseen > max(cost, STAYS * self.cost)
        if among_many and self.trial.motions is None:
            return self.under_way and self.foreseen > max(cost, STAYS * self.cost)
        return self.under_way and self.foreseen > cost

    def seems_no_less_than(self, cost: float) -> bool:
        """Whether motions have freedom left and a step without damping promises neither a cost of the data below one
        nor to halve it. Once they balance the cost may be far lower, and far higher.
        """
        return self.freedom > 0.0 and self.steps > 1 and self.foreseen > max(cost, STAYS * self.cost)

    def balance(self) -> None:
        """Go on from the parameters where it is, with motions that balance."""
        assert self.here is not None
        self.freedom, self.cost, self.early = 0.0, math.inf, True
        self.trial = self.here.point._replace(slack=False)
        self.damping, self.growth, self.cap = FIRST_DAMPING, 2.0, 1.0

    def give_up(self, result: int = MAX_STEPS) -> None:
        """End it where it stands."""
        self.done, self.result = True, result

    def joins(self, other: "Descent") -> bool:
        """Whether both would step to one optimum without damping: to a standard error, as either tells it. Where there
        are motions to be found, not before a step was seen.
        """
        ready = self.under_way if self.coupled else self.settled
        if self.here is None or other.here is None or not (ready and other.settled):
            return False
        gap = (self.here.point.unknowns - other.here.point.unknowns)[self.task.free] + self.full - other.full
        return all(bool(gap @ one.hessian @ gap < 1.0) for one in (self, other))

    def _off(self) -> float:
        """Standard errors by which what is read is off balance, at most."""
        response = None if self.here is None else self.here.response
        return 0.0 if response is None else float(np.max(response.off[self.judged], initial=0.0))

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
            self._confident((before - self.cost) / self.promised if self.promised > 0.0 else 1.0)
        elif not taken:
            self.damping, self.growth, self.cap = self.growth * self.damping, 2.0 * self.growth, 0.5 * self.cap
        if taken:
            self._firmer()
        self.decrement = self._propose()
        limit = self._limit()
        fall = before - self.cost if taken and not first else 0.0
        self.stalled = 0 if first or self.freedom > 0.0 or fall > limit else self.stalled + 1
        fallen = taken and not first and fall <= limit and self.damping < 1e-4
        stuck = self.stalled >= PATIENCE
        balanced = self.freedom == 0.0 and self._off() < BALANCED
        if self.steps >= self.settings.most_steps:
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
        if self.coupled and there.point.refined and self.settled and (self.best is None or cost < self.best[-1]):
            self.best = there, normal, prior, cost
        return True

    def _confident(self, kept: float) -> None:
        """The damping after a trial that was taken. **Arguments:** ``kept``: the share of the promised fall of the cost
        that came.
        """
        self.damping *= max(1.0 - (2.0 * min(max(kept, 0.0), 1.0) - 1.0) ** 3, 0.1)
        self.damping, self.growth = max(self.damping, 1e-12), 2.0
        self.cap = min(2.0 * self.cap, 1.0)

    def _slack(self) -> float:
        """Rise of the cost that is put down to motions that do not balance yet, or to rounding."""
        return self._limit() if self.settled else self._limit() + self.settings.cost_slack * self.cost

    def _limit(self) -> float:
        """Change of the cost that counts as none."""
        return float(self.settings.tolerance * (self.cost + self.of_noise))

    def _firmer(self) -> None:
        """Less freedom of the motions, and the cost as it is then."""
        if self.freedom == 0.0 or self.here is None or self.here.response is None:
            return
        assert self.here.response.own is not None
        size = float(np.max(np.linalg.norm(self.here.response.own.reach, axis=2)[self.task.training], initial=0.0))
        while self.freedom > 0.0:
            self.freedom *= self.settings.freedom_decay
            self.freedom = 0.0 if self.freedom * size < BALANCED else self.freedom
            self.normal = Normal(self.lin, self.here, self.task, self.freedom)
            self.cost = self.normal.cost + self.prior.cost
            # More than enough freedom explains anything, and leaves the parameters to their prior.
            if self.normal.cost > self.of_noise:
                break

    def _arrived(self) -> None:
        """At an end; where orders depend on one another once more with more of them."""
        assert self.here is not None
        if self.coupled and not self.here.point.refined:
            self.trial = self.here.point._replace(refined=True, slack=False)
            self.since = 0
        else:
            self.result, self.done = CONVERGED, True

    def _give_in(self, balanced: bool) -> None:
        """Where no step is better: less freedom of the motions, or more orders if those so far are balanced, or the
        end.
        """
        assert self.here is not None
        self.damping, self.growth, self.cap = FIRST_DAMPING, 2.0, 1.0
        if self.freedom > 0.0:
            self._firmer()
            self.decrement = self._propose()
        elif balanced and self.coupled and not self.here.point.refined:
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
        hessian = self.hessian = self.normal.hessian + np.diag(self.prior.weight)
        self.full = step
        decrement, self.foreseen = 0.0, self.normal.cost
        if len(free):
            scaled, scale = unit_diagonal(hessian)
            downhill = scale * gradient
            full = self.full = -scale * np.linalg.solve(scaled + ROUNDING * np.eye(len(free)), downhill)
            decrement = -0.5 * float(gradient @ full)
            self.foreseen = float(
                self.normal.cost + self.normal.gradient @ full + 0.5 * full @ self.normal.hessian @ full
            )
            step = -scale * np.linalg.solve(scaled + self.damping * np.eye(len(free)), downhill)
            self.promised = float(-gradient @ step - 0.5 * step @ hessian @ step)
        unknowns[free] += step
        motions = None
        if self.coupled:
            motions = self._capped(self.normal.motion_step(step))
        self.trial = Point(unknowns, motions, point.refined, self.freedom > 0.0)
        return decrement

    def _capped(self, change: Float[np.ndarray, "state motion"]) -> Float[np.ndarray, "state dof wide"]:
        """The motions after a step that is no longer than a share of each."""
        assert self.here is not None
        size = np.linalg.norm(np.asarray(self.here.point.motions).reshape(len(change), -1), axis=1)
        most = self.cap * np.maximum(size, 0.1 * self._reach())
        return self.lin.moved(
            self.here, change * np.minimum(1.0, most / np.maximum(np.linalg.norm(change, axis=1), 1e-300))[:, None]
        )

    def back_to_balance(self) -> None:
        """Where it went on from motions that balance and came to some that do not: to those."""
        if self.best is not None and not self.settled:
            self.here, self.normal, self.prior, self.cost = self.best

    def balanced_normal(self) -> Normal | None:
        """The normal equations where it is, the motions without freedom of their own; none where nothing is finite."""
        if self.here is None or not math.isfinite(self.cost):
            return None
        return self.normal if self.freedom == 0.0 and self.normal else Normal(self.lin, self.here, self.task, 0.0)

    @property
    def exact(self) -> bool:
        """Whether its motions balance, with as many orders as are to be had."""
        return not self.coupled or (self._off() < BALANCED and self.here is not None and self.here.point.refined)
