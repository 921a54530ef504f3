"""Whether a model and a measurement can be held against one another."""

import numpy as np
from jaxtyping import Complex

from rotorjax.data.measurement import Measurement
from rotorjax.errors import InputError
from rotorjax.model.contract import AbstractRotor
from rotorjax.model.model import Model

MOST_NAMED = 5
"""Conditions named in one message."""


def paired(model: Model | AbstractRotor, measurement: Measurement) -> Model:
    """The model, or that of a rotor alone, if it is read by the probes of the measurement.

    **Errors.** ``TypeError`` for what is no model or no measurement; ``ValueError`` for other probes or planes.
    """
    full = model if isinstance(model, Model) else Model(model)
    if not isinstance(measurement, Measurement):
        raise TypeError(
            f'a {type(measurement).__name__} is no measurement: hand over read_measurement("measurement.csv", rig), '
            "after the model"
        )
    measurement.require_layout(full.layout)
    return full


def require_steady(predicted: Complex[np.ndarray, "case probe order"], measurement: Measurement) -> None:
    """Refuse a prediction that has no steady state somewhere.

    **Errors.** `InputError` with the conditions, where a vector that was measured is predicted as not a number.
    """
    lost = np.flatnonzero(~np.all(np.isfinite(predicted) | ~measurement.present, axis=(1, 2)))
    if len(lost):
        shown = ", ".join(
            f"{measurement.runs[measurement.run[k]]} at {measurement.speed_rpm[k]:.0f} rpm" for k in lost[:MOST_NAMED]
        )
        more = f" and {len(lost) - MOST_NAMED} more" if len(lost) > MOST_NAMED else ""
        raise InputError(
            f"the model has no steady state that could be found for {shown}{more}: weaken its forces that depend on "
            "motion, or leave those out"
        )
