"""How sentences name effects, list things and state probabilities and errors."""

import math

from rotorjax.effects.terms import TERMS
from rotorjax.reporting.tables import number

PLAIN = {
    "cross_coupling": "cross-coupled stiffness",
    "duffing": "cubic stiffness",
    "gyroscopic": "gyroscopic moment",
    "foundation": "flexible foundation",
    "stiffness_axes": "rotated stiffness axes",
    "clearance": "stop behind a clearance",
    "plane_participation": "participation error",
    "probe_gain": "probe gain error",
    "probe_angle": "probe angle error",
    "chain_gain": "chain gain error",
    "speed_dependent_stiffness": "speed-dependent stiffness",
    "speed_dependent_damping": "speed-dependent damping",
    "speed_dependent_cross_coupling": "speed-dependent cross-coupling",
}
"""Plain names that are not the identifier with spaces."""


def listed(names: tuple[str, ...] | list[str]) -> str:
    """Names in a sentence."""
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def plain_name(name: str) -> str:
    """The field's name of an effect, or of what was written down wrongly, by its identifier: "residual unbalance"."""
    kind, *about = name.split(".")
    words = TERMS[kind].words if kind in TERMS else PLAIN.get(kind, kind.replace("_", " "))
    return f"{words} ({', '.join(about)})" if about else words


def said(names: tuple[str, ...] | list[str]) -> str:
    """Effects in a sentence, by their plain names."""
    return listed([plain_name(name) for name in names])


def opening(text: str) -> str:
    """A text at the beginning of a sentence."""
    return text[:1].upper() + text[1:]


def percent(probability: float, places: int = 1) -> str:
    """A probability as people read it: "99.9 %", "> 99.9 %", "< 0.1 %"."""
    value, least = 100.0 * probability, 10.0**-places
    if value >= 100.0 - 0.5 * least:
        return f"> {100.0 - least:.{places}f} %"
    return f"< {least:.{places}f} %" if value < 0.5 * least else f"{value:.{places}f} %"


def with_error(value: float, error: float, *, signed: bool = False) -> str:
    """A value with half its 95 % interval, both to the same place: of the error one digit, two where it begins with 1
    (JCGM 100:2008, 7.2.6).
    """
    if not (math.isfinite(value) and math.isfinite(error)) or error <= 0.0:
        return number(value)
    power = math.floor(math.log10(error))
    place = power - (error / 10.0**power < 2.0)
    largest = math.floor(math.log10(max(abs(value), error)))
    sign = "+" if signed else ""
    if largest >= 6 or place < -6:
        digits = max(0, largest - place)
        return f"({value / 10.0**largest:{sign}.{digits}f} ± {error / 10.0**largest:.{digits}f})e{largest}"
    return f"{round(value, -place) + 0.0:{sign}.{max(0, -place)}f} ± {round(error, -place):.{max(0, -place)}f}"
