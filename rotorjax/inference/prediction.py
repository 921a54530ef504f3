"""What a model shows at conditions that were not measured, or at other parameters: motions by Newton's method from motions near by."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float, Int

from rotorjax.inference.data import Data
from rotorjax.inference.linearised import Budget, Linearisation, Point, States
from rotorjax.model import Conditions
from rotorjax.space import Space

MOST_STEPS = 20
"""Steps of Newton's method; the force is refined once the coarser balance is met."""
MET = 1e-4
"""Change of the vectors, in their largest size, that counts as none."""
LARGEST_STEP = 0.5
"""Of a motion, in its size."""


class Prediction(NamedTuple):
    """Vectors of every case and their slopes; not a number where no steady motion was found."""

    shown: Complex[np.ndarray, "case probe order"]
    slopes: Float[np.ndarray, "case cell free"]
    """Of real and imaginary parts, by the unknowns wanted [m]."""


def conditions_data(conditions: Conditions, probes: int, orders: int) -> Data:
    """Conditions at which nothing was measured."""
    speed, unbalance, bow = (np.asarray(values) for values in (conditions.speed, conditions.unbalance, conditions.bow))
    pairs, run = np.zeros((len(speed), probes, orders, 2)), np.zeros(len(speed), int)
    return Data(speed, unbalance, bow, pairs, np.ones(pairs.shape), np.zeros(orders, bool), run, np.zeros((len(speed), probes * orders * 2, 0)), 1)


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

    **Arguments:** ``near``: conditions of motions known at about these unknowns, and those motions: where orders depend on one another
    each case begins with that of the nearest condition, then with that of the linear rotor; ``free``: unknowns by which slopes are wanted.
    """
    layout = space.model.layout
    lin = Linearisation(space, conditions_data(conditions, len(layout.probes), len(layout.orders)), budget)
    wanted = np.zeros(0, int) if free is None else free
    if not lin.timed(point, np.zeros(len(point), bool)):
        (one,) = lin.at([Point(point, None)], [wanted])
        return Prediction(lin.vectors(one.shown), one.slopes)
    starts = []
    if near is not None and near[1] is not None:
        starts.append(near[1][_nearest(lin.states, States.of(near[0], None if space.model.slow_roll is None else float(space.model.slow_roll)))])
    starts.append(_linear_motions(lin, point))
    shown, slopes = np.full((lin.cases, lin.data.pairs[0].size), np.nan), np.full((lin.cases, lin.data.pairs[0].size, len(wanted)), np.nan)
    for motions in starts:
        found, by_free = _newton(lin, point, motions, wanted)
        lost = ~np.isfinite(shown).all(axis=1)
        shown[lost], slopes[lost] = found[lost], by_free[lost]
        if np.isfinite(shown).all():
            break
    return Prediction(lin.vectors(shown), slopes)


def _nearest(wanted: States, known: States) -> Int[np.ndarray, "state"]:
    """Index of the known state that is nearest to each that is wanted: in speed, and in what is installed, each in its largest size."""
    distance = np.zeros((len(wanted.speed), len(known.speed)))
    for one, other in zip(wanted[:3], known[:3], strict=True):
        here, there = one.reshape(len(one), -1), other.reshape(len(other), -1)
        distance += np.linalg.norm(here[:, None] - there[None], axis=2) / (float(np.abs(there).max()) or 1.0)
    return np.argmin(distance, axis=1)


def _linear_motions(lin: Linearisation, point: Float[np.ndarray, "param"]) -> Float[np.ndarray, "state dof wide"]:
    plain = np.where(lin.space.timed(), 0.0, point)
    (one,) = lin.at([Point(plain, lin.at_rest)], [np.zeros(0, int)])
    assert one.freedom is not None
    return lin.moved(one, -one.freedom.newton)


def _newton(
    lin: Linearisation, point: Float[np.ndarray, "param"], motions: Float[np.ndarray, "state dof wide"], free: Int[np.ndarray, "free"]
) -> tuple[Float[np.ndarray, "case cell"], Float[np.ndarray, "case cell free"]]:
    """Vectors and slopes where it converges, else not a number. Every state has steps of its own."""
    none, refined = np.zeros(0, int), False
    good = np.zeros(len(motions), bool)
    shown, slopes = np.full((lin.cases, lin.data.pairs[0].size), np.nan), np.full((lin.cases, lin.data.pairs[0].size, len(free)), np.nan)
    for step in range(MOST_STEPS):
        (one,) = lin.at([Point(point, motions, refined)], [none])
        assert one.freedom is not None
        size = np.linalg.norm(motions.reshape(len(motions), -1), axis=1)
        change = -one.freedom.newton
        length = np.linalg.norm(change, axis=1)
        with np.errstate(invalid="ignore"):
            good = np.isfinite(length) & (length <= MET * np.maximum(size, 1e-12))
            short = np.minimum(1.0, LARGEST_STEP * np.maximum(size, 0.1 * np.max(size)) / np.maximum(length, 1e-300))
        if refined and (good | ~np.isfinite(length)).all():
            break
        refined = refined or bool((good | (step > MOST_STEPS // 2)).all())
        motions = lin.moved(one, np.nan_to_num(change * short[:, None]))
    (one,) = lin.at([Point(point, motions, True)], [free])
    found = lin.states.everywhere(good)
    shown[found], slopes[found] = one.shown[found], one.slopes[found]
    return shown, slopes
