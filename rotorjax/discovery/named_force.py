"""None of these: the force that is missing, the simple terms that it looks like, and how well they do in the response."""

import dataclasses
import math
from collections.abc import Mapping

from rotorjax.discovery.fit import Fit, fit
from rotorjax.discovery.missing_force import Candidate, MissingForce, missing_force, regress
from rotorjax.discovery.noise import LARGEST_HEALTHY_CHI2
from rotorjax.effects import CATALOG
from rotorjax.effects.terms import TERMS
from rotorjax.model import Effect

LARGE_SHARE = 0.9
"""Share of the missing force that a term must have to be tried in the place of several effects."""


@dataclasses.dataclass(frozen=True)
class NamedForce:
    """The force that a model lacks, and what it looks like."""

    force: MissingForce
    terms: tuple[Candidate, ...]
    """None where nothing simple fits."""
    beside: tuple[str, ...]
    """Effects of the answer that are kept beside the terms; none where the terms do better on the model as declared."""
    fit: Fit | None
    """The terms, and those effects, fitted in the response."""

    @property
    def enough(self) -> bool:
        """Whether the terms leave no more than the noise of the table."""
        return self.fit is not None and self.fit.reduced_chi2 is not None and self.fit.reduced_chi2 <= LARGEST_HEALTHY_CHI2

    @property
    def words(self) -> str:
        """The terms in plain words."""
        return " and ".join(term.words for term in self.terms)


def name_force(declared: Fit, answer: Fit, effects: tuple[str, ...], catalog: Mapping[str, type[Effect]] = CATALOG) -> NamedForce:
    """Look at the force that is missing, name simple terms, and fit them in the response, not only in the equation of motion.

    First beside the model as declared: effects that were added in vain distort what is left. If that is not enough, beside the
    answer. **Arguments:** ``declared``: fit of the values declared uncertain; ``answer``: with the ``effects`` added.
    **Returns** the better of both; without terms, beside the answer, where neither does better than the answer does without.
    """
    first = _named(declared, (), catalog)
    if first.enough:
        return first
    second = _named(answer, effects, catalog) if effects else first
    best = min((first, second), key=lambda named: math.inf if named.fit is None else _score(named.fit))
    if best.fit is None or _score(best.fit) >= _score(answer):
        return NamedForce(second.force, (), effects, None)
    return best


def simpler_force(declared: Fit, answer: Fit, effects: tuple[str, ...], catalog: Mapping[str, type[Effect]] = CATALOG) -> NamedForce | None:
    """Fewer terms than the answer has effects that explain as much, if there are: the answer is then one of two.

    **Arguments:** as for `name_force`.
    """
    found = _named(declared, (), catalog, most=len(effects) - 1)
    return found if found.enough and found.fit is not None and _score(found.fit) < _score(answer) else None


def _score(fitted: Fit) -> float:
    """Schwarz' criterion of what a fit leaves, for noise of unknown size (Schwarz 1978, Ann. Statist. 6:461-464)."""
    m = fitted.stage.measurement
    numbers = 2 * int(m.present.sum())
    return numbers * math.log(max(m.rms_of(fitted.predicted), 1e-15) ** 2) + len(fitted.estimates) * math.log(numbers)


def _named(found: Fit, beside: tuple[str, ...], catalog: Mapping[str, type[Effect]], most: int | None = None) -> NamedForce:
    """**Arguments:** ``most``: terms, if there are more, or if they leave much of the force, nothing is fitted."""
    every, model, measurement = dict(catalog) | TERMS, found.model, found.stage.measurement
    force = missing_force(model.with_orders(measurement.orders), measurement)
    terms = tuple(t for t in regress(force, every, fitted=beside) if t.term not in model)
    if not terms or (most is not None and (len(terms) > most or max(t.share for t in terms) < LARGE_SHARE)):
        return NamedForce(force, (), beside, None)
    full = model.plus([every[t.term](**t.coefficients) for t in terms])
    names = tuple(name for name in (*beside, *(t.term for t in terms)) if name in full)
    return NamedForce(force, terms, beside, fit(full, measurement, free=names))
