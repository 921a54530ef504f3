"""The sections of a rig file, each read and checked."""

import dataclasses
import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from rotorjax.data.knowledge import SLOW_ROLL_RPM, Amplitude, Limits, Uncertain, peak_of
from rotorjax.data.measurement import Installed, Row
from rotorjax.data.names import unseen
from rotorjax.data.section import Document, Section, nearest, shown
from rotorjax.data.synonyms import nearest_effect
from rotorjax.model.conditions import Layout
from rotorjax.model.contract import Effect
from rotorjax.units import DEGREE, GRAM_MILLIMETRE, GRAVITY, MILLIMETRE

_ORDER = re.compile(r"[0-9]{1,4}(\.[0-9]{1,6})?X")
MOST_HOLES = 720
"""For correction masses, every half degree."""
TURNS = (
    "write 'x-to-y' where the shaft turns from +x towards +y: with +x to the right and +y up, counterclockwise (ccw) "
    "is 'x-to-y', clockwise (cw) 'y-to-x'"
)
"""Which sense of rotation to write when."""
WEIGHT = "unbalance = { magnitude_g_mm = 30.0, angle_deg = 0.0 }"
WEIGHT_CURE = f"a weight is given as mass times radius, 1 g at 30 mm so: {WEIGHT}"
_WEIGHT_WORDS = ("weight", "mass", "radius", "trial")
_GRAVITY_ANGLES = {"+x": 0.0, "x": 0.0, "+y": 90.0, "y": 90.0, "-x": 180.0, "-y": -90.0}


@dataclasses.dataclass(frozen=True)
class Convention:
    """How amplitudes, phases and angles are written in a user's files; everything inside is peak, lead, SI."""

    amplitude: Amplitude = "peak"
    phase: Literal["lead", "lag"] = "lead"
    weight_angles: Literal["with-rotation", "against-rotation"] = "with-rotation"

    def to_internal(self, row: Row) -> Row:
        """A row of the table as zero-to-peak amplitude and leading phase."""
        return self._convert(row, peak_of(self.amplitude, row.order))

    def to_table(self, row: Row) -> Row:
        """The inverse of `to_internal`."""
        return self._convert(row, 1.0 / peak_of(self.amplitude, row.order))

    def _convert(self, row: Row, factor: float) -> Row:
        sign = -1.0 if self.phase == "lag" else 1.0
        sigma = None if row.sigma_um is None else row.sigma_um * factor
        return row._replace(amplitude_um=row.amplitude_um * factor, phase_deg=sign * row.phase_deg, sigma_um=sigma)

    def vector(self, magnitude: float, angle_deg: float) -> np.ndarray:
        """(x, y) pair of a weight or bow: angles count from +x, with or against the rotation."""
        angle = DEGREE * angle_deg * (-1.0 if self.weight_angles == "against-rotation" else 1.0)
        return magnitude * np.array([math.cos(angle), math.sin(angle)])

    def angle_deg(self, pair: np.ndarray) -> float:
        """Angle of an (x, y) pair as the user counts it."""
        angle = math.degrees(math.atan2(pair[1], pair[0]))
        return -angle if self.weight_angles == "against-rotation" else angle


class Plane(NamedTuple):
    """A balancing plane."""

    participation: float = 1.0
    """Mode shape there, relative to the disk."""
    radius_m: float | None = None
    """Where correction masses sit."""
    holes: int | None = None
    """Evenly spaced, the first of them at `first_hole_deg`."""
    first_hole_deg: float = 0.0


def rotor_of(document: Document, rotation: str) -> dict[str, Any]:
    """What the model's rotor is made of; nothing where the section is missing."""
    section = document.section("rotor")
    if section.reported:
        return {}
    if not section.data:
        document.report(("rotor",), "section is missing; give mass_kg, stiffness_n_per_m and damping_ratio")
        return {}
    values = {
        "mass": section.number("mass_kg", above=0.0),
        "stiffness": section.pair("stiffness_n_per_m", above=0.0),
        "damping_ratio": section.pair("damping_ratio", least=0.0),
        "gravity": _gravity(section),
        "rotation": rotation,
        "bow_through_damping": section.flag("bow_through_damping"),
    }
    section.close()
    return values


def _gravity(section: Section) -> tuple[float, float]:
    value = section.raw("gravity", "none")
    if value == "none":
        return 0.0, 0.0
    if isinstance(value, str) and value in _GRAVITY_ANGLES:
        angle = _GRAVITY_ANGLES[value]
    elif isinstance(value, dict):
        table = section.table("gravity")
        angle = table.number("angle_deg")
        table.close()
    else:
        section.problem("gravity", f'{value!r} is not a direction; write "none", "-y", "+x" or {{ angle_deg = -90.0 }}')
        return 0.0, 0.0
    return GRAVITY * math.cos(DEGREE * angle), GRAVITY * math.sin(DEGREE * angle)


def _check_name(document: Document, path: tuple[str, str], kind: str, like: str) -> None:
    """Report a name that stands in no table: cells are read without the spaces around them."""
    name = path[-1]
    if not name.strip():
        document.report(path, f"a {kind} needs a name, like {like}")
    elif name != name.strip() and not unseen(name):
        document.report(path, f"a table has no spaces around a {kind}'s name; write {name.strip()!r}")


def probes_of(document: Document) -> dict[str, tuple[float, float, float]]:
    """Probe name -> angle [rad], participation, one if it reads against the foundation."""
    section = document.section("probes")
    probes = {}
    for name, table in section.tables():
        _check_name(document, ("probes", name), "probe", "X")
        if set(name) & set(".,:="):
            document.report(("probes", name), "a probe's name must not hold any of . , : = (they separate parameters)")
        angle = DEGREE * table.number("angle_deg")
        participation = table.number("participation", 1.0)
        reference = table.choice("reference", ("ground", "foundation"))
        table.close()
        if participation == 0.0:
            table.problem("participation", "must not be zero: the probe would read nothing")
        probes[name] = angle, participation, float(reference == "foundation")
    if not probes:
        document.report(("probes",), "section is missing; give each probe a direction: X = { angle_deg = 0.0 }")
    return probes


def planes_of(document: Document) -> dict[str, Plane]:
    """The balancing planes; one on the disk where none is declared."""
    section = document.section("planes")
    planes = {}
    for name, table in section.tables():
        radius = table.number("radius_mm", above=0.0) * MILLIMETRE if "radius_mm" in table else None
        planes[name] = Plane(
            table.number("participation", 1.0), radius, _holes(table), table.number("first_hole_deg", 0.0)
        )
        table.asked |= {"radius_mm", "holes"}
        table.close()
    return planes or {"disk": Plane()}


def _holes(table: Section) -> int | None:
    """How many holes a plane has for correction masses."""
    if "holes" not in table:
        return None
    count = table.number("holes", least=3.0)
    if math.isfinite(count) and (count != int(count) or count > MOST_HOLES):
        table.problem("holes", f"must be a whole number of evenly spaced holes, {MOST_HOLES} at most")
    return int(count) if math.isfinite(count) else None


def slow_roll_of(section: Section) -> tuple[float, bool]:
    """Speed [rpm] of the slow roll, and whether its vectors were subtracted."""
    return section.number("slow_roll_rpm", SLOW_ROLL_RPM, above=0.0), section.flag("slow_roll_subtracted")


def runs_of(document: Document, planes: dict[str, float], convention: Convention) -> dict[str, Installed]:
    """What was installed in every run: unbalance by plane, and bow."""
    runs = {}
    for name, table in document.section("runs").tables():
        _check_name(document, ("runs", name), "run", "baseline")
        unbalance = np.zeros((len(planes), 2))
        entries = table.raw("unbalance", [])
        for entry in entries if isinstance(entries, list) else [entries]:
            if not isinstance(entry, dict):
                table.problem("unbalance", f"must be a table, not {shown(entry)}; {WEIGHT_CURE}")
                continue
            weight = Section(document, (*table.path, "unbalance"), entry)
            plane = weight.raw("plane", next(iter(planes)))
            if "plane" not in weight and len(planes) > 1:
                weight.problem("plane", f"is missing; say which of {', '.join(planes)}")
            elif not isinstance(plane, str) or plane not in planes:
                weight.problem("plane", f"unknown plane {plane!r}; {nearest(str(plane), planes)}")
                plane = next(iter(planes))
            unbalance[list(planes).index(plane)] += convention.vector(_size(weight), weight.number("angle_deg", 0.0))
            weight.close(WEIGHT_CURE, _WEIGHT_WORDS)
        bow = np.zeros(2)
        if "bow" in table:
            bent = table.table("bow")
            bow = convention.vector(bent.number("magnitude_mm", least=0.0) * 1e-3, bent.number("angle_deg", 0.0))
            bent.close()
        table.asked |= {"bow", "note"}
        table.close(WEIGHT_CURE, _WEIGHT_WORDS)
        runs[name] = Installed(unbalance, bow)
    return runs


def _size(weight: Section) -> float:
    """Of an installed unbalance [kg m]; a mass and a radius in its place are told as their product."""
    mass, radius = (weight.data.get(key) for key in ("mass_g", "radius_mm"))
    if "magnitude_g_mm" not in weight and isinstance(mass, int | float) and isinstance(radius, int | float):
        weight.problem(
            "magnitude_g_mm", f"is missing; write magnitude_g_mm = {mass * radius:g} in place of mass_g and radius_mm"
        )
        weight.asked |= {"mass_g", "radius_mm"}
        return math.nan
    return weight.number("magnitude_g_mm", least=0.0) * GRAM_MILLIMETRE


def form_of(document: Document) -> tuple[float, Literal["auto", "none"], Path | None]:
    """Tolerance of the model's form, whether runs may scatter, and the table of the healthy rotor."""
    section = document.section("model")
    tolerance = section.number("tolerance", 0.0, least=0.0)
    scatter = section.choice("run_scatter", ("auto", "none"))
    healthy = section.raw("healthy")
    if healthy is not None and not (isinstance(healthy, str) and healthy):
        section.problem("healthy", 'is no file: write healthy = "healthy.csv", a table beside this file')
        healthy = None
    section.close()
    return tolerance, scatter, None if healthy is None else document.path.parent / healthy  # type: ignore[return-value]


# Key of [uncertainty] -> effect, parameter along x and y (or the only one), logarithmic, SI value of one unit.
_UNCERTAIN_PAIRS = {
    "stiffness": ("stiffness_error", "error_{}", True),
    "damping_ratio": ("damping_error", "log_ratio_{}", False),
}


_UNCERTAIN_PROBES = {
    "probe_gain": ("probe_gain", "gain", True, 1.0),
    "probe_angle_deg": ("probe_angle", "angle_rad", False, DEGREE),
}


def uncertainty_of(document: Document, probes: tuple[str, ...]) -> dict[str, Any]:
    """What is fitted in every comparison, with its standard deviation, as arguments of `Knowledge`."""
    section = document.section("uncertainty")
    uncertain: list[Uncertain] = []
    for key, (effect, label, logarithmic) in _UNCERTAIN_PAIRS.items():
        common = isinstance(section.data.get(key), dict) and "common" in section.table(key)
        if common:
            table = section.table(key)
            deviations = dict.fromkeys("xy", table.number("common", least=0.0))
            table.close()
        else:
            pair = section.pair(key, least=0.0, also=("common",)) if key in section else None
            deviations = {} if pair is None else dict(zip("xy", pair, strict=True))
        for axis, deviation in deviations.items():
            group = key if common else f"{key}.{axis}"
            uncertain.append(Uncertain(effect, label.format(axis), deviation, logarithmic, group))
    uncertain.append(Uncertain("mass_error", "error", section.number("mass", 0.0, least=0.0), True, "mass"))
    for key, (effect, label, logarithmic, unit) in _UNCERTAIN_PROBES.items():
        deviation = unit * section.number(key, 0.0, least=0.0)
        uncertain += [
            Uncertain(effect, f"{label}.{probe}", deviation, logarithmic, f"{key}.{probe}") for probe in probes
        ]
    values = {
        "uncertain": tuple(u for u in uncertain if u.deviation > 0.0),
        "installed_unbalance": section.number("installed_unbalance", 0.0, least=0.0),
        "installed_angle_rad": DEGREE * section.number("installed_angle_deg", 0.0, least=0.0),
        "installed_bow": section.number("installed_bow", 0.0, least=0.0),
    }
    section.close()
    return values


def limits_of(document: Document) -> Limits:
    """What a next measurement may ask for, and where the machine runs."""
    section = document.section("limits")
    speeds = _speeds(section, "speed_rpm") if "speed_rpm" in section else None
    amplitude = section.number("amplitude_um", above=0.0) if "amplitude_um" in section else None
    weight = section.number("trial_weight_g_mm", above=0.0) if "trial_weight_g_mm" in section else None
    operating, key = None, "operating_speed_rpm"
    if key in section:
        one = section.raw(key)
        alone = math.nan if isinstance(one, list) else section.number(key, above=0.0)
        operating = _speeds(section, key) if isinstance(one, list) else (alone, alone)
    section.close()
    return Limits(speeds, amplitude, weight, operating)


def _speeds(section: Section, key: str) -> tuple[float, float] | None:
    """A range of speeds [rpm]."""
    speeds = section.raw(key)
    if not (isinstance(speeds, list) and len(speeds) == 2):
        section.problem(key, f"must be [lowest, highest], not {speeds!r}")
        return None
    low, high = (section.checked(key, speed, above=0.0) for speed in speeds)
    if low >= high:
        section.problem(key, "must rise; write [lowest, highest]")
    return low, high


def priors_of(document: Document, catalog: Mapping[str, type[Effect]]) -> dict[str, dict[str, float]]:
    """Prior scales by effect and parameter."""
    priors = {}
    for name, table in document.section("prior").tables():
        if name not in catalog:
            document.report(("prior", name), f"unknown effect; {nearest_effect(name, catalog)}")
            continue
        declared = [p.name for p in catalog[name].parameters()]
        priors[name] = {key: table.number(key, above=0.0) for key in declared if key in table}
        table.close()
    return priors


def effects_of(
    document: Document, layout: Layout, catalog: Mapping[str, type[Effect]]
) -> list[tuple[type[Effect], dict[str, float], tuple[float, ...]]]:
    """Class, values by label and orders named of every section [effects.NAME]."""
    declared = []
    for name, table in document.section("effects").tables():
        if name not in catalog:
            document.report(
                ("effects", name),
                f"unknown effect; {nearest_effect(name, catalog)} (one of your own: in Python, "
                "read_rig(..., catalog=...))",
            )
            continue
        orders = _orders_named(catalog[name], table.data)
        known = layout._replace(orders=orders or layout.orders)
        given = _flat(table, {label for p in catalog[name].parameters() for label in p.labels(known)})
        declared.append((catalog[name], given, orders))
    return declared


def _orders_named(cls: type[Effect], data: dict[str, Any]) -> tuple[float, ...]:
    """Orders like '2X' that a table of a parameter per probe and order mentions."""
    orders = set()
    for declared in cls.parameters():
        if "order" in declared.axes and isinstance(per_probe := data.get(declared.name), dict):
            for per_order in per_probe.values():
                if isinstance(per_order, dict):
                    orders |= {float(key[:-1]) for key in per_order if _ORDER.fullmatch(key)}
    return tuple(sorted(orders))


def _flat(table: Section, labels: set[str]) -> dict[str, float]:
    """Nested tables of an effect as label -> value: angle_rad = { X = 0.1 } becomes angle_rad.X."""
    given: dict[str, float] = {}

    def descend(value: Any, label: str) -> None:
        if isinstance(value, dict):
            for key, inner in value.items():
                descend(inner, f"{label}.{key}")
            return
        matching = [known for known in labels if known == label or known.startswith(f"{label}.")]
        if not matching:
            table.problem(label, f"unknown parameter; {nearest(label, labels)}")
        number = table.checked(label, value)
        given.update(dict.fromkeys(matching, number))

    for key in table.data:
        descend(table.data[key], key)
    return given
