"""The paper's four features of one speed, the linear map from faults to them, and its exact inverse.

u(t) = f1 cos Ωt + f2 sin Ωt, v(t) = f3 cos Ωt + f4 sin Ωt; with vibration vectors z (displacement Re[z e^{iΩt}])
z_x = f1 - i f2, z_y = f3 - i f4. A fault is the vector m = (U_x, U_y, s_x, s_y) of unbalance [kg m] and bow [m];
f = J(Ω) m. Source: Huang et al. 2026, Sensors 26:2565, equations 1-14, corrected (see paper_tables/README.md).
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from rotorjax.arrays import AnyArray, Numbers, require_float64
from rotorjax.data.signals import WaveformVectors, vectors_from_waveform
from rotorjax.model.conditions import Conditions, Layout
from rotorjax.model.model import Model
from rotorjax.model.rotor import Jeffcott
from rotorjax.physics.response import vectors
from rotorjax.units import DEGREE, GRAM_MILLIMETRE, RPM

SINGULAR = 1e10
"""Condition number, in units of the columns' sizes, from which a map counts as singular."""


class FaultValues(NamedTuple):
    """Faults as the paper prints them, every entry an array of one shape or a number."""

    unbalance_g_mm: AnyArray | float
    unbalance_angle_deg: AnyArray | float
    bow_mm: AnyArray | float
    bow_angle_deg: AnyArray | float


def components(values: FaultValues) -> Float[np.ndarray, "*case 4"]:
    """(U cos α, U sin α, s cos θ, s sin θ) in kg m and m."""
    unbalance = np.asarray(values.unbalance_g_mm) * GRAM_MILLIMETRE
    bow = np.asarray(values.bow_mm) * 1e-3
    alpha, theta = np.asarray(values.unbalance_angle_deg) * DEGREE, np.asarray(values.bow_angle_deg) * DEGREE
    return np.stack(
        [unbalance * np.cos(alpha), unbalance * np.sin(alpha), bow * np.cos(theta), bow * np.sin(theta)], axis=-1
    )


def fault_values(faults: Float[AnyArray, "*case 4"]) -> FaultValues:
    """Magnitudes in g mm and mm, angles in degrees from 0 to 360."""
    m = np.asarray(faults)
    unbalance, bow = m[..., 0] + 1j * m[..., 1], m[..., 2] + 1j * m[..., 3]
    return FaultValues(
        np.abs(unbalance) / GRAM_MILLIMETRE,
        np.degrees(np.angle(unbalance)) % 360.0,
        np.abs(bow) * 1e3,
        np.degrees(np.angle(bow)) % 360.0,
    )


def fault_table(faults: Float[AnyArray, "*case 4"]) -> Float[np.ndarray, "*case 4"]:
    """(U [g mm], α [°], s [mm], θ [°]) along the last axis: `fault_values` as one array."""
    return np.stack([np.asarray(value) for value in fault_values(faults)], axis=-1)


def probe_model(rotor: Jeffcott) -> Model:
    """The rotor with one probe along x and one along y, 1X only."""
    return Model(rotor, layout=Layout(probes=("X", "Y"), orders=(1.0,)))


def features(z: AnyArray) -> Float[np.ndarray, "*case 4"]:
    """(f1, f2, f3, f4) of vibration vectors along x and y, shape (..., 2), complex [m]."""
    x, y = np.asarray(z)[..., 0], np.asarray(z)[..., 1]
    return np.stack([np.real(x), -np.imag(x), np.real(y), -np.imag(y)], axis=-1)


def vectors_of(f: Float[AnyArray, "*case 4"]) -> np.ndarray:
    """Vibration vectors along x and y of features, shape (..., 2), complex [m]."""
    f = np.asarray(f)
    return np.stack([f[..., 0] - 1j * f[..., 1], f[..., 2] - 1j * f[..., 3]], axis=-1)


def fault_features(rotor: Jeffcott, speed: Float[AnyArray, ""], fault: Float[AnyArray, "4"]) -> Float[Array, "4"]:
    """Features [m] of one fault at one speed [rad/s], for vmap and derivatives."""
    condition = Conditions(
        jnp.reshape(jnp.asarray(speed), (1,)),
        jnp.reshape(jnp.asarray(fault)[:2], (1, 1, 2)),
        jnp.reshape(jnp.asarray(fault)[2:], (1, 2)),
    )
    z = vectors(probe_model(rotor), condition)[0, :, 0]
    return jnp.stack([jnp.real(z[0]), -jnp.imag(z[0]), jnp.real(z[1]), -jnp.imag(z[1])])


@eqx.filter_jit
def _maps(rotor: Jeffcott, speeds: Float[Array, "speed"]) -> Float[Array, "speed 4 4"]:
    at = jax.vmap(lambda speed: jax.vmap(lambda fault: fault_features(rotor, speed, fault), out_axes=1)(jnp.eye(4)))
    return at(speeds)


def feature_map(rotor: Jeffcott, speed_rpm: Numbers) -> Float[np.ndarray, "speed 4 4"]:
    """J at each speed: f = J m, in m per kg m (first two columns) and m per m.

    **Arguments:** ``speed_rpm``: one speed or several. **Returns** shape (speed, 4, 4). **Errors.** ``ValueError`` for
    a speed that is not a positive number.
    """
    speeds = np.atleast_1d(np.asarray(speed_rpm, float))
    if not len(speeds) or not np.all(np.isfinite(speeds)) or not np.all(speeds > 0.0):
        raise ValueError(f"speeds {speeds.tolist()} rpm: each must be a positive number")
    return np.asarray(_maps(rotor, jnp.asarray(speeds) * RPM))


def inverse_map(
    rotor: Jeffcott, speed_rpm: Numbers, covariance: Float[AnyArray, "cell cell"] | None = None
) -> Float[np.ndarray, "4 cell"]:
    """The least-squares inverse at one speed or at several jointly: m = inverse @ concatenated features.

    **Arguments:** ``covariance`` of all those features (4 x speeds, 4 x speeds) [m²], such as `WaveformFeatures` has
    for each record, in blocks; by default their errors are equal and independent. **Returns** shape (4, 4 x speeds), in
    kg m per m (first two rows) and m per m. **Errors.** ``ValueError`` in single precision, for a speed that is not
    positive or is an undamped critical speed, a covariance that is none, and where the map is singular: with equal axes
    one speed cannot tell an unbalance from a bow.
    """
    require_float64("the inverse map")
    stacked = feature_map(rotor, speed_rpm).reshape(-1, 4)
    size = np.linalg.norm(stacked, axis=0)
    if not np.all(np.isfinite(stacked)):
        raise ValueError(
            "the response is infinite at a speed: an undamped rotor at its critical speed; give it damping, or another "
            "speed"
        )
    if np.linalg.cond(stacked / size) > SINGULAR:
        raise ValueError(
            "unbalance and bow cannot be told apart at "
            f"{', '.join(f'{float(s):g}' for s in np.atleast_1d(np.asarray(speed_rpm)))} rpm: "
            "the axes are equally stiff there and the map is singular; measure at a second speed and give both"
        )
    if covariance is None:
        return np.linalg.pinv(stacked / size, rcond=1e-15) / size[:, None]
    whiten = np.linalg.inv(np.linalg.cholesky(_checked_covariance(covariance, len(stacked))))
    return np.linalg.pinv(whiten @ stacked / size, rcond=1e-15) @ whiten / size[:, None]


def _checked_covariance(covariance: AnyArray, count: int) -> Float[np.ndarray, "cell cell"]:
    values = np.asarray(covariance, float)
    if values.shape != (count, count) or not np.all(np.isfinite(values)) or np.linalg.eigvalsh(values)[0] <= 0.0:
        raise ValueError(
            f"the covariance has shape {values.shape}: give a positive definite one of all features, ({count}, "
            f"{count}), in m²"
        )
    return values


def feature_covariance(rotor: Jeffcott, speed_rpm: Numbers, noise: float | AnyArray) -> Float[np.ndarray, "4 4"]:
    """Covariance (4, 4) of the faults found by least squares [kg m, kg m, m, m].

    **Arguments:** ``noise``: standard error of independent features [m], or the covariance that `inverse_map` takes
    [m²].
    """
    if np.ndim(noise) == 0:
        inverse = inverse_map(rotor, speed_rpm)
        return float(noise) ** 2 * inverse @ inverse.T
    inverse = inverse_map(rotor, speed_rpm, np.asarray(noise))
    return inverse @ np.asarray(noise) @ inverse.T


def checked_features(f: AnyArray, count: int = 4) -> Float[np.ndarray, "*case cell"]:
    """Features as an array. **Errors.** ``ValueError`` unless there are four (``count``) to a case, all real and
    finite.
    """
    if np.iscomplexobj(f):
        raise ValueError("features are real numbers: turn vibration vectors z into them with features(z)")
    values = np.asarray(f, float)
    if values.ndim == 0 or values.shape[-1] != count:
        more = "" if count == 4 else f", those of each speed in turn, {count} in all"
        raise ValueError(
            f"features have shape {values.shape}: give f1, f2, f3, f4 along the last axis, in metres{more}"
        )
    if not np.all(np.isfinite(values)):
        case = np.argwhere(~np.isfinite(values))[0]
        raise ValueError(
            f"feature f{case[-1] + 1}{f' of case {case[0]}' if len(case) > 1 else ''} is not finite: "
            "leave that case out"
        )
    return values


class WaveformFeatures(NamedTuple):
    """The paper's features of one record, with their errors."""

    features: Float[np.ndarray, "feature"]
    """f1..f4 [m]."""
    covariance: Float[np.ndarray, "feature feature"]
    """Of the features [m²]; what the pulses got wrong is common to both probes."""
    fit: WaveformVectors
    """Where they come from."""

    @property
    def standard_error(self) -> Float[np.ndarray, "feature"]:
        """Of each feature [m]."""
        return np.sqrt(np.diagonal(self.covariance))


def features_from_waveform(
    time: Numbers,
    displacement: Numbers,
    pulses: Numbers,
    *,
    probe_angle_deg: tuple[float, float] = (0.0, 90.0),
    drift: int = 1,
    pulse_error: float | None = None,
) -> WaveformFeatures:
    """The paper's features f1..f4 of one record: u = f1 cos φ + f2 sin φ along x, v = f3 cos φ + f4 sin φ along y.

    **Arguments:** ``time`` (sample) [s]; ``displacement`` (sample, 2) [m], probe X then Y; ``pulses`` of the phase
    reference [s]; ``probe_angle_deg`` where the two probes stand: x is the first one's direction; ``drift`` and
    ``pulse_error`` as in `vectors_from_waveform`. **Returns** `WaveformFeatures`. **Errors.** ``ValueError`` unless
    there are two probes, the second 90 degrees on from the first, and those of `vectors_from_waveform`.
    **Source:** Huang et al. 2026, section 2.3 and Figure 7.
    """
    shape = np.shape(displacement)
    if len(shape) != 2 or shape[1] != 2:
        raise ValueError(
            "features need the displacement of two probes, X then Y, of shape (sample, 2); this one has shape "
            f"{shape}: choose two columns"
        )
    apart = (probe_angle_deg[1] - probe_angle_deg[0]) % 360.0
    if not np.isclose(apart, 90.0):
        raise ValueError(
            f"features need the second probe 90 degrees on from the first; here it is {apart:g} degrees on: "
            "swap the columns if it is 270, else fit vectors_from_waveform against a model with these probes"
        )
    fit = vectors_from_waveform(time, displacement, pulses, drift=drift, pulse_error=pulse_error)
    sign = np.array([1.0, -1.0, 1.0, -1.0])  # f2 = -Im z_x, f4 = -Im z_y
    return WaveformFeatures(features(fit.vectors[:, 0]), sign[:, None] * fit.covariance[0] * sign, fit)
