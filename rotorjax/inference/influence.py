"""What a fit would be on part of the data, to first order about where it ended: no evaluation of the model."""

import numpy as np
from jaxtyping import Bool

from rotorjax.inference.curvature import solved
from rotorjax.inference.data import Data
from rotorjax.inference.descent import End, Local
from rotorjax.inference.squares import squares_of

CLEAR = 1.0
"""Log evidence to first order by which one fit must be behind another not to be made."""


def influenced(data: Data, end: End, training: Bool[np.ndarray, "case"]) -> End:
    """One step of Gauss and Newton from the end of a fit: exact where the vectors are linear in the parameters.

    Elsewhere the cost is too low, as a rule: the step goes as far as the linear model promises. Without part of the
    data this is the influence function of the fit (Cook 1977, Technometrics 19:15-18). **Arguments:** ``data``: in the
    units of the fit; ``training``: cases that count now.
    """
    squares, here = squares_of(data, end.local.error, end.local.slopes, training), end.point[end.free]
    weight = end.prior.weight
    gradient, curvature = squares.gradient + weight * here, squares.hessian + np.diag(weight)
    step = -solved(curvature, gradient[:, None])[:, 0]
    cost = squares.cost + end.prior.cost + 0.5 * float(gradient @ step)
    prior = end.prior._replace(cost=end.prior.cost + float((weight * (here + 0.5 * step)) @ step))
    point = end.point.copy()
    point[end.free] += step
    local = Local(end.local.error + end.local.slopes @ step, end.local.slopes)
    return end._replace(point=point, cost=cost, curvature=curvature, prior=prior, local=local, spread=data.spread)
