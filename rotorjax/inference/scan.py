"""The strength of a force scanned where descents lose it: its motion followed from that of the rotor without the force,
step by step.

A force that nearly holds the rotor shows as little of a motion, from which no descent finds the one that balances; from
weak to strong each motion is near the one before.
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from rotorjax.inference.linearised import Linearisation, Point
from rotorjax.inference.motions import BALANCED, balanced

STRENGTHS = 0.1 * 1.5 ** np.arange(14)
"""In prior scales, with either sign."""


class Scanned(NamedTuple):
    """The best strength of a scan, and the motions there."""

    point: Float[np.ndarray, "param"]
    motions: Float[np.ndarray, "state dof wide"]


def scan(
    lin: Linearisation,
    point: Float[np.ndarray, "param"],
    free: Int[np.ndarray, "free"],
    training: Bool[np.ndarray, "case"],
) -> Scanned | None:
    """The strength that comes nearest to the data, if motions balance at any and the free unknowns have just one
    strength of a force.

    **Arguments:** ``point``: values of all other unknowns.
    """
    strength = free[lin.space.coupled()[free]]
    if len(strength) != 1:
        return None
    none, best, found = np.zeros(0, int), math.inf, None
    judged = lin.states.seen_in(np.flatnonzero(training))
    plain = np.where(lin.space.coupled(), 0.0, point)
    (rest,) = lin.at([Point(plain, lin.at_rest)], [none])
    assert rest.response is not None
    for sign in (1.0, -1.0):
        motions = lin.moved(rest, -rest.response.newton)
        for size in STRENGTHS:
            trial = point.copy()
            trial[strength] = sign * size
            here = lin.at([Point(trial, motions)], [none])
            if not here[0].finite or lin.budget.exhausted:
                break
            (near,), _ = balanced(lin, here, BALANCED)
            (there,) = lin.at([near], [none])
            if there.response is None or not there.finite or np.any(there.response.off[judged] > BALANCED):
                break
            motions = lin.moved(there, -there.response.newton)
            cost = float(np.sum(there.error[training] ** 2))
            if cost < best:
                best, found = cost, Scanned(trial, motions)
    if found is None:
        return None
    (near,), _ = balanced(lin, lin.at([Point(*found, refined=True)], [none]), BALANCED)
    return Scanned(near.unknowns, np.asarray(near.motions))
