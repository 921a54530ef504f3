"""What compiled programs hold on to, and how it is let go."""

import ctypes
import sys
from pathlib import Path

import jax

MOST_MAPS = 30_000
"""Memory maps of this process from which on compiled programs are dropped: Linux grants 65530 (vm.max_map_count)."""


def forget_compiled() -> None:
    """Drop what was compiled so far if the process nears the limit of memory maps, at which a compilation ends it
    (SIGSEGV).

    Each measurement of a new size adds some three thousand maps, which JAX keeps for as long as the program may be used
    again.
    """
    maps = Path("/proc/self/maps")
    if maps.exists() and maps.read_bytes().count(b"\n") > MOST_MAPS:
        jax.clear_caches()


def release_freed_memory() -> None:
    """Return to the system what a compilation has freed, some hundred MB, where the C library is glibc: it keeps that
    for each thread apart.
    """
    if sys.platform == "linux" and (trim := getattr(ctypes.CDLL(None), "malloc_trim", None)):
        trim(0)
