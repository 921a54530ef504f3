"""Vectors of a rotor whose speed changes: closed form against integration in time."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.special import wofz

from rotorjax import Conditions, Jeffcott, Layout, Model, effects, response
from rotorjax.physics.sweep import faddeeva, kept

MASS, STIFFNESS, RATIO = 1.0, (29000.0, 27000.0), (0.013, 0.02)
DAMPING = tuple(2 * z * np.sqrt(k * MASS) for z, k in zip(RATIO, STIFFNESS, strict=True))
UNBALANCE, BOW = 1e-5 * np.exp(0.7j), 2e-5 * np.exp(2.0j)
SPEEDS = np.linspace(120.0, 230.0, 45)
FORWARD = np.array([1.0, -1j])


def swept(rate: float, path: np.ndarray, cross: np.ndarray, damping: np.ndarray) -> np.ndarray:
    """Amplitudes of x and y at `SPEEDS` on the way, of a rotor that begins in steady motion far off.

    The motion is complex, its real part the rotor's.
    """
    stiffness = path + cross
    begin = 40.0 if rate > 0.0 else 500.0
    instants = (SPEEDS - begin) / rate
    order = np.argsort(instants)

    def turned(t):
        return begin * t + 0.5 * rate * t**2

    def change(t, state):
        speed = begin + rate * t
        # The mass centre at e^{iφ} from the shaft's: minus its acceleration pushes.
        push = UNBALANCE * (speed**2 - 1j * rate) * FORWARD + path @ (BOW * FORWARD)
        back = damping @ state[2:] + stiffness @ state[:2]
        return np.concatenate([state[2:], (push * np.exp(1j * turned(t)) - back) / MASS])

    dynamic = stiffness + 1j * begin * damping - begin**2 * MASS * np.eye(2)
    steady = np.linalg.solve(dynamic, UNBALANCE * begin**2 * FORWARD + path @ (BOW * FORWARD))
    start = np.concatenate([steady, 1j * begin * steady])
    found = solve_ivp(change, (0.0, instants.max() + 1e-6), start, "DOP853", instants[order], rtol=1e-9, atol=1e-15)
    amplitudes = np.empty((len(SPEEDS), 2), complex)
    amplitudes[order] = (found.y[:2] * np.exp(-1j * turned(found.t))).T
    return amplitudes


def conditions(rate: float | None) -> Conditions:
    return Conditions.at(SPEEDS, unbalance=[UNBALANCE.real, UNBALANCE.imag], bow=[BOW.real, BOW.imag], sweep=rate)


@pytest.mark.parametrize("rate", [2.0, 24.0, -24.0])
@pytest.mark.parametrize("kind", ["unequal", "isotropic", "cross-coupled"])
def test_a_sweep_as_in_time(kind, rate):
    """Up to 230 rpm/s, five times the square of the rate of decay: free vibration beats with 1X."""
    stiffness, ratio = (STIFFNESS, RATIO) if kind == "unequal" else ((STIFFNESS[0],) * 2, (RATIO[1],) * 2)
    model = Model(Jeffcott(MASS, stiffness, ratio))
    damping = np.diag([2 * z * np.sqrt(k * MASS) for z, k in zip(ratio, stiffness, strict=True)])
    cross = np.zeros((2, 2))
    if kind == "cross-coupled":
        cross = np.array([[0.0, 500.0], [-500.0, 0.0]])
        model += effects.CrossCoupling(500.0)
    expected = swept(rate, np.diag(stiffness), cross, damping)
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
    compliance = [1.0 / (k + 1j * c * SPEEDS - MASS * SPEEDS**2) for k, c in zip(STIFFNESS, DAMPING, strict=True)]
    steady = response(twice + pushed, Conditions.at(0.5 * SPEEDS))[..., 0]
    np.testing.assert_allclose(steady, np.stack(compliance, axis=1) * force, rtol=1e-12)
    added = np.asarray(at[..., 0] - steady)
    poles = [np.sqrt(k / MASS * (1 - z**2)) + 1j * z * np.sqrt(k / MASS) for k, z in zip(STIFFNESS, RATIO, strict=True)]
    for axis, (pole, c) in enumerate(zip(poles, DAMPING, strict=True)):
        residue = 1.0 / (1j * c - 2.0 * MASS * pole)
        one = jax.vmap(lambda at, pole=pole: kept(jnp.asarray(pole), at, jnp.asarray(24.0)))(jnp.asarray(SPEEDS))
        np.testing.assert_allclose(added[:, axis], force[axis] * residue * one, rtol=1e-3, atol=1e-9)


def test_w_as_in_scipy(rng):
    z = 4.0 * rng.standard_normal(300) + 4j * np.abs(rng.standard_normal(300))
    np.testing.assert_allclose(jax.vmap(faddeeva)(jnp.asarray(z)), wofz(z), rtol=0.0, atol=1e-6)


def test_the_expansion_meets_the_closed_form():
    """No jump where one takes the place of the other, on either side of the resonance and for both signs."""
    for sign, offset in ((s, o) for s in (1.0, -1.0) for o in (-30.0, -3.0, 0.0, 3.0, 30.0)):
        pole = jnp.asarray(offset + 4j)
        edge = abs(complex(pole)) ** 2 / 60.0
        below, above = (kept(pole, jnp.asarray(0.0), jnp.asarray(sign * edge * f)) for f in (1 - 1e-9, 1 + 1e-9))
        np.testing.assert_allclose(below, above, rtol=1e-5)
