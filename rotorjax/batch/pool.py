"""A pool of processes on this machine. Each worker is a pool of its own with one process, so that a worker that dies
costs the case that it was at and no other.
"""

import contextlib
import multiprocessing
import os
import signal
import threading
from collections import deque
from collections.abc import Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import Connection
from typing import NamedTuple

from rotorjax.batch.case import Case, Function, Outcome, attempt

TRIALS = 2
"""Times that a case is begun whose worker dies: once more tells a case that kills from one that was in the way."""
ONE_THREAD = {name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NPROC")}
"""Environment of a worker: NumPy's and SciPy's linear algebra, and XLA (``NPROC``), each with one thread."""
_QUIET = "ignore:resource_tracker"
"""A run that is stopped leaves semaphores to Python's tracker, which frees them; its warning says nothing to users."""


def processors() -> int:
    """Processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class _UnderWay(NamedTuple):
    """A case in a worker."""

    lane: int
    case: Case
    trial: int


class Processes:
    """So many processes on this machine."""

    def __init__(self, workers: int):
        self.workers = workers

    def outcomes(self, function: Function, cases: Sequence[Case]) -> Generator[Outcome, None, None]:
        """What becomes of every case, in the order in which they end; no worker outlives this process, nor the
        iteration.
        """
        waiting = deque((case, 1) for case in cases)
        under_way: dict[Future[Outcome], _UnderWay] = {}
        with _lanes(min(self.workers, len(cases))) as lanes:
            free = deque(range(len(lanes)))

            def begin() -> None:
                while waiting and free:
                    lane, (case, trial) = free.popleft(), waiting.popleft()
                    under_way[lanes.submit(lane, function, case)] = _UnderWay(lane, case, trial)

            begin()
            while under_way:
                ended, _ = wait(under_way, return_when=FIRST_COMPLETED)
                for future in ended:
                    lane, case, trial = under_way.pop(future)
                    free.append(lane)
                    died = isinstance(future.exception(), BrokenProcessPool)
                    if died:
                        lanes.renew(lane)
                    again = died and trial < TRIALS
                    if again:
                        waiting.appendleft((case, trial + 1))
                    # Before the outcome is given out, so that no worker waits until it is kept.
                    begin()
                    if not again:
                        yield _outcome(future, case)


def _outcome(future: Future[Outcome], case: Case) -> Outcome:
    error = future.exception()
    if error is None:
        return future.result()
    if isinstance(error, BrokenProcessPool):
        return Outcome(
            case.name,
            None,
            f"its process died, {TRIALS} times (killed, or out of memory); fewer workers at one time need less memory",
            0.0,
        )
    return Outcome(case.name, None, f"{type(error).__name__}: {error}", 0.0)


class _Lanes:
    """Processes, one for each lane, made when they are first needed."""

    def __init__(self, count: int, lifeline: Connection):
        self._lifeline = lifeline
        self._pools = [self._made() for _ in range(count)]

    def __len__(self) -> int:
        return len(self._pools)

    def submit(self, lane: int, function: Function, case: Case) -> Future[Outcome]:
        """Begin a case; where the worker died while it had nothing to do, in a new one."""
        with _interrupt_held():
            try:
                return self._pools[lane].submit(attempt, function, case.name, case.payload)
            except BrokenProcessPool:
                self.renew(lane)
                return self._pools[lane].submit(attempt, function, case.name, case.payload)

    def renew(self, lane: int) -> None:
        """A new worker in the place of one that died."""
        self._pools[lane].shutdown(wait=False)
        self._pools[lane] = self._made()

    def shutdown(self, *, wait: bool) -> None:
        """End the workers."""
        for pool in self._pools:
            pool.shutdown(wait=False)
        for pool in self._pools if wait else ():
            pool.shutdown(wait=True)

    def _made(self) -> ProcessPoolExecutor:
        context = multiprocessing.get_context("spawn")
        return ProcessPoolExecutor(1, mp_context=context, initializer=_begin_worker, initargs=(self._lifeline,))


@contextlib.contextmanager
def _lanes(count: int) -> Iterator[_Lanes]:
    """Workers that end with the block: at its regular end when they are done, otherwise at once."""
    lifeline, held = multiprocessing.get_context("spawn").Pipe(duplex=False)
    warnings = ",".join(filter(None, (os.environ.get("PYTHONWARNINGS"), _QUIET)))
    with _environment({**ONE_THREAD, "PYTHONWARNINGS": warnings}), lifeline:
        lanes = _Lanes(count, lifeline)
        try:
            yield lanes
            lanes.shutdown(wait=True)
        finally:
            held.close()
            lanes.shutdown(wait=False)


@contextlib.contextmanager
def _environment(values: dict[str, str]) -> Iterator[None]:
    """Variables that processes started meanwhile inherit."""
    before = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


@contextlib.contextmanager
def _interrupt_held() -> Iterator[None]:
    """A process that is started meanwhile sees no Ctrl-C, from its first moment on; this one sees it afterwards."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _begin_worker(lifeline: Connection) -> None:
    """In a worker: Ctrl-C is the parent's, where it could not be held, and when the parent lets go of its end, or is
    gone, so is the worker.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def wait_for_end() -> None:
        with contextlib.suppress(EOFError, OSError):
            lifeline.recv_bytes()
        os._exit(1)

    threading.Thread(target=wait_for_end, daemon=True).start()
