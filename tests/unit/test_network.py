"""The fault network: scaling, files, shapes, and what it refuses."""

import inspect
import json
import re

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from rotorjax.diagnosis.network import (
    FORMAT,
    SLACK,
    FaultNetwork,
    Format,
    Parts,
    Perceptron,
    Range,
    read_parts,
    write_parts,
)
from rotorjax.errors import InputError

FEATURES, HIDDEN, TARGETS = 4, 5, 4
WEIGHTS = HIDDEN * (FEATURES + 1) + TARGETS * (HIDDEN + 1)


@pytest.fixture
def network(rng):
    """Random weights, and ranges of the size of the paper's features [m] and faults [kg m, m]."""
    perceptron = Perceptron(
        rng.standard_normal((HIDDEN, FEATURES)),
        rng.standard_normal(HIDDEN),
        rng.standard_normal((TARGETS, HIDDEN)),
        rng.standard_normal(TARGETS),
    )
    faults = np.array([1e-3, 1e-3, 0.05, 0.05])
    return FaultNetwork(perceptron, Range(np.full(4, -0.09), np.full(4, 0.08)), Range(-faults, 0.9 * faults))


@pytest.fixture
def features(rng):
    return rng.uniform(-0.09, 0.08, (7, FEATURES))


# Scaling


def test_range_takes_smallest_and_largest_to_minus_one_and_one(rng):
    data = rng.standard_normal((30, 4)) * np.array([1e-6, 1.0, 1e3, 1.0]) + np.array([0.0, 5.0, -2.0, 1.0])
    span = Range.of(data, "features")
    scaled = np.asarray(jax.vmap(span.scaled)(jnp.asarray(data)))
    assert scaled.shape == data.shape
    assert scaled.dtype == np.float64
    np.testing.assert_allclose(scaled.min(axis=0), -1.0, atol=1e-14)
    np.testing.assert_allclose(scaled.max(axis=0), 1.0, atol=1e-14)
    np.testing.assert_array_equal(span.half, 0.5 * (data.max(axis=0) - data.min(axis=0)))


def test_unscaled_is_the_inverse(rng):
    data = rng.standard_normal((30, 4))
    span = Range.of(data, "features")
    for case in data:
        np.testing.assert_allclose(span.unscaled(span.scaled(jnp.asarray(case))), case, atol=1e-14)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_range_refuses_numbers_that_are_not_finite(bad):
    data = np.arange(12.0).reshape(3, 4)
    data[1, 2] = bad
    with pytest.raises(ValueError, match="faults: not all numbers are finite; leave those cases out"):
        Range.of(data, "faults")


def test_range_refuses_a_constant_column_and_names_it():
    data = np.arange(12.0).reshape(3, 4)
    data[:, 2] = 7.0
    with pytest.raises(ValueError, match=r"features: column 3 is constant \(7\).*draw cases that vary it"):
        Range.of(data, "features")


# Values


def test_value_is_the_formula(network, features):
    p, low, high = network.perceptron, np.asarray(network.outputs.low), np.asarray(network.outputs.high)
    x = 2.0 * (features + 0.09) / 0.17 - 1.0
    y = np.tanh(x @ np.asarray(p.weight_in).T + np.asarray(p.bias_in)) @ np.asarray(p.weight_out).T + np.asarray(
        p.bias_out
    )
    np.testing.assert_allclose(network.diagnose(features), low + (y + 1.0) * (high - low) / 2.0, rtol=1e-12, atol=1e-16)
    assert p.size == WEIGHTS


def test_compiled_is_eager_and_vmap_is_the_loop(network, features):
    one = jnp.asarray(features[0])
    eager = network(one)
    assert eager.shape == (4,)
    assert eager.dtype == jnp.float64
    loop = np.stack([np.asarray(network(jnp.asarray(case))) for case in features])
    tolerance = 1e-14 * np.max(np.abs(loop))
    np.testing.assert_allclose(eqx.filter_jit(network)(one), eager, rtol=0.0, atol=tolerance)
    np.testing.assert_allclose(jax.vmap(network)(jnp.asarray(features)), loop, rtol=0.0, atol=tolerance)
    np.testing.assert_allclose(network.diagnose(features), loop, rtol=0.0, atol=tolerance)


def test_derivative_is_finite_and_that_of_differences(network, features):
    point, step = jnp.asarray(features[0]), 1e-6
    jacobian = np.asarray(jax.jacfwd(network)(point))
    assert np.all(np.isfinite(jacobian))
    differences = np.stack(
        [(network(point + step * axis) - network(point - step * axis)) / (2.0 * step) for axis in jnp.eye(4)], axis=1
    )
    np.testing.assert_allclose(jacobian, differences, rtol=1e-6, atol=1e-8 * np.max(np.abs(jacobian)))
    by_weights = eqx.filter_grad(lambda net: jnp.sum(net(point) ** 2))(network)
    assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(by_weights))


def test_diagnose_keeps_the_shape_of_the_cases(network, features):
    many = network.diagnose(features)
    assert isinstance(many, np.ndarray)
    np.testing.assert_allclose(network.diagnose(features[2]), many[2], rtol=1e-12)
    cube = network.diagnose(features[:6].reshape(2, 3, 4))
    assert cube.shape == (2, 3, 4)
    np.testing.assert_allclose(cube.reshape(6, 4), many[:6], rtol=1e-12)


@pytest.mark.parametrize("shape", [(3,), (5, 3), (4, 5)])
def test_diagnose_refuses_another_shape(network, shape):
    unchecked = inspect.unwrap(FaultNetwork.diagnose)
    with pytest.raises(
        ValueError,
        match=rf"features have shape {re.escape(str(shape))}: give f1, f2, f3, f4 along the last axis, in metres",
    ):
        unchecked(network, np.zeros(shape))


def test_diagnose_refuses_what_is_not_finite_and_names_it(network, features):
    features[4, 1] = np.nan
    with pytest.raises(ValueError, match="feature f2 of case 4 is not finite: leave that case out"):
        network.diagnose(features)
    with pytest.raises(ValueError, match="feature f2 is not finite"):
        network.diagnose(features[4])


# The range trained


def test_within_is_where_every_feature_lies_in_the_range(network, features):
    inside = network.within(features)
    assert inside.shape == (7,)
    assert inside.dtype == bool
    assert inside.all()
    for column in range(FEATURES):
        for beyond in (-0.0901, 0.0801):
            moved = features.copy()
            moved[3, column] = beyond
            assert network.within(moved).tolist() == [True, True, True, False, True, True, True]


@pytest.mark.parametrize("end", ["low", "high"])
def test_within_grants_rounding_and_no_more(network, end):
    sign = {"low": -1.0, "high": 1.0}[end]
    at, half = np.asarray(getattr(network.inputs, end)), np.asarray(network.inputs.half)
    assert network.within(at)
    assert network.within(at + sign * 0.9 * SLACK * half)
    for column in np.eye(FEATURES):
        assert not network.within(at + sign * 1.1 * SLACK * half * column)
        assert network.within(at - sign * 1.1 * SLACK * half * column)


def test_within_holds_for_all_cases_trained(network, rng):
    data = rng.standard_normal((200, 4)) * np.array([1e-6, 1.0, 1e3, 1.0]) + np.array([0.0, 5.0, -2.0, 1.0])
    trained = FaultNetwork(network.perceptron, Range.of(data, "features"), network.outputs)
    assert trained.within(data).all()


def test_within_keeps_the_shape_of_the_cases(network, features):
    features[1, 2] = 1.0
    assert network.within(features[:6].reshape(2, 3, 4)).tolist() == [[True, False, True], [True, True, True]]
    assert network.within(features[1]).shape == ()
    assert network.within(features[:0]).shape == (0,)
    assert network.diagnose(features[:0]).shape == (0, 4)


def test_within_refuses_what_diagnose_refuses(network, features):
    with pytest.raises(
        ValueError, match=r"features have shape \(3,\): give f1, f2, f3, f4 along the last axis, in metres"
    ):
        inspect.unwrap(FaultNetwork.within)(network, np.zeros(3))
    features[4, 1] = np.nan
    with pytest.raises(ValueError, match="feature f2 of case 4 is not finite: leave that case out"):
        network.within(features)


# Files


def test_saved_and_loaded_is_the_same_to_the_last_bit(network, features, tmp_path):
    path = tmp_path / "network.json"
    network.save(path)
    again = FaultNetwork.load(path)
    for mine, theirs in zip(jax.tree.leaves(network), jax.tree.leaves(again), strict=True):
        np.testing.assert_array_equal(mine, theirs)
        assert mine.dtype == theirs.dtype
    np.testing.assert_array_equal(again.diagnose(features), network.diagnose(features))
    again.save(tmp_path / "again.json")
    assert (tmp_path / "again.json").read_bytes() == path.read_bytes()


def without_bias(content):
    del content["perceptron"]["bias_in"]


def without_outputs(content):
    del content["outputs"]


def of_another_version(content):
    content["format"] = FORMAT._replace(version=FORMAT.version + 1).mark


def of_another_kind(content):
    content["format"] = FORMAT._replace(kind="conditioned network").mark


def of_words(content):
    content["perceptron"]["weight_in"] = [["one", "two"]]


def of_too_many_weights(content):
    content["perceptron"]["weight_out"].append([0.0] * HIDDEN)


def of_too_few_ranges(content):
    content["inputs"] = {"low": [0.0], "high": [1.0]}


def of_one_row(content):
    content["perceptron"]["weight_in"] = content["perceptron"]["weight_in"][0]


def with_more(content):
    content["inputs"]["middle"] = [0.0]


CHANGES = [
    without_bias,
    without_outputs,
    of_another_version,
    of_another_kind,
    of_words,
    of_too_many_weights,
    of_too_few_ranges,
    of_one_row,
    with_more,
]


@pytest.mark.parametrize("change", CHANGES)
def test_a_changed_file_is_refused(network, tmp_path, change):
    path = tmp_path / "network.json"
    network.save(path)
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))
    with pytest.raises(
        ValueError, match=r"network\.json: not a network that rotorjax wrote .*; train it anew and save it"
    ):
        FaultNetwork.load(path)


@pytest.mark.parametrize(
    "content", [b"", b"a,b\n1,2\n", b"[1, 2]", b"7", b"{}", b'{"format": "other"}', b"\xff\xfe\x00"]
)
def test_another_file_is_refused(tmp_path, content):
    path = tmp_path / "other.json"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=r"other\.json: (not a network that rotorjax wrote|encoded as UTF-16)"):
        FaultNetwork.load(path)


def test_the_layout_is_nested(network, tmp_path):
    network.save(tmp_path / "network.json")
    content = json.loads((tmp_path / "network.json").read_text())
    assert {name: list(part) for name, part in content.items() if name != "format"} == {
        "perceptron": ["weight_in", "bias_in", "weight_out", "bias_out"],
        "inputs": ["low", "high"],
        "outputs": ["low", "high"],
    }
    assert content["format"] == "rotorjax network 2"


def test_the_flat_layout_of_before_is_named(tmp_path):
    path = tmp_path / "old.json"
    path.write_text('{"format": "rotorjax network 1", "weight_in": [[1.0]]}')
    with pytest.raises(
        ValueError,
        match=r"its format is 'rotorjax network 1' instead of 'rotorjax network 2'.*; train it anew and save it",
    ):
        FaultNetwork.load(path)


def test_a_format_of_other_ends_is_refused(network, tmp_path):
    path, parts = tmp_path / "network.json", Parts(network.perceptron, network.inputs, network.outputs)
    write_parts(path, Format("test", 1), parts)
    assert read_parts(path, Format("test", 1, (FEATURES, TARGETS))).perceptron.size == WEIGHTS
    with pytest.raises(
        ValueError,
        match=r"network\.json: not a test that rotorjax wrote \(it leads from 4 numbers to 4 instead of 2 to 4\)",
    ):
        read_parts(path, Format("test", 1, (2, TARGETS)))


def test_saving_into_a_missing_folder_is_refused(network, tmp_path):
    with pytest.raises(InputError, match="choose a folder that exists"):
        network.save(tmp_path / "missing" / "network.json")
