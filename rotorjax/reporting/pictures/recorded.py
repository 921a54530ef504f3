"""The pictures of recordings: waveforms, orbits and spectra as recorded."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from rotorjax.data.record_vectors import Record, Records
from rotorjax.data.rig import Rig
from rotorjax.data.spectra import FEWEST_TURNS, Spectra, full_spectrum, spectra
from rotorjax.diagnosis.orbits import Pair, probe_pairs, recorded_orbit
from rotorjax.model.rotor import Jeffcott
from rotorjax.reporting import plots

MOST_SAMPLES = 2_000_000
"""Of a recording, from its beginning, that pictures are drawn of."""
MOST_RUNS = 6
"""Runs of which an orbit is shown."""
SHOWN_TURNS = 4
"""Revolutions of a waveform."""
FEWEST_SPEEDS = 4
"""Of a run whose vectors are shown over speed."""
SPECTRA = 30
"""Of a recording whose speed changes."""
FEWEST_SPECTRA = 3
"""In a cascade."""
STEP_HZ = 1.0
"""Between the lines of a spectrum, unless a recording is shorter than a second."""


class Trace(NamedTuple):
    """Samples of a recording, or the beginning of them."""

    time: Float[np.ndarray, "sample"]
    displacement: Float[np.ndarray, "sample probe"]
    pulses: Float[np.ndarray, "_"]

    @classmethod
    def of(cls, record: Record) -> "Trace":
        """The samples between the first and the last pulse, at most `MOST_SAMPLES`."""
        times, waves, count = [], [], 0
        for time, _, displacement in record.found.pieces():
            times.append(time)
            waves.append(displacement)
            count += len(time)
            if count >= MOST_SAMPLES:
                break
        time, wave = np.concatenate(times)[:MOST_SAMPLES], np.concatenate(waves)[:MOST_SAMPLES]
        marks = record.found.pulses.pulses
        return cls(time, wave, marks[(marks >= time[0]) & (marks <= time[-1])])


def recorded_pictures(rig: Rig, records: Records) -> list[tuple[str, bytes]]:
    """Caption and SVG: 1X over speed, where there are some speeds; of every run the steady recording with the largest
    vibration; then cascades and waterfalls of the run with the largest vibration.
    """
    probes = records.records[0].probes
    pairs = probe_pairs(rig.model, probes)
    lag = rig.convention.phase == "lag"
    figures = [*_over_speed(records, probes, lag=lag), *_steady(rig, records, pairs), *_stacked(records, probes)]
    return [(caption, plots.svg(drawn)) for caption, drawn in figures]


def _over_speed(records: Records, probes: Sequence[str], *, lag: bool) -> Iterator[tuple[str, Figure]]:
    """1X of every probe over speed, of the runs with vectors at some speeds."""
    points: dict[str, list[tuple[float, np.ndarray]]] = {}
    for record in records.records:
        first = record.orders.index(1.0) if 1.0 in record.orders else None
        own = [] if first is None else [(point.speed_rpm, point.vectors[:, first]) for point in record.points]
        points.setdefault(record.run, []).extend(own)
    enough = [run for run, own in points.items() if len({speed for speed, _ in own}) >= FEWEST_SPEEDS][:MOST_RUNS]
    if not enough:
        return
    drawn, axes = plots.figure(4.0 + 4.0 * len(probes), 5.0, 2, len(probes))
    speeds, vectors = ({run: np.array([one[part] for one in points[run]]) for run in enough} for part in (0, 1))
    for k, probe in enumerate(probes):
        runs = {run: (speeds[run], vectors[run][:, k]) for run in enough}
        plots.measured_bode(axes[k], axes[k + len(probes)], runs, what=f"{plots.plain(probe)} 1X", lag=lag)
    if len(enough) > 1:
        plots.legend_above(axes[0], most=3)
    yield "Amplitude and phase of 1X over speed, as the recordings give them.", drawn


def _steady(rig: Rig, records: Records, pairs: Sequence[Pair]) -> Iterator[tuple[str, Figure]]:
    """Waveform, orbit and full spectrum."""
    rotor, angle = rig.model.rotor, np.asarray(rig.model.probes.angle)
    assert isinstance(rotor, Jeffcott)
    runs = list(dict.fromkeys(record.run for record in records.records if record.steady))
    for run in runs[:MOST_RUNS] if pairs else []:
        record = max((r for r in records.records if r.run == run and r.steady), key=lambda r: r.largest)
        trace, pair = Trace.of(record), list(pairs[0])
        if len(trace.pulses) <= FEWEST_TURNS + 1:
            continue
        wave, spin = trace.displacement[:, pair], int(rotor.spin)
        degrees = (float(np.degrees(angle[pair[0]])), float(np.degrees(angle[pair[1]])))
        names = [record.probes[k] for k in pair]
        drawn, (left, middle, right) = plots.figure(12.5, 4.2, 1, 3)
        shown = (trace.time >= trace.pulses[0]) & (trace.time <= trace.pulses[min(SHOWN_TURNS, len(trace.pulses) - 1)])
        vibration = wave[shown] - np.mean(wave[shown], axis=0)
        plots.waveform(left, trace.time[shown], vibration, trace.pulses, probes=names)
        orbit = recorded_orbit(*trace._replace(displacement=wave), probe_angle_deg=degrees, spin=spin)
        plots.record_orbit(middle, orbit, probes=dict(zip(names, np.radians(degrees).tolist(), strict=True)))
        spectrum = full_spectrum(*trace._replace(displacement=wave), probe_angle_deg=degrees, spin=spin)
        plots.full_spectrum(right, spectrum)
        caption = (
            f"{record.run}, {orbit.speed_rpm:.0f} rpm ({record.file}): displacement over the first revolutions, less "
            "its mean; orbit, x to the right and y up; full spectrum, forward circles to the right and backward ones "
            "to the left."
        )
        yield caption, drawn


def _stacked(records: Records, probes: Sequence[str]) -> Iterator[tuple[str, Figure]]:
    """Spectra of the run with the largest vibration one behind the other: over speed, and of a recording whose speed
    changes over time.
    """
    run = max(records.records, key=lambda record: record.largest).run
    own = [record for record in records.records if record.run == run]
    found = {record.file: _spectra_of(Trace.of(record), record.steady) for record in own}
    for k, probe in enumerate(probes):
        together = _together([each[k] for each in found.values() if each])
        if together is None or len(together.speed_rpm) < FEWEST_SPECTRA:
            continue
        drawn, (axes,) = plots.figure(7.5, 5.0)
        plots.cascade(axes, together)
        yield f"{run}, probe {probe}: spectra, each raised to its speed; dashed: orders.", drawn
    for record in own:
        if not record.steady and found[record.file]:
            drawn, axes = plots.figure(12.5, 5.0, 1, len(probes))
            for each, one, probe in zip(axes, found[record.file], probes, strict=True):
                plots.waterfall(each, one)
                each.set_title(f"probe {plots.plain(probe)}")
            yield f"{run} ({record.file}): spectra, each raised to its time; dashed: orders.", drawn
            break


def _spectra_of(trace: Trace, steady: bool) -> list[Spectra]:
    """Of every probe; none where the recording is too short, or not evenly sampled."""
    inside = trace.pulses[-1] - trace.pulses[0] if len(trace.pulses) > 1 else 0.0
    step = max(STEP_HZ, 1.05 / inside) if inside > 0.0 else STEP_HZ
    try:
        return [
            spectra(trace.time, wave, trace.pulses, step_hz=step, count=1 if steady else SPECTRA)
            for wave in trace.displacement.T
        ]
    except ValueError:
        return []


def _together(parts: Sequence[Spectra]) -> Spectra | None:
    """Spectra of several recordings at the frequencies of the coarsest."""
    if not parts:
        return None
    frequency = min((one.frequency_hz for one in parts), key=len)
    amplitude = np.array([np.interp(frequency, one.frequency_hz, row) for one in parts for row in one.amplitude])
    return Spectra(
        np.concatenate([one.time for one in parts]),
        np.concatenate([one.speed_rpm for one in parts]),
        frequency,
        amplitude,
    )
