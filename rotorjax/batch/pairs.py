"""Which tables are explained, each with which rig file: a folder, or a list."""

import csv
import hashlib
import io
from collections import Counter
from collections.abc import Collection
from pathlib import Path
from typing import NamedTuple

from rotorjax.data.files import read_text
from rotorjax.data.names import harmless
from rotorjax.errors import InputError

RIG = "rig.toml"
"""The rig file of all tables beside it that have none of their own."""
_DELIMITERS = ",;\t"


class Pair(NamedTuple):
    """A table and its rig file."""

    name: str
    """Without control characters."""
    data: Path
    rig: Path | None
    """None where a folder has none."""

    @property
    def digest(self) -> str:
        """Of the content of both, so that a pair that was changed is explained anew."""
        digest = hashlib.sha256()
        for path in (self.data, self.rig):
            try:
                content = b"" if path is None else path.read_bytes()
            except OSError as error:
                content = f"cannot be read: {error.strerror}".encode()
            digest.update(hashlib.sha256(content).digest())
        return digest.hexdigest()


def pairs(source: Path, written: Collection[Path] = ()) -> list[Pair]:
    """Tables and rig files in a folder and all below it, or in a list with the columns ``data,rig``, and ``name`` where
    that is not the path of the table; paths in a list count from its folder.

    In a folder every CSV file is a table; its rig file is the one of the same stem beside it, or else ``rig.toml``
    beside it. **Arguments:** ``written``: files and folders that the command writes, which are not read. **Errors.**
    `InputError` if there are none, or if the list cannot be read.
    """
    return _in_folder(source, written) if source.is_dir() else _in_list(source)


def _in_folder(folder: Path, written: Collection[Path]) -> list[Pair]:
    own = {path.resolve() for path in written}
    found = []
    for data in sorted(path for path in folder.rglob("*") if path.suffix.lower() == ".csv" and path.is_file()):
        within = data.relative_to(folder)
        if any(part.startswith(".") for part in within.parts) or own & {data.resolve(), *data.resolve().parents}:
            continue
        candidates = (data.with_suffix(".toml"), data.parent / RIG)
        rig = next((path for path in candidates if path.is_file()), None)
        found.append(Pair(harmless(within.as_posix()), data, rig))
    if not found:
        raise InputError(
            f"{folder}: no table in it; put there pairs a.csv and a.toml, or tables beside one {RIG}, or give a list"
        )
    return found


def _in_list(path: Path) -> list[Pair]:
    text = read_text(path)
    lines = text.splitlines()
    if not lines:
        raise InputError(f"{path}: the file is empty; its first line must be the header data,rig")
    reader = csv.DictReader(io.StringIO(text), delimiter=max(_DELIMITERS, key=lines[0].count), skipinitialspace=True)
    header = [(name or "").strip() for name in reader.fieldnames or ()]
    reader.fieldnames = header
    if missing := [column for column in ("data", "rig") if column not in header]:
        raise InputError(
            f"{path}:1: column {missing[0]!r} is missing; write a list with the columns data,rig, or give a folder"
        )
    found, problems = [], []
    for row in reader:
        data, rig, name = ((row.get(column) or "").strip() for column in ("data", "rig", "name"))
        if not data and not rig:
            continue
        if not data or not rig:
            column = "data" if not data else "rig"
            problems.append(f"{path}:{reader.line_num}: column {column!r} is empty; give the path of a file")
            continue
        found.append(Pair(harmless(name or data), path.parent / data, path.parent / rig))
    twice = [name for name, count in Counter(pair.name for pair in found).items() if count > 1]
    problems += [
        f"{path}: {name!r} is listed {Counter(pair.name for pair in found)[name]} times; keep one, or tell them apart "
        "by a column name"
        for name in twice
    ]
    if not found and not problems:
        problems.append(f"{path}: no rows below the header; write one per table")
    if problems:
        raise InputError(*problems)
    return found
