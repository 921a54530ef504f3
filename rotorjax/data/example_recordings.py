"""Recordings in time for the example: what a recorder would have seen of its rotor, with the effects that it hides."""

import tomllib
from pathlib import Path

import numpy as np

from rotorjax.data.example import RECORDINGS
from rotorjax.data.files import refusals, write_whole
from rotorjax.data.rig import Rig, effect_from_labels, read_rig
from rotorjax.data.simulate import plan_speeds
from rotorjax.effects import CATALOG
from rotorjax.model.model import Model
from rotorjax.physics.response import response
from rotorjax.units import DEGREE, GRAM_MILLIMETRE, MICROMETRE, RPM

SPEEDS_RPM = (700, 1300, 1700, 1900, 2050, 2450, 2600, 2800)
RATE_HZ, SECONDS = 2000.0, 1.0
NOISE_M = 3.0 * MICROMETRE
SENSITIVITY_MV_PER_UM = 7.874
"""200 mV per mil, as most proximity probes have it."""
PULSE_RAD, PULSE_V = 60.0 * DEGREE, -5.0
EDGE_S = 3e-4
"""A recorder's filter makes an edge no shorter than a sample or two; else it would be known to half a sample only."""
WAVEFORM = f"""
[waveform]                                       # which channel of a recording is what
time = "time_s"                                  # seconds; or sample_rate_hz where a file has no time
reference = {{ channel = "keyphasor", edge = "falling", threshold = "auto" }}
X = {{ channel = "probe_x", unit = "V", sensitivity_mv_per_um = {SENSITIVITY_MV_PER_UM} }}
Y = {{ channel = "probe_y", unit = "V", sensitivity_mv_per_um = {SENSITIVITY_MV_PER_UM} }}
orders = [1]
"""
GUIDE = """Written to {folder}: rig.toml (the rotor, its probes and runs, what each channel is) and {count} recordings,
one second each, of a phase reference and two probes. Type, one after the other:

  rotorjax vectors {folder}/rig.toml --output {folder}/measurement.csv
      recordings to vibration vectors, with standard errors

  rotorjax explain {folder}/measurement.csv --rig {folder}/rig.toml
      which effects are missing, how sure that is

  rotorjax explain --recordings {folder}/rig.toml --report {folder}/report.html
      the same without a table between

Then put your own recordings and your own rotor in their place.
"""


def write_recordings(folder: Path, rig_text: str) -> str:
    """Write recordings and a rig file that names them, into a folder that exists. **Returns** what to type, with
    ``{folder}`` for the folder.
    """
    names = {
        (run, speed): f"{RECORDINGS}/{run}-{speed}.csv"
        for run in tomllib.loads(rig_text)["runs"]
        for speed in SPEEDS_RPM
    }
    entries = "".join(f'\n[recordings."{name}"]\nrun = "{run}"\n' for (run, _), name in names.items())
    write_whole(folder / "rig.toml", rig_text.rstrip("\n") + "\n" + WAVEFORM + entries)
    rig = read_rig(folder / "rig.toml")
    with refusals(folder, "cannot be written to", "choose another folder"):
        (folder / RECORDINGS).mkdir()
    rng = np.random.default_rng(3)
    for (run, speed), name in names.items():
        write_whole(folder / name, _recording(_truth(rig), rig, run, speed * (1.0 + 1e-3 * rng.standard_normal()), rng))
    return GUIDE.format(folder="{folder}", count=len(names))


def _truth(rig: Rig) -> Model:
    """The rotor as it is: an unbalance of 9 g mm at 50°, a cross-coupling of 1200 N/m, 1 % stiffer along x."""
    weight = 9.0 * GRAM_MILLIMETRE
    sizes = {
        "residual_unbalance": {
            "unbalance_x_kg_m": weight * np.cos(50.0 * DEGREE),
            "unbalance_y_kg_m": weight * np.sin(50.0 * DEGREE),
        },
        "cross_coupling": {"cross_stiffness_n_per_m": 1200.0},
        "stiffness_error": {"error_x": 0.01},
    }
    return rig.model.plus([effect_from_labels(CATALOG[name], rig.model.layout, each) for name, each in sizes.items()])


def _recording(truth: Model, rig: Rig, run: str, speed_rpm: float, rng: np.random.Generator) -> str:
    """One second at a steady speed, as text."""
    plan = plan_speeds(rig, f"{speed_rpm!r}:{speed_rpm!r}:1", "1")
    z = np.asarray(response(truth, plan.conditions))[plan.runs.index(run), :, 0]
    time = np.arange(int(RATE_HZ * SECONDS)) / RATE_HZ
    angle = speed_rpm * RPM * time - rng.uniform(1.0, 5.0)
    moved = np.real(z * np.exp(1j * angle)[:, None]) + NOISE_M * rng.standard_normal((len(time), len(z)))
    volts = moved / MICROMETRE * SENSITIVITY_MV_PER_UM * 1e-3
    turned = (angle + np.pi) % (2.0 * np.pi) - np.pi
    edge = EDGE_S * speed_rpm * RPM
    pulse = 0.5 * PULSE_V * (np.tanh(turned / edge) - np.tanh((turned - PULSE_RAD) / edge))
    lines = [f"{t:.4f},{p:.3f},{x:.5f},{y:.5f}" for t, p, (x, y) in zip(time, pulse, volts, strict=True)]
    return "\n".join(["time_s,keyphasor,probe_x,probe_y", *lines]) + "\n"
