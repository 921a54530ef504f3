"""What the runner of many cases costs: start of a worker to the first result, two processes against one, and what lies
between the cases.

    python benchmarks/batch.py

Times are of this machine as it is now: the load on it is printed with them.
"""

import os
import shutil
import tempfile
import time
from pathlib import Path

import numpy as np

from rotorjax.batch.case import Case
from rotorjax.batch.explaining import Task, explain_case
from rotorjax.batch.pool import Processes
from rotorjax.batch.runner import Progress, run
from rotorjax.batch.store import Store

CASES, SHORT = 40, 400
EXAMPLE = Path(__file__).parent.parent / "rotorjax" / "data" / "example"


def explained(number: int) -> dict:
    """The shipped example explained, with how long a processor was at work on it, and before it in the same worker."""
    before = time.process_time()
    explain_case(Task(EXAMPLE / "measurement.csv", EXAMPLE / "rig.toml"))
    return {"number": number, "before": before, "processor": time.process_time() - before}


def asleep(milliseconds: int) -> dict:
    """A case that needs no processor."""
    time.sleep(1e-3 * milliseconds)
    return {}


def timed(function, payloads: list, workers: int) -> tuple[float, float, list[dict]]:
    """Seconds of a run, seconds to its first result, and its rows."""
    first: list[float] = []
    began = time.monotonic()

    def told(progress: Progress) -> None:
        if progress.done == 1:
            first.append(time.monotonic() - began)

    folder = Path(tempfile.mkdtemp())
    with Store(folder / "rows.sqlite", {}) as store:
        run(function, [Case(str(k), payload) for k, payload in enumerate(payloads)], store, Processes(workers), told)
        rows = store.rows()
    shutil.rmtree(folder)
    return time.monotonic() - began, first[0], rows


def load() -> str:
    return f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors"


def main() -> None:
    print(f"{'':34}seconds   first result   cases a minute")
    taken, work = {}, {}
    for workers in (1, 2):
        before = load()
        taken[workers], first, rows = timed(explained, list(range(CASES)), workers)
        told = f"{CASES} explanations, {workers} worker{'s' * (workers > 1)}"
        print(f"{told:34}{taken[workers]:7.1f}{first:15.1f}{60 * CASES / taken[workers]:17.1f}   {before}")
        work[workers] = float(np.median([row["processor"] for row in rows]))
        starting = min(rows, key=lambda row: row["before"])
        print(
            f"{'':34}processor time of a case {work[workers]:.1f} s (median); of a worker's start "
            f"{starting['before']:.1f} s, and of its first case {starting['processor']:.1f} s"
        )
    clock, processor = taken[1] / taken[2], 2 * work[1] / work[2]
    print(f"two workers against one: {clock:.2f} by the clock, {processor:.2f} by processor time")
    print(f"{3600 / work[1]:.0f} cases a processor and hour; a thousand take {work[1] / 3.6:.2f} processor hours")
    for milliseconds in (0, 100):
        seconds, first, _ = timed(asleep, [milliseconds] * SHORT, 2)
        each = (seconds - first) / (SHORT - 1) * 2
        print(
            f"cases of {milliseconds} ms, 2 workers: {1e3 * each - milliseconds:.1f} ms of a worker between two cases; "
            f"first result after {first:.2f} s"
        )


if __name__ == "__main__":
    main()
