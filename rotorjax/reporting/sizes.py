"""Sizes of fitted effects as an engineer states them: magnitude and angle, percent, a gap; with 95 % intervals."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from rotorjax.data.rig_sections import Convention
from rotorjax.discovery.fit import Fit
from rotorjax.effects.healthy_rotor import HealthyRotor
from rotorjax.inference.estimates import NORMAL_QUANTILE, Estimate
from rotorjax.reporting.tables import number
from rotorjax.reporting.wording import plain_name, with_error
from rotorjax.units import DEGREE

VECTORS = ("kg m", "m", "N")
"""Units of parameters along x and y that are the parts of one vector."""
WORDS = {
    "cosine_n": "force, cosine part",
    "cosine_n_per_m": "stiffness, cosine part",
    "cross_stiffness_n_per_m": "cross-coupled stiffness",
    "cubic_n_per_m3": "cubic stiffness",
    "damping_n_s2_per_m2": "drag",
    "difference_x_n_per_m": "half difference of stiffness",
    "force_1_x_n": "1X force",
    "force_2_x_real_n": "2X force x",
    "force_2_y_real_n": "2X force y",
    "friction": "coefficient of friction",
    "growth_per_m": "growth of stiffness",
    "inertia_ratio_kg": "polar inertia, as a mass",
    "log_damping": "damping ratio over 0.05",
    "log_frequency": "natural frequency over the rotor's",
    "loss_x_n_per_m": "loss of stiffness",
    "rate_rad_per_s2": "rate of the speed",
    "real_m": "runout",
    "sine_n": "force, sine part",
    "sine_n_per_m": "stiffness, sine part",
    "stiffness_n_per_m": "contact stiffness",
}
"""What parameters are called whose name says too little."""
DOUBLED = ("difference_x_n_per_m",)
"""Vectors that stand at twice the angle of the axis that they tell."""
SURE_OF_ANGLE = 60.0
"""Half of a 95 % interval of an angle [degrees] up to which the angle is told."""
NOT_DETERMINED = "not determined"
LINEAR = 0.2
"""Half of an interval of a logarithm up to which exp(x) is 1 + x to one digit of the error."""
RATIOS = ("error", "gain")
"""How parameters begin that are relative errors: they are stated in percent, with their sign."""


class Size(NamedTuple):
    """One size of one effect, in words."""

    effect: str
    what: str
    """What it is the size of: "unbalance", "cross stiffness"."""
    value: str
    """With unit and 95 % interval."""
    labels: tuple[str, ...]
    """Its parameters as rig files name them."""
    prior: str = ""
    """Half the 95 % interval that it had before the data."""
    remark: str = ""

    @property
    def determined(self) -> bool:
        """Whether the data say anything of it."""
        return not self.value.startswith(NOT_DETERMINED)


def sizes(fitted: Fit, effects: tuple[str, ...], convention: Convention | None = None) -> list[Size]:
    """Sizes of some effects in a fit, in the order of the effects; parts of one vector together.

    **Arguments:** ``convention``: how angles count; by default from x towards y.
    """
    convention, found = convention or Convention(), []
    for effect in effects:
        own = {e.entry.label: e for e in fitted.estimates if e.entry.effect == effect}
        alone = len(own) == 1
        while own:
            label, first = next(iter(own.items()))
            second = own.get(_partner(label) or "")
            parts = (first,) if second is None else (first, second)
            for part in parts:
                own.pop(part.entry.label)
            what = _what(first, single=second is None)
            if not any(part.determined for part in parts):
                value = NOT_DETERMINED
            elif second is None:
                value = _single(first, fitted, alone=alone)
            else:
                value = _pair(first, second, fitted, convention)
            labels = tuple(part.entry.label for part in parts)
            found.append(Size(effect, what, value, labels, _prior(first), _remark(parts)))
    return found


def _remark(parts: tuple[Estimate, ...]) -> str:
    moved = [part for part in parts if part.finding]
    if moved:
        return f"moved by {max(abs(part.pull) for part in moved):.1f} of its standard deviations: a finding"
    return "declared uncertain" if parts[0].entry.declared_uncertain else ""


def _partner(label: str) -> str | None:
    """The label of the other part of the same vector or complex number."""
    parameter, dot, axes = label.partition(".")
    for one, other in (("_x_", "_y_"), ("_real", "_imaginary"), ("real_", "imaginary_")):
        if one in parameter and not ("real" in parameter and one == "_x_"):
            return parameter.replace(one, other) + dot + axes
    return None


def _what(estimate: Estimate, *, single: bool) -> str:
    """Words for a parameter, or for the vector that it is a part of, and whose it is."""
    name, _, axes = estimate.entry.label.partition(".")
    return " ".join(filter(None, (WORDS.get(name) or _by_name(estimate, name, single), axes.replace(".", " "))))


def _by_name(estimate: Estimate, name: str, single: bool) -> str:
    """The parameter's name without unit and, of a vector, without the part."""
    if not single:
        return next((name.partition(part)[0] for part in ("_x_", "_real") if part in name), name).replace("_", " ")
    words = name.removesuffix("_" + _ending(name)) if _ending(name) else name
    words = words.removeprefix("inverse_").removeprefix("log_")
    if words.split("_")[0] in ("error", "ratio"):
        # Named after what the effect is an error of: "stiffness x".
        quantity = "damping_ratio" if estimate.entry.effect == "damping_error" else estimate.entry.effect
        return " ".join([plain_name(quantity.removesuffix("_error")), *words.split("_")[1:]])
    return words.replace("_", " ")


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


def _single(estimate: Estimate, fitted: Fit, *, alone: bool) -> str:
    """One number: a ratio, a gap, percent, or the value in its unit. **Arguments:** ``alone``: whether it is the only
    size of its effect, so that it is not determined where its interval holds zero.
    """
    entry, value, error = estimate.entry, estimate.value, fitted.quantile * estimate.standard_error
    show = _shown(estimate, fitted)
    if entry.parameter.startswith("log_"):
        return show(value, error)
    zero_too = abs(value) <= error
    if entry.parameter.startswith("inverse_"):
        nearest = 1e6 / (abs(value) + error)
        # The sign of a gap is the side that it is on.
        far = f"{NOT_DETERMINED}: {number(nearest)} µm or more"
        return far if zero_too else f"{with_error(1e6 / value, 1e6 * error / value**2)} µm"
    if zero_too and alone and not entry.declared_uncertain:
        return f"{NOT_DETERMINED}: {show(value, error)}"
    return show(value, error)


def _shown(estimate: Estimate, fitted: Fit) -> Callable[[float, float], str]:
    """How a value and half its interval are written."""
    entry, unit = estimate.entry, estimate.entry.unit
    if entry.parameter.startswith("log_"):
        ratio = _declared_ratio(estimate, fitted)
        return _times if ratio is None else (lambda v, e: _damping_ratio(ratio, v, e))
    if unit.si == "1" and entry.parameter.startswith(RATIOS):
        return lambda v, e: f"{with_error(100.0 * v, 100.0 * e, signed=True)} %"
    shown = {"deg": "°", "1": ""}.get(unit.shown, f" {unit.shown}")
    return lambda v, e: f"{with_error(v / unit.factor, e / unit.factor)}{shown}"


def _declared_ratio(estimate: Estimate, fitted: Fit) -> float | None:
    """The declared damping ratio that a logarithm multiplies, if it is one."""
    declared = getattr(fitted.model.rotor, "damping_ratio", None)
    # A healthy rotor that was measured has another damping than declared.
    if declared is None or estimate.entry.effect != "damping_error" or HealthyRotor.name in fitted.model:
        return None
    return float(np.asarray(declared)["xy".index(estimate.entry.parameter[-1])])


def _damping_ratio(declared: float, log_ratio: float, error: float) -> str:
    """exp(log_ratio) times the declared one, in percent: the interval as the logarithm has it where it is wide."""
    value = 100.0 * declared * math.exp(log_ratio)
    if error < LINEAR:
        return f"{with_error(value, value * error)} %"
    low, high = (value * math.exp(k * error) for k in (-1.0, 1.0))
    return f"{number(value, 2)} % ({number(low, 2)} to {number(high, 2)} %)"


def _times(log_ratio: float, error: float) -> str:
    low, middle, high = (math.exp(log_ratio + k * error) for k in (-1.0, 0.0, 1.0))
    if error < LINEAR:
        return f"{with_error(middle, middle * error)} times"
    return f"{number(middle)} times ({number(low, 2)} to {number(high, 2)})"


def _prior(estimate: Estimate) -> str:
    """Half the 95 % interval before the data."""
    entry, unit, half = estimate.entry, estimate.entry.unit, NORMAL_QUANTILE * estimate.entry.scale
    if entry.parameter.startswith("log_"):
        return f"factor {number(math.exp(half), 2)}"
    if unit.si == "1" and entry.parameter.startswith(RATIOS):
        return f"{number(100.0 * half, 2)} %"
    if entry.parameter.startswith("inverse_"):
        return f"{number(1e6 / half, 2)} µm or more"
    shown = {"deg": "°", "1": ""}.get(unit.shown, f" {unit.shown}")
    return f"{number(half / unit.factor, 2)}{shown}"


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
    if first.entry.parameter in DOUBLED:
        degrees, turn = 0.5 * degrees, 0.5 * turn
    scale, shown = (unit.factor, f" {unit.shown}") if unit.si != "1" else (1.0, " times")
    if size <= error:
        return f"{NOT_DETERMINED}: up to {number((size + error) / scale, 2)}{shown}"
    angle = f" at {with_error(degrees % 360.0 if spatial else degrees, turn)}°"
    return f"{with_error(size / scale, error / scale)}{shown}" + (
        angle if turn < SURE_OF_ANGLE else ", angle not determined"
    )


def _covariance(first: Estimate, second: Estimate, fitted: Fit) -> Float[np.ndarray, "2 2"]:
    """Of two values, in SI."""
    which = [first.entry.unknown, second.entry.unknown]
    scale = np.array([first.entry.scale, second.entry.scale])
    return scale[:, None] * fitted.covariance[np.ix_(which, which)] * scale
