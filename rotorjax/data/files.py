"""Text files read with a clear refusal; files written whole or not at all."""

import os
import tempfile
from pathlib import Path

from rotorjax.errors import InputError


def read_text(path: Path) -> str:
    """The text of a UTF-8 file, with or without byte order mark.

    **Errors.** `InputError` if the file cannot be opened or is in another encoding.
    """
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}; give the path of a readable file") from error
    if raw.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise InputError(f"{path}: encoded as UTF-16; save it as UTF-8 (for a table in Excel: 'CSV UTF-8')")
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw[: error.start].count(b"\n") + 1
        raise InputError(
            f"{path}:{line}: not UTF-8; save the file as UTF-8 (for a table in Excel: 'CSV UTF-8')"
        ) from error
    if "\0" in text:
        raise InputError(f"{path}: holds zero bytes, so it is not a text file; give a CSV or TOML file")
    return text


def write_whole(path: Path, content: str | bytes) -> None:
    """Write a file, a text as UTF-8, through a temporary one beside it, so that a failure leaves what was there.

    **Errors.** `InputError` if the folder is missing or cannot be written to.
    """
    try:
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    except OSError as error:
        raise InputError(
            f"{path}: cannot be written ({error.strerror or error}); choose a folder that exists"
        ) from error
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content.encode() if isinstance(content, str) else content)
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    except OSError as error:
        Path(temporary).unlink(missing_ok=True)
        raise InputError(f"{path}: cannot be written ({error.strerror or error}); choose another path") from error
