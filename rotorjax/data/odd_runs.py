"""What may be other in one run than it is stated, or than in all others: a weight, the phase reference, amplitudes.

Unlike the changes of `rotorjax.data.declarations` these have values, which are fitted beside the effects that may be
missing, and then count as known.
"""

import dataclasses
import math
from collections.abc import Collection, Iterator, Mapping
from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from rotorjax.arrays import as_array
from rotorjax.data.declarations import KINDS, MIL, Mistake, Stated, beside_influence, with_installed
from rotorjax.data.knowledge import Uncertain
from rotorjax.data.measurement import Measurement
from rotorjax.effects.of_one_run import RUN_EFFECTS, RunAmplitude, RunBow, RunPhase, RunSpeed, RunUnbalance
from rotorjax.effects.reading import ChainGain, PhaseReferenceOffset
from rotorjax.model.conditions import Conditions
from rotorjax.model.model import Model
from rotorjax.physics.steady_state import is_coupled
from rotorjax.units import GRAM_MILLIMETRE, MICROMETRE, figures

LEAST_RUNS = 3
"""Of two runs either may be the odd one."""
MOST_NOISE = 0.02
"""Of the vectors, what an unknown noise may be where influence coefficients leave as much."""
HALVED = 0.5
"""Of what influence coefficients leave of all runs, the share that they leave at most without the odd one."""
USUAL, NEAR_USUAL = (2.0, math.sqrt(2.0), 2.0 * math.sqrt(2.0), MIL), 0.02
"""Factors between kinds and units of amplitudes, and how near one is to them."""
CLOSE = 3.0
"""Standard errors within which an unbalance is another run's weight."""
EXCHANGED = "run_probes_exchanged"
"""Of two probes the cables of one run."""
ABOUT_WEIGHTS = "installed weights"
"""Words in what speaks against an answer for which weights may stand."""
MOST_ODD = 3
"""Runs that are looked at."""
Pair = Float[np.ndarray, "dof"]


class Value(NamedTuple):
    """A value fitted, and its standard error, in SI."""

    value: float
    error: float


def odd_runs(model: Model, m: Measurement, kinds: Collection[str] = KINDS) -> list[Mistake]:
    """What may be other in one run, of those runs without which influence coefficients hold much better."""
    if len(m.runs) < LEAST_RUNS:
        return []
    return [mistake for run in _odd_ones(m) for mistake in _of_run(model, m, run) if mistake.kind in kinds]


def every_odd_run(model: Model, m: Measurement, kinds: Collection[str] = KINDS) -> list[Mistake]:
    """The same of every run, whatever the data say."""
    return [mistake for run in range(len(m.runs)) for mistake in _of_run(model, m, run) if mistake.kind in kinds]


def _odd_ones(m: Measurement) -> list[int]:
    """The runs without which the least is left; none where noise is all that is, or may be where it is unknown."""
    total = beside_influence(m)
    noise = 1.0 if m.sigma is not None else MOST_NOISE
    if total <= noise**2 * np.count_nonzero(m.weights(0.0 if m.sigma is not None else m.rms)):
        return []
    left = {
        run: beside_influence(dataclasses.replace(m, present=m.present & (m.run != run)[:, None, None]))
        for run in range(len(m.runs))
    }
    nearest = sorted(left, key=lambda run: left[run])[:MOST_ODD]
    return [run for run in nearest if left[run] < HALVED * total]


def _of_run(model: Model, m: Measurement, run: int) -> Iterator[Mistake]:
    name, odd = m.runs[run], partial(_with_odd_run, run=run)
    largest = float(np.max(np.linalg.norm(np.asarray(m.conditions.unbalance), axis=-1), initial=0.0))
    scales = model.rotor.quantities()
    size, bow = max(largest, scales["unbalance"]), 2.0 * scales["eccentricity"]
    for kind, deviation, meaning in (
        (RunUnbalance.name, size, f"the unbalance of run {name} is another than stated"),
        (RunBow.name, bow, f"the shaft was bowed in run {name} as in no other"),
        (RunPhase.name, 1.0, f"the phase reference of run {name} is at another angle than that of the others"),
        (RunAmplitude.name, 1.0, f"the amplitudes of run {name} are of another size than those of the others"),
        (RunSpeed.name, 0.1, f"the speeds of run {name} are other than stated"),
    ):
        labels = [label for p in RUN_EFFECTS[kind].parameters() for label in p.labels(model.layout)]
        uncertain = tuple(Uncertain(kind, label, deviation, False, f"{kind}.{label}") for label in labels)
        yield Mistake(kind, (name,), meaning, f"check run {name}", odd, uncertain=uncertain)
    if len(pair := m.probes_read) == 2:
        meaning = f"the cables of probes {' and '.join(pair)} were exchanged in run {name}"
        exchanged = partial(_with_probes_exchanged, run=run)
        yield Mistake(EXCHANGED, (name,), meaning, f"the table: exchange the probes of run {name}", exchanged)


def settled(mistake: Mistake, m: Measurement, found: Mapping[str, Value]) -> Mistake:
    """A mistake about one run with the values that were fitted, by label: what it says, what to change, and the
    measurement as it is then.
    """
    run, values = m.runs.index(mistake.about[0]), list(found.values())
    meaning, cure, corrected = _SAID[mistake.kind](m, run, *values)
    return mistake._replace(meaning=meaning, cure=cure, corrected=corrected, uncertain=())


def _unbalance(m: Measurement, run: int, x: Value, y: Value) -> tuple[str, str, partial[Stated]]:
    added, name = np.array([x.value, y.value]), m.runs[run]
    stated = _installed(m, run)
    corrected = partial(_with_unbalance_added, run=run, added=added)
    where = f"counted from +x in the sense of rotation{_left_in(m, run, added, math.hypot(x.error, y.error))}"
    if len(stated) == 1 and np.any(stated):
        acted = f"acted as {_vector(stated[0] + added, x, y)} where {_vector(stated[0])} is stated"
        cure = f"[runs.{name}]: check mass, radius and place of its weight"
        return f"the weight of run {name} {acted} ({where})", cure, corrected
    meaning = f"an unbalance of {_vector(added, x, y)} that is not stated acted in run {name} ({where})"
    return meaning, f"[runs.{name}]: a weight was lost, added or moved; state it there", corrected


def _installed(m: Measurement, run: int) -> Float[np.ndarray, "plane xy"]:
    """Weights of a run as stated [kg m]."""
    return np.asarray(m.conditions.unbalance)[int(np.argmax(m.run == run))]


def _left_in(m: Measurement, run: int, added: Pair, error: float) -> str:
    """That the weight of another run was left in, if an unbalance is that weight."""
    for other in (k for k in range(len(m.runs)) if k != run):
        weight = _installed(m, other)[0]
        size = float(np.linalg.norm(weight))
        if size > 0.0 and np.linalg.norm(added - weight) < max(CLOSE * error, NEAR_USUAL * size):
            return f"; it is as if the weight of run {m.runs[other]} had been left in"
    return ""


def _bow(m: Measurement, run: int, x: Value, y: Value) -> tuple[str, str, partial[Stated]]:
    added, name = np.array([x.value, y.value]), m.runs[run]
    bow = _vector(added, x, y, unit=MICROMETRE, words="µm")
    meaning = f"a bow of {bow} (from +x in the sense of rotation) bent the shaft in run {name} and in no other"
    cure = f"[runs.{name}] bow: state it, or measure the run again with the shaft as straight as in the others"
    return meaning, cure, partial(_with_bow_added, run=run, added=added)


def _phase(m: Measurement, run: int, angle: Value) -> tuple[str, str, partial[Stated]]:
    degrees, error, name = math.degrees(angle.value), math.degrees(angle.error), m.runs[run]
    way = "lead" if degrees > 0.0 else "lag"
    meaning = (
        f"the phases of run {name} {way} those of the other runs by {_with_error(abs(degrees), error)}° "
        "(n times that at order n): its phase reference was elsewhere"
    )
    back = "lead less" if degrees > 0.0 else "lag less"
    cure = f"the table: let all phases of run {name} {back} by {abs(degrees):.3g}°"
    return meaning, cure, partial(_with_phases_turned, run=run, angle=angle.value)


def _amplitude(m: Measurement, run: int, gain: Value) -> tuple[str, str, partial[Stated]]:
    factor, name = 1.0 + gain.value, m.runs[run]
    meaning = f"the amplitudes of run {name} are {_with_error(factor, gain.error)} times those of the other runs"
    cure = f"the table: divide amplitude_um and sigma_um of run {name} by {factor:.3g}"
    return meaning, cure, partial(_with_amplitudes_divided, run=run, factor=factor)


def _speed(m: Measurement, run: int, error: Value) -> tuple[str, str, partial[Stated]]:
    name, percent = m.runs[run], 100.0 * abs(error.value)
    way = "higher" if error.value > 0.0 else "lower"
    meaning = f"the speeds of run {name} are {_with_error(percent, 100.0 * error.error)} % {way} than stated"
    cure = f"the table: multiply speed_rpm of run {name} by {1.0 + error.value:.5g}"
    return meaning, cure, partial(_with_speeds_times, run=run, factor=1.0 + error.value)


_SAID = {
    RunUnbalance.name: _unbalance, RunBow.name: _bow, RunPhase.name: _phase, RunAmplitude.name: _amplitude,
    RunSpeed.name: _speed,
}  # fmt: skip


def is_same_run(one: Mistake, other: Mistake) -> bool:
    """Whether both are about one run: an unbalance does at 1X what a turned phase or another amplitude does, with one
    value more. A factor of the amplitudes by which conventions and units differ is no chance.
    """
    both = one.kind in RUN_EFFECTS and other.kind in RUN_EFFECTS and one.about == other.about
    return both and not any(_is_usual(mistake) for mistake in (one, other))


def _is_usual(mistake: Mistake) -> bool:
    if mistake.kind != RunAmplitude.name or not isinstance(mistake.corrected, partial):
        return False
    factor = mistake.corrected.keywords.get("factor", 1.0)
    return any(abs(factor / usual**power - 1.0) < NEAR_USUAL for usual in USUAL for power in (1, -1))


def weights_that_tell_amplitudes(model: Model, measurement: Measurement) -> Float[np.ndarray, "weight plane xy"]:
    """The different weights that were installed, if they alone tell how large the vibration is [kg m]; none where an
    installed bow, the sag or a nonlinear force does, too.
    """
    at = measurement.conditions
    weights = np.unique(np.round(np.asarray(at.unbalance), 12), axis=0)
    weights = weights[np.any(weights != 0.0, axis=(1, 2))]
    sag = 0.0 in measurement.orders and np.any(np.asarray(model.rotor.gravity))
    told = np.any(np.asarray(at.bow)) or sag or is_coupled(model)
    return weights[:0] if told else weights


def as_other_weights(model: Model, measurement: Measurement) -> str | None:
    """The weights that would do what a common gain and phase of everything read does: the vectors change with c w, w a
    weight and c gain and phase, and unbalance and bow are not known beforehand. One weight may be another by c; several
    are all larger by a common factor at most, as by their radius.

    None where something else tells the two apart: an installed bow, the sag, a nonlinear force.
    """
    weights = weights_that_tell_amplitudes(model, measurement)
    if not len(weights):
        return None
    gain = model.find(ChainGain.name)
    factor = 1.0 if gain is None else 1.0 + complex(*map(float, gain.values()))
    without_gain = abs(abs(factor) - 1.0) < NEAR_USUAL
    factor *= float(model.probes.scale)
    if len(weights) > 1 or weights.shape[1] > 1:
        if without_gain:
            return None
        return (
            f"{ABOUT_WEIGHTS} that are all {abs(factor):.3g} times as large as stated (their radius?), or mass, "
            f"stiffness and damping all {1.0 / abs(factor):.3g} times as large, would do what a gain of the measuring "
            "chain does"
        )
    if (offset := model.find(PhaseReferenceOffset.name)) is not None:
        factor *= np.exp(1j * float(offset.values()[0]))
    stated = complex(*weights[0, 0])
    shown = [_vector(np.array([w.real, w.imag])) for w in (factor * stated, stated)]
    return (
        f"one weight does not tell the measuring chain from {ABOUT_WEIGHTS} that are not as stated: {shown[0]} (from "
        f"+x in the sense of rotation) instead of {shown[1]} would do the same"
    )


def _vector(pair: Pair, *errors: Value, unit: float = GRAM_MILLIMETRE, words: str = "g mm") -> str:
    """Size and angle, with the standard error of the size."""
    size, angle = float(np.hypot(*pair)) / unit, math.degrees(math.atan2(pair[1], pair[0])) % 360.0
    error = math.hypot(*(one.error for one in errors)) / math.sqrt(2.0) / unit if errors else 0.0
    return f"{_with_error(size, error)} {words} at {angle:.0f}°"


def _with_error(value: float, error: float) -> str:
    """A value, with its standard error if it has one, to the digit that this leaves."""
    if error <= 0.0:
        return figures(value) if value >= 1e3 else f"{value:.3g}"
    digits = max(0, 1 - math.floor(math.log10(error)))
    return f"{value:.{digits}f} ± {error:.{digits}f}"


def _with_odd_run(model: Model, m: Measurement, *, run: int) -> Stated:
    return model, dataclasses.replace(m, odd_run=run)


def _with_probes_exchanged(model: Model, m: Measurement, *, run: int) -> Stated:
    place = np.arange(len(m.probes))
    place[np.isin(m.probes, m.probes_read)] = place[np.isin(m.probes, m.probes_read)][::-1]
    own = (m.run == run)[:, None, None]
    vectors, present = (np.where(own, part[:, place], part) for part in (m.vectors, m.present))
    sigma = None if m.sigma is None else np.where(own, m.sigma[:, place], m.sigma)
    return model, dataclasses.replace(m, vectors=vectors, present=present, sigma=sigma)


def _with_unbalance_added(model: Model, m: Measurement, *, run: int, added: Pair) -> Stated:
    unbalance = np.array(m.conditions.unbalance)
    unbalance[m.run == run, 0] += added / float(np.asarray(model.participation)[0])
    return model, dataclasses.replace(with_installed(m, unbalance, np.asarray(m.conditions.bow)), odd_run=None)


def _with_bow_added(model: Model, m: Measurement, *, run: int, added: Pair) -> Stated:
    bow = np.array(m.conditions.bow)
    bow[m.run == run] += added
    return model, dataclasses.replace(with_installed(m, np.asarray(m.conditions.unbalance), bow), odd_run=None)


def _with_phases_turned(model: Model, m: Measurement, *, run: int, angle: float) -> Stated:
    turn = np.exp(-1j * angle * np.array(m.orders)) * np.ones(len(m.run))[:, None]
    turn[m.run != run] = 1.0
    return model, dataclasses.replace(m, vectors=m.vectors * turn[:, None], odd_run=None)


def _with_speeds_times(model: Model, m: Measurement, *, run: int, factor: float) -> Stated:
    at = m.conditions
    speed = as_array(np.asarray(at.speed) * np.where(m.run == run, factor, 1.0))
    there = Conditions(speed, at.unbalance, at.bow, at.sweep)
    return model, dataclasses.replace(m, conditions=there, odd_run=None)


def _with_amplitudes_divided(model: Model, m: Measurement, *, run: int, factor: float) -> Stated:
    by = np.where(m.run == run, factor, 1.0)[:, None, None]
    sigma = None if m.sigma is None else m.sigma / np.abs(by)
    return model, dataclasses.replace(m, vectors=m.vectors / by, sigma=sigma, odd_run=None)
