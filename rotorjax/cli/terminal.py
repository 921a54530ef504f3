"""The only place that writes to standard output and standard error: control characters written out, and no complaint
where the reader of a pipe has seen enough.
"""

import os
import shutil
import sys
from collections.abc import Iterable
from typing import TextIO

from rotorjax.data.names import harmless
from rotorjax.errors import InputError

_ELSEWHERE = "let it go to a terminal, or to a file where there is room"


def terminal_width() -> int | None:
    """Columns of the terminal that standard output is; none where it is a file or a pipe, which take lines of any
    length.
    """
    return shutil.get_terminal_size().columns if sys.stdout and sys.stdout.isatty() else None


def say(text: str) -> None:
    """Print a result; that the reader of a pipe has seen enough does not cost the files asked for.

    **Errors.** `InputError` where standard output cannot be written to: for the first text, the others are not printed.
    """
    try:
        if sys.stdout is None:
            sys.stdout = _nowhere()
            raise InputError(f"standard output: is closed; {_ELSEWHERE}")
        print(harmless(text), flush=True)
    except BrokenPipeError:
        leave_output()
    except OSError as error:
        leave_output()
        raise InputError(f"standard output: cannot be written to ({error.strerror or error}); {_ELSEWHERE}") from error


def aside(text: str, end: str = "\n") -> None:
    """Print on standard error, as it is; where nobody can be told, the command goes on."""
    try:
        print(text, end=end, file=sys.stderr, flush=True)
    except OSError:
        _leave(sys.stderr)


def complain(text: str) -> None:
    """Print a problem or a note on standard error."""
    aside(f"rotorjax: {harmless(text)}")


def note(notes: Iterable[str]) -> None:
    """Print what was tolerated, or looks like a mistake, on standard error."""
    for line in notes:
        complain(f"note: {line}")


def leave_output() -> None:
    """Nobody reads standard output any more; Python would complain once more when it closes it."""
    _leave(sys.stdout)


def _leave(stream: TextIO) -> None:
    with _nowhere() as nowhere:
        os.dup2(nowhere.fileno(), stream.fileno())


def _nowhere() -> TextIO:
    return open(os.devnull, "w", encoding="utf-8")


def accept_any_character() -> None:
    """Characters that the terminal's encoding lacks are written as escapes rather than ending the command; what would
    go to a standard error that is closed goes nowhere.
    """
    if sys.stderr is None:
        sys.stderr = _nowhere()
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")  # type: ignore[union-attr]
