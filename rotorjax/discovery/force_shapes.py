"""Shapes that a missing force may have: effects that are linear in a few factors, and a scan of what is not linear.

The size of a gap and the angle of a crack are tried one by one; what is left enters the balance of forces linearly.
"""

import math
from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np

from rotorjax.effects.terms import TERMS, AxisForce
from rotorjax.model.contract import (
    AbstractRotor,
    Effect,
    ExcitationEffect,
    MatrixEffect,
    ReadingEffect,
    RestoringEffect,
    SpeedEffect,
    SupportEffect,
)

GAPS = tuple(float(share) for share in np.linspace(0.2, 0.95, 12))
"""Gaps to try, in the largest displacement."""
GAP = "inverse_gap_per_m"
"""The parameter that is one over a gap."""
CRACK_ANGLES = 12
RUB_FRICTION = 0.2
STEP = 1e-2
"""In prior scales: size at which a force is taken that is, or nearly, linear in its parameters."""
BY_AXIS = ("stiffness_error", "damping_error", "speed_dependent_stiffness")
"""Effects whose axes are tried one by one."""
LOGARITHMIC = ("damping_error",)
"""Those of which a parameter is the logarithm of a factor."""
LEAST_FACTOR = 0.05
"""Least such factor that a force found can stand for: less cannot be said by its logarithm."""


class Reach(NamedTuple):
    """Largest displacement along x, along y and radially [m]."""

    x: float
    y: float
    radius: float


class Shape(NamedTuple):
    """A force up to a few factors: parameters that are held, and what each factor multiplies."""

    term: str
    held: dict[str, float]
    factors: tuple[dict[str, float], ...]
    positive: bool = False
    """Whether the factors must be."""
    gap: str | None = None
    """The held parameter that is one over a gap."""

    @property
    def unknowns(self) -> int:
        """Factors, and the gap."""
        return len(self.factors) + (self.gap is not None)

    @property
    def plain(self) -> str:
        """What people call it, without the gap."""
        words = TERMS[self.term].words if self.term in TERMS else self.term.replace("_", " ")
        keys = [key for factor in self.factors for key in factor]
        if len(keys) == 1 and keys[0][-2:] in {"_x", "_y"}:
            words = f"{words.removesuffix(' error')} along {keys[0][-1]}"
        return words

    @property
    def words(self) -> str:
        """What people call it, with the gap."""
        return self.plain if self.gap is None else with_gap(self.term, self.plain, self.held[self.gap])


def with_gap(term: str, plain: str, inverse_gap: float) -> str:
    """Words for a term with the size of its gap. **Arguments:** ``inverse_gap`` [1/m]."""
    return f"{plain} {TERMS[term].reached if term in TERMS else 'beyond'} {1e3 / inverse_gap:.2g} mm"


def shapes(catalog: Mapping[str, type[Effect]], rotor: AbstractRotor, reach: Reach) -> Iterator[Shape]:
    """Forces to try: effects that enter linearly, one axis at a time where the axes are apart, and a scan of gaps and
    crack angles.
    """
    for name, cls in catalog.items():
        hooks = issubclass(cls, ExcitationEffect | MatrixEffect | RestoringEffect)
        if (
            not hooks
            or issubclass(cls, SupportEffect | SpeedEffect | ReadingEffect)
            or any(p.axes for p in cls.parameters())
        ):
            continue
        scale = {p.name: STEP * p.prior_scale(rotor) for p in cls.parameters()}
        if GAP in cls.over_amplitude:
            sides = cls.sides if issubclass(cls, AxisForce) else AxisForce.sides
            yield from (beyond(cls, rotor, reach, side * share) for side in sides for share in GAPS)
        elif name == "crack":
            for angle in 2.0 * math.pi * np.arange(CRACK_ANGLES) / CRACK_ANGLES:
                pair = zip(scale.items(), (math.cos(angle), math.sin(angle)), strict=True)
                yield Shape(name, {}, ({key: size * part for (key, size), part in pair},), positive=True)
        elif name in BY_AXIS:
            yield from (Shape(name, {}, ({key: size},)) for key, size in scale.items())
        else:
            yield Shape(name, {}, tuple({key: size} for key, size in scale.items()))


def beyond(cls: type[Effect], rotor: AbstractRotor, reach: Reach, share: float) -> Shape:
    """A force beyond a gap that is this share of the largest displacement, along the term's axis or radially; negative:
    on the negative side.
    """
    largest = reach[cls().axis()] if issubclass(cls, AxisForce) else reach.radius
    held = {GAP: 1.0 / (share * largest)} | ({"friction": RUB_FRICTION} if cls.name == "rub" else {})
    free = {p.name: STEP * p.prior_scale(rotor) for p in cls.parameters() if p.name not in held}
    return Shape(cls.name, held, tuple({key: size} for key, size in free.items()), positive=True, gap=GAP)
