"""What is missing is found: each effect on the plan that its page calls sufficient, nothing where nothing is, verdicts
on hopeless data.
"""

import dataclasses
import json
import sys

import numpy as np
import pytest

from rotorjax import (
    Conditions,
    Explanation,
    Jeffcott,
    Knowledge,
    Layout,
    Measurement,
    Model,
    Probes,
    effects,
    explain,
    response,
)
from rotorjax.data.knowledge import Uncertain
from rotorjax.discovery import bootstrap
from rotorjax.discovery.held_out import HeldOut
from rotorjax.discovery.next_measurement import next_measurement
from rotorjax.discovery.race import contender_of
from rotorjax.discovery.ranking import SHOWS
from rotorjax.effects import CATALOG
from rotorjax.inference import force_kernels, linear_kernels
from rotorjax.model.contract import RestoringEffect, WaveformEffect
from rotorjax.reporting.comparison import step_labels
from rotorjax.reporting.explanation import explanation_text, notes, sentence
from rotorjax.reporting.explanation_json import explanation_json

import drawn_effects
import hidden
import hidden_forces
from helpers import with_campaign
from poor_data import cut


def names_open(found: Explanation) -> set[str]:
    """What the answer names, ties included."""
    return {*found.effects, *(name for group in found.ties.groups() for names in group for name in names)}


TIMED = {name for name, cls in CATALOG.items() if issubclass(cls, RestoringEffect | WaveformEffect)}
SHARE = {"clearance": 0.5, "rub": 0.3}
"""Of the prior scale: more contact leaves no steady motion on these plans, or one whose corners 64 instants per turn
resolve to a micrometre only.
"""


ONE_OF_EACH_FAMILY = {"thermal_bow", "cross_coupling", "rub", "time_delay"}


@pytest.mark.parametrize(
    "name",
    # The rate of a run-up is in test_run_ups.py.
    with_campaign((name for name in CATALOG if name != "sweep_rate"), lambda name: name not in ONE_OF_EACH_FAMILY),
)
def test_every_effect_is_found_on_its_sufficient_plan(name):
    source = hidden_forces if name in TIMED else hidden
    model, measurement, _ = source.sufficient(CATALOG[name], seed=7, factor=SHARE.get(name, 1.0))
    found = explain(model, measurement, thorough=False)
    assert name in names_open(found)
    assert len(found.effects) == 1
    assert found.verdict in ("explained", "undecided")
    last = found.story.fits[-1]
    assert last.converged
    assert last.reduced_chi2 == pytest.approx(1.0, abs=0.7)


def test_as_many_values_as_numbers_may_hold_within_the_noise():
    """Bow and unbalance at two speeds of one probe, with a trial weight: with what is uncertain as many values as
    numbers were read. What is left is a third of the noise.
    """
    probes = Probes(np.zeros(1), np.ones(1), np.zeros(1))
    model = Model(Jeffcott(1.0, [55199.6, 50953.5], 0.02), probes, layout=Layout(("X",), orders=(1.0,)))
    uncertain = [
        Uncertain(effect, f"{label}_{axis}", deviation, True, f"{label}.{axis}")
        for effect, label, deviation in (("stiffness_error", "error", 0.02), ("damping_error", "log_ratio", 0.3))
        for axis in "xy"
    ]
    z = 1e-6 * np.array([27.877, 60.639, 51.915, 130.17]) * np.exp(1j * np.radians([74.6, 53.6, 78.1, 69.3]))
    weights = np.array([0.0, 0.0, 30e-6, 30e-6])[:, None, None] * np.array([0.0, 1.0])
    conditions = Conditions.at_rpm(np.array([1500.0, 1900.0, 1500.0, 1900.0]), unbalance=weights)
    runs = {"run": np.array([0, 0, 1, 1]), "runs": ("base", "trial"), "probes": ("X",), "sigma": 1.09e-6}
    measurement = Measurement.from_arrays(z[:, None, None], conditions, **runs, knowledge=Knowledge(tuple(uncertain)))
    found = explain(model, measurement, only=["residual_bow", "residual_unbalance", "misalignment"], thorough=False)
    assert found.verdict == "undecided"
    assert found.effects in (("misalignment", "residual_unbalance"), ("residual_bow", "residual_unbalance"))


@pytest.mark.campaign
def test_friction_of_ten_prior_scales_is_found():
    """Near the measured motion none was found, and what was laid along it left 22 times the noise."""
    model, measurement, (true,) = hidden_forces.sufficient(effects.CoulombFriction, seed=8, factor=10.0)
    found = explain(model, measurement, thorough=False)
    assert (found.verdict, found.effects) == ("explained", ("coulomb_friction",))
    assert found.story.fits[-1].estimate("coulomb_friction", "force_n").value == pytest.approx(true, rel=0.02)


def test_values_come_back():
    model, measurement, (true,) = hidden.sufficient(effects.CrossCoupling, seed=3)
    found = explain(model, measurement)
    estimate = found.story.fits[-1].estimate("cross_coupling", "cross_stiffness_n_per_m")
    assert abs(estimate.value - true) < 4.0 * estimate.standard_error
    assert found.verdict == "explained"
    assert found.p_value.value > 0.01
    held = found.story.fits[-1].held_out_rms
    assert held == pytest.approx(np.sqrt(2) * 0.3e-6, rel=0.4)
    assert found.story.views[0].rms / held > 10.0
    assert repr(found).startswith("Explanation(explained: cross_coupling; Story(as declared: ")
    assert all(
        len(repr(part)) < 200 for part in (found, found.story, found.story.last, found.story.fits[-1], measurement)
    )


def accused(seeds: range) -> int:
    """Measurements without any effect that get one."""
    count = 0
    for seed in seeds:
        model, measurement, _ = hidden.sufficient(effects.MassError, seed=seed, hidden=False)
        count += bool(explain(model, measurement, thorough=False).effects)
    return count


def test_healthy_rotors_get_no_effect():
    """8 measurements without any effect."""
    assert accused(range(8)) == 0


def test_what_the_data_do_not_show_has_no_probability_of_its_own():
    """A stop that the rotor does not reach is as probable as none at all; all others fit better than that."""
    model, measurement, _ = hidden.sufficient(effects.MassError, seed=0, hidden=False)
    found = explain(model, measurement, only=["clearance", "mass_error", "probe_gain"], thorough=False)
    last = found.rankings[-1]
    none = next(r for r in last if r.effect == "none")
    assert "clearance" not in {r.effect for r in last}
    assert all(r.contender.best.cost <= none.contender.best.cost - SHOWS for r in last if r is not none)
    assert none.probability > 0.9


@pytest.mark.campaign
def test_a_hundred_healthy_rotors():
    """100 measurements without any effect: at most two get one."""
    assert accused(range(100)) <= 2


@pytest.mark.campaign
def test_two_effects_at_once():
    model, measurement, (delay,) = hidden.sufficient(effects.TimeDelay, seed=5, factor=0.5)
    plan = dataclasses.replace(_plan_of(measurement), speeds=tuple(np.unique(np.asarray(measurement.conditions.speed))))
    z = hidden.measure(hidden.Machine(), plan, {"time_delay": [delay], "gyroscopic": [0.03]}, np.random.default_rng(5))
    found = explain(model, dataclasses.replace(measurement, vectors=z), thorough=False)
    assert set(found.effects) == {"time_delay", "gyroscopic"}
    assert found.verdict == "explained"


def _plan_of(measurement) -> hidden.Plan:
    first = [int(np.argmax(measurement.run == k)) for k in range(len(measurement.runs))]
    weights = {
        run: [complex(*pair) for pair in np.asarray(measurement.conditions.unbalance)[k]]
        for run, k in zip(measurement.runs, first, strict=True)
    }
    return hidden.Plan(weights, ())


def test_what_does_not_hold_on_data_held_out_is_undecided(monkeypatch):
    model, measurement, _ = hidden.sufficient(effects.CrossCoupling, seed=1)
    monkeypatch.setattr(
        sys.modules["rotorjax.discovery.explain"],
        "held_out",
        lambda contest, selection, ties: HeldOut((1e-6, 1.01e-6), ""),
    )
    found = explain(model, measurement)
    assert found.effects == ("cross_coupling",)
    assert not found.confirmed
    assert found.verdict == "undecided"
    assert sentence(found).startswith("Undecided: cross-coupled stiffness, but ")
    assert "the error does not fall on readings left out of the fit." in sentence(found)


def test_draws_that_cannot_be_fitted_say_nothing_for_the_noise(monkeypatch):
    """Friction that is many prior scales large: descents on drawn data found no motion, and the p-value was one at 800
    times the noise.
    """
    model, measurement, _ = hidden.sufficient(effects.CrossCoupling, seed=1)
    whole = bootstrap.descend

    def failing(*arguments, shift, **others):
        ends = whole(*arguments, shift=shift, **others)
        return [end._replace(cost=np.inf) if np.any(drawn) else end for end, drawn in zip(ends, shift, strict=True)]

    monkeypatch.setattr(bootstrap, "descend", failing)
    monkeypatch.setattr(sys.modules["rotorjax.discovery.explain"], "name_force", lambda *_: None)
    found = explain(model, measurement, only=["damping_error"])
    assert found.verdict == "unexplained"
    assert "is more than the noise (p <= 0.0" in sentence(found)


def test_verdict_and_table_are_of_one_fit(monkeypatch):
    """A fit again that ends in a worse optimum, as among several steady motions, does not replace the better one, of
    which the p-value is.
    """
    module = sys.modules["rotorjax.discovery.polished"]
    model, measurement, _ = hidden.sufficient(effects.CrossCoupling, seed=1)
    seen = {}

    def losing(contest, noise, hypotheses, known, *others):
        seen.update({end.point.tobytes(): end for contender in known.values() for end in contender.ends})
        return {effects: contender_of(contest, effects, [known[frozenset()].best], noise) for effects in hypotheses}

    def staying(space, data, starts, *others, **settings):
        return [seen[start.point.tobytes()] for start in starts]

    monkeypatch.setattr(module, "race", losing)
    monkeypatch.setattr(module, "descend", staying)
    kept = explain(model, measurement, only=["cross_coupling"])
    assert kept.verdict == "explained"
    assert kept.story.last.rms < 0.1 * kept.story.declared.rms


def test_measurements_of_any_size_compile_once(monkeypatch):
    """Another file with fewer runs, another rig, other names of runs and probes: the same compiled programs."""
    model, measurement, _ = hidden.sufficient(effects.MassError, seed=1)
    explain(model, measurement, thorough=False)
    traced = []
    for module, name in ((linear_kernels, "linear_vectors"), (force_kernels, "force_slopes")):
        whole = getattr(module, name)
        monkeypatch.setattr(module, name, lambda *arguments, whole=whole: traced.append(1) or whole(*arguments))
    other, second, _ = hidden.sufficient(
        effects.MassError, seed=2, machine=hidden.Machine(2.0, (2e5, 1.9e5), (0.02, 0.04))
    )
    renamed = dataclasses.replace(other, layout=other.layout._replace(probes=("left", "right")))
    fewer = dataclasses.replace(cut(second, [0, 1, 2, 4, 5]), probes=("left", "right"))
    explain(renamed, fewer, thorough=False)
    assert not traced


POOR = {
    "one run": lambda m: cut(m, [0, 1, 2, 3]),
    "one speed": lambda m: cut(m, [1, 5]),
    "one reading": lambda m: cut(m, [1]),
    "one probe": lambda m: cut(m, list(range(8)), probe=1),
    "three cells": lambda m: cut(m, [0, 1, 2], probe=1),
    "no sigma": lambda m: dataclasses.replace(m, sigma=None, noise="unknown"),
    "no sigma, one reading": lambda m: dataclasses.replace(cut(m, [1]), sigma=None, noise="unknown"),
    "sigma too small": lambda m: dataclasses.replace(m, sigma=m.sigma / 1000.0),
    "sigma too large": lambda m: dataclasses.replace(m, sigma=m.sigma * 1000.0),
    "all zero": lambda m: dataclasses.replace(m, vectors=np.zeros_like(m.vectors)),
    "noise alone": lambda m: dataclasses.replace(m, vectors=_noise(m)),
}


def _noise(m):
    rng = np.random.default_rng(8)
    return m.sigma * (rng.standard_normal(m.vectors.shape) + 1j * rng.standard_normal(m.vectors.shape))


@pytest.mark.parametrize("name", with_campaign(POOR, lambda name: name == "sigma too small"))
def test_poor_data_get_a_verdict_with_its_reason(name):
    model, measurement, _ = hidden.sufficient(effects.CrossCoupling, seed=1)
    found = explain(model, POOR[name](measurement))
    told = json.loads(json.dumps(explanation_json(found), allow_nan=False))
    assert told["verdict"] == found.verdict
    assert explanation_text(found).count("nan") == 0
    said = sentence(found) + " ".join(told["findings"])
    if name == "sigma too small":
        assert found.verdict == "unexplained"
        assert "sigma_um is too small" in said
    if name == "sigma too large":
        assert found.verdict == "nothing missing"
        assert "sigma_um looks far too large" in said
    if name == "all zero":
        assert (found.verdict, found.effects) == ("unexplained", ())
        assert "every measured vector is zero" in said
    if name == "noise alone":
        assert found.verdict == "undecided"
        assert "friction or a stop that holds the rotor look alike" in said
    if "no sigma" in name:
        assert (told["noise"], told["p_value"]) == ("inferred", None)
    if name in ("one speed", "one reading"):
        assert told["steps"][0]["held_out_rms_um"] is None
        assert told["steps"][0]["held_out_reason"]


def test_no_effect_beyond_those_allowed():
    model, measurement, _ = hidden.sufficient(effects.CrossCoupling, seed=1)
    found = explain(model, measurement, only=("probe_gain", "runout"), thorough=False)
    assert "cross_coupling" not in names_open(found)
    assert found.verdict == "unexplained"
    few = {"only": ("cross_coupling", "probe_gain"), "exclude": ("cross_coupling",)}
    assert "cross_coupling" not in names_open(explain(model, measurement, **few, thorough=False))
    with pytest.raises(ValueError, match="unknown effect 'magic'"):
        explain(model, measurement, only=("magic",))


def many_readings(present: dict[str, list[float]], *, lowest: float = 60.0):
    """A plan of forty speeds per run: a runout of less than the noise of one reading shows in many."""
    model, measurement, _ = hidden.sufficient(effects.Runout, seed=4, factor=0.02)
    plan = dataclasses.replace(_plan_of(measurement), speeds=tuple(np.linspace(lowest, 500.0, 40)), sigma=0.0)
    clean = hidden.measure(hidden.Machine(), plan, present, np.random.default_rng(0))
    noise = 0.01e-6 * np.random.default_rng(0).standard_normal((*clean.shape, 2))
    run = np.repeat(np.arange(len(plan.weights)), len(plan.speeds))
    unbalance = np.array([[[w.real, w.imag] for w in planes] for planes in plan.weights.values()])[run]
    return model, dataclasses.replace(
        measurement, run=run, repeat=("",) * len(run),
        conditions=Conditions.at(np.tile(plan.speeds, len(plan.weights)), unbalance=unbalance),
        vectors=clean + noise[..., 0] + 1j * noise[..., 1], present=np.ones(clean.shape, bool),
        sigma=np.full(clean.shape, 0.01e-6),
    )  # fmt: skip


RUNOUT = [8e-9, -8e-9, 8e-9, 8e-9]


def test_what_is_below_the_noise_is_named_small():
    """It changes the prediction by less than the noise."""
    found = explain(*many_readings({"runout": RUNOUT}), thorough=False)
    assert found.effects == ()
    assert [small.effect for small in found.detected_but_small] == ["runout"]
    assert found.verdict == "nothing missing"
    assert all(fitted.free == () for fitted in found.story.fits)


def test_what_is_below_the_noise_is_fitted_along():
    """Left out, it would bias what was found."""
    data = many_readings({"runout": RUNOUT, "residual_unbalance": [3e-7, -2e-7]})
    found = explain(*data, only=["runout", "residual_unbalance"], thorough=False)
    assert (found.verdict, found.effects, found.story.beside) == ("explained", ("residual_unbalance",), ("runout",))
    last = found.story.fits[-1]
    assert last.reduced_chi2 == pytest.approx(1.0, abs=0.15)
    for estimate, true in zip(last.estimates, [3e-7, -2e-7, *RUNOUT], strict=True):
        assert abs(estimate.value - true) < 4.0 * estimate.standard_error, estimate.entry.key
    assert step_labels(found.story)[-1] == "+ residual_unbalance (with runout)"


def test_two_effects_below_the_noise_that_are_above_it_together_are_not_both_small():
    """Either changes the prediction by eight tenths of the noise, both together by more than all of it."""
    size = 0.8 * 0.01e-6 * np.sqrt(2.0)
    offset = size / many_readings({})[1].rms
    data = many_readings(
        {"runout": [size / np.sqrt(2.0), 0.0, 0.0, size / np.sqrt(2.0)]} | {"phase_reference_offset": [offset]}
    )
    found = explain(*data, only=["runout", "phase_reference_offset"], thorough=False)
    small = [small.effect for small in found.detected_but_small]
    assert sorted([*found.effects, *small]) == ["phase_reference_offset", "runout"]
    assert (found.verdict, len(found.effects)) == ("explained", 1)


@pytest.mark.campaign
def test_what_was_small_beside_less_goes_where_it_is_no_longer_needed():
    """A turned probe stood for part of a delay until that was found; then nothing in its place is an effect either."""
    drawn = drawn_effects.draw(31072)
    reading = [name for name, cls in CATALOG.items() if cls.family == "reading"]
    others = ["speed_error", "foundation", "stiffness_error", "damping_error", "cross_coupling"]
    found = explain(drawn.model, drawn.measurement, only=[*reading, *others], mistakes=False, thorough=False)
    assert set(found.effects) == set(drawn.effects)


def test_what_would_do_as_well_in_the_place_of_something_small_is_named():
    """Over a narrow range of speeds a delay turns phases as an offset of their reference does; that is said, and does
    not make the verdict doubtful.
    """
    data = many_readings({"phase_reference_offset": [8e-5]}, lowest=495.0)
    found = explain(*data, only=["phase_reference_offset", "time_delay", "mass_error"], thorough=False)
    assert (found.verdict, found.effects, found.tied_groups()) == ("nothing missing", (), [])
    (group,) = found.ties.small_groups()
    assert sorted(group) == [["phase_reference_offset"], ["time_delay"]]
    assert explanation_json(found)["small_ties"] == [group]
    assert any(line.startswith("In the place of ") and line.endswith(" would do as well.") for line in notes(found))


def half_order_data(signs: np.ndarray, *, size: float = 30e-6):
    """A runout at 1/2X that a once-per-turn reference shows with any sign."""
    model, measurement, _ = hidden.sufficient(effects.MassError, seed=11, hidden=False)
    orders = (0.5, 1.0)
    rng = np.random.default_rng(2)
    shape = measurement.vectors.shape[:2]
    half = size * np.array([1.0, 0.5 - 0.4j]) + 0.3e-6 * (rng.standard_normal(shape) + 1j * rng.standard_normal(shape))
    vectors = np.concatenate([(signs[:, None] * half)[..., None], measurement.vectors], axis=2)
    present, sigma = np.ones(vectors.shape, bool), np.full(vectors.shape, 0.3e-6)
    return model.with_orders(orders), dataclasses.replace(
        measurement, orders=orders, vectors=vectors, present=present, sigma=sigma
    )


@pytest.mark.campaign
def test_signs_of_half_orders_change_nothing():
    one = explain(*half_order_data(np.ones(8)))
    other = explain(*half_order_data(np.array([1.0, -1.0, 1.0, -1.0, -1.0, 1.0, -1.0, 1.0])))
    assert one.effects == other.effects == ("runout",)
    assert one.p_value == other.p_value
    assert one.verdict == other.verdict == "explained"


@pytest.mark.campaign
def test_half_orders_alone():
    model, measurement = half_order_data(np.ones(8), size=3e-6)
    alone = dataclasses.replace(
        measurement,
        orders=(0.5,),
        vectors=measurement.vectors[..., :1],
        present=measurement.present[..., :1],
        sigma=measurement.sigma[..., :1],
    )
    assert explain(model.with_orders((0.5,)), alone, thorough=False).effects == ("runout",)


@pytest.mark.campaign
def test_parts_that_a_chain_gain_stands_for_are_named_beside_it():
    """A phase reference offset, and probes that read too much by 4.0 and 4.5 %: one complex gain in other words."""
    drawn = drawn_effects.draw(446)
    assert drawn.effects == ("phase_reference_offset", "probe_gain")
    found = explain(drawn.model, drawn.measurement, thorough=False)
    assert (found.verdict, found.effects) == ("undecided", ("chain_gain",))
    assert ("phase_reference_offset", "probe_gain") in [tied.effects for tied in found.ties.tied]


def test_what_fits_as_well_with_more_parameters_ties_or_contains_the_answer():
    """Stiffness 0.40 and 0.44 % off in noise: a speed 0.2 % off does nearly as well with one parameter. Where the usual
    strengths are known to be so much larger, the second one does not pay.
    """
    speeds, run = np.tile(np.linspace(2800.0, 4500.0, 13), 3) * np.pi / 30.0, np.repeat(np.arange(3), 13)
    weights = 30e-6 * np.array([[0.0, 0.0], [1.0, 0.0], [np.cos(2.1), np.sin(2.1)]])
    conditions = Conditions(speeds, weights[run][:, None], np.zeros((39, 2)))
    model = Model(Jeffcott(0.98, [140104.0, 137098.0], [0.011, 0.0138]))
    z = np.asarray(response(model + effects.StiffnessError(0.0040, 0.0044), conditions))
    rng = np.random.default_rng(0)
    z = z + 4e-6 * (rng.standard_normal(z.shape) + 1j * rng.standard_normal(z.shape))
    measurement = Measurement.from_arrays(z, conditions, run=run, runs=("baseline", "a", "b"), sigma=4e-6)
    found = explain(model, measurement, only=("speed_error", "stiffness_error"), thorough=False)
    assert found.effects == ("speed_error",)
    assert [tied.effects for tied in found.ties.tied] == [("stiffness_error",)]
    known = Knowledge(priors={"speed_error": {"error": 0.01}, "stiffness_error": {"error_x": 1.0, "error_y": 1.0}})
    told = dataclasses.replace(measurement, knowledge=known)
    found = explain(model, told, only=("speed_error", "stiffness_error"), thorough=False)
    assert found.effects == ("speed_error",)
    (other,) = found.ties.contains
    assert other.effects == ("stiffness_error",)
    assert other.gap > 3.0
    assert other.contender.best.cost < found.ties.winner.best.cost - 2.0


@pytest.mark.parametrize(
    ("effect", "values"),
    [
        pytest.param("runout", [4e-6, 8e-6, 8e-6, -4e-6], marks=pytest.mark.campaign),
        pytest.param("stiffness_error", [0.03, 0.03], marks=pytest.mark.campaign),
        ("probe_gain", [0.1, 0.0]),
    ],
)
def test_simpler_forms_of_an_effect_do_not_pay_for_all_its_parameters(effect: str, values: list[float]):
    """Well below the resonance, where others with fewer parameters do nearly as well: an eccentric probe track, which
    a bow with an unbalance opposite to it is too; a shaft softer in all directions, which a wrong speed is.
    """
    machine = hidden.Machine()
    speeds, run = tuple(np.linspace(0.4, 0.8, 10) * machine.frequency), np.repeat(np.arange(3), 10)
    weights = {"baseline": [2e-5 + 0j], "a": [6e-5 + 0j], "b": [2e-5 + 4e-5j]}
    plan = hidden.Plan(weights, speeds, orders=(1, 2, 3), sigma=1e-6)
    z = hidden.measure(machine, plan, {effect: values}, np.random.default_rng(1))
    model = Model(Jeffcott(machine.mass, machine.stiffness, machine.ratio), layout=Layout(orders=(1.0, 2.0, 3.0)))
    unbalance = np.array([[[w.real, w.imag] for w in planes] for planes in weights.values()])[run]
    conditions = Conditions.at(np.tile(speeds, 3), unbalance=unbalance)
    measurement = Measurement.from_arrays(
        z, conditions, run=run, runs=tuple(weights), orders=(1.0, 2.0, 3.0), sigma=1e-6
    )
    found = explain(model, measurement, thorough=False)
    assert effect in names_open(found)
    assert found.verdict != "explained" or found.effects == (effect,)


@pytest.mark.parametrize(("springs", "dampers"), [(0.3, 0.3), (0.3, 0.0)])
def test_the_axes_of_stiffness_and_damping_are_told_apart(springs: float, dampers: float):
    """A support turned as a whole is no other than probes, phase reference and angles of all weights turned back."""
    machine = hidden.Machine()
    speeds, run = tuple(np.linspace(0.8, 1.2, 9) * machine.frequency), np.repeat(np.arange(3), 9)
    weights = {"baseline": [2e-5 + 0j], "a": [6e-5 + 0j], "b": [2e-5 + 4e-5j]}
    plan = hidden.Plan(weights, speeds, sigma=1e-6)
    z = hidden.measure(machine, plan, {"stiffness_axes": [springs, dampers]}, np.random.default_rng(1))
    unbalance = np.array([[[w.real, w.imag] for w in planes] for planes in weights.values()])[run]
    conditions = Conditions.at(np.tile(speeds, 3), unbalance=unbalance)
    measurement = Measurement.from_arrays(z, conditions, run=run, runs=tuple(weights), sigma=1e-6)
    found = explain(Model(Jeffcott(machine.mass, machine.stiffness, machine.ratio)), measurement, thorough=False)
    assert (found.verdict, found.effects) == ("explained", ("stiffness_axes",))
    for label, true in (("angle_rad", springs), ("damping_angle_rad", dampers)):
        estimate = found.story.fits[-1].estimate("stiffness_axes", label)
        assert abs(estimate.value - true) < 3.0 * estimate.standard_error


def test_limit_on_the_number_of_effects_is_kept_and_named():
    model, measurement, (delay,) = hidden.sufficient(effects.TimeDelay, seed=5, factor=0.5)
    plan = dataclasses.replace(_plan_of(measurement), speeds=tuple(np.unique(np.asarray(measurement.conditions.speed))))
    z = hidden.measure(hidden.Machine(), plan, {"time_delay": [delay], "gyroscopic": [0.03]}, np.random.default_rng(5))
    only = ("time_delay", "gyroscopic", "phase_reference_offset", "residual_bow")
    for most in (0, 1):
        found = explain(model, dataclasses.replace(measurement, vectors=z), only=only, max_effects=most, thorough=False)
        assert len(found.effects) == most
        assert f"no more than {most} effects were to be added, and" in sentence(found)


@pytest.mark.campaign
def test_a_tie_without_the_first_order():
    """Twice per turn only: resonances are looked for at 1X all the same."""
    model, measurement, _ = hidden.sufficient(effects.Misalignment, seed=2)
    second = dataclasses.replace(
        measurement,
        orders=(2.0,),
        vectors=measurement.vectors[..., 1:],
        present=measurement.present[..., 1:],
        sigma=measurement.sigma[..., 1:],
    )
    found = explain(model.with_orders((2.0,)), second, thorough=False)
    assert "misalignment" in names_open(found)
    other = found.ties.tied or found.ties.contains
    end = other[0].contender.best if other else found.ties.winner.best
    next_measurement(found.contest, found.noise, found.ties.winner.best, end, (("a",), ("b",)))


def test_a_probe_that_was_never_read_is_named_where_it_takes_it_to_tell():
    """Along x alone a thermal bow is an unbalance; with unequal stiffness y tells them apart, at no
    other reading of x.
    """
    model, measurement, _ = hidden.sufficient(effects.ResidualUnbalance, seed=4)
    x_only = dataclasses.replace(measurement, present=measurement.present & np.array([True, False])[:, None])
    assert x_only.probes_read == ("X",)
    found = explain(model, x_only, only=("residual_unbalance", "thermal_bow"), thorough=False)
    assert found.ties.groups() == [[["residual_unbalance"], ["thermal_bow"]]]
    assert found.next_measurement is not None
    assert found.next_measurement.new_probes == ("Y",)
    assert any("with Y, not read so far" in line for line in notes(found))
    assert "X, Y (not read)" in explanation_text(found)
    assert found.story.last.share()["probe"] == {"X": pytest.approx(1.0)}


def test_a_declared_uncertain_value_is_estimated_along_and_leaves_the_race():
    """True mass 10 % off, declared to 2 %, where nothing else may be missing: it moves by some five of its standard
    deviations, a finding.
    """
    model, measurement, _ = hidden.sufficient(effects.MassError, seed=6, factor=2.0)
    knowledge = Knowledge(uncertain=(Uncertain("mass_error", "error", 0.02, True, "mass"),))
    found = explain(
        model, dataclasses.replace(measurement, knowledge=knowledge), only=("runout", "mass_error"), thorough=False
    )
    assert "mass_error" not in {r.effect for r in found.rankings[0]}
    estimate = found.story.fits[-1].estimate("mass_error", "error")
    assert abs(estimate.value) == pytest.approx(0.1, abs=0.005)
    assert estimate.finding
    assert any("mass_error.error, declared uncertain, had to move by" in line for line in notes(found))
    fitted = f"{found.story.last.rms * 1e6:.3g} µm rms remain once the values declared uncertain are adjusted."
    assert fitted in sentence(found)


def test_scatter_between_runs_does_not_hide_an_effect():
    """Eight runs whose weights scatter by 2 g mm: the effect is found, the scatter is quantified, and no effect is made
    of it.
    """
    model, measurement, _ = hidden.sufficient(effects.CrossCoupling, seed=8)
    rng = np.random.default_rng(8)
    declared = [[complex(25e-6 * np.exp(1j * angle))] for angle in rng.uniform(0.0, 6.0, 8)]
    real = {f"run{k}": [w + 2e-6 * complex(*rng.standard_normal(2))] for k, (w,) in enumerate(declared)}
    speeds = tuple(np.unique(np.asarray(measurement.conditions.speed)))
    plan = hidden.Plan(real, speeds)
    for effect, expected in (({"cross_coupling": [900.0]}, ("cross_coupling",)), ({}, ())):
        z = hidden.measure(hidden.Machine(), plan, effect, rng)
        run = np.repeat(np.arange(8), len(speeds))
        unbalance = np.array([[[w.real, w.imag]] for (w,) in declared])[run]
        scattered = dataclasses.replace(
            measurement, runs=tuple(real), run=run, repeat=("",) * len(run),
            conditions=Conditions.at(np.tile(speeds, 8), unbalance=unbalance),
            vectors=z, present=np.ones(z.shape, bool), sigma=np.full(z.shape, plan.sigma),
        )  # fmt: skip
        found = explain(model, scattered)
        assert found.effects == expected
        assert found.verdict == ("explained" if expected else "nothing missing")
        assert found.noise.scatter.unbalance_kg_m == pytest.approx(2e-6, rel=0.4)
