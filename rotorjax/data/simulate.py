"""Measurements made from a model: the plan of what would be measured, its vectors, and noise on them."""

import dataclasses

import jax
import numpy as np

from rotorjax.data.measurement import Measurement, Row, arrange
from rotorjax.data.pairing import require_steady
from rotorjax.data.rig import Rig
from rotorjax.data.table import HIGHEST_ORDER, LARGEST
from rotorjax.errors import InputError
from rotorjax.model.model import Model
from rotorjax.physics.response import response
from rotorjax.units import MICROMETRE

MOST_SPEEDS = 100_000
"""Speeds of a simulated table."""


def plan_like(measurement: Measurement) -> Measurement:
    """The runs, speeds, probes and orders of a measurement, without its vectors and noise."""
    return dataclasses.replace(measurement, vectors=np.zeros_like(measurement.vectors), sigma=None, noise="unknown")


def plan_speeds(rig: Rig, speeds: str, orders: str) -> Measurement:
    """Every run of a rig file at the speeds ``LOW:HIGH:COUNT`` [rpm] and the orders ``1,2``.

    **Errors.** `InputError` if either cannot be read, or the rig file has no runs.
    """
    try:
        low, high, count = (kind(part) for kind, part in zip((float, float, int), speeds.split(":"), strict=True))
        if not (0.0 < low < LARGEST and 0.0 < high < LARGEST and count > 0):
            raise ValueError(speeds)
    except ValueError as error:
        raise InputError(f"--speeds {speeds}: write LOW:HIGH:COUNT in rpm, like 600:3500:15") from error
    if count > MOST_SPEEDS:
        raise InputError(f"--speeds {speeds}: {count} speeds are too many; give at most {MOST_SPEEDS}")
    grid = np.linspace(low, high, int(count))
    numbers = orders_of(orders)
    if not rig.runs:
        raise InputError(f"{rig.path}: no runs to simulate; add [runs.baseline] with what is installed in it")
    probes = rig.model.layout.probes
    rows = [
        Row(run, float(speed), probe, order, 0.0, 0.0)
        for run in rig.runs
        for speed in grid
        for probe in probes
        for order in numbers
    ]
    return arrange(rows, runs=rig.runs, probes=probes, knowledge=rig.knowledge)


def orders_of(orders: str) -> tuple[float, ...]:
    """Orders from ``1,2`` as the command line gives them.

    **Errors.** `InputError` if they cannot be read.
    """
    try:
        numbers = [float(order) for order in orders.split(",")]
        if not all(np.isfinite(numbers)) or min(numbers) < 0.0:
            raise ValueError(orders)
    except ValueError as error:
        raise InputError(f"--orders {orders}: write numbers separated by commas, like 1,2") from error
    if max(numbers) > HIGHEST_ORDER:
        raise InputError(f"--orders {orders}: no order is above {HIGHEST_ORDER:g}; give multiples of the speed")
    return tuple(numbers)


def noisy(model: Model, plan: Measurement, *, noise_um: float, seed: int) -> Measurement:
    """What a model would show under a plan, with Gaussian noise on real and on imaginary parts.

    **Arguments:** ``noise_um`` standard deviation of each part [µm]; ``seed`` of JAX's random key. **Returns** the
    plan with vectors; its sigma is the noise, or absent where there is none.
    """
    vectors = np.asarray(response(model.with_orders(plan.orders), plan.conditions))
    require_steady(vectors, plan)
    parts = np.asarray(jax.random.normal(jax.random.key(seed), (*vectors.shape, 2)))
    noise = MICROMETRE * noise_um * (parts[..., 0] + 1j * parts[..., 1])
    noise[:, :, np.array(plan.orders) == 0.0] = noise[:, :, np.array(plan.orders) == 0.0].real
    sigma = np.full(vectors.shape, MICROMETRE * noise_um) if noise_um > 0.0 else None
    return dataclasses.replace(
        plan,
        vectors=np.where(plan.present, vectors + noise, 0.0),
        sigma=sigma,
        noise="given" if noise_um > 0.0 else "unknown",
    )
