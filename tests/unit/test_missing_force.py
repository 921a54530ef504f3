"""The force that a model lacks: zero where nothing is missing, the hidden one where something is, and a reason where it
cannot be told.
"""

import dataclasses
import inspect

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from rotorjax import Conditions, Effect, Jeffcott, Layout, Measurement, Model, effects, response
from rotorjax.discovery.force_shapes import Reach, shapes
from rotorjax.discovery.force_terms import regress
from rotorjax.discovery.missing_force import missing_force
from rotorjax.effects.terms import TERMS
from rotorjax.reporting import plots

ORDERS = (0.0, 1.0, 2.0, 3.0)
SPEEDS = (120.0, 200.0, 235.0, 260.0, 320.0)
GRAVITY = (0.0, -9.80665)
SIGMA = 3e-7


def rotor(**settings) -> Model:
    return Model(
        Jeffcott(0.9686, [56538.0, 51282.0], [0.03, 0.05], gravity=GRAVITY), layout=Layout(orders=ORDERS), **settings
    )


def measured(model: Model, *, sigma: float | None = SIGMA) -> Measurement:
    """Two runs at every speed, without noise."""
    run = np.repeat([0, 1], len(SPEEDS))
    weights = np.array([[[12e-6, 3e-6]], [[-5e-6, 20e-6]]])[run]
    conditions = Conditions.at(np.tile(SPEEDS, 2), unbalance=weights, bow=[4e-6, -2e-6])
    z = np.asarray(response(model, conditions))
    orders, errors = model.layout.orders, None if sigma is None else np.full(z.shape, sigma)
    return Measurement.from_arrays(z, conditions, run=run, runs=("one", "two"), orders=orders, sigma=errors)


CRANKED = {"probes": dataclasses.replace(rotor().probes, angle=jnp.array([0.6, 2.4]))}
MODELS = {
    "linear": lambda: rotor() + effects.ResidualBow(5e-6, 1e-6),
    "chain": lambda: (
        rotor(**CRANKED)
        + effects.TimeDelay(3e-4)
        + effects.ProbeGain([0.1, -0.05])
        + effects.SpeedError(0.01)
        + effects.Foundation(2e-6, 0.3, 0.1)
    ),
    "slow roll": lambda: rotor(slow_roll=20.0) + effects.ResidualBow(5e-6, 1e-6),
    "crack": lambda: rotor() + effects.Crack(1500.0, 400.0),
}


@pytest.mark.parametrize("name", MODELS)
def test_nothing_is_missing_from_the_model_that_made_the_data(name):
    model = MODELS[name]()
    found = missing_force(model, measured(model))
    assert found.reason is None
    assert found.usable.all()
    # A crack excites orders beyond those measured.
    assert np.max(np.abs(found.amplitude)) < (5e-2 if name == "crack" else 1e-9)
    assert found.force.shape == found.displacement.shape == found.velocity.shape == (10, 2, 64)
    assert np.all(found.amplitude_error > 0.0)


def test_hidden_force_comes_back_order_by_order():
    hidden = {"term_steady_x": [2.0], "term_pulsating_y": [0.5, -0.3], "term_pulsating_twice_x": [0.2, 0.7]}
    model = MODELS["chain"]()
    found = missing_force(model, measured(model.plus(TERMS[name](*values) for name, values in hidden.items())))
    expected = np.array([[2.0, 0.0, 0.2 - 0.7j, 0.0], [0.0, 0.5 + 0.3j, 0.0, 0.0]])
    np.testing.assert_allclose(found.amplitude, np.broadcast_to(expected, found.amplitude.shape), rtol=0.0, atol=1e-9)
    wave = 2.0 + 0.2 * np.cos(2 * found.angle) + 0.7 * np.sin(2 * found.angle)
    np.testing.assert_allclose(found.force[:, 0], np.broadcast_to(wave, found.force[:, 0].shape), rtol=0.0, atol=1e-9)


def test_standard_error_covers(rng):
    model = rotor()
    clean = measured(model)
    pulls = []
    for _ in range(100):
        noise = SIGMA * (rng.standard_normal(clean.vectors.shape) + 1j * rng.standard_normal(clean.vectors.shape))
        noise[:, :, 0] = noise[:, :, 0].real
        found = missing_force(model, dataclasses.replace(clean, vectors=clean.vectors + noise))
        pulls.append(found.amplitude / found.amplitude_error)
    real, imaginary = np.std(np.real(pulls)), np.std(np.imag(pulls)[..., 1:])
    assert real == pytest.approx(1.0, abs=0.03)
    assert imaginary == pytest.approx(1.0, abs=0.03)


def test_one_probe_says_why_not():
    model = rotor()
    measurement = measured(model)
    present = measurement.present.copy()
    present[:5, 1] = False
    some = missing_force(model, dataclasses.replace(measurement, present=present))
    assert some.usable.tolist() == [False] * 5 + [True] * 5
    assert np.all(some.force[:5] == 0.0)
    present[:, 1] = False
    none = missing_force(model, dataclasses.replace(measurement, present=present))
    assert none.reason is not None
    assert "only one direction was measured" in none.reason
    assert regress(none) == ()
    bent = missing_force(model + effects.ProbeSaturation(100.0), measurement)
    assert bent.reason is not None
    assert "waveform" in bent.reason


def test_an_order_without_probes_is_the_linear_rotors():
    model, hidden = rotor(), TERMS["term_pulsating_x"](0.4, 0.1)
    measurement = measured(model + hidden)
    present = measurement.present.copy()
    present[0, :, 0] = False
    found = missing_force(
        model, dataclasses.replace(measurement, present=present, vectors=np.where(present, measurement.vectors, 0.0))
    )
    assert found.usable.all()
    np.testing.assert_allclose(found.amplitude[0, 0], [0.0, 0.4 - 0.1j, 0.0, 0.0], rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(np.mean(found.displacement[0, 1]), GRAVITY[1] * 0.9686 / 51282.0, rtol=1e-9)


def test_unknown_noise_and_an_allowance():
    model = rotor()
    given = measured(model + TERMS["term_steady_x"](1.0))
    unknown = missing_force(model, measured(model + TERMS["term_steady_x"](1.0), sigma=None))
    np.testing.assert_allclose(unknown.amplitude_error, missing_force(model, given).amplitude_error * 1e-6 / SIGMA)
    assert regress(unknown)[0].term == "term_steady_x"
    wider = missing_force(model, given, noise_allowance=np.sqrt(3.0) * SIGMA)
    np.testing.assert_allclose(wider.amplitude_error, 2.0 * missing_force(model, given).amplitude_error)


def test_other_probes_are_refused():
    measurement = dataclasses.replace(measured(rotor()), probes=("A", "B"))
    with pytest.raises(ValueError, match="build both from one rig file"):
        missing_force(rotor(), measurement)


def test_noise_alone_names_nothing(rng):
    clean = measured(rotor())
    noise = SIGMA * (rng.standard_normal(clean.vectors.shape) + 1j * rng.standard_normal(clean.vectors.shape))
    noise[:, :, 0] = noise[:, :, 0].real
    assert regress(missing_force(rotor(), dataclasses.replace(clean, vectors=clean.vectors + noise))) == ()


@pytest.mark.parametrize("name", TERMS)
def test_terms_keep_the_contract(name, paper_rotor):
    cls = TERMS[name]
    assert cls.name == name
    assert name not in effects.CATALOG
    assert not inspect.isabstract(cls)
    assert all(base is Effect or inspect.isabstract(base) for base in cls.__mro__[1:] if issubclass(base, Effect))
    assert cls.__doc__
    assert len(cls.meaning) > 20
    assert any(character.isdigit() for character in cls.source)
    assert set(cls.relatives) <= set(effects.CATALOG)
    assert set(cls.alike) <= set(TERMS) - {name}
    assert all(p.prior_scale(paper_rotor) > 0.0 for p in cls.parameters())
    assert all(set(start) <= {p.name for p in cls.parameters()} for start in cls.starts)


def test_terms_at_their_null_change_nothing():
    plain, conditions = rotor(), Conditions.at([150.0, 300.0], unbalance=[3e-6, 1e-6])
    whole = plain.plus(cls() for cls in TERMS.values())
    np.testing.assert_allclose(response(whole, conditions), response(plain, conditions), rtol=1e-12, atol=1e-18)

    def reading(unit):
        added = [
            cls().replaced([unit * p.prior_scale(plain.rotor) for p in cls.parameters()]) for cls in TERMS.values()
        ]
        z = response(plain.plus(added), conditions)
        return jnp.stack([z.real, z.imag])

    assert np.all(np.isfinite(jax.jacfwd(reading)(jnp.zeros(()))))


def test_words_are_plain(paper_rotor):
    tried = list(shapes(effects.CATALOG | TERMS, paper_rotor, Reach(2e-4, 1e-4, 2e-4)))
    words = {shape.words for shape in tried}
    expected = {
        "cubic in x",
        "quadratic damping along y",
        "constant direction along x, once per turn",
        "stiffness along y",
        "cross coupling",
    }
    assert expected <= words
    assert "two-sided stop along x of 0.19 mm" in words
    assert "clearance beyond 0.19 mm" in words
    assert len([shape for shape in tried if shape.term == "term_dead_band_y"]) == 12


def test_picture_shows_the_largest_forces():
    model = rotor()
    found = missing_force(model, measured(model + TERMS["term_cubic_x"](5e10)))
    drawn, axes = plots.figure(12.0, 6.0, 2, 3)
    for k, over in enumerate(("displacement", "velocity", "angle")):
        for dof in range(2):
            assert plots.missing_force(axes[3 * dof + k], found, over=over, dof=dof) is axes[3 * dof + k]
    assert axes[0].get_xlabel() == "displacement x, µm"
    assert axes[4].get_xlabel() == "velocity y, mm/s"
    assert axes[2].get_ylabel() == "force missing along x, N"
    assert len(axes[0].get_legend().get_texts()) == 4
    drawn.canvas.draw()


@pytest.mark.parametrize("log_ratio", [1.5, -1.0])
def test_damping_that_the_regression_finds_is_a_logarithm_as_its_effect_is(log_ratio):
    found = missing_force(rotor(), measured(rotor() + effects.DampingError(0.0, log_ratio)))
    (term,) = regress(found, effects.CATALOG)
    assert term.term == "damping_error"
    assert term.coefficients == pytest.approx({"log_ratio_y": log_ratio}, rel=1e-2)


@pytest.mark.parametrize(("size", "nothing"), [(0.0, True), (1.0, True), (1.5, False)])
def test_a_table_of_noise_shows_nothing(size, nothing, rng):
    """Order 0 has no imaginary part: it counts one number."""
    clean = measured(rotor())
    noise = size * SIGMA * (rng.standard_normal(clean.vectors.shape) + 1j * rng.standard_normal(clean.vectors.shape))
    noise[:, :, 0] = noise[:, :, 0].real
    assert dataclasses.replace(clean, vectors=noise).shows_nothing == nothing
    assert not clean.shows_nothing
