"""What in a rig file can hardly be meant is said once, with its place and the cure, and nothing where all is well."""

import pytest

from rotorjax import read_measurement, read_rig
from rotorjax.cli import main
from rotorjax.data.table import read_table

from helpers import HEADER, RIG, ROWS, write

DAMPING, STIFFNESS = "damping_ratio = { x = 0.02, y = 0.02 }", "{ x = 56500.0, y = 51300.0 }"
WEIGHT = "magnitude_g_mm = 30.0"


def notes(folder, *change: str) -> tuple[str, ...]:
    data, toml = write(folder, rig=RIG.replace(*change) if change else RIG)
    return read_measurement(data, read_rig(toml)).notes


def test_nothing_is_said_of_an_ordinary_rig(tmp_path):
    assert notes(tmp_path) == ()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ((DAMPING, "damping_ratio = 2"), ["rig.toml:4: rotor.damping_ratio = 2", "200 %", "write 0.02"]),
        ((DAMPING, "damping_ratio = { x = 0.02, y = 0.5 }"), ["rotor.damping_ratio.y = 0.5", "50 %", "write 0.005"]),
        (
            ("mass_kg = 0.97", "mass_kg = 970"),
            ["rig.toml:3: rotor.stiffness_n_per_m", "69 and 73 rpm", "mass_kg is in g"],
        ),
        ((STIFFNESS, "{ x = 56.5, y = 51.3 }"), ["69 and 73 rpm", "far below", "in N/mm, multiply it by 1000"]),
        ((STIFFNESS, "5.65e8"), ["critical speeds are 2304", "far above"]),
        (("mass_kg = 0.97", "mass_kg = 0.00097"), ["far above", "mass_kg is in t, multiply it by 1000"]),
        (
            (WEIGHT, "magnitude_g_mm = 30000"),
            ["rig.toml:10: runs.trial-a.unbalance: 30000 g mm", "times the vibration"],
        ),
        ((WEIGHT, "magnitude_g_mm = 3e-5"), ["runs.trial-a.unbalance: 3e-05 g mm", "standard error of 0.3 µm"]),
        (
            (f"unbalance = {{ {WEIGHT}", "bow = { magnitude_mm = 300.0"),
            ["runs.trial-a.bow: 300 mm", "times the vibration"],
        ),
        (("[runs.baseline]", "[uncertainty]\nstiffness = 2\n[runs.baseline]"), ["uncertainty.stiffness = 2", "0.02"]),
        (("[runs.baseline]", "[model]\ntolerance = 5\n[runs.baseline]"), ["model.tolerance = 5", "500 %", "0.05"]),
    ],
)
def test_one_line_says_place_and_cure(tmp_path, change, words):
    (said,) = notes(tmp_path, *change)
    assert [word for word in words if word not in said] == []


def test_weights_that_cancel_are_no_matter_of_units(tmp_path):
    opposite = "[{ magnitude_g_mm = 30.0, angle_deg = 0.0 }, { magnitude_g_mm = 30.0, angle_deg = 180.0 }]"
    assert notes(tmp_path, "{ magnitude_g_mm = 30.0, angle_deg = 0.0 }", opposite) == ()


def test_sag_is_said_without_a_table(tmp_path):
    rig = read_rig(write(tmp_path, rig=RIG.replace("mass_kg = 0.97", "mass_kg = 9700"))[1])
    (said,) = rig.notes
    assert "the sag is 1.9 m" in said


def test_a_rotor_without_damping_is_no_matter_of_units(tmp_path):
    data, toml = write(tmp_path, rig=RIG.replace(DAMPING, "damping_ratio = 0"))
    assert read_measurement(data, read_rig(toml)).notes == ()


def test_noise_above_all_vectors(tmp_path):
    table = "\n".join([HEADER, *(row.replace(",0.30", ",300") for row in ROWS)]) + "\n"
    data, _ = write(tmp_path, table=table)
    (said,) = read_table(data).notes
    assert "sigma_um" in said
    assert "30 µm" in said


@pytest.mark.parametrize("command", ["compare", "diagnose"])
def test_commands_say_it_on_standard_error(tmp_path, capsys, command):
    data, toml = write(tmp_path, rig=RIG.replace(DAMPING, "damping_ratio = 2"))
    assert main([command, str(data), "--rig", str(toml)]) == 0
    assert capsys.readouterr().err.count("rotor.damping_ratio = 2") == 1
