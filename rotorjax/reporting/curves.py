"""What a model shows over speed with what was installed in a run, with its 95 % band, for Bode plots."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float

from rotorjax.data.measurement import Measurement
from rotorjax.data.names import one_of
from rotorjax.discovery.fit import Fit
from rotorjax.inference.budget import Budget
from rotorjax.inference.prediction import predict
from rotorjax.model.conditions import Conditions
from rotorjax.model.model import Model
from rotorjax.physics.response import response
from rotorjax.units import MICROMETRE, RPM

POINTS = 241


class Curve(NamedTuple):
    """Vectors over speed, of one probe and order."""

    speed_rpm: Float[np.ndarray, "speed"]
    vectors: Complex[np.ndarray, "speed"]
    """[m]; not a number where no steady motion was found."""
    spread: Float[np.ndarray, "speed 2"] | None = None
    """Half the 95 % interval along the vector and across it [m]; none where nothing was fitted."""
    lag: bool = False
    """Whether phases are shown as lags, not as leads."""

    @property
    def amplitude_um(self) -> Float[np.ndarray, "speed"]:
        """Size of the vectors; not a number where nothing drives this order."""
        size = np.abs(self.vectors) / MICROMETRE
        return np.where(size > 0.0, size, np.nan)

    @property
    def phase_deg(self) -> Float[np.ndarray, "speed"]:
        """Phase without jumps of 360°; it begins between -180° and 180°."""
        angle, seen = (-1.0 if self.lag else 1.0) * np.degrees(np.angle(self.vectors)), np.isfinite(self.amplitude_um)
        angle[seen] = np.unwrap(angle[seen], period=360.0)
        return np.where(seen, angle, np.nan)

    @property
    def band_um(self) -> tuple[Float[np.ndarray, "speed"], Float[np.ndarray, "speed"]] | None:
        """Lower and upper limit of the amplitude."""
        if self.spread is None:
            return None
        size, half = self.amplitude_um, self.spread[:, 0] / MICROMETRE
        return np.maximum(size - half, 1e-2 * size), size + half

    @property
    def band_deg(self) -> tuple[Float[np.ndarray, "speed"], Float[np.ndarray, "speed"]] | None:
        """Lower and upper limit of the phase."""
        if self.spread is None:
            return None
        half = np.degrees(np.arctan(self.spread[:, 1] / MICROMETRE / self.amplitude_um))
        return self.phase_deg - half, self.phase_deg + half

    def near(self, speed_rpm: Float[np.ndarray, "_"], phase_deg: Float[np.ndarray, "_"]) -> Float[np.ndarray, "_"]:
        """Measured phases, each in the turn in which it is nearest to the curve."""
        seen = np.isfinite(self.phase_deg)
        if not seen.any():
            return phase_deg
        there = np.interp(speed_rpm, self.speed_rpm[seen], self.phase_deg[seen])
        return phase_deg + 360.0 * np.round((there - phase_deg) / 360.0)


class Curves(NamedTuple):
    """Vectors over speed, of all probes and orders."""

    speed_rpm: Float[np.ndarray, "speed"]
    vectors: Complex[np.ndarray, "speed probe order"]
    factor: Float[np.ndarray, "speed probe order 2 free"] | None = None
    """Real and imaginary part by unit deviations of what was fitted, times half a 95 % interval [m]."""

    def of(self, probe: int, order: int, *, lag: bool = False) -> Curve:
        """Those of one probe and order, by their place. **Arguments:** ``lag``: whether phases are shown as lags."""
        z = self.vectors[:, probe, order]
        if self.factor is None:
            return Curve(self.speed_rpm, z, lag=lag)
        real, imaginary = self.factor[:, probe, order, 0], self.factor[:, probe, order, 1]
        angle = np.angle(z)[:, None]
        along = np.cos(angle) * real + np.sin(angle) * imaginary
        across = np.cos(angle) * imaginary - np.sin(angle) * real
        spread = np.stack([np.linalg.norm(along, axis=1), np.linalg.norm(across, axis=1)], axis=1)
        return Curve(self.speed_rpm, z, spread, lag)


def shown_speeds(m: Measurement) -> Float[np.ndarray, "speed"]:
    """Speeds of a curve [rpm]: those measured and some beyond."""
    low, high = float(m.speed_rpm.min()), float(m.speed_rpm.max())
    margin = 0.08 * high if high - low < 0.02 * high else 0.15 * (high - low)
    return np.linspace(max(low - margin, 0.02 * low), high + margin, POINTS)


def declared_curves(model: Model, m: Measurement, run: str) -> Curves:
    """What a model shows as it is."""
    speeds = shown_speeds(m)
    return Curves(speeds, np.asarray(response(model.with_orders(m.orders), _conditions(m, run, speeds))))


def fitted_curves(fitted: Fit, run: str) -> Curves:
    """What a fit shows, with its 95 % band to first order in what was fitted."""
    stage, end = fitted.stage, fitted.end
    m, speeds = stage.measurement, shown_speeds(stage.measurement)
    near = m.conditions, end.motions
    found = predict(stage.space, _conditions(m, run, speeds), end.point, budget=Budget(), near=near, free=end.free)
    covariance = fitted.covariance[np.ix_(end.free, end.free)]
    root = fitted.quantile * np.linalg.cholesky(covariance) if len(end.free) else np.zeros((0, 0))
    factor = (found.slopes @ root).reshape(*found.shown.shape, 2, len(end.free))
    return Curves(speeds, found.shown, factor)


def _conditions(m: Measurement, run: str, speeds: Float[np.ndarray, "speed"]) -> Conditions:
    cases = np.flatnonzero(m.run == m.runs.index(one_of(run, m.runs, "run")))
    cases = cases[np.argsort(m.speed_rpm[cases])]
    at = m.conditions
    sweep = np.interp(speeds, m.speed_rpm[cases], at.sweeps[cases] / RPM) if at.sweep is not None else None
    return Conditions.at_rpm(speeds, unbalance=at.unbalance[cases[0]], bow=at.bow[cases[0]], sweep_rpm_per_s=sweep)
