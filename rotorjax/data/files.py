"""Text files read with a clear refusal; files written whole or not at all."""

import contextlib
import functools
import os
import re
import secrets
import stat
from collections.abc import Iterator
from pathlib import Path

from rotorjax.errors import InputError

_EXPORT = "export it as text: a table as CSV, a rig file as TOML"
_SHEET = "save the sheet as text (in Excel: 'CSV UTF-8')"
_UNPACK = "unpack it first"
_KINDS: tuple[tuple[bytes, str, str], ...] = (
    (rb"PK\x03\x04.{0,4000}?(\[Content_Types\]|xl/)", "an Excel workbook (.xlsx)", _SHEET),
    (rb"PK\x03\x04.{26}mimetypeapplication/vnd\.oasis", "an OpenDocument file (.ods)", _SHEET),
    (rb"PK\x03\x04.{26}[^/]{0,80}?\.npy", "a NumPy archive (.npz)", _EXPORT),
    (rb"PK\x03\x04", "a ZIP archive (an Excel workbook is one, too)", f"{_UNPACK}, or {_SHEET}"),
    (rb"\xd0\xcf\x11\xe0", "an old Excel workbook (.xls)", _SHEET),
    (rb"PAR1", "a Parquet file", _EXPORT),
    (rb"ARROW1", "an Arrow file", _EXPORT),
    (rb"MATLAB 5\.0 MAT-file|MATLAB 7\.3 MAT-file", "a MATLAB file (.mat)", _EXPORT),
    (rb"\x89HDF\r\n", "an HDF5 file (a MATLAB file of version 7.3 is one, too)", _EXPORT),
    (rb"\x93NUMPY", "a NumPy array (.npy)", _EXPORT),
    (rb"TDSm", "a TDMS file", _EXPORT),
    (rb"RIFF....WAVE", "a WAV recording", _EXPORT),
    (rb"SQLite format 3", "an SQLite database", _EXPORT),
    (rb"\x1f\x8b", "compressed by gzip", _UNPACK),
    (rb"BZh\d1AY", "compressed by bzip2", _UNPACK),
    (rb"\xfd7zXZ", "compressed by xz", _UNPACK),
    (rb"7z\xbc\xaf", "a 7-Zip archive", _UNPACK),
    (rb"%PDF-", "a PDF document", _EXPORT),
    (rb"\x89PNG|\xff\xd8\xff|GIF8", "a picture", _EXPORT),
)
"""How a file begins -> what it is, and the cure."""
_CONTROLS = re.compile(rb"[\x00-\x08\x0e-\x1a\x1c-\x1f]")
"""Bytes that no text in any encoding of one byte per character has. Escape has a message of its own."""
_SAMPLE = 8192
_NOT_WRITTEN = "cannot be written"


@contextlib.contextmanager
def refusals(path: Path | str, what: str = "", cure: str = "choose another path") -> Iterator[None]:
    """What the system refuses to do with a path, as an `InputError`: also a path that is none, being too long, in a
    circle or with a zero byte.

    **Arguments:** ``path``, or how it was given; ``what`` cannot be done, such as "cannot be written"; ``cure``.
    """
    try:
        yield
    except InputError:
        raise
    except (OSError, ValueError, RuntimeError) as error:
        why = getattr(error, "strerror", None) or error
        raise InputError(f"{path}: {f'{what} ({why})' if what else why}; {cure}") from error


def resolved(path: Path) -> Path:
    """A path with nothing relative and no link in it. **Errors.** `InputError` if it is none."""
    with refusals(path):
        return path.resolve()


def read_text(path: Path) -> str:
    """The text of a UTF-8 file, with or without byte order mark.

    **Errors.** `InputError` if the file cannot be opened, is no text, which is said, or is in another encoding.
    """
    with refusals(path, cure="give the path of a readable file"):
        if path.is_dir():
            raise InputError(f"{path}: is a folder; give the path of a file in it")
        raw = path.read_bytes()
    wide = _wide_encoding(raw)
    if wide:
        raise InputError(f"{path}: encoded as {wide}; save it as UTF-8 (for a table in Excel: 'CSV UTF-8')")
    for begins, kind, cure in _KINDS:
        if re.match(begins, raw[:_SAMPLE], re.DOTALL):
            raise InputError(f"{path}: {kind}, not a text file; {cure}")
    if b"\0" in raw:
        raise InputError(f"{path}: a binary file (it holds zero bytes), not a text file; {_EXPORT}")
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        if _CONTROLS.search(raw[:_SAMPLE]):
            raise InputError(f"{path}: a binary file, not a text file; {_EXPORT}") from error
        line = raw[: error.start].count(b"\n") + 1
        raise InputError(
            f"{path}:{line}: not UTF-8; save the file as UTF-8 (for a table in Excel: 'CSV UTF-8')"
        ) from error


def _wide_encoding(raw: bytes) -> str:
    """The encoding with two or four bytes for every character, by its byte order mark or its zero bytes."""
    if raw.startswith((b"\xff\xfe\0\0", b"\0\0\xfe\xff")):
        return "UTF-32"
    if raw.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "UTF-16"
    sample = raw[:_SAMPLE]
    halves = [half.count(0) for half in (sample[::2], sample[1::2])]
    all_of_one = len(sample) >= 4 and max(halves) >= 0.9 * (len(sample) // 2) and min(halves) == 0
    return "UTF-16 without a byte order mark" if all_of_one else ""


def write_whole(path: Path, content: str | bytes) -> None:
    """Write a file, a text as UTF-8, through a temporary one beside it, so that a failure leaves what was there. A file
    keeps its mode, a link stays one. What is no plain file, such as /dev/stdout, is written to, not replaced.

    **Errors.** `InputError` if the folder is missing or cannot be written to, or the file is protected.
    """
    data = content.encode() if isinstance(content, str) else content
    with refusals(path, _NOT_WRITTEN):
        found = _found(path)
        if found is not None and not stat.S_ISREG(found.st_mode):
            path.write_bytes(data)
            return
        with _temporary(path, found) as temporary:
            temporary.write_bytes(data)
            os.replace(temporary, resolved(path))


def check_writable(path: Path) -> None:
    """Refuse beforehand what `write_whole` would refuse, as far as a temporary file in the folder shows it.

    **Errors.** `InputError`.
    """
    with refusals(path, _NOT_WRITTEN):
        found = _found(path)
        if found is None or stat.S_ISREG(found.st_mode):
            with _temporary(path, found):
                pass


def _found(path: Path) -> os.stat_result | None:
    """What is there already, if anything.

    **Errors.** `InputError` for a folder, a file that is protected, and a file in a folder that does not exist.
    """
    if not path.name or path.is_dir():
        raise InputError(f"{path}: is a folder; name a file")
    if not path.parent.is_dir():
        raise InputError(
            f"{path}: {_NOT_WRITTEN}, the folder {path.parent} does not exist; make it, or choose a folder that exists"
        )
    try:
        found = path.stat()
    except FileNotFoundError:
        return None
    # The superuser may write to any file: its mode says what its owner wants.
    if not (found.st_mode & (stat.S_IWUSR | stat.S_IWGRP | stat.S_IWOTH) and os.access(path, os.W_OK)):
        raise InputError(f"{path}: is protected against writing; choose another path, or allow writing to it")
    return found


@contextlib.contextmanager
def _temporary(path: Path, found: os.stat_result | None) -> Iterator[Path]:
    """An empty file beside another, with its mode, or that of a new file; gone at the end."""
    temporary = resolved(path).parent / f".{secrets.token_hex(8)}.part"
    mode = 0o666 if found is None else stat.S_IMODE(found.st_mode) & 0o777
    with open(temporary, "xb", opener=functools.partial(os.open, mode=mode)):
        pass
    try:
        if found is not None:
            os.chmod(temporary, mode)
        yield temporary
    finally:
        temporary.unlink(missing_ok=True)
