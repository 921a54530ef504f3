"""Cases that take no time, for the runner: workers import this file, which needs no JAX."""

import os
import signal
import sys
import time
from pathlib import Path

from rotorjax.batch.case import Case
from rotorjax.batch.pool import Processes
from rotorjax.batch.runner import run
from rotorjax.batch.store import Store
from rotorjax.cli.progress import progress_line

CONFIGURATION = {"command": "test", "power": 2}


def square(number: int) -> dict:
    """The square, and which process made it, with how many threads."""
    return {"square": number**2, "process": os.getpid(), "threads": os.environ["OMP_NUM_THREADS"]}


def troubled(payload: tuple[str, Path]) -> dict:
    """What its name says, a mark left for each time that it was begun."""
    what, folder = payload
    with (folder / what).open("a") as marks:
        marks.write("x")
    first = (folder / what).stat().st_size == 1
    if what == "kills" or (what == "kills once" and first):
        os.kill(os.getpid(), signal.SIGKILL)
    if what == "raises":
        raise RuntimeError("nobody foresaw this")
    if what == "not finite":
        return {"value": float("nan")}
    return {"failure": "no rig file"} if what == "bad input" else {"value": 1.0}


def slow_square(number: int) -> dict:
    """`square`, in ten milliseconds."""
    time.sleep(0.01)
    return square(number)


def endless(number: int) -> dict:
    """A case that does not end."""
    time.sleep(3600.0)
    return {"value": number}


def announced(number: int) -> dict:
    """A case that does not end, and leaves a file where it begins."""
    Path(f"begun {number}").touch()
    return endless(number)


def first_or_endless(number: int) -> dict:
    """Only case 0 ends."""
    return endless(number) if number else {"value": number}


def main() -> None:
    """A run of many cases that is meant to be killed: says the name of every case that it has kept."""
    path, count = Path(sys.argv[1]), int(sys.argv[2])
    function = {"slow": slow_square, "announced": announced}[sys.argv[3]]
    cases = [Case(f"case {k}", k) for k in range(count)]
    with progress_line(kept="kept") as show, Store(path, CONFIGURATION, ("square",)) as store:
        run(function, cases, store, Processes(2), lambda progress: show(f"{progress.before} {progress.done}"))


if __name__ == "__main__":
    main()
