"""A force that no named effect explains, hidden in data by time integration: the regression names its shape and its
size.
"""

import dataclasses
import json

import numpy as np
import pytest

from rotorjax import Conditions, Jeffcott, Layout, Measurement, Model, effects, explain, fit
from rotorjax.arrays import as_array
from rotorjax.discovery.force_terms import regress
from rotorjax.discovery.missing_force import missing_force
from rotorjax.discovery.named_force import name_force, other_power
from rotorjax.effects.power_terms import with_power_open
from rotorjax.model.contract import Instant
from rotorjax.reporting.explanation import explanation_text, sentence
from rotorjax.reporting.explanation_json import explanation_json

import nonlinear_oracle as in_time
from drawn_forces import draw, measured
from hidden import Machine, Plan

MACHINE = Machine()
ORDERS = (0.0, 1.0, 2.0, 3.0)
SPEEDS = tuple(share * MACHINE.frequency for share in (0.5, 0.75, 0.9, 1.0, 1.1, 1.3))
WEIGHTS = {"baseline": [12e-6 + 0j], "trial": [25e-6 * np.exp(2.1j)]}
SIGMA = 0.5e-6
LEFT_OUT = 4e-6j
"""Unbalance that the rotor has and the rig file does not know [kg m]."""
GAP = 1.2e-4
PUSH, TWICE, PULSE = 1.0 * np.exp(0.7j), 0.8 * np.exp(-0.4j), 1500.0 * np.exp(0.4j)
MODEL = Model(Jeffcott(MACHINE.mass, list(MACHINE.stiffness), list(MACHINE.ratio)), layout=Layout(orders=ORDERS))

HIDDEN = {
    "cubic in x": (in_time.cubic_x(3e10), "term_cubic_x", {"cubic_n_per_m3": 3e10}),
    "two-sided stop along x of 0.12 mm": (
        in_time.dead_band_x(2e4, GAP), "term_dead_band_x", {"stiffness_n_per_m": 2e4, "inverse_gap_per_m": 1 / GAP},
    ),
    "stop on one side along y at -0.11 mm": (
        in_time.stop_below_y(1.5e4, GAP), "term_one_sided_stop_y", {"stiffness_n_per_m": 1.5e4,
        "inverse_gap_per_m": -1 / GAP},
    ),
    "square of x, stiffer on one side": (
        in_time.square_x(400.0 * np.mean(MACHINE.stiffness)), "term_unsymmetrical_x", {"growth_per_m": 400.0},
    ),
    "quadratic damping along x": (
        in_time.quadratic_damping_x(300.0), "term_quadratic_damping_x", {"damping_n_s2_per_m2": 300.0},
    ),
    # The integration has its forces on the left-hand side; these terms push.
    "constant direction along x, once per "
    "turn": (in_time.pulsating(PUSH, 0.0), "term_pulsating_x", {"cosine_n": -PUSH.real, "sine_n": PUSH.imag}),
    "constant direction along y, twice per turn": (
        in_time.pulsating(TWICE, np.pi / 2, 2), "term_pulsating_twice_y", {"cosine_n": -TWICE.real,
        "sine_n": TWICE.imag},
    ),
    "stiffness along x that pulsates twice per turn": (
        in_time.stiffness_twice_per_turn_x(PULSE), "term_turning_stiffness_x", {"cosine_n_per_m": PULSE.real,
        "sine_n_per_m": -PULSE.imag},
    ),
}  # fmt: skip


def measure(force: in_time.Force, *, left_out: complex = 0.0) -> Measurement:
    plan = Plan({run: [*weights, left_out] for run, weights in WEIGHTS.items()}, SPEEDS, ORDERS, 0.0, SIGMA)
    z = in_time.measure(MACHINE, plan, (force,), np.random.default_rng(5))
    run = np.repeat(np.arange(len(WEIGHTS)), len(SPEEDS))
    weights = np.array([[[w.real, w.imag] for w in planes] for planes in WEIGHTS.values()])[run]
    conditions = Conditions.at(np.tile(SPEEDS, len(WEIGHTS)), unbalance=weights)
    return Measurement.from_arrays(z, conditions, run=run, runs=tuple(WEIGHTS), orders=ORDERS, sigma=SIGMA)


def assert_near(found: dict[str, float], expected: dict[str, float], share: float) -> None:
    """To a share of the largest: pairs are components of one amplitude."""
    assert found.keys() == expected.keys()
    for key, value in expected.items():
        others = [v for k, v in expected.items() if k.partition("_")[2] == key.partition("_")[2]]
        assert found[key] == pytest.approx(value, abs=share * max(map(abs, others))), key


@pytest.mark.parametrize("words", HIDDEN)
def test_term_is_named(words):
    force, term, values = HIDDEN[words]
    found = regress(missing_force(MODEL, measure(force)))
    assert found[0].words == words
    assert found[0].term == term
    assert found[0].share > 0.9
    assert not found[0].rivals
    # Orders above those measured, which a stop excites, are missing in the equation of motion.
    assert_near(found[0].coefficients, values, 0.15 if "stop" in words else 0.1)
    assert len(found) == 1


@pytest.mark.campaign
def test_the_response_corrects_a_stop():
    force, _, values = HIDDEN["stop on one side along y at -0.11 mm"]
    declared = fit(MODEL, measure(force), free=(), held_out=False)
    found = name_force(declared, declared, ())
    assert found.words == "stop on one side along y at -0.12 mm"
    assert found.rivals == ()
    assert found.enough
    assert_near({e.entry.label: e.value for e in found.fit.estimates}, values, 0.03)


@pytest.mark.campaign
def test_what_does_hardly_worse_is_said():
    """A stop on either side, of which the weight lets the rotor reach one: the other cannot be seen, so that either
    name comes first.
    """
    drawn = draw(205)
    assert drawn.term == "term_dead_band_y"
    declared = fit(*measured(drawn), free=(), held_out=False)
    found = name_force(declared, declared, ())
    assert {found.words, *found.rivals} == {
        "two-sided stop along y of 0.28 mm",
        "stop on one side along y at -0.28 mm",
    }
    assert found.enough


@pytest.mark.campaign
def test_a_gap_that_has_to_be_fitted_does_not_exclude_a_rival():
    """Without order 0 the square of y fits a little better than the dead band that is there, and has one parameter
    less.
    """
    drawn = draw(721)
    assert drawn.term == "term_dead_band_y"
    declared = fit(*measured(drawn), free=(), held_out=False)
    found = name_force(declared, declared, ())
    assert any(words.startswith("two-sided stop along y") for words in (found.words, *found.rivals))


def test_one_named_effect_that_a_term_beats():
    """Drag along x alone: damping that is too small comes near, and the data have room for it; the term does far
    better.
    """
    force, term, _ = HIDDEN["quadratic damping along x"]
    found = explain(MODEL, measure(force), only=["damping_error"])
    assert found.verdict != "explained"
    assert [t.term for t in found.named_force.terms] == [term]


@pytest.mark.campaign
def test_dry_friction_that_nearly_holds_the_rotor_is_fitted():
    """No motion is found near the measured one, as friction magnifies its noise: it has to be searched for."""
    drawn = draw(317)
    declared = fit(*measured(drawn), free=(), held_out=False)
    found = name_force(declared, declared, ())
    assert [t.term for t in found.terms] == [drawn.term]
    assert found.enough


@pytest.mark.campaign
def test_a_rotor_that_is_held_still_gets_no_certain_answer():
    """Friction holds it within the noise along x, at a thirtieth of its free motion: damping of 160 times would nearly
    do that.
    """
    drawn = draw(425)
    model, measurement = measured(drawn)
    answer = explain(model, measurement)
    assert (answer.verdict, answer.effects) == ("undecided", ("damping_error",))
    assert "times the critical one: friction, a stop or a stiff support would hold the rotor as well" in sentence(
        answer
    )
    assert answer.named_force is not None
    assert [t.term for t in answer.named_force.terms] == [drawn.term]
    assert "Along x the rotor hardly moves, though without the missing force it would" in sentence(answer)
    assert explanation_json(answer)["missing_force"]["held"] == ["x"]


def test_two_at_once():
    """Neither alone looks like anything; the stop that would explain the largest vibration is not believed."""
    force, term, values = HIDDEN["cubic in x"]
    found = regress(missing_force(MODEL, measure(force, left_out=LEFT_OUT)))
    by_name = {candidate.term: candidate.coefficients for candidate in found}
    assert set(by_name) == {term, "residual_unbalance"}
    assert_near(by_name[term], values, 0.05)
    np.testing.assert_allclose(
        [by_name["residual_unbalance"][f"unbalance_{a}_kg_m"] for a in "xy"],
        [0.0, LEFT_OUT.imag],
        rtol=0.0,
        atol=0.05 * LEFT_OUT.imag,
    )


def test_fitted_effects_give_way():
    """A wrong explanation that took up half of the force, and more, is taken back."""
    force, term, values = HIDDEN["cubic in x"]
    wrong = MODEL + effects.Duffing(1e10) + effects.StiffnessError(0.02, 0.02) + effects.DampingError(0.1, 0.0)
    found = regress(missing_force(wrong, measure(force)), fitted=("duffing", "stiffness_error", "damping_error"))
    assert found[0].term == term
    assert_near(found[0].coefficients, values, 0.1)


def test_a_named_effect_is_named():
    found = regress(missing_force(MODEL, measure(in_time.duffing(2e10))))
    assert found[0].term == "duffing"
    assert_near(found[0].coefficients, {"cubic_n_per_m3": 2e10}, 0.1)


def test_unexplained_by_the_catalogue_and_named():
    """The whole of `explain`: no named effect by itself is enough, the term is, and it is said first."""
    force, term, _ = HIDDEN["cubic in x"]
    found = explain(MODEL, measure(force), max_effects=1, mistakes=False)
    assert found.verdict == "unexplained"
    assert not found.cost.untried
    assert [t.term for t in found.named_force.terms] == [term]
    assert found.named_force.enough
    said = explanation_text(found)
    assert said.index("looks like this: cubic in x") < said.index("The model as declared differs")
    told = json.loads(json.dumps(explanation_json(found), allow_nan=False))
    assert told["missing_force"]["parameters"]["term_cubic_x.cubic_n_per_m3"]["value"] == pytest.approx(3e10, rel=0.02)


def test_one_simple_term_in_the_place_of_several_effects():
    """A bow and a misalignment together can stand for a force of constant direction: neither is the answer for sure."""
    force, term, _ = HIDDEN["constant direction along x, once per turn"]
    found = explain(MODEL, measure(force))
    if found.verdict != "unexplained":
        assert found.verdict == "undecided"
        assert (
            "A simpler force would do as well, beside the model as declared: constant direction along x, once per turn."
            in explanation_text(found)
        )
    assert [t.term for t in found.named_force.terms] == [term]


@pytest.mark.campaign
def test_a_simple_term_beside_an_effect_in_the_place_of_more_effects():
    """Beside an unbalance a force of constant direction takes three effects of the catalogue: they are not the answer
    for sure.
    """
    force, term, _ = HIDDEN["constant direction along x, once per turn"]
    found = explain(MODEL, measure(force, left_out=LEFT_OUT), mistakes=False)
    assert found.verdict in ("undecided", "unexplained")
    assert {t.term for t in found.named_force.terms} == {term, "residual_unbalance"}
    assert found.named_force.enough


@pytest.mark.parametrize(
    ("force", "effect", "term", "power", "words"),
    [
        (
            in_time.spring_of_power(4e3, 5.0, 2e-4), "duffing", "term_power_spring", 5.0,
            "restoring force in proportion to the power {:.3g} of displacement",
        ),
        (
            in_time.damping_of_power(3.0, 3.0, 0.03), "quadratic_damping", "term_power_damping", 3.0,
            "damping force in proportion to the power {:.3g} of the speed of vibration",
        ),
    ],
)  # fmt: skip
def test_a_force_that_grows_with_another_power_than_the_catalogue_has(force, effect, term, power, words):
    """The usual power comes near, is beaten by far, and the power is found with its interval."""
    found = explain(MODEL, measure(force), only=[effect], mistakes=False)
    assert found.effects == (effect,) or found.verdict == "unexplained"
    assert [t.term for t in found.named_force.terms] == [term]
    exponent = found.named_force.fit.estimate(term, "power_less_two")
    assert exponent.value + 2.0 == pytest.approx(power, abs=0.3)
    assert found.named_force.words == words.format(exponent.value + 2.0)
    assert found.verdict != "explained"


@pytest.mark.parametrize(
    ("force", "effect"),
    [(in_time.duffing(2e10), "duffing"), (in_time.quadratic_damping(300.0), "quadratic_damping")],
)
def test_the_usual_power_is_not_beaten(force, effect):
    found = explain(MODEL, measure(force), mistakes=False)
    assert (found.verdict, found.effects) == ("explained", (effect,))
    assert found.named_force is None


def test_a_force_in_the_place_of_two_of_the_usual_powers():
    """A spring of the fifth power, for which a stop and a cubic spring stand: one force with its power fitted."""
    measurement = measure(in_time.spring_of_power(4e3, 5.0, 2e-4))
    declared = fit(MODEL, measurement, free=(), held_out=False)
    answer = fit(MODEL.plus([effects.Duffing(2e10), effects.Clearance(4e3, 1 / GAP)]), measurement, held_out=False)
    found = other_power(declared, answer, ("duffing", "clearance"))
    assert found is not None
    assert ([term.term for term in found.terms], found.beside) == (["term_power_spring"], ())
    assert found.fit.estimate("term_power_spring", "power_less_two").value == pytest.approx(3.0, abs=0.3)
    # The force shown is what the model lacks without it.
    assert np.max(np.abs(found.force.force)) == pytest.approx(
        4e3 * 2e-4 * (found.force.reach.radius / 2e-4) ** 5, rel=0.2
    )


def test_the_power_is_found_where_the_noise_is_unknown():
    measurement = dataclasses.replace(measure(in_time.damping_of_power(3.0, 3.0, 0.03)), sigma=None)
    declared = fit(MODEL, measurement, free=(), held_out=False)
    answer = fit(MODEL.plus([effects.QuadraticDamping(100.0)]), measurement, held_out=False)
    found = other_power(declared, answer, ("quadratic_damping",))
    assert found is not None
    assert found.fit.estimate("term_power_damping", "power_less_two").value == pytest.approx(1.0, abs=0.3)


def test_the_power_is_not_opened_where_one_probe_shows_no_force():
    measurement = measure(in_time.quadratic_damping(300.0))
    one = dataclasses.replace(measurement, present=measurement.present & np.array([True, False])[:, None])
    model = MODEL.plus([effects.QuadraticDamping(250.0), effects.Duffing(1e9)])
    answer = fit(model, one, held_out=False)
    assert other_power(fit(MODEL, one, free=(), held_out=False), answer, ("quadratic_damping", "duffing")) is None


@pytest.mark.parametrize("effect", [effects.Duffing(3e10), effects.Duffing(-2e9), effects.QuadraticDamping(120.0)])
def test_an_effect_with_its_power_open_is_the_same_force(effect):
    pair = as_array(np.array([3e-4, -1e-4]))
    instant = Instant(MODEL.rotor, as_array(200.0), as_array(0.4), pair, 150.0 * pair, pair)
    np.testing.assert_allclose(with_power_open(effect, MODEL.rotor).force(instant), effect.force(instant), rtol=1e-6)


def late(stiffness: float, delay: float) -> Measurement:
    """A force k q(t - τ) at many speeds about the resonance, in closed form: K + iωC - ω²M + k e^{-iωτ} along each
    axis.
    """
    speed = np.tile(MACHINE.frequency * np.linspace(0.6, 1.5, 16), len(WEIGHTS))
    run = np.repeat(np.arange(len(WEIGHTS)), len(speed) // len(WEIGHTS))
    (unbalance,) = np.array(list(WEIGHTS.values())).T
    own = [
        k + 1j * speed * c - speed**2 * MACHINE.mass + stiffness * np.exp(-1j * speed * delay)
        for k, c in zip(MACHINE.stiffness, MACHINE.damping, strict=True)
    ]
    z = speed**2 * unbalance[run] * np.array([1.0 / own[0], -1j / own[1]])
    noise = np.random.default_rng(7).standard_normal((2, *z.shape))
    z = (z + SIGMA * (noise[0] + 1j * noise[1])).T[:, :, None]
    weights = np.stack([unbalance.real, unbalance.imag], axis=-1)[run, None]
    conditions = Conditions.at(speed, unbalance=weights)
    return Measurement.from_arrays(z, conditions, run=run, runs=tuple(WEIGHTS), orders=(1.0,), sigma=SIGMA)


@pytest.mark.parametrize(
    ("stiffness", "periods", "noise"),
    [pytest.param(-900.0, 0.7, "given", marks=pytest.mark.campaign), (200.0, 1.6, "unknown")],
)
def test_a_force_that_follows_the_displacement_late(stiffness, periods, noise):
    """Named with its delay, not called a foundation or damping, which come near; either sign, and where the noise is
    unknown, too.
    """
    delay = periods * 2.0 * np.pi / MACHINE.frequency
    measurement = late(stiffness, delay)
    if noise == "unknown":
        measurement = dataclasses.replace(measurement, sigma=None, noise=noise)
    found = explain(MODEL, measurement, mistakes=False)
    assert found.verdict in {"undecided", "unexplained"}
    assert [t.term for t in found.named_force.terms] == ["term_delayed_force"]
    values = {e.entry.label: e.value for e in found.named_force.fit.estimates if e.entry.effect == "term_delayed_force"}
    assert values == {
        "stiffness_n_per_m": pytest.approx(stiffness, rel=0.1),
        "delay_s": pytest.approx(delay, rel=0.02),
    }
    assert (
        found.named_force.words == f"force in proportion to the displacement {1e3 * values['delay_s']:.3g} ms earlier"
    )
