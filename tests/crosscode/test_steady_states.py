"""Stable or not, and one steady state or several: against integration in time, closed forms and eigenvalues."""

from typing import ClassVar

import jax.numpy as jnp
import numpy as np
import pytest
from jax import Array
from scipy.integrate import solve_ivp

from rotorjax import Conditions, Jeffcott, Layout, Model, Support, SupportEffect, effects, response, steady_states
from rotorjax.model.contract import Family, OperatingPoint
from rotorjax.model.parameters import parameter
from rotorjax.physics.harmonic_balance import BALANCED, UNSTABLE

from nonlinear_oracle import DOWN, NonlinearRotor, clearance, rub

MASS, STIFFNESS, RATIO = 1.0, 5e4, 0.01
FREQUENCY = np.sqrt(STIFFNESS / MASS)
DAMPING = 2 * RATIO * np.sqrt(STIFFNESS * MASS)
UNBALANCE, CUBIC = 5e-6, 2e11
SHARES = (0.7, 0.9, 0.98, 1.01, 1.05, 1.08, 1.1, 1.12, 1.14, 1.2, 1.3, 1.5)
"""Speeds in the natural frequency: the resonance curve leans over from 1.03 to 1.15."""
WHIRL = np.array([[0.0, 1.0], [-1.0, 0.0]])
TURN = 2 * np.pi


@pytest.fixture(scope="module")
def leaning():
    model = Model(Jeffcott(MASS, STIFFNESS, RATIO)) + effects.Duffing(CUBIC)
    conditions = Conditions.at(np.array(SHARES) * FREQUENCY, unbalance=[UNBALANCE, 0.0])
    return steady_states(model, conditions), np.asarray(response(model, conditions))


def circles(speed: float) -> np.ndarray:
    """Radii r of circular motion, ((K - MΩ² + k_3 r²)² + (cΩ)²) r² = (Ω² U)², from the least."""
    short, drag = STIFFNESS - MASS * speed**2, DAMPING * speed
    squares = np.roots([CUBIC**2, 2 * CUBIC * short, short**2 + drag**2, -((UNBALANCE * speed**2) ** 2)])
    return np.sqrt(np.sort(squares.real[(np.abs(squares.imag) < 1e-9 * np.abs(squares)) & (squares.real > 0)]))


def reached(speed: float, begun: np.ndarray, turns: int = 250) -> np.ndarray:
    """Amplitudes at 1X along x and y after so many turns, from a state (x, y and their velocities)."""

    def rate(t, state):
        q, v = state[:2], state[2:]
        pull = UNBALANCE * speed**2 * np.array([np.cos(speed * t), np.sin(speed * t)])
        return np.concatenate([v, (pull - DAMPING * v - (STIFFNESS + CUBIC * (q @ q)) * q) / MASS])

    times = (turns + np.arange(64) / 64) * TURN / speed
    path = solve_ivp(
        rate, (0.0, times[-1]), begun, "DOP853", times, rtol=1e-8, atol=1e-12 * np.array([1.0, 1.0, speed, speed])
    )
    return 2 * np.mean(path.y[:2] * np.exp(-1j * speed * times), axis=1)


def growth(mass: np.ndarray, damping: np.ndarray, stiffness: np.ndarray, speed: float) -> float:
    """Largest exp(Re λ T) over one turn."""
    size = len(mass)
    rate = np.block(
        [[np.zeros((size, size)), np.eye(size)], [-np.linalg.solve(mass, stiffness), -np.linalg.solve(mass, damping)]]
    )
    return float(np.exp(np.max(np.linalg.eigvals(rate).real) * TURN / speed))


def test_vectors_are_those_of_the_response(leaning):
    states, expected = leaning
    np.testing.assert_allclose(states.vectors, expected, rtol=1e-9, atol=0.0)
    assert np.all(states.result == BALANCED)


def test_a_leaning_curve_has_two_stable_states_where_it_overhangs(leaning):
    states, _ = leaning
    inside = 0
    for k, speed in enumerate(states.speed):
        radii = circles(speed)
        stable = [radii[0], radii[2]] if len(radii) == 3 else [radii[0]]
        found = [states.vectors[k]] + [other.vectors for other in states.others[k] if other.stable]
        np.testing.assert_allclose(sorted(abs(vectors[0, 0]) for vectors in found), stable, rtol=1e-6)
        for other in states.others[k]:
            if not other.stable:
                np.testing.assert_allclose(abs(other.vectors[0, 0]), radii[1], rtol=1e-6)
        inside += len(radii) == 3
    assert inside == 5


def test_the_machine_stays_in_either_state(leaning):
    states, _ = leaning
    k = SHARES.index(1.1)
    speed, both = states.speed[k], [states.vectors[k][:, 0], states.others[k][0].vectors[:, 0]]
    assert max(abs(z[0]) for z in both) > 5 * min(abs(z[0]) for z in both)
    for amplitudes in both:
        begun = np.concatenate([amplitudes.real, (1j * speed * amplitudes).real])
        np.testing.assert_allclose(reached(speed, 1.03 * begun), amplitudes, rtol=1e-3)
    least = min(both, key=lambda z: abs(z[0]))
    np.testing.assert_allclose(reached(speed, np.zeros(4)), least, rtol=1e-3)


def test_words_name_number_and_speeds(leaning):
    states, _ = leaning
    (line,) = states.words()
    low, high = (f"{share * FREQUENCY * 60 / TURN:.0f}" for share in (1.05, 1.14))
    assert line.startswith(f"At 5 of 12 conditions (speeds {low} to {high} rpm) there are two stable steady states")


@pytest.mark.parametrize("rotation", ["x-to-y", "y-to-x"])
def test_internal_damping_beyond_its_threshold(rotation):
    """D += c_r (iω I + Ω J): whirl at ω_n grows where c_r (Ω - ω_n) > c ω_n."""
    turning = 2.0 * DAMPING
    threshold = FREQUENCY * (1 + DAMPING / turning)
    speeds = threshold * np.array([0.5, 0.95, 1.05, 1.5])
    states = steady_states(
        Jeffcott(MASS, STIFFNESS, RATIO, rotation=rotation) + effects.InternalDamping(turning),
        Conditions.at(speeds, unbalance=[1e-5, 0.0]),
    )
    stiffness = [STIFFNESS * np.eye(2) + turning * speed * WHIRL for speed in speeds]
    expected = [
        growth(MASS * np.eye(2), (DAMPING + turning) * np.eye(2), k, speed)
        for k, speed in zip(stiffness, speeds, strict=True)
    ]
    np.testing.assert_allclose(states.multiplier, expected, rtol=1e-9)
    assert states.result.tolist() == [BALANCED, BALANCED, UNSTABLE, UNSTABLE]
    assert states.others == ((), (), (), ())
    rpm = [f"{speed * 60 / TURN:.0f}" for speed in speeds[2:]]
    assert states.words() == [
        f"At 2 of 4 conditions (speeds {rpm[0]} and {rpm[1]} rpm) the steady state is unstable: the machine does not "
        "stay there."
    ]


def test_asymmetric_shaft_between_its_critical_speeds():
    """In the turning frame the matrices are constant: M (q̈ + 2Ω G q̇ - Ω² q) + c (q̇ + Ω G q) + K q, G a quarter turn.
    Slow roll is subtracted.
    """
    difference, ratio, gyre = 4e3, 0.002, -WHIRL
    damping = 2 * ratio * np.sqrt(STIFFNESS * MASS)
    critical = np.sqrt((STIFFNESS + difference * np.array([-1.0, 1.0])) / MASS)
    speeds = np.array([0.9 * critical[0], np.mean(critical), 1.1 * critical[1]])
    effect = effects.AsymmetricShaft(difference * np.cos(0.7), difference * np.sin(0.7))
    conditions = Conditions.at(speeds, unbalance=[1e-5, 0.0], bow=[0.0, 1e-5])
    model = Model(Jeffcott(MASS, STIFFNESS, ratio), slow_roll=20.0) + effect
    states = steady_states(model, conditions)
    np.testing.assert_allclose(states.vectors, np.asarray(response(model, conditions)), rtol=1e-9)
    stiffness = np.diag(STIFFNESS + difference * np.array([1.0, -1.0]))
    expected = [
        growth(
            MASS * np.eye(2),
            damping * np.eye(2) + 2 * MASS * w * gyre,
            stiffness - MASS * w**2 * np.eye(2) + damping * w * gyre,
            w,
        )
        for w in speeds
    ]
    np.testing.assert_allclose(states.multiplier, expected, rtol=1e-4)
    assert states.result.tolist() == [BALANCED, UNSTABLE, BALANCED]
    assert states.others == ((), (), ())


@pytest.mark.campaign
def test_half_order_motion_beside_an_unstable_one():
    """A loose support reached for part of the turn: at 491 rad/s motion that repeats every turn is unstable, and one at
    1/2X is stable.
    """
    gap, contact, unbalance = 1.96e-4, 1e5, 2e-5
    speeds = 300.0 + 350.0 / 11 * np.array([0, 6])
    rotor = Jeffcott(MASS, STIFFNESS, RATIO, gravity=DOWN)
    model = Model(rotor, layout=Layout(orders=(0.0, 0.5, 1.0, 2.0))) + effects.Clearance(contact, 1 / gap)
    states = steady_states(model, Conditions.at(speeds, unbalance=[unbalance, 0.0]))
    assert states.result.tolist() == [BALANCED, UNSTABLE]
    other = states.others[1][0]
    assert other.stable
    assert not states.others[1][-1].stable
    force = clearance(contact, gap)
    in_time = NonlinearRotor(
        MASS,
        (STIFFNESS, STIFFNESS),
        (DAMPING, DAMPING),
        gravity=DOWN,
        unbalance=unbalance,
        forces=(force,),
        transient=300,
    )
    orbit = in_time.orbit(speeds[1], 2, np.array([1e-4, -2e-4, 0.0, 0.0]))
    expected = [
        (2 - (n == 0)) * np.mean(orbit.position * np.exp(-1j * n * speeds[1] * orbit.times)[:, None], axis=0)
        for n in (0.0, 0.5, 1.0, 2.0)
    ]
    expected = np.stack(expected, axis=1)
    assert abs(expected[1, 1]) > 1e-5
    # Half of the order may begin in either of two turns.
    turned = [other.vectors * np.array([1.0, sign, 1.0, 1.0]) for sign in (1.0, -1.0)]
    assert min(np.max(np.abs(vectors - expected)) for vectors in turned) < 3e-3 * np.max(np.abs(expected[:, 1:]))
    np.testing.assert_allclose(other.multiplier, orbit.multiplier, rtol=3e-3)
    assert any("a stable one exists" in line for line in states.words())


def test_two_motions_at_half_the_order_and_both_are_found():
    """At 540 rad/s motion that repeats every turn is unstable, and where the rotor begins decides between two that take
    two turns.
    """
    mass, stiffness, ratio, speed = 0.9686, (56538.0, 51282.0), (0.01, 0.05 / 3), 540.0
    contact, gap, unbalance, orders = 5.4e4, 1.9e-4, 2e-5, (0.0, 0.5, 1.0, 2.0)
    model = Model(
        Jeffcott(mass, list(stiffness), list(ratio), gravity=DOWN), layout=Layout(orders=orders)
    ) + effects.Clearance(contact, 1 / gap)
    states = steady_states(model, Conditions.at([speed], unbalance=[unbalance, 0.0]))
    assert states.result.tolist() == [UNSTABLE]
    found = [np.abs(other.vectors[:, 1]) for other in states.others[0] if other.stable]
    damping = tuple(2 * r * np.sqrt(k * mass) for r, k in zip(ratio, stiffness, strict=True))
    in_time = NonlinearRotor(
        mass, stiffness, damping, gravity=DOWN, unbalance=unbalance, forces=(clearance(contact, gap),), transient=400
    )
    reached = []
    for begun in ([0.0, -2e-4, 0.0, 0.0], [-3e-4, -3e-4, 0.0, 0.1]):
        orbit = in_time.orbit(speed, 2, np.array(begun))
        expected = np.abs(2 * np.mean(orbit.position * np.exp(-0.5j * speed * orbit.times)[:, None], axis=0))
        apart = [np.max(np.abs(half - expected)) for half in found]
        assert min(apart) < 3e-3 * np.max(expected)
        reached.append(int(np.argmin(apart)))
    assert sorted(reached) == [0, 1]
    assert len(found) == 2


HARD_STOPS = {
    "three times as stiff": (
        Jeffcott(3.6476, [222320.0, 213490.0], 0.03677),
        (653720.0, 4.3423e-6, 0.1),
        4.7652e-5,
        132.855,
    ),
    "ten times as stiff": (
        Jeffcott(5.3113, [213310.0, 211721.0], 0.03626, gravity=DOWN),
        (2125155.0, 2.23344e-4, 0.25),
        2.71915e-4,
        148.642,
    ),
}
"""Rotor, stop (stiffness, gap, friction), unbalance and speed."""


@pytest.mark.parametrize(("rotor", "stop", "unbalance", "speed"), HARD_STOPS.values(), ids=HARD_STOPS)
def test_what_a_rubbing_rotor_comes_to_is_found_beside_an_unstable_motion(rotor, stop, unbalance, speed):
    """From rest, and its stability is judged with the corners where contact begins and ends; along 7 orders the
    multiplier of the first is 1.15.
    """
    stiffness, gap, friction = stop
    model = Model(rotor, layout=Layout(orders=(0.0, 1.0, 2.0))) + effects.Rub(stiffness, 1.0 / gap, friction)
    states = steady_states(model, Conditions.at([speed], unbalance=[unbalance, 0.0]))
    stiff, drag, weight = ((float(a), float(b)) for a, b in (rotor.stiffness, rotor.damping, rotor.gravity))
    there = NonlinearRotor(
        float(rotor.mass), stiff, drag, gravity=weight, unbalance=unbalance, forces=(rub(*stop, 1),), transient=150
    ).orbit(speed)
    waves = np.exp(-1j * speed * there.times * np.arange(3)[:, None]) * np.array([[1.0], [2.0], [2.0]])
    expected = there.position.T @ waves.T / len(there.times)
    assert states.result[0] == UNSTABLE
    assert "but a stable one exists" in " ".join(states.words())
    found = min(
        (other for other in states.others[0] if other.stable),
        key=lambda other: np.max(np.abs(other.vectors - expected)),
    )
    assert np.max(np.abs(found.vectors - expected)) < 1e-3 * np.max(np.abs(expected[:, 1:]))
    assert found.multiplier == pytest.approx(there.multiplier, abs=0.01)


def test_healthy_rotors_give_no_words():
    """A linear one alone, and the same with a probe that saturates, which does not change its motion."""
    rotor = Jeffcott(MASS, [STIFFNESS, 1.2 * STIFFNESS], [RATIO, 0.0], gravity=DOWN)
    conditions = Conditions.at([150.0, 230.0, 400.0], unbalance=[1e-5, 2e-6], bow=[1e-6, 0.0])
    for model in (rotor, Model(rotor) + effects.ProbeSaturation(1 / 5e-4)):
        states = steady_states(model, conditions)
        np.testing.assert_allclose(states.vectors, np.asarray(response(model, conditions)), rtol=1e-9)
        np.testing.assert_allclose(states.multiplier, 1.0, rtol=1e-12)
        assert np.all(states.result == BALANCED)
        assert states.others == ((), (), ())
        assert states.words() == []


def test_no_steady_state_at_an_undamped_critical_speed():
    states = steady_states(Jeffcott(1.0, 1e4, 0.0), Conditions.at([100.0], unbalance=[1e-5, 0.0]))
    assert np.isnan(states.multiplier[0])
    assert states.words() == ["At 955 rpm no steady state was found."]


def test_foundation_has_motion_of_its_own():
    """Four degrees of freedom, by hand; with cross-coupling on the disk, turned axes and slow roll subtracted."""
    stiffness, compliance, frequency, damping, cross, angle = np.array([5e4, 6e4]), 1 / 2e5, -0.4, 0.3, 8000.0, 0.3
    rotor = Jeffcott(MASS, stiffness, RATIO)
    added = [
        effects.Foundation(compliance, frequency, damping),
        effects.CrossCoupling(cross),
        effects.StiffnessAxes(angle),
    ]
    model, speeds = Model(rotor, slow_roll=20.0).plus(added), np.array([90.0, 200.0, 400.0])
    conditions = Conditions.at(speeds, unbalance=[1e-5, 0.0], bow=[1e-5, 0.0])
    own = np.sqrt(np.mean(stiffness) / MASS) * np.exp(frequency)
    spring, ratio = 1 / compliance, 0.05 * np.exp(damping)
    turn, one = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]), np.eye(2)
    shaft = turn @ np.diag(stiffness) @ turn.T
    drag = [*(2 * RATIO * np.sqrt(stiffness * MASS)), *2 * [2 * ratio * spring / own]]
    stiff = np.block([[shaft + cross * WHIRL, -shaft], [-shaft, shaft + spring * one]])
    expected = [growth(np.diag([MASS, MASS, *2 * [spring / own**2]]), np.diag(drag), stiff, speed) for speed in speeds]
    states = steady_states(model, conditions)
    np.testing.assert_allclose(states.vectors, np.asarray(response(model, conditions)), rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(states.multiplier, expected, rtol=1e-9)
    assert np.max(expected) > 1.01
    assert states.others == ((), (), ())


class _Soft(SupportEffect):
    """Compliance a (1 + iωτ)^(-1/2) in series: without τ a spring, else nothing that has an equation of motion of
    finite size.
    """

    name: ClassVar[str] = "soft"
    family: ClassVar[Family] = "structure"
    meaning: ClassVar[str] = "series compliance"
    source: ClassVar[str] = "none"
    compliance_m_per_n: Array = parameter("compliance a", scale=0.1, of="compliance")
    delay_s: Array = parameter("time τ", scale=0.1, of="period")

    def support(self, point: OperatingPoint) -> Support:
        return Support(
            compliance=self.compliance_m_per_n / jnp.sqrt(1.0 + 1j * point.frequency * self.delay_s) * jnp.ones(2)
        )


def test_compliance_of_other_kinds():
    """A spring in series is part of the stiffness; of a compliance that no foundation has stability is not known, and
    that is said.
    """
    conditions = Conditions.at([100.0, 300.0], unbalance=[1e-5, 0.0])
    rotor = Jeffcott(MASS, STIFFNESS, RATIO)
    states = steady_states(rotor + _Soft(1 / STIFFNESS), conditions)
    expected = [
        growth(MASS * np.eye(2), DAMPING * np.eye(2), 0.5 * STIFFNESS * np.eye(2), speed) for speed in (100.0, 300.0)
    ]
    np.testing.assert_allclose(states.multiplier, expected, rtol=1e-9)
    states = steady_states(rotor + _Soft(1 / STIFFNESS, 0.01), conditions)
    assert np.all(np.isnan(states.multiplier))
    assert states.words()[0].startswith(
        "At 2 of 2 conditions (speeds 955 and 2865 rpm) whether the steady state is stable is not known"
    )
