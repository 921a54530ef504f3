"""Recordings to vibration vectors: steady ones to one vector, run-ups and coast-downs to vectors against speed."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from rotorjax.data.files import resolved
from rotorjax.data.measurement import CLUSTER_WIDTH, Measurement, Row, is_half_order
from rotorjax.data.pulses import TURN
from rotorjax.data.record_points import (
    LEFT,
    MOST_LEFT,
    Point,
    bend,
    blocks,
    is_steady,
    point,
    rate_of,
    ringing,
    steady_plan,
    sweep_plan,
    together,
    wanted,
)
from rotorjax.data.record_scan import Progress, Scan, scan
from rotorjax.data.recordings import open_recording
from rotorjax.data.rig import Rig
from rotorjax.data.section import nearest
from rotorjax.data.table import Table
from rotorjax.data.waveform_sections import Recorded
from rotorjax.errors import InputError
from rotorjax.model.rotor import Jeffcott
from rotorjax.units import MICROMETRE, RPM

MUCH_LARGER = 5.0
"""Times 1X that a half order must be, at every probe, for the pulses to be suspected of coming twice per turn."""
TOO_FAST = 0.3
"""Shift from which its first order says little."""
MOST_SAID = 5
"""Instants named in one note."""
LEAST_UM = 1e-6
"""Standard error of a recording without any noise: a table takes no zero [µm]."""
ALLOWED_BIAS = 0.05
"""Shift of a vector by the sweep that ISO 7626-2 puts up with, too."""


@dataclasses.dataclass(frozen=True)
class Record:
    """What one recording gives."""

    file: str
    run: str
    probes: tuple[str, ...]
    orders: tuple[float, ...]
    steady: bool
    points: tuple[Point, ...]
    notes: tuple[str, ...]
    found: Scan = dataclasses.field(repr=False, compare=False)
    """The recording itself, to be read once more."""
    rate: float | None = None
    """At which its speed changes, where it does so steadily [rad/s²]: models then take it into account."""

    @property
    def largest(self) -> float:
        """Amplitude of the largest vector [m]; a constant, such as the voltage of the gap, is none where others are
        there.
        """
        moving = [n for n, order in enumerate(self.orders) if order > 0.0] or [0]
        return max(float(np.max(np.abs(point.vectors[:, moving]))) for point in self.points)


@dataclasses.dataclass(frozen=True)
class Records:
    """What recordings give, and notes on what was done to them."""

    records: tuple[Record, ...]
    notes: tuple[str, ...] = ()

    @property
    def all_notes(self) -> list[str]:
        """Those on all recordings, then those on each."""
        return [*self.notes, *(note for record in self.records for note in record.notes)]

    def rows(self) -> list[Row]:
        """Vectors as rows: amplitude zero-to-peak, phase leading; equal speeds of a run are told apart by ``repeat``.
        The standard error holds the shift by a sweep of which the rate cannot be stated.
        """
        rows, seen = [], dict[tuple[str, float], int]()
        for record in self.records:
            for each in record.points:
                speed = round(each.speed_rpm, 3)
                count = seen[record.run, speed] = seen.get((record.run, speed), 0) + 1
                for p, probe in enumerate(record.probes):
                    rows += [
                        _row(each, record, probe, (p, n), (speed, order), str(count) if count > 1 else "")
                        for n, order in enumerate(record.orders)
                    ]
        return rows

    def measurement(self, rig: Rig) -> Measurement:
        """The vectors as a measurement of the rig, with all notes.

        **Errors.** `InputError` as for a table.
        """
        rows = [rig.convention.to_table(row) for row in self.rows()]
        read = rig.measurement(Table(rows, [0] * len(rows), self.all_notes, []), rig.path)
        return dataclasses.replace(read, knowledge=dataclasses.replace(read.knowledge, amplitude=None))


def _row(each: Point, record: Record, probe: str, cell: tuple[int, int], at: tuple[float, float], repeat: str) -> Row:
    """One vector of a point, at a speed [rpm] and an order, in µm and degrees."""
    z = each.vectors[cell] / MICROMETRE
    sigma = float(np.hypot(each.sigma[cell], each.bias[cell])) / MICROMETRE
    amplitude, phase = float(f"{abs(z):.6g}"), round(float(np.degrees(np.angle(z))), 3)
    if at[1] == 0.0:
        phase = 0.0 if z.real >= 0.0 else 180.0
    rounded, rate = float(f"{max(sigma, LEAST_UM):.3g}"), float(f"{(record.rate or 0.0) / RPM:.6g}")
    return Row(record.run, at[0], probe, at[1], amplitude, phase, rounded, repeat, rate)


@threadpool_limits.wrap(limits=1, user_api="blas")
def read_recordings(
    rig: Rig,
    files: Sequence[Path] = (),
    *,
    orders: tuple[float, ...] | None = None,
    sample_rate_hz: float | None = None,
    progress: Progress = lambda line: None,
) -> Records:
    """Vibration vectors of recordings, with the channels, units and runs that a rig file states.

    **Arguments:** ``files``: recordings, by default those under [recordings]; ``orders`` instead of those under
    [waveform]; ``sample_rate_hz`` likewise; ``progress``: told what is being read. **Errors.** `InputError` with one
    line for each recording that cannot be used: file, channel and cure.
    """
    if orders is not None:
        rig = dataclasses.replace(rig, waveform=dataclasses.replace(rig.waveform, orders=orders))
    chosen = [_entry(rig, file) for file in files] or [
        (recorded, rig.path.parent / recorded.file) for recorded in rig.waveform.recordings
    ]
    if not chosen:
        raise InputError(f'{rig.path}: names no recordings; add [recordings."FILE"] with run = "NAME" for each')
    records, problems = [], []
    for recorded, path in chosen:
        try:
            records.append(_record(rig, recorded, path, sample_rate_hz, progress))
        except InputError as error:
            problems += error.problems
    if problems:
        raise InputError(*problems)
    return _above_slow_roll(rig, tuple(records), sample_rate_hz, progress)


def _entry(rig: Rig, file: Path) -> tuple[Recorded, Path]:
    """What the rig file says of a recording."""
    for recorded in rig.waveform.recordings:
        if resolved(rig.path.parent / recorded.file) == resolved(file):
            return recorded, file
    if file.stem not in rig.runs:
        raise InputError(
            f"{file}: {rig.path} does not say which run it holds, and no run is called {file.stem!r} "
            f'({nearest(file.stem, rig.runs)}); add [recordings."{file.name}"] with run = "NAME"'
        )
    return Recorded(file.name, file.stem), file


def _record(rig: Rig, recorded: Recorded, path: Path, rate: float | None, progress: Progress) -> Record:
    """Vectors of one recording."""
    found = scan(open_recording(path), rig.waveform, rate_hz=rate, progress=progress)
    marks = found.pulses.pulses
    steady = is_steady(marks)
    _check_speed(path, recorded, marks)
    rotor = rig.model.rotor
    assert isinstance(rotor, Jeffcott)
    orders = rig.waveform.orders
    plan = steady_plan(marks, found.step) if steady else sweep_plan(marks, found.step, rotor, orders)
    notes = _repairs(found)
    try:
        points = [point(found, rotor, orders, block, waves, steady) for block, waves in blocks(found, plan)]
    except ValueError as error:
        raise error if isinstance(error, InputError) else InputError(f"{path}: {error}") from error
    if steady:
        notes += _twice_per_turn(points)
        points = [together(points)]
    else:
        points = ringing(points, rotor)
    points, rate = [wanted(each, orders) for each in points], None if steady else rate_of(points)
    notes += _sweep_note(points, rotor, rate)
    if rate is not None:
        points = [
            dataclasses.replace(each, bias=np.minimum(LEFT * each.bias, MOST_LEFT * np.abs(each.vectors)))
            for each in points
        ]
    return Record(
        recorded.file, recorded.run, found.probes, orders, steady, tuple(points),
        tuple(f"{recorded.file}: {note}" for note in notes), found, rate,
    )  # fmt: skip


def _check_speed(path: Path, recorded: Recorded, marks: np.ndarray) -> None:
    """Refuse pulses at another rate than the speed that was stated.

    **Errors.** `InputError`.
    """
    if recorded.speed_rpm is None:
        return
    speeds = TURN / np.diff(marks) / RPM
    low, high = (float(edge) for edge in np.quantile(speeds, [0.05, 0.95]))
    mean = float((len(marks) - 1) * TURN / (marks[-1] - marks[0]) / RPM)
    if low * (1.0 - CLUSTER_WIDTH) <= recorded.speed_rpm <= high * (1.0 + CLUSTER_WIDTH):
        return
    times = mean / recorded.speed_rpm
    hint = f"; does the reference see {times:.0f} marks per turn?" if abs(times - round(times)) < 0.02 * times else ""
    raise InputError(
        f"{path}: its pulses come at {mean:.5g} rpm, {recorded.file} is said to have {recorded.speed_rpm:g} rpm{hint}; "
        "check threshold, sampling rate and speed_rpm"
    )


# What there is to say


def _repairs(found: Scan) -> list[str]:
    """What was done to the pulses."""
    lines = []
    for what, cure, instants in (
        ("missing, put in between its neighbours", "lower the threshold", found.pulses.missing),
        ("too many, left out", "raise the threshold", found.pulses.double),
    ):
        if len(instants):
            where = ", ".join(f"{instant:.6g}" for instant in instants[:MOST_SAID])
            more = f" and {len(instants) - MOST_SAID} more" if len(instants) > MOST_SAID else ""
            lines.append(
                f"{len(instants)} of {len(found.pulses.pulses)} pulses {what} (t = {where}{more} s); {cure} if there "
                "are many"
            )
    return lines


def _twice_per_turn(points: list[Point]) -> list[str]:
    """Whether the pulses may come twice per turn."""
    ratio = min(each.half_over_first for each in points)
    if ratio < MUCH_LARGER:
        return []
    return [
        f"the half order is {ratio:.3g} times 1X at every probe; unless the rotor whirls at half its speed, the "
        "reference fires twice per turn: state speed_rpm for the recording to have that checked"
    ]


def _sweep_note(points: list[Point], rotor: Jeffcott, rate: float | None) -> list[str]:
    """By how much the sweep shifts vectors, where that is more than their error, and whether models know of it."""
    seen = [each for each in points if np.any(each.bias > each.sigma)]
    if not seen:
        return []

    def share(each: Point) -> float:
        return float(np.max(np.where(each.bias > each.sigma, each.bias / np.abs(each.vectors), 0.0)))

    worst = max(seen, key=share)
    shifts = (
        f"shifts vectors there by some {share(worst):.0%} from those of a steady speed; {len(seen)} of {len(points)} "
        "speeds have more of it than noise"
    )
    if rate is not None:
        return [
            f"the speed changes by {rate / RPM:.3g} rpm/s, which near {worst.speed_rpm:.4g} rpm {shifts}. The model "
            "takes it into account (sweep_rpm_per_s)"
        ]
    slow = 2.0 * ALLOWED_BIAS / bend(rotor, worst.speed_rpm * RPM) / RPM
    fast = "; so fast a sweep leaves free vibration that beats with 1X and looks like a split resonance"
    return [
        f"the speed changes by {abs(worst.sweep) / RPM:.3g} rpm/s near {worst.speed_rpm:.4g} rpm, which {shifts}. As "
        f"its rate does not stay the same, it is counted in sigma_um; for {ALLOWED_BIAS:.0%} sweep at {slow:.2g} rpm/s"
        f"{fast if share(worst) > TOO_FAST else ''}"
    ]


def _above_slow_roll(rig: Rig, records: tuple[Record, ...], rate: float | None, progress: Progress) -> Records:
    """Vectors less those at slow roll, where the rig file asks for it.

    **Errors.** `InputError` where what was subtracted is not what [convention] declares.
    """
    file, declared = rig.waveform.slow_roll, rig.model.slow_roll
    if file is None and declared is None:
        return Records(records)
    if file is None:
        raise InputError(
            f"{rig.path}: [convention] says that slow roll was subtracted, vectors of recordings still hold it; name "
            'the recording of the slow roll, [waveform] slow_roll = "FILE", or leave slow_roll_subtracted out'
        )
    slow = _record(rig, Recorded(file, ""), rig.path.parent / file, rate, progress)
    speed = slow.points[0].speed_rpm
    if not slow.steady:
        raise InputError(f"{rig.path.parent / file}: its speed changes; record slow roll at a steady speed")
    if declared is None or abs(speed / (float(declared) / RPM) - 1.0) > CLUSTER_WIDTH:
        raise InputError(
            f"{rig.path}: [waveform] slow_roll has the vectors of {file} subtracted, and with them most of what a bow "
            f"shows; the model must know: write slow_roll_subtracted = true and slow_roll_rpm = {speed:.1f} under "
            "[convention], or leave slow_roll out"
        )
    kept = tuple(_less(record, slow) for record in records if record.file != file)
    return Records(
        kept,
        (f"slow-roll vectors of {file} ({speed:.4g} rpm) are subtracted, and with them most of what a bow shows",),
    )


def _less(record: Record, slow: Record) -> Record:
    """A record less the vectors at slow roll; not half orders, whose sign is open."""
    taken = np.array([not is_half_order(order) for order in record.orders])
    z, error = slow.points[0].vectors * taken, slow.points[0].sigma * taken
    points = tuple(
        dataclasses.replace(each, vectors=each.vectors - z, sigma=np.hypot(each.sigma, error)) for each in record.points
    )
    return dataclasses.replace(record, points=points)
