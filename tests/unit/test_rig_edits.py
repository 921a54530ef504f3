"""A mistake put right in the text of a rig file does what the corrected model does."""

import numpy as np
import pytest

from rotorjax import compare, effects, read_measurement, read_rig
from rotorjax.data.declarations import mistakes
from rotorjax.data.example import write_example

NOT_IN_THE_RIG_FILE = ("amplitude_unit", "amplitude_unit.mil")
CHANGES = (
    ("", ""),
    ('amplitude = "peak"', 'amplitude = "peak-to-peak"'),
    ('amplitude = "peak"', 'amplitude = "rms"'),
    ('rotation = "x-to-y"', 'rotation = "y-to-x"\nslow_roll_subtracted = true'),
    ('gravity = "-y"', "gravity = { angle_deg = 30.0 }"),
    ("{ magnitude_g_mm = 30.0, angle_deg = 120.0 }", "[{ magnitude_g_mm = 30.0, angle_deg = 120.0 }]"),
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
        right, data = mistake.put_right(model, measurement)
        ours, theirs = compare(again.model, read_measurement(table, again)), compare(right, data)
        if done:
            share = [one.rms / one.measurement.rms for one in (ours, theirs)]
            if mistake.kind.startswith("amplitude_"):
                # The same vectors, seen by probes of another sensitivity: their units are others.
                scale = theirs.measurement.rms / ours.measurement.rms
                np.testing.assert_allclose(ours.residual * scale, theirs.residual, rtol=1e-9, atol=1e-15)
            else:
                assert share[0] == pytest.approx(share[1], rel=1e-9), mistake.name


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
