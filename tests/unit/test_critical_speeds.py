"""Critical speeds, damping and whirl against the eigenvalues of the rotor's equation of motion."""

import math

import jax.numpy as jnp
import numpy as np
import pytest

from rotorjax import Jeffcott, Layout, Model, Support, SupportEffect, effects
from rotorjax.diagnosis.critical_speeds import critical_speeds, log_decrement, orbit_of, whirl_in_words

RPM = np.pi / 30.0


def modes(mass: float, stiffness: np.ndarray, damping: np.ndarray) -> list[tuple[float, float]]:
    """Undamped natural frequency [rpm] and damping ratio of M q̈ + C q̇ + K q = 0."""
    state = np.block([[np.zeros((2, 2)), np.eye(2)], [-stiffness / mass, -damping / mass]])
    values = [v for v in np.linalg.eigvals(state) if v.imag > 0.0]
    return sorted((abs(v) / RPM, -v.real / abs(v)) for v in values)


def agree(found, expected):
    np.testing.assert_allclose([c.speed_rpm for c in found], [speed for speed, _ in expected], rtol=1e-6)
    np.testing.assert_allclose([c.damping_ratio for c in found], [zeta for _, zeta in expected], rtol=1e-6)


@pytest.mark.parametrize("ratio", [0.005, 0.02, 0.15])
def test_of_a_rotor_with_unequal_axes(ratio):
    mass, stiffness = 1.3, np.array([9e4, 6e4])
    damping = 2.0 * ratio * np.sqrt(stiffness * mass)
    found = critical_speeds(Model(Jeffcott(mass, list(stiffness), [ratio, ratio])))
    agree(found, modes(mass, np.diag(stiffness), np.diag(damping)))
    assert [c.whirl for c in found] == ["elliptic", "elliptic"]
    np.testing.assert_allclose(np.abs([c.direction_deg for c in found]), [90.0, 0.0], atol=1e-6)


def test_peaks_far_apart_have_their_own_width():
    found = critical_speeds(Model(Jeffcott(1.3, [9e4, 6e4], [0.005, 0.004])))
    assert all(c.from_width for c in found)
    np.testing.assert_allclose([c.amplification for c in found], [0.5 / 0.004, 0.5 / 0.005], rtol=2e-3)


def test_peaks_that_overlap_are_told_by_their_eigenvalues():
    """Axes 5 % apart at 2 %: the half-power width of the response would say 2.1 and 2.3 %."""
    mass, stiffness, ratio, cross = 0.97, np.array([57069.0, 51301.0]), 0.02, 1190.0
    model = Model(Jeffcott(mass, list(stiffness), [ratio, ratio])) + effects.CrossCoupling(cross)
    coupled = np.diag(stiffness) + cross * np.array([[0.0, 1.0], [-1.0, 0.0]])
    found = critical_speeds(model)
    agree(found, modes(mass, coupled, np.diag(2.0 * ratio * np.sqrt(stiffness * mass))))
    assert not any(c.from_width for c in found)
    np.testing.assert_allclose([c.amplification for c in found], [0.5 / c.damping_ratio for c in found])


def test_of_a_measurement_at_other_orders():
    plain = Model(Jeffcott(1.3, [9e4, 8.5e4], [0.01, 0.02]))
    other = Model(plain.rotor, layout=Layout(orders=(0.5, 2.0)))
    assert critical_speeds(other) == critical_speeds(plain)


@pytest.mark.parametrize("rotation", ["x-to-y", "y-to-x"])
def test_unbalance_excites_forward_whirl_alone_where_all_directions_are_alike(rotation):
    """Forward: √(K / (M - g)) (Genta 2005, section 2.6); the backward mode at √(K / (M + g)) has no critical speed."""
    stiffness, mass, inertia = 5e4, 2.0, 0.3
    model = Jeffcott(mass, stiffness, 0.01, rotation=rotation) + effects.Gyroscopic(inertia)
    (found,) = critical_speeds(model)
    assert found.whirl == "forward"
    assert found.speed_rpm == pytest.approx(math.sqrt(stiffness / (mass - inertia)) / RPM, rel=1e-3)


def test_unequal_axes_let_unbalance_excite_backward_whirl():
    found = critical_speeds(Jeffcott(2.0, [5e4, 4.6e4], 0.01) + effects.Gyroscopic(0.5))
    assert [c.whirl for c in found] == ["backward", "forward"]


def test_cross_coupling_takes_damping_from_forward_whirl():
    """ζ_f = ζ - k / (2 K) to first order (Childs 1993, chapter 1)."""
    (found,) = critical_speeds(Jeffcott(2.0, 5e4, 0.02) + effects.CrossCoupling(1000.0))
    assert found.whirl == "forward"
    assert found.damping_ratio == pytest.approx(0.02 - 1000.0 / 1e5, rel=0.01)


def test_a_growing_mode_has_no_amplification_factor():
    (found,) = critical_speeds(Jeffcott(2.0, 5e4, 0.02) + effects.CrossCoupling(3000.0))
    assert found.damping_ratio < 0.0
    assert found.log_decrement < 0.0
    assert found.amplification is None


def test_without_damping():
    (found,) = critical_speeds(Model(Jeffcott(2.0, 5e4, 0.0)))
    assert (found.damping_ratio, found.log_decrement, found.amplification) == (0.0, 0.0, None)


def test_a_foundation_brings_critical_speeds_of_its_own():
    found = critical_speeds(Jeffcott(0.97, [56500.0, 51300.0], 0.02) + effects.Foundation(3e-6, -0.5, 0.0))
    assert len(found) == 4
    assert all(c.damping_ratio == pytest.approx(0.05, rel=0.02) for c in found[:2])


@pytest.mark.parametrize("ratio", [0.9, 1.0, 2.0])
def test_a_rotor_damped_out_has_none(ratio):
    assert critical_speeds(Model(Jeffcott(1.0, [5e4, 5e4], ratio))) == ()


class Rubber(SupportEffect):
    """A support whose compliance falls with frequency as no spring and damper do."""

    name = "rubber"
    family = "structure"
    meaning = "rubber mounts"
    source = "test, 2025"

    def support(self, point):
        return Support(compliance=1e-6 / jnp.sqrt(1.0 + point.frequency))


def test_not_known_where_no_equation_in_time_is():
    assert critical_speeds(Jeffcott(1.0, 5e4, 0.02) + Rubber()) is None


@pytest.mark.parametrize("effect", [effects.MassError(-1.0), effects.SpeedError(-1e6)])
def test_not_known_without_mass_or_speed(effect):
    assert critical_speeds(Jeffcott(1.0, 5e4, 0.02) + effect) is None


def test_logarithmic_decrement_is_that_of_free_vibration():
    """x(t) = e^{-ζωt} cos(ω√(1-ζ²) t): the logarithm of the ratio of two maxima that follow one another."""
    ratio = 0.07
    period = 2.0 * math.pi / math.sqrt(1.0 - ratio**2)
    assert log_decrement(ratio) == pytest.approx(math.log(1.0 / math.exp(-ratio * period)))
    assert log_decrement(1.0) == math.inf


def test_orbit_of():
    assert orbit_of(np.array([1.0, -1j]), 1)[1] == pytest.approx(1.0)
    assert orbit_of(np.array([1.0, -1j]), -1)[1] == pytest.approx(-1.0)
    assert orbit_of(np.array([1.0, -0.2j]), 1) == pytest.approx((0.0, 0.2))
    angle = math.radians(30.0)
    line = orbit_of(np.exp(0.7j) * np.array([math.cos(angle), math.sin(angle)]), 1)
    assert line == (pytest.approx(30.0), pytest.approx(0.0, abs=1e-12))
    said = [whirl_in_words(30.0, ratio) for ratio in (0.9, -0.3, 0.0)]
    assert said == ["forward", "backward, major axis 30°", "straight line, 30°"]
