"""Results that can be held: summary, report, pictures by name, HTML for notebooks. Hostile names stay harmless."""

import copy
import dataclasses
import pickle
import re

import numpy as np
import pandas
import pytest

from rotorjax import (
    Conditions,
    InputError,
    Jeffcott,
    Layout,
    Measurement,
    Model,
    compare,
    diagnose,
    effects,
    explain,
    fit,
    fit_steps,
    read_measurement,
    read_rig,
    response,
    tell,
)  # fmt: skip
from rotorjax.data.declarations import mistakes
from rotorjax.data.example import write_example
from rotorjax.reporting.curves import Curve, fitted_curves

RUNS = ("<script>", "trial")
SPEEDS = np.array([900.0, 1400.0, 1900.0, 2400.0, 2900.0])


@pytest.fixture(scope="module")
def measured() -> tuple[Model, Measurement]:
    """9 g mm at 50° hidden in a rotor with two probes; a trial weight in the second run."""
    model, rng = Model(Jeffcott(0.9, [5e4, 4.5e4], [0.02, 0.02]), layout=Layout()), np.random.default_rng(3)
    unbalance = np.repeat([[[0.0, 0.0]], [[2e-5, 0.0]]], len(SPEEDS), axis=0)
    conditions = Conditions.at_rpm(np.tile(SPEEDS, 2), unbalance=unbalance)
    z = np.asarray(response(model + effects.ResidualUnbalance(5.8e-6, 6.9e-6), conditions))
    sigma = 0.01 * float(np.median(np.abs(z)))
    z = z + sigma * (rng.standard_normal(z.shape) + 1j * rng.standard_normal(z.shape))
    return model, Measurement.from_arrays(z, conditions, run=np.repeat([0, 1], len(SPEEDS)), runs=RUNS, sigma=sigma)


@pytest.fixture(scope="module")
def found(measured):
    return explain(*measured, only=["residual_unbalance", "cross_coupling", "residual_bow"], thorough=False)


@pytest.fixture(scope="module")
def story(measured):
    return tell(*measured, [effects.ResidualUnbalance()])


def test_a_rotor_alone_is_fitted_told_and_diagnosed(measured):
    (model, m), rotor = measured, measured[0].rotor
    assert fit(rotor, m, held_out=False).model.summary() == fit(model, m, held_out=False).model.summary()
    assert len(fit_steps(rotor, [], m)) == 1
    assert tell(rotor, m, []).summary() == tell(model, m, []).summary()
    for mine, same in zip(diagnose(rotor, m).runs, diagnose(model, m).runs, strict=True):
        np.testing.assert_array_equal(mine.unbalance.pair, same.unbalance.pair)


def test_from_arrays_fills_in_what_is_usual(measured):
    _, m = measured
    assert (m.probes, m.orders, m.noise) == (("X", "Y"), (1.0,), "given")
    assert m.present.all()
    assert m.sigma is not None
    assert m.sigma.shape == m.vectors.shape
    first, conditions = m.vectors[: len(SPEEDS)], Conditions.at_rpm(SPEEDS)
    assert Measurement.from_arrays(first, conditions).runs == ("run",)
    assert Measurement.from_arrays(first, conditions).noise == "unknown"
    missing = np.where(np.arange(len(SPEEDS))[:, None, None] == 0, np.nan, first)
    assert not Measurement.from_arrays(missing, conditions).present[0].any()
    with pytest.raises(ValueError, match="vectors have shape"):
        Measurement.from_arrays(m.vectors[:5], m.conditions)
    for sigma in (0.0, np.nan, np.where(np.arange(len(m.vectors))[:, None, None] == 1, -1.0, m.sigma)):
        with pytest.raises(ValueError, match="sigma must be positive"):
            Measurement.from_arrays(m.vectors, m.conditions, run=m.run, runs=RUNS, sigma=sigma)
    with pytest.raises(ValueError, match="nothing was measured"):
        Measurement.from_arrays(np.full_like(m.vectors, np.nan), m.conditions)
    with pytest.raises(ValueError, match="run 2 is not among"):
        Measurement.from_arrays(m.vectors, m.conditions, run=np.full(len(m.vectors), 2), runs=RUNS)


def test_from_arrays_takes_lists(measured):
    _, m = measured
    run = [0] * len(SPEEDS) + [1] * len(SPEEDS)
    listed = Measurement.from_arrays(
        m.vectors.tolist(),
        m.conditions,
        run=run,
        runs=["a", "b"],
        probes=["X", "Y"],
        orders=[1],
        repeat=["r"] * len(run),
    )
    assert (listed.runs, listed.probes, listed.orders) == (("a", "b"), ("X", "Y"), (1.0,))
    assert listed.repeat == ("r",) * len(run)
    np.testing.assert_array_equal(listed.vectors, m.vectors)
    np.testing.assert_array_equal(listed.run, m.run)
    listed.require_layout(Layout(("X", "Y")))


def test_a_run_has_one_weight(measured):
    _, m = measured
    with pytest.raises(ValueError, match="run 'run' holds different installed unbalance or bow: give each its own run"):
        Measurement.from_arrays(m.vectors, m.conditions)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"run": [0.0] * 5 + [1.0] * 5}, r"type float64: give each of 10 cases the index"),
        ({"run": [0, 1]}, r"run has shape \(2,\)"),
        ({"run": [0] * 9 + [-1]}, "run -1 is not among a, b"),
        ({"runs": ("a", "b", "c")}, "run 'c' has no case: leave it out of runs"),
        ({"runs": "run"}, "runs is 'run': write a list"),
        ({"runs": ("a", "a")}, "runs names 'a' twice"),
        ({"probes": ("X", "X")}, "probes names 'X' twice"),
        ({"orders": 1.0}, "orders is 1.0: write a list"),
        ({"orders": (np.nan,)}, "orders holds nan"),
        ({"orders": (1.0, 1)}, "orders names 1.0 twice"),
        ({"repeat": ("1", "2")}, "repeat has 2 labels for 10 cases"),
        ({"sigma": np.ones(3)}, r"sigma has shape \(3,\): give one number, or an array like the vectors"),
        ({"sigma": "small"}, "sigma is no array of float numbers"),
        ({"vectors": [[1.0], [1.0, 2.0]]}, "vectors is no array of complex numbers"),
    ],
)
def test_from_arrays_says_what_is_wrong(measured, given, words):
    _, m = measured
    usual = {"vectors": m.vectors, "conditions": m.conditions, "run": m.run, "runs": ("a", "b")}
    with pytest.raises(ValueError, match=words):
        Measurement.from_arrays(**(usual | given))


@pytest.mark.parametrize("speed", [np.nan, np.inf, 0.0, -900.0])
def test_from_arrays_refuses_a_speed_that_cannot_be(measured, speed):
    _, m = measured
    with pytest.raises(ValueError, match=r"the speed of case 1 is .*: it must be positive and finite"):
        Measurement.from_arrays(m.vectors[:2], Conditions.at_rpm([900.0, speed]))


def test_summaries_say_what_the_command_line_says(found, story, measured):
    assert "The model lacks residual unbalance." in found.summary()
    assert "Critical speeds: " in found.summary()
    for told in (found.summary(), story.summary(), story.fits[-1].summary()):
        assert re.search(
            r"residual_unbalance +unbalance +9\.\d+ ± 0\.\d+ g mm at \d+\.?\d* ± .*unbalance_x_kg_m, unbalance_y_kg_m",
            told,
        )
    assert "natural frequency x" in measured[0].summary()
    assert measured[1].summary().startswith("2 runs, 900 to 2900 rpm")
    assert "Where the model fails" in story.declared.summary()


def test_a_notebook_shows_results_and_escapes_names(found, story, measured):
    shown = [result._repr_html_() for result in (found, story, story.fits[-1], story.declared, *measured)]
    assert " g mm at " in shown[0]
    assert "explained" in shown[0]
    assert all("<script>" not in text for text in shown)
    assert "&lt;script&gt;" in shown[-1]


def test_reports_are_written_where_asked(found, story, tmp_path):
    for result in (found, story):
        path = result.report(tmp_path / "report.html", title="<b>mine</b>")
        text = path.read_text()
        assert "&lt;b&gt;mine" in text
        assert "<script" not in text


@pytest.mark.parametrize("again", [lambda kept: pickle.loads(pickle.dumps(kept)), copy.deepcopy])
def test_results_can_be_saved_and_copied(found, story, measured, again):
    for result in (found, story, story.fits[-1], story.declared, *measured):
        assert again(result).summary() == result.summary()
    kept = again(found)
    assert kept.catalog == found.catalog
    assert kept.cost == found.cost
    assert repr(kept) == repr(found)
    assert kept.plot.amplitude().has_data()


def test_mistakes_can_be_saved(tmp_path):
    write_example(tmp_path)
    rig = read_rig(tmp_path / "rig.toml")
    stated = rig.model, read_measurement(tmp_path / "measurement.csv", rig)
    every = mistakes(*stated)
    for kept, mistake in zip(pickle.loads(pickle.dumps(every)), every, strict=True):
        assert kept.name == mistake.name
        (model, m), (same, alike) = kept.put_right(*stated), mistake.put_right(*stated)
        assert model.summary() == same.summary()
        np.testing.assert_array_equal(m.conditions.unbalance, alike.conditions.unbalance)


def test_results_are_told_apart_as_objects(found, story, measured):
    results = [found, story, story.fits[-1], story.declared, measured[1]]
    assert len({*results, *results}) == 5
    for result in results:
        assert result in results
        assert result != copy.copy(result)


@pytest.mark.parametrize("name", ["error", "amplitude", "polar", "residuals", "correlations"])
def test_pictures_have_labels_and_are_drawn_where_asked(found, story, name):
    for result in (found, story):
        axes = getattr(result.plot, name)()
        assert getattr(result.plot, name)(axes) is axes
        assert axes.has_data()
        assert axes.get_ylabel() or axes.get_yticklabels()


def test_probabilities_name_effects_and_none(found, story):
    labels = [label.get_text() for label in found.plot.probabilities().get_yticklabels()]
    assert labels[0] == "residual_unbalance"
    assert "none" in labels
    assert found.plot.probabilities(step=-1).has_data()
    with pytest.raises(ValueError, match="explain finds that"):
        story.plot.probabilities()


def test_unknown_names_are_answered_with_those_there_are(found, story, measured):
    for ask, message in (
        (lambda: found.plot.amplitude(run="foo"), "no run 'foo'; choose among <script>, trial"),
        (lambda: found.plot.amplitude(probe="Z"), "no probe 'Z'; choose among X, Y"),
        (lambda: found.plot.amplitude(order=2.0), "no order 2.0; choose among 1.0"),
        (lambda: found.plot.polar(probe="Z"), "no probe 'Z'"),
        (lambda: found.plot.orbit(run="foo"), "no run 'foo'"),
        (lambda: found.plot.orbit(probes=("X", "Z")), "no probe 'Z'"),
        (lambda: found.plot.orbit(probes=("X", "X")), "needs two probes"),
        (lambda: found.plot.probabilities(step=9), r"no step 9; choose among 0"),
        (lambda: story.fits[-1].estimate("residual_unbalance", "foo"), r"'residual_unbalance.foo'; choose among .*_x_"),
        (lambda: diagnose(*measured, reference="foo"), "reference run 'foo' is not in the table"),
        (lambda: fit(*measured, free="foo"), "has no 'foo' to fit"),
        (lambda: explain(*measured, only="foo"), "unknown effect 'foo'"),
        (lambda: explain(*measured, max_effects=-1), "max_effects is -1"),
    ):
        with pytest.raises(ValueError, match=message):
            ask()


def test_what_is_no_model_or_no_measurement_is_called_that(measured):
    model, m = measured
    for ask in (compare, fit, explain, diagnose):
        # By name: here types are checked before.
        with pytest.raises(TypeError, match=r"no rotor|parameter 'model'"):
            ask(m, model)
        with pytest.raises(TypeError, match=r"no measurement|parameter 'measurement'"):
            ask(model, "measurement.csv")


def test_a_diagnosis_says_in_short_and_in_a_table_what_it_found(measured):
    found = diagnose(*measured)
    assert repr(found).startswith("Diagnosis(<script>: unbalance 9")
    assert "unbalance g mm ± 95 %" in found.summary()
    assert "<script>" not in found._repr_html_()
    rows = found.to_pandas().set_index("run")
    assert rows.loc["<script>", "unbalance_g_mm"] == pytest.approx(np.hypot(5.8, 6.9), rel=0.1)
    assert rows.loc["<script>", "unbalance_g_mm_angle_deg"] == pytest.approx(50.0, abs=6.0)


def test_one_name_stands_for_a_collection_of_it(measured):
    model, m = measured
    assert diagnose(model, m, reference="trial") is not None
    fitted = fit(model + effects.ResidualUnbalance(), m, free="residual_unbalance", held_out=False)
    assert fitted.free == ("residual_unbalance",)
    assert fitted.estimate("residual_unbalance", "unbalance_x_kg_m").value == pytest.approx(5.8e-6, rel=0.1)


def test_what_was_not_looked_into_is_said(found):
    with pytest.raises(ValueError, match="not looked into"):
        found.plot.missing_force()
    bare = dataclasses.replace(found.story, fits=())
    with pytest.raises(ValueError, match="nothing was fitted"):
        bare.plot.correlations()


def test_curves_go_through_what_the_fit_predicts_with_a_band(story):
    fitted = story.fits[-1]
    curves = fitted_curves(fitted, "trial")
    assert np.isfinite(curves.vectors).all()
    trial = story.measurement.run == 1
    for probe in (0, 1):
        curve = curves.of(probe, 0)
        there = np.interp(story.measurement.speed_rpm[trial], curve.speed_rpm, curve.amplitude_um)
        np.testing.assert_allclose(there, 1e6 * np.abs(fitted.predicted[trial, probe, 0]), rtol=0.02)
        low, high = curve.band_um
        assert np.all((low <= curve.amplitude_um) & (curve.amplitude_um <= high))
        assert np.all(high / curve.amplitude_um < 1.5)
        assert np.abs(np.diff(curve.phase_deg)).max() < 90.0


def test_a_band_is_as_wide_as_draws_of_the_parameters_make_it(story):
    fitted, rng = story.fits[-1], np.random.default_rng(1)
    curve = fitted_curves(fitted, "trial").of(0, 0)
    free = fitted.end.free
    root = np.linalg.cholesky(fitted.covariance[np.ix_(free, free)])
    conditions = Conditions.at_rpm(curve.speed_rpm, unbalance=np.tile([[[2e-5, 0.0]]], (len(curve.speed_rpm), 1, 1)))
    drawn = []
    for _ in range(200):
        point = fitted.end.point.copy()
        point[free] += root @ rng.standard_normal(len(free))
        model = fitted.stage.space.model_at(point)
        drawn.append(np.abs(np.asarray(response(model, conditions))[:, 0, 0]))
    expected = fitted.quantile * np.std(drawn, axis=0)
    np.testing.assert_allclose(curve.spread[:, 0], expected, rtol=0.25)


def test_phases_are_shown_in_the_turn_in_which_they_are_nearest():
    speed = np.linspace(0.0, 10.0, 50)
    curve = Curve(speed, np.exp(-1j * speed))
    assert curve.phase_deg[-1] == pytest.approx(-np.degrees(10.0))
    assert curve.near(np.array([8.0]), np.array([-98.0]))[0] == pytest.approx(-458.0)
    assert np.isnan(Curve(speed, np.zeros(50, complex)).amplitude_um).all()


def test_data_frames_hold_what_the_tables_say(found, story, measured):
    vectors = measured[1].to_pandas()
    assert list(vectors.columns[:6]) == ["run", "speed_rpm", "probe", "order", "amplitude_um_0pk", "phase_lead_deg"]
    assert len(vectors) == measured[1].present.sum()
    parameters = story.fits[-1].to_pandas().set_index("parameter")
    assert parameters.loc["unbalance_x_kg_m", "unit"] == "g mm"
    assert parameters.loc["unbalance_x_kg_m", "low"] < 5.8 < parameters.loc["unbalance_x_kg_m", "high"]
    assert list(story.to_pandas()["step"]) == ["as declared", "+ residual_unbalance"]
    cells = story.last.to_pandas()
    assert cells["standardised"].is_monotonic_decreasing
    ranking = found.to_pandas()
    first = ranking[ranking["step"] == 0]
    assert first["probability"].sum() == pytest.approx(1.0)
    assert first["effect"].iloc[0] == "residual_unbalance"
    numbers = (measured[0] + effects.ResidualUnbalance(5.8e-6, 0.0)).to_pandas().set_index("parameter")
    assert numbers.loc["stiffness x", "value"] == 5e4
    assert numbers.loc["unbalance_x_kg_m", ["part", "unit"]].to_list() == ["residual_unbalance", "g mm"]
    assert numbers.loc["unbalance_x_kg_m", "value"] == pytest.approx(5.8)


@pytest.mark.parametrize(("amplitude", "phase"), [("peak", "lead"), ("peak-to-peak", "lag"), ("rms", "lead")])
def test_a_data_frame_keeps_the_vectors_whatever_the_rig_file_states(tmp_path, amplitude, phase):
    write_example(tmp_path)
    path = tmp_path / "rig.toml"
    path.write_text(path.read_text().replace('"peak"', f'"{amplitude}"').replace('"lead"', f'"{phase}"'))
    rig = read_rig(path)
    assert (rig.convention.amplitude, rig.convention.phase) == (amplitude, phase)
    measurement = read_measurement(tmp_path / "measurement.csv", rig)
    frames = measurement.to_pandas(), pandas.read_csv(tmp_path / "measurement.csv")
    for frame in (*frames, frames[0].assign(phase_deg=frames[1]["phase_deg"]).drop(columns="phase_lead_deg")):
        again = Measurement.from_pandas(frame, rig)
        np.testing.assert_allclose(again.vectors, measurement.vectors, atol=1e-12)
        np.testing.assert_allclose(again.sigma, measurement.sigma)
        assert again.runs == measurement.runs
    quiet = dataclasses.replace(measurement, sigma=None)
    assert Measurement.from_pandas(quiet.to_pandas(), rig).sigma is None


def test_a_data_frame_is_read_as_a_table_is(tmp_path):
    write_example(tmp_path)
    rig = read_rig(tmp_path / "rig.toml")
    measurement = read_measurement(tmp_path / "measurement.csv", rig)
    rig.write_measurement(str(tmp_path / "again.csv"), measurement)
    assert rig.write(str(tmp_path / "again.toml"), rig.model)
    again = read_measurement(tmp_path / "again.csv", read_rig(tmp_path / "again.toml"))
    np.testing.assert_allclose(again.vectors, measurement.vectors, atol=1e-13)
    frame = measurement.to_pandas().assign(run=lambda f: f["run"].replace("trial-a", "trial-c"))
    with pytest.raises(InputError, match=r"data frame:\d+: run 'trial-c' is not in"):
        Measurement.from_pandas(frame, rig)
