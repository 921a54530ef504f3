"""What a measurement of the healthy rotor says of the model, so that only what has changed since is left to explain.

A real rotor is never a disk on a shaft: the shaft has mass, the disk tilts, bearings differ. What that does to the
vectors is larger than many a fault, and the search would name it. `calibrated` fits mass, damping and stiffness at the
disk, unbalance, bow and runout of its own (`rotorjax.effects.healthy_rotor`) to a measurement of the healthy rotor.
What these values leave open is an error that all vectors measured later share; what they do not explain is the
tolerance of the model's form.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Complex, Float
from scipy.linalg import solve_triangular

from rotorjax.data.knowledge import Knowledge
from rotorjax.data.measurement import Measurement
from rotorjax.data.pairing import paired
from rotorjax.discovery.compare import Comparison, compare, compare_vectors
from rotorjax.discovery.fit import Fit, fit
from rotorjax.effects import CATALOG
from rotorjax.effects.healthy_rotor import HEALTHY, HealthyDetail, HealthyRotor
from rotorjax.errors import InputError
from rotorjax.inference.budget import Budget
from rotorjax.inference.covariance import Noise, common_errors
from rotorjax.inference.curvature import inverse
from rotorjax.inference.linearised import Linearisation, Point
from rotorjax.inference.prediction import conditions_data, predict
from rotorjax.inference.space import Space, make_space, values_of
from rotorjax.model.conditions import Conditions
from rotorjax.model.contract import AbstractRotor
from rotorjax.model.model import Model
from rotorjax.physics.steady_state import without_coupling

FIRST_TOLERANCE = 1e-3
"""Tolerance of the model's form under which the first fit is made."""
TOLERANCES = np.geomspace(1e-5, 0.1, 17)
"""Each as probable beforehand: what is fitted to the healthy rotor leaves one of them."""
MOST_LEFT = 0.3
"""Share of what was measured on the healthy rotor that may be left: beyond, its model is another."""
MOST_OFF = 0.3
"""Error of stiffness or mass of the rig file from which on the healthy table is not of this rotor."""
OF_HEALTHY = frozenset({"stiffness_error", "damping_error", "mass_error"})
"""What the rig file may call uncertain, and a healthy rotor shows."""


class Healthy(NamedTuple):
    """A model calibrated on a measurement of the healthy rotor."""

    model: Model
    """The model of the healthy rotor: hand it to `compare`, with `beside` of what was measured later."""
    declared: Comparison
    """The model as it was stated against that measurement."""
    calibrated: Comparison
    fit: Fit
    tolerance: float
    """Of the model's form: what the fit leaves beyond the noise, relative to the size of the measured vector."""
    tolerance_of_changes: float
    """The same of a disk on a shaft alone: the detail that it lacks is known of the healthy rotor only, not of what has
    changed.
    """

    def beside(self, measurement: Measurement) -> Measurement:
        """What was measured later, with the error that the calibration leaves in all its vectors, and the tolerances.

        **Errors.** `InputError` where it is the measurement of the healthy rotor itself.
        """
        read = self.calibrated.measurement
        if read.vectors.shape == measurement.vectors.shape and np.array_equal(read.vectors, measurement.vectors):
            raise InputError("the measurement of the healthy rotor is the one looked at: give the table of another day")
        end = self.fit.end
        fitted = {e.unknown: e for e in self.fit.stage.space.entries if e.effect in HEALTHY}
        own = [k for k, unknown in enumerate(end.free) if unknown in fitted]
        entries = [fitted[unknown] for unknown in end.free[own]]
        root = np.linalg.cholesky(inverse(end.curvature)[np.ix_(own, own)])
        left = LeftOpen(
            self.model, self.tolerance_of_changes, tuple(e.key for e in entries),
            np.array([e.scale for e in entries])[:, None] * root,
        )  # fmt: skip
        return dataclasses.replace(_with_tolerance(measurement, self.tolerance), calibration=left)


@dataclasses.dataclass(frozen=True, eq=False)
class LeftOpen:
    """The healthy rotor, and what its calibration leaves open of the parameters that it fitted."""

    model: Model
    tolerance_of_changes: float
    keys: tuple[str, ...]
    """Effect and label of each parameter."""
    root: Float[np.ndarray, "own common"]
    """L, their posterior covariance being L Lᵀ [SI]."""
    _spaces: dict[Any, Space] = dataclasses.field(default_factory=dict, init=False, repr=False)

    def healthy(self, conditions: Conditions, orders: tuple[float, ...]) -> Complex[np.ndarray, "case probe order"]:
        """What the healthy rotor would show [m], zero where it has no steady motion."""
        space = make_space(self.model.with_orders(orders), Knowledge())
        return np.nan_to_num(predict(space, conditions, space.given_unknowns(), budget=Budget()).shown)

    def columns(
        self, model: Model, conditions: Conditions, orders: tuple[float, ...]
    ) -> Float[np.ndarray, "case cell common"]:
        """J L, J the slopes of the vectors by these parameters where a model is right, at a steady speed, without
        nonlinear forces.
        """
        linear = without_coupling(model.with_orders(orders)).with_null_effects(CATALOG.values())
        space = self._space(linear)
        return self.columns_at(space, conditions, [values_of(linear) / np.asarray(space.scale)])[0]

    def columns_at(
        self, space: Space, conditions: Conditions, points: Sequence[Float[np.ndarray, "param"]]
    ) -> list[Float[np.ndarray, "case cell common"]]:
        """The same at several points of a space that has these parameters."""
        entries = {e.key: e for e in space.entries}
        own = [k for k, key in enumerate(self.keys) if key in entries]
        wanted = np.array([entries[self.keys[k]].unknown for k in own])
        layout, scale, costly = space.model.layout, np.asarray(space.scale), space.coupled() | space.sweeping()
        lin = Linearisation(space, conditions_data(conditions, len(layout.probes), len(layout.orders)), Budget())
        linear = [Point(np.where(costly, 0.0, point), None) for point in points]
        found = lin.at(linear, [wanted] * len(points))
        return [one.slopes / scale[wanted] @ self.root[own] for one in found]

    def _space(self, model: Model) -> Space:
        """The space of a model, kept for all that differ from it in the values of their effects only."""
        others = jax.tree.leaves(dataclasses.replace(model, effects=()))
        key = (jax.tree.structure(model), *(np.asarray(value).tobytes() for value in others))
        if key not in self._spaces:
            self._spaces[key] = make_space(model, Knowledge())
        return self._spaces[key]


def calibrated(model: Model | AbstractRotor, healthy: Measurement) -> Healthy:
    """Fit a model to a measurement of the healthy rotor: mass, damping and stiffness at the disk, its own unbalance,
    bow and runout.

    The tolerance of the model's form is the one that its residual asks for, the root mean square over tolerances from
    1e-5 to 0.1, each as probable beforehand, by their evidence; the model is fitted anew with it. Without what a disk
    on a shaft does not have (`HealthyDetail`), the same gives the tolerance of changes. What the rig file calls
    uncertain of mass, damping and stiffness is fitted here, and is not uncertain later.

    **Arguments:** ``model`` as stated; ``healthy``: a measurement of the rotor in its healthy state, with the weights
    that were on it. **Errors.** `InputError` where more than 30 % of what was measured is left, so that what was
    measured is not this rotor, or stiffness or mass are off by more than 30 %, and errors as for `fit`.
    """
    stated = paired(model, healthy)
    full = stated.plus(cls() for cls in HEALTHY.values())
    plain = tuple(name for name in HEALTHY if name != HealthyDetail.name)
    _, of_changes = _fitted(full, healthy, plain)
    fitted, tolerance = _fitted(full, healthy, tuple(HEALTHY))
    view = compare_vectors(fitted.predicted, fitted.stage.measurement, fitted.model)
    if view.rms > MOST_LEFT * healthy.rms:
        share = 100.0 * view.rms / healthy.rms
        raise InputError(
            f"the measurement of the healthy rotor: {share:.0f} % of what was measured is left whatever "
            "mass, damping, stiffness, unbalance and bow are: explain it first, and state in the rig file what it "
            "shows (weights, conventions, gains)"
        )
    for name in ("stiffness_x", "stiffness_y", "mass"):
        value = fitted.estimate(HealthyRotor.name, name).value
        if abs(value) > MOST_OFF:
            off = f"{name.replace('_', ' along ')} would be {100.0 * value:+.0f} % off the rig file"
            raise InputError(
                f"the measurement of the healthy rotor: its {off}: it is of another rotor, or in another unit or "
                "convention than the rig file states"
            )
    return Healthy(fitted.model, compare(stated, healthy), view, fitted, tolerance, max(of_changes, tolerance))


def _fitted(full: Model, healthy: Measurement, free: tuple[str, ...]) -> tuple[Fit, float]:
    """A fit under the tolerance that its residual asks for, and that of its own residual."""
    first = fit(full, _with_tolerance(healthy, FIRST_TOLERANCE), free=free, held_out=False)
    fitted = fit(full, _with_tolerance(healthy, _tolerance(first, healthy)), free=free, held_out=False)
    return fitted, _tolerance(fitted, healthy)


def _with_tolerance(measurement: Measurement, tolerance: float) -> Measurement:
    """The measurement with this tolerance, and nothing uncertain of what the healthy rotor shows."""
    known = measurement.knowledge
    uncertain = tuple(one for one in known.uncertain if one.effect not in OF_HEALTHY)
    return dataclasses.replace(
        measurement, knowledge=dataclasses.replace(known, uncertain=uncertain, tolerance=tolerance)
    )


def _tolerance(fitted: Fit, healthy: Measurement) -> float:
    """The root mean square of the tolerances that the measurement may come from, by the evidence of each: what is
    fitted is linear near the fit, and integrated out.
    """
    allowance = fitted.misfit if healthy.sigma is None else 0.0
    evidence = np.array([_log_evidence(fitted, healthy, Noise(allowance), float(one)) for one in TOLERANCES])
    weight = np.exp(evidence - evidence.max())
    return float(np.sqrt(weight @ TOLERANCES**2 / weight.sum()))


def _log_evidence(fitted: Fit, healthy: Measurement, noise: Noise, tolerance: float) -> float:
    """Logarithm of the probability of a residual under a tolerance, up to a constant."""
    end = fitted.end
    # Relative to what the fit predicts: what was measured has noise in it, which relative errors would explain.
    own = dataclasses.replace(_with_tolerance(healthy, tolerance), vectors=fitted.predicted)
    weight, before = (one.weights(noise.allowance).ravel() for one in (own, fitted.stage.measurement))
    counted = weight > 0.0
    by_weight = weight[counted] / before[counted]
    slopes = end.local.slopes.reshape(len(weight), -1)[counted] * by_weight[:, None]
    # As it would be at the null: there the prior of what is fitted has its mean.
    error = end.local.error.ravel()[counted] * by_weight - slopes @ end.point[end.free]
    common = common_errors(own, fitted.model, noise).reshape(len(weight), -1)[counted]
    columns = np.concatenate([common, slopes], axis=1)
    factor = np.linalg.cholesky(np.eye(columns.shape[1]) + columns.T @ columns)
    score = solve_triangular(factor, columns.T @ error, lower=True)
    return float(
        np.sum(np.log(weight[counted])) - np.sum(np.log(np.diag(factor))) - 0.5 * (error @ error - score @ score)
    )
