"""The prior of the unknowns: normal, or, for forces that depend on motion, of a size that is left open."""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array
from jax.scipy.special import gammaln
from jaxtyping import Float


class Prior(NamedTuple):
    """The prior at one point."""

    cost: Float[Array, ""]
    """Minus the logarithm of its density, in that of the normal distribution at its peak."""
    weight: Float[Array, "free"]
    """Its gradient is the weight times the unknowns; one over the square root of the weight is how wide it is there."""


def prior_at(unknowns: Float[Array, "free"], alike: Float[Array, "free free"]) -> Prior:
    """The prior of some unknowns, in units of their scales.

    A standard normal for each, but for those of a force that depends on motion: nobody knows beforehand how strong a cubic
    spring or a rub is. The n unknowns of such a force together have a Student distribution with one degree of freedom (Cauchy, as
    Gelman et al. 2008, Ann. Appl. Stat. 2:1360-1383, advise where a scale is little more than a guess), in which thirty times
    the usual costs a single number as much as three and a half standard deviations of a normal one:

        p(u) ∝ (1 + |u|² / (n + 1))^(-(n + 1) / 2)

    It has the normal's curvature at its peak. The weight is that of iterated least squares, (1 + |u|² / (n + 1))⁻¹ (Lange, Little, Taylor
    1989, J. Am. Stat. Assoc. 84:881-896): as a curvature it bounds the true one from above, and is never negative.

    **Arguments:** ``unknowns``; ``alike``: 1 where two unknowns belong to the same such force, itself included; rows of zeros for the others.
    """
    count = alike.sum(axis=1)
    left_open = count > 0.0
    shape = 0.5 * (count + 1.0)
    wide = 1.0 + alike @ unknowns**2 / (count + 1.0)
    peak = 0.5 * jnp.log(jnp.pi) - gammaln(shape) + 0.5 * count * jnp.log(shape)
    each = jnp.where(left_open, (peak + shape * jnp.log(wide)) / jnp.maximum(count, 1.0), 0.5 * unknowns**2)
    return Prior(each.sum(), 1.0 / wide)
