"""Fit the free parameters of a model's effects to a measurement: Levenberg-Marquardt from the declared starts."""

import dataclasses
import math
from collections.abc import Iterable, Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float
from scipy.special import stdtrit

from rotorjax.arrays import require_float64
from rotorjax.data.declarations import Mistake
from rotorjax.data.measurement import Measurement
from rotorjax.data.names import one_of, several
from rotorjax.data.odd_runs import ABOUT_WEIGHTS, as_other_weights
from rotorjax.data.pairing import paired
from rotorjax.data.wrong_readings import WRONG, Cell, cells_of
from rotorjax.discovery.cancelling import cancelling
from rotorjax.discovery.inferred_noise import Ahead, Round, Stage, fitted_rounds, likeliest
from rotorjax.discovery.own_effects import check_own_effects
from rotorjax.effects import CATALOG
from rotorjax.effects.of_one_run import RunSpeed
from rotorjax.effects.reading import ChainGain, PhaseReferenceOffset
from rotorjax.effects.structure import SpeedDependentStiffness
from rotorjax.effects.terms import TERMS
from rotorjax.errors import InputError
from rotorjax.inference.budget import Budget
from rotorjax.inference.data import Data, make_data, make_folds, residual_vectors
from rotorjax.inference.descent import End, Start, descend, starts_at
from rotorjax.inference.descent_settings import CONVERGED, NOT_FINITE, RESULT_TEXT
from rotorjax.inference.estimates import (
    NORMAL_QUANTILE,
    Estimate,
    estimates_of,
    independent_parts,
    robust_covariance,
)
from rotorjax.inference.noise import (
    NO_SCATTER,
    Noise,
    RunScatter,
    reduced_chi2,
    run_floor,
)
from rotorjax.inference.space import make_space
from rotorjax.inference.stable import unstable_speeds
from rotorjax.model.contract import AbstractRotor, Effect, ExcitationEffect, RestoringEffect
from rotorjax.model.model import Model
from rotorjax.physics.stability import SELF_EXCITING
from rotorjax.shown import Shown
from rotorjax.units import MICROMETRE

GAIN_OF_A_CHAIN = 0.1
"""Largest error of a gain that scale factors may have beside another unit of amplitude."""
OF_THE_CHAIN = frozenset({ChainGain.name, PhaseReferenceOffset.name})
"""Effects that change all that is read alike."""
MOST_SCATTER = 0.15
"""Share of what was measured by which runs may differ from one another for what is random in mounting weights."""
RUNS_DIFFER = (
    "the runs differ from one another by {} % of what was measured: check their weights, phase reference and amplitudes"
)
NO_UNIT = (
    f"readings are off by a factor that is not that of a unit: {ABOUT_WEIGHTS} that are off by it would do the same "
    "(their mass for g mm?), and the correction with them"
)
"""What is said of a larger one."""
SEVERAL_WRONG = (
    "several readings would have to be wrong: measure them again, as a force that acts at few speeds only may do what "
    "they show"
)
"""What is said where more than one reading is called wrong."""
LARGEST_WRONG = (
    "the reading called wrong is of the largest vibration there, where a nonlinear force of another form would show "
    "first: measure it again"
)
"""What is said of such a reading beside a nonlinear force."""
UNSETTLED = "its values and the error that it leaves, which is taken for noise, still change one another"
ALIKE = 0.3
"""Relative difference along x and y up to which an error may be the same along both."""
AS_MASS = (
    "a modal mass that is another along x than along y, as where pedestals move along, does the same at 1X as a "
    "stiffness that changes with the square of speed: another order would tell"
)
"""What is said of such a stiffness where only 1X was measured."""
AS_STIFFNESS = (
    "a shaft or support that was stiffer or softer in that run (temperature, bolts, preload of bearings), by twice the "
    "percentage of its speeds, does nearly the same at 1X"
)
"""What is said where the speeds of one run are called other than stated."""
NOT_STEADY = (
    "no steady motion was found with these values, so that the prediction is only to first order along the measured "
    "motion"
)
"""What a fit says whose nonlinear forces were laid along the measured motion and no further."""


@dataclasses.dataclass(frozen=True, eq=False)
class Fit(Shown):
    """A fitted model, its parameters with standard errors, and how well it holds on data that it did not see."""

    model: Model
    """The fitted model: hand it to `compare`, `response`, or write it to a rig file."""
    estimates: tuple[Estimate, ...]
    predicted: Complex[np.ndarray, "case probe order"]
    """Its prediction of the measured vectors [m]."""
    result: str
    converged: bool
    reduced_chi2: float | None
    """Squared residual in standard errors per degree of freedom; none where the noise had to be inferred."""
    held_out_rms: float | None
    """Root mean square |residual| of every fold, predicted without it [m]."""
    held_out_reason: str
    residual: Complex[np.ndarray, "case probe order"]
    """Model minus measured [m], zero where nothing was measured."""
    scatter: RunScatter | None
    """Scatter between runs, where it was inferred before."""
    misfit: float
    """Standard error that had to be added to the table's, per component, to account for what is left [m]."""
    free: tuple[str, ...]
    """Names of the effects that were fitted."""
    quantile: float
    """Standard errors in half a 95 % interval: Student's, by the number of clusters, where the misfit rules."""
    covariance: Float[np.ndarray, "param param"]
    """Posterior covariance of the unknowns."""
    stage: Stage
    end: End

    def __repr__(self) -> str:
        values = "; ".join(f"{e.entry.key} = {e.value:.4g} ± {e.standard_error:.2g}" for e in self.estimates)
        held = "" if self.held_out_rms is None else f", {self.held_out_rms / MICROMETRE:.3g} µm on data held out"
        return (
            f"Fit({values or 'nothing fitted'}; {self.stage.measurement.rms_of(self.predicted) / MICROMETRE:.3g} µm "
            f"rms{held})"
        )

    @cached_property
    def run_scatter(self) -> RunScatter:
        """Random unbalance and bow per run that would account for what is left; none beside forces that depend on
        motion, which leave what looks like it.
        """
        if self.scatter is not None:
            return self.scatter
        if not self.stage.space.is_linear_at(self.end.point):
            return NO_SCATTER
        fitted = self.stage.space.model_at(self.end.point)
        return run_floor(self.stage.measurement, fitted, -self.residual).scatter

    def estimate(self, effect: str, label: str) -> Estimate:
        """The estimate of one entry. **Errors.** ``ValueError`` where it was not fitted."""
        by_key = {e.entry.key: e for e in self.estimates}
        return by_key[one_of(f"{effect}.{label}", by_key, "estimate")]

    def objections(self, names: Iterable[str], mistake: Mistake | None = None) -> tuple[str, ...]:
        """What speaks against the values of these effects, each by name. **Arguments:** ``mistake`` beside them."""
        own, orders = [e for e in self.model.effects if e.name in set(names)], self.stage.measurement.orders
        said = ((e.name, e.objection(self.model.rotor) or self._unstable(e.name)) for e in own)
        spoken = tuple(f"{name} {words}" for name, words in said if words is not None)
        if mistake is not None and mistake.of_amplitudes and any(_is_far_from_one(e) for e in own):
            spoken = (*spoken, NO_UNIT)
        chain = any(e.name in OF_THE_CHAIN for e in own) or (mistake is not None and mistake.of_amplitudes)
        if chain and (words := as_other_weights(self.model, self.stage.measurement)):
            spoken = (*spoken, words)
        if mistake is not None and mistake.kind == RunSpeed.name:
            spoken = (*spoken, AS_STIFFNESS)
        if any(isinstance(e, SpeedDependentStiffness) and _of_one_axis(e) for e in own) and set(orders) == {1.0}:
            spoken = (*spoken, AS_MASS)
        if mistake is not None and mistake.kind == WRONG:
            spoken = (*spoken, *self._doubts_of_readings(cells_of(mistake), own))
        exciting = [e.name for e in own if isinstance(e, ExcitationEffect)]
        if words := cancelling(self.end, self.stage.space, self.stage.measurement, exciting):
            spoken = (*spoken, words)
        left = self.stage.measurement.rms_of(self.predicted)
        if self.scatter is not None and left > MOST_SCATTER * self.stage.measurement.rms:
            share = 100.0 * left / self.stage.measurement.rms
            spoken = (*spoken, RUNS_DIFFER.format(f"{share:.0f}"))
        return spoken if self.end.exact else (*spoken, NOT_STEADY)

    def _doubts_of_readings(self, cells: tuple[Cell, ...], own: list[Effect]) -> list[str]:
        """What speaks against readings that are called wrong beside effects."""
        forces, size = any(isinstance(e, RestoringEffect) for e in own), np.abs(self.predicted)
        read = np.where(self.stage.measurement.present, size, 0.0)
        largest = any(size[cell] > read[:, cell[1], cell[2]].max() for cell in cells)
        return [*([SEVERAL_WRONG] if len(cells) > 1 else []), *([LARGEST_WRONG] if forces and largest else [])]

    def _unstable(self, name: str) -> str | None:
        """What an effect says against itself that makes the rotor unstable."""
        speeds = self.stage.measurement.steady_rpm()
        if name not in SELF_EXCITING or not (count := unstable_speeds(self.end, self.stage.space, speeds)):
            return None
        return f"makes the rotor unstable at {count} of the {len(speeds)} speeds at which a steady state was measured"


def _of_one_axis(effect: Effect) -> bool:
    along = [float(value) for value in effect.values()]
    return abs(along[0] - along[1]) > ALIKE * max(map(abs, along))


def _is_far_from_one(effect: Effect) -> bool:
    return isinstance(effect, ChainGain) and math.hypot(*map(float, effect.values())) > GAIN_OF_A_CHAIN


def fit(
    model: Model | AbstractRotor,
    measurement: Measurement,
    *,
    free: str | Iterable[str] | None = None,
    held_out: bool = True,
) -> Fit:
    """Fit the parameters of a model's effects, with whatever the user declared uncertain.

    Minimises Σ |(z - z_model)/σ|² - 2 ln p(u), u the parameters in units of their prior scale (maximum a posteriori; p
    is normal, with long tails for the size of a nonlinear force: `rotorjax.inference.prior`), by
    Levenberg-Marquardt from every declared start; the best descent wins. Standard errors are the larger of the
    posterior's and of the cluster-robust ones over runs (Liang, Zeger 1986, Biometrika 73:13-22), so that scatter
    between runs widens them; with fewer than four runs the clusters are single cases, which scatter between runs
    escapes. σ² is that of the table plus what the misfit demands: see `Fit.misfit`.

    **Arguments:** ``model``, or a rotor alone; ``measurement``; ``free``: names of the effects to fit, by default all
    that the model has, the others keeping their values; ``held_out``: cross-validate over runs or speeds.
    **Returns** a `Fit`, whose ``converged`` and ``result`` say how it ended.
    **Errors.** ``ValueError`` in single precision, for a name that the model lacks, or for an effect of one's own that
    breaks a rule of effects; `InputError` where nothing is finite.
    """
    full = paired(model, measurement)
    names = tuple(e.name for e in full.effects) if free is None else several(free)
    if missing := [name for name in names if name not in full]:
        raise ValueError(f"the model has no {missing[0]!r} to fit; add it first: model + effect")
    check_own_effects(full.with_orders(measurement.orders))
    fitted = _finite(_fit(_stage(full, full, measurement, names, frozenset())))
    return cross_validated(fitted) if held_out else fitted


class Trial(NamedTuple):
    """A model to be fitted beside others."""

    model: Model
    names: tuple[str, ...]
    """The effects to fit, the others keeping their values."""
    near: bool
    """Whether its values are near enough to begin with them alone."""


def fit_trials(
    trials: Sequence[Trial], measurement: Measurement, budget: Budget, ahead: Ahead | None = None
) -> list[Fit]:
    """Fit models that may have different effects, compiled once, under one ``budget``.

    One that does worse by far than another, or than what is ``ahead`` of all, is left at that.
    **Returns** one `Fit` each, without held-out error. Errors as for `fit`.
    """
    effects = {e.name: e for trial in trials for e in trial.model.effects}
    everything = trials[0].model.plus([e for name, e in effects.items() if name not in trials[0].model])
    fits, ahead = [], ahead or Ahead()
    for model, names, near in trials:
        stage = _stage(model, everything, measurement, names, frozenset())._replace(budget=budget)
        start = starts_at(np.where(stage.free, stage.space.given_unknowns(), 0.0)[None]) if near else None
        rounds = fitted_rounds(stage, start, ahead)
        ahead = ahead.of(rounds)
        fits.append(summarise(stage, likeliest(rounds), None, "not asked for"))
    return fits


def fit_steps(
    model: Model | AbstractRotor,
    additions: list[Effect],
    measurement: Measurement,
    *,
    fixed: frozenset[str] = frozenset(),
) -> list[Fit]:
    """Fit a model as effects are added one after the other: the error step by step, compiled once.

    **Arguments:** ``model`` to begin with, or a rotor alone, its own effects keeping their values; ``additions``:
    effects in the order of adding; ``fixed``: entries of theirs ("probe_angle.angle_rad.X") that keep the value with
    which they come.
    **Returns** one `Fit` per step, the first without any addition. Errors as for `fit`.
    """
    full = paired(model, measurement)
    everything = full.plus(additions)
    check_own_effects(everything.with_orders(measurement.orders))
    fits = []
    for count in range(len(additions) + 1):
        names = tuple(dict.fromkeys(effect.name for effect in additions[:count]))
        stage = _stage(full.plus(additions[:count]), everything, measurement, names, fixed)
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
    full = model.with_orders(measurement.orders).with_null_effects(classes.values())
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
    return summarise(stage, likeliest(fitted_rounds(stage)), None, "not asked for")


def summarise(
    stage: Stage, now: Round, held_out: float | None, reason: str, *, scatter: RunScatter | None = None
) -> Fit:
    """A round as people want it. ``scatter`` between runs, where it was inferred before; it then counts in the
    chi-square.
    """
    space, measurement, free = stage.space, stage.measurement, stage.free
    best, data = now.best, now.data
    clusters = independent_parts(best, data)
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
        result=_result(now),
        converged=best.result == CONVERGED and now.settled and best.exact,
        reduced_chi2=reduced_chi2(
            measurement, fitted, left, fitted=int(free.sum()), noise=Noise(0.0, scatter or NO_SCATTER)
        ),
        held_out_rms=held_out,
        held_out_reason=reason,
        residual=left,
        scatter=scatter,
        misfit=now.allowance,
        free=stage.names,
        quantile=quantile,
        covariance=covariance,
        stage=stage,
        end=best,
    )


def _result(now: Round) -> str:
    """How a round ended, in words."""
    if not now.best.exact:
        return NOT_STEADY
    return RESULT_TEXT[now.best.result] if now.settled or now.best.result != CONVERGED else UNSETTLED


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
