"""Numbers and names as people read them: values with their errors, probabilities, sizes, what is not determined."""

import dataclasses

import numpy as np
import pytest

from rotorjax import Conditions, Jeffcott, Layout, Measurement, Model, effects, explain, fit, read_rig, response, tell
from rotorjax.data.declarations import amplitude_changes
from rotorjax.data.rig_sections import Convention
from rotorjax.discovery.fit import AS_MASS
from rotorjax.discovery.force_shapes import Reach
from rotorjax.discovery.named_force import reached
from rotorjax.discovery.progress import REPEATED, ProgressReporter
from rotorjax.reporting import plots
from rotorjax.reporting.answer import as_if_lines, sentence, slight
from rotorjax.reporting.comparison import measurement_line, parameter_table, verdict, worst_cells
from rotorjax.reporting.correction import balance_of, correction_lines
from rotorjax.reporting.curves import Curve
from rotorjax.reporting.explanation import notes
from rotorjax.reporting.sizes import sizes
from rotorjax.reporting.to_correct import balance_of_fit
from rotorjax.reporting.wording import percent, plain_name, said, with_error
from rotorjax.units import figures

from helpers import RIG, write

SPEEDS = np.array([900.0, 1400.0, 1900.0, 2400.0, 2900.0])
SIGMA = 2e-7
NARROW = {"unbalance_x_kg_m": 1e-5, "unbalance_y_kg_m": 1e-5}


def measured(*hidden, factor: float = 1.0) -> tuple[Model, Measurement]:
    """A rotor and what it reads with some effects, times a factor; a trial weight in the second run."""
    model, rng = Model(Jeffcott(0.9, [5e4, 4.5e4], [0.02, 0.02])), np.random.default_rng(7)
    unbalance = np.repeat([[[2e-5, 1e-5]], [[4e-5, -1e-5]]], len(SPEEDS), axis=0)
    conditions = Conditions.at_rpm(np.tile(SPEEDS, 2), unbalance=unbalance)
    z = factor * np.asarray(response(model.plus(list(hidden)), conditions))
    z = z + SIGMA * (rng.standard_normal(z.shape) + 1j * rng.standard_normal(z.shape))
    run = np.repeat([0, 1], len(SPEEDS))
    return model, Measurement.from_arrays(z, conditions, run=run, runs=("first", "second"), sigma=SIGMA)


@pytest.mark.parametrize(
    ("value", "error", "shown"),
    [
        (9.0004, 0.0231, "9.00 ± 0.02"),
        (0.9968, 0.017, "0.997 ± 0.017"),
        (1190.2, 21.0, "1190 ± 20"),
        (0.0023, 0.69, "0.0 ± 0.7"),
        (-0.0004, 0.02, "0.00 ± 0.02"),
        (2.96e10, 4.1e8, "(2.96 ± 0.04)e10"),
        (3.2e-9, 1.3e-10, "(3.20 ± 0.13)e-9"),
        (5.0, 0.0, "5.00"),
    ],
)
def test_a_value_is_told_to_the_place_of_its_error(value, error, shown):
    assert with_error(value, error) == shown


@pytest.mark.parametrize(
    ("probability", "shown"),
    [
        (0.99991, "> 99.9 %"),
        (0.9989, "99.9 %"),
        (0.5, "50.0 %"),
        (0.0011, "0.1 %"),
        (4e-75, "< 0.1 %"),
        (0.0, "< 0.1 %"),
    ],
)
def test_probabilities_claim_no_more_than_they_can(probability, shown):
    assert percent(probability) == shown


def test_effects_have_plain_names():
    assert said(["residual_unbalance", "cross_coupling"]) == "residual unbalance and cross-coupled stiffness"
    assert plain_name("term_cubic_x") == "cubic in x"
    assert plain_name("trial_weight_opposite.first") == "trial weight opposite (first)"


def test_sizes_are_those_of_the_field():
    """Stiffness, damping and unbalance as an engineer states them; rig files' names beside."""
    model, m = measured(effects.StiffnessError(0.01, 0.0), effects.DampingError(0.1, 0.0))
    fitted = fit(model + effects.StiffnessError() + effects.DampingError(), m)
    told = {size.what: size for size in sizes(fitted, ("stiffness_error", "damping_error"))}
    assert set(told) == {"stiffness x", "stiffness y", "damping ratio x", "damping ratio y"}
    assert told["stiffness x"].value.startswith(("+1.0", "+0.9"))
    assert told["stiffness x"].value.endswith(" %")
    assert float(told["damping ratio x"].value.split()[0]) == pytest.approx(2.0 * np.exp(0.1), abs=0.1)
    assert told["damping ratio x"].labels == ("log_ratio_x",)
    assert "log_ratio_x" in parameter_table(fitted).text()


def test_what_the_data_leave_open_is_not_determined():
    model, m = measured(effects.ResidualUnbalance(5e-6, 0.0))
    fitted = fit(model + effects.ResidualUnbalance(), m)
    (size,) = sizes(fitted, ("residual_unbalance",))
    assert size.determined
    assert " g mm at " in size.value
    open_ = tuple(e._replace(determined=False) for e in fitted.estimates)
    assert sizes(dataclasses.replace(fitted, estimates=open_), ("residual_unbalance",))[0].value == "not determined"
    model, m = measured()
    (size,) = sizes(fit(model + effects.CrossCoupling(), m), ("cross_coupling",))
    assert not size.determined, "the only size of an effect, and its interval holds zero"


def test_one_definition_of_how_far_off_a_model_is():
    """The rms of noise alone is sqrt 2 standard errors; reduced chi-square is named, and no root of it."""
    model, m = measured(effects.ResidualUnbalance(5e-6, 0.0))
    story = tell(model, m, [])
    assert m.noise_rms == pytest.approx(np.sqrt(2.0) * SIGMA)
    assert story.noise_um() == pytest.approx(1e6 * m.noise_rms)
    assert "0.200 µm per component (given): noise alone is 0.283 µm rms" in measurement_line(m)
    assert f"reduced chi² {figures(story.declared.reduced_chi2)} (1 = noise only)" in verdict(story)
    assert "times the standard error" not in verdict(story)


def test_phases_are_shown_as_the_rig_file_counts_them():
    model, m = measured()
    view = tell(model, m, []).declared
    lead, lag = (worst_cells(view, "", Convention(phase=phase)) for phase in ("lead", "lag"))
    angles = [[int(row[4].split(" at ")[1][:-1]) for row in table.rows] for table in (lead, lag)]
    assert angles[0] == [-angle for angle in angles[1]]
    assert "phase lag" in lag.note
    speed = np.linspace(0.0, 1.0, 5)
    curve = Curve(speed, np.exp(1j * speed))
    np.testing.assert_allclose(curve._replace(lag=True).phase_deg, -curve.phase_deg)


def test_a_polar_plot_says_how_its_angles_count():
    """0° to the right; a lead of 90° above, a lag of 90° below; circles that hold every vector."""
    model, m = measured()
    view = tell(model, m, []).declared
    for phase, sign in (("lead", 1.0), ("lag", -1.0)):
        (axes,) = plots.figure(4.0, 4.0)[1]
        plots.polar(axes, view, probe="X", order=1.0, phase=phase)
        at = {text.get_text(): text.xy for text in axes.texts}
        assert {f"{angle}°" for angle in range(0, 360, 30)} <= set(at)
        assert at["0°"][0] > 1e6 * np.abs(m.vectors[:, 0]).max()
        assert np.sign(at["90°"][1]) == sign
        assert phase in axes.get_xlabel()


@pytest.mark.parametrize(
    ("stated", "kind", "factor"),
    [
        ("peak", "amplitude_doubled", 2.0),
        ("peak", "amplitude_rms", 0.5**0.5),
        ("rms", "amplitude_peak", 2.0**0.5),
        ("peak-to-peak", "amplitude_halved", 0.5),
    ],
)
def test_a_gain_that_a_convention_would_explain_is_said_to_be_one(stated, kind, factor):
    change = next(one for one in amplitude_changes(stated) if one.kind == kind)
    assert change.factor == pytest.approx(factor)
    model, m = measured(factor=change.factor)
    m = dataclasses.replace(m, knowledge=dataclasses.replace(m.knowledge, amplitude=stated))
    found = explain(model, m, only=["chain_gain", "residual_unbalance"], thorough=False)
    assert found.effects == ("chain_gain",)
    (line,) = as_if_lines(found)
    assert change.meaning in line
    assert line in sentence(found)
    model, m = measured(factor=0.95 * change.factor)
    m = dataclasses.replace(m, knowledge=dataclasses.replace(m.knowledge, amplitude=stated))
    assert not as_if_lines(explain(model, m, only=["chain_gain", "residual_unbalance"], thorough=False))


def test_a_convention_that_a_gain_would_stand_for_is_said_to_be_one():
    model, m = measured(factor=0.5**0.5)
    m = dataclasses.replace(m, knowledge=dataclasses.replace(m.knowledge, amplitude="peak"))
    found = explain(model, m, only=["residual_unbalance", "amplitude_rms"], thorough=False)
    assert found.named == ("amplitude_rms",)
    assert as_if_lines(found) == [
        "A gain of all probes of 0.707 would do the same: check scale factors too. So would installed weights all "
        "0.707 times as large as stated. Amplitudes here are as the table states them."
    ]


def test_what_leaves_much_gives_no_correction(tmp_path):
    model, m = measured(effects.ResidualUnbalance(2e-5, 1e-5), effects.CrossCoupling(2500.0))
    found = explain(model, m, only=["residual_unbalance"], mistakes=False, thorough=False)
    assert (found.verdict, found.effects) == ("unexplained", ("residual_unbalance",))
    balance = balance_of(found, read_rig(write(tmp_path)[1]))
    assert balance.corrections == ()
    assert balance.why_none.startswith("No correction: what was found leaves ")


def test_a_fit_that_has_not_settled_gives_no_correction(tmp_path):
    model, m = measured(effects.ResidualUnbalance(2e-5, 1e-5), effects.CrossCoupling(250.0))
    found = explain(model, m, only=["residual_unbalance"], mistakes=False, thorough=False)
    rig = read_rig(write(tmp_path)[1])
    assert found.verdict == "unexplained"
    assert "more than these errors may be wrong" in " ".join(correction_lines(found, rig))
    last = dataclasses.replace(found.story.fits[-1], converged=False)
    story = dataclasses.replace(found.story, fits=(*found.story.fits[:-1], last))
    unsettled = dataclasses.replace(found, story=story)
    assert "the fit has not settled" in balance_of(unsettled, rig).why_none


def test_a_correction_counts_the_participation_that_was_found(tmp_path):
    """Of a trial weight in the second plane a quarter more reached the disk than stated."""
    stated, true, speeds = np.array([1.0, 0.8]), np.array([1.0, 1.0]), np.linspace(900.0, 2900.0, 8)
    weights = np.array([[[0.0, 0.0], [0.0, 0.0]], [[3e-5, 0.0], [0.0, 0.0]], [[0.0, 0.0], [0.0, 3e-5]]])
    conditions = Conditions.at_rpm(np.tile(speeds, 3), unbalance=np.repeat(weights, 8, axis=0))
    layout, rotor = Layout(planes=("A", "B")), Jeffcott(0.97, [56500.0, 51300.0], [0.02, 0.02])
    inherent = effects.ResidualUnbalance(2e-5, -1e-5)
    z = np.asarray(response(Model(rotor, participation=true, layout=layout) + inherent, conditions))
    rng = np.random.default_rng(1)
    z = z + SIGMA * (rng.standard_normal(z.shape) + 1j * rng.standard_normal(z.shape))
    run = np.repeat(np.arange(3), 8)
    m = Measurement.from_arrays(z, conditions, sigma=SIGMA, run=run, runs=("a", "b", "c"))
    model = Model(rotor, participation=stated, layout=layout)
    planes = "[planes.A]\nparticipation = 1.0\n[planes.B]\nparticipation = 0.8\n[runs.baseline]"
    text = RIG.replace("[runs.baseline]", planes).replace("angle_deg = 0.0 }\n", 'angle_deg = 0.0, plane = "A" }\n')
    rig = read_rig(
        write(tmp_path, rig=text.replace('X = { angle_deg = 0.0, plane = "A" }', "X = { angle_deg = 0.0 }"))[1]
    )
    found = fit(model + effects.ResidualUnbalance() + effects.PlaneParticipation(), m, held_out=False)
    one, other = balance_of_fit(found, rig, m).corrections
    for correction in (one, other):
        np.testing.assert_allclose(correction.unbalance.pair, [2e-5, -1e-5], atol=2e-7)
    assert other.plane.participation == pytest.approx(1.0, abs=0.01)
    # The error of the participation comes on top of that of the unbalance.
    assert other.unbalance.half_interval > 1.05 * one.unbalance.half_interval


def test_a_bow_in_the_place_of_an_unbalance_says_why_there_is_no_correction(tmp_path):
    """At one speed a bow that grows does what an unbalance does."""
    model, conditions = Model(Jeffcott(0.9, 5e4, 0.02)), Conditions.at_rpm(np.full(6, 1500.0))
    z = np.asarray(response(model + effects.ThermalBow(3e-5, 1e-5), conditions))
    m = Measurement.from_arrays(z, conditions, sigma=SIGMA)
    m = dataclasses.replace(m, knowledge=dataclasses.replace(m.knowledge, priors={"residual_unbalance": NARROW}))
    found = explain(model, m, only=["thermal_bow", "residual_unbalance"], mistakes=False, thorough=False)
    assert found.effects == ("thermal_bow",)
    assert "residual unbalance does as well" in balance_of(found, read_rig(write(tmp_path)[1])).why_none


def test_another_mass_along_one_axis_does_what_a_stiffness_does_that_grows_with_speed():
    model, m = measured(effects.SpeedDependentStiffness(0.1, 0.0))
    only = ["speed_dependent_stiffness", "mass_error", "stiffness_error"]
    found = explain(model, m, only=only, mistakes=False)
    assert (found.verdict, found.objections) == ("undecided", (AS_MASS,))


def test_gains_of_all_probes_alike_are_not_told_from_one_of_the_chain():
    model, m = measured(factor=0.93)
    found = explain(model, m, only=["chain_gain", "probe_gain"], mistakes=False)
    assert found.verdict == "undecided"
    assert {name for group in found.ties.groups() for names in group for name in names} == {"chain_gain", "probe_gain"}


def test_standard_errors_that_are_far_too_large_are_said_to_be():
    model, m = measured(effects.ResidualUnbalance(2e-5, 1e-5))
    large = dataclasses.replace(m, sigma=2.5 * m.sigma)
    loose = dataclasses.replace(large, knowledge=dataclasses.replace(m.knowledge, installed_unbalance=0.05))
    said_of = [
        [
            line
            for line in notes(explain(model, one, only=["residual_unbalance"], mistakes=False))
            if "times too large" in line
        ]
        for one in (m, large, loose)
    ]
    assert said_of[0] == said_of[2] == []
    assert "stated 3." in said_of[1][0] or "stated 2." in said_of[1][0]


def test_what_hardly_helps_is_not_the_answer():
    """Phases that lag where leads are stated: the best effect does next to nothing, and what is stated may be wrong."""
    model, m = measured(effects.ResidualUnbalance(5e-6, 5e-6))
    turned = dataclasses.replace(m, vectors=np.conj(m.vectors))
    only = ["speed_error", "probe_gain", "mass_error"]
    found = explain(model, turned, only=only, mistakes=False, thorough=False)
    assert found.verdict == "unexplained"
    assert slight(found) or not found.effects
    assert "`--mistakes`" in sentence(found)
    assert "error falls" not in sentence(found)
    tried = explain(model, turned, only=[*only, "weight_absent", "probes_exchanged"], thorough=False)
    assert tried.written.tried
    assert "`--mistakes`" not in sentence(tried)


@pytest.mark.parametrize(
    ("term", "inverse_gap", "believed"),
    [
        ("term_dead_band_x", 1.0 / 50e-6, True),
        ("term_dead_band_x", 1e-46, False),
        ("term_dead_band_x", -1.0 / 50e-6, False),
        ("term_one_sided_stop_x", -1.0 / 50e-6, True),
        ("term_one_sided_stop_x", -1e-138, False),
        ("clearance", 1.0 / 120e-6, True),
        ("clearance", 1.0 / 200e-6, False),
    ],
)
def test_a_gap_that_was_never_reached_is_not_named(term, inverse_gap, believed):
    """The rotor came to 100 µm along x, 90 µm along y, and 130 µm from its place."""
    assert reached(term, inverse_gap, Reach(100e-6, 90e-6, 130e-6)) == believed


def test_a_long_stage_is_told_while_it_goes_on():
    lines: list[str] = []
    reporter = ProgressReporter(lines.append, 100_000)
    reporter.stage("looking")
    with reporter.budget.share(50_000):
        for _ in range(3):
            reporter.budget.spend(REPEATED // 2)
    assert lines == [f"looking ({spent:,} of 100,000 linearisations)" for spent in (0, REPEATED)]
