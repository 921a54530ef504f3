"""What the errors of several vectors have in common: unbalance and bow of a run that nobody knows exactly, and the
error of the model's form.

In standard errors the covariance of all vectors is 1 + B Bᵀ. The columns of B, here `common_errors`, are independent
random numbers of unit variance.
"""

import functools
import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float

from rotorjax.arrays import numpy_pair
from rotorjax.data.knowledge import Knowledge
from rotorjax.data.measurement import Measurement
from rotorjax.inference.faults import fault_sensitivity, installed_faults, polar_covariance
from rotorjax.model.model import Model
from rotorjax.units import GRAM_MILLIMETRE, MICROMETRE

ALIKE = 0.1
"""Relative difference of speed over which the error of the model's form stays alike: several half-power widths of a
resonance.
"""
NEGLIGIBLE = 0.01
"""Variance, in that of the noise, which a common error may lack."""


class RunScatter(NamedTuple):
    """Standard deviation per component of a random unbalance and a random bow in every run, of zero mean."""

    unbalance_kg_m: float = 0.0
    bow_m: float = 0.0

    def as_json(self) -> dict[str, float]:
        """In engineering units."""
        return {"unbalance_g_mm": self.unbalance_kg_m / GRAM_MILLIMETRE, "bow_um": self.bow_m / MICROMETRE}


class Noise(NamedTuple):
    """What is added to the standard errors of the table: an isotropic allowance for misfit [m], and scatter between
    runs.
    """

    allowance: float = 0.0
    scatter: RunScatter = RunScatter()


NO_SCATTER, NO_NOISE = RunScatter(), Noise()


def anything_random(known: Knowledge, scatter: RunScatter) -> bool:
    """Whether unbalance or bow of a run are random: then the vectors feel that as they feel the rotor."""
    declared = known.installed_unbalance > 0.0 or known.installed_angle_rad > 0.0 or known.installed_bow > 0.0
    return declared or scatter != NO_SCATTER


class OfRuns(NamedTuple):
    """What is random in every run, and what a calibration leaves open in all: one unit of each of its independent parts
    does this to the vectors [m].
    """

    measurement: Measurement
    columns: Float[np.ndarray, "case cell common"]

    @classmethod
    def of(
        cls,
        measurement: Measurement,
        model: Model,
        scatter: RunScatter,
        calibrated: Float[np.ndarray, "case cell common"] | None = None,
    ) -> "OfRuns":
        """**Arguments:** ``model``: where the sensitivity to unbalance and bow is taken, and that to what a calibration
        leaves open, but where what that does is given, ``calibrated``.
        """
        if calibrated is None and measurement.calibration is not None:
            calibrated = measurement.calibration.columns(model, measurement.conditions, measurement.orders)
        left_open = [] if calibrated is None else [calibrated]
        cases, cells = len(measurement.run), 2 * measurement.vectors[0].size
        random = anything_random(measurement.knowledge, scatter)
        if not random or not np.any(factor := _scatter_factor(measurement, model, scatter)):
            return cls(measurement, np.concatenate([np.zeros((cases, cells, 0)), *left_open], axis=2))
        slopes = fault_sensitivity(model, measurement.conditions).reshape(cases, cells, 4)
        by_run = np.zeros((cases, cells, len(measurement.runs), 4))
        by_run[np.arange(cases), :, measurement.run] = np.einsum("cmd,cdl->cml", slopes, factor[measurement.run])
        return cls(measurement, np.concatenate([by_run.reshape(cases, cells, -1), *left_open], axis=2))

    def with_form(self, allowance: float, *, form: bool = True) -> Float[np.ndarray, "case cell common"]:
        """In standard errors, with the error of the model's form. **Arguments:** ``allowance``: added to the table's
        standard errors [m].
        """
        weight = self.measurement.weights(allowance)
        parts = [weight.reshape(*self.columns.shape[:2], 1) * self.columns]
        if form and self.measurement.knowledge.tolerance > 0.0:
            parts.append(_form_error(self.measurement, allowance))
        common = np.concatenate(parts, axis=-1)
        return common[..., np.any(common != 0.0, axis=(0, 1))]


def common_errors(
    measurement: Measurement,
    model: Model,
    noise: Noise,
    *,
    form: bool = True,
    calibrated: Float[np.ndarray, "case cell common"] | None = None,
) -> Float[np.ndarray, "case cell common"]:
    """What one unit of every common error does to the vectors, in standard errors.

    **Arguments:** ``model``: where the sensitivity to what is random in a run is taken; ``noise``: what to add to the
    table's; ``form``: with the error of the model's form; ``calibrated``: as in `OfRuns.of`.
    """
    return OfRuns.of(measurement, model, noise.scatter, calibrated).with_form(noise.allowance, form=form)


def _scatter_factor(measurement: Measurement, model: Model, scatter: RunScatter) -> Float[np.ndarray, "run dof latent"]:
    """Factor L of the covariance L Lᵀ of the random (U_x, U_y, s_x, s_y) of each run [kg m, m].

    What the user declared of the installed weights and bows, relative size along and angle across, and ``scatter``.
    """
    installed = installed_faults(model, measurement)
    return np.stack([random_in_run(measurement.knowledge, fault, scatter) for fault in installed])


def random_in_run(
    known: Knowledge, fault: Float[np.ndarray, "4"], scatter: RunScatter
) -> Float[np.ndarray, "4 latent"]:
    """The same of one run. **Arguments:** ``fault``: unbalance and bow installed, as the disk feels them [kg m, m]."""
    covariance = np.diag([scatter.unbalance_kg_m**2] * 2 + [scatter.bow_m**2] * 2)
    covariance[:2, :2] += polar_covariance(fault[:2], known.installed_unbalance, known.installed_angle_rad)
    covariance[2:, 2:] += polar_covariance(fault[2:], known.installed_bow, known.installed_angle_rad)
    values, directions = np.linalg.eigh(covariance)
    return directions * np.sqrt(np.maximum(values, 0.0))


@functools.lru_cache(maxsize=4)
def _form_error(measurement: Measurement, allowance: float) -> Float[np.ndarray, "case cell common"]:
    """The error of the model's form: at each order the vectors z of the probes become z + ε z.

    The entries of the matrix ε(Ω) are complex Gaussian processes of the logarithm of the speed, the same in all runs:
    ``tolerance`` is the standard deviation of real and imaginary part, ½ + ½ exp(-½ (Δ ln Ω / `ALIKE`)²) their
    correlation. A rotor with more detail answers all runs alike by another response, which differs little from that of
    the model and smoothly over speed (Kennedy, O'Hagan 2001, J. R. Stat. Soc. B 63:425-464: model discrepancy). Where
    the healthy rotor is known, what has changed since has an ε of its own (`Measurement.form`).
    """
    apart = np.subtract.outer(np.log(measurement.speed_rpm), np.log(measurement.speed_rpm)) / ALIKE
    weight = measurement.weights(allowance)
    kernel = 0.5 * (1.0 + np.exp(-0.5 * apart**2))
    parts = []
    for order in range(weight.shape[2]):
        form = measurement.form[:, :, order]
        both = kernel * (form @ form.conj().T)
        for probe in range(weight.shape[1]):
            parts.append(_root(both, weight[:, probe, order], weight.shape, (probe, order)))
    return np.concatenate(parts, axis=-1)


def _root(
    covariance: Complex[np.ndarray, "case case"],
    weight: Float[np.ndarray, "case 2"],
    shape: tuple[int, ...],
    where: tuple[int, int],
) -> Float[np.ndarray, "case cell common"]:
    """Columns whose squares sum up to a covariance of complex numbers, in standard errors at one probe and order."""
    pairs = np.moveaxis(np.stack([numpy_pair(covariance), numpy_pair(1j * covariance)], axis=2), 3, 1)
    rows = weight.ravel()
    values, directions = np.linalg.eigh(rows[:, None] * pairs.reshape(len(rows), -1) * rows)
    kept = values > NEGLIGIBLE
    full = np.zeros((*shape, int(kept.sum())))
    full[:, *where] = (directions[:, kept] * np.sqrt(values[kept])).reshape(*weight.shape, -1)
    return full.reshape(shape[0], math.prod(shape[1:]), full.shape[-1])
