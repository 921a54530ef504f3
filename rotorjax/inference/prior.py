"""The prior of the unknowns: normal, with long tails for the size of nonlinear forces and of a probe's
saturation.
"""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

USUAL = 3.0
"""Prior scales up to which a size that is left open counts as in a normal distribution."""


class Prior(NamedTuple):
    """The prior at one point, or at each of several."""

    cost: Any
    """Minus the logarithm of its density, in that of the normal distribution at its peak: a number, or one for each."""
    weight: Float[np.ndarray, "*point free"]
    """Its gradient is the weight times the unknowns; one over the square root of the weight is how wide it is there."""


def together(open_size: Int[np.ndarray, "free"]) -> Float[np.ndarray, "free free"]:
    """1 where two unknowns are parts of the same open size, itself included; rows of zeros for the others.
    **Arguments:** as in `Space.open_size`.
    """
    return ((open_size[:, None] == open_size[None]) & (open_size >= 0)[:, None]).astype(float)


def prior_at(unknowns: Float[np.ndarray, "*point free"], parts: Float[np.ndarray, "free free"]) -> Prior:
    """The prior of some unknowns, in units of their scales.

    A standard normal for each; but the size r = |u| of a nonlinear force, or of a probe's saturation, has
    a tail by a power, as nobody knows beforehand how strong a cubic spring or a rub is: thirty times the usual must not
    be excluded by its size alone. Parameters with one unit, like the two components of a crack, have one size.

        -ln p(u) = r² / 2 up to r = c, c² / 2 + c² ln(r / c) beyond, c = `USUAL`

    up to a constant: within a thousandth of the normal's for a single number, within 3 % up to four (it is a density up
    to eight). The weight is that of iterated least squares, min(1, c² / r²) (Huber 1981, Robust Statistics, section
    7.8): as a curvature it bounds the true one from above, and is never negative.

    **Arguments:** ``unknowns``; ``parts``: as `together` makes them.
    """
    count = parts.sum(axis=1)
    far = np.maximum(unknowns**2 @ parts / USUAL**2, 1.0)
    tail = 0.5 * USUAL**2 * (1.0 + np.log(far)) / np.maximum(count, 1.0)
    each = np.where(far > 1.0, tail, 0.5 * unknowns**2)
    cost = each.sum(axis=-1)
    return Prior(cost if unknowns.ndim > 1 else float(cost), 1.0 / far)
