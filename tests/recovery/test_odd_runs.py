"""One run in which something is other than stated: a weight, the phase reference, amplitudes, speeds."""

import numpy as np
import pytest

from rotorjax import Conditions, Jeffcott, Layout, Measurement, Model, effects, explain, response, tell
from rotorjax.data.odd_runs import Value, every_odd_run, odd_runs, settled
from rotorjax.discovery.contest import make_contest
from rotorjax.discovery.fit import AS_STIFFNESS
from rotorjax.discovery.screening import Change
from rotorjax.inference.data import make_data
from rotorjax.inference.linearised import Linearisation, Point
from rotorjax.inference.noise import NO_NOISE, NO_SCATTER
from rotorjax.reporting.explanation import explanation_text

from hidden import Machine, Plan, measure

MACHINE = Machine()
SPEEDS = tuple(MACHINE.frequency * np.linspace(0.55, 1.45, 10))
RESIDUAL = 20e-6 * np.exp(0.9j)
TRIALS = {"baseline": 0j, "trial-a": 60e-6 + 0j, "trial-b": 60e-6 * np.exp(2.1j), "check": 0j}
"""kg m."""
ONLY = ("residual_unbalance", "chain_gain", "phase_reference_offset", "stiffness_error", "residual_bow")
KINDS = (
    "run_unbalance", "run_bow", "run_phase", "run_amplitude", "run_speed", "run_probes_exchanged",
    "trial_weight_absent", "trial_weight_opposite",
)  # fmt: skip


def measured(made, runs=tuple(TRIALS), sigma=0.3e-6, change=None, bows=None):
    """Integrated in time with the unbalance of each run as it was ``made``, and with ``bows`` of each if there are any;
    stated is what `TRIALS` says.
    """
    weights = {run: [made.get(run, TRIALS[run]) + RESIDUAL] for run in runs}
    rng = np.random.default_rng(4)
    plans = [Plan({run: weights[run]}, SPEEDS, bow=bow, sigma=sigma) for run, bow in (bows or {}).items()]
    z = np.concatenate([measure(MACHINE, plan, {}, rng) for plan in plans or [Plan(weights, SPEEDS, sigma=sigma)]])
    run = np.repeat(np.arange(len(runs)), len(SPEEDS))
    z = z if change is None else change(z, run)
    sigma = sigma if change is None else np.abs(change(np.full(z.shape, sigma), run))
    stated = np.array([[[TRIALS[name].real, TRIALS[name].imag]] for name in runs])[run]
    conditions = Conditions.at(np.tile(SPEEDS, len(runs)), unbalance=stated)
    rotor = Jeffcott(MACHINE.mass, MACHINE.stiffness, MACHINE.ratio)
    model = Model(rotor, layout=Layout(orders=(1.0,)))
    return model, Measurement.from_arrays(z, conditions, run=run, runs=runs, sigma=sigma)


def answer(case, only=(*ONLY, *KINDS)):
    return explain(*case, only=only, thorough=False)


def in_run(run, factor):
    def change(z, of):
        return z * np.where(of == run, factor, 1.0)[:, None, None]

    return change


def test_a_weight_left_in_is_said_to_be_that_of_the_other_run():
    model, m = measured({})
    lost = next(one for one in every_odd_run(model, m) if one.name == "run_unbalance.trial-b")
    left, other = (settled(lost, m, {"x": Value(1e-6 * x, 0.3e-6), "y": Value(0.5e-6, 0.3e-6)}) for x in (60.5, 40.0))
    assert "as if the weight of run trial-a had been left in" in left.meaning
    assert "left in" not in other.meaning


def test_a_weight_lost_before_the_last_run_is_named_and_no_scatter():
    found = answer(measured({"check": 25e-6 * np.exp(-2.5j)}))
    assert (found.verdict, found.named) == ("explained", ("run_unbalance.check", "residual_unbalance"))
    assert found.noise.scatter == NO_SCATTER
    assert "an unbalance of 2" in found.mistake.meaning
    assert "g mm at 217°" in found.mistake.meaning
    unbalance = [found.story.fits[-1].estimate("residual_unbalance", f"unbalance_{a}_kg_m").value for a in "xy"]
    np.testing.assert_allclose(unbalance, [RESIDUAL.real, RESIDUAL.imag], atol=0.5e-6)


def test_a_bow_that_drifts_is_scatter_of_three_runs_not_an_effect_of_the_chain():
    runs = ("baseline", "trial-a", "trial-b")
    bows = dict(zip(runs, (4e-6 * np.exp(0.3j), 10e-6 * np.exp(0.8j), 15e-6 * np.exp(1.2j)), strict=True))
    found = answer(measured({}, runs, bows=bows))
    assert (found.verdict, found.named) == ("undecided", ("residual_unbalance",))
    assert found.noise.scatter.unbalance_kg_m == 0.0
    assert 2e-6 < found.noise.scatter.bow_m < 15e-6
    unbalance = [found.story.fits[-1].estimate("residual_unbalance", f"unbalance_{a}_kg_m").value for a in "xy"]
    np.testing.assert_allclose(unbalance, [RESIDUAL.real, RESIDUAL.imag], atol=1e-6)
    assert "Three runs do not tell that from one run that is other than stated." in explanation_text(found)


@pytest.mark.campaign
def test_a_weight_at_another_place_is_named_of_three_runs():
    found = answer(measured({"trial-b": 60e-6 * np.exp(2.6j)}, ("baseline", "trial-a", "trial-b")))
    assert (found.verdict, found.named) == ("explained", ("run_unbalance.trial-b", "residual_unbalance"))
    assert "where 60 g mm at 120° is stated" in found.mistake.meaning
    assert "g mm at 149°" in found.mistake.meaning


@pytest.mark.campaign
def test_a_turned_phase_reference_ties_with_an_unbalance_that_does_the_same():
    found = answer(measured({}, change=in_run(2, np.exp(0.5j))))
    assert found.verdict == "undecided"
    named = {found.named, *(other.named for other in found.written.tied)}
    assert {("run_phase.trial-b", "residual_unbalance"), ("run_unbalance.trial-b", "residual_unbalance")} <= named
    assert "lead those of the other runs by 28." in found.summary()


@pytest.mark.campaign
def test_amplitudes_twice_as_large_in_one_run_are_no_chance():
    found = answer(measured({}, change=in_run(3, 2.0)))
    assert (found.verdict, found.named) == ("explained", ("run_amplitude.check", "residual_unbalance"))
    assert "divide amplitude_um and sigma_um of run check by 2" in found.mistake.cure


@pytest.mark.campaign
def test_speeds_of_one_run_that_are_nominal_are_named():
    slow = np.where(np.repeat(np.arange(4), len(SPEEDS)) == 1, 0.98, 1.0)
    model, m = measured({})
    there = Conditions(m.conditions.speed * slow, m.conditions.unbalance, m.conditions.bow)
    full = model + effects.ResidualUnbalance(RESIDUAL.real, RESIDUAL.imag)
    rng = np.random.default_rng(7)
    z = np.asarray(response(full, there))
    z = z + 0.3e-6 * (rng.standard_normal(z.shape) + 1j * rng.standard_normal(z.shape))
    m = Measurement.from_arrays(z, m.conditions, run=m.run, runs=m.runs, sigma=0.3e-6)
    found = answer((model, m))
    assert (found.verdict, found.named) == ("undecided", ("run_speed.trial-a", "residual_unbalance"))
    assert found.objections == (AS_STIFFNESS,)
    assert "are 1.99" in found.mistake.meaning
    assert "% lower than stated" in found.mistake.meaning


@pytest.mark.campaign
def test_probes_exchanged_in_one_run_are_named():
    def exchanged(z, of):
        return np.where((of == 1)[:, None, None], z[:, ::-1], z)

    found = answer(measured({}, change=exchanged))
    assert (found.verdict, found.named) == ("explained", ("run_probes_exchanged.trial-a", "residual_unbalance"))


def test_runs_that_agree_are_not_doubted():
    model, m = measured({})
    assert odd_runs(model, m) == []
    every = {one.kind for one in every_odd_run(model, m, KINDS)}
    assert every == {kind for kind in KINDS if kind.startswith("run_")}


@pytest.mark.parametrize(("kind", "like"), [("run_unbalance", "residual_unbalance"), ("run_speed", "speed_error")])
def test_a_value_of_one_run_is_that_of_the_effect_in_that_run_alone(kind, like):
    model, m = measured({}, ("baseline", "trial-a", "trial-b"))
    contest = make_contest(model, m, ONLY)
    mistake = next(one for one in every_odd_run(model, m) if one.name == f"{kind}.trial-a")
    change = Change.of(contest, mistake, 0.0).contest
    space, rng = change.space, np.random.default_rng(3)
    own = [e for e in space.entries if e.effect == kind]
    free = np.array([e.unknown for e in own])
    point = np.zeros(len(space.entries))
    point[free] = 0.1 * rng.standard_normal(len(free))
    lin = Linearisation(space, make_data(change.measurement, model, NO_NOISE), change.budget)
    (here,) = lin.at([Point(point, None)], [free])
    everywhere = np.zeros(len(space.entries))
    for e in own:
        place = next(o for o in space.entries if (o.effect, o.label) == (like, e.label))
        everywhere[place.unknown] = point[e.unknown] * e.scale / place.scale
    plain = Linearisation(contest.space, make_data(m, model, NO_NOISE), contest.budget)
    with_it, without = (plain.at([Point(u, None)], [free[:0]])[0].shown for u in (everywhere, 0.0 * everywhere))
    np.testing.assert_allclose(here.shown, np.where((m.run == 1)[:, None], with_it, without), rtol=1e-12)
    for k, unknown in enumerate(free):
        step = 1e-6 * (np.arange(len(point)) == unknown)
        ahead, behind = (lin.at([Point(point + sign * step, None)], [free[:0]])[0].error for sign in (1.0, -1.0))
        np.testing.assert_allclose(here.slopes[..., k], (ahead - behind) / 2e-6, rtol=1e-4, atol=1e-4)


def test_one_trial_weight_does_not_tell_the_measuring_chain_from_another_weight():
    case = measured({"trial-a": 60e-6 * np.exp(0.5j)}, ("baseline", "trial-a"))
    found = answer(case, ONLY)
    assert found.verdict == "undecided"
    assert "phase_reference_offset" in found.named
    assert "60 g mm at 29° (from +x in the sense of rotation) instead of 60 g mm at 0°" in found.summary()


@pytest.mark.parametrize("known", [True, False])
def test_what_is_other_in_one_run_is_fitted_by_hand(known):
    model, m = measured({"check": 25e-6 * np.exp(-2.5j)})
    if not known:
        m = Measurement.from_arrays(m.vectors, m.conditions, run=m.run, runs=m.runs)
    mistake = next(one for one in every_odd_run(model, m) if one.name == "run_unbalance.check")
    story = tell(model, m, [effects.ResidualUnbalance()], mistake=mistake)
    assert story.last.rms < 0.5e-6
    assert not known or story.last.reduced_chi2 < 1.3
    assert "g mm at 217°" in story.mistake.meaning


@pytest.mark.campaign
def test_a_bow_of_one_run_is_named():
    model, m = measured({})
    bow = 12e-6 * np.exp(0.5j)
    there = np.where((m.run == 2)[:, None], [bow.real, bow.imag], 0.0)
    full = model + effects.ResidualUnbalance(RESIDUAL.real, RESIDUAL.imag)
    z = np.asarray(response(full, Conditions(m.conditions.speed, m.conditions.unbalance, there)))
    rng = np.random.default_rng(9)
    z = z + 0.3e-6 * (rng.standard_normal(z.shape) + 1j * rng.standard_normal(z.shape))
    found = answer((model, Measurement.from_arrays(z, m.conditions, run=m.run, runs=m.runs, sigma=0.3e-6)))
    assert (found.verdict, found.named) == ("explained", ("run_bow.trial-b", "residual_unbalance"))
    assert "a bow of 1" in found.mistake.meaning
