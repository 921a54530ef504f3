"""What a model shows at conditions that were not measured, or at other parameters: motions that balance, from motions
near by.
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float, Int

from rotorjax.inference.budget import Budget
from rotorjax.inference.data import Data
from rotorjax.inference.linearised import Linearisation, Point
from rotorjax.inference.motions import balanced
from rotorjax.inference.space import Space
from rotorjax.inference.states import States
from rotorjax.model.conditions import Conditions

MET = 1e-4
"""Change of the vectors, in their largest size, that counts as none."""


class Prediction(NamedTuple):
    """Vectors of every case and their slopes; not a number where no steady motion was found."""

    shown: Complex[np.ndarray, "case probe order"]
    slopes: Float[np.ndarray, "case cell free"]
    """Of real and imaginary parts, by the unknowns wanted [m]."""


def conditions_data(conditions: Conditions, probes: int, orders: int) -> Data:
    """Conditions at which nothing was measured."""
    speed, unbalance, bow = (np.asarray(values) for values in (conditions.speed, conditions.unbalance, conditions.bow))
    sweep = conditions.sweeps
    pairs, run = np.zeros((len(speed), probes, orders, 2)), np.zeros(len(speed), int)
    return Data(
        speed,
        unbalance,
        bow,
        sweep,
        pairs,
        np.ones(pairs.shape),
        np.zeros(orders, bool),
        run,
        np.zeros((len(speed), probes * orders * 2, 0)),
        np.zeros(len(speed), bool),
    )


def predict(
    space: Space,
    conditions: Conditions,
    point: Float[np.ndarray, "param"],
    *,
    budget: Budget,
    near: tuple[Conditions, Float[np.ndarray, "near dof wide"] | None] | None = None,
    free: Int[np.ndarray, "free"] | None = None,
) -> Prediction:
    """What the model shows at some unknowns.

    **Arguments:** ``near``: conditions of motions known at about these unknowns, and those motions: where orders depend
    on one another each case begins with that of the nearest condition, then with that of the linear rotor; ``free``:
    unknowns by which slopes are wanted.
    """
    layout = space.model.layout
    lin = Linearisation(space, conditions_data(conditions, len(layout.probes), len(layout.orders)), budget)
    wanted = np.zeros(0, int) if free is None else free
    if not lin.coupled(point, np.zeros(0, int)):
        (one,) = lin.at([Point(point, None)], [wanted])
        return Prediction(lin.vectors(one.shown), one.slopes)
    starts = []
    if near is not None and near[1] is not None:
        starts.append(
            near[1][
                _nearest(
                    lin.states,
                    States.of(near[0], None if space.model.slow_roll is None else float(space.model.slow_roll)),
                )
            ]
        )
    starts.append(_linear_motions(lin, point))
    shown, slopes = (
        np.full((lin.cases, lin.data.pairs[0].size), np.nan),
        np.full((lin.cases, lin.data.pairs[0].size, len(wanted)), np.nan),
    )
    for motions in starts:
        found, by_free = _balanced(lin, point, motions, wanted)
        lost = ~np.isfinite(shown).all(axis=1)
        shown[lost], slopes[lost] = found[lost], by_free[lost]
        if np.isfinite(shown).all():
            break
    return Prediction(lin.vectors(shown), slopes)


def _nearest(wanted: States, known: States) -> Int[np.ndarray, "state"]:
    """Index of the known state that is nearest to each that is wanted: in speed, and in what is installed, each in its
    largest size.
    """
    distance = np.zeros((len(wanted.speed), len(known.speed)))
    for one, other in zip(wanted[:3], known[:3], strict=True):
        here, there = one.reshape(len(one), -1), other.reshape(len(other), -1)
        distance += np.linalg.norm(here[:, None] - there[None], axis=2) / (float(np.abs(there).max()) or 1.0)
    return np.argmin(distance, axis=1)


def _linear_motions(lin: Linearisation, point: Float[np.ndarray, "param"]) -> Float[np.ndarray, "state dof wide"]:
    plain = np.where(lin.space.coupled(), 0.0, point)
    (one,) = lin.at([Point(plain, lin.at_rest)], [np.zeros(0, int)])
    assert one.response is not None
    return lin.moved(one, -one.response.newton)


def _balanced(
    lin: Linearisation,
    point: Float[np.ndarray, "param"],
    motions: Float[np.ndarray, "state dof wide"],
    free: Int[np.ndarray, "free"],
) -> tuple[Float[np.ndarray, "case cell"], Float[np.ndarray, "case cell free"]]:
    """Vectors and slopes where motions that balance are found near some, else not a number."""
    tight, none = math.inf, np.zeros(0, int)
    for refined in (False, True):
        (here,) = lin.at([Point(point, motions, refined)], [none])
        tight = MET * float(np.nanmax(np.abs(here.shown), initial=0.0))
        (near,), _ = balanced(lin, [here], tight)
        motions = np.asarray(near.motions)
    (one,) = lin.at([Point(point, motions, True)], [free])
    assert one.response is not None
    found = lin.states.everywhere(one.response.off <= tight)
    return np.where(found[:, None], one.shown, np.nan), np.where(found[:, None, None], one.slopes, np.nan)
