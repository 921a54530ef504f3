"""What recordings gave, as people read it."""

import numpy as np

from rotorjax.data.record_vectors import Record, Records
from rotorjax.data.rig import Rig
from rotorjax.reporting.page import Picture, rendered
from rotorjax.reporting.pictures.recorded import recorded_pictures
from rotorjax.reporting.tables import Table, number
from rotorjax.units import MICROMETRE


def recordings_text(records: Records, *, width: int | None = None) -> str:
    """One line for each recording: its run, speed, revolutions, and how certain its vectors are."""
    return _table(records).text(width)


def _table(records: Records) -> Table:
    rows = [_row(record) for record in records.records]
    heads = ["recording", "run", "rpm", "revolutions", "speeds", "orders", "largest µm", "std. error µm"]
    return Table("Recordings", heads, rows, spare=["speeds", "orders"])


def recordings_html(rig: Rig, records: Records, *, title: str) -> str:
    """The table, the notes, and waveforms, orbits and spectra, as one HTML file that needs no network."""
    pictures = Picture.every(recorded_pictures(rig, records))
    content = {"title": title, "notes": records.all_notes, "table": _table(records), "pictures": pictures}
    return rendered("recordings.html", content)


def _row(record: Record) -> list[str]:
    points = record.points
    speeds = [point.speed_rpm for point in points]
    ends = [f"{speed:.1f}" if record.steady else f"{speed:.0f}" for speed in (speeds[0], speeds[-1])]
    speed = " to ".join(dict.fromkeys(ends))
    error = np.concatenate([np.hypot(point.sigma, point.bias).ravel() for point in points]) / MICROMETRE
    return [
        record.file, record.run, speed, str(sum(point.revolutions for point in points)), str(len(points)),
        ", ".join(f"{order:g}X" for order in record.orders),
        number(record.largest / MICROMETRE), number(float(np.median(error))),
    ]  # fmt: skip
