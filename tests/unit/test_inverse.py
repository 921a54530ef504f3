"""The linear inverse: values, errors, what cannot be told apart and why."""

import dataclasses
import re

import numpy as np
import pytest

from rotorjax import Conditions, Jeffcott, Knowledge, Measurement, Model, diagnose, response
from rotorjax.data.knowledge import Limits, Uncertain

FAULTS = {"a": (6e-6, 0.3e-6, 1e-4, -2e-4), "b": (-3e-6, 8e-6, 1e-4, -2e-4)}


def measure(rotor, speeds_rpm, *, sigma=0.1e-6, installed=None, seed=0, **settings) -> Measurement:
    installed = installed or {run: (0.0,) * 4 for run in FAULTS}
    runs = np.repeat(np.arange(len(FAULTS)), len(speeds_rpm))
    true = np.array(list(FAULTS.values()))[runs]
    known = np.array(list(installed.values()))[runs]
    speeds = np.tile(speeds_rpm, len(FAULTS))
    clean = np.asarray(
        response(Model(rotor, **settings), Conditions.at_rpm(speeds, unbalance=true[:, None, :2], bow=true[:, 2:]))
    )
    rng = np.random.default_rng(seed)
    z = clean + sigma * (rng.standard_normal(clean.shape) + 1j * rng.standard_normal(clean.shape))
    conditions = Conditions.at_rpm(speeds, unbalance=known[:, None, :2], bow=known[:, 2:])
    return Measurement.from_arrays(z, conditions, run=runs, runs=tuple(FAULTS), sigma=sigma)


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
    assert re.search(
        r"one speed \(1500 rpm\) and nearly equal axes \(critical speeds 219\d and 230\d rpm\)", run.reason
    )
    assert "a reading at" in run.reason
    assert 5e-6 < run.unbalance.largest_error < 60e-6
    assert run.unbalance_alone is not None


def test_one_speed_leaves_nothing_to_check_the_model_by(paper_rotor):
    """Next to no noise, four numbers for four unknowns: right if the model is, but nothing says so."""
    run = diagnose(paper_rotor + _nothing(), measure(paper_rotor, [1500], sigma=1e-10)).runs[0]
    assert not run.identifiable
    assert "no reading is left over to check the model by" in run.reason
    np.testing.assert_allclose(run.unbalance.pair, FAULTS["a"][:2], atol=1e-8)


def test_uncertain_stiffness_widens_the_errors(paper_rotor):
    """Stiffness off by 2 % and declared so: one speed says nothing, several speeds find faults and stiffness along."""
    stiffness = np.array([56538.0 / 1.02, 51282.0 / 0.98])
    ratio = np.array([0.005, 0.0047]) * np.sqrt(np.array([56538.0, 51282.0]) / stiffness)
    wrong = Jeffcott(0.9686, stiffness, ratio)
    uncertain = tuple(Uncertain("stiffness_error", f"error_{a}", 0.02, True, f"stiffness.{a}") for a in "xy")
    knowledge = Knowledge(uncertain=uncertain)
    one = diagnose(Model(wrong), dataclasses.replace(measure(paper_rotor, [1500]), knowledge=knowledge)).runs[0]
    assert not one.identifiable
    assert one.unbalance.largest_error > 20e-6
    for run in diagnose(
        Model(wrong), dataclasses.replace(measure(paper_rotor, [800, 1500, 1900, 2600]), knowledge=knowledge)
    ).runs:
        assert run.identifiable, run.reason
        assert np.hypot(*(run.unbalance.pair - np.array(FAULTS[run.run][:2]))) < 4 * run.unbalance.largest_error
        assert run.unbalance.largest_error < 1e-6


def test_a_model_that_fails_is_named(paper_rotor):
    wrong = Jeffcott(0.9686, [56538.0 / 1.02, 51282.0 / 0.98], [0.005, 0.0047])
    run = diagnose(Model(wrong), measure(paper_rotor, [800, 1500, 2600])).runs[0]
    assert not run.identifiable
    assert "the model does not hold here" in run.reason


def test_proposed_speed_keeps_its_promise(paper_rotor):
    """The error after adding the proposed reading is the promised one."""
    reason = diagnose(paper_rotor + _nothing(), measure(paper_rotor, [1500], sigma=1e-6)).runs[0].reason
    speed, before, after = map(
        float, re.search(r"a reading at (\d+) rpm .* from ([\d.e+]+) to ([\d.e+]+) g mm", reason).groups()
    )
    again = diagnose(paper_rotor + _nothing(), measure(paper_rotor, [1500, speed], sigma=1e-6)).runs[0]
    assert again.unbalance.largest_error * 1e6 == pytest.approx(after, rel=0.8)
    assert after < 0.2 * before


def test_participation_of_a_second_plane_counts_in_a_reference(paper_rotor):
    from rotorjax import Layout, effects

    model = Model(paper_rotor, participation=[1.0, 0.8], layout=Layout(planes=("a", "b"))) + effects.PlaneParticipation(
        [0.3]
    )
    weights = np.array([[0.0, 0.0], [10e-6, 0.0]])
    conditions = Conditions.at_rpm([800.0, 1500.0, 2600.0], unbalance=weights)
    z = np.asarray(response(model, conditions))
    run, present = np.zeros(3, int), np.ones(z.shape, bool)
    measurement = Measurement(
        ("a",), ("X", "Y"), (1.0,), run, ("",) * 3, conditions, z, present, np.full(z.shape, 1e-8), "given"
    )
    assert diagnose(model, measurement, reference=("a",)).inherent.unbalance.magnitude < 1e-9


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
    found = diagnose(
        paper_rotor + _nothing(), measure(paper_rotor, [800, 1500, 2600], installed=installed), reference=("a",)
    )
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
