"""The evidence of one optimum: Laplace's method, averaged over how strong each effect is usually.

A declared prior scale says how strong an effect may well be; that most are weaker by decades is as likely. The
evidence is the mean over prior scales s_k = 3^k times the declared one, for the strength of every effect by itself:
from where it could just be seen up to the declared scale, or 2000 times that for a force that depends on motion and a
probe's saturation. Of two effects that fit as well with as many parameters neither is then preferred for the scale that
somebody chose.

To first order about the optimum at the declared scales, where the curvature of the data is A, that of the prior W and
both together H = A + W, the optimum u moves to v under another prior W_k:

    v = (A + W_k)⁻¹ H u
    ln Z_k = -[cost of the data + ½ (v-u)ᵀ A (v-u) - uᵀ W (v-u)] - [cost of the prior at v] - ½ ln |A + W_k| - n ln s_k

Exact where the vectors are linear in the parameters. (Mixtures over the scale of a prior: Liang, Paulo, Molina, Clyde,
Berger 2008, J. Am. Stat. Assoc. 103:410-423.)
"""

from collections.abc import Callable, Iterator

import numpy as np
from jaxtyping import Float, Int

from rotorjax.inference.descent import End
from rotorjax.inference.manner import CONVERGED
from rotorjax.inference.prior import prior_at, together
from rotorjax.inference.space import Space

STEP = 3.0
"""From one prior scale to the next."""
LARGEST, LARGEST_OPEN = 0, 7
"""Largest power of it: in general, and of a size that is left open (`rotorjax.inference.prior`)."""
SEEN = 5.0
"""Standard errors from which on a strength could be seen: smaller ones belong to "none"."""
LEAST = -12
"""Smallest power of the step."""
DETERMINED = 1.5
"""Curvature in units of the prior's from which the data determine a direction: here that of the data alone."""


def log_evidence(end: End, space: Space, log_of: Callable[[float], float]) -> float:
    """Logarithm of the evidence of one optimum, up to a constant of the data; at the declared scales where the fit did
    not converge, for nothing can be told from there.

    **Arguments:** ``log_of``: logarithm of the likelihood times the prior's density at a cost.
    """
    own = log_of(end.cost) - 0.5 * float(np.linalg.slogdet(end.curvature)[1])
    if end.result != CONVERGED:
        return own
    parts, total = together(np.asarray(space.open_size)[end.free]), own
    here = _determined(end)
    for group, scales in strengths(end, space):
        at_scales = _at_scales(end, here, group, scales, parts, log_of)
        total += float(np.logaddexp.reduce(at_scales)) - np.log(len(at_scales)) - own
    return total


def _determined(end: End) -> Float[np.ndarray, "free"]:
    """The optimum, zero in directions that the data do not determine: along a curved valley a fit may have stopped
    where the prior still pulls.
    """
    width = 1.0 / np.sqrt(end.prior.weight)
    data = width[:, None] * (end.curvature - np.diag(end.prior.weight)) * width
    curvatures, directions = np.linalg.eigh(data)
    kept = directions[:, curvatures > DETERMINED]
    return width * (kept @ (kept.T @ (end.point[end.free] / width)))


def strengths(end: End, space: Space) -> Iterator[tuple[Int[np.ndarray, "part"], Float[np.ndarray, "scale"]]]:
    """Free unknowns that are one strength together, and the factors of their declared prior scale that are averaged
    over.
    """
    numbers, sizes = (np.asarray(a)[end.free] for a in (space.strength, space.open_size))
    weight = end.prior.weight
    for number in np.unique(numbers[numbers >= 0]):
        group = np.flatnonzero(numbers == number)
        largest = LARGEST_OPEN if sizes[group[0]] >= 0 else LARGEST
        yield group, factors(end.curvature - np.diag(weight), weight, group, largest)


def _at_scales(
    end: End,
    here: Float[np.ndarray, "free"],
    group: Int[np.ndarray, "part"],
    scales: Float[np.ndarray, "scale"],
    parts: Float[np.ndarray, "free free"],
    log_of: Callable[[float], float],
) -> list[float]:
    """Log evidence with the prior scale of some unknowns times each factor. **Arguments:** ``here``: the optimum."""
    weight = end.prior.weight
    data, data_cost = end.curvature - np.diag(weight), end.cost - prior_at(here, parts).cost
    pull, found = end.curvature @ here, []
    for factor in scales:
        by = np.ones(len(here))
        by[group] = factor
        curvature = data + np.diag(prior_at(here / by, parts).weight / by**2)
        there = np.linalg.solve(curvature, pull)
        step = there - here
        fit = data_cost + 0.5 * float(step @ data @ step) - float((weight * here) @ step)
        cost = fit + prior_at(there / by, parts).cost
        found.append(log_of(cost) - 0.5 * float(np.linalg.slogdet(curvature)[1]) - len(group) * np.log(factor))
    return found


def factors(
    data: Float[np.ndarray, "free free"],
    weight: Float[np.ndarray, "free"],
    group: Int[np.ndarray, "part"],
    largest: int,
) -> Float[np.ndarray, "scale"]:
    """Factors of the declared prior scale of some unknowns: from where they could be seen on, one of them always.

    **Arguments:** ``data``: curvature of the data, ``weight`` of the prior, by all unknowns; ``largest`` power of the
    step.
    """
    others = np.setdiff1d(np.arange(len(weight)), group)
    coupling = data[np.ix_(group, others)]
    rest = data[np.ix_(others, others)] + np.diag(weight[others])
    own = data[np.ix_(group, group)] - coupling @ np.linalg.solve(rest, coupling.T)
    told = float(np.trace(own)) / len(group)
    powers = np.arange(LEAST, largest + 1)
    return STEP ** powers[(powers >= 0) | (told * STEP ** (2.0 * powers) >= SEEN**2)]
