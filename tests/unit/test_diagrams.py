"""Orbits, full spectra, centrelines, spectra over speed and natural frequencies: numbers, and what is drawn of them."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from rotorjax import Conditions, Jeffcott, Layout, Measurement, Model, Probes, compare, effects, response, tell
from rotorjax.data.spectra import full_spectrum, spectra
from rotorjax.diagnosis.critical_speeds import critical_speeds_rpm
from rotorjax.diagnosis.lateral import SpeedRange, stability
from rotorjax.diagnosis.natural_frequencies import natural_frequencies
from rotorjax.diagnosis.orbits import Centreline, Orbit, probe_pairs, recorded_orbit
from rotorjax.reporting import plots
from rotorjax.reporting.curves import Curve
from rotorjax.reporting.pictures import story_pictures
from rotorjax.reporting.pictures.orbits import orbit_cases
from rotorjax.reporting.plots.canvas import label_speeds

ORDERS = (0.0, 0.5, 1.0, 2.0)
SPEEDS = np.linspace(600.0, 2900.0, 6)


def read_by(motion: np.ndarray, angle_deg: tuple[float, float]) -> np.ndarray:
    """What two probes show of a motion along x and y."""
    angle = np.radians(angle_deg)
    return np.stack([np.cos(angle), np.sin(angle)], axis=1) @ motion


@pytest.mark.parametrize("angle_deg", [(0.0, 90.0), (45.0, 135.0), (30.0, -40.0)])
def test_an_orbit_is_the_motion_wherever_its_probes_stand(angle_deg, rng):
    motion = rng.standard_normal((2, 4)) + 1j * rng.standard_normal((2, 4))
    motion[:, 0] = motion[:, 0].real
    orbit = Orbit.of(read_by(motion, angle_deg), ORDERS, np.radians(angle_deg))
    np.testing.assert_allclose(orbit.motion, motion, atol=1e-12)
    assert orbit.turns == 2
    assert Orbit(ORDERS, motion * [1.0, 0.0, 1.0, 1.0]).turns == 1
    turn = 2.0 * np.pi * np.linspace(0.0, 2.0, 721)
    expected = np.real(np.exp(1j * np.outer(turn, ORDERS[1:])) @ motion[:, 1:].T)
    np.testing.assert_allclose(orbit.path(), expected, atol=1e-12)
    np.testing.assert_allclose(orbit.at_reference(), expected[[0, 360]], atol=1e-12)


@pytest.mark.parametrize(("spin", "forward", "backward"), [(1, 3.0, 1.0), (-1, 1.0, 3.0)])
def test_forward_is_with_the_rotation(spin, forward, backward):
    """3 e^{iφ} and 1 e^{-iφ} in x + iy: x = 4 cos φ, y = 2 sin φ."""
    orbit = Orbit.of(np.array([[4.0], [-2.0j]]), (1.0,), np.radians([0.0, 90.0]), spin=spin)
    np.testing.assert_allclose([orbit.forward[0], orbit.backward[0]], [forward, backward])
    assert orbit.sense() == ("forward" if spin > 0 else "backward")


def test_a_whirl_that_the_error_leaves_open_is_a_line(rng):
    angle, sigma = np.radians([0.0, 90.0]), 0.1
    z = np.array([[4.0], [-0.1j]])
    assert Orbit.of(z, (1.0,), angle).sense() == "forward"
    orbit = Orbit.of(z, (1.0,), angle, sigma=np.full((2, 1), sigma))
    assert orbit.sense() == "a line"
    assert Orbit.of(z[::-1] * 1.0, (1.0,), angle, sigma=np.full((2, 1), 0.01)).sense() == "backward"
    noise = sigma * (rng.standard_normal((4000, 2, 1)) + 1j * rng.standard_normal((4000, 2, 1)))
    drawn = [Orbit.of(z + each, (1.0,), angle) for each in noise]
    minor = [float(one.forward[0] - one.backward[0]) for one in drawn]
    np.testing.assert_allclose(np.std(minor), orbit.sigma[0], rtol=0.05)


def test_probes_go_in_pairs_that_see_one_plane():
    probes = Probes(
        jnp.radians(jnp.array([0.0, 90.0, 0.0, 20.0, 90.0])), jnp.array([1.0, 1, 0.5, 0.5, 0.5]), jnp.zeros(5)
    )
    names = ("X1", "Y1", "X2", "near", "Y2")
    model = Model(Jeffcott(1.0, 5e4, 0.02), probes, layout=Layout(probes=names))
    assert probe_pairs(model, names) == [(0, 1), (2, 4)]
    assert probe_pairs(model, ("X1", "Y2")) == []
    with pytest.raises(ValueError, match="30° apart"):
        Orbit.of(np.ones((2, 1), complex), (1.0,), np.radians([0.0, 20.0]))


@pytest.fixture(scope="module")
def record():
    """Twenty seconds of a run-up from 20 to 30 Hz: forward 40 µm, backward 10 µm at 1X, forward 6 µm at 0.5X."""
    time = np.arange(40_000) / 2000.0
    angle = 2.0 * np.pi * (20.0 * time + 0.25 * time**2) - 0.3
    motion = 40e-6 * np.exp(1j * (angle + 0.7)) + 10e-6 * np.exp(-1j * angle) + 6e-6 * np.exp(0.5j * angle)
    pulses = np.interp(2.0 * np.pi * np.arange(int(angle[-1] / 2.0 / np.pi) + 1), angle, time)
    return time, motion, pulses


@pytest.mark.parametrize("spin", [1, -1])
def test_a_full_spectrum_tells_forward_from_backward_though_the_speed_varies(record, spin):
    time, motion, pulses = record
    xy = np.stack([motion.real + 30e-6, spin * motion.imag - 80e-6], axis=1)
    angle_deg = (20.0, 100.0)
    found = full_spectrum(time, read_by(xy.T, angle_deg).T, pulses, probe_angle_deg=angle_deg, spin=spin)
    size = [found.amplitude[np.argmin(np.abs(found.order - order))] for order in (1.0, -1.0, 2.0, -2.0)]
    np.testing.assert_allclose(size, [40e-6, 10e-6, 0.0, 0.0], atol=2e-8)
    half = np.abs(found.order - 0.5) < 0.02
    np.testing.assert_allclose(found.amplitude[half].max(), 6e-6, rtol=0.15)


def test_a_record_has_its_orbit(record):
    time, motion, pulses = record
    part, marks = slice(0, 2000), pulses[pulses < 1.0]
    found = recorded_orbit(time[part], np.stack([motion.real, motion.imag], axis=1)[part] + 5e-5, marks)
    np.testing.assert_allclose([found.filtered.forward[0], found.filtered.backward[0]], [40e-6, 10e-6], rtol=0.02)
    assert len(found.at_reference) == len(marks)
    assert np.abs(found.direct).max() < 60e-6
    with pytest.raises(ValueError, match="two probes"):
        recorded_orbit(time, motion.real[:, None], pulses)


def test_spectra_follow_the_speed(record):
    time, motion, pulses = record
    found = spectra(time, motion.real, pulses, step_hz=2.0, count=12)
    np.testing.assert_allclose(found.speed_rpm, 60.0 * (20.0 + 0.5 * found.time), rtol=1e-3)
    peak = found.frequency_hz[np.argmax(found.amplitude, axis=1)]
    assert np.all(np.abs(peak - found.speed_rpm / 60.0) <= 1.01)
    steady = spectra(time, 7e-6 * np.cos(2.0 * np.pi * 24.0 * time), pulses, step_hz=2.0, count=3)
    np.testing.assert_allclose(steady.amplitude.max(axis=1), 7e-6, rtol=1e-3)
    with pytest.raises(ValueError, match="another step_hz"):
        spectra(time, motion.real, pulses, step_hz=0.01)
    with pytest.raises(ValueError, match="evenly"):
        spectra(np.delete(time, 50), np.delete(motion.real, 50), pulses)


def test_natural_frequencies_equal_the_speed_at_critical_speeds_and_modes_are_followed():
    model = Model(Jeffcott(1.0, [5e4, 4.8e4], [0.02, 0.02])) + effects.Gyroscopic(0.3)
    speed = np.linspace(20.0, 5000.0, 400)
    found = natural_frequencies(model, speed)
    assert found.frequency_hz.shape == (400, 2)
    assert found.whirl == ("backward", "forward")
    critical = critical_speeds_rpm(model)
    assert len(critical) == 2
    for k, one in enumerate(critical):
        np.testing.assert_allclose(np.interp(one, speed, found.frequency_hz[:, k]), one / 60.0, rtol=1e-4)
    assert np.all(np.diff(found.frequency_hz[:, 0]) < 0.0)
    assert np.all(np.diff(found.frequency_hz[:, 1]) > 0.0)


def test_modes_that_cross_keep_their_damping():
    """The x mode stiffens with the speed and passes the y mode."""
    model = Model(Jeffcott(1.0, [4.5e4, 5e4], [0.01, 0.04])) + effects.SpeedDependentStiffness(0.5, 0.0)
    found = natural_frequencies(model, np.linspace(20.0, 4000.0, 300))
    rising = int(np.argmax(np.ptp(found.frequency_hz, axis=0)))
    assert found.frequency_hz[0, rising] < found.frequency_hz[0, 1 - rising]
    assert found.frequency_hz[-1, rising] > found.frequency_hz[-1, 1 - rising]
    assert np.all(found.damping_ratio[:, rising] < 0.02)
    assert found.whirl[rising] == "straight line, 0°"
    same = natural_frequencies(Model(Jeffcott(1.0, 5e4, 0.02)), np.linspace(100.0, 3000.0, 5))
    assert same.whirl == ("forward and backward",) * 2


def test_a_mode_that_grows_is_red_from_the_onset_of_instability_on():
    model = Model(Jeffcott(1.0, 5e4, 0.02)) + effects.InternalDamping(12.0)
    speed = np.linspace(50.0, 8000.0, 1600)
    found = natural_frequencies(model, speed)
    onset = speed[np.any(found.damping_ratio < 0.0, axis=1)][0]
    expected = stability(model, SpeedRange(50.0, 8000.0, "measured")).onset_rpm
    np.testing.assert_allclose(onset, expected, rtol=0.01)
    drawn, (axes,) = plots.figure(6.0, 4.0)
    assert plots.campbell(axes, found, critical_rpm=[2135.0], measured_rpm=(500.0, 3000.0)) is axes
    legend = [text.get_text() for text in axes.get_legend().get_texts()]
    assert {"unstable", "critical speed", "measured speeds"} <= set(legend)
    assert [axes.get_xlabel(), axes.get_ylabel()] == ["speed, rpm", "natural frequency, Hz"]
    assert "damping ratio, %" in [other.get_ylabel() for other in drawn.axes]


@pytest.fixture(scope="module")
def story():
    """A horizontal rotor with unequal shaft stiffness, turning from y to x, read at 45° and 135° at 0X, 1X and 2X."""
    orders, names = (0.0, 1.0, 2.0), ("L", "R")
    rotor = Jeffcott(0.97, [5.6e4, 5.1e4], [0.03, 0.03], gravity=[0.0, -9.81], rotation="y-to-x")
    probes = Probes(jnp.radians(jnp.array([45.0, 135.0])), jnp.ones(2), jnp.zeros(2))
    model, rng = Model(rotor, probes, layout=Layout(probes=names, orders=orders)), np.random.default_rng(1)
    unbalance = np.repeat([[[2e-6, 1e-6]], [[2e-5, -2e-6]]], len(SPEEDS), axis=0)
    conditions = Conditions.at_rpm(np.tile(SPEEDS, 2), unbalance=unbalance)
    z = np.asarray(response(model + effects.AsymmetricShaft(3e3, 1e3), conditions))
    noise = 3e-7 * (rng.standard_normal(z.shape) + 1j * rng.standard_normal(z.shape))
    z = np.where(np.array(orders) == 0.0, (z + noise).real, z + noise)
    measurement = Measurement.from_arrays(
        z, conditions, run=np.repeat([0, 1], len(SPEEDS)), runs=("first", "$second"), probes=names, orders=orders,
        sigma=3e-7,
    )  # fmt: skip
    return tell(model, measurement, [effects.AsymmetricShaft()])


def test_orbits_of_a_result_show_measurement_and_model(story):
    axes = story.plot.orbit(run="$second", speed_rpm=2000.0)
    assert axes.get_title(loc="left") == r"\$second, 1980 rpm"
    assert [axes.get_xlabel(), axes.get_ylabel()] == ["x, µm", "y, µm"]
    labels = [text.get_text() for text in axes.get_legend().get_texts()]
    assert [label.split(",")[0] for label in labels] == ["measured", "model"]
    measured, model = (line for line in axes.lines if str(line.get_label()).startswith(("measured", "model")))
    np.testing.assert_allclose(measured.get_xydata(), model.get_xydata(), atol=3.0)
    # The dot is where the probes stand at the phase reference: the sum of the real parts of 1X and 2X.
    case = len(SPEEDS) + 3
    seen = np.real(story.measurement.vectors[case, :, 1:]).sum(axis=1) * 1e6
    x, y = measured.get_xydata()[0]
    np.testing.assert_allclose([(x + y) / np.sqrt(2.0), (y - x) / np.sqrt(2.0)], seen, atol=1e-9)
    assert story.plot.orbit(axes) is axes


def test_full_spectrum_and_centreline_of_a_result(story):
    axes = story.plot.full_spectrum()
    assert [label.get_text() for label in axes.get_xticklabels()] == ["-2X", "-1X", "+1X", "+2X"]
    assert axes.get_ylabel() == "amplitude, µm (0-peak)"
    axes = story.plot.centreline(clearance_um=400.0)
    lines = {str(line.get_label()): line for line in axes.lines}
    position = np.median(lines[r"\$second, measured"].get_xydata(), axis=0)
    np.testing.assert_allclose(position, [0.0, -1e6 * 0.97 * 9.81 / 5.1e4], atol=15.0)
    assert "clearance" in lines
    assert story.plot.campbell().get_ylabel() == "natural frequency, Hz"


def test_what_cannot_be_drawn_is_said(story):
    alone = Measurement.from_arrays(
        np.ones((2, 1, 1), complex) * 1e-6, Conditions.at_rpm([900.0, 1500.0]), probes=("X",)
    )
    rotor = Model(
        Jeffcott(1.0, 5e4, 0.02), Probes(jnp.zeros(1), jnp.ones(1), jnp.zeros(1)), layout=Layout(probes=("X",))
    )
    one = tell(rotor, alone, [])
    for name in ("orbit", "full_spectrum", "centreline"):
        with pytest.raises(ValueError, match="no two probes"):
            getattr(one.plot, name)()
    assert not [caption for caption, _ in story_pictures(one) if caption.startswith(("Orbit", "Full", "Shaft"))]
    blind = dataclasses.replace(story.measurement, present=story.measurement.present & [[True] * 3, [False] * 3])
    blind = tell(story.model, blind, [])
    with pytest.raises(ValueError, match="no reading of both probes"):
        blind.plot.orbit(probes=("L", "R"))


def test_readings_at_critical_speeds_come_first_then_the_largest_then_other_runs(story):
    view, pair = story.last, (0, 1)
    m = view.measurement
    cases = orbit_cases(view, pair, [SPEEDS[1] + 10.0, 9000.0])
    assert len(cases) == 3
    assert {m.runs[m.run[k]] for k in cases} == {"$second"}
    assert list(m.speed_rpm[cases]) == sorted(m.speed_rpm[cases])
    size = np.abs(m.vectors[len(SPEEDS) :, :, 1:]).reshape(len(SPEEDS), -1)
    largest = SPEEDS[np.argmax(np.linalg.norm(size, axis=1))]
    assert any(np.isclose(m.speed_rpm[cases], SPEEDS[1]))
    assert any(np.isclose(m.speed_rpm[cases], largest))
    single = dataclasses.replace(m, present=m.present & (np.arange(len(m.run)) % len(SPEEDS) == 0)[:, None, None])
    few = orbit_cases(dataclasses.replace(view, measurement=single), pair, [])
    assert [m.runs[m.run[k]] for k in few] in (["first", "$second"], ["$second", "first"])


def test_a_report_shows_what_was_measured(story):
    captions = [caption for caption, _ in story_pictures(story)]
    for name in ("orbit", "full_spectrum", "centreline", "campbell"):
        assert sum(caption.startswith(plots.CAPTIONS[name]) for caption in captions) == 1


def test_every_diagram_has_a_caption_and_draws_where_asked(record):
    time, motion, pulses = record
    xy = np.stack([motion.real, motion.imag], axis=1)
    orbit = Orbit.of(np.array([[4e-6], [-2e-6j]]), (1.0,), np.radians([0.0, 90.0]))
    found = spectra(time, motion.real, pulses, step_hz=2.0, count=10)
    place = Centreline(SPEEDS, np.stack([SPEEDS, -SPEEDS], axis=1) * 1e-8)
    natural = natural_frequencies(Model(Jeffcott(1.0, 5e4, 0.02)), SPEEDS)
    given = {
        "orbit": (orbit,),
        "record_orbit": (recorded_orbit(time, xy, pulses), orbit),
        "full_spectrum": (full_spectrum(time, xy, pulses), orbit),
        "centreline": ({"run-up": place},),
        "cascade": (found,),
        "waterfall": (found,),
        "campbell": (natural,),
    }
    assert set(given) == set(plots.CAPTIONS)
    for name, data in given.items():
        (axes,) = plots.figure(5.0, 4.0)[1]
        assert getattr(plots, name)(axes, *data) is axes
        assert axes.has_data()
        assert axes.get_xlabel()
        assert axes.get_ylabel()
        axes.figure.canvas.draw()


@pytest.mark.parametrize(
    ("rms_um", "held_out_um", "noise_um", "drawn"),
    [
        ([0.52, 0.36], [None, 13.45], 0.42, [0.52, 0.36]),
        ([0.3, 0.3], [None, 0.4], 7.07, [0.3, 0.3]),
        ([48.7, 2e-14], [None, 0.0], None, [48.7, 4.87]),
        ([0.0, 0.0], [None, 0.0], 0.42, [0.042, 0.042]),
        ([0.0, 0.0], [None, 0.0], None, [0.0, 0.0]),
    ],
)
def test_the_error_picture_holds_all_that_it_names(rms_um, held_out_um, noise_um, drawn):
    (axes,) = plots.figure(5.6, 3.2)[1]
    plots.error_fall(axes, ["as declared", "+ bow"], rms_um, held_out_um, noise_um=noise_um)
    low, high = axes.get_ylim()
    for line in axes.lines:
        assert np.all((low < line.get_ydata()) & (line.get_ydata() < high)), line.get_label()
    np.testing.assert_allclose(axes.lines[0].get_ydata(), drawn)
    words = [text.get_text() for text in axes.texts]
    assert [word == "0" for word in words] == [value < 1e-9 for value in rms_um]


@pytest.mark.filterwarnings("error")
def test_vectors_of_zero_are_seen():
    conditions = Conditions.at_rpm(SPEEDS, unbalance=(0.0, 0.0))
    measurement = Measurement.from_arrays(np.zeros((len(SPEEDS), 2, 1), complex), conditions, sigma=3e-7)
    found = tell(Model(Jeffcott(1.0, 5e4, 0.02)), measurement, [effects.ResidualUnbalance()])
    axes = found.plot.amplitude()
    (dots,) = (line for line in axes.lines if line.get_label() == "measured")
    assert axes.get_yscale() == "linear"
    assert axes.get_ylim()[0] < 0.0
    np.testing.assert_array_equal(dots.get_ydata(), 0.0)
    assert "Adding residual unbalance does not help: 0.00 µm rms remain." in found.summary()


def test_no_run_vanishes_for_want_of_colours():
    runs = tuple("ABCDEFGH")
    conditions = Conditions.at_rpm(np.tile(SPEEDS, 8))
    z = np.arange(1, 97).reshape(48, 2, 1) * (1e-6 + 1e-6j)
    measurement = Measurement.from_arrays(z, conditions, run=np.repeat(np.arange(8), 6), runs=runs)
    axes = [plots.figure(5.0, 4.0)[1][0] for _ in range(4)]
    view = compare(Model(Jeffcott(1.0, 5e4, 0.02)), measurement)
    plots.polar(axes[0], view, probe="Y", order=1.0, runs=runs)
    curve = Curve(SPEEDS, np.ones(6) * (1e-6 + 0j))
    plots.bode(axes[1], plots.figure(5.0, 4.0)[1][0], view, dict.fromkeys(runs, curve), probe="Y", order=1.0)
    place = Centreline(SPEEDS, np.stack([SPEEDS, -SPEEDS], axis=1) * 1e-8)
    plots.centreline(axes[2], dict.fromkeys((f"machine 7, overhaul {run}" for run in runs), place))
    plots.convergence(axes[3], {run: np.array([1.0, 0.1]) for run in runs}, tolerance=0.01)
    for each in axes:
        seen = {(line.get_color(), line.get_marker()) for line in each.lines if line.get_marker() not in ("None", "x")}
        assert len(seen) >= 8
    axes[2].figure.canvas.draw()
    assert axes[2].get_window_extent().width > 0.5 * axes[2].figure.bbox.width


@pytest.mark.parametrize(
    ("z", "speed_rpm", "expected"),
    [
        (40.0 + 0.05 * np.exp(1j * np.arange(10)), np.linspace(300.0, 1200.0, 10), ["300 rpm"]),
        ([30.0, 30.5j, 31.0j, -30.0], [700.0, 700.0, 700.0, 900.0], ["700 rpm", "900 rpm"]),
        ([49.0 + 49.0j, -49.0 + 49.0j, 49.0 - 49.0j, -49.0 - 49.0j], [1.0, 2.0, 3.0, 4.0], ["1", "2", "3", "4"]),
        ([20.0, 26.0 + 1.0j, 32.0, 1.0], [1000.0, 2000.0, 3000.0, 4000.0], ["1000", "2000"]),
        ([], [], []),
    ],
)
def test_speeds_are_labelled_once_apart_and_within_the_axes(z, speed_rpm, expected):
    drawn, (axes,) = plots.figure(4.6, 4.4)
    axes.set(xlim=(-50.0, 50.0), ylim=(-50.0, 50.0))
    axes.set_aspect("equal", adjustable="box")
    label_speeds(axes, np.array(z, dtype=complex), np.array(speed_rpm), clear=5.0)
    drawn.canvas.draw()
    words = [text.get_text() for text in axes.texts]
    assert words == [each if "rpm" in each else f"{each} rpm" for each in expected]
    boxes = [text.get_window_extent() for text in axes.texts]
    assert not any(one.overlaps(other) for k, one in enumerate(boxes) for other in boxes[:k])
    frame = axes.get_window_extent()
    assert all(frame.x0 <= box.x0 and box.x1 <= frame.x1 and frame.y0 <= box.y0 and box.y1 <= frame.y1 for box in boxes)


def test_the_legend_of_a_polar_plot_hides_nothing(story):
    axes = story.plot.polar()
    axes.figure.canvas.draw()
    legend = axes.get_legend().get_window_extent()
    assert not any(legend.overlaps(text.get_window_extent()) for text in axes.texts if text.get_text())
