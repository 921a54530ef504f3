"""Units: SI within, what people read at the door."""

import math
from typing import NamedTuple

RPM = 2.0 * math.pi / 60.0
"""One revolution per minute, in rad/s."""

MICROMETRE = 1e-6
MILLIMETRE = 1e-3

GRAM_MILLIMETRE = 1e-6
"""One g mm, in kg m."""

DEGREE = math.pi / 180.0

GRAVITY = 9.80665
"""Standard acceleration of gravity, m/s² (CGPM 1901)."""


# Ending of a parameter's name -> (SI unit, unit for people, SI value of one of these). Longest ending first.
_UNITS: tuple[tuple[str, tuple[str, str, float]], ...] = (
    ("_n_per_m3", ("N/m³", "N/m³", 1.0)),
    ("_n_s2_per_m2", ("N s²/m²", "N s²/m²", 1.0)),
    ("_n_s_per_m", ("N s/m", "N s/m", 1.0)),
    ("_n_s2_per_m", ("N s²/m", "N s²/m", 1.0)),
    ("_n_per_m", ("N/m", "N/m", 1.0)),
    ("_s_per_m", ("s/m", "s/mm", 1e3)),
    ("_m_per_n", ("m/N", "µm/N", 1e-6)),
    ("_per_m", ("1/m", "1/mm", 1e3)),
    ("_rad_per_s2", ("rad/s²", "rpm/s", RPM)),
    ("_kg_m", ("kg m", "g mm", GRAM_MILLIMETRE)),
    ("_kg", ("kg", "g", 1e-3)),
    ("_rad", ("rad", "deg", DEGREE)),
    ("_n", ("N", "N", 1.0)),
    ("_s", ("s", "ms", 1e-3)),
    ("_m", ("m", "µm", MICROMETRE)),
)


class Unit(NamedTuple):
    """SI unit, the unit shown to people, and the SI value of one of the latter."""

    si: str
    shown: str
    factor: float


def unit_of(name: str) -> Unit:
    """The unit that a parameter's name declares by its ending; dimensionless without one."""
    for ending, unit in _UNITS:
        if name.endswith(ending):
            return Unit(*unit)
    return Unit("1", "1", 1.0)


def figures(value: float, digits: int = 3) -> str:
    """A number to some significant digits, trailing zeros kept; without a power of ten below ten million."""
    text = f"{value:#.{digits}g}"
    return f"{float(text):.0f}" if "e+" in text and abs(value) < 1e7 else text.rstrip(".")
