"""The linear inverse: values, errors, what cannot be told apart and why."""

import dataclasses

import numpy as np
import pytest

from rotorjax import Conditions, Measurement, Model, diagnose, response
from rotorjax.measurement import Limits

FAULTS = {"a": (6e-6, 0.3e-6, 1e-4, -2e-4), "b": (-3e-6, 8e-6, 1e-4, -2e-4)}


def measure(rotor, speeds_rpm, *, sigma=0.1e-6, installed=None, seed=0, **settings) -> Measurement:
    installed = installed or {run: (0.0,) * 4 for run in FAULTS}
    runs = np.repeat(np.arange(len(FAULTS)), len(speeds_rpm))
    true = np.array(list(FAULTS.values()))[runs]
    known = np.array(list(installed.values()))[runs]
    speeds = np.tile(speeds_rpm, len(FAULTS))
    clean = np.asarray(response(Model(rotor, **settings), Conditions.at_rpm(speeds, unbalance=true[:, None, :2], bow=true[:, 2:])))
    rng = np.random.default_rng(seed)
    z = clean + sigma * (rng.standard_normal(clean.shape) + 1j * rng.standard_normal(clean.shape))
    conditions = Conditions.at_rpm(speeds, unbalance=known[:, None, :2], bow=known[:, 2:])
    return Measurement(tuple(FAULTS), ("X", "Y"), (1.0,), runs, ("",) * len(runs), conditions, z, np.ones(z.shape, bool), np.full(z.shape, sigma), "given")


def test_several_speeds(paper_rotor):
    found = diagnose(paper_rotor + _nothing(), measure(paper_rotor, [800, 1500, 2600]))
    assert found.inherent is None
    for run in found.runs:
        assert run.identifiable, run.reason
        assert run.unbalance is not None
        assert run.bow is not None
        truth = np.array(FAULTS[run.run])
        assert np.hypot(*(run.unbalance.pair - truth[:2])) < 4 * run.unbalance.largest_error
        assert np.hypot(*(run.bow.pair - truth[2:])) < 4 * run.bow.largest_error
        assert run.reduced_chi2 == pytest.approx(1.0, abs=1.0)


def test_one_speed_and_nearly_equal_axes(paper_rotor):
    """At 1500 rpm 1 µm of noise is some 12 g mm of unbalance (Huang et al. 2026: see the paper's tables 4 and 5)."""
    found = diagnose(paper_rotor + _nothing(), measure(paper_rotor, [1500], sigma=1e-6))
    run = found.runs[0]
    assert not run.identifiable
    assert "one speed (1500 rpm) and nearly equal axes (critical speeds 2197 and 2307 rpm)" in run.reason
    assert "a reading at" in run.reason
    assert 5e-6 < run.unbalance.largest_error < 60e-6
    assert run.unbalance_alone is not None


def test_one_speed_without_noise_is_enough(paper_rotor):
    found = diagnose(paper_rotor + _nothing(), measure(paper_rotor, [1500], sigma=1e-10))
    assert found.runs[0].identifiable


def test_cure_is_within_the_limits(paper_rotor):
    measurement = measure(paper_rotor, [1500], sigma=1e-6)
    knowledge = dataclasses.replace(measurement.knowledge, limits=Limits(speed_rpm=(900.0, 1000.0)))
    reason = diagnose(paper_rotor + _nothing(), dataclasses.replace(measurement, knowledge=knowledge)).runs[0].reason
    speed = float(reason.split("a reading at ")[1].split(" rpm")[0])
    assert 900.0 <= speed <= 1000.0


def test_slow_roll_subtracted(paper_rotor):
    model = Model(paper_rotor, slow_roll=np.asarray(25.0))
    measurement = measure(paper_rotor, [800, 1500, 2600], slow_roll=np.asarray(25.0))
    run = diagnose(model, measurement).runs[0]
    assert not run.identifiable
    assert "slow roll was subtracted" in run.reason
    assert run.unbalance is None
    assert run.unbalance_alone is not None


def test_one_probe_at_one_speed(paper_rotor):
    measurement = measure(paper_rotor, [1500])
    present = measurement.present.copy()
    present[:, 1] = False
    run = diagnose(paper_rotor + _nothing(), dataclasses.replace(measurement, present=present)).runs[0]
    assert not run.identifiable
    assert "2 independent numbers for four unknowns" in run.reason


def test_unknown_noise(paper_rotor):
    measurement = dataclasses.replace(measure(paper_rotor, [800, 1500, 2600]), sigma=None, noise="unknown")
    run = diagnose(paper_rotor + _nothing(), measurement).runs[0]
    assert run.unbalance.standard_error is not None
    lone = dataclasses.replace(measure(paper_rotor, [1500]), sigma=None, noise="unknown")
    assert "the noise is unknown" in diagnose(paper_rotor + _nothing(), lone).runs[0].reason


def test_inherent_faults_are_compensated(paper_rotor):
    """Run a's installed faults are known: what it has beyond them is taken off run b."""
    inherent = np.array([1e-6, 0.0, 5e-5, 0.0])
    installed = {run: tuple(np.array(fault) - inherent) for run, fault in FAULTS.items()}
    found = diagnose(paper_rotor + _nothing(), measure(paper_rotor, [800, 1500, 2600], installed=installed), reference=("a",))
    assert found.inherent is not None
    assert np.hypot(*(found.inherent.unbalance.pair - inherent[:2])) < 4 * found.inherent.unbalance.largest_error
    compensated = found.runs[1].unbalance.pair
    assert np.hypot(*(compensated - np.array(installed["b"][:2]))) < 4 * found.runs[1].unbalance.largest_error


def test_refusals(paper_rotor):
    measurement = measure(paper_rotor, [1500])
    with pytest.raises(ValueError, match="reference run 'c' is not in the table"):
        diagnose(paper_rotor + _nothing(), measurement, reference=("c",))
    with pytest.raises(ValueError, match="holds no order 1"):
        diagnose(paper_rotor + _nothing(), dataclasses.replace(measurement, orders=(2.0,)))


def _nothing():
    from rotorjax import effects

    return effects.CrossCoupling()
