"""The detailed rotor of the campaign: its integration in time against closed form and against SciPy, and what is left
of it where it has no more detail than the model.
"""

import csv
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
from detailed.shaft import STEEL, Section, assembled, finite_elements, two_elements

FREQUENCY, MASS = 200.0, 2.0
SPRING = MASS * FREQUENCY**2
ROTOR = Rotor(
    disk_mass=1.8, polar=0.0073, shaft=two_elements(0.6, 0.54, SPRING * 0.6**3 / 48.0, 0.4),
    bearing_stiffness=(10 * SPRING, 7 * SPRING), bearing_damping=(2 * SPRING / FREQUENCY, 1.5 * SPRING / FREQUENCY),
    disk_damping=(2 * 0.03 * MASS * FREQUENCY, 2 * 0.04 * MASS * FREQUENCY), gravity=(0.0, -9.80665),
    reference_speed=FREQUENCY,
)  # fmt: skip
FINITE = dataclasses.replace(
    ROTOR, shaft=finite_elements([Section(0.1, 0.016), Section(0.24, 0.02), Section(0.26, 0.02)], (0.0, 0.6), 0.34),
    second_bearing=0.7,
)  # fmt: skip
"""The same with a stepped shaft of finite elements."""
CONDITIONS = [Condition(FREQUENCY * s, 3e-5 + 1e-5j) for s in (0.6, 0.9, 1.05, 1.4)]
ORDERS = (0, 1, 2, 3)


@pytest.mark.parametrize("plain", [ROTOR, FINITE], ids=["two elements", "finite elements"])
def test_integration_from_rest_meets_the_closed_form(plain):
    rotor = dataclasses.replace(
        plain, bow=1e-5 + 3e-6j, thermal_bow=2e-6j, force_2=(1.0, 2.0j), force_1=0.5 + 0.1j, cross=900.0, internal=2.0,
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
    ("plain", "force"),
    [
        (ROTOR, forces.power(3e11, 3)),
        (ROTOR, forces.crack(2000.0 + 900.0j, ROTOR.gravity)),
        (ROTOR, forces.stop(2e4, 1.5e-4, 0.2)),
        (FINITE, forces.power(3e12, 3)),
    ],
    ids=["cubic spring", "crack", "rub", "cubic spring on finite elements"],
)
def test_a_force_that_depends_on_motion_as_scipy_integrates_it(plain, force):
    rotor, condition = dataclasses.replace(plain, bow=1e-5), CONDITIONS[1]
    waves, state = waveforms(rotor, (force,), [condition], steps=768)
    mass, damping, stiffness = rotor.matrices(condition.speed)
    inverse = np.linalg.inv(mass)
    excitation, n = rotor.excitation(condition.speed, condition.unbalance), 2 * rotor.places
    disk, shaft, period = rotor.at_disk(), rotor.shaft_deflection(), 2 * np.pi / condition.speed

    def rate(t, state):
        q, v, angle = state[:n], state[n:], condition.speed * t
        bow = (rotor.bow * FORWARD * np.exp(1j * angle)).real
        drive = sum((part * np.exp(1j * order * angle)).real for order, part in excitation.items())
        resists = force.law(np.array(angle), disk @ q, disk @ v, shaft @ q - bow)
        total = drive - damping @ v - stiffness @ q - (shaft if force.on_shaft else disk).T @ resists
        return np.concatenate([v, inverse @ total])

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
        ROTOR, shaft=two_elements(0.6, 0.5, SPRING * 0.6**3 / 48.0, 1e-6), polar=1e-9,
        bearing_stiffness=(1e4 * SPRING,) * 2, bearing_damping=(0.0, 0.0), disk_mass=MASS, gravity=(0.0, 0.0),
        cross=700.0, gyroscopic=0.1,
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


@pytest.mark.parametrize("speed", [0.0, 2000.0])
def test_beam_elements_have_the_frequencies_of_a_timoshenko_beam(speed):
    """A uniform beam on two supports, a tenth as thick as long: backward and forward modes k of deflection sin(kπz/L),
    from the equations of motion in x + iy with shear, rotary inertia and gyroscopic moment.
    """
    length, diameter = 0.6, 0.06
    _, stiffness, mass, gyroscopic = assembled([Section(length, diameter, 16)])
    free = np.setdiff1d(np.arange(len(mass)), [0, len(mass) - 2])
    stiffness, mass, gyroscopic = (m[np.ix_(free, free)] for m in (stiffness, mass, gyroscopic))
    damping, n = -1j * speed * gyroscopic, len(free)
    rate = np.block([[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(mass, np.hstack([stiffness, damping]))]])
    found = np.linalg.eigvals(rate).imag
    area, second = np.pi * diameter**2 / 4, np.pi * diameter**4 / 64
    poisson = STEEL["young"] / (2 * STEEL["shear"]) - 1
    sheared = 6 * (1 + poisson) / (7 + 6 * poisson) * STEEL["shear"] * area
    for mode, accuracy in ((1, 5e-5), (2, 6e-4), (3, 3e-3)):
        k = mode * np.pi / length
        across = [STEEL["density"] * area, 0.0, -sheared * k**2]
        inertia = STEEL["density"] * second
        tilting = [inertia, -2 * inertia * speed, -STEEL["young"] * second * k**2 - sheared]
        roots = np.roots(np.polysub(np.polymul(across, tilting), [sheared**2 * k**2])).real
        for exact in sorted(roots, key=abs)[:2]:
            assert np.min(np.abs(found / exact - 1.0)) < accuracy
    thin = np.pi**2 / length**2 * np.sqrt(STEEL["young"] * second / (STEEL["density"] * area))
    assert np.min(np.abs(np.abs(found) / thin - 1.0)) == pytest.approx(0.01, abs=0.008)


def test_finite_elements_answer_as_ross_does():
    """ROSS 3.1.0, eight elements ([reference](../data/README.md)): vectors under unbalance, first modes."""
    shaft = finite_elements([Section(0.24, 0.01, 8)], (0.0, 0.24), 0.12)
    rotor = Rotor(
        disk_mass=0.8, polar=0.5 * 0.8 * 0.0375**2, shaft=shaft, bearing_stiffness=(135.72e3, 108.92e3),
        bearing_damping=(16.0, 13.0), disk_damping=(0.0, 0.0),
    )  # fmt: skip
    table = Path(__file__).parents[1] / "data" / "ross_reference.csv"
    rows = [r for r in csv.DictReader(table.read_text().splitlines()) if r["excitation"].startswith("unbalance")]
    assert len(rows) == 18
    for row in rows:
        steady = rotor.steady(float(row["speed_rpm"]) * np.pi / 30, 16e-6 * np.exp(1j * np.pi / 6))[1]
        expected = 1e-6 * complex(float(row["re_um"]), float(row["im_um"]))
        assert abs((rotor.at_disk() @ steady)["XY".index(row["probe"])] / expected - 1.0) < 1e-5
    mass, damping, stiffness = rotor.matrices(0.0)
    n = len(mass)
    rate = np.block([[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(mass, np.hstack([stiffness, damping]))]])
    first = sorted((v for v in np.linalg.eigvals(rate) if v.imag > 0.0), key=abs)[:2]
    assert np.abs(first) * 30 / np.pi == pytest.approx([3683.48, 3942.51], abs=0.01)
    assert [-v.real / abs(v) for v in first] == pytest.approx([0.014812, 0.014373], abs=1e-6)


@pytest.mark.parametrize(
    ("sections", "disk"),
    [
        ([Section(0.1, 0.016), Section(0.24, 0.02), Section(0.26, 0.018, 6)], 0.34),
        ([Section(0.1, 0.016), Section(0.5, 0.02, 5), Section(0.12, 0.017, 3)], 0.72),
    ],
    ids=["stepped", "overhung"],
)
def test_few_modes_of_the_shaft_do_for_all(sections, disk):
    """Vectors at 1X and 2X from half the first resonance to beyond it."""
    few, whole = (
        dataclasses.replace(
            ROTOR, shaft=finite_elements(sections, (0.0, 0.6), disk, modes=modes), bow=1e-5, force_2=(1.0, 1j)
        )
        for modes in (3, 2 * sum(s.elements for s in sections) - 2)
    )
    for speed in np.linspace(150.0, 500.0, 8):
        found, exact = (r.steady(float(speed), 1e-5) for r in (few, whole))
        for order in (1, 2):
            z, expected = few.at_disk() @ found[order], whole.at_disk() @ exact[order]
            assert np.max(np.abs(z - expected)) < 1e-4 * np.max(np.abs(expected))


def test_weight_of_the_shaft_and_disk_hangs_in_the_bearings():
    vertical = FINITE.steady(1e-3, 0.0)[0].reshape(2, -1)[1]
    force = FINITE.bearing_stiffness[1] * (vertical[0] + FINITE.second_bearing * vertical[1])
    shaft = np.pi / 4 * STEEL["density"] * (0.1 * 0.016**2 + 0.5 * 0.02**2)
    assert -force == pytest.approx(9.80665 * (1.8 + shaft), rel=1e-6)
