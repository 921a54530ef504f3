"""Whether the steady state that `response` shows is stable, and whether there are others at the same speed.

Stable is a motion whose small disturbances die away: the largest Floquet multiplier (`rotorjax.physics.floquet`) is not
above one. Others are searched by `rotorjax.physics.steady_state_search`.
"""

import math
import operator
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Complex, Float, Int

from rotorjax.model.conditions import Conditions
from rotorjax.model.contract import AbstractRotor, RestoringEffect
from rotorjax.model.model import Model
from rotorjax.physics.floquet import largest_multiplier
from rotorjax.physics.harmonic_balance import BALANCED, NOT_BALANCED, SMALLEST_MOTION, UNSTABLE, Grid, grid_of
from rotorjax.physics.restoring_forces import restoring
from rotorjax.physics.steady_state_search import DISTINCT, Found, let_go, steady_states_found
from rotorjax.units import RPM

SELF_EXCITING = ("cross_coupling", "internal_damping")
"""Effects of the linear rotor that may make it unstable."""
GROWTH, LINEAR_GROWTH = 1e-3, 1e-4
"""Of a disturbance in one period, up to which a motion counts as stable: forces with corners leave errors of the first
size; the second is for models without nonlinear forces. A rotor without damping has multipliers of one.
"""
MOST_OTHERS = 3
"""Further steady states that are reported per condition."""
MOST_LISTED = 4
"""Speeds that a line of words lists one by one."""
BATCH = 8
"""Cases that are followed in time at once."""


class SteadyState(NamedTuple):
    """One steady state of one case."""

    vectors: Complex[np.ndarray, "probe order"]
    """As `response` gives them [m]."""
    multiplier: float
    """Largest absolute Floquet multiplier over one period; not a number where stability cannot be judged."""

    @property
    def stable(self) -> bool:
        """Whether disturbances of the motion die away."""
        return self.multiplier <= 1.0 + GROWTH


class SteadyStates(NamedTuple):
    """What `response` shows, whether the machine stays there, and where else it may run."""

    speed: Float[np.ndarray, "case"]
    """Ω as tabulated [rad/s]."""
    vectors: Complex[np.ndarray, "case probe order"]
    """The same as from `response` [m]."""
    result: Int[np.ndarray, "case"]
    """BALANCED (0), NOT_BALANCED (1: no steady state was found) or UNSTABLE (2: the machine does not stay there), of
    `rotorjax.physics.harmonic_balance`.
    """
    multiplier: Float[np.ndarray, "case"]
    """Largest absolute Floquet multiplier over one period of the motion; not a number where none was found, or where an
    effect depends on frequency in a way that no equation of motion in time has.
    """
    others: tuple[tuple[SteadyState, ...], ...]
    """Per case further steady states at the same speed, stable ones first."""

    def words(self) -> list[str]:
        """What is not as it should be, one line for each kind; none where all is well."""
        stable = np.array([sum(other.stable for other in others) for others in self.others], int)
        missing, unstable, good = (self.result == code for code in (NOT_BALANCED, UNSTABLE, BALANCED))
        kinds = (
            (missing & (stable == 0), "no steady state was found"),
            (missing & (stable > 0), "no steady state is shown, but following it from other speeds found a stable one"),
            (unstable & (stable == 0), "the steady state is unstable: the machine does not stay there"),
            (
                unstable & (stable > 0),
                "the steady state shown is unstable, but a stable one exists: the machine may run there instead",
            ),
            (
                good & (stable == 1),
                "there are two stable steady states; which one is reached depends on how the speed was reached",
            ),
            (
                good & (stable > 1),
                "there are three or more stable steady states; which one is reached depends on how the speed was "
                "reached",
            ),
            (
                good & np.isnan(self.multiplier),
                "whether the steady state is stable is not known: an effect depends on frequency as no spring or "
                "damper does",
            ),
        )
        return [f"At {self._where(there)} {what}." for there, what in kinds if np.any(there)]

    def _where(self, there: Bool[np.ndarray, "case"]) -> str:
        """Number of conditions, and their speeds in rpm."""
        speeds = sorted({f"{speed / RPM:.0f}": speed for speed in self.speed[there]}.items(), key=lambda item: item[1])
        shown = [text for text, _ in speeds]
        each = [part for part in (", ".join(shown[:-1]), shown[-1]) if part]
        listed = " and ".join(each) if len(shown) <= MOST_LISTED else f"{shown[0]} to {shown[-1]}"
        if len(self.speed) == 1:
            return f"{listed} rpm"
        return f"{np.sum(there)} of {len(self.speed)} conditions (speed{'s' if len(shown) > 1 else ''} {listed} rpm)"


def _same(
    one: Complex[np.ndarray, "dof coefficient"], other: Complex[np.ndarray, "dof coefficient"], grid: Grid
) -> bool:
    """Whether two motions are one, begun in the same turn or in another of its period."""
    turned = [other * np.exp(2j * np.pi * grid.order_array * turn) for turn in range(grid.turns)]
    size = max(np.max(np.abs(one[:, 1:])), np.max(np.abs(other[:, 1:])), SMALLEST_MOTION)
    return bool(min(np.max(np.abs(one - there)) for there in turned) <= DISTINCT * size)


class _Case(NamedTuple):
    """Steady states of one case, as in `Found`."""

    vectors: Complex[np.ndarray, "start probe order"]
    motions: Complex[np.ndarray, "start dof coefficient"]
    multipliers: tuple[float, ...]
    """Not a number where no equation of motion in time is known."""

    @classmethod
    def of(cls, found: Found) -> "_Case":
        """Of one case of what was found."""
        multipliers = (
            largest_multiplier(matrix) if found.exists else math.nan for matrix in np.asarray(found.monodromy)
        )
        return cls(np.asarray(found.vectors), np.asarray(found.motions), tuple(multipliers))

    def there(self, number: int) -> bool:
        """Whether such a steady state was found."""
        return bool(np.all(np.isfinite(self.motions[number])) and np.all(np.isfinite(self.vectors[number])))

    @property
    def restless(self) -> bool:
        """Whether nothing was found in which the machine would stay, although that could be told."""
        told = [self.multipliers[k] for k in range(len(self.motions)) if self.there(k)]
        return not np.any(np.isnan(self.multipliers)) and all(multiplier > 1.0 + GROWTH for multiplier in told)

    def joined(self, other: "_Case") -> "_Case":
        """With further ones."""
        vectors, motions = np.concatenate([self.vectors, other.vectors]), np.concatenate([self.motions, other.motions])
        return _Case(vectors, motions, self.multipliers + other.multipliers)

    def others(self, grid: Grid) -> tuple[SteadyState, ...]:
        """The distinct ones beside the first."""
        first = int(np.all(np.isfinite(self.motions[0])))
        kept = list(range(first))
        for k in range(1, len(self.motions)):
            if self.there(k) and not any(_same(self.motions[k], self.motions[j], grid) for j in kept):
                kept.append(k)
        states = [SteadyState(self.vectors[k], self.multipliers[k]) for k in kept[first:]]
        return tuple(sorted(states, key=lambda state: not state.stable)[:MOST_OTHERS])


def _cases(found: Found) -> list[_Case]:
    """One by one."""
    each = (Found(*parts) for parts in zip(*(np.asarray(part) for part in found), strict=True))
    return [_Case.of(one) for one in each]


def _settling(model: Model, conditions: Conditions, found: Found, cases: list[_Case]) -> list[_Case]:
    """The cases, with what the machine comes to in time where nothing stable was found."""
    after, restless = list(cases), np.flatnonzero([case.restless for case in cases])
    for first in range(0, len(restless), BATCH):
        # The last batch is filled up, so that one program serves all.
        index = restless[np.minimum(np.arange(first, first + BATCH), len(restless) - 1)]
        chosen = jax.tree.map(operator.itemgetter(index), conditions)
        after_a_while = let_go(model, chosen, found.motions[index, 0], found.rolling[index])
        for k, more in zip(index, _cases(after_a_while), strict=True):
            after[k] = cases[k].joined(more)
    return after


def steady_states(model: Model | AbstractRotor, conditions: Conditions) -> SteadyStates:
    """What `response` shows at every condition, whether it is stable, and which other steady states were found there.

    Stable: the largest absolute Floquet multiplier over one period, a turn of the shaft or two to four where the model
    has fractions of an order, is at most 1.001 (1.0001 without nonlinear forces). Others are searched by
    following the steady state in speed from
    0.6 times the speed of the condition (0.8 times the natural frequency if that is less) and from 1.5 times, installed
    unbalance and bow unchanged, with a push towards fractions of an order where the model has any, and by Newton's
    method from motions of several sizes and, at fractions, directions; where nothing stable was found so, by
    integration in time over 200 turns from near the motion shown, from rest and from the motion of the linear rotor.
    That none was found is no proof that there is none. Motion that does not repeat itself within such a period is not
    found. Without nonlinear forces there is one steady state, which internal damping or cross-coupling can
    make unstable. Not differentiable.

    **Arguments:** ``model``, or a rotor alone; ``conditions`` with one leading axis. **Returns** `SteadyStates`.
    Source: Nayfeh, Balachandran, Applied Nonlinear Dynamics, Wiley 1995, chapter 3; for a shaft with two unequal
    stiffnesses Genta, Dynamics of Rotating Systems, Springer 2005, section 6.3.
    """
    model = model if isinstance(model, Model) else Model(model)
    found, coupled = steady_states_found(model, conditions), bool(restoring(model))
    cases = _cases(found)
    others: tuple[tuple[SteadyState, ...], ...] = ((),) * len(cases)
    if coupled:
        grid = grid_of(model)
        others = tuple(case.others(grid) for case in _settling(model, conditions, found, cases))
    good = np.array([case.there(0) for case in cases], bool)
    multiplier = np.where(good, np.array([case.multipliers[0] for case in cases]), np.nan)
    result = np.where(
        good, np.where(multiplier > 1.0 + (GROWTH if coupled else LINEAR_GROWTH), UNSTABLE, BALANCED), NOT_BALANCED
    )
    return SteadyStates(np.asarray(conditions.speed), np.asarray(found.vectors)[:, 0], result, multiplier, others)


def steadiness(model: Model, conditions: Conditions) -> list[str]:
    """Where a steady state does not exist, is unstable or is not the only one, in words; looked into where an effect
    may cause that.
    """
    suspects = any(isinstance(e, RestoringEffect) or e.name in SELF_EXCITING for e in model.effects)
    return steady_states(model, conditions).words() if suspects else []
