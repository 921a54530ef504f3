"""The evidence of one optimum: Laplace's method, averaged over how strong each effect is usually.

A declared prior scale says how strong an effect may well be; that most are weaker by decades is as likely. The
evidence is the mean over prior scales s_k = 3^k times the declared one, for the strength of every effect by itself:
from where it could just be seen up to the declared scale, or 2000 times that for a nonlinear force and a
probe's saturation. Of two effects that fit as well with as many parameters neither is then preferred for the scale that
somebody chose. An effect that often has a simpler form (`Effect.forms`: errors of the stiffness that are the same along
x and y, one probe off and not the other, an eccentric probe track) is averaged over these too, each as likely as that
all its parameters are independent: those that a form does not have then lower the evidence by no more than the
logarithm of the number of forms.

Each of these priors is that of unknowns T_k w, with w as declared. To first order about the optimum at the declared
scales, where the curvature of the data is A, that of the prior W and both together H = A + W, the optimum u moves to v
under another prior, of curvature W_k:

    v = (A + W_k)⁻¹ H u
    ln Z_k = -[cost of the data + ½ (v-u)ᵀ A (v-u) - uᵀ W (v-u)] - [cost of the prior at T_k⁻¹ v] - ½ ln |A + W_k|
             - ln |T_k|

Exact where the vectors are linear in the parameters. (Mixtures over the scale of a prior: Liang, Paulo, Molina, Clyde,
Berger 2008, J. Am. Stat. Assoc. 103:410-423.)
"""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from rotorjax.inference.curvature import log_determinant, solved
from rotorjax.inference.descent import End
from rotorjax.inference.descent_settings import CONVERGED
from rotorjax.inference.prior import prior_at, together
from rotorjax.inference.space import Space
from rotorjax.model.model import Model

STEP = 3.0
"""From one prior scale to the next."""
LARGEST_OPEN = 7
"""Largest power of it, of a size that is left open (`rotorjax.inference.prior`); of others the declared scale is the
largest.
"""
SEEN = 5.0
"""Standard errors from which on a strength could be seen: smaller ones belong to "none"."""
LEAST = -12
"""Smallest power of the step."""
ACROSS = 0.01
"""Standard deviation across the directions of a form, over that along them."""


def log_evidence(end: End, space: Space, log_of: Callable[[float], float], *, wide: bool = False) -> float:
    """Logarithm of the evidence of one optimum, up to a constant of the data; at the declared scales where the fit did
    not converge, for nothing can be told from there.

    **Arguments:** ``log_of``: logarithm of the likelihood times the prior's density at a cost; ``wide``: effects may be
    three times as strong as declared.
    """
    own = log_of(end.cost) - 0.5 * float(log_determinant(end.curvature))
    if end.result != CONVERGED:
        return own - end.spread
    optimum, total = _Optimum.of(end, together(np.asarray(space.open_size)[end.free])), own
    for group, widths in left_open(end, space, wide=wide):
        logs = optimum.under(group, np.stack(widths), log_of)
        total += float(np.logaddexp.reduce(logs)) - np.log(len(logs)) - own
    return total - end.spread


def _determined(end: End) -> Float[np.ndarray, "free"]:
    """The optimum, zero in directions that the data do not determine: along a curved valley a fit may have stopped
    where the prior still pulls.
    """
    width, kept = end.prior_width[end.free], end.determined
    return width * (kept @ (kept.T @ (end.point[end.free] / width)))


def left_open(
    end: End, space: Space, *, wide: bool = False
) -> Iterator[tuple[Int[np.ndarray, "part"], list[Float[np.ndarray, "part part"]]]]:
    """Free unknowns whose prior is averaged over, together, and the priors: the matrices T that make unknowns T w of
    unknowns w with the declared one.
    """
    place, data_curvature = {int(unknown): k for k, unknown in enumerate(end.free)}, end.data_curvature
    strength, sizes = np.asarray(space.strength), np.asarray(space.open_size)
    groups: dict[tuple[str, int], dict[str, int]] = {}
    for entry in space.entries:
        if entry.unknown in place and not entry.declared_uncertain:
            group = groups.setdefault((entry.effect, int(strength[entry.unknown])), {})
            group[entry.label] = place[entry.unknown]
    for (effect, number), labels in groups.items():
        group = np.array(list(labels.values()))
        shapes = [np.eye(len(group)), *_forms(space.model, effect, tuple(labels), data_curvature[np.ix_(group, group)])]
        if number >= 0:
            largest = LARGEST_OPEN if sizes[end.free[group[0]]] >= 0 else int(wide)
            scales = factors(data_curvature, end.prior.weight, group, largest)
            yield group, [scale * shape for scale in scales for shape in shapes]
        elif len(shapes) > 1:
            yield group, shapes


def _forms(
    model: Model, effect: str, labels: tuple[str, ...], data_curvature: Float[np.ndarray, "part part"]
) -> list[Float[np.ndarray, "part part"]]:
    """Matrices T as in `left_open` of an effect's simpler forms: along their directions with the declared scales of the
    parameters that take part, `ACROSS` them a small share of that. Forms of which the data tell nothing are left out,
    and those of parameters that are not free together.

    **Arguments:** ``data_curvature`` by the unknowns of the effect.
    """
    angles = model.rotor.spin * np.asarray(model.probes.angle)
    found = []
    own = next(e for e in model.effects if e.name == effect)
    for form in own.forms(model.layout, angles):
        if not all(direction.keys() <= set(labels) for direction in form) or len(form) == len(labels):
            continue
        shares = np.array([[direction.get(label, 0.0) for direction in form] for label in labels])
        basis, _ = np.linalg.qr(shares)
        along = basis @ basis.T
        if np.trace(basis.T @ data_curvature @ basis) < 1.0:
            continue
        taking_part = np.count_nonzero(np.any(shares != 0.0, axis=1))
        found.append(np.sqrt(taking_part / len(form)) * along + ACROSS * (np.eye(len(labels)) - along))
    return found


class _Optimum(NamedTuple):
    """Cost and curvature about one optimum under the declared prior."""

    here: Float[np.ndarray, "free"]
    data: Float[np.ndarray, "free free"]
    """Curvature of the data."""
    data_cost: float
    data_gradient: Float[np.ndarray, "free"]
    pull: Float[np.ndarray, "free"]
    """Whole curvature times the optimum."""
    parts: Float[np.ndarray, "free free"]
    """As in `rotorjax.inference.prior.prior_at`."""

    @classmethod
    def of(cls, end: End, parts: Float[np.ndarray, "free free"]) -> "_Optimum":
        here = _determined(end)
        data_cost = end.cost - prior_at(here, parts).cost
        return cls(here, end.data_curvature, data_cost, -end.prior.weight * here, end.curvature @ here, parts)

    def under(
        self,
        group: Int[np.ndarray, "part"],
        widths: Float[np.ndarray, "prior part part"],
        log_of: Callable[[float], float],
    ) -> list[float]:
        """Log evidence under each of other priors of some unknowns. **Arguments:** ``widths``: T of each."""
        to_declared = np.tile(np.eye(len(self.here)), (len(widths), 1, 1))
        to_declared[:, group[:, None], group] = np.linalg.inv(widths)
        weights = prior_at(to_declared @ self.here, self.parts).weight
        curvature = self.data + np.swapaxes(to_declared, 1, 2) @ (weights[..., None] * to_declared)
        there = solved(curvature, self.pull[:, None])[..., 0]
        step = there - self.here
        fit = self.data_cost + step @ self.data_gradient + 0.5 * np.sum(step @ self.data * step, axis=1)
        declared = (to_declared @ there[..., None])[..., 0]
        cost = fit + prior_at(declared, self.parts).cost
        volume = -0.5 * log_determinant(curvature) - np.linalg.slogdet(widths)[1]
        return [log_of(float(one)) + float(log) for one, log in zip(cost, volume, strict=True)]


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
    others = np.delete(np.arange(len(weight)), group)
    coupling = data[np.ix_(group, others)]
    rest = data[np.ix_(others, others)] + np.diag(weight[others])
    own = data[np.ix_(group, group)] - coupling @ solved(rest, coupling.T)
    mean = float(np.trace(own)) / len(group)
    powers = np.arange(LEAST, largest + 1)
    return STEP ** powers[(powers >= 0) | (mean * STEP ** (2.0 * powers) >= SEEN**2)]
