"""The same cases on a cluster: Dask distributes them, this process keeps what comes back."""

import asyncio
import concurrent.futures
import contextlib
import importlib.util
from collections.abc import Generator, Sequence
from typing import Any

from rotorjax.batch.case import Case, Function, Outcome, attempt
from rotorjax.errors import InputError

ANSWER_S = 15
"""How long a scheduler may take to answer."""


class Cluster:
    """The workers of a Dask scheduler, which have this package and see the same files under the same paths.

    **Arguments:** ``address``: of the scheduler, ``tcp://host:8786``. **Errors.** `InputError` if Dask is not
    installed, or nothing answers there, or no worker is there.
    """

    def __init__(self, address: str):
        if importlib.util.find_spec("distributed") is None:
            raise InputError(
                "--cluster: needs Dask, which is not installed; pip install 'rotorjax[cluster]', or leave it out to "
                "use this machine"
            )
        from distributed import Client  # noqa: PLC0415  an extra

        try:
            self._client = Client(address, timeout=ANSWER_S, set_as_default=False)
        except (OSError, ValueError) as error:
            raise InputError(
                f"--cluster {address}: no scheduler answers ({error}); start one with 'dask scheduler', and give the "
                "address that it prints, tcp://host:8786"
            ) from error
        threads: Any = self._client.nthreads()
        self.workers = sum(threads.values())
        if not self.workers:
            self._client.close()
            raise InputError(
                f"--cluster {address}: has no worker; start some with 'dask worker {address} --nthreads 1'"
            )

    def outcomes(self, function: Function, cases: Sequence[Case]) -> Generator[Outcome, None, None]:
        """What becomes of every case, in the order in which they end.

        Where a worker dies Dask suspects all cases that it had, running or not, and gives up those that it suspects
        more often than the scheduler's ``allowed-failures``: these are tried once more at the end, each alone, so that
        only the case fails that does it.
        """
        from distributed import as_completed  # noqa: PLC0415
        from distributed.scheduler import KilledWorker  # noqa: PLC0415

        with self._client as client:

            def begun(case: Case) -> Any:
                return client.submit(attempt, function, case.name, case.payload, pure=False)

            under_way, suspects = {begun(case): case for case in cases}, []
            for future in as_completed(list(under_way), loop=client.loop):
                case = under_way.pop(future)
                if isinstance(_error(future), KilledWorker):
                    suspects.append(case)
                else:
                    yield _outcome(future, case)
            for case in suspects:
                yield _outcome(begun(case), case)


def _error(future: Any) -> BaseException | None:
    """What a future ended with; waits for its end. **Errors.** `InputError` if the scheduler is gone."""
    with contextlib.suppress(asyncio.CancelledError, concurrent.futures.CancelledError):
        error = future.exception()
        if not future.cancelled():
            return error
    raise InputError(
        "--cluster: the scheduler was lost; what is finished is kept, the same command goes on with the rest"
    )


def _outcome(future: Any, case: Case) -> Outcome:
    error = _error(future)
    if error is None:
        return future.result()
    if type(error).__name__ == "KilledWorker":
        return Outcome(case.name, None, "its worker died (killed, or out of memory), alone too", 0.0)
    return Outcome(case.name, None, f"{type(error).__name__}: {error}", 0.0)
