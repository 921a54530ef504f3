"""Mistakes in what rig file and table state, made in the files of the example, which hides two effects."""

import csv
import dataclasses
import re
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))
from rotorjax import (
    Conditions,
    Jeffcott,
    Layout,
    Measurement,
    Model,
    compare,
    effects,
    explain,
    read_measurement,
    read_rig,
    response,
    tell,
)
from rotorjax.arrays import as_array
from rotorjax.data.declarations import mistakes, promising
from rotorjax.data.example import write_example
from rotorjax.discovery.contest import Contender, Contest, make_contest
from rotorjax.discovery.nearest_changes import of_what_fails
from rotorjax.discovery.race import race
from rotorjax.discovery.screening import Change, as_large_as_read, as_stated, beside_forces_of, screen
from rotorjax.discovery.search import begin, wide_noise, with_set
from rotorjax.effects import CATALOG
from rotorjax.inference.data import largest_displacement
from rotorjax.inference.noise import NO_NOISE
from rotorjax.model.contract import Instant, RestoringEffect, SweepEffect

import hidden_forces
import nonlinear_oracle as in_time
from answers import answer
from detailed.case import draw as draw_detailed
from detailed.files import write_case
from drawn_effects import draw
from drawn_mistakes import draw_with_mistake
from hidden import Machine, Plan, measure

EFFECTS = ("residual_unbalance", "cross_coupling")


def lag(rig, rows):
    return rig, [{**row, "phase_deg": -float(row["phase_deg"])} for row in rows]


def radians(rig, rows):
    return rig, [{**row, "phase_deg": np.radians(float(row["phase_deg"]))} for row in rows]


def peak_to_peak(rig, rows):
    return rig, [{**row, **{key: 2.0 * float(row[key]) for key in ("amplitude_um", "sigma_um")}} for row in rows]


def mil(rig, rows):
    return rig, [{**row, **{key: float(row[key]) / 25.4 for key in ("amplitude_um", "sigma_um")}} for row in rows]


def exchanged_cables(rig, rows):
    return rig, [{**row, "probe": {"X": "Y", "Y": "X"}[row["probe"]]} for row in rows]


def exchanged_runs(rig, rows):
    names = {"trial-a": "trial-b", "trial-b": "trial-a"}
    return rig, [{**row, "run": names.get(row["run"], row["run"])} for row in rows]


def opposite(rig, rows):
    before, after = rig.split("[runs.trial-b]")
    turned = re.sub(r"angle_deg = ([-\d.]+)", lambda found: f"angle_deg = {float(found[1]) + 180.0}", after, count=1)
    return f"{before}[runs.trial-b]{turned}", rows


def weight_said_of_the_baseline(rig, rows):
    """What the rig file says of the run in which nothing was installed."""
    section = rig[rig.index("[runs.trial-a]") + len("[runs.trial-a]") : rig.index("[runs.trial-b]")]
    before, after = rig.split("[runs.baseline]")
    rest = after[after.index("[runs.trial-a]") :]
    return f"{before}[runs.baseline]{section}{rest}", rows


def slow_roll_said_to_be_subtracted(rig, rows):
    said = "slow_roll_subtracted = true\nslow_roll_rpm = 700\n"
    return re.sub(r"(\[convention\][^\n]*\n)", rf"\1{said}", rig), rows


def scaled(convention, factor):
    """Amplitudes that are so many times what the rig file says that they are."""

    def made(rig, rows):
        keys = ("amplitude_um", "sigma_um")
        rig = re.sub('amplitude = "[^"]*"', f'amplitude = "{convention}"', rig)
        return rig, [{**row, **{key: factor * float(row[key]) for key in keys}} for row in rows]

    return made


def grams_without_the_radius(rig, rows):
    """The example's weights are of 1 g at 30 mm."""
    plane = "[planes.disk]\nradius_mm = 30.0\n\n[runs.baseline]"
    return rig.replace("magnitude_g_mm = 30.0", "magnitude_g_mm = 1.0").replace("[runs.baseline]", plane, 1), rows


def reversed_probe(rig, rows):
    return rig, [
        {**row, "phase_deg": float(row["phase_deg"]) + (180.0 if row["probe"] == "Y" else 0.0)} for row in rows
    ]


def reversed_rotation(rig, rows):
    return rig.replace('rotation = "x-to-y"', 'rotation = "y-to-x"'), rows


def no_mistake(rig, rows):
    return rig, rows


def explained(folder, mistake, mistakes, **asked):
    """The example with a mistake made in its files."""
    write_example(folder)
    with (folder / "measurement.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    rig_text, rows = mistake((folder / "rig.toml").read_text(encoding="utf-8"), rows)
    (folder / "rig.toml").write_text(rig_text, encoding="utf-8")
    with (folder / "measurement.csv").open("w", encoding="utf-8", newline="") as file:
        table = csv.DictWriter(file, rows[0].keys())
        table.writeheader()
        table.writerows(rows)
    rig = read_rig(folder / "rig.toml")
    measurement = read_measurement(folder / "measurement.csv", rig)
    return explain(rig.model, measurement, mistakes=mistakes, thorough=False, **asked)


CAMPAIGN = pytest.mark.campaign


@pytest.mark.parametrize(
    ("mistake", "name"),
    [
        (lag, "phase_sign_reversed"),
        pytest.param(radians, "phase_unit", marks=CAMPAIGN),
        pytest.param(opposite, "trial_weight_opposite.trial-b", marks=CAMPAIGN),
        pytest.param(peak_to_peak, "amplitude_doubled", marks=CAMPAIGN),
        pytest.param(mil, "amplitude_unit", marks=CAMPAIGN),
        pytest.param(exchanged_cables, "probes_exchanged", marks=CAMPAIGN),
        pytest.param(exchanged_runs, "runs_exchanged.trial-a.trial-b", marks=CAMPAIGN),
        pytest.param(weight_said_of_the_baseline, "trial_weight_absent.baseline", marks=CAMPAIGN),
        pytest.param(slow_roll_said_to_be_subtracted, "slow_roll_subtracted", marks=CAMPAIGN),
        pytest.param(scaled("peak", 2.0**-0.5), "amplitude_rms", marks=CAMPAIGN),
        pytest.param(scaled("rms", 1.0), "amplitude_peak", marks=CAMPAIGN),
        pytest.param(scaled("rms", 2.0), "amplitude_peak_to_peak", marks=CAMPAIGN),
        pytest.param(grams_without_the_radius, "weights_unit.g", marks=CAMPAIGN),
        pytest.param(no_mistake, None, marks=CAMPAIGN),
    ],
)
def test_a_mistake_is_named_with_the_effects_beside_it(tmp_path, mistake, name):
    found = explained(tmp_path, mistake, mistakes=None if name else True)
    named = [found.named, *(other.named for other in found.written.tied)]
    assert tuple(filter(None, (name, *EFFECTS))) in named
    assert found.verdict == ("undecided" if found.tied_groups() else "explained")


@pytest.mark.campaign
@pytest.mark.parametrize("mistake", [reversed_probe, reversed_rotation])
def test_a_reversed_probe_and_a_reversed_rotation_tie(tmp_path, mistake):
    found = explained(tmp_path, mistake, mistakes=True)
    assert found.verdict == "undecided"
    named = {found.named, *(other.named for other in found.written.tied)}
    assert {("rotation_reversed", *EFFECTS), ("probe_reversed.Y", *EFFECTS)} <= named


def test_effects_beside_a_reversed_rotation_are_kept_where_the_limit_ends_the_search(tmp_path):
    """They are found in a mirror, and then sought in the rotor itself."""
    found = explained(tmp_path, reversed_rotation, mistakes=None, only=(*EFFECTS, "rotation_reversed"), limit=6000)
    assert (found.verdict, found.named) == ("undecided", ("rotation_reversed", *EFFECTS))


def test_a_weight_on_the_opposite_side_is_no_participation_of_its_plane():
    """Of a plane that one run uses the participation may be minus that of the rig file; that the weight sat opposite is
    far more probable.
    """
    machine = Machine()
    speeds = tuple(machine.frequency * np.linspace(0.6, 1.4, 9))
    stated = {"none": [0j, 0j], "first": [25e-6 * np.exp(0.7j), 0j], "second": [0j, 30e-6 * np.exp(-1.2j)]}
    made = {**stated, "second": [0j, -stated["second"][1]]}
    z = measure(machine, Plan(made, speeds), {}, np.random.default_rng(11))
    run = np.repeat(np.arange(3), len(speeds))
    unbalance = np.array([[[w.real, w.imag] for w in planes] for planes in stated.values()])[run]
    conditions = Conditions.at(np.tile(speeds, 3), unbalance=unbalance)
    model = Model(
        Jeffcott(machine.mass, machine.stiffness, machine.ratio),
        participation=np.ones(2),
        layout=Layout(planes=("disk1", "disk2"), orders=(1.0,)),
    )
    measurement = Measurement.from_arrays(z, conditions, run=run, runs=tuple(stated), sigma=0.3e-6)
    only = ("plane_participation", "residual_unbalance", "chain_gain", "trial_weight_opposite", "trial_weight_absent")
    found = explain(model, measurement, only=only, thorough=False)
    assert (found.verdict, found.named) == ("explained", ("trial_weight_opposite.second",))
    # What is scored of it: the other answers take their share.
    told = answer(found)
    assert len(found.written.ranked) > 1
    assert 0.9 < told["probability"] < 1.0
    assert told["set95"] == [["trial_weight_opposite.second"]]


def test_of_many_runs_those_are_kept_that_influence_coefficients_allow(tmp_path):
    write_example(tmp_path)
    rig = read_rig(tmp_path / "rig.toml")
    measurement = read_measurement(tmp_path / "measurement.csv", rig)
    every = mistakes(rig.model, measurement)
    assert len({mistake.name for mistake in every}) == len(every)
    assert promising(rig.model, measurement, every) == every
    assert not any(
        mistake.kind == "phase_sign_reversed" for mistake in mistakes(rig.model, measurement, ["amplitude_unit"])
    )


@pytest.mark.campaign
def test_a_weight_in_another_direction_is_named_where_misalignment_would_stand_for_it():
    """What the weight does through a crack shows at 1X and 2X, as a force does that turns with the shaft."""
    drawn, mistake = draw_with_mistake(31278)
    assert explain(drawn.model, drawn.measurement, thorough=False).named == (mistake, "crack")


@pytest.mark.campaign
def test_a_weight_that_is_not_there_is_named_beside_a_strong_spring():
    """A vertical rotor whose rig file states a weight: nonlinear forces make up for that without end. Of
    four runs the spring leaves much beside influence coefficients, which is no scatter between runs.
    """
    plan = Plan(
        {"a": [4e-6 + 0j], "b": [30e-6 + 0j], "c": [30e-6 * np.exp(2.1j)], "d": [20e-6 * np.exp(-1.5j)]},
        tuple(float(speed) for speed in np.linspace(800.0, 3000.0, 12) * np.pi / 30.0),
        (1, 2),
        sigma=1e-6,
    )
    rng = np.random.default_rng(0)
    model, measurement = hidden_forces.measured((in_time.duffing(1e12),), plan, rng, (0.0, 0.0))
    heavy = dataclasses.replace(model, rotor=dataclasses.replace(model.rotor, gravity=as_array([0.0, -9.81])))
    only = ("duffing", "rub", "stiffness_error", "foundation", "weight_absent", "weight_direction")
    found = explain(heavy, measurement, only=only, thorough=False, limit=100_000)
    assert (found.verdict, found.named) == ("explained", ("weight_absent", "duffing"))
    assert found.noise == NO_NOISE


def test_a_sag_that_1x_does_not_show_to_first_order_is_no_balance():
    """Measured at 1X only, a motion without the sag that the stated weight makes reads like one in balance: to first
    order a cubic spring has no part of order 0 in order 1.
    """
    plan = Plan(
        {"a": [4e-6 + 0j], "b": [30e-6 + 0j], "c": [30e-6 * np.exp(2.1j)]},
        tuple(float(speed) for speed in np.linspace(800.0, 3000.0, 12) * np.pi / 30.0),
        (1,),
        sigma=1e-6,
    )
    rng = np.random.default_rng(0)
    model, measurement = hidden_forces.measured((in_time.duffing(1e11),), plan, rng, (0.0, 0.0))
    heavy = dataclasses.replace(model, rotor=dataclasses.replace(model.rotor, gravity=as_array([0.0, -9.81])))
    found = explain(heavy, measurement, only=("duffing", "weight_absent"), thorough=False, limit=100_000)
    assert found.named == ("weight_absent", "duffing")
    assert compare(found.model, found.story.measurement).rms == pytest.approx(found.story.last.rms, rel=0.1)


def _beside_an_unknown_unbalance(cubic):
    """A spring [N/m³] and an unbalance that nobody knows: four runs at twelve speeds."""
    known = {"a": 6e-6 + 0j, "b": 30e-6 + 0j, "c": 25e-6 * np.exp(2.1j), "d": 20e-6 * np.exp(-1.5j)}
    hidden = 15e-6 * np.exp(0.7j)
    speeds = tuple(np.linspace(0.5, 1.6, 12) * hidden_forces.MACHINE.frequency)
    plan = Plan({name: [weight + hidden] for name, weight in known.items()}, speeds, (1, 2, 3), sigma=0.5e-6)
    model, measurement = hidden_forces.measured((in_time.duffing(cubic),), plan, np.random.default_rng(3), (0.0, 0.0))
    installed = np.asarray(measurement.conditions.unbalance) - np.array([hidden.real, hidden.imag])
    conditions = dataclasses.replace(measurement.conditions, unbalance=as_array(installed))
    return model, dataclasses.replace(measurement, conditions=conditions)


def test_a_spring_beside_an_unknown_unbalance_is_found_under_the_noise_of_the_table():
    """Neither holds by itself, and of several runs the spring leaves 20 times the noise beside influence
    coefficients.
    """
    model, measurement = _beside_an_unknown_unbalance(1e10)
    only = ("duffing", "clearance", "residual_unbalance", "stiffness_error", "probe_gain", "trial_weight_opposite")
    found = explain(model, measurement, only=only, limit=100_000)
    assert (found.verdict, set(found.effects)) == ("explained", {"duffing", "residual_unbalance"})
    assert found.noise == NO_NOISE


def test_a_weight_that_is_not_there_is_named_beside_a_strong_spring_and_an_unbalance():
    """Neither the spring nor the unbalance holds by itself, whatever weight is stated."""
    model, measurement = _beside_an_unknown_unbalance(2e11)
    heavy = dataclasses.replace(model, rotor=dataclasses.replace(model.rotor, gravity=as_array([0.0, -9.81])))
    only = ("duffing", "residual_unbalance", "foundation", "chain_gain", "weight_absent", "weight_direction")
    found = explain(heavy, measurement, only=only, thorough=False, limit=100_000)
    assert (found.verdict, set(found.named)) == ("explained", {"weight_absent", "duffing", "residual_unbalance"})


def test_three_effects_are_read_from_one_fit_of_all_linear_ones():
    """A probe that shows 6 % too much beside both, the spring strong: no two effects hold. What two leave of it differs
    from run to run, and passed for scatter between runs.
    """
    model, measurement = _beside_an_unknown_unbalance(2e11)
    vectors = measurement.vectors * np.array([1.06, 1.0])[:, None]
    contest = make_contest(model, dataclasses.replace(measurement, vectors=vectors), CATALOG)
    nothing = begin(contest)
    assert nothing.contest.floor != NO_NOISE
    begun = with_set(nothing, 3)
    assert begun.found == {"duffing", "residual_unbalance", "probe_gain"}
    assert (begun.noise, begun.contest.floor) == (NO_NOISE, NO_NOISE)
    assert contest.budget.spent < 100_000


def test_a_set_of_all_that_may_be_missing_is_read_too():
    model, measurement = _beside_an_unknown_unbalance(1e10)
    contest = make_contest(model, measurement, ("duffing", "residual_unbalance"))
    assert with_set(begin(contest), 3).found == {"duffing", "residual_unbalance"}


def test_a_unit_is_named_where_the_noise_is_unknown():
    """Amplitudes in mil beside a turned phase reference. Of three runs not all numbers are independent; counted as if
    they were, every mistake was out of reach of a chain gain of 0.04.
    """
    machine, speeds, run = Machine(), tuple(np.linspace(60.0, 500.0, 60)), np.repeat(np.arange(3), 60)
    weights = {"baseline": [2e-5 + 0j], "a": [6e-5 + 0j], "b": [2e-5 + 4e-5j]}
    plan = Plan(weights, speeds, sigma=1.5e-6)
    z = measure(machine, plan, {"phase_reference_offset": [0.1]}, np.random.default_rng(1)) / 25.4
    unbalance = np.array([[[w.real, w.imag] for w in planes] for planes in weights.values()])[run]
    conditions = Conditions.at(np.tile(speeds, 3), unbalance=unbalance)
    model = Model(Jeffcott(machine.mass, machine.stiffness, machine.ratio), layout=Layout(orders=(1.0,)))
    measurement = Measurement.from_arrays(z, conditions, run=run, runs=tuple(weights))
    found = explain(model, measurement, only=("chain_gain", "phase_reference_offset", "amplitude_unit"), thorough=False)
    assert (found.verdict, found.named) == ("explained", ("amplitude_unit", "phase_reference_offset"))


def test_linear_effects_none_of_which_promises_much_are_read_from_one_fit_of_all():
    """The angles of the weights are reversed: three effects stand for that where nothing but effects is looked for."""
    drawn, _ = draw_with_mistake(31244)
    linear = tuple(name for name, cls in CATALOG.items() if not issubclass(cls, RestoringEffect | SweepEffect))
    contest = make_contest(drawn.model, drawn.measurement, linear)
    level = screen(Change(None, contest), wide_noise(contest.measurement))
    (stated, *_), begun = of_what_fails(as_stated(contest), level, []), begin(contest)
    assert stated.holds
    assert not begun.holds
    found = with_set(begun, 3, {stated.beside: stated.end}).found
    assert found == {"phase_reference_offset", "residual_unbalance", "cross_coupling"}


def test_exchanged_runs_are_nearest_beside_a_foundation():
    """The foundation moves the resonance: from the values of the rig file no fit beside a mistake came near."""
    machine, speeds, run = (
        Machine(ratio=(0.02, 0.02)),
        tuple(np.linspace(125.0, 335.0, 16)),
        np.repeat(np.arange(3), 16),
    )
    own, weights = 12e-6 * np.exp(1.2j), {"base": 0j, "a": 30e-6 + 0j, "b": 30e-6 * np.exp(2.1j)}
    made = {"base": [own], "a": [own + weights["b"]], "b": [own + weights["a"]]}
    support = {"foundation": [3.7e-6, 0.26, -0.9]}
    z = measure(machine, Plan(made, speeds, sigma=0.8e-6), support, np.random.default_rng(5))
    stated = np.array([[[w.real, w.imag]] for w in weights.values()])[run]
    conditions = Conditions.at(np.tile(speeds, 3), unbalance=stated)
    model = Model(Jeffcott(machine.mass, machine.stiffness, machine.ratio), layout=Layout(orders=(1.0,)))
    contest = make_contest(
        model, Measurement.from_arrays(z, conditions, run=run, runs=tuple(weights), sigma=0.8e-6), CATALOG
    )
    changes = [Change.of(contest, one, 0.0) for one in mistakes(contest.space.model, contest.measurement)]
    level = screen(Change(None, contest), wide_noise(contest.measurement))
    _, _, ahead = of_what_fails(as_stated(contest), level, changes)
    assert ahead[0].holds
    assert ahead[0].change.mistake.name == "runs_exchanged.a.b"


@pytest.mark.campaign
@pytest.mark.parametrize("seed", [31238, 31244])
def test_a_mistake_for_which_many_linear_effects_would_stand(seed):
    """Beside what is stated the data take three effects that none of them promises, or more than may be added."""
    drawn, mistake = draw_with_mistake(seed)
    assert {*explain(drawn.model, drawn.measurement).named} == {mistake, *drawn.effects}


@pytest.mark.campaign
def test_a_weight_that_is_not_there_is_named_beside_friction_six_times_its_scale():
    drawn, mistake = draw_with_mistake(31256)
    found = explain(drawn.model, drawn.measurement)
    assert (found.verdict, found.named) == ("explained", (mistake, *drawn.effects))


@pytest.mark.campaign
def test_no_mistake_is_named_without_which_the_same_effects_do_as_well():
    """In a single run an unbalance makes up for any angle of its weight."""
    drawn = draw(3067)
    found = explain(drawn.model, drawn.measurement)
    assert found.written.best.mistake is None
    assert found.effects == drawn.effects


@pytest.mark.campaign
def test_exchanged_probes_are_named_where_the_noise_is_unknown():
    """Six runs of ten speeds: the search beside what is stated would take all linearisations, and misses by far."""
    speeds = np.tile(np.linspace(80.0, 320.0, 10), 6)
    run, rng = np.repeat(np.arange(6), 10), np.random.default_rng(0)
    weights = np.array([[0.0, 0.0], [3e-5, 0.0], [2e-5, 3e-5], [-3e-5, 1e-5], [0.0, -3e-5], [1e-5, 1e-5]])[run]
    conditions = Conditions.at(speeds, unbalance=weights[:, None])
    model = Model(Jeffcott(1.0, [56538.0, 45000.0], [0.02, 0.02]))
    z = np.asarray(response(model, conditions))[:, ::-1]
    z = z + 1e-6 * (rng.standard_normal(z.shape) + 1j * rng.standard_normal(z.shape))
    measurement = Measurement.from_arrays(z, conditions, run=run, runs=tuple("abcdef"))
    found = explain(model, measurement, thorough=False)
    assert (found.verdict, found.named) == ("explained", ("probes_exchanged",))


def test_mistakes_are_held_against_one_another_beside_the_force_of_an_answer_that_misses():
    """A weight on the opposite side in one of three runs beside a strong cubic spring, which a rub stands for."""
    drawn, mistake = draw_with_mistake(31450)
    contest = make_contest(drawn.model, drawn.measurement, CATALOG)
    wide, answer = wide_noise(drawn.measurement), frozenset({"rub", "foundation"})
    own = race(contest, wide, [answer], {})[answer]
    every = mistakes(contest.space.model, contest.measurement)
    near = beside_forces_of(own, contest, [Change.of(contest, one, 0.0) for one in every], NO_NOISE)
    assert [one.change.mistake.name for one in near] == [mistake]
    assert near[0].beside == {"rub"}


@pytest.mark.parametrize("name", ["duffing", "clearance", "rub", "quadratic_damping", "coulomb_friction", "crack"])
def test_a_force_does_the_same_where_the_table_says_another_amplitude(name):
    """25.4 times the motion, 25.4 times the force: so an answer begins beside amplitudes in mil."""
    drawn, _ = draw_with_mistake(31450)
    contest = make_contest(drawn.model, drawn.measurement, CATALOG)
    (mil,) = (one for one in mistakes(contest.space.model, contest.measurement) if one.name == "amplitude_unit.mil")
    there = Change.of(contest, mil, 0.0).contest
    none = race(contest, NO_NOISE, [frozenset()], {})[frozenset()]
    point = np.where(contest.only_of([name]), 0.5, 0.0)
    own = Contender(frozenset({name}), (none.best._replace(point=point),), 0.0, NO_NOISE)
    larger = largest_displacement(there.space.model, there.measurement) / largest_displacement(
        contest.space.model, contest.measurement
    )
    assert abs(np.log(larger)) == pytest.approx(np.log(25.4))

    def force(of: Contest, contender: Contender, size: float) -> np.ndarray:
        (effect,) = (e for e in of.space.model_at(contender.best.point).effects if e.name == name)
        q = as_array(size * np.array([9e-4, 3e-4]))
        return np.asarray(effect.force(Instant(of.space.model.rotor, as_array(200.0), as_array(0.4), q, 200.0 * q, q)))

    first = force(contest, own, 1.0)
    assert np.linalg.norm(first) > 0.0
    np.testing.assert_allclose(force(there, as_large_as_read(own, contest, there), larger), larger * first, rtol=1e-3)


@pytest.mark.campaign
def test_a_weight_that_is_not_there_is_named_where_a_foundation_would_stand_for_its_sag(tmp_path):
    rig_file, table = write_case(draw_detailed(3174), tmp_path)
    rig = read_rig(rig_file)
    assert "weight_absent" in explain(rig.model, read_measurement(table, rig)).named


@pytest.mark.campaign
@pytest.mark.parametrize("seed", [31666, 31678])
def test_rms_amplitudes_leave_what_is_constant_as_it_is(seed):
    """With order 0 measured: no factor of the whole table does what they do."""
    drawn, mistake = draw_with_mistake(seed)
    found = explain(drawn.model, drawn.measurement)
    assert (found.verdict, found.named) == ("explained", (mistake, *drawn.effects))


@pytest.mark.campaign
def test_a_weight_that_is_not_there_is_named_where_runout_would_stand_for_its_sag():
    """Beside a stiffness that is far off: fits beside a change of what is stated begin at the answer, too."""
    drawn, mistake = draw_with_mistake(31664)
    found = explain(drawn.model, drawn.measurement)
    assert found.named == (mistake, *drawn.effects)
    assert found.p_value.value > 0.1


@pytest.mark.campaign
@pytest.mark.parametrize("seed", [31058, 31332, 31352, 31356, 31382, 31388, 31460, 31476, 31506, 31636, 31888])
def test_a_mistake_beside_a_force_without_which_nothing_linear_shows_it(seed):
    """Gains far from their scale make up for amplitudes read as half of what they are beside a clearance, or in mil
    beside a cubic spring where the noise is unknown; beside dry friction a phase reference half a turn off and an
    unbalance for two runs exchanged, or either alone for a weight on the opposite side of a single run. Beside a rub or
    a strong cubic spring nothing makes up for a reversed probe, angles in the other sense or a weight on the opposite
    side, and no linear effect tells these apart; amplitudes in mil hold with more effects. Beside a crack
    cross-coupling and an asymmetric shaft stand for a wrong phase sign, and cross-coupling and an unbalance for an
    asymmetric shaft that turns the other way. Beside dry friction a gain of a twenty-fifth stands for a wrong unit and
    a phase reference that is off.
    """
    drawn, mistake = draw_with_mistake(seed)
    found = explain(drawn.model, drawn.measurement)
    assert (found.verdict, found.named) == ("explained", (mistake, *drawn.effects))


@pytest.mark.campaign
def test_a_weight_on_the_opposite_side_of_the_only_run_is_left_open():
    """Beside a rub: an unbalance of the rotor does exactly what the weight does, so that one run cannot tell it."""
    drawn, mistake = draw_with_mistake(31634)
    assert (mistake, drawn.effects) == ("trial_weight_opposite.run0", ("rub", "residual_bow"))
    found = explain(drawn.model, drawn.measurement)
    assert found.verdict == "undecided"
    assert {"residual_bow", "residual_unbalance"} < set(found.named)
    assert ("rub",) in [other.effects for other in found.ties.tied]


def test_all_linear_effects_at_once_hold_where_a_wrong_damping_hides_beside_an_unbalance():
    """One run of a turbocharger, nothing installed: under the noise of the table alone the fit gets lost."""
    rotor, rng, sigma = Jeffcott(0.3, [1.0e7, 9.3e6], [0.06, 0.06]), np.random.default_rng(0), 2e-8
    conditions = Conditions.at_rpm(np.linspace(15e3, 120e3, 30))
    hidden = [effects.ResidualUnbalance(4.1e-7, 2.9e-7), effects.DampingError(0.6, 0.6)]
    z = np.asarray(response(Model(rotor).plus(hidden), conditions))
    z = z + sigma * (rng.standard_normal(z.shape) + 1j * rng.standard_normal(z.shape))
    contest = make_contest(Model(rotor), Measurement.from_arrays(z, conditions, sigma=sigma), CATALOG)
    assert as_stated(contest).holds


@pytest.mark.campaign
def test_a_weight_on_the_opposite_side_beside_a_strong_spring_takes_more_than_the_usual_limit():
    """Nothing by itself shows either: every force by itself is fitted beside every mistake."""
    drawn, mistake = draw_with_mistake(31450)
    found = explain(drawn.model, drawn.measurement, limit=1_100_000)
    assert (found.verdict, found.named) == ("explained", (mistake, *drawn.effects))


def test_values_are_those_of_the_probes_not_of_the_table():
    """Amplitudes that are half of what they should be: runout and the limit of a probe are in metres that it sees."""
    speeds, weights = np.linspace(80.0, 320.0, 16), np.array([0.0, 3e-5, 2e-5 + 3e-5j])
    unbalance = np.repeat(np.stack([weights.real, weights.imag], axis=-1)[:, None], len(speeds), axis=0)
    conditions = Conditions.at(np.tile(speeds, 3), unbalance=unbalance)
    model = Model(Jeffcott(1.0, [56538.0, 51282.0], [0.05, 0.05]))
    read = {"real_m.X.1X": 2e-5, "real_m.Y.1X": 0.0, "imaginary_m.X.1X": 0.0, "imaginary_m.Y.1X": -1e-5}
    true = [effects.Runout([[2e-5], [0.0]], [[0.0], [-1e-5]]), effects.ProbeSaturation(2e3)]
    halved = 0.5 * np.asarray(response(model.plus(true), conditions))
    stated = Measurement.from_arrays(
        halved, conditions, run=np.repeat(np.arange(3), len(speeds)), runs=("none", "a", "b"), sigma=1e-8
    )
    stated = dataclasses.replace(stated, knowledge=dataclasses.replace(stated.knowledge, amplitude="peak-to-peak"))
    (mistake,) = mistakes(model, stated, ["amplitude_halved"])
    fitted = tell(model, stated, [type(effect)() for effect in true], mistake=mistake).fits[-1]
    found = {entry: fitted.estimate("runout", entry).value for entry in read}
    assert found == pytest.approx(read, abs=1e-7)
    assert fitted.estimate("probe_saturation", "inverse_limit_per_m").value == pytest.approx(2e3, rel=1e-3)
