"""Compilation as a process sets it up, what it holds on to, and how that is let go."""

import ctypes
import functools
import os
import sys
import threading
from pathlib import Path

MOST_MAPS = 30_000
"""Memory maps of a process from which on compiled programs are dropped: Linux grants 65530 (vm.max_map_count), and a
compilation beyond them ends the process.
"""
MOST_RESIDENT = 1.0
"""Memory [GB] that a process holds between two cases from which on they are dropped, too: those for one set of probes
and orders take some 0.1 GB, and are read again from the cache in a second.
"""

Options = dict[str, bool | int | str]
OPTIONS: Options = {"xla_cpu_use_fusion_emitters": False, "xla_cpu_experimental_ynn_fusion_type": ""}
"""Options of the compiler: older fusion, with which large programs take some two thirds of the time and run as fast;
and none of the library for products, which takes a fifth of the balanced kernel's time for what are small sums.
"""
LEVEL = "xla_backend_optimization_level"
"""Option that says how much the compiler makes of its instructions: at 1, a program that is called often, half as slow
again to compile as at 0, and twice as fast; at its own 2, a fifth slower again to compile, and no faster.
"""
_ARENA_MAX = -8
"""M_ARENA_MAX of glibc, mallopt(3)."""
_ASKING = threading.Lock()


def compiler_options(*, often: bool) -> Options:
    """Those options that the installed compiler knows: asked once, whatever is compiled side by side. **Arguments:**
    ``often``: whether the program is called so often that fast code saves more than it takes to make.
    """
    with _ASKING:
        known = _known_options()
    return {**known, LEVEL: 1 if often else 0} if LEVEL in known else known


@functools.cache
def _known_options() -> Options:
    import jax  # noqa: PLC0415  what needs no JAX starts without it

    def known(options: Options) -> bool:
        try:
            jax.jit(lambda x: x, compiler_options=options)(0.0)
        except jax.errors.JaxRuntimeError:
            return False
        return True

    every = {**OPTIONS, LEVEL: 1}
    return every if known(every) else {name: value for name, value in every.items() if known({name: value})}


def use_double_precision() -> None:
    """Double precision, compiled programs kept for the next process, and what one thread frees there for the others."""
    import jax  # noqa: PLC0415

    _share_freed_memory()
    jax.config.update("jax_enable_x64", True)
    if cache := os.environ.get("JAX_COMPILATION_CACHE_DIR") or _cache_folder():
        jax.config.update("jax_compilation_cache_dir", cache)
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.1)


def spare_memory() -> None:
    """Return freed memory to the system, and drop compiled programs where a process holds many, as one does that sees
    thousands of rigs.
    """
    import jax  # noqa: PLC0415

    release_freed_memory()
    maps, sizes = Path("/proc/self/maps"), Path("/proc/self/statm")
    if not (maps.exists() and sizes.exists()):
        return
    resident = int(sizes.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e9
    if resident > MOST_RESIDENT or maps.read_bytes().count(b"\n") > MOST_MAPS:
        jax.clear_caches()
        release_freed_memory()


def release_freed_memory() -> None:
    """Return to the system what a compilation has freed, some hundred MB, where the C library is glibc."""
    if sys.platform == "linux" and (trim := getattr(ctypes.CDLL(None), "malloc_trim", None)):
        trim(0)


def _share_freed_memory() -> None:
    """One heap for all threads, where the C library is glibc: of one each some hundred MB lie idle. Threads rarely ask
    for memory at one time: it costs no time.
    """
    if sys.platform == "linux" and (tune := getattr(ctypes.CDLL(None), "mallopt", None)):
        tune(_ARENA_MAX, 1)


def _cache_folder() -> str | None:
    """A folder of the user's for compiled programs; none where it cannot be made, or the user has no home."""
    try:
        folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "rotorjax"
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, RuntimeError):
        return None
    return str(folder)
