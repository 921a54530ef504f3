"""Rig files (TOML): what the rotor is, how it is read, what was installed in each run, what the user is unsure of."""

import dataclasses
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, NamedTuple

import jax.numpy as jnp
import numpy as np
import tomlkit

from rotorjax.data.files import write_whole
from rotorjax.data.measurement import Installed, Knowledge, Limits, Measurement, Row, Uncertain, arrange
from rotorjax.data.section import Document, Section, nearest
from rotorjax.data.table import Table, read_table, write_table
from rotorjax.effects.terms import NAMED
from rotorjax.errors import InputError
from rotorjax.model.conditions import Layout, Probes
from rotorjax.model.contract import Effect
from rotorjax.model.model import Model
from rotorjax.model.rotor import Jeffcott
from rotorjax.units import DEGREE, GRAM_MILLIMETRE, GRAVITY, MILLIMETRE, RPM

_SECTIONS = ("rotor", "probes", "planes", "convention", "model", "uncertainty", "prior", "effects", "limits", "runs", "waveform", "recordings")
_GRAVITY_ANGLES = {"+x": 0.0, "x": 0.0, "+y": 90.0, "y": 90.0, "-x": 180.0, "-y": -90.0}


@dataclasses.dataclass(frozen=True)
class Convention:
    """How amplitudes, phases and angles are written in a user's files; everything inside is peak, lead, SI."""

    amplitude: Literal["peak", "peak-to-peak"] = "peak"
    phase: Literal["lead", "lag"] = "lead"
    weight_angles: Literal["with-rotation", "against-rotation"] = "with-rotation"

    def to_internal(self, row: Row) -> Row:
        """A row of the table as zero-to-peak amplitude and leading phase."""
        return self._convert(row, 0.5 if self.amplitude == "peak-to-peak" else 1.0)

    def to_table(self, row: Row) -> Row:
        """The inverse of `to_internal`."""
        return self._convert(row, 2.0 if self.amplitude == "peak-to-peak" else 1.0)

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


@dataclasses.dataclass(frozen=True)
class Rig:
    """A rig file: the model, what was installed in each run, and what the user declared besides."""

    model: Model
    runs: Mapping[str, Installed]
    convention: Convention
    knowledge: Knowledge
    path: Path
    text: str
    planes: Mapping[str, Plane]

    def measurement(self, table: Table, path: Path) -> Measurement:
        """A table's rows as a measurement of this rig.

        **Errors.** `InputError` with the table's problems, and for every run that the rig file lacks the block to paste.
        """
        unknown = dict.fromkeys(row.run for row in table.rows if row.run not in self.runs)
        if problems := [*table.problems, *(self._missing_run(run, table, path) for run in unknown)]:
            raise InputError(*problems)
        rows = [self.convention.to_internal(row) for row in table.rows]
        return arrange(rows, runs=self.runs, probes=self.model.layout.probes, knowledge=self.knowledge)

    def _missing_run(self, run: str, table: Table, path: Path) -> str:
        line = next(n for row, n in zip(table.rows, table.lines, strict=True) if row.run == run)
        near = f" ({nearest(run, self.runs)})" if self.runs else ""
        key = tomlkit.key(run).as_string()
        return (
            f"{path}:{line}: run {run!r} is not in {self.path}{near}; paste there and fill in what was installed:\n"
            f"    [runs.{key}]\n"
            "    unbalance = { magnitude_g_mm = 0.0, angle_deg = 0.0 }\n"
            "    bow = { magnitude_mm = 0.0, angle_deg = 0.0 }"
        )

    def write(self, path: Path, model: Model) -> None:
        """Write this rig file with the effects of another model, everything else as the user wrote it."""
        document = tomlkit.parse(self.text)
        document.pop("effects", None)
        model = self._with_other_orders(model)
        if model.effects:
            effects = tomlkit.table(is_super_table=True)
            for effect in model.effects:
                effects.add(effect.name, _effect_table(effect, model.layout))
            document.add(tomlkit.nl())
            document.add("effects", effects)
        write_whole(path, tomlkit.dumps(document).rstrip("\n") + "\n")

    def _with_other_orders(self, model: Model) -> Model:
        """The model with what this rig file says of orders that it does not have."""
        others = tuple(order for order in self.model.layout.orders if order not in model.layout.orders)
        if not others:
            return model
        wider = model.with_orders(tuple(sorted({*model.layout.orders, *others})))
        mine = self.model.with_orders(others).with_orders(wider.layout.orders)
        for effect in mine.effects:
            values = [v if "order" in p.axes else jnp.zeros_like(v) for p, v in zip(effect.parameters(), effect.values(), strict=True)]
            if any("order" in p.axes for p in effect.parameters()):
                wider = wider + effect.replaced(values)
        return wider

    def write_measurement(self, path: Path, measurement: Measurement) -> None:
        """Write a measurement as a table in this rig file's conventions."""
        rows = [self.convention.to_table(row) for row in to_rows(measurement)]
        write_table(path, rows)


def to_rows(measurement: Measurement) -> list[Row]:
    """The cells of a measurement as rows, case by case."""
    rows = []
    for case, probe, order in np.argwhere(measurement.present):
        z = measurement.vectors[case, probe, order] * 1e6
        sigma = None if measurement.sigma is None else float(measurement.sigma[case, probe, order] * 1e6)
        rows.append(
            Row(
                measurement.runs[measurement.run[case]],
                float(measurement.speed_rpm[case]),
                measurement.probes[probe],
                measurement.orders[order],
                float(abs(z)),
                float(np.degrees(np.angle(z))),
                sigma,
                measurement.repeat[case],
            )
        )
    return rows


def read_rig(path: str | Path, *, catalog: Mapping[str, type[Effect]] = NAMED) -> Rig:
    """Read a rig file.

    **Arguments:** ``path``; ``catalog``: the effects that sections ``[effects.NAME]`` and ``[prior.NAME]`` may name.
    **Errors.** `InputError` with one line per problem: file, line, key and cure.
    """
    document = Document(Path(path))
    for name in document.data:
        if name not in _SECTIONS:
            document.report((name,), f"unknown section; {nearest(name, _SECTIONS)}")
    convention_section = document.section("convention")
    convention = Convention(
        convention_section.choice("amplitude", ("peak", "peak-to-peak")),  # type: ignore[arg-type]
        convention_section.choice("phase", ("lead", "lag")),  # type: ignore[arg-type]
        convention_section.choice("weight_angles", ("with-rotation", "against-rotation")),  # type: ignore[arg-type]
    )
    rotation = convention_section.choice("rotation", ("x-to-y", "y-to-x"))
    slow_roll = _slow_roll(convention_section)
    convention_section.close()
    planes = _planes(document)
    participation = {name: plane.participation for name, plane in planes.items()}
    runs = _runs(document, participation, convention)
    model_parts = _rotor(document, rotation), _probes(document)
    tolerance, scatter = _form(document)
    knowledge = Knowledge(
        **_uncertainty(document, tuple(model_parts[1])), priors=_priors(document, catalog), limits=_limits(document),
        tolerance=tolerance, run_scatter=scatter,
    )  # fmt: skip
    layout = Layout(tuple(model_parts[1]) or ("X",), tuple(planes))
    declared = _effects(document, layout, catalog)
    document.raise_problems()
    model = _assemble(model_parts[0], model_parts[1], participation, slow_roll)
    orders = {order for _, _, named in declared for order in named}
    model = model.with_orders(tuple(sorted({*model.layout.orders, *orders})))
    model = model.plus([effect_from_labels(cls, model.layout, given) for cls, given, _ in declared])
    return Rig(model, runs, convention, knowledge, document.path, document.text, planes)


def read_measurement(path: str | Path, rig: Rig) -> Measurement:
    """Read a measurement table of a rig, in the conventions that the rig file declares.

    **Errors.** `InputError` with one line per problem: file, line, column and cure.
    """
    table = read_table(Path(path), probes=rig.model.layout.probes)
    return rig.measurement(table, Path(path))


def _rotor(document: Document, rotation: str) -> dict[str, Any]:
    section = document.section("rotor")
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


def _probes(document: Document) -> dict[str, tuple[float, float, float]]:
    """Probe name -> angle [rad], participation, one if it reads against the foundation."""
    section = document.section("probes")
    probes = {}
    for name, table in section.tables():
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


def _planes(document: Document) -> dict[str, Plane]:
    section = document.section("planes")
    planes = {}
    for name, table in section.tables():
        radius = table.number("radius_mm", above=0.0) * MILLIMETRE if "radius_mm" in table else None
        planes[name] = Plane(table.number("participation", 1.0), radius, _holes(table), table.number("first_hole_deg", 0.0))
        table.close()
    return planes or {"disk": Plane()}


def _holes(table: Section) -> int | None:
    """How many holes a plane has for correction masses."""
    if "holes" not in table:
        return None
    count = table.number("holes", least=3.0)
    if math.isfinite(count) and count != int(count):
        table.problem("holes", "must be a whole number of evenly spaced holes")
    return int(count) if math.isfinite(count) else None


def _slow_roll(section: Section) -> float | None:
    subtracted = section.flag("slow_roll_subtracted")
    speed = section.number("slow_roll_rpm", 250.0, above=0.0)
    return speed * RPM if subtracted else None


def _runs(document: Document, planes: dict[str, float], convention: Convention) -> dict[str, Installed]:
    runs = {}
    for name, table in document.section("runs").tables():
        unbalance = np.zeros((len(planes), 2))
        entries = table.raw("unbalance", [])
        for entry in entries if isinstance(entries, list) else [entries]:
            weight = Section(document, (*table.path, "unbalance"), entry)
            plane = weight.raw("plane", next(iter(planes)))
            if "plane" not in weight and len(planes) > 1:
                weight.problem("plane", f"is missing; say which of {', '.join(planes)}")
            elif plane not in planes:
                weight.problem("plane", f"unknown plane {plane!r}; {nearest(str(plane), planes)}")
                plane = next(iter(planes))
            pair = convention.vector(weight.number("magnitude_g_mm", least=0.0) * GRAM_MILLIMETRE, weight.number("angle_deg", 0.0))
            unbalance[list(planes).index(plane)] += pair
            weight.close()
        bow = np.zeros(2)
        if "bow" in table:
            bent = table.table("bow")
            bow = convention.vector(bent.number("magnitude_mm", least=0.0) * 1e-3, bent.number("angle_deg", 0.0))
            bent.close()
        table.raw("note")
        table.close()
        runs[name] = Installed(unbalance, bow)
    return runs


def _form(document: Document) -> tuple[float, Literal["auto", "none"]]:
    section = document.section("model")
    tolerance = section.number("tolerance", 0.0, least=0.0)
    scatter = section.choice("run_scatter", ("auto", "none"))
    section.close()
    return tolerance, scatter  # type: ignore[return-value]


# Key of [uncertainty] -> effect, parameter along x and y (or the only one), logarithmic, SI value of one unit.
_UNCERTAIN_PAIRS = {
    "stiffness": ("stiffness_error", "error_{}", True),
    "damping_ratio": ("damping_error", "log_ratio_{}", False),
}
_UNCERTAIN_PROBES = {"probe_gain": ("probe_gain", "gain", True, 1.0), "probe_angle_deg": ("probe_angle", "angle_rad", False, DEGREE)}


def _uncertainty(document: Document, probes: tuple[str, ...]) -> dict[str, Any]:
    section = document.section("uncertainty")
    uncertain: list[Uncertain] = []
    for key, (effect, label, logarithmic) in _UNCERTAIN_PAIRS.items():
        value = section.raw(key, 0.0)
        common = value.get("common") if isinstance(value, dict) else None
        if common is not None:
            table = section.table(key)
            deviations = dict.fromkeys("xy", table.number("common", least=0.0))
            table.close()
        else:
            deviations = dict(zip("xy", section.pair(key, least=0.0), strict=True)) if key in section else {}
        for axis, deviation in deviations.items():
            group = key if common is not None else f"{key}.{axis}"
            uncertain.append(Uncertain(effect, label.format(axis), deviation, logarithmic, group))
    uncertain.append(Uncertain("mass_error", "error", section.number("mass", 0.0, least=0.0), True, "mass"))
    for key, (effect, label, logarithmic, unit) in _UNCERTAIN_PROBES.items():
        deviation = unit * section.number(key, 0.0, least=0.0)
        uncertain += [Uncertain(effect, f"{label}.{probe}", deviation, logarithmic, f"{key}.{probe}") for probe in probes]
    values = {
        "uncertain": tuple(u for u in uncertain if u.deviation > 0.0),
        "installed_unbalance": section.number("installed_unbalance", 0.0, least=0.0),
        "installed_angle_rad": DEGREE * section.number("installed_angle_deg", 0.0, least=0.0),
        "installed_bow": section.number("installed_bow", 0.0, least=0.0),
    }
    section.close()
    return values


def _limits(document: Document) -> Limits:
    section = document.section("limits")
    speeds = section.raw("speed_rpm")
    pair = None
    if speeds is not None:
        if isinstance(speeds, list) and len(speeds) == 2:
            low, high = (section.checked("speed_rpm", speed, above=0.0) for speed in speeds)
            pair = low, high
            if low >= high:
                section.problem("speed_rpm", "must rise; write [lowest, highest]")
        else:
            section.problem("speed_rpm", f"must be [lowest, highest], not {speeds!r}")
    amplitude = section.number("amplitude_um", above=0.0) if "amplitude_um" in section else None
    weight = section.number("trial_weight_g_mm", above=0.0) if "trial_weight_g_mm" in section else None
    section.asked |= {"amplitude_um", "trial_weight_g_mm"}
    section.close()
    return Limits(pair, amplitude, weight)


def _priors(document: Document, catalog: Mapping[str, type[Effect]]) -> dict[str, dict[str, float]]:
    priors = {}
    for name, table in document.section("prior").tables():
        if name not in catalog:
            document.report(("prior", name), f"unknown effect; {nearest(name, catalog)}")
            continue
        declared = [p.name for p in catalog[name].parameters()]
        priors[name] = {key: table.number(key, above=0.0) for key in declared if key in table}
        table.asked |= set(declared)
        table.close()
    return priors


def _assemble(rotor: dict[str, Any], probes: dict[str, tuple[float, float, float]], planes: dict[str, float], slow_roll: float | None) -> Model:
    angle, participation, foundation = (np.array(column) for column in zip(*probes.values(), strict=True))
    return Model(
        Jeffcott(**rotor),
        Probes(angle, participation, foundation),
        np.array(list(planes.values())),
        slow_roll,
        layout=Layout(tuple(probes), tuple(planes)),
    )


def _effects(document: Document, layout: Layout, catalog: Mapping[str, type[Effect]]) -> list[tuple[type[Effect], dict[str, float], tuple[float, ...]]]:
    """Class, values by label and orders named of every section [effects.NAME]."""
    declared = []
    for name, table in document.section("effects").tables():
        if name not in catalog:
            document.report(("effects", name), f"unknown effect; {nearest(name, catalog)}")
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
                    orders |= {float(key[:-1]) for key in per_order if key.endswith("X") and key[:-1].replace(".", "", 1).isdigit()}
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


def effect_from_labels(cls: type[Effect], layout: Layout, given: Mapping[str, float]) -> Effect:
    """An effect with the values of some entries by label (``angle_rad.X``), null elsewhere."""
    values = []
    for declared in cls.parameters():
        entries = [given.get(label, 0.0) for label in declared.labels(layout)]
        values.append(jnp.asarray(entries, dtype=float).reshape(declared.shape(layout)))
    return cls().sized(layout).replaced(values)


def _effect_table(effect: Effect, layout: Layout) -> Any:
    table = tomlkit.table()
    for declared, value in zip(effect.parameters(), effect.values(), strict=True):
        if not declared.axes:
            table.add(declared.name, float(value))
            continue
        nested: Any = tomlkit.inline_table()
        for label, number in zip(declared.labels(layout), np.asarray(value).ravel(), strict=True):
            *parents, last = label.split(".", len(declared.axes))[1:]
            inner = nested
            for key in parents:
                if key not in inner:
                    inner.add(key, tomlkit.inline_table())
                inner = inner[key]
            inner.add(last, float(number))
        table.add(declared.name, nested)
    return table
