"""What is explained, a table with its rig file or a rig file with its recordings: a folder, or a list."""

import csv
import hashlib
import re
from collections import Counter
from collections.abc import Collection
from pathlib import Path
from typing import NamedTuple

from rotorjax.data.files import read_text
from rotorjax.data.named_files import can_be_read, recordings_named
from rotorjax.data.names import harmless
from rotorjax.errors import InputError

RIG = "rig.toml"
"""The rig file of all tables beside it that have none of their own."""
_DELIMITERS = ",;\t"


class Pair(NamedTuple):
    """A table and its rig file, or a rig file and the recordings that it names."""

    name: str
    """Without control characters."""
    data: Path | None
    """None where vectors come from recordings."""
    rig: Path | None
    """None where a folder has none."""

    @property
    def digest(self) -> str:
        """Of the content of all files, so that a pair that was changed is explained anew."""
        digest = hashlib.sha256()
        recordings = () if self.data is not None or self.rig is None else recordings_of(self.rig)
        for path in (self.data, self.rig, *recordings):
            digest.update(b"" if path is None else _content_digest(path))
        return digest.hexdigest()


def _content_digest(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").digest()
    except OSError as error:
        return f"cannot be read: {error.strerror}".encode()


def recordings_of(rig: Path) -> tuple[Path, ...]:
    """Recordings that a rig file names, that of the slow roll too; none where it cannot be read."""
    return tuple(rig.parent / file for file in recordings_named(rig))


def pairs(source: Path, written: Collection[Path] = ()) -> list[Pair]:
    """Tables and rig files in a folder and all below it, or in a list with the columns ``data,rig``, and ``name`` where
    that is not the path of the table; paths in a list count from its folder.

    In a folder every CSV file is a table, unless a rig file names it as a recording; its rig file is the one of the
    same stem beside it, or else ``rig.toml`` beside it. A rig file that names recordings and belongs to no table is
    explained by those, and so is one without a table in a list; one that cannot be read is a case that says why.
    **Arguments:** ``written``: files and folders that the command writes, which are not read. **Errors.** `InputError`
    if there are none, or if the list cannot be read.
    """
    return _in_folder(source, written) if source.is_dir() else _in_list(source)


def _in_folder(folder: Path, written: Collection[Path]) -> list[Pair]:
    own = {path.resolve() for path in written}

    def files(suffix: str) -> list[Path]:
        every = sorted(path for path in folder.rglob("*") if path.suffix.lower() == suffix and path.is_file())
        return [
            path
            for path in every
            if not any(part.startswith(".") for part in path.relative_to(folder).parts)
            and not own & {path.resolve(), *path.resolve().parents}
        ]

    # What cannot be read may name recordings: as a row of its own it says why.
    every = {rig: recordings_of(rig) for rig in files(".toml")}
    recorded = {rig: recordings for rig, recordings in every.items() if recordings or not can_be_read(rig)}
    records = {path.resolve() for recordings in recorded.values() for path in recordings}
    found, used = [], set[Path]()
    for data in files(".csv"):
        if data.resolve() in records:
            continue
        candidates = (data.with_suffix(".toml"), data.parent / RIG)
        rig = next((path for path in candidates if path.is_file()), None)
        used |= {rig} if rig is not None else set()
        found.append(Pair(_name(data, folder), data, rig))
    found += [Pair(_name(rig, folder), None, rig) for rig in recorded if rig not in used]
    if not found:
        raise InputError(
            f"{folder}: no table in it; put there pairs a.csv and a.toml, or tables beside one {RIG}, or rig files "
            "that name recordings, or give a list"
        )
    return found


def _name(path: Path, folder: Path) -> str:
    return harmless(path.relative_to(folder).as_posix())


def _in_list(path: Path) -> list[Pair]:
    lines = re.split(r"\r\n|\r|\n", read_text(path))
    if not any(lines):
        raise InputError(f"{path}: the file is empty; its first line must be the header data,rig")
    reader = csv.DictReader(lines, delimiter=max(_DELIMITERS, key=lines[0].count), skipinitialspace=True)
    try:
        header = [(name or "").strip() for name in reader.fieldnames or ()]
        reader.fieldnames = header
        rows = [(reader.line_num, row) for row in reader]
    except csv.Error as error:
        raise InputError(f"{path}:{reader.line_num + 1}: {error}; write plain text cells") from error
    if missing := [column for column in ("data", "rig") if column not in header]:
        raise InputError(
            f"{path}:1: column {missing[0]!r} is missing; write a list with the columns data,rig, or give a folder"
        )
    found, problems = [], []
    for line, row in rows:
        data, rig, name = ((row.get(column) or "").strip() for column in ("data", "rig", "name"))
        if not data and not rig:
            continue
        if not rig or (not data and not recordings_of(path.parent / rig)):
            column, cure = ("rig", "") if not rig else ("data", ", or a rig file that names recordings")
            problems.append(f"{path}:{line}: column {column!r} is empty; give the path of a file{cure}")
            continue
        found.append(Pair(harmless(name or data or rig), path.parent / data if data else None, path.parent / rig))
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
