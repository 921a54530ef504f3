"""A rotor that is unstable was not measured in a steady state: cross-coupling against its threshold in closed form."""

import math

import numpy as np
import pytest

from rotorjax import Conditions, Jeffcott, Measurement, Model, effects, explain, fit
from rotorjax.inference.stable import cost_of_stability

MASS, STIFFNESS, RATIO, SIGMA = 1.0, 1e5, 0.02, 1e-7
THRESHOLD = 2.0 * RATIO * STIFFNESS
"""k = c ω_n (Childs 1993, chapter 1), for c = 2 ζ √(k m)."""
RPM = np.linspace(1500.0, 2500.0, 5)


def measured(coupling: float, *, stiffer: float = 1.0, unbalance: float = 1e-4) -> tuple[Model, Measurement]:
    """A rotor without cross-coupling, and vectors of one with it, by their closed form, stable or not. ``stiffer``:
    along y than along x.
    """
    stiffness, speed = np.array([STIFFNESS, stiffer * STIFFNESS]), RPM[:, None] * math.pi / 30.0
    dynamic = np.zeros((len(RPM), 2, 2), complex)
    damping = 2.0 * RATIO * np.sqrt(stiffness * MASS)
    dynamic[:, [0, 1], [0, 1]] = stiffness + 1j * speed * damping - MASS * speed**2
    dynamic[:, 0, 1], dynamic[:, 1, 0] = coupling, -coupling
    vectors = np.linalg.solve(dynamic, (unbalance * speed**2 * np.array([1.0, -1j]))[..., None])
    noise = np.random.default_rng(5).normal(scale=SIGMA, size=(2, *vectors.shape))
    conditions = Conditions.at_rpm(RPM, unbalance=[unbalance, 0.0])
    model = Model(Jeffcott(mass=MASS, stiffness=stiffness, damping_ratio=RATIO))
    found = Measurement.from_arrays(vectors + noise[0] + 1j * noise[1], conditions, sigma=SIGMA)
    return model, found


@pytest.mark.parametrize("share", [1.002, 1.01])
def test_it_costs_what_the_threshold_costs(share: float):
    model, measurement = measured(share * THRESHOLD)
    found = fit(model + effects.CrossCoupling(), measurement, held_out=False)
    (estimate,) = found.estimates
    expected = 0.5 * ((estimate.value - THRESHOLD) / estimate.entry.scale) ** 2 * found.end.curvature[0, 0]
    assert expected > 0.5
    cost = cost_of_stability(found.end, found.stage.space, measurement.steady_rpm())
    assert cost == pytest.approx(expected, rel=0.02)


def test_an_answer_that_is_unstable_where_it_was_measured_says_so():
    model, measurement = measured(1.5 * THRESHOLD)
    found = fit(model + effects.CrossCoupling(), measurement, held_out=False)
    assert found.reduced_chi2 == pytest.approx(1.0, abs=0.6), "it fits all the same"
    (said,) = found.objections(["cross_coupling"])
    assert "makes the rotor unstable at 5 of the 5 speeds" in said


def test_a_stable_one_does_not():
    model, measurement = measured(0.8 * THRESHOLD)
    found = fit(model + effects.CrossCoupling(), measurement, held_out=False)
    assert found.objections(["cross_coupling"]) == ()
    assert cost_of_stability(found.end, found.stage.space, measurement.steady_rpm()) == 0.0


def test_a_force_that_does_nothing_does_not_hold_it():
    """A cubic spring of no size, and a probe that hardly saturates: the rotor is as unstable as without."""
    model, measurement = measured(1.5 * THRESHOLD)
    full = model + effects.CrossCoupling() + effects.Duffing(1.0) + effects.ProbeSaturation(1e-3)
    found = fit(full, measurement, held_out=False)
    assert len(found.objections(["cross_coupling"])) == 1


def test_it_is_never_what_explains():
    """Beside unequal stiffnesses, where internal damping shows: beside equal ones that may hold the rotor unseen."""
    model, measurement = measured(4.0 * THRESHOLD, stiffer=1.1)
    helpers = ("internal_damping", "asymmetric_shaft", "probe_saturation", "sweep_rate")
    answer = explain(model, measurement, only=("cross_coupling", *helpers), thorough=False)
    assert answer.verdict in ("unexplained", "undecided")
