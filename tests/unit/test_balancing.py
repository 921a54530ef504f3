"""Corrections: they cancel the unbalance, in holes too, and the words and grades are those of ISO 21940-11."""

import numpy as np
import pytest

from rotorjax import Conditions, InputError, Jeffcott, Layout, Model, effects, read_rig, response
from rotorjax.data.rig_sections import Convention, Plane
from rotorjax.diagnosis.balancing import Correction, before_and_after
from rotorjax.reporting.balance import balance_json, balance_line

UNBALANCE = 9e-6 * np.array([np.cos(np.radians(50.0)), np.sin(np.radians(50.0))])


def correction(plane: Plane, convention: Convention | None = None) -> Correction:
    return Correction(
        "disk", plane, UNBALANCE / plane.participation, 1e-14 * np.eye(2), 0.9, 300.0, convention or Convention()
    )


def test_the_correction_is_opposite_and_its_mass_is_that_at_the_radius():
    found = correction(Plane(radius_m=0.04))
    told = balance_json((found,))["disk"]
    assert told["angle_deg"] == pytest.approx(50.0)
    assert told["correction_angle_deg"] == pytest.approx(230.0)
    assert told["correction_g"] == pytest.approx(0.225)
    assert told["standard_error_g"] == pytest.approx(1e-7 / 0.04 * 1e3)
    # e = 9 g mm / 900 g = 10 µm; G = e Ω = 10e-6 m * 300 rad/s = 3 mm/s
    assert told["grade_before"] == pytest.approx(3.0)
    assert told["grade_after"] == pytest.approx(3.0 * np.sqrt(2.0) * 1e-7 / 9e-6)
    assert "0.225 ± 0.0049 g at 230° in plane disk" in balance_line(found)


def test_angles_against_the_rotation_count_so():
    assert correction(Plane(), Convention(weight_angles="against-rotation")).correction_angle_deg == pytest.approx(
        130.0
    )


def test_without_a_radius_there_is_no_mass():
    found = correction(Plane())
    assert balance_json((found,))["disk"]["correction_g"] is None
    assert "9.00 ± 0.20 g mm at 230°" in balance_line(found)
    assert "radius_mm under [planes.disk]" in balance_line(found)


@pytest.mark.parametrize(("holes", "first"), [(16, 0.0), (3, 0.0), (8, 20.0), (12, 229.0)])
def test_masses_in_two_holes_add_up_to_the_correction(holes, first):
    found = correction(Plane(radius_m=0.04, holes=holes, first_hole_deg=first))
    angles = [np.radians(first + 360.0 / holes * (part.hole - 1)) for part in found.in_holes]
    total = sum(
        0.04 * part.mass_kg * np.array([np.cos(a), np.sin(a)]) for part, a in zip(found.in_holes, angles, strict=True)
    )
    np.testing.assert_allclose(total, -UNBALANCE, atol=1e-15)
    assert all(part.mass_kg >= 0.0 for part in found.in_holes)


@pytest.mark.parametrize("participation", [1.0, -0.4])
def test_what_is_installed_as_told_stills_the_rotor(participation):
    """The correction installed as a weight of a run in a plane that takes part with any sign: nothing is left, and so
    it is predicted.
    """
    rotor = Jeffcott(0.9, [5e4, 4.5e4], [0.01, 0.01])
    model = Model(rotor, participation=np.array([participation]), layout=Layout()) + effects.ResidualUnbalance(
        *UNBALANCE
    )
    found = correction(Plane(participation))
    before, after = before_and_after(model, found, np.array([900.0, 2100.0]))
    weight = found.size * np.array(
        [np.cos(np.radians(found.correction_angle_deg)), np.sin(np.radians(found.correction_angle_deg))]
    )
    installed = np.asarray(response(model, Conditions.at_rpm([900.0, 2100.0], unbalance=weight)))
    largest = np.abs(before).max()
    assert largest > 1e-6
    np.testing.assert_allclose(installed, 0.0, atol=1e-9 * largest)
    np.testing.assert_allclose(after, 0.0, atol=1e-9 * largest)


def test_planes_are_read_and_refused(tmp_path):
    text = (
        "[rotor]\nmass_kg = 1.0\nstiffness_n_per_m = { x = 5e4, y = 5e4 }\ndamping_ratio = { x = 0.01, y = 0.01 }\n"
        "[probes]\nX = { angle_deg = 0.0 }\n[runs.baseline]\n[planes.disk]\n"
    )
    path = tmp_path / "rig.toml"
    path.write_text(text + "radius_mm = 40.0\nholes = 16\nfirst_hole_deg = 5.0\n")
    assert read_rig(path).planes == {"disk": Plane(1.0, 0.04, 16, 5.0)}
    path.write_text(text + "radius_mm = -4.0\nholes = 16.5\n")
    with pytest.raises(InputError) as refused:
        read_rig(path)
    assert len(refused.value.problems) == 2
    assert any("holes" in problem and "whole number" in problem for problem in refused.value.problems)
