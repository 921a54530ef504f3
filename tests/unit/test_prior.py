"""The prior of forces whose size is left open: a density, without a preferred direction."""

from typing import ClassVar

import numpy as np
import pytest
from jax import Array
from scipy.integrate import dblquad, quad
from scipy.stats import multivariate_normal

from rotorjax import Jeffcott, Model, effects
from rotorjax.data.knowledge import Knowledge
from rotorjax.inference.prior import prior_at
from rotorjax.inference.space import make_space
from rotorjax.model.parameters import parameter

NORMAL_PEAK = 0.3989422804014327


def density(*unknowns: float) -> float:
    count = len(unknowns)
    cost = float(prior_at(np.asarray(unknowns), np.ones((count, count))).cost)
    return NORMAL_PEAK**count * np.exp(-cost)


def test_density_integrates_to_one():
    assert 2.0 * quad(density, 0.0, np.inf, limit=200)[0] == pytest.approx(1.0, abs=1e-3)

    def in_polar(angle: float, radius: float) -> float:
        return radius * density(radius * np.cos(angle), radius * np.sin(angle))

    assert dblquad(in_polar, 0.0, 100.0, 0.0, 2.0 * np.pi, epsabs=1e-4)[0] == pytest.approx(1.0, abs=0.005)


def test_size_costs_its_logarithm():
    costs = [float(prior_at(np.asarray([size]), np.ones((1, 1))).cost) for size in (1.0, 3.0, 30.0)]
    np.testing.assert_allclose(costs, [0.5, 4.5, 4.5 + 9.0 * np.log(10.0)])


def test_others_stay_normal():
    unknowns = np.asarray([0.3, -2.0, 40.0])
    parts = np.diag([0.0, 0.0, 1.0])
    both = prior_at(unknowns, parts)
    alone = prior_at(unknowns[2:], np.ones((1, 1)))
    peak = multivariate_normal.logpdf(np.zeros(2), np.zeros(2))
    assert float(both.cost - alone.cost) == pytest.approx(
        peak - multivariate_normal.logpdf(np.asarray(unknowns[:2]), np.zeros(2))
    )
    np.testing.assert_allclose(both.weight[:2], 1.0)


@pytest.mark.parametrize("size", [0.0, 0.5, 30.0, 1e4])
def test_weight_is_gradient_and_bounds_curvature(size: float):
    unknowns, parts = np.asarray([0.6, 0.8]) * size, np.ones((2, 2))
    weight = prior_at(unknowns, parts).weight
    step = 1e-4 * max(size, 1.0)
    around = step * np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
    costs = np.array([prior_at(unknowns + move, parts).cost for move in around])
    slope = (costs[:2] - costs[2:]) / (2.0 * step)
    np.testing.assert_allclose(slope, weight * unknowns, rtol=1e-6, atol=1e-9)
    slopes = np.array([prior_at(unknowns + move, parts).weight * (unknowns + move) for move in around])
    curvature = (slopes[:2] - slopes[2:]) / (2.0 * step)
    assert float(np.linalg.eigvalsh(np.diag(weight) - curvature).min()) > -1e-9
    assert float(prior_at(np.asarray([0.0, 1.0]) * size, parts).cost) == pytest.approx(
        float(prior_at(unknowns, parts).cost)
    )


def test_sizes_are_left_open_unless_told():
    """Of nonlinear forces: their strength and their gap, not a coefficient of friction, and not what the
    user gave a scale.
    """
    model = (
        Model(Jeffcott(mass=1.0, stiffness=1e5, damping_ratio=0.02))
        + effects.Duffing()
        + effects.Crack()
        + effects.Rub()
        + effects.ResidualBow()
    )
    own = make_space(model, Knowledge())
    numbers = {e.key: int(own.open_size[e.unknown]) for e in own.entries}
    assert numbers["crack.loss_x_n_per_m"] == numbers["crack.loss_y_n_per_m"]
    sizes = [
        numbers[key]
        for key in ("duffing.cubic_n_per_m3", "crack.loss_x_n_per_m", "rub.stiffness_n_per_m", "rub.inverse_gap_per_m")
    ]
    assert sorted(sizes) == [0, 1, 2, 3]
    assert {key for key, number in numbers.items() if number < 0} == {
        "rub.friction",
        *(key for key in numbers if key.startswith("residual_bow")),
    }
    told = make_space(model, Knowledge(priors={"duffing": {"cubic_n_per_m3": 1e12}}))
    assert "duffing" not in {e.effect for e in told.entries if int(told.open_size[e.unknown]) >= 0}


def test_a_scale_given_by_the_user_holds_for_every_axis():
    class OwnRange(effects.ProbeSaturation):
        name: ClassVar[str] = "own_range"
        bend_per_m: Array = parameter("bend of each probe", scale=0.1, of="curvature", axes=("probe",))

    model = Model(Jeffcott(mass=1.0, stiffness=1e5, damping_ratio=0.02)) + OwnRange()
    assert np.all(np.asarray(make_space(model, Knowledge()).open_size) >= 0)
    told = make_space(model, Knowledge(priors={"own_range": {"bend_per_m": 100.0}}))
    assert {e.parameter for e in told.entries if int(told.open_size[e.unknown]) < 0} == {"bend_per_m"}
