"""The linear inverse: unbalance and bow from measured vectors by least squares, and whether they are separable."""

import dataclasses
import math
from collections.abc import Iterable

import numpy as np
from jaxtyping import Float

from rotorjax.arrays import require_float64
from rotorjax.data.measurement import Measurement
from rotorjax.data.names import several
from rotorjax.data.pairing import paired
from rotorjax.diagnosis.fault import Fault
from rotorjax.diagnosis.least_squares import Solution, solve
from rotorjax.diagnosis.separability import why_not_separable
from rotorjax.effects import CATALOG
from rotorjax.inference.faults import installed_faults, polar_covariance
from rotorjax.inference.space import make_space
from rotorjax.model.contract import AbstractRotor
from rotorjax.model.model import Model
from rotorjax.shown import Shown
from rotorjax.units import GRAM_MILLIMETRE, MICROMETRE


@dataclasses.dataclass(frozen=True)
class RunDiagnosis:
    """Unbalance [kg m] and bow [m] of one run; either is none where not even a least-squares value exists."""

    run: str
    unbalance: Fault | None
    bow: Fault | None
    identifiable: bool
    reason: str
    """Why not, and what would help; empty if identifiable."""
    unbalance_alone: Fault | None
    """If not identifiable: the unbalance that would account for the most of it without any bow."""
    reduced_chi2: float | None
    """Squared residual in squared standard errors per degree of freedom; well above one, the model does not hold."""
    model_holds: bool | None
    """Whether the misfit is within the noise; none where the noise is not known, or no reading is left over."""
    covariance: Float[np.ndarray, "4 4"] | None = None
    """Of unbalance and bow together (U_x, U_y, s_x, s_y); none where the data do not determine it."""

    def __str__(self) -> str:
        faults = (("unbalance", self.unbalance, GRAM_MILLIMETRE, "g mm"), ("bow", self.bow, MICROMETRE, "µm"))
        sizes = [
            f"{what} not determined" if fault is None else f"{what} {fault.magnitude / unit:.3g} {shown}"
            for what, fault, unit, shown in faults
        ]
        sure = " where the model fails" if self.model_holds is False else "" if self.identifiable else ", not separable"
        return f"{self.run}: {', '.join(sizes)}{sure}"


@dataclasses.dataclass(frozen=True)
class Diagnosis(Shown):
    """What `diagnose` found in every run, and the inherent faults where a reference was given."""

    runs: tuple[RunDiagnosis, ...]
    inherent: RunDiagnosis | None

    @property
    def found(self) -> tuple[RunDiagnosis, ...]:
        """Every run, and what is inherent, if that was asked for."""
        return (*self.runs, *([self.inherent] if self.inherent else []))

    def __repr__(self) -> str:
        return f"Diagnosis({'; '.join(map(str, self.found))})"


def diagnose(
    model: Model | AbstractRotor, measurement: Measurement, *, reference: str | Iterable[str] = ()
) -> Diagnosis:
    """Unbalance and bow of every run from its 1X vectors at all its speeds jointly, by weighted least squares.

    z - z_0 = J (U_x, U_y, s_x, s_y): the map is linear (Huang et al. 2026, Sensors 26:2565, equations 5-9). Found is
    all that drives the run, what was installed included. What the user declared uncertain of rotor and probes is
    fitted beside, one value for all runs, and widens the errors. Covariance from the joint normal equations, times
    the reduced chi-square where that exceeds one; with unknown noise the residual gives it.

    **Arguments:** ``model`` of rotor and reading, or a rotor alone, its own faults not counted; ``measurement``;
    ``reference``: runs whose installed faults are known, so that what is found beyond them is inherent to the rotor and
    taken off the other runs. **Returns** a `Diagnosis`. **Errors.** ``ValueError`` in single precision, for a reference
    that is not a run, without 1X, or for a measurement with other probes or planes.
    """
    require_float64("diagnose")
    whole = paired(model, measurement)
    if 1.0 not in measurement.orders:
        raise ValueError("the table holds no order 1: unbalance and bow show at 1X")
    reference = several(reference)
    if missing := [run for run in reference if run not in measurement.runs]:
        raise ValueError(f"reference run {missing[0]!r} is not in the table, which has {', '.join(measurement.runs)}")
    full = whole.with_orders(measurement.orders).with_null_effects(
        CATALOG[name] for name in {u.effect for u in measurement.knowledge.uncertain}
    )
    solutions, fitted = solve(make_space(full, measurement.knowledge), measurement)
    inherent = _inherent(measurement, fitted, solutions, reference) if reference else None
    runs = []
    for k, (run, solution) in enumerate(zip(measurement.runs, solutions, strict=True)):
        beyond = solution if inherent is None or run in reference else _shifted(solution, inherent)
        runs.append(_judge(run, beyond, fitted, measurement, k))
    found = (
        _judge("inherent", inherent, fitted, measurement, measurement.runs.index(reference[0])) if inherent else None
    )
    return Diagnosis(tuple(runs), found)


def _inherent(
    measurement: Measurement, model: Model, solutions: list[Solution], reference: tuple[str, ...]
) -> Solution:
    """Found less installed, averaged over the reference runs; declared errors of the installed ones widen it."""
    installed, known = installed_faults(model, measurement), measurement.knowledge
    chosen = [measurement.runs.index(run) for run in reference]
    each = [solutions[k] for k in chosen]
    covariance = np.zeros((4, 4))
    for k, solution in zip(chosen, each, strict=True):
        covariance += solution.covariance
        covariance[:2, :2] += polar_covariance(
            installed[k, :2], known.installed_unbalance, known.installed_angle_rad
        ) / (solution.scale or 1.0)
        covariance[2:, 2:] += polar_covariance(installed[k, 2:], known.installed_bow, known.installed_angle_rad) / (
            solution.scale or 1.0
        )
    scales = [s.scale for s in each if s.scale is not None]
    return each[0]._replace(
        faults=np.mean([s.faults - installed[k] for k, s in zip(chosen, each, strict=True)], axis=0),
        covariance=covariance / len(each) ** 2,
        alone=Fault(
            np.mean([s.alone.pair - installed[k, :2] for k, s in zip(chosen, each, strict=True)], axis=0),
            each[0].alone.covariance,
            each[0].alone.freedom,
        ),
        scale=max(scales) if len(scales) == len(each) else None,
        chi2=max((s.chi2 for s in each if s.chi2 is not None), default=None),
    )


def _shifted(solution: Solution, inherent: Solution) -> Solution:
    ratio = (inherent.scale or 1.0) / (solution.scale or 1.0)
    return solution._replace(
        faults=solution.faults - inherent.faults,
        covariance=solution.covariance + ratio * inherent.covariance,
        alone=solution.alone._replace(pair=solution.alone.pair - inherent.alone.pair),
    )


def _judge(run: str, solution: Solution, model: Model, measurement: Measurement, index: int) -> RunDiagnosis:
    covariance = None if solution.scale is None else solution.scale * solution.covariance
    blocks = (covariance[:2, :2], covariance[2:, 2:]) if covariance is not None else (None, None)
    lost = math.inf if measurement.sigma is not None else solution.freedom
    unbalance, bow = (Fault(solution.faults[k : k + 2], blocks[k // 2], lost) for k in (0, 2))
    reason = why_not_separable(unbalance, bow, solution, model, measurement, index)
    alone = solution.alone if reason and np.all(np.isfinite(solution.alone.pair)) else None
    holds = None if solution.chi2 is None else not solution.model_fails
    if solution.rank < 4 or model.slow_roll is not None:
        return RunDiagnosis(run, None, None, False, reason, alone, solution.chi2, holds)
    return RunDiagnosis(run, unbalance, bow, not reason, reason, alone, solution.chi2, holds, covariance)
