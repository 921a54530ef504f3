"""The only place that writes to standard output and standard error: control characters written out, and no complaint
where the reader of a pipe has seen enough.
"""

import os
import shutil
import sys
from collections.abc import Iterable

from rotorjax.data.names import harmless


def terminal_width() -> int | None:
    """Columns of the terminal that standard output is; none where it is a file or a pipe, which take lines of any
    length.
    """
    return shutil.get_terminal_size().columns if sys.stdout.isatty() else None


def say(text: str) -> None:
    """Print a result; that the reader of a pipe has seen enough does not cost the files asked for."""
    try:
        print(harmless(text), flush=True)
    except BrokenPipeError:
        leave_output()


def complain(text: str) -> None:
    """Print a problem or a note on standard error."""
    print(f"rotorjax: {harmless(text)}", file=sys.stderr)


def note(notes: Iterable[str]) -> None:
    """Print what was tolerated, or looks like a mistake, on standard error."""
    for line in notes:
        complain(f"note: {line}")


def leave_output() -> None:
    """Nobody reads standard output any more; Python would complain once more when it closes it."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def accept_any_character() -> None:
    """Characters that the terminal's encoding lacks are written as escapes rather than ending the command."""
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")  # type: ignore[union-attr]
