"""Influence coefficients: weights come back that were hidden, as a fit of the linear rotor finds them, with errors that
cover; and, where they are at hand, published balancing cases.
"""

import cmath
import csv
import math
from pathlib import Path

import numpy as np
import pytest

from rotorjax import Conditions, Jeffcott, Measurement, Model, diagnose, effects, read_rig, response
from rotorjax.diagnosis.influence_coefficients import influence_balance, measured_influence, weighted_planes
from rotorjax.reporting.balance import differ_lines, influence_lines
from rotorjax.reporting.to_correct import balance_of_diagnosis

from helpers import RIG, write

PUBLISHED = Path(__file__).parents[3] / "shared" / "real"
OWN = np.array([5e-6, -7e-6])
SPEEDS = [900.0, 1500.0, 1900.0, 2600.0]


def measured(weights, *, sigma=0.2e-6, rotation="x-to-y", seed=0, bow=(0.0, 0.0)) -> Measurement:
    """A rotor with an unbalance of its own, and runs with weights beside it."""
    rotor = Jeffcott(0.97, [5.65e4, 5.13e4], [0.02, 0.02], rotation=rotation)
    run = np.repeat(np.arange(len(weights)), len(SPEEDS))
    speeds, installed = np.tile(SPEEDS, len(weights)), np.array(weights)[run]
    there = Conditions.at_rpm(speeds, unbalance=(installed + OWN)[:, None], bow=np.tile(bow, (len(speeds), 1)))
    z = np.asarray(response(Model(rotor), there))
    rng = np.random.default_rng(seed)
    z = z + sigma * (rng.standard_normal(z.shape) + 1j * rng.standard_normal(z.shape))
    conditions = Conditions.at_rpm(speeds, unbalance=installed[:, None])
    names = tuple(f"run-{k}" for k in range(len(weights)))
    return Measurement.from_arrays(z, conditions, run=run, runs=names, sigma=sigma or None)


TRIALS = [(0.0, 0.0), (30e-6, 0.0), (0.0, -20e-6)]


@pytest.mark.parametrize("rotation", ["x-to-y", "y-to-x"])
def test_what_was_hidden_comes_back_as_the_fit_of_the_rotor_finds_it(rotation):
    measurement = measured(TRIALS, rotation=rotation)
    assert weighted_planes(measurement) == (0,)
    found = measured_influence(measurement)
    (unbalance,) = found.unbalance
    assert np.hypot(*(unbalance.pair - OWN)) < unbalance.reach < 0.3e-6
    assert found.linear
    assert np.abs(found.left).max() < 0.1 * np.abs(found.initial).max()
    model = Model(Jeffcott(0.97, [5.65e4, 5.13e4], [0.02, 0.02], rotation=rotation))
    fitted = diagnose(model, measurement).runs[0].unbalance
    assert np.hypot(*(unbalance.pair - fitted.pair)) < unbalance.reach + fitted.reach


def test_without_noise_one_trial_weight_is_enough_and_exact():
    found = measured_influence(measured(TRIALS[:2], sigma=0.0))
    np.testing.assert_allclose(found.unbalance[0].pair, OWN, rtol=1e-9)
    assert found.unbalance[0].covariance is None
    assert found.reduced_chi2 is None


def test_errors_cover():
    """Of a hundred measurements some 95 find the unbalance within the 95 % region."""
    inside = [
        not fault._replace(pair=fault.pair - OWN).differs_from_zero
        for seed in range(100)
        for fault in measured_influence(measured(TRIALS, seed=seed)).unbalance
    ]
    assert 89 <= sum(inside) <= 100


def test_a_weight_stated_wrongly_is_noticed():
    measurement = measured([*TRIALS[:2], (0.0, 20e-6)])
    stated = np.array(TRIALS)[measurement.run][:, None]
    conditions = Conditions.at_rpm(measurement.speed_rpm, unbalance=stated)
    wrong = Measurement.from_arrays(
        measurement.vectors, conditions, run=measurement.run, runs=measurement.runs, sigma=0.2e-6
    )
    assert measured_influence(wrong).linear is False


def test_runs_that_do_not_determine_it():
    assert measured_influence(measured([(0.0, 0.0), (0.0, 0.0)])) is None
    with pytest.raises(ValueError, match="every plane needs a run of its own"):
        influence_balance(np.ones((2, 4), complex), np.array([[1.0, 2.0], [2.0, 4.0]], complex))


def test_two_planes_at_once():
    rng = np.random.default_rng(3)
    influence, own, initial = (
        rng.standard_normal(shape) + 1j * rng.standard_normal(shape) for shape in ((8, 2), (2,), (8,))
    )
    weights = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 2.0j]])
    vectors = influence @ own + weights @ influence.T
    found = influence_balance(vectors, weights)
    np.testing.assert_allclose([complex(*fault.pair) for fault in found.unbalance], own, rtol=1e-9)
    np.testing.assert_allclose(found.influence, influence, rtol=1e-9)
    np.testing.assert_allclose(found.left, 0.0, atol=1e-9)
    # One plane in its own right leaves what is orthogonal to its influence.
    one = influence_balance(vectors, weights, using=(1,))
    assert len(one.unbalance) == 1
    np.testing.assert_allclose(np.conj(influence[:, 1]) @ one.left, 0.0, atol=1e-9)
    # What no weight can still is left, and is the least that can be.
    least = influence_balance(vectors + initial, weights)
    np.testing.assert_allclose(np.conj(influence.T) @ least.left, 0.0, atol=1e-9)


def test_planes_in_one_mode_are_corrected_in_by_themselves(tmp_path):
    """Two planes of a rotor with one mode: how to share the correction is left open, and each alone is the whole."""
    text = RIG.replace("[runs.baseline]\n", "[planes.a]\n[planes.b]\nparticipation = 0.5\n[runs.baseline]\n")
    text = text.replace("{ magnitude", '{ plane = "a", magnitude') + '[runs.trial-b]\nunbalance = { plane = "b", '
    text += "magnitude_g_mm = 40.0, angle_deg = 90.0 }\n"
    _, path = write(tmp_path, rig=text)
    rig = read_rig(path)
    weights = np.array([installed.unbalance for installed in rig.runs.values()])
    run = np.repeat(np.arange(3), len(SPEEDS))
    conditions = Conditions.at_rpm(np.tile(SPEEDS, 3), unbalance=weights[run])
    z = np.asarray(response(rig.model + effects.ResidualUnbalance(*OWN), conditions))
    rng = np.random.default_rng(5)
    z = z + 0.2e-6 * (rng.standard_normal(z.shape) + 1j * rng.standard_normal(z.shape))
    measurement = Measurement.from_arrays(z, conditions, run=run, runs=tuple(rig.runs), sigma=0.2e-6)
    lines = influence_lines(measurement, rig)
    assert len(lines) == 3
    assert "in plane a alone" in lines[0]
    assert "nearly proportional" in lines[2]
    for k, share in enumerate((1.0, 0.5)):
        (fault,) = measured_influence(measurement, using=(k,)).unbalance
        assert np.hypot(*(share * fault.pair - OWN)) < 3.0 * share * fault.reach


@pytest.mark.skipif(not PUBLISHED.is_dir(), reason="published balancing cases are not at hand")
@pytest.mark.parametrize(
    ("case", "kept"),
    [("feese_grazier2004", True), ("bk17227_ex6", False), ("bk_vaughan_ex_static", False),
     ("bk_vaughan_ex_dynamic", False)],
)  # fmt: skip
def test_published_corrections(case, kept):
    """Weights within 2 % and 2.5° of those published, or computed from them by pyPRB (Vaughan's)."""

    def rows(name: str) -> list[dict[str, str]]:
        with (PUBLISHED / f"balancing_{name}.csv").open(encoding="utf-8") as file:
            return [row for row in csv.DictReader(file) if row["case"] == case]

    def vector(size: str, degrees: str) -> complex:
        return cmath.rect(float(size), math.radians(float(degrees)))

    read = {(r["run"], r["sensor"]): vector(r["amp"], r["phase_deg"]) for r in rows("runs")}
    runs, sensors = (list(dict.fromkeys(key[k] for key in read)) for k in (0, 1))
    printed = {r["plane"]: vector(r["weight"], r["angle_deg"]) for r in rows("published_corrections")}
    weights = np.zeros((len(runs), len(printed)), complex)
    for row in rows("trial_weights"):
        weights[runs.index(row["run"]), list(printed).index(row["plane"])] = vector(row["weight"], row["angle_deg"])
    if kept:
        weights = np.cumsum(weights, axis=0)
    found = influence_balance(np.array([[read[run, sensor] for sensor in sensors] for run in runs]), weights)
    for fault, correction in zip(found.unbalance, printed.values(), strict=True):
        ratio = -complex(*fault.pair) / correction
        assert abs(abs(ratio) - 1.0) < 0.02
        assert abs(math.degrees(cmath.phase(ratio))) < 2.5


def test_a_correction_by_the_model_that_contradicts_it_is_said_to(tmp_path):
    """The shaft is a tenth softer than the rig file says, where only speeds below resonance were read."""
    rig = read_rig(write(tmp_path)[1])
    rotor = Jeffcott(0.97, [0.9 * 56500.0, 0.9 * 51300.0], [0.02, 0.02])
    speeds, run = np.tile([600.0, 800.0, 1000.0], 3), np.repeat([0, 1, 2], 3)
    weights = np.array([[0.0, 0.0], [6e-5, 0.0], [0.0, 6e-5]])[run]
    there = Conditions.at_rpm(speeds, unbalance=(weights + np.array([2e-5, -2e-5]))[:, None])
    stated = Conditions.at_rpm(speeds, unbalance=weights[:, None])
    for model, lines in ((Model(rotor), 1), (rig.model, 0)):
        z = np.asarray(response(model, there))
        m = Measurement.from_arrays(z, stated, run=run, runs=("baseline", "a", "b"), sigma=2e-7)
        told = differ_lines(balance_of_diagnosis(diagnose(rig.model, m), rig, m), m, rig)
        assert len(told) == lines
        assert not told or "Influence coefficients need no rotor" in told[0]
