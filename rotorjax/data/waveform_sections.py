"""The sections of a rig file that say what recordings are: [waveform] and [recordings], every key checked."""

import dataclasses
import math
from collections.abc import Collection, Mapping
from pathlib import PurePath
from typing import Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from rotorjax.data.names import unseen
from rotorjax.data.section import Document, Section, nearest
from rotorjax.data.table import HIGHEST_ORDER
from rotorjax.units import MICROMETRE

UNITS = ("um", "V")
EDGES = ("rising", "falling")
TIME = "time_s"
"""Channel that holds the time in seconds where none is named."""


class Channel(NamedTuple):
    """A probe's channel in recordings, and what its numbers mean."""

    channel: str | int
    unit: str = "um"
    sensitivity_mv_per_um: float = 1.0
    """With the unit V."""
    scale: float | None = None
    """Units (µm or V) for each number of the file; 1 where none is given."""

    def displacement(self, numbers: Float[np.ndarray, "sample"]) -> Float[np.ndarray, "sample"]:
        """Numbers of a file as displacement [m]."""
        per_unit = 1e3 / self.sensitivity_mv_per_um if self.unit == "V" else 1.0
        return numbers * ((self.scale or 1.0) * per_unit * MICROMETRE)


class Reference(NamedTuple):
    """The channel with one pulse per turn, and what of it is the angle zero."""

    channel: str | int = "reference"
    edge: Literal["rising", "falling"] = "rising"
    threshold: float | None = None
    """In the numbers of the file; none: midway between its levels."""


class Recorded(NamedTuple):
    """A file, the run it holds, and the speed that it should have, if stated."""

    file: str
    run: str
    speed_rpm: float | None = None


@dataclasses.dataclass(frozen=True)
class Waveform:
    """What a rig file says of recordings."""

    probes: Mapping[str, Channel]
    reference: Reference = dataclasses.field(default_factory=Reference)
    sample_rate_hz: float | None = None
    time: str | int | None = None
    """Channel of the time; none: ``TIME``, where a file has it."""
    orders: tuple[float, ...] = (1.0,)
    slow_roll: str | None = None
    """File whose vectors are subtracted from all others."""
    recordings: tuple[Recorded, ...] = ()


def waveform_of(document: Document, probes: Collection[str], runs: Collection[str]) -> Waveform:
    """Channels, units and the sampling rate of recordings, and which file holds which run."""
    section = document.section("waveform")
    rate = section.number("sample_rate_hz", above=0.0) if "sample_rate_hz" in section else None
    reference = _reference_of(section.table("reference")) if "reference" in section else Reference()
    named = {probe: _channel_of(section.table(probe)) for probe in probes if probe in section}
    time = _channel_name(section, "time") if "time" in section else None
    orders = _orders_of(section) if "orders" in section else (1.0,)
    slow_roll = section.raw("slow_roll")
    if slow_roll is not None and (not isinstance(slow_roll, str) or not slow_roll):
        section.problem("slow_roll", f"must be the name of a recording, not {slow_roll!r}")
        slow_roll = None
    elif slow_roll and (control := unseen(slow_roll)):
        section.problem("slow_roll", f"file name holds the control character {control}; delete it")
    section.close()
    # A rig file that maps no probe has recordings whose channels are called as the probes are.
    return Waveform(
        named or {probe: Channel(probe) for probe in probes}, reference, rate, time, orders, slow_roll,
        _recordings_of(document, runs),
    )  # fmt: skip


def _reference_of(table: Section) -> Reference:
    """The channel with one pulse per turn."""
    channel = _channel_name(table, "channel")
    edge = table.choice("edge", EDGES)
    threshold, level = table.raw("threshold", "auto"), None
    if isinstance(threshold, bool) or not isinstance(threshold, int | float | str) or threshold == "":
        table.problem("threshold", f'must be "auto" or a number in the channel\'s unit, not {threshold!r}')
    elif isinstance(threshold, str) and threshold != "auto":
        table.problem("threshold", f'{threshold!r} is not "auto" or a number in the channel\'s unit')
    elif not isinstance(threshold, str):
        level = table.checked("threshold", threshold)
    table.close()
    return Reference(channel, edge, level)  # type: ignore[arg-type]


def _channel_of(table: Section) -> Channel:
    """The channel of a probe, with its unit."""
    channel = _channel_name(table, "channel")
    unit, key, sensitivity = table.choice("unit", UNITS), "sensitivity_mv_per_um", 1.0
    if key in table and table.data.get("unit", "um") == "um":
        table.problem(key, 'goes with unit = "V"; leave it out where the channel is in µm')
    elif unit == "V" and (sensitivity := table.number(key)) == 0.0:
        table.problem(key, "must not be zero: the probe would read nothing")
    scale = table.number("scale") if "scale" in table else None
    if scale == 0.0:
        table.problem("scale", f"must not be zero: it is the {unit} for each number of the file")
    table.close()
    return Channel(channel, unit, sensitivity, scale)


def _channel_name(table: Section, key: str) -> str | int:
    """Name or number of a channel in the file."""
    channel: Any = table.raw(key)
    if channel is None:
        table.missing(key, 'name the channel of the recording, like channel = "ch1"')
    elif isinstance(channel, bool) or not isinstance(channel, int | str) or channel == "":
        table.problem(key, f"must be the name or the number of a channel, not {channel!r}")
    else:
        if isinstance(channel, int):
            table.checked(key, channel, least=0.0)
        return channel
    return 0


def _orders_of(section: Section) -> tuple[float, ...]:
    """Multiples of the speed, each once."""
    orders = section.raw("orders")
    if not isinstance(orders, list) or not orders:
        section.problem("orders", f"must be a list of multiples of the speed, like [1, 2], not {orders!r}")
        return (1.0,)
    numbers = [section.checked("orders", order, least=0.0) for order in orders]
    if any(order > HIGHEST_ORDER for order in numbers):
        section.problem("orders", f"no order is above {HIGHEST_ORDER:g}; give multiples of the speed")
    return tuple(sorted({order for order in numbers if math.isfinite(order)}))


def _recordings_of(document: Document, runs: Collection[str]) -> tuple[Recorded, ...]:
    """Which file holds which run; the file's name without its ending by default."""
    found = []
    for file, table in document.section("recordings").tables():
        run = table.raw("run", PurePath(file).stem)
        if not file:
            table.problem("run", 'the name of the recording is empty; write [recordings."FILE"]')
        if not isinstance(run, str):
            table.problem("run", f"must be the name of a run, not {run!r}")
        elif run not in runs:
            by_default = "" if "run" in table else ', which is the file\'s name: say run = "NAME"'
            table.problem("run", f"unknown run {run!r}{by_default}; {nearest(run, runs)}")
        speed = table.number("speed_rpm", above=0.0) if "speed_rpm" in table else None
        found.append(Recorded(file, run, speed))
        table.close()
    return tuple(found)
