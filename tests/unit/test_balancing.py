"""Corrections: they cancel the unbalance, in holes too, and the words and grades are those of ISO 21940-11."""

import numpy as np
import pytest

from rotorjax import Conditions, InputError, Jeffcott, Layout, Model, effects, read_measurement, read_rig, response
from rotorjax.data.rig_sections import Convention, Plane
from rotorjax.diagnosis.balancing import Correction, predicted
from rotorjax.diagnosis.fault import Fault
from rotorjax.reporting.balance import balance_json, balance_line, balance_lines
from rotorjax.reporting.intervals import angle_and_error, value_and_error
from rotorjax.reporting.to_correct import Balance, grade_speed

from helpers import RIG, write

UNBALANCE = 9e-6 * np.array([np.cos(np.radians(50.0)), np.sin(np.radians(50.0))])


def correction(plane: Plane, convention: Convention | None = None) -> Correction:
    unbalance = Fault(UNBALANCE, plane.participation**2 * 1e-14 * np.eye(2)).scaled(1.0 / plane.participation)
    return Correction("disk", plane, unbalance, 0.9, 300.0, convention or Convention())


def test_the_correction_is_opposite_and_its_mass_is_that_at_the_radius():
    found = correction(Plane(radius_m=0.04))
    said = balance_json(Balance((found,)))["disk"]
    assert said["angle_deg"] == pytest.approx(50.0)
    assert said["correction_angle_deg"] == pytest.approx(230.0)
    assert said["correction_g"] == pytest.approx(0.225)
    assert said["standard_error_g"] == pytest.approx(1e-7 / 0.04 * 1e3)
    assert said["half_interval_g"] == pytest.approx(1.959964 * 1e-7 / 0.04 * 1e3)
    # e = 9 g mm / 900 g = 10 µm; G = e Ω = 10e-6 m * 300 rad/s = 3 mm/s
    assert said["grade_before"] == pytest.approx(3.0)
    assert said["grade_after"] == pytest.approx(3.0 * np.sqrt(2.0) * 1e-7 / 9e-6)
    # Rayleigh's 95 % quantile is 2.4477 standard errors.
    assert said["grade_after_below"] == pytest.approx(3.0 * 2.447747 * 1e-7 / 9e-6)
    # Of 0.225 ± 0.0049 g and 230° ± 1.248°, which is rounded up.
    line = balance_line(found)
    for words in ("0.225 ± 0.005 g at a radius of 40 mm", "230.0° ± 1.3°", "unbalance at 50.0°", "3.00 mm/s before"):
        assert words in line
    assert "2865 rpm" in line


def test_angles_against_the_rotation_count_so():
    assert correction(Plane(), Convention(weight_angles="against-rotation")).correction_angle_deg == pytest.approx(
        130.0
    )


def test_without_a_radius_there_is_no_mass():
    found = correction(Plane())
    assert balance_json(Balance((found,)))["disk"]["correction_g"] is None
    assert "9.0 ± 0.2 g mm at 230.0°" in balance_line(found)
    assert "radius_mm under [planes.disk]" in balance_line(found)


@pytest.mark.parametrize(("holes", "first"), [(16, 0.0), (3, 0.0), (8, 20.0), (12, 229.0)])
def test_masses_in_two_holes_add_up_to_the_correction(holes, first):
    found = correction(Plane(radius_m=0.04, holes=holes, first_hole_deg=first))
    angles = [np.radians(first + 360.0 / holes * (part.hole - 1)) for part in found.in_holes]
    np.testing.assert_allclose(np.degrees(angles) % 360.0, [part.angle_deg for part in found.in_holes], atol=1e-9)
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
    before, after, error = predicted(model, found, np.array([900.0, 2100.0]))
    weight = found.size * np.array(
        [np.cos(np.radians(found.correction_angle_deg)), np.sin(np.radians(found.correction_angle_deg))]
    )
    installed = np.asarray(response(model, Conditions.at_rpm([900.0, 2100.0], unbalance=weight)))
    largest = np.abs(before).max()
    assert largest > 1e-6
    np.testing.assert_allclose(installed, 0.0, atol=1e-9 * largest)
    np.testing.assert_allclose(after, 0.0, atol=1e-9 * largest)
    # The rotor is linear: what an unbalance as long as the 95 % region leaves, in the direction that shows most.
    turned = [np.array([np.cos(a), np.sin(a)]) * found.left_below for a in np.linspace(0.0, np.pi, 181)]
    left = np.abs(
        [np.asarray(response(model.without("residual_unbalance"), Conditions.at_rpm([900.0, 2100.0], unbalance=w)))
         for w in turned]
    ).max(0)  # fmt: skip
    np.testing.assert_allclose(error, left, rtol=1e-3)


def test_what_is_not_different_from_zero_is_not_corrected_and_has_no_grade():
    weak = Fault(np.array([1e-7, 1e-7]), 1e-14 * np.eye(2))
    assert not weak.differs_from_zero
    assert weak.below == pytest.approx(np.sqrt(2.0) * 1e-7 + 2.447747e-7)
    assert weak.angle_half_interval_deg == 180.0
    assert Fault(np.array([3e-7, 0.0]), 1e-14 * np.eye(2)).differs_from_zero
    assert balance_lines(Balance(why_none="No correction")) == ["No correction"]


def test_intervals_are_students_where_the_residual_gave_the_noise():
    """Quantiles as tabulated: t(5) 2.5706, F(2, 5) 5.7861."""
    found = Fault(np.array([3.3, 0.0]), np.diag([1.0, 4.0]), 5)
    assert found.half_interval == pytest.approx(2.5706, abs=1e-4)
    assert not found.differs_from_zero
    assert found.reach == pytest.approx(2.0 * np.sqrt(2.0 * 5.7861), rel=1e-4)
    assert found._replace(pair=np.array([3.5, 0.0])).differs_from_zero


def test_regions_cover(rng):
    """Of vectors drawn about nothing 95 in 100 are said not to differ from zero, and lie below the bound."""
    root = np.array([[2.0, 0.0], [0.7, 0.3]])
    drawn = [Fault(root @ rng.standard_normal(2), root @ root.T) for _ in range(2000)]
    assert np.mean([not f.differs_from_zero for f in drawn]) == pytest.approx(0.95, abs=0.015)
    assert np.mean([f.magnitude < f.reach for f in drawn]) >= 0.94


@pytest.mark.parametrize(
    ("value", "error", "expected"),
    [
        (9.0012, 0.0232, ("9.00", "0.02")),
        (9.03, 0.1226, ("9.03", "0.12")),
        (29.9, 0.0961, ("29.90", "0.10")),
        (259.4, 239.2, ("259", "239")),
        (9.0, None, ("9.00", "-")),
    ],
)
def test_values_have_the_figures_that_their_error_bears(value, error, expected):
    assert value_and_error(value, error) == expected
    assert value_and_error(value * 1e-6, None if error is None else error * 1e-6, 1e-6) == expected


def test_angles_are_told_to_a_tenth_of_a_degree_at_best():
    assert angle_and_error(-0.02, 0.003) == ("0.0", "0.1")
    assert angle_and_error(-159.7, 17.2) == ("200", "18")


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


def test_the_grade_counts_at_the_operating_speed_else_the_limits_else_what_was_measured(tmp_path):
    def speed(limits: str = "") -> tuple[float, str]:
        data, path = write(tmp_path, rig=RIG + limits)
        speed_rpm, which = grade_speed(read_measurement(data, read_rig(path)))
        return round(speed_rpm, 6), which

    assert speed() == (1500.0, "the highest measured")
    limits = "[limits]\nspeed_rpm = [600, 3000]\n"
    assert speed(limits) == (3000.0, "the highest of [limits]")
    assert speed(limits + "operating_speed_rpm = [3000, 6000]\n") == (6000.0, "the highest operating speed")
