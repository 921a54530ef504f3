"""Closed forms from the literature, at the tolerance that they support."""

import numpy as np
import pytest

from rotorjax import Conditions, Jeffcott, Model, Probes, effects, response

K, M, ZETA = 50e3, 2.0, 0.05
OMEGA = np.sqrt(K / M)


def isotropic(**settings) -> Jeffcott:
    return Jeffcott(M, K, ZETA, **settings)


def forward(z: np.ndarray) -> np.ndarray:
    """Forward component of (x, y): (x + i y) / 2."""
    return (z[:, 0, 0] + 1j * z[:, 1, 0]) / 2.0


def backward(z: np.ndarray) -> np.ndarray:
    return (z[:, 0, 0] - 1j * z[:, 1, 0]) / 2.0


def test_unbalance_law():
    """|z| = e r² / sqrt((1-r²)² + (2ζr)²), lag atan2(2ζr, 1-r²): Genta 2005, equation 2.28."""
    r = np.array([0.2, 0.7, 1.0, 1.4, 5.0])
    z = np.asarray(response(isotropic(), Conditions.at(r * OMEGA, unbalance=[M * 10e-6, 0.0])))[:, 0, 0]
    expected = 10e-6 * r**2 / np.sqrt((1 - r**2) ** 2 + (2 * ZETA * r) ** 2)
    np.testing.assert_allclose(np.abs(z), expected, rtol=1e-12)
    np.testing.assert_allclose(-np.angle(z), np.arctan2(2 * ZETA * r, 1 - r**2), atol=1e-12)


def test_far_above_critical_the_disk_turns_about_its_mass_centre():
    z = np.asarray(response(isotropic(), Conditions.at([1000 * OMEGA], unbalance=[M * 10e-6, 0.0])))[0, 0, 0]
    assert z.real == pytest.approx(-10e-6, rel=1e-4)


@pytest.mark.parametrize("stiffness", [1e3, 1e5, 1e7])
def test_bow_reads_itself_at_slow_roll_whatever_the_stiffness(stiffness):
    rotor = Jeffcott(M, [stiffness, 0.8 * stiffness], ZETA)
    z = np.asarray(response(rotor, Conditions.at([1e-4], bow=[30e-6, 40e-6])))[0, :, 0]
    np.testing.assert_allclose(z, [30e-6 + 40e-6j, 40e-6 - 30e-6j], rtol=1e-6)


def test_self_balancing_speed():
    """Unbalance opposite to the bow: no motion where Ω² U = K s (Nicholas, Gunter, Allaire 1976, part 1)."""
    speed = 0.6 * OMEGA
    bow = 20e-6
    z = np.asarray(response(isotropic(), Conditions.at([speed], unbalance=[-K * bow / speed**2, 0.0], bow=[bow, 0.0])))
    assert np.max(np.abs(z)) < 1e-18


def test_paper_equations():
    """f1..f4 of Huang et al. 2026 (equations 5-9, corrected), unequal axes, any angles."""
    mass, stiffness, ratio = 0.9686, np.array([56538.0, 51282.0]), np.array([0.005, 0.0047])
    unbalance, alpha, bow, theta, speed = 6e-6, np.radians(45.0), 0.5e-3, np.radians(110.0), 1500 * np.pi / 30
    tau = speed / np.sqrt(stiffness / mass)
    gain = 1 / np.sqrt((1 - tau**2) ** 2 + (2 * ratio * tau) ** 2)
    lag = np.arctan2(2 * ratio * tau, 1 - tau**2)
    reach = unbalance * tau**2 / mass
    f1 = gain[0] * (reach[0] * np.cos(alpha - lag[0]) + bow * np.cos(theta - lag[0]))
    f2 = -gain[0] * (reach[0] * np.sin(alpha - lag[0]) + bow * np.sin(theta - lag[0]))
    f3 = gain[1] * (reach[1] * np.sin(alpha - lag[1]) + bow * np.sin(theta - lag[1]))
    f4 = gain[1] * (reach[1] * np.cos(alpha - lag[1]) + bow * np.cos(theta - lag[1]))
    conditions = Conditions.at(
        [speed],
        unbalance=[unbalance * np.cos(alpha), unbalance * np.sin(alpha)],
        bow=[bow * np.cos(theta), bow * np.sin(theta)],
    )
    z = np.asarray(response(Jeffcott(mass, stiffness, ratio), conditions))[0, :, 0]
    np.testing.assert_allclose([z[0].real, -z[0].imag, z[1].real, -z[1].imag], [f1, f2, f3, f4], rtol=1e-10)


def test_cross_coupling_stability_threshold():
    """k = c ω_n leaves forward whirl at the critical speed without damping (Childs 1993, chapter 1)."""
    threshold = 2 * ZETA * np.sqrt(K * M) * OMEGA
    below = np.asarray(
        response(isotropic() + effects.CrossCoupling(0.999 * threshold), Conditions.at([OMEGA], unbalance=[1e-6, 0.0]))
    )
    plain = np.asarray(response(isotropic(), Conditions.at([OMEGA], unbalance=[1e-6, 0.0])))
    assert abs(forward(below)[0] / forward(plain)[0]) == pytest.approx(1000.0, rel=1e-6)


def test_internal_damping_does_nothing_on_a_circular_orbit():
    conditions = Conditions.at([0.5 * OMEGA, 1.3 * OMEGA], unbalance=[1e-6, 0.0])
    with_it = np.asarray(response(isotropic() + effects.InternalDamping(50.0), conditions))
    np.testing.assert_allclose(with_it, np.asarray(response(isotropic(), conditions)), rtol=1e-12)


def test_gyroscopic_stiffens_forward_whirl():
    """Forward unbalance sees K - (M - g) Ω²: undamped critical speed sqrt(K / (M - g))."""
    g = 0.3
    rotor = Jeffcott(M, K, 0.0)
    speed = 0.9 * OMEGA
    z = np.asarray(response(rotor + effects.Gyroscopic(g), Conditions.at([speed], unbalance=[1e-6, 0.0])))
    assert forward(z)[0].real == pytest.approx(1e-6 * speed**2 / (K - (M - g) * speed**2), rel=1e-12)
    assert abs(backward(z)[0]) < 1e-18


def test_foundation_in_series():
    """Massless foundation: springs in series, K k_f / (K + k_f) (Kirk, Gunter 1972)."""
    foundation = effects.Foundation(1 / (3 * K), 20.0, -30.0)
    z = np.asarray(response(Jeffcott(M, K, 0.0) + foundation, Conditions.at([0.5 * OMEGA], unbalance=[1e-6, 0.0])))
    expected = 1e-6 * (0.5 * OMEGA) ** 2 / (0.75 * K - M * (0.5 * OMEGA) ** 2)
    assert forward(z)[0].real == pytest.approx(expected, rel=1e-9)


def test_split_stiffness_makes_backward_whirl_between_the_criticals():
    rotor = Jeffcott(M, [1.2 * K, 0.8 * K], 0.001)
    z = np.asarray(response(rotor, Conditions.at([OMEGA], unbalance=[1e-6, 0.0])))
    assert abs(backward(z)[0]) > abs(forward(z)[0])


def test_turned_stiffness_equals_turned_probes():
    """Turning support, unbalance and probes together changes nothing."""
    angle = 0.37
    rotor = Jeffcott(M, [1.2 * K, 0.8 * K], [0.03, 0.05])
    plain = np.asarray(response(rotor, Conditions.at([0.9 * OMEGA], unbalance=[1e-6, 0.0])))
    even = Jeffcott(M, [1.2 * K, 0.8 * K], [0.0, 0.0])
    turned_model = Model(even, Probes([angle, np.pi / 2 + angle], [1.0, 1.0], [0.0, 0.0])) + effects.StiffnessAxes(
        angle
    )
    turned = np.asarray(
        response(turned_model, Conditions.at([0.9 * OMEGA], unbalance=[1e-6 * np.cos(angle), 1e-6 * np.sin(angle)]))
    )
    undamped = np.asarray(response(even, Conditions.at([0.9 * OMEGA], unbalance=[1e-6, 0.0])))
    np.testing.assert_allclose(turned, undamped, rtol=1e-12, atol=1e-20)
    assert not np.allclose(plain, undamped, rtol=1e-3)


def test_paper_critical_speeds(paper_rotor):
    """Huang et al. 2026, table 3: 2307 (x) and 2197 rpm (y), with M_eq = 0.9686 kg."""
    np.testing.assert_allclose(paper_rotor.critical_speeds_rpm(), [2307.0, 2197.0], atol=0.5)


def test_rotor_from_its_critical_speeds():
    """k = M ω²: the critical speeds come back."""
    rotor = Jeffcott.from_critical_speed(mass=0.9686, critical_speed_rpm=[2307.0, 2197.0], damping_ratio=0.005)
    np.testing.assert_allclose(rotor.critical_speeds_rpm(), [2307.0, 2197.0], rtol=1e-12)
    np.testing.assert_allclose(rotor.stiffness, [56532.3, 51269.8], rtol=1e-4)
