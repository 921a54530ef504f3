"""What holds for every rotor: superposition, turning everything together, gradients, inverse of the forward map."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rotorjax import Conditions, Jeffcott, Layout, Measurement, Model, diagnose, effects, response
from rotorjax.effects.terms import TERMS

finite = st.floats(-1.0, 1.0, allow_subnormal=False)
pairs = st.tuples(finite, finite)
speeds = st.floats(30.0, 400.0)
ROTOR = Jeffcott(0.9686, [56538.0, 51282.0], [0.02, 0.03])
EFFECTS = [
    effects.CrossCoupling(800.0),
    effects.Gyroscopic(0.03),
    effects.Foundation(2e-6, 0.4, 0.0),
    effects.ProbeAngle([0.1, -0.1]),
]
LOADED = sum(EFFECTS, Model(ROTOR))


def vectors(speed, unbalance, bow) -> np.ndarray:
    return np.asarray(
        response(LOADED, Conditions.at([speed], unbalance=1e-5 * np.array(unbalance), bow=1e-4 * np.array(bow)))
    )


@given(speeds, pairs, pairs, pairs, pairs)
def test_superposition(speed, u1, u2, s1, s2):
    both = vectors(speed, np.add(u1, u2), np.add(s1, s2))
    np.testing.assert_allclose(
        both, vectors(speed, u1, s1) + vectors(speed, u2, s2), atol=1e-15 + 1e-10 * np.max(np.abs(both))
    )


@given(speeds, pairs, st.floats(-3.0, 3.0))
def test_turning_the_fault_turns_the_phase(speed, unbalance, angle):
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    turned = vectors(speed, turn @ np.array(unbalance), (0.0, 0.0))
    np.testing.assert_allclose(
        turned, vectors(speed, unbalance, (0.0, 0.0)) * np.exp(1j * angle), atol=1e-16 + 1e-10 * np.max(np.abs(turned))
    )


@given(speeds, pairs, pairs)
def test_inverse_undoes_the_response(speed, unbalance, bow):
    conditions = Conditions.at([speed, 0.6 * speed], unbalance=1e-5 * np.array(unbalance), bow=1e-4 * np.array(bow))
    z = np.asarray(response(LOADED, conditions))
    run, present = np.zeros(2, int), np.ones(z.shape, bool)
    measurement = Measurement(
        ("a",), ("X", "Y"), (1.0,), run, ("", ""), conditions, z, present, np.full(z.shape, 1e-9), "given"
    )
    found = diagnose(LOADED, measurement).runs[0]
    assert found.unbalance is not None
    assert found.bow is not None
    np.testing.assert_allclose(found.unbalance.pair, 1e-5 * np.array(unbalance), atol=2e-8)
    np.testing.assert_allclose(found.bow.pair, 1e-4 * np.array(bow), atol=2e-7)


def test_vmap_is_a_loop_and_jit_is_eager():
    speed = np.array([100.0, 233.0, 300.0])
    conditions = Conditions.at(speed, unbalance=[1e-6, 2e-6], bow=[1e-5, 0.0])
    together = np.asarray(response(LOADED, conditions))
    alone = np.concatenate(
        [np.asarray(response(LOADED, Conditions.at([s], unbalance=[1e-6, 2e-6], bow=[1e-5, 0.0]))) for s in speed]
    )
    np.testing.assert_allclose(together, alone, rtol=1e-13)
    with jax.disable_jit():
        np.testing.assert_allclose(np.asarray(response(LOADED, conditions)), together, rtol=1e-13)


def test_gradients_reach_what_a_force_takes_of_the_rotor():
    """A crack looks along gravity, a one-sided stiffness grows from the mean stiffness."""
    conditions = Conditions.at([150.0, 220.0], unbalance=[1e-4, 0.0])

    def size(share):
        rotor = Jeffcott(
            0.9686,
            jnp.array([56538.0, 51282.0]) * share,
            jnp.array([0.05, 0.05]),
            gravity=jnp.array([share - 2.0, -9.81]),
        )
        model = Model(rotor, layout=Layout(orders=(1.0, 2.0))).plus(
            [TERMS["term_unsymmetrical_x"](400.0), effects.Crack(2000.0, 1000.0)]
        )
        return jnp.sum(jnp.abs(response(model, conditions) * 1e4) ** 2)

    difference = (size(1.0 + 1e-5) - size(1.0 - 1e-5)) / 2e-5
    assert float(jax.grad(size)(1.0)) == pytest.approx(float(difference), rel=1e-6)


@pytest.mark.parametrize("name", ["mass", "stiffness", "damping_ratio"])
def test_gradients_of_the_rotor_equal_finite_differences(name):
    conditions = Conditions.at([200.0, 260.0], unbalance=[1e-6, 2e-6], bow=[1e-5, 0.0])
    base = {"mass": 0.9686, "stiffness": jnp.array([56538.0, 51282.0]), "damping_ratio": jnp.array([0.02, 0.03])}

    def size(value):
        z = response(sum(EFFECTS, Model(Jeffcott(**{**base, name: value}))), conditions)
        return jnp.sum(jnp.abs(z * 1e6) ** 2)

    value = jnp.asarray(base[name])
    slope = jax.grad(lambda t: size(value * (1.0 + t)))(0.0)
    step = 1e-6
    difference = (size(value * (1 + step)) - size(value * (1 - step))) / (2 * step)
    assert float(slope) == pytest.approx(float(difference), rel=1e-6)
