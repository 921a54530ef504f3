"""Comparison, noise and what is known of it, in small cases worked out by hand."""

import dataclasses

import numpy as np
import pytest

from rotorjax import (
    Conditions,
    Jeffcott,
    Knowledge,
    Layout,
    Measurement,
    Model,
    Probes,
    compare,
    diagnose,
    effects,
    explain,
    fit,
    response,
)
from rotorjax.data.measurement import cluster_speeds
from rotorjax.discovery.compare import compare_vectors
from rotorjax.inference.data import make_folds
from rotorjax.inference.noise import NO_NOISE, run_floor, scatter_share


def measurement_of(z, *, sigma=1e-6, orders=(1.0,), runs=None, speeds=None, **changes) -> Measurement:
    z = np.asarray(z, complex)
    runs = np.zeros(len(z), int) if runs is None else np.asarray(runs)
    speeds = 1000.0 + 100.0 * np.arange(len(z)) if speeds is None else speeds
    names = tuple("abcdefghijklmnopqrstuvwxyz"[: runs.max() + 1])
    given = None if sigma is None else np.full(z.shape, sigma)
    made = Measurement.from_arrays(z, Conditions.at_rpm(speeds), run=runs, runs=names, orders=orders, sigma=given)
    return dataclasses.replace(made, **changes)


def held(predicted, measurement):
    return compare_vectors(predicted, measurement, Model(Jeffcott(1.0, 5e4, 0.02)))


def test_residuals_and_where():
    z = np.array([[[3e-6 + 4e-6j], [0.0]], [[1e-6], [1e-6j]]])
    view = held(np.zeros_like(z, complex), measurement_of(z))
    assert view.rms == pytest.approx(np.sqrt((25 + 0 + 1 + 1) / 4) * 1e-6)
    assert view.reduced_chi2 == pytest.approx(27 / 8)
    worst = view.where()[0]
    assert (worst.run, worst.probe, worst.residual_um, worst.standardised) == (
        "a",
        "X",
        pytest.approx(5.0),
        pytest.approx(5.0),
    )
    assert worst.amplitude_ratio == 0.0
    assert worst.phase_error_deg is None
    share = view.share()
    assert share["probe"] == pytest.approx({"X": 26 / 27, "Y": 1 / 27})
    assert share["speed"] == pytest.approx({"1000": 25 / 27, "1100": 2 / 27})


def test_amplitude_ratio_and_phase_error():
    z = np.array([[[2e-6], [2e-6]]])
    cell = held(z * 1.1 * np.exp(0.1j), measurement_of(z)).where()[0]
    assert cell.amplitude_ratio == pytest.approx(1.1)
    assert cell.phase_error_deg == pytest.approx(np.degrees(0.1))


def test_unknown_noise_and_absent_cells():
    z = np.array([[[2e-6], [1e-6]]])
    present = np.array([[[True], [False]]])
    view = held(np.zeros_like(z, complex), measurement_of(z, sigma=None, present=present))
    assert view.reduced_chi2 is None
    assert view.where()[0].standardised is None
    assert view.rms == pytest.approx(2e-6)
    assert len(view.where()) == 1


def test_half_orders_are_compared_up_to_their_sign():
    z = np.array([[[1e-6 + 1e-6j], [2e-6]]])
    view = held(-z, measurement_of(z, orders=(0.5,)))
    assert view.rms == pytest.approx(0.0, abs=1e-20)


def test_order_zero_counts_once():
    z = np.array([[[1e-6], [-1e-6]]])
    view = held(np.zeros_like(z, complex), measurement_of(z, orders=(0.0,)))
    assert view.reduced_chi2 == pytest.approx(1.0)


def test_tolerance_widens_the_noise():
    z = np.array([[[30e-6], [40e-6]]])
    knowledge = Knowledge(tolerance=0.1)
    weight = measurement_of(z, sigma=1e-6, knowledge=knowledge).weights(0.0)
    np.testing.assert_allclose(weight, 1.0 / np.sqrt(1e-12 + 25e-12))


def test_probes_must_match(paper_rotor):
    model = Model(paper_rotor, Probes([0.0], [1.0], [0.0]), layout=Model(paper_rotor).layout._replace(probes=("X",)))
    with pytest.raises(ValueError, match="the model has probes"):
        compare(model, measurement_of([[[1e-6], [1e-6]]]))
    with pytest.raises(ValueError, match="the model has probes"):
        fit(model + effects.ResidualBow(), measurement_of([[[1e-6], [1e-6]]]))


def test_planes_must_match():
    """Weights meant case by case, and one weight on a rotor of two planes: neither is repeated in silence, whatever
    programs for two planes are at hand.
    """
    weights = np.array([[0.0, 0.0], [3e-5, 0.0], [0.0, 3e-5]])
    rows, cases = (Conditions.at_rpm([1000.0] * 3, unbalance=u) for u in (weights, weights[:, None]))
    assert len(set(np.asarray(response(ROTOR, cases))[:, 0, 0].tolist())) == 3
    for model in (ROTOR, ROTOR + effects.Duffing(1e9)):
        with pytest.raises(ValueError, match=r"for 3 planes, the model has 1: .* u\[:, None\]"):
            response(model, rows)
    two = Model(ROTOR, participation=[1.0, 0.5], layout=Layout(planes=("a", "b")))
    vectors, runs = np.full((3, 2, 1), 1e-6 + 0j), {"run": np.arange(3), "runs": ("none", "x", "y"), "sigma": 1e-6}
    measurement = Measurement.from_arrays(vectors, cases, **runs)
    both = Conditions.at_rpm([1000.0] * 3, unbalance=np.repeat(weights[:, None], 2, axis=1))
    diagnose(two, Measurement.from_arrays(vectors, both, **runs))
    for ask in (compare, diagnose, lambda *given: explain(*given, only=["residual_unbalance"])):
        with pytest.raises(ValueError, match="for 1 plane, the model has 2: give a pair"):
            ask(two, measurement)


@pytest.mark.parametrize("what", ["unbalance", "bow"])
@pytest.mark.parametrize(
    ("value", "words"),
    [(3e-5, "one number: its last axis"), (3e-5j, "complex: write u as"), ([1.0, 2.0, 3.0], r"of shape \(3,\)")],
)
def test_what_is_installed_is_a_pair_along_x_and_y(what, value, words):
    with pytest.raises(ValueError, match=f"{what} is {words}"):
        Conditions.at([100.0], **{what: value})
    assert not np.any(getattr(Conditions.at([100.0], **{what: 0}), what))


def test_speeds_within_two_percent_are_one():
    index, speeds = cluster_speeds(np.array([1500.0, 1001.0, 1000.0, 1510.0, 1019.0]))
    np.testing.assert_array_equal(index, [1, 0, 0, 1, 0])
    np.testing.assert_allclose(speeds, [1006.67, 1505.0], rtol=1e-3)


def test_folds():
    def folds(measurement):
        return make_folds(measurement, np.ones((len(measurement.run), 1, 1)))

    assert folds(measurement_of(np.ones((10, 2, 1)), runs=np.repeat(np.arange(5), 2)))[0].shape == (5, 10)
    few = measurement_of(np.ones((2, 2, 1)), runs=[0, 1])
    none, reason = folds(dataclasses.replace(few, conditions=Conditions.at_rpm([1000.0, 1001.0])))
    assert len(none) == 0
    assert "2 runs at 1 speed leave" in reason
    assert folds(measurement_of(np.ones((4, 2, 1))))[0].sum() == 4
    # Of five runs named two have a case: that is no fold over runs.
    gaps = measurement_of(np.ones((6, 2, 1)), runs=[0, 0, 0, 1, 1, 1], speeds=np.tile([1000.0, 1200.0, 1400.0], 2))
    gaps = dataclasses.replace(gaps, run=4 * gaps.run, runs=tuple("abcde"))
    assert [list(fold.nonzero()[0]) for fold in folds(gaps)[0]] == [[0, 3], [1, 4], [2, 5]]


def test_a_fold_that_would_lose_what_only_one_run_shows_is_refused():
    """Five runs, one of which alone shows the second parameter: folds go over speeds instead."""
    runs = np.repeat(np.arange(5), 3)
    measurement = measurement_of(np.ones((15, 2, 1)), runs=runs, speeds=np.tile([1000.0, 1200.0, 1400.0], 5))
    information = np.zeros((15, 2, 2))
    information[:, 0, 0] = 1.0
    information[runs == 4, 1, 1] = 1.0
    folds, _ = make_folds(measurement, information)
    assert len(folds) == 3


def test_scatter_between_runs_is_found(paper_rotor, rng):
    """A random unbalance of 2 g mm per component in each of 24 runs."""
    count = 24
    runs = np.repeat(np.arange(count), 2)
    speeds = np.tile([1200.0, 1700.0], count)
    random = rng.normal(0.0, 2e-6, (count, 1, 2))[runs]
    z = np.asarray(response(paper_rotor, Conditions.at_rpm(speeds, unbalance=random)))
    sigma = 0.05e-6
    z = z + sigma * (rng.standard_normal(z.shape) + 1j * rng.standard_normal(z.shape))
    measurement = measurement_of(z, sigma=sigma, runs=runs, speeds=speeds)
    found = run_floor(measurement, Model(paper_rotor), z)
    assert found.scatter.unbalance_kg_m == pytest.approx(2e-6, rel=0.25)
    assert found.scatter.bow_m == 0.0
    assert found.allowance == 0.0
    assert scatter_share(measurement, Model(paper_rotor), z, found.scatter) > 0.95
    quiet = run_floor(
        measurement,
        Model(paper_rotor),
        z - z + sigma * (rng.standard_normal(z.shape) + 1j * rng.standard_normal(z.shape)),
    )
    assert quiet == NO_NOISE


def test_fit_names_what_is_missing(paper_rotor):
    with pytest.raises(ValueError, match="the model has no 'cross_coupling' to fit"):
        fit(Model(paper_rotor), measurement_of([[[1e-6], [1e-6]]]), free=("cross_coupling",))


@pytest.mark.parametrize("sigma", [1e-9, 1e-3, None])
def test_hopeless_data_get_a_verdict(sigma):
    """One run, one speed, all zero, sigma far off or absent: finite numbers and a result, no traceback."""
    rotor = Jeffcott(1.0, 5e4, 0.02)
    for z in (np.zeros((1, 2, 1)), np.full((1, 2, 1), 1e-6 + 1e-6j)):
        found = fit(rotor + effects.ResidualUnbalance(), measurement_of(z, sigma=sigma))
        assert found.result
        assert found.held_out_rms is None
        assert found.held_out_reason
        assert all(np.isfinite([e.value, e.standard_error]).all() for e in found.estimates)


ROTOR = Jeffcott(0.97, [56500.0, 51300.0], 0.02)


def made(model, speeds, *, runs=1, unbalance=0.0, sigma=0.3e-6, seed=0, knowledge=None, true=None) -> Measurement:
    """What a model shows, with noise; ``unbalance`` is declared installed, ``true`` really is."""
    index = np.repeat(np.arange(runs), len(speeds))
    installed = np.broadcast_to(unbalance, (runs, 1, 2))[index]
    really = installed if true is None else np.broadcast_to(true, (runs, 1, 2))[index]
    rpm = np.tile(speeds, runs)
    z = np.asarray(response(model, Conditions.at_rpm(rpm, unbalance=really)))
    rng = np.random.default_rng(seed)
    z = z + sigma * (rng.standard_normal(z.shape) + 1j * rng.standard_normal(z.shape))
    made = measurement_of(z, sigma=sigma, runs=index, speeds=rpm, knowledge=knowledge or Knowledge())
    return dataclasses.replace(made, conditions=Conditions.at_rpm(rpm, unbalance=installed))


@pytest.mark.parametrize("size", [100e-6, 300e-6])
def test_few_cells_far_from_the_null(size):
    """One run at one speed, an unbalance of several prior scales: the prior must not rule."""
    found = fit(ROTOR + effects.ResidualUnbalance(), made(Model(ROTOR), [1500.0], true=[size, 0.0]))
    assert found.converged
    assert found.estimate("residual_unbalance", "unbalance_x_kg_m").value == pytest.approx(size, rel=0.02)
    assert found.misfit == 0.0


def test_gain_far_from_the_null():
    measurement = made(ROTOR + effects.ChainGain(-2.0, 0.1), np.linspace(900, 2800, 8), runs=3, unbalance=[30e-6, 0.0])
    found = fit(ROTOR + effects.ChainGain(), measurement)
    assert found.estimate("chain_gain", "gain_real").value == pytest.approx(-2.0, abs=0.02)
    assert found.reduced_chi2 == pytest.approx(1.0, abs=0.4)


def test_what_all_runs_share_is_no_scatter():
    measurement = made(ROTOR + effects.ResidualUnbalance(20e-6, 0.0), [1200.0, 1700.0], runs=6)
    assert run_floor(measurement, Model(ROTOR), measurement.vectors) == NO_NOISE


def test_an_effect_that_acts_alike_in_all_runs_is_no_scatter():
    """A phase reference offset misplaces every weight: it differs between runs, but influence coefficients hold it."""
    weights = [[4e-6, 0.0], [30e-6, 0.0], [-15e-6, 26e-6], [1e-6, -20e-6], [10e-6, 10e-6]]
    true = ROTOR + effects.PhaseReferenceOffset(0.5)
    measurement = made(true, [1200.0, 1700.0, 2500.0], runs=5, unbalance=np.array(weights)[:, None])
    assert run_floor(measurement, Model(ROTOR), measurement.vectors) == NO_NOISE


def test_declared_scatter_of_the_weights_is_no_misfit(rng):
    """Weights off by 5 % and 3°, declared so: the model holds."""
    weights = 60e-6 * np.exp(1j * rng.uniform(0, 6, 8))
    really = weights * (1 + 0.05 * rng.standard_normal(8)) * np.exp(1j * np.radians(3.0) * rng.standard_normal(8))
    knowledge = Knowledge(installed_unbalance=0.05, installed_angle_rad=np.radians(3.0))
    pairs = [np.stack([w.real, w.imag], axis=-1)[:, None] for w in (weights, really)]
    measurement = made(
        Model(ROTOR), [1200.0, 1700.0, 2600.0], runs=8, unbalance=pairs[0], true=pairs[1], knowledge=knowledge
    )
    assert compare(ROTOR, measurement).reduced_chi2 < 1.6
    found = fit(ROTOR + effects.CrossCoupling(), measurement)
    assert found.misfit == 0.0
    assert abs(found.estimates[0].value) < 4 * found.estimates[0].standard_error


def test_sweeps_are_no_repeats():
    """Two sweeps through a resonance at 10 rpm spacing: neighbours in speed are not repeated readings of one."""
    from rotorjax.data.measurement import Installed, Row, arrange

    speeds = np.arange(2000.0, 2500.0, 10.0)
    z = np.asarray(response(ROTOR, Conditions.at_rpm(speeds, unbalance=[30e-6, 0.0])))[:, :, 0] * 1e6
    rng = np.random.default_rng(1)
    rows = []
    for repeat in "12":
        noisy = z + 0.3 * (rng.standard_normal(z.shape) + 1j * rng.standard_normal(z.shape))
        rows += [
            Row("a", rpm, probe, 1.0, abs(v), float(np.degrees(np.angle(v))), None, repeat)
            for rpm, pair in zip(speeds, noisy, strict=True)
            for probe, v in zip("XY", pair, strict=True)
        ]
    runs = {"a": Installed(np.array([[30e-6, 0.0]]), np.zeros(2))}
    measurement = arrange(rows, runs=runs, probes=("X", "Y"), knowledge=Knowledge())
    assert measurement.noise == "repeats"
    assert measurement.sigma[0, 0, 0] == pytest.approx(0.3e-6, rel=0.15)


def test_nothing_to_fit_and_no_damping():
    measurement = made(Model(ROTOR), [1200.0, 1700.0, 2600.0], unbalance=[30e-6, 0.0])
    assert fit(Model(ROTOR), measurement).reduced_chi2 == pytest.approx(1.0, abs=1.0)
    undamped = Jeffcott(0.97, [56500.0, 51300.0], 0.0)
    assert np.isfinite(fit(undamped + effects.CrossCoupling(), measurement).estimates[0].value)


def test_orders_that_nothing_drives_are_named():
    from rotorjax import tell
    from rotorjax.discovery.driven_orders import undriven_orders
    from rotorjax.reporting.comparison import findings, verdict

    once = made(ROTOR + effects.ResidualUnbalance(20e-6, 0.0), [1200.0, 1700.0, 2600.0], runs=2)
    both = np.concatenate([once.vectors, np.full_like(once.vectors, 100e-6)], axis=2)
    measurement = dataclasses.replace(
        once, orders=(1.0, 2.0), vectors=both, present=np.ones(both.shape, bool), sigma=np.full(both.shape, 0.3e-6)
    )
    story = tell(Model(ROTOR), measurement, [effects.ResidualUnbalance()])
    assert story.undriven == (2.0,)
    assert any("Nothing in this model excites 2X" in line for line in findings(story))
    assert "what the noise allows" in verdict(story)
    assert undriven_orders(Model(ROTOR).plus([effects.Clearance()]), measurement) == ()


def test_both_probes_share_the_sign_of_a_half_order():
    """Whirl in the opposite sense is another motion, whatever the sign that the reference leaves open."""
    once = made(ROTOR + effects.ResidualUnbalance(20e-6, 0.0), [1200.0, 1700.0])
    forward, backward = (
        np.broadcast_to(np.array([1.0, turn])[None, :, None], once.vectors.shape) for turn in (1j, -1j)
    )
    measurement = dataclasses.replace(once, orders=(0.5,), vectors=forward)
    assert measurement.rms_of(-forward) == 0.0
    assert measurement.rms_of(backward) == pytest.approx(np.sqrt(2.0))


def test_a_fit_without_a_steady_motion_says_so():
    fitted = fit(
        Model(ROTOR) + effects.ResidualUnbalance(),
        made(Model(ROTOR), [1200.0, 1700.0, 2600.0], unbalance=[30e-6, 0.0]),
        held_out=False,
    )
    assert fitted.objections(["residual_unbalance"]) == ()
    loose = dataclasses.replace(fitted, end=fitted.end._replace(exact=False))
    assert "no steady motion was found with these values" in loose.objections(["residual_unbalance"])[0]
