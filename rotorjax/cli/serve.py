"""`serve`: a page on this machine to drop files on."""

import argparse
import importlib.util

from rotorjax.cli.terminal import say
from rotorjax.errors import InputError

NEEDED = {"starlette": "starlette", "uvicorn": "uvicorn", "python_multipart": "python-multipart"}
"""Modules that the page takes -> packages, all in the extra ``web``."""
HIGHEST_PORT = 65535
LARGEST_MB = 1e9


def serve(options: argparse.Namespace) -> None:
    """The page, until Ctrl-C."""
    if not 0 <= options.port <= HIGHEST_PORT:
        raise InputError(f"--port {options.port}: must be 1 to {HIGHEST_PORT}, or 0 for any that is free")
    for flag in ("max_table_mb", "max_recordings_mb"):
        given = getattr(options, flag)
        if not 0.0 < given <= LARGEST_MB:
            told = f"--{flag.replace('_', '-')} {given}"
            raise InputError(f"{told}: must be a number above zero, at most {LARGEST_MB:g}")
    if missing := [package for module, package in NEEDED.items() if importlib.util.find_spec(module) is None]:
        packages = f"the package{'s' if len(missing) > 1 else ''} {', '.join(missing)}"
        raise InputError(f"serve takes {packages}, not installed: pip install 'rotorjax[web]'")
    from rotorjax.web import server
    from rotorjax.web.uploads import MEGABYTE, Limits

    limits = Limits(round(options.max_table_mb * MEGABYTE), round(options.max_recordings_mb * MEGABYTE))
    server.serve(
        options.port,
        limits,
        on_start=lambda address: say(f"{address} (drop your files there; Ctrl-C ends it)"),
        open_browser=options.open,
    )
