"""Run-ups read as if every speed were steady: the rate of the sweep is found, and what is hidden beside it."""

import dataclasses

import numpy as np
import pytest

from rotorjax import Conditions, Jeffcott, Measurement, Model, compare, explain
from rotorjax.reporting.explanation import notes

from hidden import Machine
from run_up import swept

MACHINE = Machine(1.0, (29000.0, 27000.0), (0.013, 0.02))
SPEEDS = np.linspace(120.0, 230.0, 30)
WEIGHTS = (1e-5 * np.exp(0.7j), 2e-5 * np.exp(-1.0j))
NOISE = 1e-6


def run_ups(rate: float, hidden: complex = 0.0) -> tuple[Model, Measurement]:
    """Two runs at one rate [rad/s²], each with a weight, and an unbalance that nobody knows of."""
    rng = np.random.default_rng(1)
    clean = np.concatenate([swept(SPEEDS, rate, MACHINE, weight + hidden) for weight in WEIGHTS])
    noise = NOISE * rng.standard_normal((2, *clean.shape))
    unbalance = np.repeat([[[w.real, w.imag]] for w in WEIGHTS], len(SPEEDS), axis=0)
    measurement = Measurement.from_arrays(
        (clean + noise[0] + 1j * noise[1])[..., None], Conditions.at(np.tile(SPEEDS, 2), unbalance=unbalance),
        run=np.repeat([0, 1], len(SPEEDS)), runs=("a", "b"), sigma=NOISE,
    )  # fmt: skip
    return Model(Jeffcott(MACHINE.mass, MACHINE.stiffness, MACHINE.ratio)), measurement


@pytest.mark.parametrize("rate", [pytest.param(3.0, marks=pytest.mark.campaign), -24.0])
def test_the_rate_is_found(rate):
    found = explain(*run_ups(rate), thorough=False)
    assert (found.verdict, found.effects) == ("explained", ("sweep_rate",))
    estimate = found.story.fits[-1].estimate("sweep_rate", "rate_rad_per_s2")
    assert abs(estimate.value - rate) < 4.0 * estimate.standard_error + 2e-3 * abs(rate)
    assert estimate.standard_error < 0.02
    assert any("state it in a column sweep_rpm_per_s" in line for line in notes(found))


@pytest.mark.campaign
def test_with_an_unbalance_beside_it():
    found = explain(*run_ups(24.0, 6e-6j), thorough=False)
    assert found.verdict == "explained"
    assert set(found.effects) == {"sweep_rate", "residual_unbalance"}
    assert found.story.fits[-1].estimate("residual_unbalance", "unbalance_y_kg_m").value == pytest.approx(
        6e-6, rel=0.02
    )


def test_a_rate_that_is_stated_is_nothing_missing():
    model, measurement = run_ups(24.0)
    stated = dataclasses.replace(measurement.conditions, sweep=np.full(2 * len(SPEEDS), 24.0))
    known = dataclasses.replace(measurement, conditions=stated)
    assert compare(model, measurement).rms > 20.0 * compare(model, known).rms
    assert explain(model, known, only=["sweep_rate", "speed_error", "damping_error"]).verdict == "nothing missing"
