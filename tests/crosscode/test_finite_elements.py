"""The closed form against finite elements (ROSS 3.1.0): the tolerances are those of a model with two degrees of
freedom.
"""

import csv
from pathlib import Path

import numpy as np
import pytest

from rotorjax import Conditions, Jeffcott, response

ROWS = list(csv.DictReader((Path(__file__).parents[1] / "data" / "ross_reference.csv").read_text().splitlines()))
SPEEDS = sorted({float(row["speed_rpm"]) for row in ROWS})


def finite_elements(kind: str) -> np.ndarray:
    """Vectors, speed x probe [m]."""
    rows = {
        (float(r["speed_rpm"]), r["probe"]): complex(float(r["re_um"]), float(r["im_um"]))
        for r in ROWS
        if r["excitation"].startswith(kind)
    }
    return 1e-6 * np.array([[rows[speed, probe] for probe in "XY"] for speed in SPEEDS])


def twin(**settings) -> Jeffcott:
    return Jeffcott(0.909644, [155051.3, 135346.3], [0.014373, 0.014812], **settings)


def at(magnitude: float, angle_deg: float) -> list[float]:
    return [magnitude * np.cos(np.radians(angle_deg)), magnitude * np.sin(np.radians(angle_deg))]


def test_reference_is_whole():
    assert len(SPEEDS) == 9
    assert len(ROWS) == 36


def test_unbalance():
    found = np.asarray(response(twin(), Conditions.at_rpm(SPEEDS, unbalance=at(16e-6, 30.0))))[:, :, 0]
    ratio = found / finite_elements("unbalance")
    assert np.max(np.abs(np.abs(ratio) - 1.0)) < 0.005
    assert np.max(np.abs(np.degrees(np.angle(ratio)))) < 0.2


@pytest.mark.parametrize(("through_damping", "amplitude", "phase_deg"), [(False, 0.045, 2.3), (True, 0.045, 0.5)])
def test_bow(through_damping, amplitude, phase_deg):
    """K alone is off by up to 2.2°; K + iΩC, as the bearings' springs and dampers stand, brings the phase in."""
    rotor = twin(bow_through_damping=through_damping)
    ratio = np.asarray(response(rotor, Conditions.at_rpm(SPEEDS, bow=at(20e-6, 75.0))))[:, :, 0] / finite_elements(
        "bow"
    )
    assert np.max(np.abs(np.abs(ratio) - 1.0)) < amplitude
    assert np.max(np.abs(np.degrees(np.angle(ratio)))) < phase_deg


def test_bow_below_2500_rpm():
    slow = [i for i, speed in enumerate(SPEEDS) if speed <= 2500]
    ratio = np.asarray(response(twin(), Conditions.at_rpm(SPEEDS, bow=at(20e-6, 75.0))))[:, :, 0] / finite_elements(
        "bow"
    )
    assert np.max(np.abs(np.abs(ratio[slow]) - 1.0)) < 0.014
    assert np.max(np.abs(np.degrees(np.angle(ratio[slow])))) < 1.3
