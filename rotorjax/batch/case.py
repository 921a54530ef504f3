"""One case of many: what it is given, and what becomes of it. Needs no JAX, so that a worker starts at once."""

import json
import time
import traceback
from collections.abc import Callable, Generator, Sequence
from pathlib import Path
from typing import Any, NamedTuple, Protocol, runtime_checkable

from rotorjax.data.names import harmless

Function = Callable[[Any], dict[str, Any]]
"""What is done with each case: payload -> flat row. A function of a module, so that another process finds it."""


class Case(NamedTuple):
    """One case of a run."""

    name: str
    payload: Any
    """Argument of the function; can be pickled."""
    digest: str = ""
    """Of what the case is made of: a case that was finished with another digest is done anew."""


class Outcome(NamedTuple):
    """What became of one case."""

    name: str
    row: str | None
    """Flat row as JSON; none where there is none."""
    failure: str | None
    """Why there is no row."""
    seconds: float
    """That the case took in its worker."""

    @property
    def failed(self) -> bool:
        """Whether there is no row, or the row says why there is nothing else in it, under ``failure``."""
        return self.row is None or bool(json.loads(self.row).get("failure"))


@runtime_checkable
class Executor(Protocol):
    """Where cases are done."""

    workers: int
    """Cases done at one time."""

    def outcomes(self, function: Function, cases: Sequence[Case]) -> Generator[Outcome, None, None]:
        """What becomes of every case, in the order in which they end; where it is closed before its end, so is all that
        was begun.
        """
        ...


def attempt(function: Function, name: str, payload: Any) -> Outcome:
    """Do one case. What the function raises is its outcome, so that one case never ends a run."""
    began = time.monotonic()
    try:
        row, failure = json.dumps(function(payload), allow_nan=False), None
    except Exception as error:  # whatever it is, the other cases go on
        row, failure = None, _message(error)
    return Outcome(name, row, failure, time.monotonic() - began)


def _message(error: Exception) -> str:
    """An exception that nobody foresaw in one line, with the place that raised it."""
    last = traceback.extract_tb(error.__traceback__)[-1]
    told = f"{type(error).__name__}: {error} ({Path(last.filename).name}:{last.lineno}, in {last.name})"
    return harmless(told)
