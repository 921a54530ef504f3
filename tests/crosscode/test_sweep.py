"""Vectors of a rotor whose speed changes: closed form against integration in time."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import wofz

from rotorjax import Conditions, Jeffcott, Layout, Model, effects, response
from rotorjax.physics.sweep import faddeeva, pole_by_sweep

from hidden import Machine
from run_up import swept

MASS, STIFFNESS, RATIO = 1.0, (29000.0, 27000.0), (0.013, 0.02)
UNEQUAL, ISOTROPIC = Machine(MASS, STIFFNESS, RATIO), Machine(MASS, (29000.0, 29000.0), (0.02, 0.02))
UNBALANCE, BOW = 1e-5 * np.exp(0.7j), 2e-5 * np.exp(2.0j)
SPEEDS = np.linspace(120.0, 230.0, 45)


def conditions(rate: float | None) -> Conditions:
    return Conditions.at(SPEEDS, unbalance=[UNBALANCE.real, UNBALANCE.imag], bow=[BOW.real, BOW.imag], sweep=rate)


@pytest.mark.parametrize("rate", [2.0, 24.0, -24.0])
@pytest.mark.parametrize("kind", ["unequal", "isotropic", "cross-coupled"])
def test_a_sweep_as_in_time(kind, rate):
    """Up to 230 rpm/s, five times the square of the rate of decay: free vibration beats with 1X."""
    machine, cross = UNEQUAL if kind == "unequal" else ISOTROPIC, 500.0 if kind == "cross-coupled" else 0.0
    model = Model(Jeffcott(machine.mass, machine.stiffness, machine.ratio)) + effects.CrossCoupling(cross)
    expected = swept(SPEEDS, rate, machine, UNBALANCE, BOW, cross)
    steady = np.asarray(response(model, conditions(None)))[..., 0]
    assert np.max(np.abs(steady - expected)) > 0.15 * np.max(np.abs(expected))
    atol = 1e-3 * np.max(np.abs(expected))
    stated = np.asarray(response(model, conditions(rate)))[..., 0]
    np.testing.assert_allclose(stated, expected, rtol=0.0, atol=atol)
    both = response(model + effects.SweepRate(0.25 * rate), conditions(0.75 * rate))[..., 0]
    np.testing.assert_allclose(both, stated, rtol=0.0, atol=1e-9 * atol)


def test_what_is_read_at_slow_roll_is_steady():
    model = Model(Jeffcott(MASS, STIFFNESS, RATIO))
    less = dataclasses.replace(model, slow_roll=26.0)
    slow = response(model, dataclasses.replace(conditions(None), speed=jnp.full(len(SPEEDS), 26.0)))
    difference = response(model, conditions(24.0)) - slow
    np.testing.assert_allclose(response(less, conditions(24.0)), difference, rtol=1e-12)


def test_twice_per_turn_sweeps_twice_as_fast():
    """2X at a speed is what 1X would be at twice the speed and the rate."""
    twice = Model(Jeffcott(MASS, STIFFNESS, RATIO), layout=Layout(orders=(2.0,)))
    pushed = effects.Misalignment(0.0, 0.0, 0.4, 0.1, -0.3, 0.2)
    at = response(twice + pushed, Conditions.at(0.5 * SPEEDS, sweep=12.0))
    force = np.array([0.4 + 0.1j, -0.3 + 0.2j])
    compliance = [
        1.0 / (k + 1j * c * SPEEDS - MASS * SPEEDS**2) for k, c in zip(STIFFNESS, UNEQUAL.damping, strict=True)
    ]
    steady = response(twice + pushed, Conditions.at(0.5 * SPEEDS))[..., 0]
    np.testing.assert_allclose(steady, np.stack(compliance, axis=1) * force, rtol=1e-12)
    added = np.asarray(at[..., 0] - steady)
    poles = [np.sqrt(k / MASS * (1 - z**2)) + 1j * z * np.sqrt(k / MASS) for k, z in zip(STIFFNESS, RATIO, strict=True)]
    for axis, (pole, c) in enumerate(zip(poles, UNEQUAL.damping, strict=True)):
        residue = 1.0 / (1j * c - 2.0 * MASS * pole)
        one = jax.vmap(lambda at, pole=pole: pole_by_sweep(jnp.asarray(pole), at, jnp.asarray(24.0)))(
            jnp.asarray(SPEEDS)
        )
        np.testing.assert_allclose(added[:, axis], force[axis] * residue * one, rtol=1e-3, atol=1e-9)


def test_w_as_in_scipy(rng):
    z = 4.0 * rng.standard_normal(300) + 4j * np.abs(rng.standard_normal(300))
    np.testing.assert_allclose(jax.vmap(faddeeva)(jnp.asarray(z)), wofz(z), rtol=0.0, atol=1e-6)


def test_the_expansion_meets_the_closed_form():
    """No jump where one takes the place of the other, on either side of the resonance and for both signs."""
    for sign, offset in ((s, o) for s in (1.0, -1.0) for o in (-30.0, -3.0, 0.0, 3.0, 30.0)):
        pole = jnp.asarray(offset + 4j)
        edge = abs(complex(pole)) ** 2 / 60.0
        below, above = (
            pole_by_sweep(pole, jnp.asarray(0.0), jnp.asarray(sign * edge * f)) for f in (1 - 1e-9, 1 + 1e-9)
        )
        np.testing.assert_allclose(below, above, rtol=1e-5)


def test_an_overdamped_rotor_shows_nearly_what_it_does_at_steady_speeds():
    """It has no resonance that could be passed. Where one never dies out, what is shown stays finite."""

    def shown(model, rate):
        return jnp.abs(response(model, Conditions.at(SPEEDS, unbalance=[1e-5, 0.0], sweep=rate)))

    slack = Model(Jeffcott(MASS, STIFFNESS, (1.5, 2.0)))
    np.testing.assert_allclose(shown(slack, 24.0), shown(slack, 0.0), rtol=1e-3)
    for model in (slack, Model(Jeffcott(MASS, STIFFNESS, RATIO)) + effects.CrossCoupling(5000.0)):
        assert np.all(np.isfinite(shown(model, 24.0)))
        assert np.all(np.isfinite(jax.jacfwd(lambda rate, model=model: shown(model, rate))(24.0)))
