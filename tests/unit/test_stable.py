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


def measured(coupling: float, unbalance: float = 1e-4) -> tuple[Model, Measurement]:
    """A rotor without cross-coupling, and vectors of one with it, by their closed form, stable or not."""
    speed = RPM * math.pi / 30.0
    dynamic = STIFFNESS - 1j * coupling + 2j * RATIO * math.sqrt(STIFFNESS * MASS) * speed - MASS * speed**2
    x = unbalance * speed**2 / dynamic
    vectors = np.stack([x, -1j * x], axis=1)[:, :, None]
    noise = np.random.default_rng(5).normal(scale=SIGMA, size=(2, *vectors.shape))
    conditions = Conditions.at_rpm(RPM, unbalance=[unbalance, 0.0])
    model = Model(Jeffcott(mass=MASS, stiffness=STIFFNESS, damping_ratio=RATIO))
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


def test_it_is_never_what_explains():
    model, measurement = measured(1.5 * THRESHOLD)
    answer = explain(model, measurement, only="cross_coupling", thorough=False)
    assert answer.verdict in ("unexplained", "undecided")
