"""Vectors from waveforms: 1X to 3X of 100 records of 2 s at 12.8 kHz, beside pyPRB on the same records.

Each record has two probes and a phase reference of short pulses; the speed wanders by a few tenths of a per cent, as it
does, and noise is 1 % of 1X (40 dB). pyPRB (1.0.0) gives 1X of one channel at a call, by one of four methods, and takes
the speed as given: it is told the true mean speed, as its own detection takes a harmonic of short pulses for it. Its
detection, by the spectrum 256 times as fine of its documentation, is timed by itself. Ours gives three orders of both
probes with their standard errors, from finding the pulses on. Both run in one process; ratios count, not seconds. The
largest memory held is that of the process after ten records, and after all.

    python benchmarks/waveforms.py --output benchmarks/results
"""

import argparse
import resource
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import tabulate
from pyPRB.processing import (
    FFTExtraction,
    IQDemodulation,
    LeastSquaresFit,
    SynchronousAveraging,
    VibrationExtractor,
    detect_rotation_freq,
)
from timing import best, timed

from rotorjax.data.pulses import pulse_times
from rotorjax.data.signals import vectors_from_waveform
from rotorjax.reporting.tables import number

ABOUT = """Root mean square errors and time over 100 records of 2 s at 12.8 kHz with two probes; the speed wanders by
0.3 %, and noise is 1 % of 1X. pyPRB is told the true mean speed. Ours gives 1X to 3X with standard errors from finding
the pulses on. Written by `python benchmarks/waveforms.py --output benchmarks/results`."""
RATE, SECONDS, RECORDS, EARLY = 12_800.0, 2.0, 100, 10
WANDER, NOISE = 0.003, 0.01
PULSE = 8.0 / 360.0
"""Length of a pulse, in turns."""
ORDERS = (1.0, 2.0, 3.0)
METHODS = {
    "IQ demodulation": IQDemodulation,
    "least squares": LeastSquaresFit,
    "synchronous average": SynchronousAveraging,
    "FFT": FFTExtraction,
}


class Record(NamedTuple):
    """Samples, and what they were made of."""

    time: np.ndarray
    waves: np.ndarray
    reference: np.ndarray
    vectors: np.ndarray
    """Probe, order."""
    speed: float
    """Turns per second, the mean over the record."""


def record(seed: int) -> Record:
    """One record, by seed."""
    rng = np.random.default_rng([24, seed])
    time = np.arange(round(RATE * SECONDS)) / RATE
    speed, slow = rng.uniform(15.0, 60.0), rng.uniform(0.3, 1.5)
    turns = speed * time + WANDER * speed * np.sin(2.0 * np.pi * slow * time) / (2.0 * np.pi * slow) + rng.uniform()
    size = 50e-6 * np.array([1.0, 0.2, 0.05])
    vectors = size * rng.uniform(0.5, 1.0, (2, 3)) * np.exp(2j * np.pi * rng.uniform(size=(2, 3)))
    clean = np.real(np.exp(2j * np.pi * turns[:, None] * np.array(ORDERS)) @ vectors.T)
    noise = NOISE * np.abs(vectors[:, 0]) * rng.standard_normal(clean.shape)
    # An edge takes a few samples, as a recorder's filter makes it; turns are counted from the middle of a pulse.
    edge, apart = 1.5 * speed / RATE, np.abs((turns + 0.5) % 1.0 - 0.5)
    reference = 2.5 * (1.0 - np.tanh(2.0 * (apart - 0.5 * PULSE) / edge))
    return Record(time, clean + noise, reference, vectors, float((turns[-1] - turns[0]) / (time[-1] - time[0])))


def ours(one: Record) -> np.ndarray:
    """Probe, order; phases from the middle of the pulse."""
    found = vectors_from_waveform(one.time, one.waves, pulse_times(one.time, one.reference), orders=ORDERS)
    return found.vectors * np.exp(1j * np.pi * PULSE * np.array(ORDERS))


def theirs(one: Record, method: str) -> np.ndarray:
    """Probe, 1X alone."""
    extractor = VibrationExtractor(RATE, one.speed, METHODS[method]())
    found = [extractor.get_vibration_vector(column, one.reference) for column in one.waves.T]
    z = np.array([[each.amplitude * np.exp(1j * np.radians(each.phase))] for each in found])
    # Alone of the four this method counts from the edge.
    return z * np.exp(1j * np.pi * PULSE) if method == "synchronous average" else z


def row(name: str, extract: Callable[[Record], np.ndarray]) -> list[str]:
    """Errors and time of one way."""
    ratios, seconds, memory = [], 0.0, [0, 0]
    for seed in range(RECORDS):
        one = record(seed)
        found, took = timed(lambda one=one: extract(one))
        seconds += took
        ratios.append(found / one.vectors[:, : found.shape[1]])
        if seed in (EARLY - 1, RECORDS - 1):
            memory[seed == RECORDS - 1] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
    first = np.array(ratios)[..., 0]
    amplitude, phase = (float(np.sqrt(np.mean(part**2))) for part in (np.abs(first) - 1.0, np.angle(first, deg=True)))
    count, both = str(ratios[0].shape[1]), f"{memory[0]} / {memory[1]}"
    return [name, count, number(100.0 * amplitude, 2), number(phase, 2), number(1e3 * seconds / RECORDS, 2), both]


def detection() -> list[str]:
    """Time that pyPRB takes to find the speed of one record."""
    one = record(0)
    took = best(lambda: detect_rotation_freq(one.reference, RATE, max_freq=70.0, nfft_mult=256))
    return ["pyPRB, detection of the speed", "-", "-", "-", number(1e3 * took, 2), "-"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, help="folder for waveforms.md")
    output = parser.parse_args().output
    heads = ["", "orders", "1X amplitude %", "1X phase °", "ms per record", "memory MB, after 10 / 100"]
    peers = [row(f"pyPRB, {name}", lambda one, name=name: theirs(one, name)) for name in METHODS]
    rows = [row("rotorjax", ours), *peers, detection()]
    print(tabulate.tabulate(rows, heads, disable_numparse=True))
    if output:
        table = tabulate.tabulate(rows, heads, tablefmt="pipe", disable_numparse=True)
        (output / "waveforms.md").write_text(f"# Vectors from waveforms\n\n{ABOUT}\n\n{table}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
