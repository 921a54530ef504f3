"""The closed form against time integration, for every effect alone and for all together."""

import dataclasses

import numpy as np
import pytest

from rotorjax import Conditions, Jeffcott, Layout, Model, Probes, effects, response
from rotorjax.model.contract import RestoringEffect, WaveformEffect

from oracle import TimeRotor

MASS, STIFFNESS, RATIO = 0.9686, (56538.0, 51282.0), (0.03, 0.05)
DAMPING = tuple(2 * z * np.sqrt(k * MASS) for z, k in zip(RATIO, STIFFNESS, strict=True))
OMEGA_N = np.sqrt(np.mean(STIFFNESS) / MASS)
SPEEDS = (120.0, 215.0, 233.0, 300.0)
UNBALANCE, BOW = 12e-6 * np.exp(0.4j), 30e-6 * np.exp(2.0j)
PLAIN = TimeRotor(MASS, STIFFNESS, DAMPING, unbalance=UNBALANCE, bow=BOW)


def pair(z: complex) -> list[float]:
    return [z.real, z.imag]


def scaled(**changes):
    return lambda speed: dataclasses.replace(PLAIN, **changes)


def thermal(speed: float) -> TimeRotor:
    return dataclasses.replace(PLAIN, bow=BOW + (20e-6 - 10e-6j) * (speed / OMEGA_N) ** 2)


def foundation_of(compliance: float, log_frequency: float, log_damping: float) -> tuple[float, float, float]:
    stiffness, own = 1.0 / compliance, OMEGA_N * np.exp(log_frequency)
    return stiffness, stiffness / own**2, 2 * 0.05 * np.exp(log_damping) * stiffness / own


def stiffening(speed: float) -> TimeRotor:
    growth = (speed / OMEGA_N) ** 2
    return dataclasses.replace(
        PLAIN, stiffness=(STIFFNESS[0] * (1 + 0.04 * growth), STIFFNESS[1] * (1 - 0.03 * growth))
    )


def losing_damping(speed: float) -> TimeRotor:
    """The force of a loss factor beside viscous damping."""
    viscous, structural = 0.4, 0.6 * OMEGA_N / speed
    return dataclasses.replace(PLAIN, damping=tuple(c * (viscous + structural) for c in DAMPING))


CASES = {
    "residual_unbalance": (effects.ResidualUnbalance(3e-6, -5e-6), scaled(unbalance=UNBALANCE + 3e-6 - 5e-6j)),
    "residual_bow": (effects.ResidualBow(4e-6, 7e-6), scaled(bow=BOW + 4e-6 + 7e-6j)),
    "thermal_bow": (effects.ThermalBow(20e-6, -10e-6), thermal),
    "misalignment": (
        effects.Misalignment(0.3, -0.2, 0.5, 0.1, -0.4, 0.25),
        scaled(force_1=0.3 - 0.2j, force_2=(0.5 + 0.1j, -0.4 + 0.25j)),
    ),
    "stiffness_error": (
        effects.StiffnessError(0.05, -0.08),
        scaled(stiffness=(STIFFNESS[0] * 1.05, STIFFNESS[1] * 0.92)),
    ),
    "mass_error": (effects.MassError(0.07), scaled(mass=MASS * 1.07)),
    "damping_error": (
        effects.DampingError(0.3, -0.5),
        scaled(damping=(DAMPING[0] * np.exp(0.3), DAMPING[1] * np.exp(-0.5))),
    ),
    "stiffness_axes": (effects.StiffnessAxes(0.4, 0.25), scaled(axes=0.4, damping_axes=0.25)),
    "cross_coupling": (effects.CrossCoupling(900.0), scaled(cross=900.0)),
    "speed_dependent_stiffness": (effects.SpeedDependentStiffness(0.04, -0.03), stiffening),
    "speed_dependent_cross_coupling": (
        effects.SpeedDependentCrossCoupling(700.0),
        lambda speed: dataclasses.replace(PLAIN, cross=700.0 * (speed / OMEGA_N) ** 2),
    ),
    "speed_dependent_damping": (effects.SpeedDependentDamping(0.6), losing_damping),
    "internal_damping": (effects.InternalDamping(6.0), scaled(internal=6.0)),
    "gyroscopic": (effects.Gyroscopic(0.06), scaled(gyroscopic=0.06)),
    "foundation": (effects.Foundation(3e-6, 0.3, 0.2), scaled(foundation=foundation_of(3e-6, 0.3, 0.2))),
    "probe_gain": (effects.ProbeGain([0.05, -0.1]), scaled(gains=(1.05, 0.9))),
    "chain_gain": (
        effects.ChainGain(0.2 * np.cos(0.3) + np.cos(0.3) - 1, 1.2 * np.sin(0.3)),
        lambda speed: dataclasses.replace(PLAIN, gains=(1.2, 1.2), delay=-0.3 / speed),
    ),
    "probe_angle": (
        effects.ProbeAngle([0.1, -0.07]),
        scaled(probes=((0.1, 1.0, False), (np.pi / 2 - 0.07, 1.0, False))),
    ),
    "phase_reference_offset": (effects.PhaseReferenceOffset(0.9), scaled(reference=0.9)),
    "time_delay": (effects.TimeDelay(4e-4), scaled(delay=4e-4)),
    "runout": (
        effects.Runout([[2e-6, 1e-6], [-3e-6, 0.0]], [[1e-6, -2e-6], [0.5e-6, 4e-6]]),
        scaled(runout=({1: 2e-6 + 1e-6j, 2: 1e-6 - 2e-6j}, {1: -3e-6 + 0.5e-6j, 2: 4e-6j})),
    ),
}
ORDERS = (1, 2)


def closed_form(effect, speed: float, **settings) -> np.ndarray:
    rotor = Jeffcott(MASS, STIFFNESS, RATIO, **settings)
    model = Model(rotor, layout=Layout(orders=(1.0, 2.0)))
    conditions = Conditions.at([speed], unbalance=pair(UNBALANCE), bow=pair(BOW))
    return np.asarray(response(model + effect if effect else model, conditions))[0]


def assert_same(found: np.ndarray, expected: np.ndarray) -> None:
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-8 * np.max(np.abs(expected)))


@pytest.mark.parametrize("name", CASES)
def test_effect_alone(name):
    effect, in_time = CASES[name]
    for speed in SPEEDS:
        assert_same(closed_form(effect, speed), in_time(speed).vectors(speed, ORDERS))


def test_no_effect_and_speed_error():
    assert_same(closed_form(None, 215.0), PLAIN.vectors(215.0, ORDERS))
    assert_same(closed_form(effects.SpeedError(0.01), 215.0), PLAIN.vectors(215.0 * 1.01, ORDERS))


def test_every_catalogue_effect_is_checked():
    coupled = {
        name for name, cls in effects.CATALOG.items() if issubclass(cls, RestoringEffect | WaveformEffect)
    }  # test_harmonic_balance.py
    elsewhere = coupled | {"speed_error", "plane_participation", "sweep_rate"}  # test_sweep.py
    assert set(CASES) | elsewhere == set(effects.CATALOG)


def test_shaft_turning_from_y_to_x():
    combined = effects.CrossCoupling(900.0)
    for name in ("gyroscopic", "internal_damping"):
        alone = CASES[name][0]
        rotor = Jeffcott(MASS, STIFFNESS, RATIO, rotation="y-to-x")
        model = Model(rotor, layout=Layout(orders=(1.0, 2.0))) + combined + alone
        conditions = Conditions.at([215.0], unbalance=pair(UNBALANCE), bow=pair(BOW))
        changes = {"gyroscopic": 0.06} if name == "gyroscopic" else {"internal": 6.0}
        in_time = dataclasses.replace(PLAIN, sense=-1, cross=900.0, **changes)
        assert_same(np.asarray(response(model, conditions))[0], in_time.vectors(215.0, ORDERS))


def test_bow_through_damping():
    in_time = dataclasses.replace(PLAIN, bow_through_damping=True)
    assert_same(closed_form(None, 233.0, bow_through_damping=True), in_time.vectors(233.0, ORDERS))


def test_planes_and_probe_participation():
    layout = Layout(planes=("disk1", "disk2"), orders=(1.0, 2.0))
    probes = Probes(np.array([0.3, 2.0]), np.array([0.7, 1.2]), np.zeros(2))
    model = Model(
        Jeffcott(MASS, STIFFNESS, RATIO), probes, np.array([1.0, 0.8]), layout=layout
    ) + effects.PlaneParticipation([0.1])
    weights = np.array([[5e-6, 2e-6], [-3e-6, 4e-6]])
    found = np.asarray(response(model, Conditions.at([215.0], unbalance=weights)))[0]
    total = 5e-6 + 2e-6j + 0.8 * 1.1 * (-3e-6 + 4e-6j)
    in_time = dataclasses.replace(PLAIN, unbalance=total, bow=0.0, probes=((0.3, 0.7, False), (2.0, 1.2, False)))
    assert_same(found, in_time.vectors(215.0, ORDERS))


def test_all_effects_together_with_a_probe_on_the_foundation():
    """Every effect at once, in another order of adding, one probe reading against the foundation."""
    speed, speed_error = 215.0, 0.01
    true = speed * (1 + speed_error)
    growth = (true / OMEGA_N) ** 2
    in_time = TimeRotor(
        mass=MASS * 1.07,
        stiffness=(STIFFNESS[0] * (1 + 0.05 + 0.04 * growth), STIFFNESS[1] * (1 - 0.08 - 0.03 * growth)),
        damping=tuple(c * (np.exp(e) + 0.6 * (OMEGA_N / true - 1)) for c, e in zip(DAMPING, (0.3, -0.5), strict=True)),
        axes=0.4, damping_axes=0.25, cross=900.0 + 700.0 * growth, internal=6.0, gyroscopic=0.06,
        foundation=foundation_of(3e-6, 0.3, 0.2), unbalance=UNBALANCE + 3e-6 - 5e-6j,
        bow=BOW + 4e-6 + 7e-6j + (20e-6 - 10e-6j) * growth,
        force_1=0.3 - 0.2j, force_2=(0.5 + 0.1j, -0.4 + 0.25j),
        probes=((0.1, 1.0, True), (np.pi / 2 - 0.07, 1.0, False)), gains=(1.05 * 1.2, 0.9 * 1.2),
        runout=({1: 2e-6 + 1e-6j, 2: 1e-6 - 2e-6j}, {1: -3e-6 + 0.5e-6j, 2: 4e-6j}), delay=4e-4, reference=0.9 + 0.3,
    )  # fmt: skip
    rotor = Jeffcott(MASS, STIFFNESS, RATIO)
    probes = Probes(np.array([0.0, np.pi / 2]), np.ones(2), np.array([1.0, 0.0]))
    model = Model(rotor, probes, layout=Layout(orders=(1.0, 2.0)))
    forward = sum([effect for effect, _ in CASES.values()], model) + effects.SpeedError(speed_error)
    backward = sum([effect for effect, _ in reversed(CASES.values())], model + effects.SpeedError(speed_error))
    conditions = Conditions.at([speed], unbalance=pair(UNBALANCE), bow=pair(BOW))
    found = np.asarray(response(forward, conditions))[0]
    assert_same(found, in_time.vectors(true, ORDERS))
    np.testing.assert_array_equal(found, np.asarray(response(backward, conditions))[0])
