"""Orders of a measurement that a model excites."""

import dataclasses

import jax.numpy as jnp
import numpy as np

from rotorjax.data.measurement import Measurement
from rotorjax.model.model import Model
from rotorjax.physics.response import response
from rotorjax.physics.steady_state import is_coupled


def undriven_orders(model: Model, measurement: Measurement) -> tuple[float, ...]:
    """Measured orders at which the model shows nothing, whatever the values of its effects; none if that is all of
    them.

    A nonlinear force may drive any order, a stop for instance once the rotor reaches it.
    """
    full = model.with_orders(measurement.orders)
    if is_coupled(full):
        return ()
    stirred = full.plus([e.replaced([jnp.full_like(v, 1e-3) for v in e.values()]) for e in full.effects])
    size = np.max(np.abs(np.asarray(response(stirred, measurement.conditions))), axis=(0, 1))
    silent = tuple(order for order, largest in zip(measurement.orders, size, strict=True) if largest == 0.0)
    return silent if len(silent) < len(measurement.orders) else ()


def without_orders(measurement: Measurement, orders: tuple[float, ...]) -> Measurement:
    """The measurement without the vectors of some orders."""
    if not orders:
        return measurement
    kept = [k for k, order in enumerate(measurement.orders) if order not in orders]
    return dataclasses.replace(
        measurement,
        orders=tuple(measurement.orders[k] for k in kept),
        vectors=measurement.vectors[:, :, kept],
        present=measurement.present[:, :, kept],
        sigma=None if measurement.sigma is None else measurement.sigma[:, :, kept],
    )
