"""What an explanation says while it goes on."""

from collections.abc import Callable

from rotorjax.inference.budget import Budget

REPEATED = 10_000
"""Linearisations after which a stage that goes on is reported again: some seconds."""
Progress = Callable[[str], None]


class ProgressReporter:
    """Says what is being done, and how much of the limit is spent, at every stage and while it goes on."""

    def __init__(self, progress: Progress, limit: int) -> None:
        self.budget = Budget(limit, watch=self._grown)
        self._progress, self._limit, self._line, self._reported = progress, limit, "", 0

    def stage(self, line: str) -> None:
        """Begin a stage, if it is not under way."""
        if line == self._line:
            return
        self._line = line
        self._report(self.budget.spent)

    def _grown(self, spent: int) -> None:
        if self._line and spent - self._reported >= REPEATED:
            self._report(spent)

    def _report(self, spent: int) -> None:
        self._reported = spent
        self._progress(f"{self._line} ({spent:,} of {self._limit:,} linearisations)")
