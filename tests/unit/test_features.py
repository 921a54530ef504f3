"""Features, the linear map, its inverse, and the rig's parameters."""

import jax
import numpy as np
import pytest

from rotorjax import Jeffcott
from rotorjax.diagnosis.features import (
    FaultValues,
    checked_features,
    components,
    fault_features,
    fault_values,
    feature_covariance,
    feature_map,
    features,
    inverse_map,
    vectors_of,
)
from rotorjax.model.rotor import bearing_stiffness, effective_mass, in_series

UNITS = np.array([1e-6, 1e-6, 1e-3, 1e-3])


def longhand(speed_rpm, unbalance_g_mm, alpha, bow_mm, theta):
    """Equations 10-13 of the paper, corrected."""
    out = []
    alpha, theta, omega = np.radians(alpha), np.radians(theta), speed_rpm * np.pi / 30.0
    for k, zeta in ((56538.0, 0.0050), (51282.0, 0.0047)):
        tau = omega / np.sqrt(k / 0.9686)
        size, lag = 1.0 / np.hypot(1.0 - tau**2, 2.0 * zeta * tau), np.arctan2(2.0 * zeta * tau, 1.0 - tau**2)
        u, s = unbalance_g_mm * 1e-6 * tau**2 / 0.9686, bow_mm * 1e-3
        out.append(
            (
                size * (u * np.cos(alpha - lag) + s * np.cos(theta - lag)),
                size * (u * np.sin(alpha - lag) + s * np.sin(theta - lag)),
            )
        )
    (cx, sx), (cy, sy) = out
    return np.array([cx, -sx, sy, cy])


@pytest.mark.parametrize("speed", [600.0, 1500.0, 2250.0, 2500.0, 3500.0])
def test_map_equals_the_equations(paper_rotor, speed):
    values = FaultValues(6.0, 67.5, 0.5, 45.0)
    expected = longhand(speed, *values)
    found = feature_map(paper_rotor, speed)[0] @ components(values)
    assert np.allclose(found, expected, rtol=1e-11, atol=1e-15)
    single = fault_features(paper_rotor, np.asarray(speed * np.pi / 30.0), components(values))
    assert np.allclose(single, expected, rtol=1e-11, atol=1e-15)


def test_condition_number_and_standard_error(paper_rotor):
    """4.5e4 at 1500 rpm in g mm and mm; 1 µm in each feature is 18 g mm."""
    scaled = feature_map(paper_rotor, 1500.0)[0] * UNITS
    assert np.linalg.cond(scaled) == pytest.approx(4.485e4, rel=1e-3)
    error = np.sqrt(np.diag(feature_covariance(paper_rotor, 1500.0, 1e-6))) / UNITS
    assert error == pytest.approx([17.58, 17.58, 0.0081, 0.0081], rel=0.01)


def test_two_speeds_determine_what_one_cannot(paper_rotor):
    one, both = (np.sqrt(feature_covariance(paper_rotor, speeds, 1e-6)[0, 0]) for speeds in (1500.0, [1500.0, 2500.0]))
    assert both < one / 30.0


def test_inverse_undoes_the_map(paper_rotor, rng):
    faults = rng.standard_normal((5, 4)) * UNITS
    for speeds in (1500.0, [1500.0, 2500.0, 900.0]):
        stacked = feature_map(paper_rotor, speeds).reshape(-1, 4)
        assert np.allclose((faults @ stacked.T @ inverse_map(paper_rotor, speeds).T) / UNITS, faults / UNITS, atol=1e-8)


def test_unequal_errors_are_weighed(paper_rotor, rng):
    """Features of one speed a thousand times less sure: the weighted inverse has the errors that it states, the plain
    one far larger.
    """
    speeds, fault = [1500.0, 2500.0], components(FaultValues(8.0, 30.0, 0.5, 45.0))
    stacked, sigma = feature_map(paper_rotor, speeds).reshape(-1, 4), np.repeat([1e-5, 1e-8], 4)
    covariance = np.diag(sigma**2) + 1e-18 * np.ones((8, 8))
    noisy = stacked @ fault + rng.multivariate_normal(np.zeros(8), covariance, 400)
    weighted = noisy @ inverse_map(paper_rotor, speeds, covariance).T - fault
    stated = np.sqrt(np.diag(feature_covariance(paper_rotor, speeds, covariance)))
    assert np.std(weighted, axis=0) == pytest.approx(stated, rel=0.15)
    plain = noisy @ inverse_map(paper_rotor, speeds).T - fault
    assert np.std(plain[:, 0]) > 5.0 * stated[0]
    with pytest.raises(ValueError, match=r"positive definite one of all features, \(8, 8\)"):
        inverse_map(paper_rotor, speeds, np.eye(4))


def test_equal_axes_are_refused_at_one_speed_and_solved_at_two():
    rotor = Jeffcott(1.0, 5e4, 0.01)
    with pytest.raises(ValueError, match=r"cannot be told apart at 1500 rpm.*second speed"):
        inverse_map(rotor, 1500.0)
    assert inverse_map(rotor, [1500.0, 2500.0]).shape == (4, 8)


@pytest.mark.parametrize("speed", [0.0, -1500.0, np.nan, np.inf])
def test_speeds_that_are_none_are_refused(paper_rotor, speed):
    with pytest.raises(ValueError, match="each must be a positive number"):
        inverse_map(paper_rotor, speed)


def test_single_precision_is_refused(paper_rotor):
    with jax.enable_x64(False), pytest.raises(ValueError, match="needs double precision"):
        inverse_map(paper_rotor, 1500.0)


def test_vectors_and_features_are_two_names_of_one_thing(rng):
    f = rng.standard_normal((3, 4))
    assert np.array_equal(features(vectors_of(f)), f)


def test_fault_values_round_trip():
    values = FaultValues(6.0, 225.0, 0.5, 45.0)
    assert np.allclose(fault_values(components(values)), values)


def test_bad_features_are_refused():
    with pytest.raises(ValueError, match=r"shape \(3,\): give f1, f2, f3, f4"):
        checked_features(np.ones(3))
    with pytest.raises(ValueError, match="features are real numbers"):
        checked_features(np.ones(4) * 1j)
    with pytest.raises(ValueError, match="feature f3 of case 1 is not finite"):
        checked_features(np.array([[1.0, 1.0, 1.0, 1.0], [1.0, 1.0, np.inf, 1.0]]))


def test_rig_identification():
    """Table 3 of the paper: K_s and K_b in series, and K_b from the critical speed."""
    assert float(in_series(96908.0, 135720.0)) == pytest.approx(56538.0, abs=1.0)
    assert float(in_series(96908.0, 108920.0)) == pytest.approx(51282.0, abs=1.0)
    bearing = bearing_stiffness(critical_speed_rpm=[2307.0, 2197.0], mass=0.9686, shaft_stiffness=96908.0)
    assert np.asarray(bearing) == pytest.approx([135720.0, 108920.0], rel=2e-3)
    assert float(effective_mass(0.8, 0.35062)) == pytest.approx(0.9703, abs=1e-4)
    with pytest.raises(ValueError, match="reaches the shaft's own stiffness"):
        bearing_stiffness(critical_speed_rpm=4000.0, mass=0.9686, shaft_stiffness=96908.0)
