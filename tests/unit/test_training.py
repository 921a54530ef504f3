"""Training: the normal equations, the evidence, the paper's network, why training stops, and what is refused."""

import itertools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree

from rotorjax.diagnosis.compensation import LinearInverse
from rotorjax.diagnosis.dataset import Dataset, make_dataset, split, with_noise
from rotorjax.diagnosis.evidence_steps import Epoch, Scaled, normal_equations
from rotorjax.diagnosis.network import Perceptron
from rotorjax.diagnosis.training import BayesianRegularisation, OptaxL2, Whitened, nguyen_widrow, rms_errors, train
from rotorjax.paper.printed import printed

SPEED_RPM, COUNT = 1500.0, 10_000
SIGMA, POINTS = 0.05, 200
"""Noise and number of points of the regression in one dimension."""
READINGS = {"A (kg m, m)": (1.0, 1.0), "B (g mm, mm)": (1e6, 1e3), "C (kg mm, m)": (1e3, 1.0)}
"""Units that table 1 may mean: how many of them make one kg m and one m."""
SUMMED = 1e-14
"""Relative rounding of sums over some ten samples."""


def perceptron(rng, features, hidden, targets):
    inner, outer = rng.standard_normal((hidden, features + 1)), rng.standard_normal((targets, hidden + 1))
    return Perceptron(inner[:, :-1], inner[:, -1], outer[:, :-1], outer[:, -1])


@pytest.fixture(scope="module")
def paper_data():
    """The paper's 10,000 cases at 1500 rpm."""
    from rotorjax import Jeffcott

    rotor = Jeffcott(0.9686, [56538.0, 51282.0], [0.0050, 0.0047])
    return rotor, split(make_dataset(rotor, SPEED_RPM, COUNT, key=jax.random.key(0)), key=jax.random.key(1))


@pytest.fixture(scope="module")
def default(paper_data):
    return train(paper_data[1].train, key=jax.random.key(0))


@pytest.fixture(scope="module")
def sine():
    """sin πx with noise, in one dimension."""
    draw = np.random.default_rng(20260417)
    x = np.linspace(-1.0, 1.0, POINTS)[:, None]
    return Scaled(jnp.asarray(x), jnp.asarray(np.sin(np.pi * x) + SIGMA * draw.standard_normal((POINTS, 1))))


@pytest.fixture(scope="module")
def small():
    """A few hundred cases of a linear map: enough for the refusals, and quick."""
    draw = np.random.default_rng(7)
    features = draw.uniform(-1.0, 1.0, (300, 4))
    return Dataset(features, features @ draw.standard_normal((4, 4)))


def silent(epoch, rms):
    pass


# Normal equations


@pytest.mark.parametrize(("features", "hidden", "targets"), [(4, 3, 2), (1, 5, 1), (2, 2, 4)])
def test_normal_equations_are_those_of_the_jacobian(rng, features, hidden, targets):
    net = perceptron(rng, features, hidden, targets)
    x, target = jnp.asarray(rng.standard_normal((11, features))), jnp.asarray(rng.standard_normal((11, targets)))
    flat, unravel = ravel_pytree(net)

    def error(weights):
        return (jax.vmap(unravel(weights))(x) - target).ravel()

    jacobian, e = np.asarray(jax.jacobian(error)(flat)), np.asarray(error(flat))
    found = normal_equations(net, x, target)
    assert found.gram.shape == (net.size, net.size)
    assert found.gradient.dtype == jnp.float64
    for mine, exact in ((found.gram, jacobian.T @ jacobian), (found.gradient, jacobian.T @ e), (found.squares, e @ e)):
        np.testing.assert_allclose(mine, exact, rtol=0.0, atol=SUMMED * np.max(np.abs(exact)))


def test_normal_equations_compiled_are_eager(rng):
    net, x, target = (
        perceptron(rng, 3, 4, 2),
        jnp.asarray(rng.standard_normal((9, 3))),
        jnp.asarray(rng.standard_normal((9, 2))),
    )
    compiled = normal_equations(net, x, target)
    with jax.disable_jit():
        eager = normal_equations(net, x, target)
    for one, other in zip(compiled, eager, strict=True):
        np.testing.assert_allclose(one, other, rtol=0.0, atol=SUMMED * float(jnp.max(jnp.abs(other))))


# First weights


@pytest.mark.parametrize(("features", "hidden"), [(4, 40), (1, 10)])
def test_nguyen_widrow_rows_have_their_length_and_biases_are_spread(features, hidden):
    net = nguyen_widrow(jax.random.key(3), features, hidden, 4)
    length = 0.7 * hidden ** (1.0 / features)
    np.testing.assert_allclose(np.linalg.norm(net.weight_in, axis=1), length, rtol=1e-14)
    np.testing.assert_allclose(
        np.sort(np.abs(net.bias_in)), np.sort(np.abs(length * np.linspace(-1.0, 1.0, hidden))), rtol=1e-12
    )
    assert float(jnp.max(jnp.abs(net.weight_out))) <= 1.0
    assert float(jnp.max(jnp.abs(net.bias_out))) <= 1.0
    assert net.size == hidden * (features + 1) + 4 * (hidden + 1)


# Bayesian regularisation


def test_effective_parameters_are_the_trace_formula(sine):
    """γ of step k takes α and β of step k-1 and JᵀJ of the weights after step k."""
    net, history, stopped = BayesianRegularisation(epochs=6).fit(sine, 5, jax.random.key(0), silent)
    assert stopped == "all 6 steps were made"
    assert len(history) == 6
    gram, (before, after) = np.asarray(normal_equations(net, sine.x, sine.target).gram), history[-2:]
    matrix = before.beta * gram + before.alpha * np.eye(net.size)
    assert np.linalg.cond(matrix) < 1e10
    assert after.effective == pytest.approx(net.size - before.alpha * np.trace(np.linalg.inv(matrix)), rel=1e-6)
    assert all(0.0 < epoch.effective < net.size for epoch in history)


def test_evidence_is_set_anew_after_every_step(sine):
    """β = (N - γ) / 2E_D and α = γ / 2E_W."""
    net, history, _ = BayesianRegularisation(epochs=4).fit(sine, 5, jax.random.key(0), silent)
    weights, last = np.asarray(ravel_pytree(net)[0]), history[-1]
    squares = float(np.sum((jax.vmap(net)(sine.x) - sine.target) ** 2))
    assert last.rms == pytest.approx(math.sqrt(squares / POINTS), rel=1e-12)
    assert last.beta == pytest.approx((POINTS - last.effective) / (2.0 * squares), rel=1e-10)
    assert last.alpha == pytest.approx(last.effective / (2.0 * weights @ weights), rel=1e-12)


def test_noise_is_found_and_the_cost_falls_at_every_step(sine):
    net, history, stopped = BayesianRegularisation(epochs=150).fit(sine, 10, jax.random.key(0), silent)
    assert stopped.startswith("no step lowers the cost any more") or stopped == "all 150 steps were made"
    assert 5 < len(history) <= 150
    assert 1.0 / math.sqrt(2.0 * history[-1].beta) == pytest.approx(SIGMA, rel=0.15)
    # sin needs half a dozen of the 31 weights: the rest is what regularisation takes.
    assert 4.0 < history[-1].effective < 0.6 * net.size
    truth = np.sin(np.pi * np.asarray(sine.x))
    assert math.sqrt(np.mean((np.asarray(jax.vmap(net)(sine.x)) - truth) ** 2)) < 0.4 * SIGMA
    for before, after in itertools.pairwise(history):
        assert cost(after, before) < cost(before, before) * (1.0 + 1e-12)


def cost(weights: Epoch, evidence: Epoch) -> float:
    """F = β E_D + α E_W of the weights after one epoch, with α and β of another; E_W = γ / 2α of its own epoch."""
    decay = weights.effective / (2.0 * weights.alpha)
    return evidence.beta * POINTS * weights.rms**2 + evidence.alpha * decay


def test_published_training_keeps_its_history_and_tells_its_progress(paper_data):
    told: list[tuple[int, float]] = []
    method = BayesianRegularisation(epochs=4)
    training = train(
        paper_data[1].train, key=jax.random.key(0), method=method, progress=lambda epoch, rms: told.append((epoch, rms))
    )
    assert training.stopped == "all 4 steps were made"
    assert told == [(k + 1, epoch.rms) for k, epoch in enumerate(training.history)]
    assert len(told) == 4
    assert training.history[-1].rms < training.history[0].rms
    assert all(0.0 < epoch.effective < training.network.perceptron.size == 364 for epoch in training.history)
    assert all(math.isfinite(number) and number > 0.0 for epoch in training.history for number in epoch)


# The default on the paper's data


def test_default_beats_table_1_in_every_reading(paper_data, default):
    errors = rms_errors(default.network.diagnose, paper_data[1].test)
    paper = np.array([float(row["rmse"]) for row in printed("table01_fnn_rmse")])
    for unbalance, bow in READINGS.values():
        assert np.all(errors * np.array([unbalance, unbalance, bow, bow]) < 0.1 * paper)


def test_default_stops_with_a_reason_and_returns_the_papers_network(default):
    steps = len(default.history)
    assert default.stopped == f"the error reached its target of 1e-08 after {steps} steps"
    assert steps <= 5
    p = default.network.perceptron
    assert [leaf.shape for leaf in (p.weight_in, p.bias_in, p.weight_out, p.bias_out)] == [
        (40, 4),
        (40,),
        (4, 40),
        (4,),
    ]
    assert all(leaf.dtype == jnp.float64 for leaf in jax.tree.leaves(default.network))


@pytest.mark.parametrize("level", [1e-6, 1e-5, 1e-4])
def test_default_stays_by_the_exact_inverse_on_noisy_features(paper_data, default, level):
    rotor, data = paper_data
    noisy = with_noise(data.test, jax.random.key(5), level)
    matrix = np.asarray(LinearInverse.at(rotor, SPEED_RPM).matrix)
    best = rms_errors(lambda f: np.asarray(f) @ matrix.T, noisy)
    assert np.all(rms_errors(default.network.diagnose, noisy) < 1.1 * best)


@pytest.mark.parametrize("seed", [1, 2])
def test_default_does_not_hang_on_its_seed(paper_data, seed):
    training = train(paper_data[1].train, key=jax.random.key(seed))
    assert "reached its target" in training.stopped
    np.testing.assert_array_less(rms_errors(training.network.diagnose, paper_data[1].test), [1e-11, 1e-11, 1e-9, 1e-9])


def test_same_key_same_weights(small):
    one, same, other = (train(small, key=jax.random.key(seed)).network for seed in (0, 0, 1))
    for mine, theirs in zip(jax.tree.leaves(one), jax.tree.leaves(same), strict=True):
        np.testing.assert_array_equal(mine, theirs)
    assert float(jnp.max(jnp.abs(one.perceptron.weight_in - other.perceptron.weight_in))) > 0.0


@pytest.mark.parametrize("level", [1e-6, 1e-4, 1e-2])
def test_training_on_noisy_features_stops_by_linear_regression(paper_data, level):
    _, data = paper_data
    noisy, unseen = with_noise(data.train, jax.random.key(5), level), with_noise(data.test, jax.random.key(6), level)
    training = train(noisy, key=jax.random.key(0))
    assert 0 < len(training.history) <= Whitened.epochs
    assert training.stopped.startswith(("no progress in the last", "no step lowers the cost", "all 100 steps"))
    regression = np.linalg.lstsq(extended(noisy.features), np.asarray(noisy.faults), rcond=None)[0]
    best = rms_errors(lambda f: extended(f) @ regression, unseen)
    assert np.all(rms_errors(training.network.diagnose, unseen) < 1.02 * best)


def extended(features):
    return np.concatenate([np.asarray(features), np.ones((len(features), 1))], axis=1)


def test_default_holds_a_weak_cubic_part(rng):
    """What is odd and weakly curved needs no step: the curvature of the nearly linear neurons takes it."""
    features = rng.uniform(-1.0, 1.0, (600, 4))
    faults = features @ rng.standard_normal((4, 4)) + 0.1 * (features @ rng.standard_normal((4, 4))) ** 3
    data = Dataset(features, faults)
    training = train(data, key=jax.random.key(0), method=Whitened(epochs=0))
    assert training.stopped == "all 0 steps were made"
    assert training.history == ()
    regression = np.linalg.lstsq(extended(features), faults, rcond=None)[0]
    best = rms_errors(lambda f: extended(f) @ regression, data)
    assert np.all(rms_errors(training.network.diagnose, data) < 0.25 * best)


def test_evidence_steps_of_the_default_lower_the_error_and_end_without_progress(rng):
    x = rng.uniform(-1.0, 1.0, (POINTS, 2))
    data = Scaled(jnp.asarray(x), jnp.asarray(np.sin(3.0 * x[:, :1] + x[:, 1:])))
    _, history, stopped = Whitened(patience=3).fit(data, 10, jax.random.key(0), silent)
    assert stopped == f"no progress in the last 3 of {len(history)} steps"
    assert 3 < len(history) < Whitened.epochs
    assert history[-1].rms > 0.99 * history[-4].rms
    assert history[-1].rms < history[0].rms


# Optax


def test_optax_lowers_the_error(small):
    told = []
    training = train(
        small,
        key=jax.random.key(0),
        method=OptaxL2(steps=200),
        hidden=10,
        progress=lambda epoch, rms: told.append(epoch),
    )
    assert training.stopped == "all 200 steps were made"
    assert told == [100, 200]
    assert len(training.history) == 2
    start = nguyen_widrow(jax.random.key(0), 4, 10, 4)
    inputs = jax.vmap(training.network.inputs.scaled)(jnp.asarray(small.features))
    outputs = jax.vmap(training.network.outputs.scaled)(jnp.asarray(small.faults))
    before = math.sqrt(float(jnp.mean((jax.vmap(start)(inputs) - outputs) ** 2)))
    assert training.history[-1].rms < training.history[0].rms < 0.1 * before


# Refusals


def test_single_precision_is_refused(small):
    with (
        jax.enable_x64(False),
        pytest.raises(
            ValueError, match=r'training needs double precision: jax\.config\.update\("jax_enable_x64", True\)'
        ),
    ):
        train(small, key=jax.random.key(0))


@pytest.mark.parametrize("part", ["features", "faults"])
def test_constant_columns_are_refused(small, part):
    values = np.array(getattr(small, part))
    values[:, 3] = 0.5
    with pytest.raises(ValueError, match=rf"{part}: column 4 is constant \(0\.5\).*draw cases that vary it"):
        train(small._replace(**{part: values}), key=jax.random.key(0))


@pytest.mark.parametrize("part", ["features", "faults"])
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_numbers_that_are_not_finite_are_refused(small, part, bad):
    values = np.array(getattr(small, part))
    values[17, 0] = bad
    with pytest.raises(ValueError, match=f"{part}: not all numbers are finite; leave those cases out"):
        train(small._replace(**{part: values}), key=jax.random.key(0))


def test_too_few_cases_are_refused(small):
    few = Dataset(small.features[:90], small.faults[:90])
    with pytest.raises(
        ValueError,
        match=r"90 cases hold no more numbers than the network has weights \(364\): draw more cases, or take fewer "
        r"neurons",
    ):
        train(few, key=jax.random.key(0))
    assert train(few, key=jax.random.key(0), hidden=10).network.perceptron.size == 94


def test_dependent_features_are_refused(small):
    features = np.array(small.features)
    features[:, 3] = features[:, 0] - 2.0 * features[:, 1]
    with pytest.raises(
        ValueError,
        match="some features are linear combinations of others: the cases do not show all faults; draw them anew",
    ):
        train(small._replace(features=features), key=jax.random.key(0))
