"""The same cases on a cluster: Dask distributes them, this process keeps what comes back."""

import importlib.util
from collections.abc import Iterator, Sequence

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
        self.workers = sum(self._client.nthreads().values())
        if not self.workers:
            self._client.close()
            raise InputError(
                f"--cluster {address}: has no worker; start some with 'dask worker {address} --nthreads 1'"
            )

    def outcomes(self, function: Function, cases: Sequence[Case]) -> Iterator[Outcome]:
        """What becomes of every case, in the order in which they end. A case whose worker dies is tried on others, as
        often as the scheduler's ``allowed-failures`` says.
        """
        from distributed import as_completed  # noqa: PLC0415

        with self._client as client:
            names = {client.submit(attempt, function, case.name, case.payload, pure=False): case.name for case in cases}
            for future in as_completed(list(names)):
                name, error = names.pop(future), future.exception()
                yield future.result() if error is None else Outcome(name, None, _told(error), 0.0)
                future.release()


def _told(error: BaseException) -> str:
    if type(error).__name__ == "KilledWorker":
        return "its workers died (killed, or out of memory)"
    return f"{type(error).__name__}: {error}"
