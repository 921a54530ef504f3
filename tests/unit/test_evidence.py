"""The evidence, whatever the strength of an effect: against quadrature where the data are linear in the parameters."""

import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import multivariate_normal, norm

from rotorjax import Jeffcott, Layout, Model, effects
from rotorjax.data.knowledge import Knowledge
from rotorjax.effects import CATALOG
from rotorjax.inference.descent import End, Local
from rotorjax.inference.evidence import ACROSS, STEP, factors, log_evidence
from rotorjax.inference.prior import prior_at
from rotorjax.inference.space import Space, make_space


def fitted(space: Space, free: np.ndarray, curvature: np.ndarray, at: np.ndarray) -> End:
    """The end of a fit to data whose log likelihood is quadratic about a point."""
    whole = curvature + np.eye(len(free))
    found = np.linalg.solve(whole, curvature @ at)
    prior = prior_at(found, np.zeros((len(free), len(free))))
    cost = 0.5 * float((found - at) @ curvature @ (found - at)) + prior.cost
    point = np.zeros(len(space.entries))
    point[free] = found
    none = Local(np.zeros((1, 0)), np.zeros((1, 0, len(free))))
    return End(point, cost, free, whole, prior, none, np.zeros((1, 1, 1), complex), None, 1, 0, True)


@pytest.fixture
def space() -> Space:
    model = Model(Jeffcott(mass=1.0, stiffness=1e5, damping_ratio=0.02))
    return make_space(model + effects.MassError() + effects.StiffnessError() + effects.Rub(), Knowledge())


def unknowns(space: Space, *effects_named: str) -> np.ndarray:
    return np.array([e.unknown for e in space.entries if e.effect in effects_named])


@pytest.mark.parametrize(("curvature", "at"), [(1e4, 0.3), (1e6, 0.004), (50.0, 0.0), (0.0, 0.0), (400.0, 4.0)])
def test_it_is_the_mean_over_prior_scales(space, curvature: float, at: float):
    free = unknowns(space, "mass_error")
    end = fitted(space, free, np.array([[curvature]]), np.array([at]))
    scales = factors(np.array([[curvature]]), np.ones(1), np.array([0]), 0)

    def averaged(unknown: float) -> float:
        prior = np.mean([norm.pdf(unknown, scale=scale) for scale in scales])
        return float(prior) * math.exp(-0.5 * curvature * (unknown - at) ** 2)

    width = 12.0 / math.sqrt(curvature) if curvature else 60.0
    exact = quad(averaged, at - width, at + width, limit=500, points=[at])[0]
    assert log_evidence(end, space, lambda cost: -cost) == pytest.approx(math.log(exact), abs=1e-6)


def test_scales_reach_from_what_can_be_seen_to_the_declared():
    def powers(curvature: float) -> list[int]:
        found = factors(np.array([[curvature]]), np.ones(1), np.array([0]), 0)
        return np.round(np.log(found) / math.log(STEP)).astype(int).tolist()

    assert powers(0.0) == [0]
    assert powers(25.0) == [0]
    assert powers(25.0 * 81.0) == [-2, -1, 0]


def test_a_declared_scale_too_large_by_far_does_not_decide(space):
    """Two effects that fit as well with as many parameters, seen as clearly, one of them a thirtieth of its prior
    scale.
    """
    free = unknowns(space, "mass_error")
    usual, small = (
        fitted(space, free, np.array([[(20.0 / size) ** 2]]), np.array([size])) for size in (0.7, 0.7 / 30.0)
    )
    gap = log_evidence(usual, space, lambda cost: -cost) - log_evidence(small, space, lambda cost: -cost)
    assert abs(gap) < 1.0
    assert math.log(30.0) - 0.5 < 0.5 * float(
        np.linalg.slogdet(small.curvature)[1] - np.linalg.slogdet(usual.curvature)[1]
    )


@pytest.mark.parametrize("at", [(0.4, 0.4), (0.4, -0.2), (0.4, 0.41), (0.0, 0.3)])
def test_errors_along_x_and_y_are_often_the_same_or_along_one_of_them(at: tuple[float, float]):
    """With a scale that the user told, of data that are linear in the parameters: a sum of normal distributions."""
    model = Model(Jeffcott(mass=1.0, stiffness=1e5, damping_ratio=0.02)) + effects.StiffnessError()
    space = make_space(model, Knowledge(priors={"stiffness_error": {"error_x": 0.02, "error_y": 0.02}}))
    free, data = unknowns(space, "stiffness_error"), np.array([[3e5, 1e5], [1e5, 2e5]])
    end = fitted(space, free, data, np.array(at))
    same, little = np.full((2, 2), 0.5), ACROSS**2
    priors = [np.eye(2), 2.0 * same + little * (np.eye(2) - same), np.diag([1.0, little]), np.diag([little, 1.0])]
    each = [multivariate_normal.logpdf(at, cov=np.linalg.inv(data) + prior) for prior in priors]
    exact = np.logaddexp.reduce(each) - math.log(4.0) + math.log(2.0 * math.pi) - 0.5 * np.linalg.slogdet(data)[1]
    assert log_evidence(end, space, lambda cost: -cost) == pytest.approx(exact, abs=1e-6)


@pytest.mark.parametrize("spin", [1, -1])
def test_an_eccentric_probe_track_reads_as_a_forward_circle(spin: int):
    """One form of a runout: what a circle of the shaft's centre looks like, 1X and other orders."""
    layout = Layout(orders=(1.0, 2.0))
    rotor = Jeffcott(mass=1.0, stiffness=1e5, damping_ratio=0.02, rotation={1: "x-to-y", -1: "y-to-x"}[spin])
    model = Model(rotor, layout=layout)
    track, once, separate = effects.Runout.forms(layout, spin * np.asarray(model.probes.angle))
    assert [len(form) for form in (track, once, separate)] == [4, 2, 4]
    in_phase = once[0]
    x, y = (complex(in_phase[f"real_m.{p}.1X"], in_phase[f"imaginary_m.{p}.1X"]) for p in "XY")
    assert (x, y) == pytest.approx((1.0, -1j * spin))
    assert track[:2] == once


def test_all_forms_are_of_the_effects_parameters():
    layout = Layout(orders=(1.0, 2.0))
    for effect in CATALOG.values():
        labels = {label for p in effect.parameters() for label in p.labels(layout)}
        for form in effect.forms(layout, np.array([0.0, 0.5 * np.pi])):
            assert all(direction.keys() <= labels for direction in form), effect.name


def test_strengths_are_left_open_but_not_shapes_and_what_the_user_told(space):
    def left_open(space: Space) -> set[str]:
        return {e.key for e in space.entries if int(space.strength[e.unknown]) >= 0}

    assert left_open(space) == {
        "mass_error.error", "stiffness_error.error_x", "stiffness_error.error_y", "rub.stiffness_n_per_m"
    }  # fmt: skip
    numbers = {e.key: int(space.strength[e.unknown]) for e in space.entries}
    assert numbers["stiffness_error.error_x"] == numbers["stiffness_error.error_y"] != numbers["mass_error.error"]
    told = make_space(space.model, Knowledge(priors={"mass_error": {"error": 0.02}}))
    assert left_open(space) - left_open(told) == {"mass_error.error"}
