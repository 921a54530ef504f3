"""Linear algebra of curvatures whose directions are told to very different degrees."""

import numpy as np
import pytest

from rotorjax.inference.curvature import inverse, log_determinant, solved


def test_as_the_matrix_says(rng):
    root = rng.standard_normal((3, 5, 5))
    curvature = root @ np.swapaxes(root, 1, 2) + np.eye(5)
    right = rng.standard_normal((5, 2))
    np.testing.assert_allclose(solved(curvature, right), np.linalg.solve(curvature, right), rtol=1e-8)
    np.testing.assert_allclose(log_determinant(curvature), np.linalg.slogdet(curvature)[1], rtol=1e-9)
    np.testing.assert_allclose(inverse(curvature[0]) @ curvature[0], np.eye(5), atol=1e-8)


def test_what_rounding_has_taken_makes_nothing_singular():
    """Data that tell the sum of two unknowns to 1e-12 of the prior's width, and nothing of their difference."""
    curvature = 1e24 * np.ones((2, 2)) + np.eye(2)
    with pytest.raises(np.linalg.LinAlgError):
        np.linalg.inv(curvature)
    assert np.all(np.isfinite(inverse(curvature)))
    assert np.isfinite(log_determinant(curvature))
    np.testing.assert_allclose(curvature @ solved(curvature, np.full((2, 1), 2e24)), 2e24, rtol=1e-9)
