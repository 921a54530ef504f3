"""Levenberg-Marquardt against SciPy, units, the guard of double precision."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import least_squares

from rotorjax._core import CONVERGED, MAX_STEPS, NOT_FINITE, Quadratic, Tolerance, levenberg_marquardt, require_float64, unit_of


def quadratic_of(residual):
    def evaluate(p, _):
        r, j = residual(p), jax.jacfwd(residual)(p)
        return Quadratic(0.5 * r @ r, j.T @ r, j.T @ j + 1e-12 * jnp.eye(len(p)))

    return evaluate


def rosenbrock(p):
    return jnp.stack([10.0 * (p[1] - p[0] ** 2), 1.0 - p[0]])


def decay(p):
    t = jnp.linspace(0.0, 4.0, 20)
    return p[0] * jnp.exp(-p[1] * t) + p[2] - (2.0 * jnp.exp(-0.7 * t) + 0.3 + 0.01 * jnp.sin(9.0 * t))


@pytest.mark.parametrize(("residual", "start"), [(rosenbrock, [-1.2, 1.0]), (decay, [1.0, 0.1, 0.0])])
def test_minimum_is_that_of_scipy(residual, start):
    found = levenberg_marquardt(quadratic_of(residual), jnp.array(start), tolerance=Tolerance(1e-12, 1e-12))
    peer = least_squares(lambda p: np.asarray(residual(jnp.asarray(p))), start, xtol=1e-12, ftol=1e-12, gtol=1e-12)
    assert int(found.result) == CONVERGED
    assert int(found.steps) < 60
    np.testing.assert_allclose(found.point, peer.x, rtol=1e-5)


def test_linear_problem_takes_few_evaluations():
    matrix = jnp.array([[1.0, 2.0], [3.0, -1.0], [0.5, 1.0]])
    found = levenberg_marquardt(quadratic_of(lambda p: matrix @ p - jnp.array([1.0, 2.0, 3.0])), jnp.zeros(2))
    assert int(found.steps) <= 6
    np.testing.assert_allclose(found.point, np.linalg.lstsq(np.asarray(matrix), [1.0, 2.0, 3.0], rcond=None)[0], rtol=1e-4)


def test_result_codes():
    assert int(levenberg_marquardt(quadratic_of(rosenbrock), jnp.array([-1.2, 1.0]), max_steps=3).result) == MAX_STEPS
    assert int(levenberg_marquardt(quadratic_of(lambda p: p / 0.0), jnp.ones(2)).result) == NOT_FINITE


@pytest.mark.parametrize(
    ("name", "si", "shown", "factor"),
    [("unbalance_x_kg_m", "kg m", "g mm", 1e-6), ("angle_rad", "rad", "deg", np.pi / 180), ("cubic_n_per_m3", "N/m³", "N/m³", 1.0), ("error_x", "1", "1", 1.0)],
)
def test_units(name, si, shown, factor):
    assert unit_of(name) == (si, shown, pytest.approx(factor))


def test_single_precision_is_refused():
    jax.config.update("jax_enable_x64", False)
    try:
        with pytest.raises(ValueError, match=r'jax.config.update\("jax_enable_x64", True\)'):
            require_float64("fit")
    finally:
        jax.config.update("jax_enable_x64", True)
