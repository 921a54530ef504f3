"""Programs that an explanation comes to need, made in the background from the first moment on.

Tracing keeps the interpreter and one processor busy, compilation one processor; the search needs the linear kernel
first.
"""

import functools

from rotorjax.data.measurement import Measurement
from rotorjax.effects.of_one_run import RUN_EFFECTS
from rotorjax.inference.force_balance import ForceBalance
from rotorjax.inference.kernels import kernels_of
from rotorjax.inference.linear_rotor import LinearRotor
from rotorjax.inference.programs import in_background
from rotorjax.inference.space import Space
from rotorjax.inference.whirl_modes import RotorInTime


def make_programs_ahead(space: Space, measurement: Measurement) -> None:
    """In the order in which they are needed, unless this process made an explanation like this before; nothing waits
    for them here.
    """
    kernels, model = kernels_of(space), space.model.without(*RUN_EFFECTS)
    if kernels.warm:
        return
    conditions = measurement.conditions
    first, *others = kernels.linear_makers(conditions)
    for maker in (first, RotorInTime(model).make, *others, *kernels.balanced_makers(conditions)):
        in_background(maker)
    # Nearly every answer is held against forces outside the catalogue.
    for late in (LinearRotor(model), ForceBalance(model)):
        in_background(functools.partial(late.make, conditions))
