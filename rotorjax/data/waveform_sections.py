"""The sections of a rig file that say what recordings are: [waveform] and [recordings], every key checked."""

from collections.abc import Collection
from pathlib import PurePath

from rotorjax.data.section import Document, Section, nearest

UNITS = ("um", "V")
EDGES = ("rising", "falling")


def check_waveform(document: Document, probes: Collection[str]) -> None:
    """Channels, units and the sampling rate of recordings."""
    section = document.section("waveform")
    if "sample_rate_hz" in section:
        section.number("sample_rate_hz", above=0.0)
    if "reference" in section:
        _check_reference(section.table("reference"))
    for probe in probes:
        if probe in section:
            _check_channel(section.table(probe))
    section.close()


def _check_reference(table: Section) -> None:
    """The channel with one pulse per turn."""
    _check_channel_name(table)
    table.choice("edge", EDGES)
    threshold = table.raw("threshold", "auto")
    if isinstance(threshold, bool) or not isinstance(threshold, int | float | str) or threshold == "":
        table.problem("threshold", f'must be "auto" or a number in the channel\'s unit, not {threshold!r}')
    elif isinstance(threshold, str) and threshold != "auto":
        table.problem("threshold", f'{threshold!r} is not "auto" or a number in the channel\'s unit')
    elif not isinstance(threshold, str):
        table.checked("threshold", threshold)
    table.close()


def _check_channel(table: Section) -> None:
    """The channel of a probe, with its unit."""
    _check_channel_name(table)
    unit, key = table.choice("unit", UNITS), "sensitivity_mv_per_um"
    if key in table and table.data.get("unit", "um") == "um":
        table.problem(key, 'goes with unit = "V"; leave it out where the channel is in µm')
    elif unit == "V" and table.number(key) == 0.0:
        table.problem(key, "must not be zero: the probe would read nothing")
    table.close()


def _check_channel_name(table: Section) -> None:
    """Name or number of a channel in the file."""
    channel = table.raw("channel")
    if channel is None:
        table.missing("channel", 'name the channel of the recording, like channel = "ch1"')
    elif isinstance(channel, bool) or not isinstance(channel, int | str) or channel == "":
        table.problem("channel", f"must be the name or the number of a channel, not {channel!r}")
    elif isinstance(channel, int):
        table.checked("channel", channel, least=0.0)


def check_recordings(document: Document, runs: Collection[str]) -> None:
    """Which file holds which run; the file's name without its ending by default."""
    for file, table in document.section("recordings").tables():
        run = table.raw("run", PurePath(file).stem)
        if not isinstance(run, str):
            table.problem("run", f"must be the name of a run, not {run!r}")
        elif run not in runs:
            by_default = "" if "run" in table else ', which is the file\'s name: say run = "NAME"'
            table.problem("run", f"unknown run {run!r}{by_default}; {nearest(run, runs)}")
        table.close()
