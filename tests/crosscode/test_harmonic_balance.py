"""Harmonic balance against time integration: every nonlinear force, alone and all together, below, near
and above resonance.
"""

import dataclasses

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from rotorjax import Conditions, HarmonicBalance, Jeffcott, Layout, Model, effects, response
from rotorjax.model.contract import Effect, RestoringEffect, WaveformEffect

import nonlinear_oracle as in_time
from hidden import Machine, Plan
from nonlinear_oracle import DOWN, NonlinearRotor
from oracle import TimeRotor

MACHINE = Machine()
MASS, STIFFNESS, RATIO, DAMPING = MACHINE.mass, MACHINE.stiffness, MACHINE.ratio, MACHINE.damping
ORDERS = (0.0, 1.0, 2.0, 3.0)
SPEEDS = (80.0, 215.0, 233.0, 300.0)
"""A third of resonance, so that the shaft's third harmonic resonates; below; in between; above."""
UNBALANCE, BOW = 12e-6 * np.exp(0.4j), 10e-6 * np.exp(2.0j)
NO_WEIGHT = (0.0, 0.0)
PLAIN = NonlinearRotor(MASS, STIFFNESS, DAMPING, unbalance=UNBALANCE, bow=BOW)

CUBIC, CONTACT, FRICTION, DRAG, STICK, LIMIT = 5e10, 1.5e4, 0.2, 500.0, 0.05, 5e-4
LOSS, DIFFERENCE = 3000.0 * np.exp(0.5j), 1000.0 * np.exp(0.7j)
SMOOTH, CORNERED = 1e-6, 1e-3
"""Tolerances, of the largest vibration. A force with a corner leaves harmonics at all orders, and instants that miss
the corner.
"""


FORCES = {name: cls for name, cls in effects.CATALOG.items() if issubclass(cls, RestoringEffect)}


def pair(z: complex) -> list[float]:
    return [z.real, z.imag]


def gap_for(gravity: tuple[float, float]) -> float:
    """One that is reached for part of the turn, or only near resonance: the weight alone bends the shaft by 0.18 mm."""
    return 2e-4 if any(gravity) else 6e-5


CASES = {
    "duffing": (SMOOTH, lambda gravity, sense: (effects.Duffing(CUBIC), in_time.duffing(CUBIC))),
    "clearance": (
        CORNERED,
        lambda gravity, sense: (
            effects.Clearance(CONTACT, 1 / gap_for(gravity)),
            in_time.clearance(CONTACT, gap_for(gravity)),
        ),
    ),
    "rub": (
        CORNERED,
        lambda gravity, sense: (
            effects.Rub(CONTACT, 1 / gap_for(gravity), FRICTION),
            in_time.rub(CONTACT, gap_for(gravity), FRICTION, sense),
        ),
    ),
    "crack": (SMOOTH, lambda gravity, sense: (effects.Crack(*pair(LOSS)), in_time.crack(LOSS, sense, gravity))),
    "asymmetric_shaft": (
        SMOOTH,
        lambda gravity, sense: (
            effects.AsymmetricShaft(*pair(DIFFERENCE)),
            in_time.asymmetric_shaft(DIFFERENCE, sense),
        ),
    ),
    "quadratic_damping": (
        SMOOTH,
        lambda gravity, sense: (effects.QuadraticDamping(DRAG), in_time.quadratic_damping(DRAG)),
    ),
    "coulomb_friction": (
        CORNERED,
        lambda gravity, sense: (effects.CoulombFriction(STICK), in_time.coulomb_friction(STICK)),
    ),
}


def balanced(
    added: list[Effect], gravity: tuple[float, float], sense: int = 1, *, speeds=SPEEDS, orders=ORDERS
) -> np.ndarray:
    rotor = Jeffcott(MASS, STIFFNESS, RATIO, gravity=gravity, rotation="x-to-y" if sense > 0 else "y-to-x")
    conditions = Conditions.at(speeds, unbalance=pair(UNBALANCE), bow=pair(BOW))
    # All other forces beside them, at their null: one program for all.
    return np.asarray(
        response(Model(rotor, layout=Layout(orders=orders)).plus(added).with_null_effects(FORCES.values()), conditions)
    )


def assert_same(found: np.ndarray, rotor: NonlinearRotor, tolerance: float, *, speeds=SPEEDS, orders=ORDERS) -> None:
    """At every speed, to a part of the largest vibration there; the mean is no vibration."""
    for at_speed, speed in zip(found, speeds, strict=True):
        expected = rotor.vectors(speed, orders)
        largest = np.max(np.abs(expected[:, np.array(orders) > 0]))
        np.testing.assert_allclose(at_speed, expected, rtol=0.0, atol=tolerance * largest, err_msg=f"at {speed} rad/s")


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("gravity", [NO_WEIGHT, DOWN], ids=["vertical", "horizontal"])
def test_force_alone(name, gravity):
    tolerance, make = CASES[name]
    effect, force = make(gravity, 1)
    assert_same(balanced([effect], gravity), dataclasses.replace(PLAIN, gravity=gravity, forces=(force,)), tolerance)


@pytest.mark.parametrize("gravity", [NO_WEIGHT, DOWN], ids=["vertical", "horizontal"])
def test_a_stop_three_times_as_stiff_as_the_shaft(gravity):
    """With less friction than above, which the machine would not stay with."""
    stiff, gap, slight, speeds = 3.0 * STIFFNESS[0], gap_for(gravity), 0.02, (190.0, 215.0, 240.0, 265.0)
    rotor = dataclasses.replace(PLAIN, gravity=gravity, forces=(in_time.rub(stiff, gap, slight, 1),))
    assert_same(balanced([effects.Rub(stiff, 1 / gap, slight)], gravity, speeds=speeds), rotor, 1e-4, speeds=speeds)


def test_a_stop_ten_times_as_stiff_as_the_shaft():
    """Its corners reach orders far above 7X: with those alone the motion is wrong by 0.6 %."""
    stiffness, gap, slight, speed, gravity = 1.5e5, 8.8e-5, 0.1, 230.0, DOWN
    rotor = Jeffcott(1.3, [stiffness, stiffness], 0.025, gravity=gravity)
    model = Model(rotor, layout=Layout(orders=ORDERS)) + effects.Rub(1.5e6, 1 / gap, slight)
    conditions = Conditions.at([speed], unbalance=[2.6e-5, 0.0])
    found = response(model, conditions)
    damping = 2.0 * 0.025 * np.sqrt(stiffness * 1.3)
    same = NonlinearRotor(
        1.3,
        (stiffness, stiffness),
        (damping, damping),
        unbalance=2.6e-5,
        gravity=gravity,
        forces=(in_time.rub(1.5e6, gap, slight, 1),),
    )
    assert_same(np.asarray(found), same, CORNERED, speeds=(speed,))
    few = HarmonicBalance(fine_order=7, fine_samples=64)
    coarse = response(dataclasses.replace(model, harmonic_balance=few), conditions)
    assert 1e-3 < np.max(np.abs(coarse - found)) / np.max(np.abs(found)) < 1e-2


@pytest.mark.parametrize("gravity", [NO_WEIGHT, DOWN], ids=["vertical", "horizontal"])
def test_probe_saturation(gravity):
    rotor = dataclasses.replace(PLAIN, gravity=gravity, bend=in_time.saturation(LIMIT))
    assert_same(balanced([effects.ProbeSaturation(1 / LIMIT)], gravity), rotor, SMOOTH)


def test_weight_to_the_side_opens_a_crack_elsewhere():
    aside = (6.0, -7.0)
    effect, force = CASES["crack"][1](aside, 1)
    assert_same(balanced([effect], aside), dataclasses.replace(PLAIN, gravity=aside, forces=(force,)), SMOOTH)


def test_every_coupled_effect_is_checked():
    coupled = {name for name, cls in effects.CATALOG.items() if issubclass(cls, RestoringEffect | WaveformEffect)}
    assert coupled == set(CASES) | {"probe_saturation"}


NULLS = [cls() for cls in effects.CATALOG.values() if issubclass(cls, RestoringEffect | WaveformEffect)]
BACKWARD = {"speeds": (80.0, 215.0, 300.0), "orders": (0.0, 0.5, 1.0, 2.0, 3.0)}
"""With half orders, so that a period is two turns; there is nothing at them."""


@pytest.mark.parametrize("name", ["rub", "crack", "asymmetric_shaft"])
def test_shaft_turning_from_y_to_x(name):
    """One at a time, the others there without strength."""
    tolerance, make = CASES[name]
    effect, force = make(DOWN, -1)
    rotor = dataclasses.replace(PLAIN, gravity=DOWN, sense=-1, forces=(force,))
    assert_same(balanced([effect, *NULLS], DOWN, -1, **BACKWARD), rotor, tolerance, **BACKWARD)


def test_all_forces_together():
    """Each a third as strong as alone, read by a probe that saturates."""
    share, gap = 0.3, 2.2e-4
    added = [
        effects.ProbeSaturation(1 / LIMIT), effects.Rub(share * CONTACT, 1 / gap, FRICTION),
        effects.QuadraticDamping(share * DRAG),
        effects.Duffing(share * CUBIC), effects.Crack(*pair(share * LOSS)), effects.CoulombFriction(share * STICK),
        effects.Clearance(share * CONTACT, 1 / gap), effects.AsymmetricShaft(*pair(share * DIFFERENCE)),
    ]  # fmt: skip
    forces = (
        in_time.asymmetric_shaft(share * DIFFERENCE, -1), in_time.clearance(share * CONTACT, gap),
        in_time.coulomb_friction(share * STICK),
        in_time.crack(share * LOSS, -1, DOWN), in_time.duffing(share * CUBIC), in_time.quadratic_damping(share * DRAG),
        in_time.rub(share * CONTACT, gap, FRICTION, -1),
    )  # fmt: skip
    rotor = dataclasses.replace(PLAIN, gravity=DOWN, sense=-1, forces=forces, bend=in_time.saturation(LIMIT))
    grid = BACKWARD | {"speeds": (120.0, 215.0, 300.0)}
    assert_same(balanced(added, DOWN, -1, **grid), rotor, 1e-4, **grid)


def test_another_integrator_agrees_on_duffing():
    """From rest, over as many turns as it takes to forget that."""
    speed, turns, samples, micro = 233.0, 90, 64, 1e-6

    def rate(t, state, args):
        q, v = state[:2] * micro, state[2:] * micro
        angles = speed * t + jnp.angle(jnp.array([UNBALANCE, BOW]))
        pull, bow = jnp.abs(jnp.array([UNBALANCE, BOW]))[:, None] * jnp.stack(
            [jnp.cos(angles), jnp.sin(angles)], axis=1
        )
        bent = q - bow
        resists = (jnp.array(STIFFNESS) + CUBIC * jnp.sum(bent**2)) * bent + jnp.array(DAMPING) * v
        return jnp.concatenate([v, (speed**2 * pull - resists) / MASS + jnp.array(DOWN)]) / micro

    period = 2 * np.pi / speed
    times = (turns + np.arange(samples) / samples) * period
    controller = diffrax.PIDController(rtol=1e-9, atol=1e-9)

    @jax.jit
    def integrate(start):
        term, save = diffrax.ODETerm(rate), diffrax.SaveAt(ts=jnp.asarray(times))
        return diffrax.diffeqsolve(
            term,
            diffrax.Dopri8(),
            0.0,
            times[-1],
            None,
            start,
            saveat=save,
            stepsize_controller=controller,
            max_steps=20_000,
        ).ys

    waves = np.asarray(integrate(jnp.zeros(4)))[:, :2].T * micro
    found = np.stack(
        [(1 if n == 0 else 2) * np.mean(waves * np.exp(-1j * n * speed * times), axis=1) for n in ORDERS], axis=1
    )
    assert_same(
        found[None], dataclasses.replace(PLAIN, gravity=DOWN, forces=(in_time.duffing(CUBIC),)), SMOOTH, speeds=(speed,)
    )
    np.testing.assert_allclose(
        balanced([effects.Duffing(CUBIC)], DOWN)[SPEEDS.index(speed)],
        found,
        rtol=0.0,
        atol=SMOOTH * np.max(np.abs(found[:, 1:])),
    )


@pytest.mark.parametrize("sense", [1, -1])
def test_oracle_without_forces_is_the_linear_one(sense):
    linear = TimeRotor(
        MASS, STIFFNESS, DAMPING, sense, unbalance=UNBALANCE, bow=BOW, force_2=(0.5 + 0.1j, -0.4 + 0.25j)
    )
    twice = tuple(
        in_time.pulsating(-force, direction, 2)
        for force, direction in zip(linear.force_2, (0.0, np.pi / 2), strict=True)
    )
    found = dataclasses.replace(PLAIN, sense=sense, forces=twice).vectors(215.0, (1.0, 2.0))
    expected = linear.vectors(215.0, (1, 2))
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-9 * np.max(np.abs(expected)))


def test_oracle_refuses_an_unstable_motion(rng):
    """A shaft whose stiffness pulsates twice as fast as it sways: Mathieu's instability."""
    speed = np.sqrt(STIFFNESS[0] / MASS)
    rotor = dataclasses.replace(PLAIN, forces=(in_time.stiffness_twice_per_turn_x(0.5 * STIFFNESS[0]),))
    with pytest.raises(RuntimeError, match="unstable"):
        dataclasses.replace(rotor, transient=2).vectors(speed)


def test_measurements_with_a_hidden_force(rng):
    """Runs one after the other, speeds inside; noise as large as the plan says; the mean is real."""
    weights = {"baseline": [UNBALANCE], "trial": [UNBALANCE, 5e-6j]}
    plan = Plan(weights, (120.0, 300.0), (0.0, 1.0), BOW, 0.0)
    force = in_time.duffing(CUBIC)
    clean = in_time.measure(MACHINE, plan, lambda speed: (force,), rng, gravity=DOWN)
    assert clean.shape == (4, 2, 2)
    assert_same(
        clean[:2],
        dataclasses.replace(PLAIN, gravity=DOWN, forces=(force,)),
        1e-12,
        speeds=plan.speeds,
        orders=plan.orders,
    )
    trial = dataclasses.replace(PLAIN, gravity=DOWN, forces=(force,), unbalance=UNBALANCE + 5e-6j)
    assert_same(clean[2:], trial, 1e-12, speeds=plan.speeds, orders=plan.orders)
    noisy = in_time.measure(MACHINE, dataclasses.replace(plan, sigma=1e-6), (force,), rng, gravity=DOWN)
    assert np.all(noisy[..., 0].imag == 0.0)
    error = (noisy - clean)[..., 1]
    assert 0.3e-6 < np.sqrt(np.mean(error.real**2 + error.imag**2) / 2) < 3e-6
