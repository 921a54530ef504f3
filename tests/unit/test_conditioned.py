"""One network for any speed of a range: beside the exact inverse, its symmetries, refusals, and its file."""

import json
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from rotorjax import Jeffcott
from rotorjax.diagnosis.compensation import inherent_fault
from rotorjax.diagnosis.conditioned import ConditionedNetwork, Ratios, train_conditioned
from rotorjax.diagnosis.features import FaultValues, components, feature_map, inverse_map
from rotorjax.diagnosis.network import SLACK
from rotorjax.units import RPM

COMMITTED = Path(__file__).parents[2] / "benchmarks" / "results" / "conditioned.json"
NOISE = 1e-7
"""Standard error of a feature [m]."""
SPEEDS = (600.0, 1000.0, 1500.0, 2000.0, 2197.3, 2250.0, 2307.1, 2500.0, 3000.0, 3500.0)
"""Both critical speeds of the paper's rotor among them, and one between."""


@pytest.fixture(scope="module")
def network():
    return train_conditioned(jax.random.key(11))


def relative(found, exact):
    return max(
        np.linalg.norm(found[rows] - exact[rows]) / np.linalg.norm(exact[rows]) for rows in (slice(0, 2), slice(2, 4))
    )


@pytest.mark.parametrize("speed", SPEEDS)
def test_within_a_hundredth_of_the_exact_inverse(network, paper_rotor, speed):
    """Of its standard error at 0.1 µm, for a fault of 10 g mm and 0.5 mm, on the critical speeds too."""
    fault = components(FaultValues(10.0, 67.5, 0.5, 45.0))
    ours, exact = np.asarray(network.at(paper_rotor, speed).matrix), inverse_map(paper_rotor, speed)
    bias = ours @ feature_map(paper_rotor, speed)[0] @ fault - fault
    error = np.sqrt(NOISE**2 * np.sum(ours**2, axis=1) + bias**2)
    assert np.all(error < 1.01 * NOISE * np.sqrt(np.sum(exact**2, axis=1)))


@pytest.mark.parametrize("seed", range(5))
def test_any_key_learns_it(paper_rotor, seed):
    found = train_conditioned(jax.random.key(seed))
    assert (
        max(relative(np.asarray(found.at(paper_rotor, s).matrix), inverse_map(paper_rotor, s)) for s in SPEEDS) < 1e-6
    )


@pytest.mark.parametrize("rotation", ["x-to-y", "y-to-x"])
def test_other_rigs(network, rng, rotation):
    """Random rigs, either axis the stiffer, either sense of rotation."""
    for _ in range(10):
        ratio, mass, stiffness = rng.uniform(0.85, 1.0 / 0.85), rng.uniform(0.5, 50.0), 10.0 ** rng.uniform(4.0, 7.0)
        rotor = Jeffcott(mass, [stiffness, stiffness * ratio**2], rng.uniform(0.002, 0.05, 2), rotation=rotation)
        low, high = network.speeds_rpm(rotor)
        speed = rng.uniform(low, high)
        assert relative(np.asarray(network.at(rotor, speed).matrix), inverse_map(rotor, speed)) < 1e-6


def test_speed_of_each_case(network, paper_rotor, rng):
    faults = rng.standard_normal((len(SPEEDS), 4)) * np.array([1e-5, 1e-5, 1e-3, 1e-3])
    f = np.einsum("nij,nj->ni", feature_map(paper_rotor, SPEEDS), faults)
    found = network.diagnose(paper_rotor, SPEEDS, f)
    assert found.shape == faults.shape
    assert np.allclose(found, faults, rtol=0.0, atol=1e-8)
    assert np.allclose(found[2], network.diagnose(paper_rotor, SPEEDS[2], f[2]), rtol=1e-12)
    with pytest.raises(ValueError, match="give one speed, or one for each case"):
        network.diagnose(paper_rotor, SPEEDS[:2], f)


def test_linear_in_the_features(network, paper_rotor, rng):
    f, g = rng.standard_normal((2, 3, 4))
    both = network.diagnose(paper_rotor, 1500.0, 2.0 * f - 3.0 * g)
    assert np.allclose(
        both,
        2.0 * network.diagnose(paper_rotor, 1500.0, f) - 3.0 * network.diagnose(paper_rotor, 1500.0, g),
        rtol=1e-10,
    )


def test_derivatives(network, paper_rotor):
    """With respect to speed as the exact inverse has it, by finite differences; finite in the rotor; jit gives the
    same.
    """
    slope = jax.jit(jax.jacfwd(lambda speed: network.matrix(paper_rotor, speed)))(jnp.asarray(1500.0 * RPM))
    exact = (inverse_map(paper_rotor, 1500.5) - inverse_map(paper_rotor, 1499.5)) / RPM
    assert relative(np.asarray(slope), exact) < 1e-4
    f = jnp.array([1e-5, 2e-5, -1e-5, 3e-5])
    gradient = eqx.filter_jit(jax.grad(lambda rotor: jnp.sum(network(f, jnp.asarray(150.0), rotor))))(paper_rotor)
    assert all(np.all(np.isfinite(np.asarray(leaf))) for leaf in jax.tree.leaves(gradient))
    assert np.allclose(
        eqx.filter_jit(network)(f, jnp.asarray(150.0), paper_rotor),
        network(f, jnp.asarray(150.0), paper_rotor),
        rtol=1e-9,
    )


def test_serves_compensation(network, paper_rotor):
    jacobian = feature_map(paper_rotor, 1500.0)[0]
    induced, other = components(FaultValues(6.0, 67.5, 0.5, 45.0)), components(FaultValues(8.0, 80.0, 0.6, 69.0))
    found = inherent_fault(network.at(paper_rotor, 1500.0), jacobian @ other, induced, jacobian)
    assert found.converged
    assert np.allclose((found.faults - (other - induced)) / np.array([1e-6, 1e-6, 1e-3, 1e-3]), 0.0, atol=1e-3)


def test_outside_the_range_is_refused(network, paper_rotor):
    for speed in (5000.0, 300.0, float("nan")):
        with pytest.raises(ValueError, match="for this rotor the network serves 461 to 4395 rpm"):
            network.at(paper_rotor, speed)
    assert np.all(np.isnan(np.asarray(network.matrix(paper_rotor, jnp.asarray(5000.0 * RPM)))))
    with pytest.raises(ValueError, match=r"damping ratios are 0\.01 and 0\.2; the network was trained from 0 to 0\.05"):
        network.at(Jeffcott(1.0, [6e4, 5e4], [0.01, 0.2]), 1500.0)
    with pytest.raises(ValueError, match="without bow_through_damping"):
        network.at(Jeffcott(1.0, [6e4, 5e4], 0.01, bow_through_damping=True), 1500.0)


def test_within_is_where_it_serves(network, paper_rotor):
    low, high = network.speeds_rpm(paper_rotor)
    speeds = np.array([[low - 1.0, low + 1.0, 1500.0], [high - 1.0, high + 1.0, np.nan]])
    inside = network.within(paper_rotor, speeds)
    assert inside.dtype == bool
    assert inside.tolist() == [[False, True, True], [True, False, False]]
    assert network.within(paper_rotor, 1500.0).shape == ()
    finite = np.isfinite(
        np.asarray(jax.vmap(lambda s: network.matrix(paper_rotor, s))(jnp.asarray(speeds.ravel() * RPM)))
    ).all(axis=(1, 2))
    assert finite.tolist() == inside.ravel().tolist()
    assert not network.within(Jeffcott(1.0, [6e4, 5e4], [0.01, 0.2]), speeds).any()
    assert network.within(Jeffcott(1.0, [6e4, 5e4], [0.0, 0.05]), 1500.0)


@pytest.mark.parametrize("end", [0, 1])
def test_within_diagnose_and_matrix_agree_at_the_ends(network, paper_rotor, end):
    """Rounding is granted by all three, and no more."""
    edge, sign = network.speeds_rpm(paper_rotor)[end], (-1.0, 1.0)[end]
    half, ratio = 0.5 * (2.0 - 0.2), (0.2, 2.0)[end]
    for share, served in ((0.0, True), (0.9, True), (1.1, False)):
        speed = edge * (1.0 + sign * share * SLACK * half / ratio)
        assert network.within(paper_rotor, speed) == served
        assert np.isfinite(np.asarray(network.matrix(paper_rotor, jnp.asarray(speed * RPM)))).all() == served
        if served:
            assert np.isfinite(network.diagnose(paper_rotor, speed, np.ones(4))).all()
        else:
            with pytest.raises(ValueError, match="for this rotor the network serves"):
                network.diagnose(paper_rotor, speed, np.ones(4))


def test_equal_axes_are_refused(network):
    with pytest.raises(
        ValueError, match="unbalance and bow cannot be told apart at 1500 rpm: the axes are equally stiff"
    ):
        network.diagnose(Jeffcott(1.0, 5e4, 0.01), 1500.0, np.ones(4))
    with pytest.raises(ValueError, match=r"stiffnesses differ by 0\.02 %, less than the 0\.1 % served"):
        network.at(Jeffcott(1.0, [5e4, 5e4 * (1.0 - 2e-4)], 0.01), 1500.0)
    assert np.all(np.isnan(np.asarray(network.matrix(Jeffcott(1.0, 5e4, 0.01), jnp.asarray(150.0)))))


def test_what_cannot_be_trained():
    with pytest.raises(ValueError, match="a range runs upwards"):
        Ratios(speed=(2.0, 0.2))
    with pytest.raises(ValueError, match="begin above 0"):
        Ratios(speed=(0.0, 2.0))
    with pytest.raises(ValueError, match="too few for 40 neurons"):
        train_conditioned(jax.random.key(0), count=10)


def test_saved_and_loaded(network, paper_rotor, tmp_path):
    path = tmp_path / "network.json"
    network.save(path)
    loaded = ConditionedNetwork.load(path)
    assert np.array_equal(loaded.at(paper_rotor, 1500.0).matrix, network.at(paper_rotor, 1500.0).matrix)
    content = json.loads(path.read_text(encoding="utf-8"))
    four = {"weight_in": [[0.0] * 4], "bias_in": [0.0], "weight_out": [[0.0]] * 4, "bias_out": [0.0] * 4}
    span = {"low": [0.0] * 4, "high": [1.0] * 4}
    for broken in (
        {},
        {**content, "format": "other"},
        {**content, "format": "rotorjax network 2"},
        {**content, "inputs": content["perceptron"]},
        {**content, "outputs": {"low": [0.0], "high": [1.0]}},
        {**content, "perceptron": four, "inputs": span, "outputs": span},
    ):
        path.write_text(json.dumps(broken), encoding="utf-8")
        with pytest.raises(ValueError, match="not a conditioned network that rotorjax wrote"):
            ConditionedNetwork.load(path)


def test_the_committed_network_loads(paper_rotor, tmp_path):
    """What the experiment wrote: as good as a fresh one, and the same bytes when saved again."""
    loaded = ConditionedNetwork.load(COMMITTED)
    assert relative(np.asarray(loaded.at(paper_rotor, 1500.0).matrix), inverse_map(paper_rotor, 1500.0)) < 1e-6
    loaded.save(tmp_path / "again.json")
    assert (tmp_path / "again.json").read_bytes() == COMMITTED.read_bytes()


def test_same_key_same_network(network):
    assert np.array_equal(train_conditioned(jax.random.key(11)).perceptron.weight_out, network.perceptron.weight_out)
