"""Shapes that a missing force may have: effects that are linear in a few factors, and a scan of what is not linear.

The size of a gap, the angle of a crack, the power of displacement or velocity and a delay are tried one by one; what
is left enters the balance of forces linearly.
"""

import math
from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np

from rotorjax.effects.delayed_force import DELAY, PERIODS, DelayedForce
from rotorjax.effects.power_terms import POWER, DampingTerm, PowerTerm
from rotorjax.effects.term import Term
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
SCANNED = (GAP, POWER, DELAY)
"""Parameters of which values are tried one by one."""
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
    scanned: str | None = None
    """The held parameter of which values are tried one by one: one over a gap, a power, or a delay."""

    @property
    def has_gap(self) -> bool:
        """Whether it acts beyond a gap only."""
        return self.scanned == GAP

    @property
    def unknowns(self) -> int:
        """Factors, and what is tried one by one."""
        return len(self.factors) + (self.scanned is not None)

    @property
    def plain(self) -> str:
        """What people call it, without gap, power or delay."""
        words = TERMS[self.term].words if self.term in TERMS else self.term.replace("_", " ")
        keys = [key for factor in self.factors for key in factor]
        if len(keys) == 1 and keys[0][-2:] in {"_x", "_y"}:
            words = f"{words.removesuffix(' error')} along {keys[0][-1]}"
        return words

    @property
    def words(self) -> str:
        """What people call it, with gap, power or delay."""
        return self.plain if self.scanned is None else with_value(self.term, self.plain, self.held[self.scanned])

    def value_of(self, key: str, multiple: float) -> float:
        """Of a parameter, where its factor is multiplied like that."""
        part = sum(factor.get(key, 0.0) for factor in self.factors)
        if self.scanned == POWER:
            return part * math.copysign(abs(multiple) ** (1.0 / (1.0 + self.held[POWER])), multiple)
        if self.term in LOGARITHMIC:
            return math.log(max(1.0 + multiple * part, LEAST_FACTOR))
        return multiple * part


def with_value(term: str, plain: str, value: float) -> str:
    """Words for a term with the size of its gap, its power, or its delay. **Arguments:** ``value``: one over the gap
    [1/m], the power less two, or the delay [s].
    """
    cls = TERMS.get(term)
    if cls is DelayedForce:
        return plain.replace("an earlier displacement", f"the displacement {1e3 * value:.3g} ms earlier")
    if cls is not None and issubclass(cls, PowerTerm):
        return plain.replace("a power of", f"the power {2.0 + value:.3g} of")
    return f"{plain} {cls.reached if cls is not None else 'beyond'} {1e3 / value:.2g} mm"


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
            sides = cls.sides if issubclass(cls, Term) else Term.sides
            yield from (beyond(cls, rotor, reach, side * share) for side in sides for share in GAPS)
        elif issubclass(cls, PowerTerm):
            size, _ = scale
            largest = reach.radius / (rotor.quantities()["period"] if issubclass(cls, DampingTerm) else 1.0)
            yield from (Shape(name, {POWER: x}, ({size: 1.0 / largest},), scanned=POWER) for x in cls.tried)
        elif cls is DelayedForce:
            period, (size, _) = 2.0 * math.pi * rotor.quantities()["period"], scale
            yield from (Shape(name, {DELAY: p * period}, ({size: scale[size]},), scanned=DELAY) for p in PERIODS)
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
    return Shape(cls.name, held, tuple({key: size} for key, size in free.items()), positive=True, scanned=GAP)
