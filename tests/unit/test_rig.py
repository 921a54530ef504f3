"""Rig files: conventions, and refusals that say where and how to mend it."""

import math

import numpy as np
import pytest

from rotorjax import InputError, read_rig

from helpers import RIG, write


def rig_of(folder, text):
    return read_rig(write(folder, rig=text)[1])


def problems(folder, text) -> str:
    with pytest.raises(InputError) as caught:
        rig_of(folder, text)
    return str(caught.value)


def test_values(tmp_path):
    rig = rig_of(tmp_path, RIG)
    assert float(rig.model.rotor.mass) == 0.97
    np.testing.assert_allclose(rig.model.rotor.stiffness, [56500.0, 51300.0])
    np.testing.assert_allclose(rig.model.probes.angle, [0.0, math.pi / 2])
    assert set(rig.runs) == {"baseline", "trial-a"}
    assert rig.model.slow_roll is None
    assert rig.knowledge.uncertain == ()


def test_weight_angles_and_planes(tmp_path):
    text = RIG.replace("unbalance = { magnitude_g_mm = 30.0, angle_deg = 0.0 }", "")
    text += 'unbalance = [{ plane = "b", magnitude_g_mm = 10.0, angle_deg = 90.0 }, '
    text += '{ plane = "a", magnitude_g_mm = 5.0 }]\n'
    text += "bow = { magnitude_mm = 0.1, angle_deg = 90.0 }\n[planes.a]\n[planes.b]\nparticipation = 0.8\n"
    text += '[convention]\nweight_angles = "against-rotation"\n'
    rig = rig_of(tmp_path, text)
    np.testing.assert_allclose(rig.runs["trial-a"].unbalance, [[5e-6, 0.0], [0.0, -10e-6]], atol=1e-20)
    np.testing.assert_allclose(rig.runs["trial-a"].bow, [0.0, -1e-4], atol=1e-18)
    assert rig.convention.angle_deg(np.array([0.0, -1.0])) == pytest.approx(90.0)


@pytest.mark.parametrize(
    ("text", "expected"),
    [('"none"', (0, 0)), ('"-y"', (0, -9.80665)), ('"+x"', (9.80665, 0)), ("{ angle_deg = 90.0 }", (0, 9.80665))],
)
def test_gravity(tmp_path, text, expected):
    rig = rig_of(tmp_path, RIG.replace("[probes]", f"gravity = {text}\n[probes]"))
    np.testing.assert_allclose(rig.model.rotor.gravity, expected, atol=1e-12)


def test_rotation_and_slow_roll(tmp_path):
    rig = rig_of(
        tmp_path, RIG + '[convention]\nrotation = "y-to-x"\nslow_roll_subtracted = true\nslow_roll_rpm = 300.0\n'
    )
    assert rig.model.rotor.spin == -1
    assert float(rig.model.slow_roll) == pytest.approx(300.0 * math.pi / 30.0)


def test_uncertainty(tmp_path):
    text = (
        RIG + "[uncertainty]\nstiffness = { common = 0.05 }\nmass = 0.1\ndamping_ratio = { x = 0.3, y = 0.0 "
        "}\nprobe_angle_deg = 2.0\ninstalled_bow = 0.03\n"
    )
    known = rig_of(tmp_path, text).knowledge
    stiffness = [u for u in known.uncertain if u.effect == "stiffness_error"]
    assert [u.label for u in stiffness] == ["error_x", "error_y"]
    assert len({u.group for u in stiffness}) == 1
    assert [u.label for u in known.uncertain if u.effect == "damping_error"] == ["log_ratio_x"]
    assert {u.label: u.deviation for u in known.uncertain if u.effect == "probe_angle"} == pytest.approx(
        {"angle_rad.X": math.radians(2.0), "angle_rad.Y": math.radians(2.0)}
    )
    assert known.installed_bow == 0.03


@pytest.mark.parametrize(("text", "expected"), [("3000", (3000.0, 3000.0)), ("[2900, 3000]", (2900.0, 3000.0))])
def test_operating_speeds(tmp_path, text, expected):
    limits = rig_of(tmp_path, f"{RIG}[limits]\noperating_speed_rpm = {text}\n").knowledge.limits
    assert limits.operating_speed_rpm == expected
    assert limits.speed_rpm is None


def test_effects_and_priors(tmp_path):
    text = (
        RIG
        + "[effects.cross_coupling]\ncross_stiffness_n_per_m = 858.0\n[effects.probe_angle]\nangle_rad = { Y = 0.1 }\n"
    )
    text += (
        "[effects.runout]\nreal_m = { X = { 2X = 1e-6 } }\n[prior.cross_coupling]\ncross_stiffness_n_per_m = 2000.0\n"
    )
    rig = rig_of(tmp_path, text)
    assert float(rig.model.find("cross_coupling").cross_stiffness_n_per_m) == 858.0
    np.testing.assert_allclose(rig.model.find("probe_angle").angle_rad, [0.0, 0.1])
    np.testing.assert_allclose(rig.model.with_orders((1.0, 2.0)).find("runout").real_m, [[0.0, 1e-6], [0.0, 0.0]])
    assert rig.knowledge.priors["cross_coupling"]["cross_stiffness_n_per_m"] == 2000.0


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("mass_kg = 0.97", "mass_kg = -1.0"), "rig.toml:2: rotor.mass_kg: must be above 0, not -1"),
        (("mass_kg = 0.97", "mass_kg = inf"), "rotor.mass_kg: must be finite"),
        (("mass_kg = 0.97", 'mass_kg = "heavy"'), "rotor.mass_kg: must be a number, not 'heavy'"),
        (("mass_kg = 0.97", "mas_kg = 0.97"), "rotor.mas_kg: unknown key; did you mean 'mass_kg'?"),
        (("mass_kg = 0.97", ""), "rotor.mass_kg: is missing"),
        (("{ x = 56500.0, y = 51300.0 }", "{ x = 56500.0 }"), "rotor.stiffness_n_per_m.y: is missing"),
        (("[rotor]", "[roto]"), "roto: unknown section; did you mean 'rotor'?"),
        (("angle_deg = 90.0", "angle = 90.0"), "probes.Y.angle: unknown key; did you mean 'angle_deg'?"),
        (
            ("[runs.baseline]", '[convention]\nphase = "lagging"\n[runs.baseline]'),
            "convention.phase: 'lagging' is not one of 'lead', 'lag'",
        ),
        (
            ("[runs.baseline]", "[runs.baseline]\nunbalanc = {}"),
            "runs.baseline.unbalanc: unknown key; did you mean 'unbalance'?",
        ),
        (
            ("[runs.baseline]", '[runs.baseline]\nunbalance = { magnitude_g_mm = 1.0, plane = "b" }'),
            "unknown plane 'b'",
        ),
        (
            ("[runs.baseline]", "[effects.cross_couplin]\n[runs.baseline]"),
            "effects.cross_couplin: unknown effect; did you mean 'cross_coupling'?",
        ),
        (
            ("[runs.baseline]", "[effects.cross_coupling]\nstiffness = 1.0\n[runs.baseline]"),
            "unknown parameter; did you mean 'cross_stiffness_n_per_m'?",
        ),
        (
            ("[runs.baseline]", "[prior.mass_error]\nerror = 0.0\n[runs.baseline]"),
            "prior.mass_error.error: must be above 0",
        ),
        (("[runs.baseline]", "[uncertainty]\nmass = -0.1\n[runs.baseline]"), "uncertainty.mass: must be at least 0"),
        (("[runs.baseline]", "[limits]\nspeed_rpm = [3000, 600]\n[runs.baseline]"), "limits.speed_rpm: must rise"),
        (("[runs.baseline]", '[rotor2]\ngravity = "down"\n[runs.baseline]'), "rotor2: unknown section"),
        (("X = { angle_deg = 0.0 }", '"X.1" = { angle_deg = 0.0 }'), "must not hold any of"),
        (("[runs.baseline]", "[runs.baseline]\nzz = 1"), "unknown key; known here: bow, note, unbalance"),
        (
            ("[runs.baseline]", "[planes.a]\nqq = 1\n[runs.baseline]"),
            "unknown key; known here: first_hole_deg, holes, participation, radius_mm",
        ),
        (
            ("[runs.baseline]", "[limits]\nqq = 1\n[runs.baseline]"),
            "unknown key; known here: amplitude_um, operating_speed_rpm, speed_rpm, trial_weight_g_mm",
        ),
        (
            ("[runs.baseline]", "[uncertainty]\nstiffness = { z = 0.1 }\n[runs.baseline]"),
            "unknown key; known here: common, x, y",
        ),
        (("[runs.baseline]", '[convention]\nrotation = "ccw"\n[runs.baseline]'), "counterclockwise (ccw) is 'x-to-y'"),
        (("[runs.baseline]", "[limits]\noperating_speed_rpm = [3000, 600]\n[runs.baseline]"), "must rise"),
        (("mass_kg = 0.97", "mass_kg = = 0.97"), "not valid TOML"),
    ],
)
def test_refused(tmp_path, change, words):
    assert words in problems(tmp_path, RIG.replace(*change))


WAVEFORM = """[waveform]
sample_rate_hz = 12800
reference = { channel = "ch4", edge = "falling", threshold = "auto" }
X = { channel = "ch1", unit = "V", sensitivity_mv_per_um = 7.874 }
Y = { channel = 2 }
[recordings."a1.mat"]
run = "trial-a"
[recordings."baseline.mat"]
"""


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            ("sample_rate_hz", "sample_rate"),
            "rig.toml:12: waveform.sample_rate: unknown key; did you mean 'sample_rate_hz'?",
        ),
        (("12800", "-1"), "rig.toml:12: waveform.sample_rate_hz: must be above 0, not -1"),
        (("12800", '"fast"'), "waveform.sample_rate_hz: must be a number, not 'fast'"),
        (('channel = "ch4", ', ""), "rig.toml:13: waveform.reference.channel: is missing; name the channel"),
        (('"ch4"', "[4]"), "waveform.reference.channel: must be the name or the number of a channel, not [4]"),
        (("falling", "down"), "waveform.reference.edge: 'down' is not one of 'rising', 'falling'"),
        (('"auto"', '"half"'), "waveform.reference.threshold: 'half' is not \"auto\" or a number"),
        (('"auto"', "true"), 'waveform.reference.threshold: must be "auto" or a number'),
        (("edge", "edg"), "waveform.reference.edg: unknown key; did you mean 'edge'?"),
        (('"V"', '"mil"'), "waveform.X.unit: 'mil' is not one of 'um', 'V'"),
        (("7.874", "0.0"), "waveform.X.sensitivity_mv_per_um: must not be zero"),
        ((", sensitivity_mv_per_um = 7.874", ""), "waveform.X.sensitivity_mv_per_um: is missing"),
        (("channel = 2", "channel = 2, sensitivity_mv_per_um = 7.9"), 'Y.sensitivity_mv_per_um: goes with unit = "V"'),
        (("channel = 2", "channel = -2"), "waveform.Y.channel: must be at least 0"),
        (("Y = { channel = 2 }", "Z = { channel = 2 }"), "rig.toml:15: waveform.Z: unknown key; known here: X, Y"),
        (("Y = { channel = 2 }", "Y = 2"), "rig.toml:15: waveform.Y: must be a table, not 2"),
        (
            ('run = "trial-a"', 'run = "trial-b"'),
            "rig.toml:17: recordings.a1.mat.run: unknown run 'trial-b'; did you mean",
        ),
        (('run = "trial-a"', "run = 3"), "recordings.a1.mat.run: must be the name of a run, not 3"),
        (('run = "trial-a"', ""), "unknown run 'a1', which is the file's name: say run = \"NAME\""),
        (('run = "trial-a"', 'run = "trial-a"\nrate = 3'), "rig.toml:18: recordings.a1.mat.rate: unknown key"),
    ],
)
def test_what_is_said_of_recordings_is_checked(tmp_path, change, words):
    assert set(rig_of(tmp_path, RIG + WAVEFORM).runs) == {"baseline", "trial-a"}
    text = problems(tmp_path, RIG + WAVEFORM.replace(*change))
    assert words in text
    assert len(text.splitlines()) == 1


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "rig.toml: the file is empty; `rotorjax example DIR` writes a rig file"),
        (RIG.replace("mass_kg = 0.97", "mass_kg = 1" + "0" * 400), "rig.toml:2: rotor.mass_kg: 1000000"),
        (
            RIG.replace("mass_kg = 0.97", "mass_kg = 1" + "0" * 5000),
            "rig.toml:2: holds a number of thousands of digits",
        ),
        (RIG.replace("mass_kg = 0.97", "mass_kg = [1, 2]"), "rig.toml:2: rotor.mass_kg: must be a number, not [1, 2]"),
        (RIG.replace("mass_kg = 0.97", "mass_kg = 1.0\nmass_kg = 2.0"), "rig.toml:3: not valid TOML"),
        (RIG + "[rotor]\n", "(the same key or section appears twice)"),
        (RIG + "[limits]\nspeed_rpm = [1,", "rig.toml:12: not valid TOML"),
        (RIG + "[limits]\nspeed_rpm = " + "[" * 5000 + "]" * 5000, "rig.toml:12: not valid TOML: nested too"),
        (RIG + "[limits]\nspeed_rpm = " + "[" * 200 + "]" * 200, "rig.toml:12: limits.speed_rpm: nested too deeply"),
        (RIG + "[" * 3000, "rig.toml:11: not valid TOML"),
        (RIG + "a" + ".a" * 3000 + " = 1\n", "rig.toml:11: a key of more than 50 parts"),
        (RIG + "[a" + ".'a'" * 100_000 + "]\n", "rig.toml:11: a key of more than 50 parts"),
        (RIG + "[a" + ".a" * 40 + "]\na" + ".a" * 40 + " = 1\n", "a.a: nested too deeply"),
        (RIG + "[limits]\nspeed_rpm = 0x" + "f" * 5000, "rig.toml:12: limits.speed_rpm: 0xfff"),
        (
            RIG.replace("magnitude_g_mm = 30.0", "radius_mm = 30.0, mass_g = 1" + "0" * 400),
            ".unbalance.mass_g: 1000000",
        ),
        (RIG + '[runs."a\\nb"]\n', r"rig.toml:11: runs.a\nb: run name holds the control character U+000A; delete it"),
        (RIG + '[runs.""]\n', "rig.toml:11: runs.: a run needs a name, like baseline"),
        (RIG + '[runs." pad "]\n', "rig.toml:11: runs. pad : a table has no spaces around a run's name; write 'pad'"),
        (RIG.replace("X = {", '"X " = {'), "a table has no spaces around a probe's name; write 'X'"),
        (RIG + '[waveform]\nslow_roll = "a\\u0000b"\n', "rig.toml:12: waveform.slow_roll: file name holds the control"),
        (RIG.replace("X = { angle_deg = 0.0 }", "X = 0"), "rig.toml:6: probes.X: must be a table, not 0"),
        (RIG.replace("X = {", '"" = {'), "a probe needs a name"),
        (RIG.replace("magnitude_g_mm", "plane = [1], magnitude_g_mm"), "unknown plane [1]; known here: disk"),
        (RIG + '[runs."a b"]\n"odd key" = 3\n', "rig.toml:12: runs.a b.odd key: unknown key"),
        (RIG + "[runs]\nc.bow.magnitude_mm = -1\n", "rig.toml:"),
        (RIG + '[effects.runout]\nreal_m = { X = { "²X" = 1e-6 } }\n', "unknown parameter"),
        (RIG + "[planes.a]\nholes = 1e15\n", "must be a whole number of evenly spaced holes, 720 at most"),
        ("run,speed_rpm\n", "rig.toml:1: not valid TOML"),
    ],
)
def test_odd_rig_files_are_refused_in_one_message(tmp_path, text, words):
    told = problems(tmp_path, text)
    assert words in told
    assert len(told.splitlines()) == 1


@pytest.mark.parametrize("quotes", ["'''", '"""'])
def test_what_a_note_says_is_no_key(tmp_path, quotes):
    """Lines of a note that look like keys have no line of their own; what follows keeps its own."""
    note = f"note = {quotes}it's \"so\n\"C:\\\\data\" = 1\n[planes.b]\nholes = 2{quotes} # a ''' in a comment\n"
    text = RIG + note + "[planes.b]\nholes = 16\n"
    assert rig_of(tmp_path, text).planes["b"].holes == 16
    assert "rig.toml:16: planes.b.holes: must be" in problems(tmp_path, text.replace("16", "2"))


def test_all_problems_at_once(tmp_path):
    text = problems(
        tmp_path, RIG.replace("mass_kg = 0.97", "mass_kg = -1.0").replace("angle_deg = 90.0", "angle = 90.0")
    )
    assert len(text.splitlines()) == 3


def test_writing_keeps_what_the_user_wrote(tmp_path):
    from rotorjax import effects

    rig = rig_of(tmp_path, "# my rig\n" + RIG)
    rig.write(tmp_path / "new.toml", rig.model + effects.CrossCoupling(700.0))
    text = (tmp_path / "new.toml").read_text()
    assert text.startswith("# my rig\n")
    assert "cross_stiffness_n_per_m = 700.0" in text
    assert float(read_rig(tmp_path / "new.toml").model.find("cross_coupling").cross_stiffness_n_per_m) == 700.0


def test_writing_to_a_missing_folder_is_refused(tmp_path):
    rig = rig_of(tmp_path, RIG)
    with pytest.raises(InputError, match="cannot be written"):
        rig.write(tmp_path / "nowhere" / "new.toml", rig.model)


@pytest.mark.parametrize(
    ("old", "new", "cure"),
    [
        ("magnitude_g_mm = 30.0", "mass_g = 1.5, radius_mm = 30.0", "write magnitude_g_mm = 45 in place of mass_g"),
        (
            "{ magnitude_g_mm = 30.0, angle_deg = 0.0 }",
            "30.0",
            "unbalance = { magnitude_g_mm = 30.0, angle_deg = 0.0 }",
        ),
        ("unbalance = {", "trial_weight_g = 1.0\nunbalance = {", "mass times radius"),
        ("magnitude_g_mm = 30.0", 'magnitude_g_mm = "30 g mm"', "without quotes and without unit"),
        ("[runs.baseline]", "[trial_weights.a]\n[runs.baseline]", "stands under [runs.NAME]"),
        (
            "[runs.baseline]",
            '[convention]\nrotation = "ccw"\n[runs.baseline]',
            "'x-to-y' where the shaft turns from +x",
        ),
        ("[runs.baseline]", '[convention]\nphase = "lagging"\n[runs.baseline]', "did you mean 'lag'"),
        ("[runs.baseline]", "[planes.disk]\nnumber_of_holes = 16\n[runs.baseline]", "did you mean 'holes'"),
    ],
)
def test_what_the_field_writes_is_refused_with_the_cure(tmp_path, old, new, cure):
    assert old in RIG
    assert cure in problems(tmp_path, RIG.replace(old, new))
