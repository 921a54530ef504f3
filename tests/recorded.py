"""Recordings whose vectors are known: waveforms from a shaft angle in closed form; no code of the package."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from helpers import RIG

RATE = 6400.0
Z = {"X": 50e-6 * np.exp(0.7j), "Y": 40e-6 * np.exp(-1.1j)}
"""1X [m]."""
TWICE, SAG = 0.1, -80e-6
"""2X as a share of 1X; order 0 [m]."""


class Made(NamedTuple):
    """Time [s], reference [V], displacement of X and Y [m]."""

    time: np.ndarray
    reference: np.ndarray
    waves: np.ndarray


def angle(time, rpm=1500.0, sweep_rpm_s=0.0, start=1.0):
    return 2 * np.pi / 60 * (rpm * time + 0.5 * sweep_rpm_s * time**2) - start


def pulse(turned, width=0.8, edge=0.1):
    """Half its height at angle zero, with edges of a tenth of a radian."""
    turned = (turned + np.pi) % (2 * np.pi) - np.pi
    return 0.5 * (np.tanh(turned / edge) - np.tanh((turned - width) / edge))


def made(rng, *, seconds=1.0, rpm=1500.0, noise=0.0, rate=RATE, start=1.0) -> Made:
    time = np.arange(int(seconds * rate)) / rate
    turned = angle(time, rpm, start=start)
    z = np.array(list(Z.values()))
    waves = np.real(z * np.exp(1j * turned)[:, None] + TWICE * z * np.exp(2j * turned)[:, None]) + SAG
    return Made(time, 5.0 * pulse(turned), waves + noise * rng.standard_normal(waves.shape))


def as_csv(record: Made, path: Path, *, header="time_s,reference,X,Y", scale=1e6) -> Path:
    table = np.column_stack([record.time, record.reference, record.waves * scale])
    np.savetxt(path, table, delimiter=",", header=header, comments="", fmt="%.9g")
    return path


def rig_file(folder: Path, recordings: str, waveform: str = "", before: str = "") -> Path:
    """A rig file with recordings, each ``FILE=RUN``."""
    entries = "".join(
        f'[recordings."{file}"]\nrun = "{run}"\n' for file, run in (pair.split("=") for pair in recordings.split())
    )
    path = folder / "rig.toml"
    path.write_text(f"{before}{RIG}{waveform}\n{entries}", encoding="utf-8")
    return path
