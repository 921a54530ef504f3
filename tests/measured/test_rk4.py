"""The RK4 rotor kit: what `make run` says of real measurements, number by number."""

from importlib.resources import as_file, files

import numpy as np
import pytest

from rotorjax import diagnose, effects, read_measurement, read_rig, tell
from rotorjax.reporting.comparison import findings, verdict
from rotorjax.reporting.critical_speeds import critical_speeds_lines

ADDED = ("residual_unbalance", "phase_reference_offset", "probe_angle", "plane_participation")


@pytest.fixture(scope="module")
def rig():
    with as_file(files("rotorjax") / "data" / "rk4" / "rig.toml") as path:
        return read_rig(path)


@pytest.fixture(scope="module")
def measurement(rig):
    with as_file(files("rotorjax") / "data" / "rk4" / "measurement.csv") as path:
        return read_measurement(path, rig)


@pytest.fixture(scope="module")
def story(rig, measurement):
    return tell(rig.model, measurement, [effects.CATALOG[name]() for name in ADDED])


def test_table(measurement):
    """21 conditions at two speeds, one of them missing; signal 16.9 µm rms; repeats scatter by about 0.05 µm."""
    assert len(measurement.runs) == 21
    assert int(measurement.present.sum()) == 82
    assert measurement.rms == pytest.approx(16.85e-6, rel=1e-3)
    assert measurement.sigma.max() == pytest.approx(0.0289e-6, rel=0.02)
    baseline = measurement.runs.index("BASE")
    first = int(np.argmax(measurement.run == baseline))
    assert measurement.vectors[first, 0, 0] * 1e6 == pytest.approx(8.8567 - 4.0523j, abs=1e-3)


def test_error_falls(story):
    """17.0 µm as declared; 9.6, 0.94, 0.87 and 0.68 µm rms as effects are added; 22-fold on runs held out."""
    rms = [view.rms * 1e6 for view in story.views]
    assert story.declared.rms * 1e6 == pytest.approx(17.0, abs=0.1)
    np.testing.assert_allclose(rms, [16.2, 9.56, 0.937, 0.870, 0.684], rtol=0.01)
    held = [fitted.held_out_rms * 1e6 for fitted in story.fits]
    assert held[-1] == pytest.approx(0.759, rel=0.02)
    assert story.declared.rms * 1e6 / held[-1] > 10.0
    assert story.fits[-1].converged


def test_parameters(story):
    """Residual unbalance 49 g mm; reference offset 75 ± 7°; probes 95 - 0.8 ° apart; second plane 1.10; critical speeds
    about 1600 and 1660 rpm.
    """
    last = story.fits[-1]
    x, y = (last.estimate("residual_unbalance", f"unbalance_{a}_kg_m").value for a in "xy")
    assert np.hypot(x, y) * 1e6 == pytest.approx(48.9, abs=1.0)
    offset = last.estimate("phase_reference_offset", "angle_rad")
    assert np.degrees(offset.value) == pytest.approx(75.4, abs=1.0)
    assert 2.0 < np.degrees(offset.standard_error) < 6.0
    between = np.degrees(
        last.estimate("probe_angle", "angle_rad.X").value - last.estimate("probe_angle", "angle_rad.Y").value
    )
    assert between == pytest.approx(5.9, abs=0.5)
    assert last.estimate("plane_participation", "gain.disk2").value == pytest.approx(0.0996, abs=0.005)
    mass = 1.0 + last.estimate("mass_error", "error").value
    speeds = [1648.0 * np.sqrt((1.0 + last.estimate("stiffness_error", f"error_{a}").value) / mass) for a in "xy"]
    np.testing.assert_allclose(speeds, [1608.0, 1667.0], atol=8.0)
    assert not last.estimate("damping_error", "log_ratio_x").determined


def test_bow_and_unbalance_tie(story):
    """Slow roll is subtracted: a bow does as well as an unbalance, and the tool says so."""
    swap = next(r for r in story.rivals if (r.effect, r.instead) == ("residual_unbalance", "residual_bow"))
    assert swap.tied
    assert any("Residual unbalance ties with residual bow" in line for line in findings(story))
    assert "more than noise" in verdict(story)


def test_no_effect_is_superfluous(story):
    assert all(r.loss > 10.0 for r in story.rivals if r.instead is None)


def test_scatter_between_mountings(story):
    """What is left is 0.5 µm per component: some 1.35 g mm per run account for part of it."""
    last = story.fits[-1]
    assert last.misfit * 1e6 == pytest.approx(0.503, rel=0.02)
    assert last.run_scatter.unbalance_kg_m * 1e6 == pytest.approx(1.35, rel=0.05)


def test_installed_weights_come_back(story, measurement):
    """Read as unbalance alone, every run's weights are found within 5 g mm or 15 %, the second plane counting 1.1
    times.

    The rig file's uncertain mass (10 %) and damping are fitted beside 21 free faults, which leaves their scale
    open.
    """
    diagnosis = diagnose(story.final_model, measurement)
    gain = 1.0 + story.fits[-1].estimate("plane_participation", "gain.disk2").value
    for run in diagnosis.runs:
        assert not run.identifiable
        assert "slow roll was subtracted" in run.reason
        assert run.unbalance is None
        case = int(np.argmax(measurement.run == measurement.runs.index(run.run)))
        installed = np.asarray(measurement.conditions.unbalance)[case]
        total = installed[0] + gain * installed[1]
        assert run.unbalance_alone is not None
        assert np.hypot(*(run.unbalance_alone.pair - total)) < max(5e-6, 0.15 * np.hypot(*total)), run.run


def test_what_follows_from_damping_that_is_open_is_not_told(story):
    """Critical speeds far above the 1213 rpm where the measured speeds end: a damping ratio came out as 0.5 %."""
    assert story.lateral.open_axes == {"x", "y"}
    assert not any(story.lateral.damping_known(one) for one in story.lateral.critical_speeds)
    (line,) = critical_speeds_lines(story)
    assert line.count("damping ratio not determined") == 2
    assert line.count("amplification factor") == 0
