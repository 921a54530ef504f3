"""What may have been written down wrongly: changes of what rig file and table state, each without a parameter."""

import dataclasses
import itertools
import math
from collections.abc import Callable, Collection, Iterator
from functools import partial
from typing import NamedTuple

import equinox as eqx
import numpy as np

from rotorjax.arrays import as_array
from rotorjax.data.knowledge import PEAK, Amplitude, Uncertain, peak_of
from rotorjax.data.measurement import Measurement
from rotorjax.model.conditions import Conditions
from rotorjax.model.model import Model
from rotorjax.units import MILLIMETRE, RPM

MIL = 25.4
"""A thousandth of an inch, in µm."""
FEW_RUNS, MOST_ABOUT_RUNS = 4, 8
"""Runs from which on influence coefficients choose among changes of what was installed, and how many they leave."""
KINDS = (
    "rotation_reversed",
    "weight_angles_reversed",
    "phase_sign_reversed",
    "phase_unit",
    "amplitude_halved",
    "amplitude_doubled",
    "amplitude_rms",
    "amplitude_peak",
    "amplitude_peak_to_peak",
    "amplitude_unit",
    "probes_exchanged",
    "probe_reversed",
    "weight_absent",
    "weight_direction",
    "runs_exchanged",
    "trial_weight_absent",
    "trial_weight_opposite",
    "weights_unit",
    "slow_roll_subtracted",
    "run_unbalance",
    "run_bow",
    "run_phase",
    "run_amplitude",
    "run_speed",
    "run_probes_exchanged",
    "wrong_reading",
)
"""All kinds of changes, by name."""
OF_WEIGHT = ("weight_absent", "weight_direction")
"""Those that change the weight of the rotor: what balancing weights do, `weight_angles_reversed`, is none of them."""
OF_RUNS = ("runs_exchanged", "trial_weight_absent", "trial_weight_opposite")
"""Those of what was installed in single runs."""
OF_READING = tuple(kind for kind in KINDS if kind.startswith(("amplitude", "phase", "probe")))
"""Those of how the table is to be read."""

WEIGHT_UNITS = {
    "kg": (1000.0, "in kg mm", "multiply every magnitude_g_mm by 1000"),
    "cm": (10.0, "in g cm", "multiply every magnitude_g_mm by 10"),
    "g": (math.nan, "in g, without the radius", "multiply every magnitude_g_mm by the radius of its plane in mm"),
}
"""Unit in which all weights may be given where g mm are stated -> factor, words, cure."""

Stated = tuple[Model, Measurement]
"""What rig file and table state, as a model and a measurement."""


class Mistake(NamedTuple):
    """One way in which what was written down may differ from what was done."""

    kind: str
    """Name of the alternative, without what it is about."""
    about: tuple[str, ...]
    """The probe or the runs that it is about, if any."""
    meaning: str
    cure: str
    """What to change, and where."""
    corrected: Callable[[Model, Measurement], Stated]
    """Model and measurement as they are if it was made; what is compiled serves both. It can be pickled."""
    in_mirror: bool = False
    """Whether that model is the rotor seen in a mirror, its rotation reversed."""
    uncertain: tuple[Uncertain, ...] = ()
    """Values of one run that are fitted along with it (`rotorjax.effects.of_one_run`); none once they are settled."""

    @property
    def name(self) -> str:
        """As it stands beside effects: ``trial_weight_opposite.RUN``."""
        return ".".join((self.kind, *self.about))

    @property
    def of_amplitudes(self) -> bool:
        """Whether all amplitudes are in another unit, or of another kind, than is stated."""
        return self.kind in TRUE_AMPLITUDES or self.kind == "amplitude_unit"

    def put_right(self, model: Model, measurement: Measurement) -> Stated:
        """Model and measurement as they should have been stated."""
        return (reversed_rotation(model), measurement) if self.in_mirror else self.corrected(model, measurement)


class AmplitudeChange(NamedTuple):
    """Amplitudes of the whole table too large by a factor, too small where it is below one."""

    kind: str
    about: tuple[str, ...]
    factor: float
    mean_factor: float
    """Of what is constant, at order 0."""
    meaning: str
    cure: str


_MILS = "the table: {} amplitude_um and sigma_um by 25.4"
TRUE_AMPLITUDES: dict[str, Amplitude] = {
    "amplitude_doubled": "peak-to-peak",
    "amplitude_halved": "peak",
    "amplitude_rms": "rms",
    "amplitude_peak": "peak",
    "amplitude_peak_to_peak": "peak-to-peak",
}
"""What amplitudes are, for each kind of mistake about them."""
_DOUBLED, _HALVED = ("peak", "peak-to-peak"), ("peak-to-peak", "peak")


def amplitude_changes(stated: Amplitude | None) -> list[AmplitudeChange]:
    """What a factor common to all amplitudes may come from. **Arguments:** ``stated``: what they are said to be, none
    where they were not written in a table.
    """
    if stated is None:
        return []
    changes = []
    for true, peak in PEAK.items():
        if true != stated:
            named = {_DOUBLED: "amplitude_doubled", _HALVED: "amplitude_halved"}
            kind = named.get((stated, true), f"amplitude_{true.replace('-', '_')}")
            meaning = f"amplitudes are {true} where {stated} is stated"
            cure = f'[convention] amplitude: write "{true}"'
            of_mean = peak_of(stated, 0.0) / peak_of(true, 0.0)
            changes.append(AmplitudeChange(kind, (), PEAK[stated] / peak, of_mean, meaning, cure))
    unit = "amplitude_unit"
    return [
        *changes,
        AmplitudeChange(unit, (), 1.0 / MIL, 1.0 / MIL, "amplitudes are in mil, not in µm", _MILS.format("multiply")),
        AmplitudeChange(unit, ("mil",), MIL, MIL, "amplitudes were converted from mil twice", _MILS.format("divide")),
    ]


def mistakes(model: Model, measurement: Measurement, kinds: Collection[str] = KINDS) -> list[Mistake]:
    """All alternatives of some ``kinds`` to what a rig file and a table state that would change anything."""
    makers = (_rotation, _angles, _phase, _phase_unit, _amplitudes, _probes, _weight, _slow_roll, _runs, _weights_unit)
    return [mistake for make in makers for mistake in make(model, measurement) if mistake.kind in kinds]


def promising(model: Model, measurement: Measurement, every: list[Mistake]) -> list[Mistake]:
    """Alternatives without those about runs that leave influence coefficients much to explain.

    Whatever linear rotor it is, vectors at one speed, of one probe and order, are a constant plus one complex number
    for each plane, and for the bow, times what is installed. Of many runs those changes are kept that leave the least
    beside that.
    """
    about_runs = [mistake for mistake in every if mistake.kind in OF_RUNS]
    if len(measurement.runs) < FEW_RUNS or len(about_runs) <= MOST_ABOUT_RUNS:
        return every
    left = {mistake.name: beside_influence(mistake.corrected(model, measurement)[1]) for mistake in about_runs}
    kept = set(sorted(left, key=lambda name: left[name])[:MOST_ABOUT_RUNS])
    return [mistake for mistake in every if mistake.name not in left or mistake.name in kept]


def beside_influence(m: Measurement) -> float:
    """Squares that influence coefficients leave of the vectors, in those of the noise."""
    installed = np.concatenate([np.asarray(m.conditions.unbalance), np.asarray(m.conditions.bow)[:, None]], axis=1)
    design = np.concatenate([np.ones((len(m.run), 1)), installed[..., 0] + 1j * installed[..., 1]], axis=1)
    design = design[:, np.any(design != 0.0, axis=0)]
    cluster, speeds = m.speed_cluster()
    weight, total = m.weights(0.0 if m.sigma is not None else m.rms)[..., 0], 0.0
    for speed in range(len(speeds)):
        for probe, order in np.ndindex(m.vectors.shape[1:]):
            cases = (cluster == speed) & m.present[:, probe, order]
            if cases.any():
                by = weight[cases, probe, order]
                rows, wanted = by[:, None] * design[cases], by * m.vectors[cases, probe, order]
                total += float(np.sum(np.abs(wanted - rows @ np.linalg.lstsq(rows, wanted)[0]) ** 2))
    return total


def _rotation(model: Model, _: Measurement) -> Iterator[Mistake]:
    """With reversed rotation x to y: the same rotor seen in a mirror, so that nothing need be compiled anew."""
    if len(model.layout.probes) < 2 or not hasattr(model.rotor, "rotation"):
        return
    meaning = "the shaft turns the other way than the rig file says"
    yield Mistake("rotation_reversed", (), meaning, "[convention] rotation: write the other sense", _in_mirror, True)


def reversed_rotation(model: Model) -> Model:
    """The model with a shaft that turns the other way."""
    other = {"x-to-y": "y-to-x", "y-to-x": "x-to-y"}[getattr(model.rotor, "rotation", "x-to-y")]
    return dataclasses.replace(model, rotor=dataclasses.replace(model.rotor, rotation=other))  # pyright: ignore


def _angles(_: Model, m: Measurement) -> Iterator[Mistake]:
    unbalance, bow = np.asarray(m.conditions.unbalance), np.asarray(m.conditions.bow)
    if not np.any(unbalance[..., 1]) and not np.any(bow[..., 1]):
        return
    meaning = "angles of weights were counted in the other sense than the rig file says"
    cure = "[convention] weight_angles: write the other of with-rotation and against-rotation"
    yield Mistake("weight_angles_reversed", (), meaning, cure, _with_other_angles)


def _phase(_: Model, m: Measurement) -> Iterator[Mistake]:
    if m.knowledge.amplitude is not None and np.any(np.imag(m.vectors[m.present])):
        meaning, cure = "phases lag where the rig file says lead, or the reverse", "[convention] phase: write the other"
        yield Mistake("phase_sign_reversed", (), meaning, cure, _with_other_phases)


def _phase_unit(_: Model, m: Measurement) -> Iterator[Mistake]:
    """Radians, where no phase is more than a turn of them."""
    largest = float(np.max(np.abs(np.angle(m.vectors[m.present])), initial=0.0))
    if m.knowledge.amplitude is not None and 0.0 < largest <= math.radians(math.tau):
        meaning, cure = "phases are in radians, not in degrees", "the table: multiply phase_deg by 57.29578"
        yield Mistake("phase_unit", (), meaning, cure, _with_phases_of_radians)


def _amplitudes(_: Model, m: Measurement) -> Iterator[Mistake]:
    """Numbers of the table that are too large or too small by a factor: all that is read, in that scale."""
    if m.rms == 0.0:
        return
    for kind, about, factor, of_mean, meaning, cure in amplitude_changes(m.knowledge.amplitude):
        yield Mistake(kind, about, meaning, cure, partial(_read_in_scale, factor=factor, of_mean=of_mean))


def _probes(model: Model, m: Measurement) -> Iterator[Mistake]:
    names = m.probes_read
    for one, other in itertools.combinations(names, 2):
        order = np.arange(len(model.layout.probes))
        pair = [model.layout.probes.index(one), model.layout.probes.index(other)]
        order[pair] = order[pair[::-1]]
        about = (one, other) if len(model.layout.probes) > 2 else ()
        cure = f"[probes]: exchange the directions of {one} and {other}"
        meaning = f"the cables of probes {one} and {other} are exchanged"
        yield Mistake("probes_exchanged", about, meaning, cure, partial(_with_probes_in_order, order=order))
    for name in names:
        meaning = f"probe {name} has its sign reversed, or looks from the other side"
        cure = f"[probes] {name}: add 180 to angle_deg"
        yield Mistake("probe_reversed", (name,), meaning, cure, partial(_with_probe_reversed, name=name))


def _weight(model: Model, _: Measurement) -> Iterator[Mistake]:
    gravity = getattr(model.rotor, "gravity", None)
    if gravity is None or not np.any(np.asarray(gravity)):
        return
    for kind, factor, meaning, cure in (
        ("weight_absent", 0.0, "the shaft is vertical, where the rig file states gravity", '"none"'),
        (
            "weight_direction",
            -1.0,
            "gravity acts in the opposite direction to what the rig file says",
            "the other direction",
        ),
    ):
        yield Mistake(kind, (), meaning, f"[rotor] gravity: write {cure}", partial(_with_weight, factor=factor))


def _slow_roll(model: Model, _: Measurement) -> Iterator[Mistake]:
    stated = model.slow_roll is not None
    meaning = "was not subtracted, as the rig file says" if stated else "was subtracted, as the rig file does not say"
    cure = f"[convention] slow_roll_subtracted: write {'false' if stated else 'true'}"
    yield Mistake("slow_roll_subtracted", (), f"the slow-roll vector {meaning}", cure, _with_other_slow_roll)


def _runs(_: Model, m: Measurement) -> Iterator[Mistake]:
    """Weights that were not where the rig file says, run by run."""
    first = [int(np.argmax(m.run == k)) for k in range(len(m.runs))]
    unbalance, bow = np.asarray(m.conditions.unbalance)[first], np.asarray(m.conditions.bow)[first]
    for k, run in enumerate(m.runs):
        if not np.any(unbalance[k]):
            continue
        for kind, factor, meaning, cure in (
            ("trial_weight_absent", 0.0, "was not installed", "take unbalance out"),
            ("trial_weight_opposite", -1.0, "sat opposite to where the rig file says", "add 180 to angle_deg"),
        ):
            right = partial(_with_weight_of_run, run=k, factor=factor)
            yield Mistake(kind, (run,), f"the weight of run {run} {meaning}", f"[runs.{run}]: {cure}", right)
    for a, b in itertools.combinations(range(len(m.runs)), 2):
        if np.array_equal(unbalance[a], unbalance[b]) and np.array_equal(bow[a], bow[b]):
            continue
        right = partial(_with_runs_exchanged, runs=(a, b), unbalance=unbalance, bow=bow)
        about = min(m.runs[a], m.runs[b]), max(m.runs[a], m.runs[b])
        cure = f"[runs]: exchange what {about[0]} and {about[1]} hold"
        yield Mistake("runs_exchanged", about, f"runs {about[0]} and {about[1]} are exchanged", cure, right)


def _weights_unit(_: Model, m: Measurement) -> Iterator[Mistake]:
    """All weights in another unit; in g where the radius of every plane is stated."""
    unbalance = np.asarray(m.conditions.unbalance)
    if not np.any(unbalance):
        return
    radii = m.knowledge.plane_radii_m
    for unit, (factor, words, cure) in WEIGHT_UNITS.items():
        factors = np.full(unbalance.shape[1], factor)
        if unit == "g":
            if len(radii) != unbalance.shape[1] or None in radii:
                continue
            factors = np.array(radii, dtype=float) / MILLIMETRE
        meaning = f"the weights of all runs are given {words}, not in g mm"
        yield Mistake(
            "weights_unit", (unit,), meaning, f"[runs]: {cure}", partial(_with_weights_times, factors=factors)
        )


def _in_mirror(model: Model, m: Measurement) -> Stated:
    mirrored = dataclasses.replace(model.probes, angle=as_array(-np.asarray(model.probes.angle)))
    return dataclasses.replace(_with_gravity(model, np.array([1.0, -1.0])), probes=mirrored), m


def _with_other_angles(model: Model, m: Measurement) -> Stated:
    turned = np.array([1.0, -1.0])
    return model, with_installed(m, np.asarray(m.conditions.unbalance) * turned, np.asarray(m.conditions.bow) * turned)


def _with_other_phases(model: Model, m: Measurement) -> Stated:
    return model, dataclasses.replace(m, vectors=np.conj(m.vectors))


def _with_phases_of_radians(model: Model, m: Measurement) -> Stated:
    turned = np.abs(m.vectors) * np.exp(1j * np.degrees(np.angle(m.vectors)))
    return model, dataclasses.replace(m, vectors=turned)


def _read_in_scale(model: Model, m: Measurement, *, factor: float, of_mean: float) -> Stated:
    scales = {
        "scale": as_array(np.asarray(float(model.probes.scale) * factor)),
        "mean_scale": as_array(np.asarray(float(model.probes.mean_scale) * of_mean)),
    }
    return dataclasses.replace(model, probes=dataclasses.replace(model.probes, **scales)), m


def _with_probes_in_order(model: Model, m: Measurement, *, order: np.ndarray) -> Stated:
    leaves = (as_array(np.asarray(part)[order]) for part in _parts(model))
    return eqx.tree_at(_parts, model, tuple(leaves)), m


def _with_probe_reversed(model: Model, m: Measurement, *, name: str) -> Stated:
    return _with_participation(model, np.where(np.array(model.layout.probes) == name, -1.0, 1.0)), m


def _with_weight(model: Model, m: Measurement, *, factor: float) -> Stated:
    return _with_gravity(model, np.full(2, factor)), m


def _with_other_slow_roll(model: Model, m: Measurement) -> Stated:
    speed = None if model.slow_roll is not None else as_array(np.asarray(m.knowledge.slow_roll_rpm * RPM))
    return dataclasses.replace(model, slow_roll=speed), m


def _with_weight_of_run(model: Model, m: Measurement, *, run: int, factor: float) -> Stated:
    there = np.where((m.run == run)[:, None, None], factor, 1.0)
    return model, with_installed(m, np.asarray(m.conditions.unbalance) * there, np.asarray(m.conditions.bow))


def _with_weights_times(model: Model, m: Measurement, *, factors: np.ndarray) -> Stated:
    return model, with_installed(m, np.asarray(m.conditions.unbalance) * factors[:, None], np.asarray(m.conditions.bow))


def _with_runs_exchanged(
    model: Model, m: Measurement, *, runs: tuple[int, int], unbalance: np.ndarray, bow: np.ndarray
) -> Stated:
    of = m.run.copy()
    of[m.run == runs[0]], of[m.run == runs[1]] = runs[::-1]
    return model, with_installed(m, unbalance[of], bow[of])


def _parts(model: Model) -> tuple:
    return model.probes.angle, model.probes.participation, model.probes.on_foundation


def _with_participation(model: Model, factor: np.ndarray) -> Model:
    changed = as_array(np.asarray(model.probes.participation) * factor)
    return dataclasses.replace(model, probes=dataclasses.replace(model.probes, participation=changed))


def _with_gravity(model: Model, factor: np.ndarray) -> Model:
    if getattr(model.rotor, "gravity", None) is None:
        return model
    return eqx.tree_at(lambda m: m.rotor.gravity, model, as_array(np.asarray(model.rotor.gravity) * factor))


def with_installed(m: Measurement, unbalance: np.ndarray, bow: np.ndarray) -> Measurement:
    """The measurement with other weights and bows installed, case by case."""
    there = Conditions(m.conditions.speed, as_array(unbalance), as_array(bow), m.conditions.sweep)
    return dataclasses.replace(m, conditions=there)


def log_odds(every: list[Mistake], family: float) -> dict[str, float]:
    """Logarithm of the prior odds of each mistake: those of the ``family`` shared by kind, then by member."""
    kinds = [mistake.kind for mistake in every]
    share = family / max(1, len(set(kinds)))
    return {mistake.name: math.log(share / kinds.count(mistake.kind)) for mistake in every}
