"""A model compared with a measurement: how far off it is, in micrometres and in standard errors, and where."""

import dataclasses
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Complex, Float

from rotorjax.data.measurement import Measurement
from rotorjax.data.pairing import paired, require_steady
from rotorjax.inference.noise import reduced_chi2
from rotorjax.model.contract import AbstractRotor
from rotorjax.model.model import Model
from rotorjax.physics.response import response
from rotorjax.shown import Shown
from rotorjax.units import MICROMETRE


class Cell(NamedTuple):
    """One vector: how far the model is from it."""

    run: str
    speed_rpm: float
    probe: str
    order: float
    measured: complex
    """[m], likewise ``predicted``."""
    predicted: complex
    residual_um: float
    standardised: float | None
    """|residual| in standard errors of one component; sqrt(2) is the rms of pure noise."""

    @property
    def amplitude_ratio(self) -> float | None:
        """|predicted| / |measured|."""
        return abs(self.predicted) / abs(self.measured) if self.measured else None

    @property
    def phase_error_deg(self) -> float | None:
        """Phase of predicted over measured, between -180 and 180."""
        return float(np.degrees(np.angle(self.predicted / self.measured))) if self.measured and self.predicted else None


@dataclasses.dataclass(frozen=True, eq=False)
class Comparison(Shown):
    """Residuals of a model against a measurement."""

    measurement: Measurement
    measured: Complex[np.ndarray, "case probe order"]
    """The measured vectors, half orders at the sign nearer to the model [m]."""
    predicted: Complex[np.ndarray, "case probe order"]
    residual: Complex[np.ndarray, "case probe order"]
    """Measured minus predicted [m], zero where nothing was measured."""
    standardised: Float[np.ndarray, "case probe order"] | None
    """|residual| in standard errors of one component; none where the noise is unknown."""
    reduced_chi2: float | None
    """Squared residual per real number measured, in squared standard errors; one for a model that holds."""

    def __repr__(self) -> str:
        chi2 = "" if self.reduced_chi2 is None else f", reduced chi-square {self.reduced_chi2:.3g}"
        return f"Comparison({self.rms / MICROMETRE:.3g} µm rms of {self.measurement.rms / MICROMETRE:.3g} µm{chi2})"

    @property
    def present(self) -> Bool[np.ndarray, "case probe order"]:
        """Where something was measured."""
        return self.measurement.present

    @property
    def rms(self) -> float:
        """sqrt(mean |residual|²) over the cells [m]."""
        return float(np.sqrt(np.mean(np.abs(self.residual[self.present]) ** 2)))

    def where(self) -> list[Cell]:
        """Every cell, worst first: by standard errors, or by micrometres where the noise is unknown."""
        size = np.abs(self.residual) if self.standardised is None else self.standardised
        cells = np.argwhere(self.present)
        order = np.argsort(-size[self.present], kind="stable")
        return [self._cell(*(int(i) for i in cells[k])) for k in order]

    def share(self) -> dict[str, dict[str, float]]:
        """Share of the squared misfit by run, speed cluster, probe that was read, and order; each adds up to one.

        Squares count in standard errors, in micrometres where the noise is unknown.
        """
        size = np.abs(self.residual) if self.standardised is None else self.standardised
        squares = np.where(self.present, size**2, 0.0)
        total = float(squares.sum())
        squares = squares / total if total > 0.0 else np.where(self.present, 1.0, 0.0) / self.present.sum()
        by_case, m = squares.sum(axis=(1, 2)), self.measurement
        cluster, speeds = m.speed_cluster()
        return {
            "run": {run: float(by_case[m.run == k].sum()) for k, run in enumerate(m.runs)},
            "speed": {f"{speed:.0f}": float(by_case[cluster == k].sum()) for k, speed in enumerate(speeds)},
            "probe": {probe: float(squares[:, m.probes.index(probe)].sum()) for probe in m.probes_read},
            "order": {f"{order:g}": float(squares[:, :, k].sum()) for k, order in enumerate(m.orders)},
        }

    def _cell(self, case: int, probe: int, order: int) -> Cell:
        m = self.measurement
        return Cell(
            m.runs[m.run[case]],
            float(m.speed_rpm[case]),
            m.probes[probe],
            m.orders[order],
            complex(self.measured[case, probe, order]),
            complex(self.predicted[case, probe, order]),
            float(abs(self.residual[case, probe, order]) / MICROMETRE),
            None if self.standardised is None else float(self.standardised[case, probe, order]),
        )


def compare(model: Model | AbstractRotor, measurement: Measurement) -> Comparison:
    """Compare a model, as it is, with a measurement.

    Residual z - z_model per run, speed, probe and order. **Arguments:** ``model``, or a rotor alone;
    ``measurement``. Nothing is fitted: that is `fit`. **Returns** a `Comparison`.
    **Errors.** ``ValueError`` if the probes or the number of planes differ.
    """
    full = paired(model, measurement)
    predicted = np.asarray(response(full.with_orders(measurement.orders), measurement.conditions))
    require_steady(predicted, measurement)
    return compare_vectors(predicted, measurement, full.with_orders(measurement.orders))


def compare_vectors(
    predicted: Complex[np.ndarray, "case probe order"], measurement: Measurement, model: Model
) -> Comparison:
    """The same for a prediction of the model that is at hand [m]."""
    measured = measurement.vectors * measurement.half_order_sign(predicted)
    residual = np.where(measurement.present, measured - predicted, 0.0)
    real_axis = np.array(measurement.orders) == 0.0
    residual[:, :, real_axis] = np.real(residual[:, :, real_axis])
    standardised = None if measurement.sigma is None else np.abs(residual) * measurement.weights(0.0)[..., 0]
    return Comparison(
        measurement, measured, predicted, residual, standardised, reduced_chi2(measurement, model, residual)
    )
