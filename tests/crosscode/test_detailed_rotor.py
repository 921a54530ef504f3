"""The detailed rotor of the campaign: its integration in time against closed form and against SciPy, and what is left
of it where it has no more detail than the model.
"""

import dataclasses
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))
from detailed import forces
from detailed.chain import Chain
from detailed.in_time import Condition, NoSteadyStateError, Stepper, periodic, vectors, waveforms
from detailed.rotor import FORWARD, Frame, Rotor

FREQUENCY, MASS = 200.0, 2.0
SPRING = MASS * FREQUENCY**2
ROTOR = Rotor(
    disk_mass=1.8, shaft_mass=0.4, polar=0.0073, length=0.6, position=0.54, bending=SPRING * 0.6**3 / 48.0,
    bearing_stiffness=(10 * SPRING, 7 * SPRING), bearing_damping=(2 * SPRING / FREQUENCY, 1.5 * SPRING / FREQUENCY),
    disk_damping=(2 * 0.03 * MASS * FREQUENCY, 2 * 0.04 * MASS * FREQUENCY), gravity=(0.0, -9.80665),
    reference_speed=FREQUENCY,
)  # fmt: skip
CONDITIONS = [Condition(FREQUENCY * s, 3e-5 + 1e-5j) for s in (0.6, 0.9, 1.05, 1.4)]
ORDERS = (0, 1, 2, 3)


def test_integration_from_rest_meets_the_closed_form():
    rotor = dataclasses.replace(
        ROTOR, bow=1e-5 + 3e-6j, thermal_bow=2e-6j, force_2=(1.0, 2.0j), force_1=0.5 + 0.1j, cross=900.0, internal=2.0,
        gyroscopic=0.05, axes=0.3, spring=(500.0, -300.0), mass_added=0.02, frame=Frame(1e6, 4.0, 300.0),
    )  # fmt: skip
    stepper = Stepper(rotor, (), CONDITIONS, 64)
    state = stepper.begin(rotor, CONDITIONS)
    state[:, : 2 * stepper.n] = 0.0
    for _ in range(250):
        state = stepper.turn(state)
    kept = []
    stepper.turn(state, kept)
    integrated = vectors(np.concatenate(kept, axis=2), ORDERS)
    closed = vectors(waveforms(rotor, (), CONDITIONS, steps=64)[0], ORDERS)
    assert np.max(np.abs(integrated - closed)) < 1e-6 * np.max(np.abs(closed))


@pytest.mark.parametrize(
    "force",
    [forces.power(3e11, 3), forces.crack(2000.0 + 900.0j, ROTOR.gravity), forces.stop(2e4, 1.5e-4, 0.2)],
    ids=["cubic spring", "crack", "rub"],
)
def test_a_force_that_depends_on_motion_as_scipy_integrates_it(force):
    rotor, condition = dataclasses.replace(ROTOR, bow=1e-5), CONDITIONS[1]
    waves, state = waveforms(rotor, (force,), [condition], steps=768)
    mass, damping, stiffness = rotor.matrices(condition.speed)
    excitation, n = rotor.excitation(condition.speed, condition.unbalance), 2 * rotor.places
    disk, shaft, period = rotor.at_disk(), rotor.shaft_deflection(), 2 * np.pi / condition.speed

    def rate(t, state):
        q, v, angle = state[:n], state[n:], condition.speed * t
        bow = (rotor.bow * FORWARD * np.exp(1j * angle)).real
        drive = sum((part * np.exp(1j * order * angle)).real for order, part in excitation.items())
        resists = force.law(np.array(angle), disk @ q, disk @ v, shaft @ q - bow)
        total = drive - damping @ v - stiffness @ q - (shaft if force.on_shaft else disk).T @ resists
        return np.concatenate([v, total / np.diag(mass)])

    # Begun there, SciPy's motion stays if it is the same, and is elsewhere after some turns if not.
    begun = state[0, : 2 * n, 0]
    settled = solve_ivp(rate, (0.0, 12 * period), begun, method="LSODA", rtol=1e-8, atol=1e-12).y[:, -1]
    times = np.arange(256) / 256 * period
    last = solve_ivp(rate, (0.0, period), settled, method="LSODA", rtol=1e-9, atol=1e-13, t_eval=times).y
    expected = vectors(disk @ last[:n], ORDERS)
    found = vectors(waves, ORDERS)[0]
    assert np.max(np.abs(found - expected)) < 1e-4 * np.max(np.abs(expected))
    without = vectors(waveforms(rotor, (), [condition], steps=64)[0], ORDERS)[0]
    assert np.max(np.abs(found - without)) > 0.01 * np.max(np.abs(expected))


def test_without_its_detail_it_is_a_rotor_of_one_mass():
    stiff = dataclasses.replace(
        ROTOR, shaft_mass=1e-6, polar=1e-9, position=0.5, bearing_stiffness=(1e4 * SPRING,) * 2,
        bearing_damping=(0.0, 0.0), disk_mass=MASS, gravity=(0.0, 0.0), cross=700.0, gyroscopic=0.1,
    )  # fmt: skip
    s, c = CONDITIONS[2].speed, np.array(stiff.disk_damping)
    whirl = np.array([[0.0, 1.0], [-1.0, 0.0]])
    dynamic = np.diag(SPRING - MASS * s**2 + 1j * s * c) + (700.0 + 1j * s**2 * 0.1) * whirl
    expected = np.linalg.solve(dynamic, s**2 * CONDITIONS[2].unbalance * FORWARD)
    found = stiff.at_disk() @ stiff.steady(s, CONDITIONS[2].unbalance)[1]
    assert np.allclose(found, expected, rtol=2e-3)


def test_a_bent_shaft_reads_its_bow_at_slow_roll():
    rotor = dataclasses.replace(ROTOR, bow=2e-5 - 1e-5j)
    assert np.allclose(rotor.at_disk() @ rotor.steady(1e-3, 0.0)[1], rotor.bow * FORWARD, rtol=1e-6)


def test_what_has_no_steady_motion_is_refused():
    with pytest.raises(NoSteadyStateError, match="unstable"):
        waveforms(dataclasses.replace(ROTOR, cross=0.5 * SPRING), (), CONDITIONS, steps=64)
    stepper = Stepper(ROTOR, (forces.power(-1e14, 3),), CONDITIONS, 96)
    with pytest.raises(NoSteadyStateError), np.errstate(over="ignore", invalid="ignore"):
        periodic(stepper, stepper.begin(ROTOR, CONDITIONS))


def test_the_chain_in_its_order():
    speeds, turn = np.array([100.0]), 2 * np.pi * np.arange(64) / 64
    waves = np.stack([2e-5 * np.cos(turn), 1e-5 * np.sin(turn)])[None]
    chain = Chain(
        angles=(0.1, 1.7), runout={1: (1e-6, 2e-6j)}, gains=(1.1, 0.9), common_gain=1.05j, delay=1e-3, reference=0.2
    )
    x, y = 2e-5, -1e-5j
    seen = np.array([np.cos(a) * x + np.sin(a) * y for a in chain.angles]) + np.array([1e-6, 2e-6j])
    expected = seen * np.array(chain.gains) * 1.05 * np.exp(1j * (np.pi / 2 + 0.2 - 0.1))
    assert np.allclose(chain.read(waves, speeds, (1,))[0, :, 0], expected)
    bent = dataclasses.replace(Chain(), inverse_limit=1e3).read(waves, speeds, (1, 3))[0, 0]
    # tanh(w/h) h = w - w³/(3 h²): the first order loses a quarter of 3/3 (w/h)².
    assert abs(bent[0]) / 2e-5 == pytest.approx(1.0 - 0.25 * (2e-5 * 1e3) ** 2, abs=1e-6)
