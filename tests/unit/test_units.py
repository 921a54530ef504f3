"""Units, and the guard of double precision."""

import jax
import numpy as np
import pytest

from rotorjax.arrays import require_float64
from rotorjax.units import unit_of


@pytest.mark.parametrize(
    ("name", "si", "shown", "factor"),
    [
        ("unbalance_x_kg_m", "kg m", "g mm", 1e-6),
        ("angle_rad", "rad", "deg", np.pi / 180),
        ("cubic_n_per_m3", "N/m³", "N/m³", 1.0),
        ("error_x", "1", "1", 1.0),
    ],
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
