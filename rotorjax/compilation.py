"""What compilations hold on to, and how it is let go."""

import ctypes
import sys


def release_freed_memory() -> None:
    """Return to the system what a compilation has freed, some hundred MB, where the C library is glibc: it keeps that
    for each thread apart.
    """
    if sys.platform == "linux" and (trim := getattr(ctypes.CDLL(None), "malloc_trim", None)):
        trim(0)
