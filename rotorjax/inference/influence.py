"""What a fit would be on part of the data or under another prior, to first order about where it ended: no evaluation of
the model.
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float

from rotorjax.inference.data import Data
from rotorjax.inference.descent import End, Local
from rotorjax.inference.prior import Prior
from rotorjax.inference.squares import squares_of

CLEAR = 1.0
"""Log evidence to first order by which one fit must be behind another not to be made."""


def influenced(
    data: Data,
    end: End,
    training: Bool[np.ndarray, "case"],
    prior: Callable[[Float[np.ndarray, "free"]], Prior] | None = None,
) -> End:
    """One step of Gauss and Newton from the end of a fit: exact where the vectors are linear in the parameters.

    Elsewhere the cost is too low, as a rule: the step goes as far as the linear model promises. Without part of the
    data this is the influence function of the fit (Cook 1977, Technometrics 19:15-18). **Arguments:** ``data``: in the
    units of the fit; ``training``: cases that count now; ``prior`` of the free unknowns, if it is another one.
    """
    squares, here = squares_of(data, end.local.error, end.local.slopes, training), end.point[end.free]
    there = end.prior if prior is None else prior(here)
    gradient, curvature = squares.gradient + there.weight * here, squares.hessian + np.diag(there.weight)
    step = -np.linalg.solve(curvature, gradient)
    cost = squares.cost + there.cost + 0.5 * float(gradient @ step)
    point = end.point.copy()
    point[end.free] += step
    local = Local(end.local.error + end.local.slopes @ step, end.local.slopes)
    return end._replace(point=point, cost=cost, curvature=curvature, prior=there, local=local)
