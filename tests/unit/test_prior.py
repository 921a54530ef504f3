"""The prior of forces whose size is left open: a density, without a preferred direction."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import dblquad, quad
from scipy.stats import multivariate_normal

from rotorjax import Jeffcott, Model, effects
from rotorjax.discovery.prior import prior_at
from rotorjax.measurement import Knowledge
from rotorjax.space import make_space

NORMAL_PEAK = 0.3989422804014327


def density(*unknowns: float) -> float:
    count = len(unknowns)
    cost = float(prior_at(jnp.asarray(unknowns), jnp.ones((count, count))).cost)
    return NORMAL_PEAK**count * np.exp(-cost)


def test_density_integrates_to_one():
    assert 2.0 * quad(density, 0.0, np.inf, limit=200)[0] == pytest.approx(1.0, abs=1e-3)

    def in_polar(angle: float, radius: float) -> float:
        return radius * density(radius * np.cos(angle), radius * np.sin(angle))

    assert dblquad(in_polar, 0.0, 100.0, 0.0, 2.0 * np.pi, epsabs=1e-4)[0] == pytest.approx(1.0, abs=0.005)


def test_size_costs_its_logarithm():
    costs = [float(prior_at(jnp.asarray([size]), jnp.ones((1, 1))).cost) for size in (1.0, 3.0, 30.0)]
    np.testing.assert_allclose(costs, [0.5, 4.5, 4.5 + 9.0 * np.log(10.0)])


def test_others_stay_normal():
    unknowns = jnp.asarray([0.3, -2.0, 40.0])
    alike = jnp.zeros((3, 3)).at[2, 2].set(1.0)
    both = prior_at(unknowns, alike)
    alone = prior_at(unknowns[2:], jnp.ones((1, 1)))
    peak = multivariate_normal.logpdf(np.zeros(2), np.zeros(2))
    assert float(both.cost - alone.cost) == pytest.approx(peak - multivariate_normal.logpdf(np.asarray(unknowns[:2]), np.zeros(2)))
    np.testing.assert_allclose(both.weight[:2], 1.0)


@pytest.mark.parametrize("size", [0.0, 0.5, 30.0, 1e4])
def test_weight_is_gradient_and_bounds_curvature(size: float):
    unknowns, alike = jnp.asarray([0.6, 0.8]) * size, jnp.ones((2, 2))
    weight = prior_at(unknowns, alike).weight
    np.testing.assert_allclose(jax.grad(lambda u: prior_at(u, alike).cost)(unknowns), weight * unknowns, atol=1e-12)
    curvature = jax.hessian(lambda u: prior_at(u, alike).cost)(unknowns)
    assert float(np.linalg.eigvalsh(np.diag(np.asarray(weight)) - np.asarray(curvature)).min()) > -1e-12
    assert float(prior_at(jnp.asarray([0.0, 1.0]) * size, alike).cost) == pytest.approx(float(prior_at(unknowns, alike).cost))


def test_size_is_left_open_unless_the_user_tells_it():
    model = Model(Jeffcott(mass=1.0, stiffness=1e5, damping_ratio=0.02)) + effects.Duffing() + effects.Crack() + effects.ResidualBow()
    own = make_space(model, Knowledge())
    forces = {e.effect: int(own.force[e.unknown]) for e in own.entries}
    assert forces["residual_bow"] == -1
    assert len({forces["duffing"], forces["crack"], -1}) == 3
    told = make_space(model, Knowledge(priors={"duffing": {"cubic_n_per_m3": 1e12}}))
    assert {e.effect for e in told.entries if int(told.force[e.unknown]) >= 0} == {"crack"}
