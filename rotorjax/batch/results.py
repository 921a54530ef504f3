"""Results as one file: Parquet, CSV, or the SQLite file in which they were kept."""

import csv
import importlib.util
import io
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rotorjax.data.files import write_whole
from rotorjax.errors import InputError

Columns = Mapping[str, "str | Mapping[str, str]"]
"""Column -> kind, as in `rotorjax.batch.explaining.COLUMNS`."""
DATABASE = (".sqlite", ".sqlite3", ".db")
KEPT = ".sqlite"
"""What is added to the name of a Parquet or CSV file for the file in which its rows are kept as they finish."""


def kept_in(output: Path) -> Path:
    """Where the rows of an output are kept as they finish.

    **Errors.** `InputError` if the output is of a kind that cannot be written.
    """
    kind = output.suffix.lower()
    if kind in DATABASE:
        return output
    if kind == ".parquet" and importlib.util.find_spec("pyarrow") is None:
        raise InputError(
            f"--output {output}: Parquet needs PyArrow, which is not installed; pip install 'rotorjax[parquet]', or "
            f"write {output.with_suffix('.sqlite').name} or {output.with_suffix('.csv').name}"
        )
    if kind not in (".parquet", ".csv"):
        raise InputError(f"--output {output}: name a file that ends in .parquet, .sqlite or .csv")
    return output.with_name(output.name + KEPT)


def write_results(output: Path, rows: Sequence[Mapping[str, Any]], columns: Columns) -> None:
    """Write rows as the ending of the file says; in an SQLite file they are already."""
    kind = output.suffix.lower()
    if kind == ".parquet":
        write_whole(output, _parquet(rows, columns))
    elif kind == ".csv":
        write_whole(output, _csv(rows, columns))


def _csv(rows: Sequence[Mapping[str, Any]], columns: Columns) -> str:
    """One line per row; lists as JSON."""
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(columns)
    for row in rows:
        values = (row.get(name) for name in columns)
        writer.writerow([json.dumps(v, ensure_ascii=False) if isinstance(v, list) else v for v in values])
    return file.getvalue()


def _parquet(rows: Sequence[Mapping[str, Any]], columns: Columns) -> bytes:
    """The same with types; lists are lists, records are records."""
    import pyarrow  # noqa: PLC0415  an extra
    import pyarrow.parquet  # noqa: PLC0415

    simple = {"text": pyarrow.string(), "number": pyarrow.float64(), "whole": pyarrow.int64()}
    simple["names"] = pyarrow.list_(pyarrow.string())
    fields = [
        (name, simple[kind] if isinstance(kind, str) else pyarrow.list_(pyarrow.struct(_typed(kind, simple))))
        for name, kind in columns.items()
    ]
    table = pyarrow.Table.from_pylist(
        [{name: row.get(name) for name in columns} for row in rows], pyarrow.schema(fields)
    )
    file = io.BytesIO()
    pyarrow.parquet.write_table(table, file)
    return file.getvalue()


def _typed(kinds: Mapping[str, str], simple: Mapping[str, Any]) -> list[tuple[str, Any]]:
    return [(name, simple[kind]) for name, kind in kinds.items()]
