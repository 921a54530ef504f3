"""Drawn cases of the detailed rotor, and the scores of answers to them."""

import csv
import hashlib
import json
import re
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))
from rotorjax import read_measurement, read_rig
from rotorjax.data.declarations import mistakes
from rotorjax.effects import CATALOG
from rotorjax.model.conditions import Layout
from rotorjax.physics.response import response

import scoring
from detailed import hidden as hide
from detailed.case import Readings, draw
from detailed.files import truth, write
from detailed.hidden import DOWN, EFFECTS, Scale
from score_page import write_page

SCALE = Scale(1e-4, 2.0, (8e4, 7e4), 0.02, 190.0, 2e-5, 2e-4, 0.95, (1, 2))
LINEAR, MISTAKEN = 5, 7
"""Seeds of a linear effect and of a mistake."""
LINEAR_VECTOR = -1.5387952409312518e-06 + 4.6269126272588145e-07j
OVERHUNG, BETWEEN = 4903, 4908
"""Seeds of finite-element rotors with a linear effect."""


def row(**changes):
    given = {
        "seed": 1, "kind": "one", "poorer": "none", "noise": 0.01, "cells": 20, "effects": ["duffing"], "outside": None,
        "beyond": None, "detail": {"gyroscopic": 20.0}, "mistake": None, "mistake_improvement": None,
        "improvements": {"duffing": 500.0},
        "values": {"duffing.cubic_n_per_m3": 2.0}, "exact": ["duffing"], "verdict": "explained", "named": ["duffing"],
        "probability": 0.9, "set95": [["duffing"]], "ties": [], "contains": [], "small": [],
        "sizes": [{"name": "duffing.cubic_n_per_m3", "value": 2.2, "half": 0.3, "determined": True}],
    }  # fmt: skip
    return {**given, **changes}


def test_all_effects_of_the_catalogue_are_hidden_with_its_labels(rng):
    layout = Layout(("X", "Y"), ("disk1", "disk2"), (1.0, 2.0))
    # Its integration in time holds every speed; what came later would change what older seeds draw.
    assert {*EFFECTS, "sweep_rate", "speed_dependent_damping", "speed_dependent_cross_coupling"} == set(CATALOG)
    for name in EFFECTS:
        labels = {label for p in CATALOG[name].parameters() for label in p.labels(layout)}
        # How far the damping at the disk turns with the springs of the journals is not drawn: it follows.
        assert set(hide.effect(name, rng, SCALE, DOWN).values) == labels - {"damping_angle_rad"}, name


def test_a_case_is_drawn_alike_twice_at_the_improvement_stated():
    one, again = draw(LINEAR), draw(LINEAR)
    assert np.array_equal(one.vectors, again.vectors)
    assert one.stated.toml() == again.stated.toml()
    assert 10.0 < one.effects[0].improvement < 1.2e4


def test_cases_stay_as_they_were_drawn():
    """Before and since the shafts of finite elements."""
    assert draw(LINEAR).vectors[0, 0, 0] == pytest.approx(LINEAR_VECTOR, rel=1e-6)


@pytest.mark.parametrize(("seed", "overhung"), [(OVERHUNG, True), (BETWEEN, False)])
def test_a_finite_element_rotor_is_drawn(seed, overhung):
    case = draw(seed)
    shaft = case.plant.rotor.shaft
    assert (shaft.position > 1.0) is overhung
    assert 1e-4 < case.stated.tolerance < 0.1
    assert case.detail["gyroscopic"] > 0.0
    assert 0.9 < case.stated.mass / (case.plant.rotor.disk_mass + shaft.mass[2, 2]) < 1.1


@pytest.mark.parametrize("seed", [LINEAR, OVERHUNG, BETWEEN])
def test_files_are_read_as_they_are_meant(tmp_path, seed):
    case = draw(seed)
    write([case], tmp_path / "cases")
    rig = read_rig(tmp_path / "cases" / f"{seed:06d}.toml")
    measurement = read_measurement(tmp_path / "cases" / f"{seed:06d}.csv", rig)
    assert np.allclose(measurement.vectors, case.vectors, rtol=1e-5, atol=1e-12)
    assert measurement.knowledge.tolerance == pytest.approx(case.stated.tolerance, rel=1e-3)
    plain = np.asarray(response(rig.model.with_orders(measurement.orders), measurement.conditions))
    assert np.allclose(plain, case.stated.predicted(case.plan), rtol=1e-5, atol=1e-12)
    told = json.loads((tmp_path / "cases-answers.jsonl").read_text())
    assert told == json.loads(json.dumps(truth(case)))


def test_frozen_cases_are_those_of_the_page(tmp_path):
    root = Path(__file__).parents[2]
    stated = dict(
        re.findall(r"(detailed_[\w-]+\.\w+)`\].*`(\w{64})` \|", (root / "docs/benchmark.md").read_text("utf-8"))
    )
    files = sorted((root / "benchmarks" / "cases").iterdir())
    assert stated == {file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in files}
    answers, cases = files
    seeds = [json.loads(line)["seed"] for line in answers.read_text(encoding="utf-8").splitlines()]
    assert seeds == list(range(3020, 3120))
    with zipfile.ZipFile(cases) as kept:
        assert sorted(kept.namelist()) == sorted(
            f"cases/{seed:06d}.{kind}" for seed in seeds for kind in ("csv", "toml")
        )
        kept.extractall(tmp_path)
    rig = read_rig(tmp_path / "cases" / "003119.toml")
    assert len(read_measurement(tmp_path / "cases" / "003119.csv", rig).run) > 5


def test_further_readings_are_of_the_same_rotor(tmp_path, rng):
    """At a speed that was read before they are the same vectors but for noise."""
    case = draw(LINEAR)
    again = Readings(case.plan.runs[-1], case.plan.speeds[-2:])
    grown = case.with_readings(again, rng)
    gap = grown.vectors[-2:] - case.vectors[-2:]
    assert np.max(np.abs(gap)) < 8.0 * case.sigma
    assert np.min(np.abs(gap[..., case.plan.orders.index(1)])) > 0.0
    for run, weight in (("bare", 0.0), ("trial", 2e-5)):
        another = case.with_readings(Readings(run, np.array([case.plan.speeds[0]]), weight=weight), rng)
        write([another], tmp_path / "cases")
        measurement = read_measurement(tmp_path / "cases/000005.csv", read_rig(tmp_path / "cases/000005.toml"))
        assert measurement.runs[-1] == run
        assert np.allclose(np.asarray(measurement.conditions.unbalance)[-1], [[weight, 0.0]], rtol=1e-6, atol=1e-15)


def test_a_mistake_is_one_that_the_answers_know(tmp_path):
    case = draw(MISTAKEN)
    write([case], tmp_path / "cases")
    rig = read_rig(tmp_path / "cases" / f"{MISTAKEN:06d}.toml")
    measurement = read_measurement(tmp_path / "cases" / f"{MISTAKEN:06d}.csv", rig)
    found = {mistake.name: mistake for mistake in mistakes(rig.model, measurement)}
    model, right = found[case.mistake].put_right(rig.model, measurement)
    plain = np.asarray(response(model.with_orders(right.orders), right.conditions))
    assert np.sqrt(np.mean(np.abs(plain - right.vectors) ** 2)) < 2.0 * np.max(right.sigma)


@pytest.mark.parametrize(
    ("changes", "verdict"),
    [
        ({}, "right"),
        ({"verdict": "undecided"}, "right, undecided"),
        ({"named": ["rub"]}, "WRONG"),
        ({"named": ["rub"], "verdict": "undecided"}, "left open"),
        ({"named": ["rub"], "verdict": "undecided", "ties": [["duffing"]]}, "among what ties"),
        ({"named": [], "verdict": "nothing missing"}, "WRONG"),
        ({"named": [], "verdict": "nothing missing", "small": ["duffing"]}, "right"),
        ({"named": [], "verdict": "nothing missing", "small": ["rub"]}, "small by another name"),
        ({"named": [], "verdict": "nothing missing", "small": ["rub"], "small_ties": [[["rub"], ["duffing"]]]},
         "among what ties"),
        ({"named": [], "verdict": "nothing missing", "small": ["gyroscopic"]}, "WRONG"),
        ({"named": [], "verdict": "nothing missing", "small": ["gyroscopic"],
          "small_ties": [[["gyroscopic"], ["duffing"]]]}, "among what ties"),
        ({"named": [], "verdict": "nothing missing", "improvements": {"duffing": 20.0}}, "right"),
        ({"named": ["rub"], "contains": [["duffing"]]}, "in other words"),
        ({"named": ["rub"], "small": ["gyroscopic"], "contains": [["duffing"]]}, "in other words"),
        ({"named": ["duffing", "rub"]}, "WRONG"),
        ({"named": ["duffing", "gyroscopic"]}, "right"),
        ({"named": ["duffing", "gyroscopic"], "detail": {"gyroscopic": 2.0}}, "WRONG"),
        ({"effects": [], "improvements": {"slider": 99.0}, "outside": "slider", "beyond": 50.0}, "WRONG"),
        ({"effects": [], "improvements": {"slider": 99.0}, "outside": "slider", "beyond": 5.0},
         "by a relative that does the same"),
        ({"effects": [], "improvements": {"slider": 99.0}, "outside": "slider", "beyond": 50.0,
          "verdict": "unexplained"},
         "not called explained"),
        ({"effects": [], "improvements": {"slider": 99.0}, "outside": "slider", "beyond": 50.0, "left_by_answer": 5.0},
         "by a relative that does the same"),
    ],
)  # fmt: skip
def test_what_an_answer_is_called(changes, verdict):
    assert scoring.judged(row(**changes)) == verdict


def test_rates_and_intervals():
    rows = [row(seed=k) for k in range(9)] + [row(seed=9, named=["rub"])]
    found = {r.name: r for r in scoring.rates(rows)}
    right = found["1 % noise, standard plan: right"]
    assert (right.count, right.total) == (9, 10)
    assert right.interval() == pytest.approx((0.55498, 0.99747), abs=1e-5)
    assert found["all: confident and wrong"].count == 1
    assert found["intervals of 90 %: hold the true value"].share == 1.0
    assert found["nothing hidden: explained by what is not there"].share is None
    found = scoring.calibration(rows)
    assert (found.error, found.brier) == pytest.approx((0.0, 0.09))


def test_the_oracle_has_the_truth_where_it_is_more_probable_or_ties():
    wrong = {"named": ["rub"], "verdict": "undecided"}
    rows = [row(seed=0, lead_of_truth=None), row(seed=1, lead_of_truth=2.0, **wrong)]
    rows += [row(seed=2, lead_of_truth=-2.0, **wrong), row(seed=3, lead_of_truth=-9.0, **wrong)]
    right, tied, *_ = scoring.rates(rows)
    assert (right.count, right.oracle, tied.oracle) == (1, 2, 3)
    assert [r["seed"] for r in scoring.search_missed(rows)] == [1]
    assert all(r.oracle is None for r in scoring.rates([row()]))


def test_what_the_others_fitted_anew_replace_need_not_be_named():
    two = {"effects": ["duffing", "rub"], "improvements": {"duffing": 200.0, "rub": 90.0}, "named": ["duffing"]}
    less, more = row(**two, brings={"duffing": 150.0, "rub": 8.0}), row(**two, brings={"rub": 40.0})
    assert [scoring.judged(scoring.with_others_fitted(r)) for r in (less, more)] == ["right", "WRONG"]
    found = {r.name: r for r in scoring.rates([less, more])}
    assert found["all: confident and wrong"].count == 2
    assert found["the same, what counts as seen with all others fitted anew"].count == 1
    beside = found["the same, each seen with the other fitted anew"]
    assert (beside.count, beside.total) == (0, 1)


def test_readings_settle_a_tie_if_one_explanation_is_left():
    both = {"named": ["rub"], "ties": [["duffing"]]}
    readings = {"separates": [["rub"], ["duffing"]], "proposed": {"named": ["duffing"], "ties": []}, "random": both}
    found = {r.name: r for r in scoring.rates([row(**both, verdict="undecided", further_readings=readings), row()])}
    proposed = found["readings proposed: settle what they separate"]
    assert (proposed.count, proposed.total) == (1, 1)
    assert found["readings proposed: the answer or what ties holds the truth"].count == 1


def test_the_calibration_error_that_chance_makes():
    """Of right probabilities: that of a share of n draws, |share - p| in the mean, for each bin."""
    n = 400
    assert scoring.by_chance([0.55] * n) == pytest.approx(np.sqrt(2 / np.pi * 0.55 * 0.45 / n), rel=0.05)
    assert scoring.by_chance([1.0, 0.0]) == 0.0


@pytest.mark.parametrize(
    ("sets", "holds"),
    [([["rub"], ["duffing"]], 1), ([["duffing", "gyroscopic"]], 1), ([["duffing", "rub"]], 0), ([[], ["rub"]], 0)],
)
def test_a_set_holds_the_truth_whatever_is_too_small_to_matter(sets, holds):
    rows = [row(named=[], small=["rub"], verdict="nothing missing", set95=sets)]
    found = {r.name: r for r in scoring.rates(rows)}
    assert found["set of 95 %: holds the truth"].count == holds


def test_answers_of_another_tool(tmp_path):
    cases = [row(seed=k) for k in range(3)]
    path, true = tmp_path / "answers.csv", tmp_path / "truth.jsonl"
    true.write_text("\n".join(json.dumps(case) for case in cases), encoding="utf-8")
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["seed", "verdict", "effects", "probability", "ties"])
        writer.writerow([0, "explained", "duffing", 0.8, ""])
        writer.writerow([1, "undecided", "rub", "", "duffing; clearance + crack"])
        writer.writerow([2, "nothing missing", "nothing", 0.5, ""])
    rows = scoring.read_answers(path, true)
    assert [scoring.judged(r) for r in rows] == ["right", "among what ties", "WRONG"]
    assert write_page(rows, tmp_path, {}).startswith("|")
    assert (tmp_path / "README.md").read_text(encoding="utf-8").count("WRONG") == 1
    path.write_text("seed,verdict,effects,probability\n0,explained,duffing,0.8\n", encoding="utf-8")
    with pytest.raises(ValueError, match="no answer for seed 1"):
        scoring.read_answers(path, true)
