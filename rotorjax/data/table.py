"""Measurement tables (CSV): read with every problem named at once, written in one piece."""

import csv
import difflib
import io
import math
import re
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from rotorjax.data.columns import hint, suspicious
from rotorjax.data.files import read_text, write_whole
from rotorjax.data.measurement import Row
from rotorjax.data.names import unseen
from rotorjax.errors import InputError

REQUIRED = ("run", "speed_rpm", "probe", "order", "amplitude_um", "phase_deg")
OPTIONAL = ("sigma_um", "repeat", "sweep_rpm_per_s")
LARGEST = 1e9
"""No amplitude in µm, speed in rpm or angle in degrees is larger."""
HIGHEST_ORDER = 100.0
"""No order of a vibration vector is higher."""
_THOUSANDS = re.compile(r"[-+]?\d{1,3}(([,. '’\u00a0\u202f])\d{3})(\2\d{3})*([.,]\d+)?")
_POINTS_OF_THOUSANDS = re.compile(r"[-+]?\d{1,3}(\.\d{3})+")
_DECIMAL_COMMA = re.compile(r"(^|;)\s*[-+]?\d+,\d+\s*(;|$)")
_DELIMITER_NAMES = {",": "commas", ";": "semicolons", "\t": "tabs"}


class Table(NamedTuple):
    """Rows as written, the line of each, and notes on what was tolerated."""

    rows: list[Row]
    lines: list[int]
    notes: list[str]
    problems: list[str]
    """Rows that cannot be used, one line each: a rig adds runs that it does not know before they are raised."""


class _Header(NamedTuple):
    delimiter: str
    columns: dict[str, int]
    width: int
    decimal_commas: bool = False
    """Whether any number below has one: a point then separates thousands."""

    def number(self, text: str) -> float | None:
        """A cell as a number, if it is one."""
        if self.decimal_commas and _POINTS_OF_THOUSANDS.fullmatch(text):
            return None
        return _number(text, decimal_comma=self.delimiter == ";")

    def place(self, line: str, name: str) -> str:
        """A cell of a line: number and name of its column."""
        return f"{line}: column {self.columns[name] + 1} ({name})"


def read_table(path: Path, *, probes: Iterable[str] | None = None) -> Table:
    """Read a measurement table as it is written, conventions not yet applied.

    **Arguments:** ``probes``: names to accept, if known. **Returns** the rows and, one line each, the problems: file,
    line, column and cure. `Rig.measurement` refuses a table with any. **Errors.** `InputError` for a header or a file
    that cannot be read at all.
    """
    return parse_table(read_text(path), path, probes=probes)


def parse_table(text: str, path: Path, *, probes: Iterable[str] | None = None) -> Table:
    """`read_table` of text that was read already. **Arguments:** ``path``: its name in messages."""
    lines = [(number, line) for number, line in enumerate(re.split(r"\r\n|\r|\n", text), start=1) if line.strip()]
    if not lines:
        raise InputError(f"{path}: the file is empty; its first line must be the header {','.join(REQUIRED)}")
    notes: list[str] = []
    header = _read_header(path, *lines[0], notes)
    if header.delimiter == ";":
        header = header._replace(decimal_commas=any(_DECIMAL_COMMA.search(line) for _, line in lines[1:]))
    _refuse_decimal_commas(path, header, [line for _, line in lines[1:]])
    problems: list[str] = []
    rows: list[Row] = []
    numbers: list[int] = []
    known = list(probes) if probes is not None else None
    for number, line in lines[1:]:
        row = _read_row(f"{path}:{number}", line, header, known, problems)
        if row is not None:
            rows.append(row)
            numbers.append(number)
    problems += _duplicates(path, rows, numbers)
    if len(lines) == 1:
        problems.append(f"{path}: no rows below the header; write one per run, speed, probe and order")
    notes += [f"{path}: {note}" for note in suspicious(rows)]
    return Table(rows, numbers, notes, problems)


def _refuse_decimal_commas(path: Path, header: _Header, lines: list[str]) -> None:
    """One message where every row of a table separated by commas has more cells than the header, and no point."""
    without_point = all(not {'"', "."} & set(line) for line in lines)
    if header.delimiter == "," and lines and without_point and all(line.count(",") >= header.width for line in lines):
        raise InputError(
            f"{path}: every row has more than the {header.width} cells of the header, as with decimal commas: write "
            "decimal points, or separate the cells of all lines by semicolons"
        )


def _split(line: str, delimiter: str) -> list[str]:
    return [cell.strip() for cell in next(csv.reader(io.StringIO(line), delimiter=delimiter, skipinitialspace=True))]


def _read_header(path: Path, number: int, line: str, notes: list[str]) -> _Header:
    delimiter = max(_DELIMITER_NAMES, key=line.count)
    names = _names(f"{path}:{number}", line, delimiter)
    problems = []
    for name in sorted({n for n in names if names.count(n) > 1}):
        problems.append(f"{path}:{number}: column {name!r} appears {names.count(name)} times; keep one")
    missing = [name for name in REQUIRED if name not in names]
    absent = missing + [name for name in OPTIONAL if name not in names]
    stood_for, ignored = set(), []
    for column, name in enumerate(names, start=1):
        if name in REQUIRED or name in OPTIONAL:
            continue
        place = f"{path}:{number}: column {column} ({name!r})"
        near = difflib.get_close_matches(name.lower(), absent, 1, 0.6)
        if meant := hint(name, absent):
            problems.append(f"{place} {meant[1]}")
            stood_for.add(meant[0])
        elif near:
            problems.append(f"{place} is unknown; did you mean {near[0]!r}?")
            stood_for.add(near[0])
        else:
            notes.append(f"{place} is ignored")
            ignored.append(repr(name))
    unread = f" (not read: {', '.join(ignored)})" if ignored else ""
    for name in missing:
        if name in stood_for:
            continue
        problems.append(
            f"{path}:{number}: column {name!r} is missing{unread}; the header must hold {','.join(REQUIRED)}"
        )
    if problems:
        raise InputError(*problems)
    if delimiter != ",":
        with_commas = " with decimal commas" if delimiter == ";" else ""
        notes.append(f"{path}: read as a table separated by {_DELIMITER_NAMES[delimiter]}{with_commas}")
    return _Header(delimiter, {name: names.index(name) for name in (*REQUIRED, *OPTIONAL) if name in names}, len(names))


def _names(place: str, line: str, delimiter: str) -> list[str]:
    """Names in the header; a line that cannot be one is refused."""
    whole = f"the first line must be {','.join(REQUIRED)},sigma_um"
    if re.match(r"\s*\[[^],;]*\]\s*(#.*)?$", line):
        raise InputError(f"{place}: no header, but what looks like a rig file, which goes with --rig; {whole}")
    try:
        names = _split(line, delimiter)
    except csv.Error as error:
        raise InputError(f"{place}: {error}; {whole}") from error
    known = set(names) & {*REQUIRED, *OPTIONAL}
    if not known and any(_number(name, decimal_comma=delimiter == ";") is not None for name in names):
        raise InputError(f"{place}: no header; {whole}")
    if len(names) == 1:
        raise InputError(f"{place}: no header of several columns separated by commas; {whole}")
    return names


def _cells(place: str, line: str, header: _Header, problems: list[str]) -> list[str] | None:
    try:
        cells = _split(line, header.delimiter)
    except csv.Error as error:
        problems.append(f"{place}: {error}; write plain text cells")
        return None
    if len(cells) != header.width:
        named = _DELIMITER_NAMES[header.delimiter]
        quotes = "close the quotation mark and " if line.count('"') % 2 else ""
        problems.append(
            f"{place}: {len(cells)} cells, the header has {header.width}; {quotes}separate exactly {header.width} "
            f"cells by {named}{_as_commas(header)}"
        )
        return None
    return cells


def _read_row(place: str, line: str, header: _Header, probes: list[str] | None, problems: list[str]) -> Row | None:
    cells = _cells(place, line, header, problems)
    if cells is None:
        return None
    before = len(problems)

    def where(name: str) -> str:
        return header.place(place, name)

    def number(name: str, least: float, *, strict: bool) -> float:
        written = cells[header.columns[name]]
        # Orders are also written as they are said: 1X.
        plain = written.removesuffix("X").removesuffix("x") if name == "order" else written
        value = header.number(plain)
        if value is None:
            cure = "leave out the separator of thousands" if _THOUSANDS.fullmatch(written) else "write it like 12.5"
            problems.append(f"{where(name)}: {written!r} is not a finite number; {cure}{_as_commas(header)}")
            return math.nan
        if abs(value) > LARGEST:
            problems.append(f"{where(name)}: {value:g} is beyond anything measured; check its unit")
        if name == "order" and value > HIGHEST_ORDER:
            problems.append(
                f"{where(name)}: {value:g} is above {HIGHEST_ORDER:g}; check that it is a multiple of the speed"
            )
        if value < least or (strict and value == least):
            problems.append(f"{where(name)}: {value:g} must be {'above' if strict else 'at least'} {least:g}")
        return value

    problems += _names_wrong(place, cells, header, probes)
    row = Row(
        cells[header.columns["run"]],
        number("speed_rpm", 0.0, strict=True),
        cells[header.columns["probe"]],
        number("order", 0.0, strict=False),
        number("amplitude_um", 0.0, strict=False),
        number("phase_deg", -math.inf, strict=False),
        number("sigma_um", 0.0, strict=True) if "sigma_um" in header.columns else None,
        cells[header.columns["repeat"]] if "repeat" in header.columns else "",
        number("sweep_rpm_per_s", -math.inf, strict=False) if "sweep_rpm_per_s" in header.columns else 0.0,
    )
    if row.order == 0.0 and row.amplitude_um > 0.0 and row.phase_deg % 180.0 != 0.0:
        problems.append(f"{where('phase_deg')}: order 0 is a constant offset; its phase must be 0 or 180")
    return row if len(problems) == before else None


def _names_wrong(place: str, cells: list[str], header: _Header, probes: list[str] | None) -> list[str]:
    """What is wrong with the names of run, probe and repeat."""
    problems = [
        f"{header.place(place, name)}: holds the control character {control}; delete it"
        for name in ("run", "probe", "repeat")
        if name in header.columns and (control := unseen(cells[header.columns[name]]))
    ]
    run, probe = (cells[header.columns[name]] for name in ("run", "probe"))
    if not run:
        problems.append(f"{header.place(place, 'run')}: empty; name the run")
    if probes is not None and probe not in probes and not unseen(probe):
        known = ", ".join(probes)
        problems.append(f"{header.place(place, 'probe')}: unknown probe {probe!r}; the rig file has {known}")
    return problems


def _as_commas(header: _Header) -> str:
    """The other way out, for tables of spreadsheets that write decimal commas."""
    return "; or save the table with commas between cells and decimal points" if header.delimiter == ";" else ""


def _number(text: str, *, decimal_comma: bool) -> float | None:
    if decimal_comma and text.count(",") == 1 and "." not in text:
        text = text.replace(",", ".")
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) and "_" not in text else None


def _duplicates(path: Path, rows: list[Row], lines: list[int]) -> list[str]:
    first: dict[tuple[object, ...], int] = {}
    rates: dict[tuple[object, ...], tuple[float, int]] = {}
    problems = []
    for row, line in zip(rows, lines, strict=True):
        rate, before = rates.setdefault((row.run, row.speed_rpm, row.repeat), (row.sweep_rpm_per_s, line))
        if rate != row.sweep_rpm_per_s:
            problems.append(
                f"{path}:{line}: sweep_rpm_per_s is {row.sweep_rpm_per_s:g}, in line {before} at the same run and "
                f"speed {rate:g}; state one rate, or number repeated readings in a column 'repeat'"
            )
        key = (row.run, row.speed_rpm, row.probe, row.order, row.repeat)
        if key in first:
            problems.append(
                f"{path}:{line}: same run, speed, probe and order as line {first[key]}; remove one, or number repeated "
                "readings in a column 'repeat'"
            )
        first.setdefault(key, line)
    return problems


def write_table(path: Path, rows: list[Row]) -> None:
    """Write rows as a measurement table, whole or not at all; sigma and repeat only if some row has them.

    **Errors.** `InputError` for rows that could not be told apart as they are written, and where it cannot be written.
    """
    names = [*REQUIRED]
    if any(row.sigma_um is not None for row in rows):
        names.append("sigma_um")
    if any(row.repeat for row in rows):
        names.append("repeat")
    if any(row.sweep_rpm_per_s for row in rows):
        names.append("sweep_rpm_per_s")
    buffer = io.StringIO(newline="")
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(names)
    seen = set()
    for row in rows:
        record = {name: f"{v:.10g}" if isinstance(v, float) else v for name, v in row._asdict().items()}
        key = tuple(record[name] for name in ("run", "speed_rpm", "probe", "order", "repeat"))
        if key in seen:
            raise InputError(
                f"{path}: run {row.run!r}, probe {row.probe!r} would have two rows of {record['speed_rpm']} rpm and "
                f"order {record['order']}: numbers have ten digits; choose speeds and orders further apart"
            )
        seen.add(key)
        writer.writerow([record[name] for name in names])
    write_whole(path, buffer.getvalue())
