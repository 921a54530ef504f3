"""Fit the free parameters of a model's effects to a measurement: Levenberg-Marquardt from the declared starts."""

import dataclasses
import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Complex, Float
from scipy.special import stdtrit

from rotorjax.arrays import require_float64
from rotorjax.data.measurement import Measurement
from rotorjax.effects import CATALOG
from rotorjax.effects.terms import TERMS
from rotorjax.errors import InputError
from rotorjax.inference.budget import Budget
from rotorjax.inference.data import Data, declared_starts, make_data, make_folds, residual_vectors
from rotorjax.inference.descent import HOPELESS, End, Start, best_of, descend, distinct_of, starts_at
from rotorjax.inference.estimates import (
    NORMAL_QUANTILE,
    Estimate,
    estimates_of,
    independent_parts,
    robust_covariance,
)
from rotorjax.inference.manner import CONVERGED, NOT_FINITE, RESULT_TEXT
from rotorjax.inference.noise import (
    LEAST_NOISE,
    MOST_ROUNDS,
    NO_NOISE,
    NO_SCATTER,
    NOISE_FLOOR,
    SAME_MISFIT,
    Noise,
    RunScatter,
    misfit_of,
    reduced_chi2,
    run_floor,
)
from rotorjax.inference.space import Space, make_space, with_company
from rotorjax.model.contract import Effect
from rotorjax.model.model import Model
from rotorjax.shown import Shown
from rotorjax.units import MICROMETRE

NOT_STEADY = (
    "no steady motion was found with these values, so that the prediction is only to first order along the measured "
    "motion"
)
"""What a fit says whose forces that depend on motion were laid along the measured motion and no further."""


@dataclasses.dataclass(frozen=True)
class Fit(Shown):
    """A fitted model, its parameters with standard errors, and how well it holds on data that it did not see."""

    model: Model
    """The fitted model: hand it to `compare`, `response`, or write it to a rig file."""
    estimates: tuple[Estimate, ...]
    predicted: Complex[np.ndarray, "case probe order"]
    """Its prediction of the measured vectors [m]."""
    result: str
    converged: bool
    steps: int
    reduced_chi2: float | None
    """Squared residual in standard errors per degree of freedom; none where the noise had to be inferred."""
    held_out_rms: float | None
    """Root mean square |residual| of every fold, predicted without it [m]."""
    held_out_reason: str
    run_scatter: RunScatter
    """Random unbalance per run that would account for what is left."""
    misfit: float
    """Standard error that had to be added to the table's, per component, to account for what is left [m]."""
    free: tuple[str, ...]
    """Names of the effects that were fitted."""
    quantile: float
    """Standard errors in half a 95 % interval: Student's, by the number of clusters, where the misfit rules."""
    covariance: Float[np.ndarray, "param param"]
    """Posterior covariance of the unknowns."""
    stage: "Stage"
    end: End

    def __repr__(self) -> str:
        values = "; ".join(f"{e.entry.key} = {e.value:.4g} ± {e.standard_error:.2g}" for e in self.estimates)
        held = "" if self.held_out_rms is None else f", {self.held_out_rms / MICROMETRE:.3g} µm on data held out"
        return (
            f"Fit({values or 'nothing fitted'}; {self.stage.measurement.rms_of(self.predicted) / MICROMETRE:.3g} µm "
            f"rms{held})"
        )

    def estimate(self, effect: str, label: str) -> Estimate:
        """The estimate of one entry."""
        return next(e for e in self.estimates if (e.entry.effect, e.entry.label) == (effect, label))

    def objections(self, names: Iterable[str]) -> tuple[str, ...]:
        """What speaks against the values of these effects, each by name."""
        said = ((e.name, e.objection(self.model.rotor)) for e in self.model.effects if e.name in set(names))
        spoken = tuple(f"{name} {words}" for name, words in said if words is not None)
        return spoken if self.end.exact else (*spoken, NOT_STEADY)


class Stage(NamedTuple):
    """What is fitted to what."""

    space: Space
    measurement: Measurement
    names: tuple[str, ...]
    free: Bool[np.ndarray, "param"]
    keep: frozenset[str]
    budget: Budget


def fit(model: Model, measurement: Measurement, *, free: tuple[str, ...] | None = None, held_out: bool = True) -> Fit:
    """Fit the parameters of a model's effects, with whatever the user declared uncertain.

    Minimises Σ |(z - z_model)/σ|² - 2 ln p(u), u the parameters in units of their prior scale (maximum a posteriori; p
    is normal, with long tails for the size of a force that depends on motion: `rotorjax.inference.prior`), by
    Levenberg-Marquardt from every declared start; the best descent wins. Standard errors are the larger of the
    posterior's and of the cluster-robust ones over runs (Liang, Zeger 1986, Biometrika 73:13-22), so that scatter
    between runs widens them; with fewer than four runs the clusters are single cases, which scatter between runs
    escapes. σ² is that of the table plus what the misfit demands: see `Fit.misfit`.

    **Arguments:** ``model``; ``measurement``; ``free``: names of the effects to fit, by default all that the model
    has, the others keeping their values; ``held_out``: cross-validate over runs or speeds.
    **Returns** a `Fit`, whose ``converged`` and ``result`` say how it ended.
    **Errors.** ``ValueError`` in single precision, or for a name that the model lacks; `InputError` where nothing is
    finite.
    """
    names = tuple(e.name for e in model.effects) if free is None else free
    if missing := [name for name in names if name not in model]:
        raise ValueError(f"the model has no {missing[0]!r} to fit; add it first: model + effect")
    fitted = _finite(_fit(_stage(model, model, measurement, names, frozenset())))
    return cross_validated(fitted) if held_out else fitted


class Trial(NamedTuple):
    """A model to be fitted beside others."""

    model: Model
    names: tuple[str, ...]
    """The effects to fit, the others keeping their values."""
    near: bool
    """Whether its values are near enough to begin with them alone."""


def fit_trials(trials: Sequence[Trial], measurement: Measurement, budget: Budget) -> list[Fit]:
    """Fit models that may have different effects, compiled once, under one ``budget``.

    One that does worse by far than another is left at that.
    **Returns** one `Fit` each, without held-out error. Errors as for `fit`.
    """
    effects = {e.name: e for trial in trials for e in trial.model.effects}
    everything = trials[0].model.plus([e for name, e in effects.items() if name not in trials[0].model])
    fits, ahead = [], _Ahead()
    for model, names, near in trials:
        stage = _stage(model, everything, measurement, names, frozenset())._replace(budget=budget)
        start = starts_at(np.where(stage.free, stage.space.given_unknowns(), 0.0)[None]) if near else None
        rounds = _rounds(stage, start, ahead)
        best = _likeliest(rounds)
        if best.best.exact:
            ahead = _Ahead(
                min(ahead.minus_log_posterior, best.minus_log_posterior), min(ahead.first_cost, rounds[0].first_cost)
            )
        fits.append(summarise(stage, best, None, "not asked for"))
    return fits


class _Ahead(NamedTuple):
    """What other models reached on the same data."""

    minus_log_posterior: float = math.inf
    first_cost: float = math.inf
    """As in `Round`, of rounds that begin with no allowance."""

    def hopeless_cost(self, measurement: Measurement) -> float:
        """Cost under the table's noise alone with which a fit does not go on; where that noise is a misfit, only the
        ratio of costs counts.
        """
        if measurement.sigma is None:
            return math.inf
        numbers = max(1, np.count_nonzero(measurement.weights(0.0)))
        return max(self.first_cost + HOPELESS, self.first_cost * math.exp(2.0 * HOPELESS / numbers))


def fit_steps(
    model: Model, additions: list[Effect], measurement: Measurement, *, fixed: frozenset[str] = frozenset()
) -> list[Fit]:
    """Fit a model as effects are added one after the other: the error step by step, compiled once.

    **Arguments:** ``model`` to begin with, its own effects keeping their values; ``additions``: effects in the order
    of adding; ``fixed``: entries of theirs ("probe_angle.angle_rad.X") that keep the value with which they come.
    **Returns** one `Fit` per step, the first without any addition. Errors as for `fit`.
    """
    everything = model.plus(additions)
    fits = []
    for count in range(len(additions) + 1):
        names = tuple(dict.fromkeys(effect.name for effect in additions[:count]))
        stage = _stage(model.plus(additions[:count]), everything, measurement, names, fixed)
        fits.append(cross_validated(_finite(_fit(stage))))
    return fits


def _finite(fitted: Fit) -> Fit:
    """The same; `InputError` where no start has a finite cost."""
    if not math.isfinite(fitted.end.cost):
        raise InputError(f"{', '.join(fitted.free) or 'the model as declared'}: {RESULT_TEXT[NOT_FINITE]}")
    return fitted


def _stage(
    model: Model, everything: Model, measurement: Measurement, names: tuple[str, ...], fixed: frozenset[str]
) -> Stage:
    """The model in the company, at their null, of all that might be freed."""
    require_float64("fit")
    uncertain = {u.effect for u in measurement.knowledge.uncertain}
    own = {e.name: type(e) for e in everything.effects}
    # The whole catalogue, and all terms where there is one: the compiled code is then the same whatever is fitted.
    classes = CATALOG | (TERMS if own.keys() & TERMS.keys() else {}) | own
    full = with_company(model.with_orders(measurement.orders), classes, classes)
    space = make_space(full, measurement.knowledge)
    keep = frozenset({e.name for e in model.effects} | uncertain)
    return Stage(space, measurement, names, space.free(list(names), fixed), keep, Budget())


def cross_validated(fitted: Fit) -> Fit:
    """A fit with its held-out error: groups of runs, or of speeds, left out in turn."""
    stage, end = fitted.stage, fitted.end
    data = make_data(stage.measurement, stage.space.model_at(end.point), Noise(fitted.misfit))
    folds, reason = make_folds(stage.measurement, np.einsum("cmp,cmq->cpq", end.local.slopes, end.local.slopes))
    ends = (
        descend(stage.space, data, [Start.at(end)] * len(folds), stage.free, ~folds, budget=stage.budget)
        if len(folds)
        else []
    )
    return dataclasses.replace(fitted, held_out_rms=_held_out(data, ends, folds), held_out_reason=reason)


def _fit(stage: Stage) -> Fit:
    return summarise(stage, _likeliest(_rounds(stage)), None, "not asked for")


def _rounds(stage: Stage, own: list[Start] | None = None, ahead: _Ahead | None = None) -> "list[Round]":
    """A fit within the table's noise, or else some that start from it and from a wide allowance for misfit.

    Where a model leaves a hundred standard errors, weighing the data by those would let them drag weakly determined
    parameters anywhere; the allowance, one isotropic standard error added to the table's, grows or shrinks until it
    equals the misfit found, and vanishes where the model holds. A wide one alone can settle where the prior rules and
    nothing was fitted; a narrow one alone can run into a corner first: so both, compared by posterior density.
    What is behind other models by far ends there.
    **Arguments:** ``own``: starts in the place of those declared; ``ahead``: what other models reached.
    """
    measurement, ahead = stage.measurement, ahead or _Ahead()
    starts = own or starts_at(declared_starts(stage.space, stage.free, measurement.reach))
    most = max(measurement.rms, LEAST_NOISE)
    floor = 0.0 if measurement.sigma is not None else max(NOISE_FLOOR * measurement.rms, LEAST_NOISE)
    hopeless = ahead.hopeless_cost(measurement)
    now = _settle(stage, floor, starts, hopeless)
    # The noise given is known: a fit that holds within it needs no comparison with one that had to widen it.
    if now.settled and now.misfit == 0.0:
        return [now]
    wide = _settle(stage, most, starts)
    if min(now.minus_log_posterior, wide.minus_log_posterior) > ahead.minus_log_posterior + HOPELESS:
        return [now, wide]
    return [now, wide, _settle(stage, floor, [Start.at(wide.best)], hopeless)]


def _likeliest(rounds: "list[Round]") -> "Round":
    return min(rounds, key=lambda one: (not math.isfinite(one.best.cost), one.misfit > 0.0, one.minus_log_posterior))


class Round(NamedTuple):
    """One fit under one allowance for misfit, and the misfit that it found."""

    allowance: float
    data: Data
    best: End
    starts: list[Start]
    """Where the descents ended: to go on from."""
    misfit: float
    first_cost: float
    """Cost of the best fit under the allowance that the rounds began with, if its motions balance."""

    @property
    def settled(self) -> bool:
        """Whether the misfit found is the one allowed for."""
        return abs(self.misfit - self.allowance) <= SAME_MISFIT * self.allowance

    @property
    def minus_log_posterior(self) -> float:
        """Up to a constant; the noise's own normalisation counts, so that allowances can be compared."""
        weight = np.asarray(self.data.weight)
        return self.best.cost - float(np.sum(np.log(weight[weight > 0.0])))


def _settle(stage: Stage, allowance: float, starts: list[Start], hopeless: float = math.inf) -> Round:
    """Rounds until the allowance equals the misfit found. **Arguments:** ``hopeless``: cost with which the first of
    them does not go on.
    """
    now = _round(stage, allowance, starts, stage.space.model, hopeless)
    for _ in range(MOST_ROUNDS - 1):
        if now.settled or not math.isfinite(now.best.cost):
            break
        now = _round(stage, now.misfit, now.starts, stage.space.model_at(now.best.point))._replace(
            first_cost=now.first_cost
        )
    return now


def _round(stage: Stage, allowance: float, starts: list[Start], model: Model, hopeless: float = math.inf) -> Round:
    data = make_data(stage.measurement, model, Noise(allowance))
    every = np.ones((len(starts), len(stage.measurement.run)), bool)
    ends = descend(stage.space, data, starts, stage.free, every, budget=stage.budget, hopeless=hopeless)
    best = best_of(ends)
    # Of many starts a few optima are left.
    ended = [Start.at(end) for end in distinct_of(ends)]
    ended = ended or [
        Start.at(end) if math.isfinite(end.cost) else start for end, start in zip(ends, starts, strict=True)
    ]
    left = residual_vectors(best.local.error, data)
    misfit = misfit_of(stage.measurement, stage.space.model_at(best.point), left, int(stage.free.sum()), NO_NOISE)
    return Round(allowance, data, best, ended, misfit, best.cost if best.exact else math.inf)


def summarise(
    stage: Stage, now: Round, held_out: float | None, reason: str, *, scatter: RunScatter | None = None
) -> Fit:
    """A round as people want it. ``scatter`` between runs, where it was inferred before; it then counts in the
    chi-square.
    """
    space, measurement, free = stage.space, stage.measurement, stage.free
    best, data = now.best, now.data
    clusters = independent_parts(best.local, data)
    covariance = robust_covariance(best, clusters)
    quantile = (
        float(stdtrit(max(len(clusters) - 1, 1), 0.975))
        if now.allowance > 0.0 and measurement.sigma is not None
        else NORMAL_QUANTILE
    )
    fitted = space.model_at(best.point)
    left = residual_vectors(best.local.error, data)
    return Fit(
        model=_kept(fitted, stage),
        estimates=estimates_of(space, best, covariance, free),
        predicted=best.shown,
        result=RESULT_TEXT[best.result] if best.exact else NOT_STEADY,
        converged=best.result == CONVERGED and now.settled and best.exact,
        steps=best.steps,
        reduced_chi2=reduced_chi2(
            measurement, fitted, left, fitted=int(free.sum()), noise=Noise(0.0, scatter or NO_SCATTER)
        ),
        held_out_rms=held_out,
        held_out_reason=reason,
        run_scatter=run_floor(measurement, fitted, -left).scatter if scatter is None else scatter,
        misfit=now.allowance,
        free=stage.names,
        quantile=quantile,
        covariance=covariance,
        stage=stage,
        end=best,
    )


def _held_out(data: Data, again: list[End], folds: np.ndarray) -> float | None:
    """Root mean square |residual| of the cells of every fold under the fit to the other folds [m]."""
    squares, cells = 0.0, 0
    for fold, end in zip(folds, again, strict=True):
        squares += float(np.sum(np.abs(residual_vectors(end.local.error, data)[fold]) ** 2))
        cells += int(np.count_nonzero(data.weight[fold, :, :, 0]))
    return math.sqrt(squares / cells) if cells else None


def _kept(fitted: Model, stage: Stage) -> Model:
    """The fitted model without effects that were at hand for comparison only."""
    return fitted.without(*(e.name for e in fitted.effects if e.name not in stage.keep))
