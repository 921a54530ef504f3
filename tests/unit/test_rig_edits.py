"""A mistake put right in the text of a rig file does what the corrected model does."""

from pathlib import Path

import numpy as np
import pytest

from rotorjax import effects, read_measurement, read_rig, response
from rotorjax.data.declarations import mistakes
from rotorjax.data.example import write_example
from rotorjax.data.table import parse_table

NOT_IN_THE_RIG_FILE = ("amplitude_unit", "amplitude_unit.mil")
CHANGES = (
    ("", ""),
    ('amplitude = "peak"', 'amplitude = "peak-to-peak"'),
    ('amplitude = "peak"', 'amplitude = "rms"'),
    ('rotation = "x-to-y"', 'rotation = "y-to-x"\nslow_roll_subtracted = true'),
    ('gravity = "-y"', "gravity = { angle_deg = 30.0 }"),
    ("{ magnitude_g_mm = 30.0, angle_deg = 120.0 }", "[{ magnitude_g_mm = 30.0, angle_deg = 120.0 }]"),
    ("[limits]", "[planes.disk]\nradius_mm = 30.0\n\n[limits]"),
    ("[convention]", "[effects.residual_bow]\nbow_x_m = 1e-5\n\n[convention] # ours"),
)


@pytest.mark.parametrize("change", CHANGES)
def test_rig_file_put_right_equals_the_corrected_model(tmp_path, change):
    write_example(tmp_path)
    path, table = tmp_path / "rig.toml", tmp_path / "measurement.csv"
    text = path.read_text(encoding="utf-8")
    assert change[0] in text
    path.write_text(text.replace(*change), encoding="utf-8")
    rig = read_rig(path)
    measurement = read_measurement(table, rig)
    model = rig.model + effects.ResidualBow(2e-5, -1e-5)
    every = mistakes(model, measurement)
    assert len(every) > 12
    for mistake in every:
        written = tmp_path / "right.toml"
        done = rig.write(written, model, mistake)
        assert done == (mistake.name not in NOT_IN_THE_RIG_FILE)
        again = read_rig(written)
        if done:
            (ours, own_rms), (theirs, rms) = (
                residual(again.model, read_measurement(table, again)),
                residual(*mistake.put_right(model, measurement)),
            )
            if mistake.kind.startswith("amplitude_"):
                # The same vectors, seen by probes of another sensitivity: their units are others.
                np.testing.assert_allclose(ours * rms / own_rms, theirs, rtol=1e-9, atol=1e-15)
            else:
                share = [np.linalg.norm(left) / size for left, size in ((ours, own_rms), (theirs, rms))]
                assert share[0] == pytest.approx(share[1], rel=1e-9), mistake.name


def residual(model, measurement):
    """What the model leaves [m], and the size of what was measured."""
    return np.asarray(response(model, measurement.conditions)) - measurement.vectors, measurement.rms


def test_the_rest_stays_as_the_user_wrote_it(tmp_path):
    write_example(tmp_path)
    rig = read_rig(tmp_path / "rig.toml")
    mistake = next(
        s
        for s in mistakes(rig.model, read_measurement(tmp_path / "measurement.csv", rig))
        if s.kind == "phase_sign_reversed"
    )
    rig.write(tmp_path / "right.toml", rig.model, mistake)
    old, new = (set((tmp_path / name).read_text(encoding="utf-8").splitlines()) for name in ("rig.toml", "right.toml"))
    assert len(old - new) == len(new - old) == 1
    assert next(iter(new - old)).startswith('phase = "lag"')


REST = "[rotor]\nmass_kg = 1.0\nstiffness_n_per_m = 5e4\ndamping_ratio = 0.02\n"
INLINE = "unbalance = { magnitude_g_mm = 30.0, angle_deg = 120.0 }\n"
LAYOUTS = (
    f"[runs.b]\n[runs.a]\n{INLINE}",
    "[runs.b]\n[runs.a.unbalance]\nmagnitude_g_mm = 30.0\nangle_deg = 120.0\n",
    "[runs.a]\n[runs.b]\n[limits]\n[runs.a.unbalance]\nmagnitude_g_mm = 30.0\nangle_deg = 120.0\n",
    "[runs.b]\n[[runs.a.unbalance]]\nmagnitude_g_mm = 30.0\nangle_deg = 120.0\n",
    "[runs]\nb = {}\na.unbalance.magnitude_g_mm = 30.0\na.unbalance.angle_deg = 120.0\n",
)


@pytest.mark.parametrize("runs", LAYOUTS)
@pytest.mark.parametrize("kind", ["runs_exchanged", "trial_weight_absent", "trial_weight_opposite"])
def test_runs_are_put_right_however_they_are_laid_out(tmp_path, runs, kind):
    path = tmp_path / "rig.toml"
    path.write_text(f"{REST}{PROBES}[effects.residual_bow]\nbow_x_m = 1e-5\n{runs}", encoding="utf-8")
    rig = read_rig(path)
    mistake = next(one for one in mistakes(rig.model, _measured(rig)) if one.kind == kind)
    assert rig.write(tmp_path / "right.toml", rig.model, mistake)
    again = read_rig(tmp_path / "right.toml")
    in_a, in_b = {"runs_exchanged": (0.0, 120.0), "trial_weight_absent": (0.0, 0.0)}.get(kind, (-60.0, 0.0))
    for name, angle in (("a", in_a), ("b", in_b)):
        x, y = np.sum(again.runs[name].unbalance, axis=0)
        assert np.hypot(x, y) == pytest.approx(3e-5 if angle else 0.0)
        assert np.degrees(np.arctan2(y, x)) == pytest.approx(angle)
    assert again.model.find("residual_bow") is not None


PROBES = "[probes]\nX = { angle_deg = 0.0 }\nY = { angle_deg = 90.0 }\nZ = { angle_deg = 45.0 }\n"


def _measured(rig):
    table = parse_table(
        "run,speed_rpm,probe,order,amplitude_um,phase_deg\n"
        + "".join(f"{run},1000,{probe},1,10.0,30.0\n" for run in "ab" for probe in "XY"),
        Path("table.csv"),
    )
    return rig.measurement(table, Path("table.csv"))


def test_two_of_three_probes_are_exchanged_by_name(tmp_path):
    path = tmp_path / "rig.toml"
    path.write_text(f"{REST}{PROBES}[convention]\nslow_roll_rpm = 600\n{LAYOUTS[0]}", encoding="utf-8")
    rig = read_rig(path)
    every = {one.name: one for one in mistakes(rig.model, _measured(rig))}
    rig.write(tmp_path / "right.toml", rig.model, every["probes_exchanged.X.Y"])
    angles = read_rig(tmp_path / "right.toml").model.probes.angle
    np.testing.assert_allclose(np.degrees(angles), [90.0, 0.0, 45.0])
    subtracted, _ = every["slow_roll_subtracted"].put_right(rig.model, _measured(rig))
    rig.write(tmp_path / "right.toml", rig.model, every["slow_roll_subtracted"])
    assert read_rig(tmp_path / "right.toml").model.slow_roll == subtracted.slow_roll


def test_what_is_said_beside_a_mistake_counts_as_the_rig_file_should_state(tmp_path):
    """Angles of weights and phases beside a mistake, as in the file that is written with it put right: the same
    correction."""
    write_example(tmp_path)
    rig = read_rig(tmp_path / "rig.toml")
    assert rig.put_right(None) is rig
    changed = set()
    for mistake in mistakes(rig.model, read_measurement(tmp_path / "measurement.csv", rig)):
        rig.write(tmp_path / "right.toml", rig.model, mistake)
        counted = rig.put_right(mistake).convention
        assert counted == read_rig(tmp_path / "right.toml").convention
        changed |= {mistake.kind} if counted != rig.convention else set()
    assert changed >= {"weight_angles_reversed", "phase_sign_reversed"}
