"""Recordings in time on the command line: to a table, or straight to an explanation."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from rotorjax.cli.arguments import check_outputs
from rotorjax.cli.progress import progress_line
from rotorjax.cli.terminal import note, say, terminal_width
from rotorjax.data.files import resolved, write_whole
from rotorjax.errors import InputError, do_every

if TYPE_CHECKING:
    from rotorjax.data.measurement import Measurement
    from rotorjax.data.record_scan import Progress
    from rotorjax.data.record_vectors import Records
    from rotorjax.data.rig import Rig


def vectors(options: argparse.Namespace) -> None:
    """Recordings to a measurement table."""
    if options.rig is None:
        if len(options.files) != 1:
            raise InputError("name the rig file alone, or recordings and the rig file with --rig RIG.toml")
        options.rig, options.files = options.files[0], []
    check_outputs(options)
    rate = options.sample_rate
    if rate is not None and not 0.0 < rate < float("inf"):
        raise InputError(f"--sample-rate {rate}: must be a number of samples per second, above zero")
    from rotorjax.data.record_vectors import read_recordings
    from rotorjax.data.rig import read_rig
    from rotorjax.data.simulate import orders_of
    from rotorjax.data.table import write_table
    from rotorjax.reporting.recordings import recordings_html, recordings_text

    orders = orders_of(options.orders) if options.orders else None
    with progress_line() as progress:
        rig = read_rig(options.rig)
        _keep_recordings(options, rig)
        records = read_recordings(rig, options.files, orders=orders, sample_rate_hz=rate, progress=progress)
    note([*records.all_notes, *rig.notes])
    rows = [rig.convention.to_table(row) for row in records.rows()]

    def table() -> None:
        write_table(options.output, rows)
        say(f"\n{len(rows)} vectors of {len(records.records)} recordings written to {options.output}")

    def report() -> None:
        write_whole(options.report, recordings_html(rig, records, title=f"Recordings of {options.rig.name}"))
        say(f"Report: {options.report}")

    told = recordings_text(records, width=terminal_width())
    do_every(lambda: say(told), table, options.report and report)


def table_or_recordings(options: argparse.Namespace) -> Path:
    """What measured vectors come from: the table, or the rig file that names recordings; then that is the rig file.

    **Errors.** `InputError` for both, or half of either.
    """
    if options.recordings is None:
        if options.data is None or options.rig is None:
            raise InputError(
                "give a table and its rig file, DATA.csv --rig RIG.toml, or recordings in time, --recordings RIG.toml"
            )
        return options.data
    if options.data is not None or options.rig is not None:
        raise InputError("--recordings RIG.toml takes the place of DATA.csv --rig RIG.toml: leave one of the two out")
    options.rig = options.recordings
    return options.recordings


def read_recorded(options: argparse.Namespace, progress: "Progress") -> "tuple[Rig, Measurement, Records]":
    """A rig file, the vectors of its recordings, and these."""
    from rotorjax.data.record_vectors import read_recordings
    from rotorjax.data.rig import read_rig

    rig = read_rig(options.recordings)
    _keep_recordings(options, rig)
    records = read_recordings(rig, progress=progress)
    return rig, records.measurement(rig), records


def _keep_recordings(options: argparse.Namespace, rig: "Rig") -> None:
    """Refuse to write over a recording that the rig file names.

    **Errors.** `InputError`.
    """
    named = [*(recorded.file for recorded in rig.waveform.recordings), rig.waveform.slow_roll or ""]
    read = {resolved(rig.path.parent / file) for file in named if file}
    for flag in ("output", "json", "report", "write_rig"):
        path = getattr(options, flag, None)
        if path is not None and resolved(path) in read:
            raise InputError(f"--{flag.replace('_', '-')} {path}: is one of the recordings; choose another file")
