"""Whether unbalance and bow can be told apart; why not, and the speed at which a reading would help most."""

import math

import numpy as np
from jaxtyping import Float

from rotorjax.data.measurement import Measurement
from rotorjax.diagnosis.critical_speeds import critical_speeds_rpm, natural_speeds_rpm
from rotorjax.diagnosis.fault import Fault
from rotorjax.diagnosis.least_squares import Solution
from rotorjax.inference.faults import fault_sensitivity, response_to
from rotorjax.model.conditions import Conditions
from rotorjax.model.model import Model
from rotorjax.units import MICROMETRE

ENTANGLED = 10.0
"""Growth of a standard error, by the other fault being free, above which two faults count as entangled."""
RESOLVED = 2.0
"""An entangled fault is still separable if it is this many standard errors large."""
NEAR_PEAK = 0.1
"""Half width of the band around a resonance that is not proposed for measuring: there the model's own error rules."""
MODEL_FAILS = "the model does not hold here"
"""How the reason begins where the misfit is above the noise."""


def why_not_separable(
    unbalance: Fault, bow: Fault, solution: Solution, model: Model, measurement: Measurement, index: int
) -> str:
    """Why unbalance and bow are not separable, with a cure; empty if they are."""
    if hopeless := _hopeless(solution, model):
        return hopeless
    resolved = all(fault.magnitude >= RESOLVED * fault.largest_error for fault in (unbalance, bow))
    unchecked = solution.freedom == 0 and not measurement.knowledge.uncertain
    if _growth(solution.covariance) <= ENTANGLED or (resolved and not unchecked):
        return ""
    entangled = _entanglement(measurement.speed_rpm[measurement.run == index], model)
    if unchecked:
        entangled += ", and no reading is left over to check the model by"
    return f"{entangled}; {_cure(solution, model, measurement, index)}"


def _hopeless(solution: Solution, model: Model) -> str:
    """Reasons that lie in the plan or the model, not in the size of the noise."""
    if model.slow_roll is not None:
        return (
            "slow roll was subtracted, and with it what a bow shows there: bow and unbalance follow the same law with "
            "speed; "
            "give the vectors without that subtraction"
        )
    if solution.rank < 4:
        return f"{solution.rank} independent numbers for four unknowns: measure a second probe or a second speed"
    if solution.scale is None:
        return "the noise is unknown and nothing is left over to judge it by: give sigma_um, repeats, or a second speed"
    if solution.chi2 is not None and solution.model_fails:
        return (
            f"{MODEL_FAILS}: it misses the readings by {math.sqrt(solution.chi2):.3g} times their "
            "standard error, so that what it lacks is counted as unbalance and bow; `rotorjax explain` looks for what "
            "it lacks"
        )
    return ""


def _growth(covariance: Float[np.ndarray, "4 4"]) -> float:
    """How much larger the standard error of either fault is than it would be if the other were known."""

    def one(own: slice, other: slice) -> float:
        crossed = covariance[own, other]
        known = covariance[own, own] - crossed @ np.linalg.solve(covariance[other, other], crossed.T)
        return _largest(covariance[own, own]) / max(_largest(known), 1e-300)

    unbalance, bow = slice(0, 2), slice(2, 4)
    return max(one(unbalance, bow), one(bow, unbalance))


def _largest(covariance: np.ndarray) -> float:
    """Standard error along the worst direction."""
    return math.sqrt(max(float(np.linalg.eigvalsh(covariance)[-1]), 0.0))


def _peaks_rpm(model: Model) -> Float[np.ndarray, "_"]:
    """Critical speeds, or where damping leaves none the natural frequencies of the axes."""
    peaks = critical_speeds_rpm(model)
    return peaks if len(peaks) else natural_speeds_rpm(model)


def _entanglement(speeds: np.ndarray, model: Model) -> str:
    axes = " and ".join(f"{speed:.0f}" for speed in _peaks_rpm(model))
    if np.ptp(speeds) <= 0.02 * np.min(speeds):
        return (
            f"one speed ({np.mean(speeds):.0f} rpm) and nearly equal axes (critical speeds {axes} rpm): bow and "
            "unbalance look alike there"
        )
    listed = ", ".join(f"{speed:.0f}" for speed in np.unique(speeds))
    return (
        f"bow and unbalance look alike at {listed} rpm, within the noise and what is uncertain (critical speeds {axes} "
        "rpm)"
    )


def _cure(solution: Solution, model: Model, measurement: Measurement, index: int) -> str:
    """The further speed within the limits that would tell them apart best, with the error that it would leave."""
    peaks, limits = _peaks_rpm(model), measurement.knowledge.limits
    low, high = limits.speed_rpm or (0.5 * measurement.speed_rpm.min(), measurement.speed_rpm.max())
    candidates = np.linspace(low, high, 57)
    conditions = Conditions.at_rpm(candidates, unbalance=np.zeros((len(model.layout.planes), 2)))
    first = measurement.orders.index(1.0)
    clear = np.all(np.abs(candidates[:, None] / peaks - 1.0) > NEAR_PEAK, axis=1)
    if limits.amplitude_um is not None:
        expected = np.abs(response_to(model, conditions, np.tile(solution.faults, (len(candidates), 1)))[:, :, first])
        clear &= np.all(expected < limits.amplitude_um * MICROMETRE, axis=1)
    if not clear.any():
        return "no speed within the limits would separate them"
    cells = measurement.weights(0.0 if measurement.sigma is not None else MICROMETRE)[measurement.run == index][
        :, :, first
    ]
    weight = float(np.median(cells[cells > 0.0]))
    factor = math.sqrt(solution.scale or 1.0) * 1e6
    before = factor * _largest(np.linalg.inv(solution.information)[:2, :2])
    after = np.full(len(candidates), np.inf)
    for k, rows in enumerate(
        weight * fault_sensitivity(model, conditions)[:, :, first].reshape(len(candidates), -1, 4)
    ):
        after[k] = (
            factor * _largest(np.linalg.inv(solution.information + rows.T @ rows)[:2, :2]) if clear[k] else np.inf
        )
    best = int(np.argmin(after))
    if measurement.knowledge.uncertain:
        return f"a reading at {candidates[best]:.0f} rpm would separate them best"
    return (
        f"a reading at {candidates[best]:.0f} rpm would bring the standard error of the unbalance from {before:.3g} to "
        f"{after[best]:.3g} g mm"
    )
