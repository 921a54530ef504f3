"""The one runner: cases of a run that are not finished yet are done, and kept as they end."""

import contextlib
import time
from collections.abc import Callable, Sequence
from typing import NamedTuple, Protocol, runtime_checkable

from rotorjax.batch.case import Case, Executor, Function, Outcome


@runtime_checkable
class Keeper(Protocol):
    """What keeps the outcomes of a run."""

    def plan(self, cases: Sequence[Case]) -> list[Case]:
        """Say which cases the run has. **Returns** those that are not finished."""
        ...

    def keep(self, case: Case, outcome: Outcome) -> None:
        """Keep what became of a case, at once."""
        ...


class Progress(NamedTuple):
    """How far a run is."""

    total: int
    """Cases of the run."""
    before: int
    """Of them finished before this start."""
    done: int
    """Of them finished since."""
    failed: int
    """Of those that failed."""
    left_s: float | None
    """Estimate of the time left: cases left times mean time of a case, by workers [s]; none before the first."""
    latest: Outcome | None = None
    """What ended last."""


def run(
    function: Function,
    cases: Sequence[Case],
    store: Keeper,
    executor: Executor,
    told: Callable[[Progress], object] = lambda progress: None,
) -> Progress:
    """Do all cases that the store does not hold yet.

    **Arguments:** ``function``: of a module; ``told``: called at the start and after every case. **Returns** the last
    progress.
    """
    left = store.plan(cases)
    by_name, taken, began = {case.name: case for case in left}, 0.0, time.monotonic()
    progress = Progress(len(cases), len(cases) - len(left), 0, 0, None)
    told(progress)
    if not left:
        return progress
    at_once = min(executor.workers, len(left))
    # Whatever is raised meanwhile, workers end with it.
    with contextlib.closing(executor.outcomes(function, left)) as outcomes:
        for outcome in outcomes:
            store.keep(by_name[outcome.name], outcome)
            taken += outcome.seconds
            done = progress.done + 1
            # What is between the cases counts once every worker has had some.
            each = max(taken / done / at_once, (time.monotonic() - began) / done if done > 2 * at_once else 0.0)
            failed = progress.failed + outcome.failed
            progress = progress._replace(done=done, failed=failed, left_s=(len(left) - done) * each, latest=outcome)
            told(progress)
    return progress
