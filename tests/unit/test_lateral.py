"""Separation margins, amplitudes at critical speeds and stability against closed forms."""

import dataclasses

import numpy as np
import pytest

from rotorjax import Conditions, Jeffcott, Measurement, Model, effects
from rotorjax.data.knowledge import Knowledge, Limits
from rotorjax.diagnosis.critical_speeds import CriticalSpeed
from rotorjax.diagnosis.lateral import SeparationMargin, SpeedRange, lateral

MASS, STIFFNESS, RATIO = 2.0, 5e4, 0.02
NATURAL = np.sqrt(STIFFNESS / MASS) / (np.pi / 30.0)
ROTOR = Jeffcott(MASS, STIFFNESS, RATIO)


def measured(low: float, high: float) -> Measurement:
    return Measurement.from_arrays(np.full((2, 2, 1), 1e-5 + 0j), Conditions.at_rpm([low, high]))


@pytest.mark.parametrize(
    ("factor", "below", "above"),
    [(2.4, 0.0, 0.0), (2.5, 0.0, 10.0), (3.5, 8.5, 18.5), (25.0, 16.0, 26.0), (None, 16.0, 26.0)],
)
def test_margins_that_api_617_asks_for(factor, below, above):
    speeds = SpeedRange(2000.0, 3000.0, "operating")
    for speed, side, percent, needed in ((1500.0, "below", 25.0, below), (3600.0, "above", 20.0, above)):
        critical = CriticalSpeed(speed, 0.02, factor, False, 0.0, 1.0)
        assert SeparationMargin.of(critical, speeds) == (side, pytest.approx(percent), pytest.approx(needed))
    assert SeparationMargin.of(CriticalSpeed(2500.0, 0.02, factor, False, 0.0, 1.0), speeds)[:2] == (
        "inside",
        0.0,
    )


def test_operating_speeds_come_before_those_measured():
    m = measured(600.0, 3000.0)
    assert SpeedRange.of(m) == (pytest.approx(600.0), pytest.approx(3000.0), "measured")
    stated = dataclasses.replace(m, knowledge=Knowledge(limits=Limits(operating_speed_rpm=(2900.0, 2950.0))))
    assert SpeedRange.of(stated) == (2900.0, 2950.0, "operating")


def test_amplitude_at_the_critical_speed():
    """e / (2ζ) with e = U / M (Genta 2005, equation 2.28 at r = 1), zero-to-peak at both probes."""
    found = lateral(ROTOR + effects.ResidualUnbalance(3e-5, 4e-5), measured(600.0, 3000.0))
    (one,) = found.critical_speeds
    expected = 5e-5 / MASS / (2.0 * RATIO) * 1e6
    assert one.amplitude_um == pytest.approx({"X": expected, "Y": expected}, rel=1e-6)


def test_without_anything_that_excites_there_is_no_amplitude():
    (one,) = lateral(Model(ROTOR), measured(600.0, 3000.0)).critical_speeds
    assert one.amplitude_um is None


def test_forces_that_depend_on_motion_are_left_out():
    found = lateral(ROTOR + effects.ResidualUnbalance(3e-5) + effects.Duffing(1e9), measured(600.0, 3000.0))
    assert found.linearised
    assert found.critical_speeds[0].speed_rpm == pytest.approx(NATURAL, rel=1e-6)
    assert found.critical_speeds[0].amplitude_um is None


def test_internal_damping_is_unstable_above_its_threshold():
    """Ω = ω_n (1 + c_external / c_rotating) (Genta 2005, section 2.5)."""
    rotating = 2.0 * float(ROTOR.damping[0])
    found = lateral(ROTOR + effects.InternalDamping(rotating), measured(600.0, 1.2 * NATURAL)).stability
    assert found.log_decrement > 0.0
    assert found.speed_rpm == pytest.approx(1.2 * NATURAL)
    assert found.frequency_rpm == pytest.approx(NATURAL, rel=0.01)
    assert found.onset_rpm == pytest.approx(1.5 * NATURAL, rel=2e-3)


def test_cross_coupling_above_the_damping_is_unstable_at_every_speed():
    """k > c ω_n (Childs 1993, chapter 1)."""
    threshold = float(ROTOR.damping[0]) * np.sqrt(STIFFNESS / MASS)
    m = measured(600.0, 3000.0)
    unstable, stable = (lateral(ROTOR + effects.CrossCoupling(k * threshold), m).stability for k in (1.01, 0.99))
    assert unstable.onset_rpm == pytest.approx(600.0)
    assert unstable.log_decrement < 0.0 < stable.log_decrement
    assert stable.onset_rpm is None


def test_least_damped_mode_counts():
    found = lateral(
        Model(Jeffcott(MASS, [STIFFNESS, 1.4 * STIFFNESS], [0.03, 0.01])), measured(600.0, 3000.0)
    ).stability
    assert found.log_decrement == pytest.approx(2.0 * np.pi * 0.01, rel=1e-3)
    assert found.frequency_rpm == pytest.approx(np.sqrt(1.4) * NATURAL, rel=1e-6)
    assert found.speed_rpm == pytest.approx(3000.0)


@pytest.mark.parametrize(
    ("axis_ratio", "direction_deg", "known"),
    [(0.0, 90.0, False), (-0.3, -60.0, False), (0.3, 10.0, True), (0.8, 0.0, False)],
)
def test_damping_that_the_data_leave_open_along_y_is_known_of_modes_along_x_alone(axis_ratio, direction_deg, known):
    found = lateral(Model(ROTOR), measured(600.0, 3000.0))
    critical = CriticalSpeed(2500.0, 0.02, 25.0, False, direction_deg, axis_ratio)
    assert found.damping_known(critical)
    assert found._replace(open_axes=frozenset("y")).damping_known(critical) == known
