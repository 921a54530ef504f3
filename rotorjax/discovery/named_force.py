"""None of these: the force that is missing, the simple terms that it looks like, and how well they
do in the response.
"""

import dataclasses
import itertools
import math
from collections.abc import Mapping, Sequence

from rotorjax.data.measurement import Measurement
from rotorjax.discovery.fit import Fit, Trial, cross_validated, fit_trials
from rotorjax.discovery.force_shapes import Reach, with_value
from rotorjax.discovery.force_terms import LEAST_GAIN, Candidate, answers, other_powers, unseen
from rotorjax.discovery.inferred_noise import Ahead
from rotorjax.discovery.missing_force import MissingForce, missing_force
from rotorjax.effects import CATALOG
from rotorjax.effects.delayed_force import DELAY
from rotorjax.effects.power_terms import OPENED, PowerTerm, with_power_open
from rotorjax.effects.terms import NAMED, TERMS
from rotorjax.inference.noise import LARGEST_HEALTHY_CHI2, NO_SCATTER, Noise, whitened_residual
from rotorjax.model.contract import Effect, RestoringEffect
from rotorjax.model.model import Model

LARGE_SHARE = 0.8
"""Share of what the answer of the regression takes away that a term must have by itself to be tried where that answer
has more terms than are wanted.
"""
SAME_POWER = 0.1
"""Difference up to which two powers are one."""
UNSEEN = 30.0
"""Prior scales allowed for a term of which the regression sees nothing."""
FIXED = {name: cls for name, cls in TERMS.items() if not issubclass(cls, PowerTerm)}
"""Terms without a power that is fitted: what is left beside an answer is held against that by itself (`other_power`).
"""
LINEAR = {name: cls for name, cls in FIXED.items() if not issubclass(cls, RestoringEffect)}
"""Those of which fits take a moment only."""
FITTED = 7
"""Answers of the regression that are fitted in the response."""


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
    rivals: tuple[str, ...] = ()
    """Words for other terms that do nearly as well there."""

    def __repr__(self) -> str:
        return f"NamedForce({self.words or 'no simple shape'}; {self.fit!r})"

    def validated(self) -> "NamedForce":
        """With the error of the fit on data left out of it."""
        return self if self.fit is None else dataclasses.replace(self, fit=cross_validated(self.fit))

    @property
    def enough(self) -> bool:
        """Whether the terms leave no more than the noise of the table."""
        return self.fit is not None and _enough(self.fit)

    @property
    def words(self) -> str:
        """The terms in plain words, gaps, powers and delays as fitted."""
        return _words(self.terms, self.fit)


def _words(terms: tuple[Candidate, ...], fitted: Fit | None) -> str:
    values = {} if fitted is None else {(e.entry.effect, e.entry.label): e.value for e in fitted.estimates}
    fitted_values = [None if term.scanned is None else values.get((term.term, term.scanned)) for term in terms]
    return " and ".join(
        with_value(term.term, term.plain, value) if value is not None else term.words
        for term, value in zip(terms, fitted_values, strict=True)
    )


def name_force(
    declared: Fit, answer: Fit, effects: tuple[str, ...], catalog: Mapping[str, type[Effect]] = CATALOG
) -> NamedForce:
    """Look at the force that is missing, name simple terms, and fit them in the response, not only in the equation of
    motion.

    First beside the model as declared: effects that were added in vain distort what is left. If that is not enough,
    beside the answer. **Arguments:** ``declared``: fit of the values declared uncertain; ``answer``: with the
    ``effects`` added.
    **Returns** the better of both; without terms, beside the answer, where neither does better than the answer does
    without.
    """
    first = _named(declared, (), catalog)
    if first.enough:
        return first.validated()
    second = _named(answer, effects, catalog) if effects else first
    best = min((first, second), key=lambda named: math.inf if named.fit is None else _score(named.fit))
    if best.fit is None or _score(best.fit) >= _score(answer) or _rms_left(best.fit) >= _rms_left(answer):
        return NamedForce(second.force, (), effects, None)
    return best.validated()


def other_force(
    declared: Fit,
    answer: Fit,
    effects: tuple[str, ...],
    catalog: Mapping[str, type[Effect]] = CATALOG,
    *,
    doubtful: bool = False,
) -> NamedForce | None:
    """Terms that explain as much as an answer of named effects, if there are: the answer is then one of two.

    In the place of several effects fewer, a term among them, or as many that do much better; in the place of one a
    single term that does much better: a nonlinear one only where something is left beside the answer that a term would
    take away, or where the answer is ``doubtful`` by itself. Where the noise is unknown also in the place of none, and
    whatever is left.
    **Arguments:** as for `name_force`.
    """
    alone, unknown = len(effects) <= 1, declared.stage.measurement.sigma is None
    terms = TERMS if not alone else FIXED if doubtful or _likely(answer, {}, 1, FIXED)[1] else LINEAR
    ahead = Ahead(first_cost=answer.end.cost, holds=True) if answer.misfit == 0.0 else Ahead()
    found = _named(declared, (), {} if alone else catalog, most=max(1, len(effects)), ahead=ahead, terms=terms)
    better = _score(answer) - (LEAST_GAIN if len(found.terms) >= len(effects) else 0.0)
    if found.fit is None or not (found.enough or unknown):
        return None
    return found.validated() if _score(found.fit) < better else None


def other_power(declared: Fit, answer: Fit, effects: tuple[str, ...]) -> NamedForce | None:
    """A force of an answer with another power of displacement or of the speed of vibration: a cubic spring may be one
    of the fifth power.

    In its place beside the other effects if it does much better there, fitted where the motion as measured asks for
    it; or in the place of all nonlinear forces if it does better than several. **Arguments:** as for `name_force`.
    """
    measurement, model = answer.stage.measurement, declared.model
    own = [e for e in answer.model.effects if e.name in effects]
    forces = [e for e in own if isinstance(e, RestoringEffect)]
    laws = [e for e in forces if e.name in OPENED and OPENED[e.name][0].name not in answer.model]
    left = _lacking(answer, answer.model)
    if left.balance is None or not laws:
        return None
    asked = other_powers(left, {e.entry.effect for e in answer.estimates})
    replaced = [(law, [law]) for law in laws if OPENED[law.name][0].name in asked]
    replaced += [(law, forces) for law in laws if len(forces) > 1]
    tried = [_with_power_open(model, own, law, gone) for law, gone in replaced]
    if not tried:
        return None
    terms = [(unseen(trial.names[-1]),) for trial in tried]
    fits = fit_trials(tried, _unprejudiced(measurement, model, terms, NAMED), answer.stage.budget)
    scores = {
        k: _score(fitted) + (LEAST_GAIN if len(tried[k].names) == len(effects) else 0.0)
        for k, fitted in enumerate(fits)
        if _believable(fitted)
        and (measurement.sigma is None or _enough(fitted))
        and _means_something(terms[k][0], fitted, left.reach)
    }
    best = min(scores, key=lambda k: scores[k], default=None)
    if best is None or scores[best] >= _score(answer):
        return None
    *beside, term = tried[best].names
    lacking = _lacking(fits[best], fits[best].model.without(term))
    return NamedForce(lacking, terms[best], tuple(beside), fits[best]).validated()


def _with_power_open(model: Model, own: list[Effect], law: RestoringEffect, gone: Sequence[Effect]) -> Trial:
    """The force of an effect with its power open in the place of some effects of an answer, beside the others."""
    others, term = [e for e in own if e not in gone], with_power_open(law, model.rotor)
    return Trial(model.plus([*others, term]), (*(e.name for e in others), term.name), near=True)


def _rms_left(fitted: Fit) -> float:
    """Root mean square of what a fit leaves [m]."""
    return fitted.stage.measurement.rms_of(fitted.predicted)


def _lacking(fitted: Fit, model: Model) -> MissingForce:
    """What a model lacks of the force, its noise that of a fit where it is not known."""
    measurement = fitted.stage.measurement
    allowance = fitted.misfit if measurement.sigma is None else 0.0
    return missing_force(model.with_orders(measurement.orders), measurement, allowance)


def _score(fitted: Fit) -> float:
    """Schwarz' criterion of what a fit leaves, for noise of unknown size (Schwarz 1978, Ann. Statist. 6:461-464)."""
    return _left(fitted, len(fitted.estimates))


def _left(fitted: Fit, counted: int) -> float:
    """What a fit leaves, in standard errors where those are known, with a price for each of what is counted: parameters
    in Schwarz' criterion.
    """
    m = fitted.stage.measurement
    numbers = 2 * int(m.present.sum())
    if m.sigma is None:
        left = m.rms_of(fitted.predicted) ** 2
    else:
        errors = whitened_residual(m, fitted.model, fitted.residual, Noise(0.0, fitted.scatter or NO_SCATTER))
        left = float(errors @ errors)
    return numbers * math.log(max(left, 1e-30)) + counted * math.log(numbers)


def _named(
    found: Fit,
    beside: tuple[str, ...],
    catalog: Mapping[str, type[Effect]],
    most: int | None = None,
    ahead: Ahead | None = None,
    terms: Mapping[str, type[Effect]] = TERMS,
) -> NamedForce:
    """The likeliest answer of the regression in the response, where the motion need not be known at orders that were
    not measured.

    **Arguments:** ``most`` terms and effects of the catalogue, one of the terms among them: where the regression wants
    more, only those that are most of the force by themselves are tried; ``ahead``: what they have to reach; ``terms``
    beside the ``catalog``.
    """
    every, model, measurement = dict(catalog) | TERMS, found.model, found.stage.measurement
    force, likely = _likely(found, catalog, FITTED, terms)
    if most is not None and likely:
        least = LARGE_SHARE * sum(t.share for t in likely[0]) if len(likely[0]) > most else 0.0
        likely = [several for several in likely if len(several) <= most and max(t.share for t in several) >= least]
        likely = [several for several in likely if any(t.term not in catalog for t in several)]
    if not likely:
        return NamedForce(force, (), beside, None)
    likely = [each for several in likely for each in _with_near_delays(model, several)]
    tried = [_trial(model, several, beside, every) for several in likely]
    fits = fit_trials(tried, _unprejudiced(measurement, model, likely, every), found.stage.budget, ahead)
    scores = {
        k: _score(fitted)
        for k, fitted in enumerate(fits)
        if _believable(fitted) and all(_means_something(term, fitted, force.reach) for term in likely[k])
    }
    if not scores:
        return NamedForce(force, (), beside, None)
    ranked = sorted(scores, key=lambda k: (not _enough(fits[k]), len(likely[k]), scores[k]))
    best = next(k for k in ranked if scores[k] < min(scores.values()) + LEAST_GAIN)
    # What a rival has to fit, a gap for instance, does not exclude it: only what it leaves, at a price for each term.
    left = {k: _left(fits[k], len(likely[k])) for k in scores}
    rivals = [
        k
        for k in ranked
        if k != best and (scores[k] < min(scores.values()) + LEAST_GAIN or left[k] < left[best] + LEAST_GAIN)
    ]
    words = (
        _words(likely[k], fits[k]) for k in rivals if not {t.term for t in likely[best]} <= {t.term for t in likely[k]}
    )
    return NamedForce(force, likely[best], beside, fits[best], tuple(words))


def _believable(fitted: Fit) -> bool:
    """Whether a steady motion was found, and nothing speaks against the values."""
    return fitted.end.exact and math.isfinite(fitted.end.cost) and not fitted.objections(fitted.free)


def _means_something(term: Candidate, fitted: Fit, reach: Reach) -> bool:
    """Whether the rotor came to the end of a gap, a power is none of which the catalogue has an effect, and a delay
    none that may be zero.
    """
    if term.scanned is None:
        return True
    found, cls = fitted.estimate(term.term, term.scanned), TERMS.get(term.term)
    if cls is not None and issubclass(cls, PowerTerm):
        least = max(SAME_POWER, fitted.quantile * found.standard_error)
        return all(abs(found.value - usual) > least for usual in cls.usual)
    if term.scanned == DELAY:
        return found.value > fitted.quantile * found.standard_error
    return reached(term.term, found.value, reach)


def reached(term: str, inverse_gap: float, reach: Reach) -> bool:
    """Whether the rotor came to the end of a gap, on a side that the term may have: else it is not what was seen.

    **Arguments:** ``inverse_gap`` [1/m].
    """
    cls = TERMS.get(term)
    axis = None if cls is None else cls().axis()
    largest = reach.radius if axis is None else reach[axis]
    sides = (1.0,) if cls is None else cls.sides
    return math.copysign(1.0, inverse_gap) in sides and abs(inverse_gap) * largest > 1.0


def _enough(fitted: Fit) -> bool:
    return fitted.reduced_chi2 is not None and fitted.reduced_chi2 <= LARGEST_HEALTHY_CHI2


def _unprejudiced(
    measurement: Measurement, model: Model, tried: list[tuple[Candidate, ...]], every: Mapping[str, type[Effect]]
) -> Measurement:
    """With prior scales of terms as wide as what the regression found, and wide where it could try nothing: the data
    alone are to choose.
    """
    priors = {name: dict(scales) for name, scales in measurement.knowledge.priors.items()}
    for term in itertools.chain(*tried):
        for declared in every[term.term].parameters():
            own, scale = priors.setdefault(term.term, {}), declared.prior_scale(model.rotor)
            found = abs(term.coefficients.get(declared.name, 0.0)) if term.coefficients else UNSEEN * scale
            own[declared.name] = max(own.get(declared.name, scale), found)
    return dataclasses.replace(measurement, knowledge=dataclasses.replace(measurement.knowledge, priors=priors))


def _likely(
    found: Fit, catalog: Mapping[str, type[Effect]], most: int, terms: Mapping[str, type[Effect]] = TERMS
) -> tuple[MissingForce, list[tuple[Candidate, ...]]]:
    """The force that a fit lacks, and the answers of the regression, all that was fitted giving way."""
    model, force = found.model, _lacking(found, found.model)
    fitted = {e.entry.effect for e in found.estimates}
    tried = (
        tuple(t for t in terms if t.term not in model)
        for terms in answers(force, dict(catalog) | dict(terms), fitted=fitted, most=most)
    )
    return force, [terms for terms in tried if terms]


def _with_near_delays(model: Model, terms: tuple[Candidate, ...]) -> list[tuple[Candidate, ...]]:
    """The same terms, and where one follows the motion late, with delays half a natural period and a whole one off: at
    the natural frequency the force is the same, if the sign changes with every half, so that each has an optimum.
    """
    half = math.pi * model.rotor.quantities()["period"]
    found = [terms]
    for place, term in enumerate(terms):
        if term.scanned != DELAY or not term.seen:
            continue
        for halves in (-2, -1, 1, 2):
            values = {
                name: value + halves * half if name == DELAY else (-1.0) ** halves * value
                for name, value in term.coefficients.items()
            }
            if values[DELAY] > 0.0:
                other = dataclasses.replace(term, coefficients=values)
                found.append((*terms[:place], other, *terms[place + 1 :]))
    return found


def _trial(
    model: Model, terms: tuple[Candidate, ...], beside: tuple[str, ...], every: Mapping[str, type[Effect]]
) -> Trial:
    """A model with terms, and what of it is to be fitted: from the values of the regression, if it saw all of them."""
    full = model.plus([every[t.term](**t.coefficients) for t in terms])
    return Trial(
        full,
        tuple(name for name in (*beside, *(t.term for t in terms)) if name in full),
        all(t.seen for t in terms),
    )
