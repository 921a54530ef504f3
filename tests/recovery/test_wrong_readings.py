"""Single readings that were written down wrongly: named, left out, and not taken for physics."""

import dataclasses

import numpy as np
import pytest

from rotorjax import Conditions, Jeffcott, Layout, Measurement, Model, compare, explain
from rotorjax.data.wrong_readings import doubt, every_wrong_reading, wrong_readings
from rotorjax.discovery.contest import make_contest
from rotorjax.discovery.doubtful_readings import gain_without
from rotorjax.discovery.screening import Change, screen
from rotorjax.inference.noise import NO_NOISE

from hidden import Machine, Plan, measure

MACHINE = Machine()
SPEEDS = tuple(MACHINE.frequency * np.linspace(0.55, 1.45, 10))
RUNS = {"baseline": 0j, "trial": 60e-6 + 0j}
RESIDUAL = 20e-6 * np.exp(0.9j)
SIGMA = 0.3e-6
ONLY = ("residual_unbalance", "residual_bow", "stiffness_error", "clearance", "wrong_reading", "run_unbalance")
CELL = (13, 1, 0)
NAME = f"wrong_reading.trial.{SPEEDS[3] * 30.0 / np.pi:.0f}rpm.Y"


def measured(sigma=SIGMA, hidden=None):
    """Integrated in time with a residual unbalance, or with what is ``hidden``."""
    plan = Plan({run: [weight + RESIDUAL] for run, weight in RUNS.items()}, SPEEDS, sigma=SIGMA)
    z = measure(MACHINE, plan, hidden or {}, np.random.default_rng(11))
    run = np.repeat(np.arange(2), len(SPEEDS))
    stated = np.array([[[RUNS[name].real, RUNS[name].imag]] for name in RUNS])[run]
    conditions = Conditions.at(np.tile(SPEEDS, 2), unbalance=stated)
    rotor = Jeffcott(MACHINE.mass, MACHINE.stiffness, MACHINE.ratio)
    m = Measurement.from_arrays(z, conditions, run=run, runs=tuple(RUNS), sigma=sigma)
    return Model(rotor, layout=Layout(orders=(1.0,))), m


def with_vector(m, change, cell=CELL):
    vectors = m.vectors.copy()
    vectors[cell] = change(vectors[cell])
    return dataclasses.replace(m, vectors=vectors)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda z: 10.0 * z, "is 10 times (a decimal point?)"),
        pytest.param(lambda z: -z, "its phase 180° (a sign?) off", marks=pytest.mark.campaign),
        pytest.param(lambda z: 0.6 * z, "is 0.6", marks=pytest.mark.campaign),
    ],
)
def test_a_reading_that_was_typed_in_wrongly_is_named_and_left_out(change, said):
    model, m = measured()
    found = explain(model, with_vector(m, change), only=ONLY)
    assert (found.verdict, found.named) == ("explained", (NAME, "residual_unbalance"))
    assert said in found.summary()
    assert not found.story.measurement.present[CELL]
    unbalance = [found.story.fits[-1].estimate("residual_unbalance", f"unbalance_{a}_kg_m").value for a in "xy"]
    np.testing.assert_allclose(unbalance, [RESIDUAL.real, RESIDUAL.imag], atol=0.5e-6)


@pytest.mark.campaign
def test_where_the_noise_is_unknown_too():
    model, m = measured(sigma=None)
    found = explain(model, with_vector(m, lambda z: 10.0 * z), only=ONLY)
    assert (found.verdict, found.named) == ("explained", (NAME, "residual_unbalance"))


@pytest.mark.campaign
def test_two_wrong_readings_are_named_and_left_undecided():
    model, m = measured()
    m = with_vector(with_vector(m, lambda z: 10.0 * z), lambda z: -z, (4, 0, 0))
    found = explain(model, m, only=ONLY)
    assert found.verdict == "undecided"
    assert found.named[0].count("rpm") == 2
    assert "several readings would have to be wrong" in found.summary()


def test_readings_that_agree_are_not_doubted():
    found = explain(*measured(), only=ONLY)
    assert (found.verdict, found.named) == ("explained", ("residual_unbalance",))
    assert found.written.ranked[1:] == ()


def test_one_tried_by_hand_is_left_out():
    model, m = measured()
    wrong = with_vector(m, lambda z: 10.0 * z)
    tried = next(one for one in every_wrong_reading(wrong) if one.name == NAME)
    _, without = tried.corrected(model, wrong)
    assert int(wrong.present.sum() - without.present.sum()) == 1
    assert compare(model, without).rms < compare(model, wrong).rms
    assert every_wrong_reading(wrong, ["run_phase"]) == []


def test_a_doubted_reading_counts_as_one_of_the_size_of_the_vectors():
    _, m = measured()
    _, doubted = wrong_readings(m, [CELL]).corrected(None, m)
    weight = doubted.weights(0.0)
    expected = 1.0 / np.hypot(SIGMA, max(abs(m.vectors[CELL]), m.rms))
    np.testing.assert_allclose(weight[CELL], expected)
    others = np.ones(m.present.shape, bool)
    others[CELL] = False
    np.testing.assert_array_equal(weight[others], m.weights(0.0)[others])
    assert not doubted.certain[CELL]


def test_what_a_fit_gains_without_a_reading_is_what_it_gains_when_fitted_without():
    """Against the fit with the reading left out, of a linear effect."""
    model, m = measured()
    m = with_vector(m, lambda z: 1.2 * z)
    contest = make_contest(model, m, ["residual_unbalance"])

    def cost(measurement):
        change = Change(None, dataclasses.replace(contest, measurement=measurement))
        return screen(change, NO_NOISE)

    whole = cost(m)
    gained = gain_without(whole)
    without = m.present.copy()
    without[CELL] = False
    left = cost(dataclasses.replace(m, present=without))
    assert np.unravel_index(np.argmax(gained), gained.shape) == CELL
    np.testing.assert_allclose(0.5 * gained[CELL], whole.end.cost - left.end.cost, rtol=1e-3)


def test_a_doubt_is_forgotten_where_the_reading_is_left_out():
    model, m = measured()
    tried = every_wrong_reading(m)[0]
    _, without = tried.corrected(model, doubt(m, [(0, 0, 0)]))
    assert without.doubted is None
