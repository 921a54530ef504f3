"""Seconds of a call."""

import time
from collections.abc import Callable
from typing import TypeVar

Result = TypeVar("Result")


def timed(run: Callable[[], Result]) -> tuple[Result, float]:
    """What one call returns, and its seconds."""
    begin = time.perf_counter()
    found = run()
    return found, time.perf_counter() - begin


def best(run: Callable[[], object], repeats: int = 5) -> float:
    """Seconds of the fastest of several calls."""
    return min(timed(run)[1] for _ in range(repeats))
