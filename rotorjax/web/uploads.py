"""What was dropped: which file is the rig file, which the table, which recordings; how large they may be.

Names that come with files are shown and compared, never used as paths: files are stored under names made here.
"""

import secrets
import unicodedata
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import NamedTuple

from rotorjax.data.named_files import healthy_named, recordings_named
from rotorjax.data.names import harmless
from rotorjax.errors import InputError

MEGABYTE = 1_000_000
LONGEST_NAME = 200
"""Characters of a file's name that are shown."""
ENDINGS = (".toml", ".csv", ".txt", ".npz", ".wav", ".mat", ".h5", ".hdf5", ".tdms", ".uff", ".unv")
"""Endings of names that stored files keep: what a recording is may depend on them."""
MOST_FILES = 1000


class TooLargeError(InputError):
    """Files larger than what is taken."""


class Limits(NamedTuple):
    """How many bytes files may have."""

    table: int = 50 * MEGABYTE
    recordings: int = 1000 * MEGABYTE
    """All together."""
    rig: int = MEGABYTE

    @property
    def together(self) -> int:
        """Of all files of one explanation."""
        return self.rig + self.table + max(self.table, self.recordings)


class Upload(NamedTuple):
    """A file as it came."""

    name: str
    """As people see it: the last part of its path, nothing in it that hides or turns text."""
    path: Path
    """Where it is stored."""
    size: int
    """In bytes."""


class Given(NamedTuple):
    """What an explanation is made from."""

    rig: Upload
    table: Upload | None
    """None with recordings."""
    recordings: Mapping[str, Upload]
    """Name in the rig file -> file."""
    healthy: Upload | None = None
    """Table of the healthy rotor."""

    @property
    def title(self) -> str:
        """Of the report, as `rotorjax explain` has it."""
        source, against = (self.rig, "the model") if self.table is None else (self.table, self.rig.name)
        return f"{source.name}: what {against} lacks"

    @property
    def shown(self) -> dict[str, str]:
        """Path of a stored file -> name by which people know it, that of a recording as the rig file has it."""
        given = [(upload.name, upload) for upload in (self.rig, self.table, self.healthy) if upload is not None]
        return {str(upload.path): harmless(name) for name, upload in (*given, *self.recordings.items())}


def shown_name(name: str) -> str:
    """The last part of a path that came with a file, fit to be shown."""
    # Some systems write an umlaut as two characters, others as one.
    last = unicodedata.normalize("NFC", PurePosixPath(name.replace("\\", "/")).name)
    last = harmless(last).replace("\n", " ").strip()
    return last[:LONGEST_NAME] or "file without a name"


def place_for(folder: Path, name: str) -> Path:
    """A new place in a folder: nothing of the file's name is in it but its ending, if that is a known one."""
    ending = PurePosixPath(name).suffix.lower()
    return folder / f"{secrets.token_hex(8)}{ending if ending in ENDINGS else ''}"


def sorted_out(uploads: Sequence[Upload], limits: Limits) -> Given:
    """Which file is what: one ends in .toml; of the others one may be the table of the healthy rotor that it names; the
    others are the recordings that it names, or one of them is a table.

    **Errors.** `InputError` where that cannot be told or files are missing, `TooLargeError`.
    """
    rig = _rig_among(uploads)
    if rig.size > limits.rig:
        raise TooLargeError(f"{rig.name}: {_size(rig.size)}; a rig file has at most {_size(limits.rig)}")
    others = {upload.name: upload for upload in uploads if upload is not rig}
    if len(others) < len(uploads) - 1:
        twice = next(name for name in others if [upload.name for upload in uploads].count(name) > 1)
        raise InputError(f"{twice}: two files have this name; rename one, here and in the rig file")
    named = recordings_named(rig.path)
    # By itself it is the measurement that is looked at.
    healthy = others.pop(shown_name(healthy_named(rig.path) or ""), None) if len(others) > 1 else None
    table = next(iter(others.values())) if len(others) == 1 else None
    if healthy is not None:
        _check_size(healthy, limits)
    if table is not None and not _is_recording(table, named):
        _check_size(table, limits)
        return Given(rig, table, {}, healthy)
    if not named:
        beside = f"{len(others)} files are beside {rig.name}" if others else f"only {rig.name} was given"
        raise InputError(
            f"{beside}: give one measurement table with it (and that of the healthy rotor, if its [model] names one as "
            "healthy), or name recordings under its [recordings] and give them"
        )
    return Given(rig, None, _recordings_among(rig, named, others, limits), healthy)


def _check_size(table: Upload, limits: Limits) -> None:
    """`TooLargeError` for a table that is too large."""
    if table.size > limits.table:
        raise TooLargeError(
            f"{table.name}: {_size(table.size)}; a table has at most {_size(limits.table)} (rotorjax serve "
            "--max-table-mb allows more)"
        )


def _rig_among(uploads: Sequence[Upload]) -> Upload:
    rigs = [upload for upload in uploads if upload.name.lower().endswith(".toml")]
    if len(rigs) == 1:
        return rigs[0]
    if rigs:
        raise InputError(f"{len(rigs)} rig files were given ({_listed(rig.name for rig in rigs)}); give one")
    raise InputError("no rig file was given; give one, its name ends in .toml (the example shows what is in it)")


def _is_recording(upload: Upload, named: Sequence[str]) -> bool:
    """Whether the one file beside a rig file that names recordings is one: by its name, or as it is no text."""
    text = upload.path.suffix in ("", ".csv", ".txt")
    return bool(named) and (not text or upload.name in map(shown_name, named))


def _recordings_among(
    rig: Upload, named: Sequence[str], others: Mapping[str, Upload], limits: Limits
) -> dict[str, Upload]:
    """Name in the rig file -> the file with the last part of it as its name.

    **Errors.** `InputError`.
    """
    last = {name: shown_name(name) for name in named}
    if len(set(last.values())) < len(last):
        twice = next(name for name in last if list(last.values()).count(last[name]) > 1)
        raise InputError(
            f"{rig.name}: [recordings] names two files called {last[twice]}, which cannot be told apart here; rename "
            "one, or use rotorjax explain --recordings"
        )
    problems = []
    if missing := [file for file in last.values() if file not in others]:
        problems.append(f"{rig.name}: [recordings] names {_listed(missing)}, not given; give all of them")
    if unknown := [name for name in others if name not in last.values()]:
        problems.append(
            f"{_listed(unknown)}: not named under [recordings] of {rig.name}; leave it out, or add it there"
        )
    if problems:
        raise InputError(*map(harmless, problems))
    found = {name: others[file] for name, file in last.items()}
    if (size := sum(upload.size for upload in found.values())) > limits.recordings:
        raise TooLargeError(_too_much(size, limits))
    return found


def refuse_before_reading(size: int, limits: Limits) -> None:
    """`TooLargeError` where more is sent than any files that are taken have together."""
    # What frames files takes some bytes of its own.
    if size > limits.together + MEGABYTE:
        raise TooLargeError(_too_much(size, limits))


def _too_much(size: int, limits: Limits) -> str:
    return (
        f"the files have {_size(size)}; tables have at most {_size(limits.table)}, recordings "
        f"{_size(limits.recordings)} together (rotorjax serve --max-table-mb, --max-recordings-mb allow more)"
    )


def _size(size: int) -> str:
    if size < MEGABYTE // 10:
        return f"{size:,} bytes"
    return f"{size / MEGABYTE:{',.0f' if size >= 100 * MEGABYTE else '.3g'}} MB"


def _listed(names: Iterable[str]) -> str:
    listed = list(names)
    more = len(listed) - 5
    return ", ".join(listed[:5]) + (f" and {more} more" if more > 0 else "")
