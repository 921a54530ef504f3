"""Threads of this process, for functions that leave Python's lock to others most of the time, as compression does."""

from collections import deque
from collections.abc import Generator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor

from rotorjax.batch.case import Case, Function, Outcome, attempt


class Threads:
    """So many threads; one case more than there are of them is begun at one time, so that none waits."""

    def __init__(self, workers: int):
        self.workers = workers

    def outcomes(self, function: Function, cases: Sequence[Case]) -> Generator[Outcome, None, None]:
        """What becomes of every case, in their order."""
        begun: deque[Future[Outcome]] = deque()
        with ThreadPoolExecutor(self.workers) as pool:
            for case in cases:
                begun.append(pool.submit(attempt, function, case.name, case.payload))
                if len(begun) > self.workers:
                    yield begun.popleft().result()
            while begun:
                yield begun.popleft().result()
