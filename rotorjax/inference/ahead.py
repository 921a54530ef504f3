"""Programs that an explanation comes to need, made in the background from the first moment on.

Tracing keeps the interpreter and one processor busy, compilation one processor; the search needs the linear kernel
first.
"""

from rotorjax.data.measurement import Measurement
from rotorjax.inference.force_balance import ForceBalance
from rotorjax.inference.kernels import kernels_of
from rotorjax.inference.linear_rotor import LinearRotor
from rotorjax.inference.programs import in_background
from rotorjax.inference.space import Space
from rotorjax.inference.whirl_modes import RotorInTime
from rotorjax.model.model import Model


def make_programs_ahead(space: Space, measurement: Measurement) -> None:
    """In the order in which they are needed, unless this process made an explanation like this before; nothing waits
    for them here.
    """
    kernels, model = kernels_of(space), space.model
    if kernels.warm:
        return
    first, *others = kernels.makers(measurement.conditions)
    for maker in (first, RotorInTime(model).make, *others):
        in_background(maker)
    in_background(lambda: LinearRotor(model).make(measurement.conditions))


def make_programs_of_a_missing_force_ahead(model: Model, measurement: Measurement) -> None:
    """Those of the balance of forces, and those that fit its terms."""
    in_background(lambda: ForceBalance(model).make(measurement.conditions))
