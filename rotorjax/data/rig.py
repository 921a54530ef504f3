"""Rig files (TOML): what the rotor is, how it is read, what was installed in each run, what the user is unsure of."""

import dataclasses
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import tomlkit

from rotorjax.data.declarations import Mistake
from rotorjax.data.files import resolved, write_whole
from rotorjax.data.knowledge import PEAK, Knowledge
from rotorjax.data.measurement import Installed, Measurement, Row, arrange
from rotorjax.data.plausibility import doubts
from rotorjax.data.rig_edits import put_right
from rotorjax.data.rig_sections import (
    TURNS,
    WEIGHT,
    Convention,
    Plane,
    effects_of,
    form_of,
    limits_of,
    planes_of,
    priors_of,
    probes_of,
    rotor_of,
    runs_of,
    slow_roll_of,
    uncertainty_of,
)
from rotorjax.data.section import Document, nearest
from rotorjax.data.table import Table, parse_table, read_table, write_table
from rotorjax.data.waveform_sections import Waveform, waveform_of
from rotorjax.effects.terms import NAMED
from rotorjax.errors import InputError
from rotorjax.model.conditions import Layout, Probes
from rotorjax.model.contract import Effect
from rotorjax.model.model import Model
from rotorjax.model.rotor import Jeffcott
from rotorjax.units import RPM

_SECTIONS = (
    "rotor",
    "probes",
    "planes",
    "convention",
    "model",
    "uncertainty",
    "prior",
    "effects",
    "limits",
    "runs",
    "waveform",
    "recordings",
)


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
    waveform: Waveform
    """What recordings in time are."""
    document: Document
    """The file as read, for the places of what is said about it."""
    healthy: Path | None = None
    """Table of the healthy rotor, where ``[model] healthy`` names one."""

    def __repr__(self) -> str:
        effects = ", ".join(effect.name for effect in self.model.effects) or "none"
        uncertain = ", ".join(dict.fromkeys(one.effect for one in self.knowledge.uncertain)) or "nothing"
        layout = self.model.layout
        return (
            f"Rig({self.path}; probes {', '.join(layout.probes)}; planes {', '.join(layout.planes)}; "
            f"runs {', '.join(self.runs) or 'none'}; effects {effects}; uncertain {uncertain})"
        )

    @property
    def notes(self) -> tuple[str, ...]:
        """What in it can hardly be meant, one line each."""
        return tuple(doubts(self.document, self.model))

    def measurement(self, table: Table, path: Path) -> Measurement:
        """A table's rows as a measurement of this rig, the table's notes among its own.

        **Errors.** `InputError` with the table's problems, and for every run that the rig file lacks the block to
        paste.
        """
        unknown = dict.fromkeys(row.run for row in table.rows if row.run not in self.runs)
        if problems := [*table.problems, *(self._missing_run(run, table, path) for run in unknown)]:
            raise InputError(*problems, *(f"note: {note}" for note in table.notes))
        rows = [self.convention.to_internal(row) for row in table.rows]
        found = arrange(rows, runs=self.runs, probes=self.model.layout.probes, knowledge=self.knowledge)
        return dataclasses.replace(found, notes=(*table.notes, *doubts(self.document, self.model, found)))

    def measurement_of_text(self, text: str, name: str) -> Measurement:
        """A table that was read already, or made, as a measurement of this rig. **Arguments:** ``name``: of the table
        in messages. **Errors.** `InputError` as for a table that is read.
        """
        path = Path(name)
        return self.measurement(parse_table(text, path, probes=self.model.layout.probes), path)

    def of_healthy(self, beside: str | Path | None = None) -> Measurement | None:
        """The measurement of the healthy rotor that the file names, if it does; none for that table itself.

        **Arguments:** ``beside``: the table that is looked at. **Errors.** `InputError` as for any table.
        """
        if self.healthy is None or (beside is not None and resolved(Path(beside)) == resolved(self.healthy)):
            return None
        return read_measurement(self.healthy, self)

    def check_only(self, only: Collection[str], measurement: Measurement) -> None:
        """`InputError` if an effect that alone may be missing is in the model already, or is estimated in any case."""
        declared = {uncertain.effect for uncertain in measurement.knowledge.uncertain}
        if held := [name for name in only if name in self.model or name in declared]:
            how = (
                "declares it uncertain, so that it is fitted in any case"
                if held[0] in declared
                else "has it in [effects] already"
            )
            raise InputError(f"--only {held[0]}: the rig file {how}; leave it out here, or there")

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

    def put_right(self, mistake: Mistake | None) -> "Rig":
        """The same with the conventions that the file should state: as a model beside this mistake is to be read."""
        if mistake is None:
            return self
        document, _ = put_right(self.text, mistake)
        stated = tomlkit.loads(tomlkit.dumps(document)).unwrap().get("convention", {})
        names = (field.name for field in dataclasses.fields(Convention))
        convention = Convention(**{name: stated[name] for name in names if name in stated})
        return dataclasses.replace(self, convention=convention)

    def write(self, path: str | Path, model: Model, mistake: Mistake | None = None) -> bool:
        """Write this rig file with the effects of another model, everything else as the user wrote it.

        **Arguments:** ``mistake``: what was written down wrongly, if anything, put right. **Returns** whether it could
        be: what is wrong in the table is not in this file.
        """
        document, right = (tomlkit.parse(self.text), True) if mistake is None else put_right(self.text, mistake)
        document.pop("effects", None)
        # What is written has changed since the healthy rotor, which is not to be calibrated on once more.
        document.get("model", {}).pop("healthy", None)
        model = self._with_other_orders(model)
        if model.effects:
            effects = tomlkit.table(is_super_table=True)
            for effect in model.effects:
                effects.add(effect.name, _effect_table(effect, model.layout))
            document.add(tomlkit.nl())
            document.add("effects", effects)
        write_whole(Path(path), tomlkit.dumps(document).rstrip("\n") + "\n")
        return right

    def _with_other_orders(self, model: Model) -> Model:
        """The model with what this rig file says of orders that it does not have."""
        others = tuple(order for order in self.model.layout.orders if order not in model.layout.orders)
        if not others:
            return model
        wider = model.with_orders(tuple(sorted({*model.layout.orders, *others})))
        mine = self.model.with_orders(others).with_orders(wider.layout.orders)
        for effect in mine.effects:
            values = [
                v if "order" in p.axes else jnp.zeros_like(v)
                for p, v in zip(effect.parameters(), effect.values(), strict=True)
            ]
            if any("order" in p.axes for p in effect.parameters()):
                wider = wider + effect.replaced(values)
        return wider

    def write_measurement(self, path: str | Path, measurement: Measurement) -> None:
        """Write a measurement as a table in this rig file's conventions."""
        rows = [self.convention.to_table(row) for row in to_rows(measurement)]
        write_table(Path(path), rows)


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
                float(measurement.conditions.sweeps[case] / RPM),
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
            installed = any(word in name for word in ("trial", "weight"))
            cure = f"what is installed in a run stands under [runs.NAME]: {WEIGHT}" if installed else ""
            document.report((name,), f"unknown section; {cure or nearest(name, _SECTIONS)}")
    convention_section = document.section("convention")
    convention = Convention(
        convention_section.choice("amplitude", tuple(PEAK)),  # type: ignore[arg-type]
        convention_section.choice("phase", ("lead", "lag")),  # type: ignore[arg-type]
        convention_section.choice("weight_angles", ("with-rotation", "against-rotation")),  # type: ignore[arg-type]
    )
    rotation = convention_section.choice("rotation", ("x-to-y", "y-to-x"), TURNS)
    slow_roll_rpm, subtracted = slow_roll_of(convention_section)
    convention_section.close()
    planes = planes_of(document)
    participation = {name: plane.participation for name, plane in planes.items()}
    runs = runs_of(document, participation, convention)
    model_parts = rotor_of(document, rotation), probes_of(document)
    tolerance, scatter, healthy = form_of(document)
    knowledge = Knowledge(
        **uncertainty_of(document, tuple(model_parts[1])), priors=priors_of(document, catalog),
        limits=limits_of(document), tolerance=tolerance, run_scatter=scatter,
        amplitude=convention.amplitude, slow_roll_rpm=slow_roll_rpm,
        plane_radii_m=tuple(plane.radius_m for plane in planes.values()),
    )  # fmt: skip
    layout = Layout(tuple(model_parts[1]) or ("X",), tuple(planes))
    declared = effects_of(document, layout, catalog)
    waveform = waveform_of(document, tuple(model_parts[1]), tuple(runs))
    document.raise_problems()
    model = _assemble(model_parts[0], model_parts[1], participation, slow_roll_rpm * RPM if subtracted else None)
    orders = {order for _, _, named in declared for order in named}
    model = model.with_orders(tuple(sorted({*model.layout.orders, *orders})))
    model = model.plus([effect_from_labels(cls, model.layout, given) for cls, given, _ in declared])
    return Rig(model, runs, convention, knowledge, document.path, document.text, planes, waveform, document, healthy)


def read_measurement(path: str | Path, rig: Rig) -> Measurement:
    """Read a measurement table of a rig, in the conventions that the rig file declares.

    **Errors.** `InputError` with one line per problem: file, line, column and cure; ``TypeError`` for what is no rig.
    """
    if not isinstance(rig, Rig):
        raise TypeError(f"{rig!r} is no rig: hand over read_rig(...) of the rig file")
    table = read_table(Path(path), probes=rig.model.layout.probes)
    return rig.measurement(table, Path(path))


def _assemble(
    rotor: dict[str, Any],
    probes: dict[str, tuple[float, float, float]],
    planes: dict[str, float],
    slow_roll: float | None,
) -> Model:
    angle, participation, foundation = (np.array(column) for column in zip(*probes.values(), strict=True))
    return Model(
        Jeffcott(**rotor),
        Probes(angle, participation, foundation),
        np.array(list(planes.values())),
        slow_roll,
        layout=Layout(tuple(probes), tuple(planes)),
    )


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
