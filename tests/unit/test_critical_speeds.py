"""Critical speeds and amplification factors against the eigenvalues of the rotor's equation of motion."""

import numpy as np
import pytest

from rotorjax import Jeffcott, Layout, Model, effects
from rotorjax.diagnosis.critical_speeds import critical_speeds

RPM = np.pi / 30.0


def modes(mass: float, stiffness: np.ndarray, damping: np.ndarray) -> list[tuple[float, float]]:
    """Undamped natural frequency [rpm] and damping ratio of M q̈ + C q̇ + K q = 0."""
    state = np.block([[np.zeros((2, 2)), np.eye(2)], [-stiffness / mass, -damping / mass]])
    values = [v for v in np.linalg.eigvals(state) if v.imag > 0.0]
    return sorted((abs(v) / RPM, -v.real / abs(v)) for v in values)


@pytest.mark.parametrize("ratio", [0.005, 0.02])
def test_of_a_rotor_with_unequal_axes(ratio):
    mass, stiffness = 1.3, np.array([9e4, 6e4])
    damping = 2.0 * ratio * np.sqrt(stiffness * mass)
    found = critical_speeds(Model(Jeffcott(mass, list(stiffness), [ratio, ratio])))
    expected = modes(mass, np.diag(stiffness), np.diag(damping))
    np.testing.assert_allclose([c.speed_rpm for c in found], [speed for speed, _ in expected], rtol=2e-3)
    np.testing.assert_allclose([c.damping_ratio for c in found], [zeta for _, zeta in expected], rtol=0.02)


def test_with_cross_coupling_and_another_damping():
    mass, stiffness, ratio, cross = 1.3, np.array([9e4, 8.5e4]), 0.01, 900.0
    model = Model(
        Jeffcott(mass, list(stiffness), [ratio, ratio]), layout=Layout(orders=(1.0, 2.0))
    ) + effects.CrossCoupling(cross)
    coupled = np.diag(stiffness) + cross * np.array([[0.0, 1.0], [-1.0, 0.0]])
    expected = modes(mass, coupled, np.diag(2.0 * ratio * np.sqrt(stiffness * mass)))
    found = critical_speeds(model)
    np.testing.assert_allclose([c.speed_rpm for c in found], [speed for speed, _ in expected], rtol=3e-3)


def test_a_rotor_damped_out_has_none():
    assert critical_speeds(Model(Jeffcott(1.0, [5e4, 5e4], [0.9, 0.9]))) == ()
