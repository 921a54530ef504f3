"""Data that another model made, with one effect hidden: fitted from the declared starts alone, it comes back."""

import dataclasses

import numpy as np
import pytest

from rotorjax import Conditions, Jeffcott, Layout, Measurement, Model, compare, effects, fit, rivals

from crosscode.test_time_integration import CASES, DAMPING, MASS, RATIO, STIFFNESS
from oracle import TimeRotor

SPEEDS_RPM = (800, 1100, 1400, 1700, 1900, 2050, 2500, 2900)
WEIGHTS = {"baseline": 4e-6, "trial-a": 30e-6, "trial-b": 30e-6 * np.exp(2.1j), "trial-c": 20e-6 * np.exp(-1.5j)}
BOW = 10e-6 * np.exp(1j)
SIGMA = 0.3e-6
ROTOR = Jeffcott(MASS, STIFFNESS, RATIO)
BARE = Model(ROTOR, layout=Layout(orders=(1.0, 2.0)))
ALL = sum((effects.CATALOG[name]() for name in CASES), BARE)
"""Every effect at its null: one shape, compiled once, for all fits below."""


def measure(in_time, *, noise: float = SIGMA, seed: int = 0) -> Measurement:
    """All runs at all speeds, from time integration, with Gaussian noise."""
    clean = []
    for weight in WEIGHTS.values():
        for rpm in SPEEDS_RPM:
            speed = rpm * np.pi / 30
            rotor = dataclasses.replace(in_time(speed), unbalance=in_time(speed).unbalance - CASES_UNBALANCE + weight)
            clean.append(dataclasses.replace(rotor, bow=rotor.bow - CASES_BOW + BOW).vectors(speed, (1, 2)))
    rng = np.random.default_rng(seed)
    z = np.array(clean)
    z = z + noise * (rng.standard_normal(z.shape) + 1j * rng.standard_normal(z.shape))
    runs = np.repeat(np.arange(len(WEIGHTS)), len(SPEEDS_RPM))
    weights = np.array([[[w.real, w.imag]] for w in map(complex, WEIGHTS.values())])[runs]
    conditions = Conditions.at_rpm(np.tile(SPEEDS_RPM, len(WEIGHTS)), unbalance=weights, bow=[BOW.real, BOW.imag])
    return Measurement.from_arrays(z, conditions, run=runs, runs=tuple(WEIGHTS), orders=(1.0, 2.0), sigma=noise or None)


CASES_UNBALANCE = CASES["mass_error"][1](1.0).unbalance
CASES_BOW = CASES["mass_error"][1](1.0).bow


@pytest.mark.parametrize("name", CASES)
def test_effect_comes_back(name):
    truth, in_time = CASES[name]
    measurement = measure(in_time)
    before = compare(BARE, measurement)
    found = fit(ALL, measurement, free=(name,), held_out=False)
    assert found.converged, found.result
    assert found.reduced_chi2 is not None
    assert found.reduced_chi2 < 1.3
    assert before.reduced_chi2 is not None
    assert before.reduced_chi2 > 2.0
    values = {e.entry.label: e for e in found.estimates}
    labels = [label for p in truth.parameters() for label in p.labels(BARE.layout)]
    expected = np.concatenate([np.ravel(v) for v in truth.sized(BARE.layout).values()])
    for label, value in zip(labels, expected, strict=True):
        estimate = values[label]
        # Three standard errors, and what the prior pulls an estimate that the data leave open.
        assert abs(estimate.value - value) < 4.0 * estimate.standard_error + 1e-3 * abs(value), label


def test_healthy_rotor_is_within_the_noise():
    measurement = measure(lambda speed: TimeRotor(MASS, STIFFNESS, DAMPING, unbalance=CASES_UNBALANCE, bow=CASES_BOW))
    view = compare(BARE, measurement)
    assert view.reduced_chi2 == pytest.approx(1.0, abs=0.2)
    assert sum(view.share()["run"].values()) == pytest.approx(1.0)
    found = fit(ALL, measurement, free=("cross_coupling",))
    assert abs(found.estimates[0].value) < 3.5 * found.estimates[0].standard_error
    assert next(r for r in rivals(found) if r.instead is None).tied, "an effect that is not there is not needed"


def test_two_effects_and_the_error_held_out():
    def in_time(speed):
        return dataclasses.replace(CASES["gyroscopic"][1](speed), delay=4e-4)

    measurement = measure(in_time)
    found = fit(ALL, measurement, free=("gyroscopic", "time_delay"))
    assert found.estimate("gyroscopic", "inertia_ratio_kg").value == pytest.approx(0.06, rel=0.02)
    assert found.estimate("time_delay", "delay_s").value == pytest.approx(4e-4, rel=0.02)
    assert found.held_out_rms == pytest.approx(np.sqrt(2) * SIGMA, rel=0.15)
    assert all(not r.tied for r in rivals(found) if r.instead is None)


def test_standard_errors_cover():
    """Errors over twenty noises, in standard errors, have unit size."""
    truth, in_time = CASES["cross_coupling"]
    clean = measure(in_time, noise=0.0)
    pulls = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        noise = SIGMA * (rng.standard_normal(clean.vectors.shape) + 1j * rng.standard_normal(clean.vectors.shape))
        measurement = dataclasses.replace(
            clean, vectors=clean.vectors + noise, sigma=np.full(clean.vectors.shape, SIGMA)
        )
        estimate = fit(ALL, measurement, free=("cross_coupling",), held_out=False).estimates[0]
        pulls.append((estimate.value - float(truth.cross_stiffness_n_per_m)) / estimate.standard_error)
    assert 0.6 < np.std(pulls) < 1.3
    assert abs(np.mean(pulls)) < 0.7


def test_unknown_noise_is_inferred():
    measurement = measure(CASES["cross_coupling"][1])
    found = fit(ALL, dataclasses.replace(measurement, sigma=None, noise="unknown"), free=("cross_coupling",))
    assert found.reduced_chi2 is None
    assert found.misfit == pytest.approx(SIGMA, rel=0.15)
    assert found.estimates[0].value == pytest.approx(900.0, rel=0.05)
