"""One network for any speed of a range: beside the exact inverse, and refusals outside the range."""

import jax
import numpy as np
import pytest

from rotorjax import Jeffcott
from rotorjax.compensation import inherent_fault
from rotorjax.conditioned import Rigs, train_conditioned
from rotorjax.features import FaultValues, components, feature_map, inverse_map

NOISE = 1e-7
"""Standard error of a feature [m]."""


@pytest.fixture(scope="module")
def network():
    return train_conditioned(jax.random.key(11))


@pytest.mark.parametrize("speed", [600.0, 1000.0, 1500.0, 2000.0, 2100.0, 2500.0, 3000.0, 3500.0])
def test_within_a_tenth_of_the_exact_inverse(network, paper_rotor, speed):
    """Of its standard error at 0.1 µm, for a fault of 10 g mm and 0.5 mm; the same network at every speed."""
    fault = components(FaultValues(10.0, 67.5, 0.5, 45.0))
    ours, exact = np.asarray(network.at(paper_rotor, speed).matrix), inverse_map(paper_rotor, speed)
    bias = ours @ feature_map(paper_rotor, speed)[0] @ fault - fault
    error = np.sqrt(NOISE**2 * np.sum(ours**2, axis=1) + bias**2)
    assert np.all(error < 1.1 * NOISE * np.sqrt(np.sum(exact**2, axis=1)))


def test_other_rigs(network, rng):
    """Random rigs of the range, in the size of faults that drive them equally."""
    for _ in range(10):
        ratio, zeta = rng.uniform(0.87, 0.97), rng.uniform(0.002, 0.04, 2)
        stiffness = 10.0 ** rng.uniform(4.0, 7.0)
        rotor = Jeffcott(rng.uniform(0.5, 50.0), [stiffness, stiffness * ratio**2], zeta)
        speed = float(rotor.critical_speeds_rpm()[0]) * rng.uniform(0.3, 1.6)
        product = np.asarray(network.at(rotor, speed).matrix) @ feature_map(rotor, speed)[0]
        size = np.array([float(rotor.mass), float(rotor.mass), 1.0, 1.0])
        assert np.abs(product * size[None] / size[:, None] - np.eye(4)).max() < 5e-3


def test_linear_and_differentiable(network, paper_rotor, rng):
    f = rng.standard_normal((3, 4))
    assert np.allclose(network.diagnose(paper_rotor, 1500.0, 2.0 * f), 2.0 * network.diagnose(paper_rotor, 1500.0, f))
    slope = jax.jacfwd(lambda speed: network.matrix(paper_rotor, speed))(np.asarray(150.0))
    assert np.all(np.isfinite(np.asarray(slope)))


def test_serves_compensation(network, paper_rotor):
    jacobian = feature_map(paper_rotor, 1500.0)[0]
    induced, other = components(FaultValues(6.0, 67.5, 0.5, 45.0)), components(FaultValues(8.0, 80.0, 0.6, 69.0))
    found = inherent_fault(network.at(paper_rotor, 1500.0), jacobian @ other, induced, jacobian)
    assert found.converged
    assert np.allclose((found.faults - (other - induced)) / np.array([1e-6, 1e-6, 1e-3, 1e-3]), 0.0, atol=0.1)


def test_outside_the_range_is_refused(network, paper_rotor):
    with pytest.raises(ValueError, match=r"speed over the critical speed along x is 2\.\d+; the network was trained from 0\.2 to 1\.7"):
        network.at(paper_rotor, 5000.0)
    with pytest.raises(ValueError, match="with equal axes one speed cannot tell"):
        network.at(Jeffcott(1.0, 5e4, 0.01), 1500.0)
    with pytest.raises(ValueError, match="exchange the axes"):
        network.at(Jeffcott(1.0, [6e4, 5e4], 0.01, rotation="y-to-x"), 1500.0)
    with pytest.raises(ValueError, match="must end below 1"):
        train_conditioned(jax.random.key(0), rigs=Rigs(high=(1.7, 1.1, 0.05, 0.05)))


def test_same_key_same_network():
    small = [train_conditioned(jax.random.key(3), count=300, hidden=20) for _ in range(2)]
    assert np.array_equal(*(net.perceptron.weight_out for net in small))
