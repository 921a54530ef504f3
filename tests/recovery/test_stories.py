"""The three stories of the main job, number by number."""

import re
import tomllib
from importlib.resources import as_file, files
from pathlib import Path

import numpy as np
import pytest

from rotorjax import Conditions, Jeffcott, Measurement, Model, effects, explain, read_measurement, read_rig, response
from rotorjax.data.rig import Rig
from rotorjax.reporting.explanation import explanation_page, explanation_text, notes, sentence, ties_table
from rotorjax.reporting.explanation_json import explanation_json

import make_hidden
from helpers import with_campaign

TRUTH = tomllib.loads((Path(__file__).parents[2] / "experiments" / "hidden_truth.toml").read_text(encoding="utf-8"))

SLOW = ("case_3", "case_5")


def told(*parts: str, rig_name: str = "rig.toml", **options) -> tuple[Rig, object]:
    with as_file(files("rotorjax") / "data") as data:
        rig = read_rig(data.joinpath(*parts, rig_name))
        return rig, explain(rig.model, read_measurement(data.joinpath(*parts, "measurement.csv"), rig), **options)


@pytest.fixture(scope="module")
def rk4():
    return told("rk4")[1]


def test_real_measurements(rk4):
    """Residual bow, tied with unbalance; the reference offset; tenfold on data held out; the rest is scatter between
    mountings.
    """
    assert rk4.effects == ("residual_bow", "phase_reference_offset")
    group = next(g for g in rk4.ties.groups() if g[0] == ["residual_bow"])
    assert ["residual_unbalance"] in group
    before, after = rk4.story.declared.rms, rk4.story.fits[-1].held_out_rms
    assert before * 1e6 == pytest.approx(17.0, abs=0.1)
    assert after * 1e6 == pytest.approx(0.98, abs=0.06)
    assert before / after > 10.0
    offset = rk4.story.fits[-1].estimate("phase_reference_offset", "angle_rad")
    assert np.degrees(offset.value) == pytest.approx(78.0, abs=5.0)
    assert rk4.verdict == "unexplained"


def test_ties_tell_whether_they_predict_the_same(rk4):
    """An unbalance and a bow move the RK4 vectors alike; what ties with other predictions is named
    with its distance.
    """
    apart = {tuple(t["effects"]): t["standardised_difference"] for t in explanation_json(rk4)["tied_predictions"]}
    assert set(apart) == {other.effects for other in rk4.ties.tied}
    assert all(value >= 0.0 for value in apart.values())
    other = next(other for other in rk4.ties.tied if other.effects == ("residual_unbalance",))
    shown, own = other.contender.best.local.error, rk4.ties.winner.best.local.error
    assert apart["residual_unbalance",] == pytest.approx(np.sqrt(np.mean((shown - own) ** 2)), rel=0.1)


def test_of_many_ties_the_sentence_names_one_and_a_table_lists_all():
    """At six neighbouring speeds of one run most excitations, and a gain, turn with the shaft alike."""
    speeds = np.linspace(2800.0, 3000.0, 6) * np.pi / 30.0
    conditions = Conditions(speeds, np.tile([[[30e-6, 0.0]]], (6, 1, 1)), np.zeros((6, 2)))
    model = Model(Jeffcott(0.98, [140104.0, 137098.0], [0.011, 0.0138]))
    z, rng = np.asarray(response(model + effects.ResidualUnbalance(4e-6, 5e-6), conditions)), np.random.default_rng(0)
    z = z + 1e-6 * (rng.standard_normal(z.shape) + 1j * rng.standard_normal(z.shape))
    measurement = Measurement.from_arrays(z, conditions, run=np.zeros(6, int), runs=("baseline",), sigma=1e-6)
    only = ("residual_unbalance", "residual_bow", "thermal_bow", "chain_gain", "misalignment")
    found = explain(model, measurement, only=only, thorough=False)
    groups = [names for names in found.ties.groups() if len(names) > 3]
    assert groups
    for names in groups:
        assert f"or from {len(names) - 2} other sets listed below" in sentence(found)
    assert len(ties_table(found).rows) == len(found.ties.tied)
    assert ties_table(found).text() in explanation_text(found)


def test_scatter_between_mountings_is_quantified(rk4):
    scatter = explanation_json(rk4)["run_scatter"]
    assert scatter["unbalance_g_mm"] == pytest.approx(1.4, abs=0.3)
    assert any("Scatter between runs" in line for line in notes(rk4))


@pytest.mark.parametrize("case", with_campaign(TRUTH, lambda case: case in SLOW))
def test_hidden_effects(case):
    _, found = told("hidden", case)
    assert set(found.effects) | {s.effect for s in found.detected_but_small} == set(TRUTH[case])
    # Nothing is hidden in the fourth, but by chance its noise looks like internal damping: of 3.5 standard errors.
    assert found.verdict == ("explained" if TRUTH[case] else "undecided")
    assert TRUTH[case] or [r.effect for r in found.more] == ["internal_damping"]
    assert found.story.last.rms * 1e6 == pytest.approx(found.story.noise_um(), rel=0.3)
    labels = [e.entry for e in found.story.fits[-1].estimates]
    for name, true in TRUTH[case].items():
        estimates = [found.story.fits[-1].estimate(name, entry.label) for entry in labels if entry.effect == name]
        for estimate, value in zip(estimates, true, strict=True):
            assert abs(estimate.value - value) < 4.5 * estimate.standard_error, estimate.entry.key
    where = [table.title for table in explanation_page(found, title="", pictures=[]).where]
    assert any("with what was added" in title for title in where) == bool(TRUTH[case])


@pytest.mark.campaign
def test_the_paper_with_sensor_noise_alone():
    """Bow or gain and phase leave some 120 µm of 750: unexplained, and what would decide."""
    _, found = told("paper")
    assert found.verdict == "unexplained"
    assert found.effects == ("residual_bow",)
    assert ["chain_gain"] in found.ties.groups()[0]
    assert found.story.declared.rms / found.contest.measurement.rms == pytest.approx(0.34, abs=0.02)
    left = np.abs(found.story.last.residual[..., 0])
    speed = found.contest.measurement.speed_rpm
    assert 80e-6 < np.sqrt(np.mean(left[speed > 2000] ** 2)) < 160e-6
    assert found.next_measurement.run == "a run with nothing installed"


def test_the_paper_with_scatter_allowed():
    _, found = told("paper", rig_name="rig_scatter.toml")
    assert found.verdict == "undecided"
    assert found.ties.groups() == [[["residual_bow"], ["chain_gain"], ["phase_reference_offset"]]]
    assert found.next_measurement.standardised_difference > 3.0
    why = next(line for line in notes(found) if "same installed bow" in line)
    assert "the unbalance is not determined" in why
    ratios = list(found.bow_over_unbalance().values())
    # Errata, item 6: 190 and 70 times for 6 g mm; the median over cases of 6 and of 12 g mm is somewhat less.
    assert 90.0 < ratios[0] < 190.0
    assert 30.0 < ratios[1] < 75.0
    assert "cannot tell residual bow from chain gain" in sentence(found)


def rounded(text: str) -> str:
    """Without the last digits of numbers, which differ from one processor to another."""
    return re.sub(r"\d+\.\d{12,}", lambda number: f"{float(number[0]):.12g}", text)


def test_the_hidden_cases_are_those_that_were_drawn(tmp_path, monkeypatch):
    """Drawn anew by seed and integrated anew, the tables and the truth are the ones that are shipped."""
    monkeypatch.setattr("sys.argv", ["make_hidden", str(tmp_path), str(tmp_path / "truth.toml")])
    make_hidden.main()
    assert tomllib.loads((tmp_path / "truth.toml").read_text(encoding="utf-8")) == TRUTH
    with as_file(files("rotorjax") / "data" / "hidden") as shipped:
        for case in TRUTH:
            drawn, kept = ((folder / case / "rig.toml").read_text() for folder in (tmp_path, shipped))
            assert rounded(drawn) == rounded(kept)
            columns = [
                np.genfromtxt(folder / case / "measurement.csv", delimiter=",", skip_header=1, usecols=(1, 4, 5))
                for folder in (tmp_path, shipped)
            ]
            np.testing.assert_allclose(*columns, rtol=1e-5, atol=1e-3)
