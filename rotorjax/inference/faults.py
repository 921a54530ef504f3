"""Unbalance and bow as one fault (U_x, U_y, s_x, s_y) on the disk: what was installed, and what the rotor answers to
it.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Complex, Float

from rotorjax.arrays import as_array
from rotorjax.data.measurement import Measurement
from rotorjax.effects import PlaneParticipation
from rotorjax.inference.linear_rotor import LinearRotor
from rotorjax.model.conditions import Conditions
from rotorjax.model.model import Model
from rotorjax.physics.response import response
from rotorjax.physics.steady_state import is_coupled


def fault_sensitivity(model: Model, conditions: Conditions) -> Float[np.ndarray, "case probe order 2 4"]:
    """Derivative of real and imaginary parts by (U_x, U_y, s_x, s_y) on the disk [m per kg m, m per m], of the model
    without nonlinear forces.
    """
    return LinearRotor(model).sensitivity(conditions)


def response_to(
    model: Model, conditions: Conditions, faults: Float[np.ndarray, "case 4"]
) -> Complex[np.ndarray, "case probe order"]:
    """The response with these faults (U_x, U_y, s_x, s_y) on the disk instead of what is installed."""
    spread = np.zeros(conditions.unbalance.shape)
    spread[:, 0] = faults[:, :2]
    on_disk = eqx.tree_at(lambda m: m.participation, model, jnp.ones_like(model.participation))
    there = Conditions(conditions.speed, as_array(spread), as_array(faults[:, 2:]), conditions.sweep)
    return np.asarray(response(on_disk, there)) if is_coupled(model) else LinearRotor(on_disk).vectors(there)


def installed_faults(model: Model, measurement: Measurement) -> Float[np.ndarray, "run 4"]:
    """What was installed in each run as one fault (U_x, U_y, s_x, s_y) on the disk, the planes'
    participation counted.
    """
    participation = acting_participation(model)
    first = [int(np.argmax(measurement.run == run)) for run in range(len(measurement.runs))]
    unbalance = np.asarray(measurement.conditions.unbalance)[first]
    return np.concatenate(
        [np.sum(unbalance * participation[:, None], axis=1), np.asarray(measurement.conditions.bow)[first]], axis=1
    )


def acting_participation(model: Model) -> Float[np.ndarray, "plane"]:
    """By how much of an unbalance in each plane the disk is driven: what is stated, with the error that the model has
    of it.
    """
    participation = np.asarray(model.participation).copy()
    if (error := model.find(PlaneParticipation.name)) is not None:
        participation[1:] *= 1.0 + np.asarray(error.values()[0])
    return participation


def polar_covariance(pair: Float[np.ndarray, "dof"], relative: float, angle: float) -> Float[np.ndarray, "dof dof"]:
    """Covariance of a vector known to a relative error along and an angle [rad] across."""
    across = np.array([-pair[1], pair[0]])
    return relative**2 * np.outer(pair, pair) + angle**2 * np.outer(across, across)
