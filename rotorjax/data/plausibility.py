"""What in a rig file, by itself or beside a table, can hardly be meant: said with its place and the likely cure, and
read as it is.
"""

import math

import numpy as np
from jaxtyping import Float

from rotorjax.data.measurement import Measurement
from rotorjax.data.section import Document
from rotorjax.model.contract import AbstractRotor
from rotorjax.model.model import Model
from rotorjax.units import GRAM_MILLIMETRE, GRAVITY, MICROMETRE, MILLIMETRE, RPM

CRITICALLY_DAMPED = 0.2
"""Damping ratio above which the amplification factor is below 2.5: API 617 then calls a mode critically damped."""
RELATIVE = {
    "uncertainty": ("stiffness", "damping_ratio", "mass", "probe_gain", "installed_unbalance", "installed_bow"),
    "model": ("tolerance",),
}
"""Sections and their keys that are relative; above one they look like percent."""
LARGEST_SAG = 0.1
"""Sag under the rotor's own weight [m] above which none is built: its critical speed is below 95 rpm."""
FAR = 5.0
"""Ratio of critical speed and speed measured from which on the two have little to do with one another: within 4 % the
response is that of a spring alone, or of a free mass.
"""
NEAR = 3.0
"""Ratio up to which they have: what a mistake in units, a factor of 1000, put right must come to."""
MISTAKES = (
    ("stiffness_n_per_m is in N/mm, multiply it by 1000", 1e3),
    ("stiffness_n_per_m is in N/µm, multiply it by 1e6", 1e6),
    ("mass_kg is in g, divide it by 1000", 1e3),
    ("mass_kg is in t, multiply it by 1000", 1e-3),
)
"""What may have been meant, and by how much stiffness over mass then grows."""
MANY_TIMES = 100.0
"""Times what was measured, or part of the standard error, where a predicted vibration is a matter of units."""
CANCELLED = 1e-9
"""Unbalance in g mm, or bow in mm, up to which it is what rounding leaves of weights that cancel."""


def doubts(document: Document, model: Model, measurement: Measurement | None = None) -> list[str]:
    """What of a rig file, or of it beside a table, can hardly be meant, one line each."""
    stiffness = _doubtful_stiffness(document, model.rotor, measurement)
    found = [*_doubtful_ratios(document), *stiffness]
    if measurement is not None and not stiffness:
        installed = (_doubtful_installation(document, model, measurement, run) for run in range(len(measurement.runs)))
        found += [doubt for doubt in installed if doubt is not None]
    return found


def _doubtful_ratios(document: Document) -> list[str]:
    """Numbers relative to something that look like percent."""
    damping = "of critical damping, which leaves hardly any peak at a critical speed"
    found = [(*one, damping) for one in _numbers(document, "rotor", "damping_ratio") if one[1] > CRITICALLY_DAMPED]
    for section, keys in RELATIVE.items():
        found += [(*one, "of the value") for key in keys for one in _numbers(document, section, key) if one[1] > 1.0]
    return [
        f"{document.place(path)} = {value:g} is {100.0 * value:g} % {of}; if {value:g} % is meant, write "
        f"{value / 100.0:g}"
        for path, value, of in found
    ]


def _numbers(document: Document, section: str, key: str) -> list[tuple[tuple[str, ...], float]]:
    """Place and value of a number, or of those along x and y that differ."""
    value = document.data.get(section, {}).get(key)
    if not isinstance(value, dict):
        return [] if value is None else [((section, key), float(value))]
    found = {float(one): ((section, key, axis), float(one)) for axis, one in value.items()}
    return [((section, key), next(iter(found)))] if len(found) == 1 else list(found.values())


def _doubtful_stiffness(document: Document, rotor: AbstractRotor, measurement: Measurement | None) -> list[str]:
    """Critical speeds that have nothing to do with the data, or a rotor that would hang down to the floor."""
    natural = np.sort(np.sqrt(np.asarray(rotor.stiffness) / float(rotor.mass))) / RPM
    speeds = " and ".join(dict.fromkeys(f"{speed:.0f}" for speed in natural))
    given = f"{document.place(('rotor', 'stiffness_n_per_m'))}: with this mass_kg the critical speeds are {speeds} rpm"
    if measurement is not None:
        low, high = float(measurement.speed_rpm.min()), float(measurement.speed_rpm.max())
        side = "above" if natural[0] > FAR * high else "below" if natural[-1] < low / FAR else ""
        if side:
            cure = _cure(float(natural[0]), low, high)
            return [f"{given}, far {side} the {low:.0f} to {high:.0f} rpm measured; {cure}"]
    sag = GRAVITY / (natural[0] * RPM) ** 2
    return [f"{given} and the sag is {sag:.2g} m; check the units of both"] if sag > LARGEST_SAG else []


def _cure(natural_rpm: float, low: float, high: float) -> str:
    """What may have been meant: that which brings the critical speed near to the speeds measured."""
    cures = [what for what, factor in MISTAKES if low / NEAR < natural_rpm * math.sqrt(factor) < NEAR * high]
    return f"if {'; if '.join(cures)}" if cures else "check the units of both"


def _doubtful_installation(document: Document, model: Model, m: Measurement, run: int) -> str | None:
    """An unbalance or a bow that would vibrate far more than what was measured, or far less than the noise."""
    cases = m.run == run
    if 1.0 not in m.orders:
        return None
    first, speed = m.orders.index(1.0), np.asarray(m.conditions.speed)[cases]
    # The largest of all runs at each speed: a weight that balances the rotor leaves little of its own run.
    every = np.where(m.present[:, :, first], np.abs(m.vectors[:, :, first]), 0.0).max(axis=1)
    cluster = m.speed_cluster()[0]
    measured = np.array([every[cluster == here].max() for here in cluster[cases]])
    planes = np.asarray(m.conditions.unbalance)[cases] * np.asarray(model.participation)[:, None]
    unbalance = np.linalg.norm(planes.sum(axis=1), axis=-1)
    bow = np.linalg.norm(np.asarray(m.conditions.bow)[cases], axis=-1)
    noise = 0.0 if m.sigma is None else float(np.median(m.sigma[m.present]))
    for key, force, size in (
        ("unbalance", unbalance * speed**2, (unbalance[0] / GRAM_MILLIMETRE, "g mm")),
        ("bow", bow * float(np.mean(np.asarray(model.rotor.stiffness))), (bow[0] / MILLIMETRE, "mm")),
    ):
        predicted, seen = _amplitude(model.rotor, speed, force), measured > 0.0
        times = float(np.median(predicted[seen] / measured[seen])) if seen.any() else 0.0
        given = f"{document.place(('runs', m.runs[run], key))}: {size[0]:.6g} {size[1]} would give"
        if times > MANY_TIMES:
            as_much = f"{size[0] / times:.2g} {size[1]} as much"
            return f"{given} {times:.0f} times the vibration measured, {as_much}; check its unit"
        if size[0] > CANCELLED and predicted.max() < noise / MANY_TIMES:
            return (
                f"{given} {predicted.max() / MICROMETRE:.2g} µm at most, far below the standard error of "
                f"{noise / MICROMETRE:.2g} µm; check its unit"
            )
    return None


def _amplitude(
    rotor: AbstractRotor, speed: Float[np.ndarray, "case"], force: Float[np.ndarray, "case"]
) -> Float[np.ndarray, "case"]:
    """Response of the rotor to a turning force [N], the mean of x and y [m]."""
    stiffness, omega = np.asarray(rotor.stiffness)[None], speed[:, None]
    dynamic = stiffness - float(rotor.mass) * omega**2 + 1j * omega * np.asarray(rotor.damping)[None]
    # Without damping there is no end to the response at a critical speed.
    return np.mean(force[:, None] / np.maximum(np.abs(dynamic), 1e-9 * stiffness), axis=1)
