"""Sizes of fitted effects as an engineer states them: magnitude and angle, percent, a gap; with 95 % intervals."""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from rotorjax.data.rig_sections import Convention
from rotorjax.discovery.fit import Estimate, Fit
from rotorjax.reporting.tables import number
from rotorjax.units import DEGREE

VECTORS = ("kg m", "m", "N")
"""Units of parameters along x and y that are the parts of one vector."""
SURE_OF_ANGLE = 60.0
"""Half of a 95 % interval of an angle [degrees] up to which the angle is told."""


class Size(NamedTuple):
    """One size of one effect, in words."""

    effect: str
    what: str
    """What it is the size of: "unbalance", "cross-coupled stiffness k"."""
    value: str
    """With unit and 95 % interval."""


def sizes(fitted: Fit, effects: tuple[str, ...], convention: Convention | None = None) -> list[Size]:
    """Sizes of some effects in a fit, in the order of the effects; parts of one vector together.

    **Arguments:** ``convention``: how angles count; by default from x towards y.
    """
    convention, found = convention or Convention(), []
    for effect in effects:
        own = {e.entry.label: e for e in fitted.estimates if e.entry.effect == effect}
        while own:
            label, first = next(iter(own.items()))
            partner = _partner(label)
            second = own.get(partner) if partner else None
            for gone in (label, partner):
                own.pop(gone or "", None)
            if second is None:
                found.append(Size(effect, _what(first), _single(first, fitted.quantile)))
            else:
                found.append(Size(effect, _name(label), _pair(first, second, fitted, convention)))
    return found


def _partner(label: str) -> str | None:
    """The label of the other part of the same vector or complex number."""
    parameter, dot, axes = label.partition(".")
    for one, other in (("_x_", "_y_"), ("_real", "_imaginary"), ("real_", "imaginary_")):
        if one in parameter and not ("real" in parameter and one == "_x_"):
            return parameter.replace(one, other) + dot + axes
    return None


def _what(estimate: Estimate) -> str:
    """Words for a parameter: its name, and whose it is."""
    name, _, axes = estimate.entry.label.partition(".")
    words = name.removesuffix("_" + _ending(name)) if _ending(name) else name
    words = words.removeprefix("inverse_").removeprefix("log_").replace("_", " ")
    return f"{words} {axes}".strip() if axes else words


def _name(label: str) -> str:
    parameter, _, axes = label.partition(".")
    for part in ("_x_", "_real", "real_"):
        if part in parameter:
            parameter = parameter.split(part)[0]
            break
    return " ".join(filter(None, (parameter.replace("_", " "), axes.replace(".", " ")))) or "vector"


def _ending(name: str) -> str:
    """The unit at the end of a parameter's name."""
    for ending in (
        "n_per_m3",
        "n_s2_per_m2",
        "n_s_per_m",
        "n_per_m",
        "m_per_n",
        "per_m",
        "kg_m",
        "kg",
        "rad",
        "n",
        "s",
        "m",
    ):
        if name.endswith("_" + ending):
            return ending
    return ""


def _single(estimate: Estimate, quantile: float) -> str:
    """One number: a factor, a gap, percent, or the value in its unit."""
    entry, value, error = estimate.entry, estimate.value, quantile * estimate.standard_error
    if entry.parameter.startswith("log_"):
        low, middle, high = (math.exp(value + k * error) for k in (-1.0, 0.0, 1.0))
        return f"{number(middle)} times ({number(low, 2)} to {number(high, 2)})"
    if entry.parameter.startswith("inverse_") and value != 0.0:
        return f"{number(1e6 / abs(value))} ± {number(1e6 * error / value**2, 2)} µm"
    if entry.unit.si == "1":
        return f"{number(100.0 * value)} ± {number(100.0 * error, 2)} %"
    unit = entry.unit
    shown = "°" if unit.shown == "deg" else f" {unit.shown}"
    return f"{number(value / unit.factor)} ± {number(error / unit.factor, 2)}{shown}"


def _pair(first: Estimate, second: Estimate, fitted: Fit, convention: Convention) -> str:
    """A vector or a complex number as magnitude and angle."""
    pair, covariance, unit = np.array([first.value, second.value]), _covariance(first, second, fitted), first.entry.unit
    if first.entry.parameter.startswith("gain_"):
        pair[0] += 1.0
    spatial = unit.si in VECTORS and "_x_" in first.entry.parameter
    size = float(np.hypot(*pair))
    along = pair / size if size > 0.0 else np.array([1.0, 0.0])
    across = np.array([-along[1], along[0]])
    error = fitted.quantile * math.sqrt(along @ covariance @ along)
    turn = fitted.quantile * math.sqrt(across @ covariance @ across) / max(size, 1e-300) / DEGREE
    degrees = convention.angle_deg(pair) if spatial else math.degrees(math.atan2(pair[1], pair[0]))
    scale, shown = (unit.factor, f" {unit.shown}") if unit.si != "1" else (1.0, " times")
    angle = (
        f" at {degrees % 360.0 if spatial else degrees:.0f} ± {number(turn, 2)}°"
        if turn < SURE_OF_ANGLE
        else ", at an angle that these data leave open"
    )
    return f"{number(size / scale)} ± {number(error / scale, 2)}{shown}{angle}"


def _covariance(first: Estimate, second: Estimate, fitted: Fit) -> Float[np.ndarray, "2 2"]:
    """Of two values, in SI."""
    which = [first.entry.unknown, second.entry.unknown]
    scale = np.array([first.entry.scale, second.entry.scale])
    return scale[:, None] * fitted.covariance[np.ix_(which, which)] * scale
