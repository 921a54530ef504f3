"""Complex amplitudes of the orders and the real coefficients that a motion is balanced by, in NumPy."""

import itertools

import numpy as np
from jaxtyping import Complex, Float

from rotorjax.arrays import numpy_pair


def as_coefficients(amplitudes: Complex[np.ndarray, "*many order"]) -> Float[np.ndarray, "*many coefficient"]:
    """`rotorjax.physics.harmonic_balance.to_real` in NumPy."""
    pairs = numpy_pair(amplitudes[..., 1:])
    return np.concatenate(
        [np.real(amplitudes[..., :1]), pairs.reshape(*amplitudes.shape[:-1], 2 * pairs.shape[-2])], axis=-1
    )


def as_amplitudes(coefficients: Float[np.ndarray, "*many coefficient"]) -> Complex[np.ndarray, "*many order"]:
    """`rotorjax.physics.harmonic_balance.to_complex` in NumPy."""
    found = np.concatenate([coefficients[..., :1], coefficients[..., 1::2]], axis=-1).astype(complex)
    found[..., 1:] += 1j * coefficients[..., 2::2]
    return found


def answer(
    compliance: list[Complex[np.ndarray, "row order"]], force: Float[np.ndarray, "row dof coefficient"]
) -> Float[np.ndarray, "row dof coefficient"]:
    """`rotorjax.physics.steady_state.answer` in NumPy."""
    xx, xy, yx, yy = compliance
    x, y = np.moveaxis(as_amplitudes(force), 1, 0)
    return as_coefficients(np.stack([xx * x + xy * y, yx * x + yy * y], axis=1))


def add_dynamic(
    by_motion: Float[np.ndarray, "row dof coefficient dof coefficient"], dynamic: list[list[np.ndarray]]
) -> None:
    """Add a complex factor per order, row x order for each pair of directions, as it acts on coefficients; that of
    order 0 is real.
    """
    for (i, row), j in itertools.product(enumerate(dynamic), range(len(dynamic))):
        real, imaginary = np.real(row[j]), np.imag(row[j])
        block = by_motion[:, i, :, j]
        block[:, 0, 0] += real[:, 0]
        for order in range(1, real.shape[1]):
            re, im = 2 * order - 1, 2 * order
            block[:, re, re] += real[:, order]
            block[:, im, im] += real[:, order]
            block[:, re, im] -= imaginary[:, order]
            block[:, im, re] += imaginary[:, order]
