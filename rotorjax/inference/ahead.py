"""Programs that an explanation comes to need, made in the background from the first moment on.

Tracing keeps the interpreter and one processor busy, compilation one processor; the search needs the linear kernel
first.
"""

from rotorjax.data.measurement import Measurement
from rotorjax.effects import CATALOG
from rotorjax.effects.terms import TERMS
from rotorjax.inference.force_balance import ForceBalance
from rotorjax.inference.kernels import kernels_of
from rotorjax.inference.linear_rotor import LinearRotor
from rotorjax.inference.programs import in_background
from rotorjax.inference.space import Space, make_space
from rotorjax.inference.whirl_modes import RotorInTime
from rotorjax.model.model import Model


def make_programs_ahead(space: Space, measurement: Measurement, *, missing_force: bool) -> None:
    """In the order in which they are needed, unless this process made an explanation like this before; nothing waits
    for them here. **Arguments:** ``missing_force``: with that program, too.
    """
    kernels, model = kernels_of(space), space.model
    if kernels.warm:
        return
    first, *others = kernels.makers(measurement.conditions)
    for maker in (first, RotorInTime(model).make, *others):
        in_background(maker)
    in_background(lambda: LinearRotor(model).make(measurement.conditions))
    if missing_force:
        in_background(lambda: ForceBalance(model).make(measurement.conditions))


def make_programs_of_terms_ahead(model: Model, measurement: Measurement) -> None:
    """Those that fit simple terms of a missing force beside the catalogue."""
    full = model.with_orders(measurement.orders).in_company((CATALOG | TERMS).values())
    kernels = kernels_of(make_space(full, measurement.knowledge))
    if not kernels.warm:
        makers = kernels.makers(measurement.conditions, swept=False)
        # One after the other: each needs some 0.1 GB more while it is made than when it is.
        in_background(lambda: [make() for make in makers])
