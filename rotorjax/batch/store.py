"""Rows as they finish, in one SQLite file: each in a transaction of its own, so that a run that is killed at any moment
loses nothing finished and leaves nothing half-written.

The file holds the run's configuration, the cases planned, and what became of them; the view ``results`` has one line
per case planned and finished, one column per key of its row. It can be read while a run writes it.
"""

import json
import sqlite3
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from rotorjax.batch.case import Case, Outcome
from rotorjax.errors import InputError

PATIENCE_S = 60.0
"""How long a transaction waits for somebody who reads."""
_TABLES = (
    "CREATE TABLE run (key TEXT PRIMARY KEY, value TEXT NOT NULL)",
    "CREATE TABLE planned (position INTEGER PRIMARY KEY, name TEXT NOT NULL UNIQUE, digest TEXT NOT NULL)",
    "CREATE TABLE finished (name TEXT PRIMARY KEY, digest TEXT NOT NULL, row TEXT, failure TEXT, seconds REAL)",
)
_DONE = "planned JOIN finished ON finished.name = planned.name AND finished.digest = planned.digest"


class Store:
    """The file of one run, which only one process writes to.

    **Arguments:** ``configuration``: what the rows depend on beside their cases, values of JSON; ``columns``: keys of
    the rows that the view ``results`` shows. **Errors.** `InputError` if the file is none of these, is another run's,
    is being written to by another process, or cannot be written.
    """

    def __init__(self, path: Path, configuration: Mapping[str, Any], columns: Sequence[str] = ()):
        self.path = path
        self._columns = tuple(columns)
        try:
            self._connection = sqlite3.connect(path, timeout=0.2, isolation_level=None)
        except sqlite3.Error as error:
            raise self._refusal(error) from error
        try:
            self._connection.execute("BEGIN IMMEDIATE")
            self._connection.execute(f"PRAGMA busy_timeout = {1000 * PATIENCE_S:.0f}")
            self._begin({key: json.dumps(value, sort_keys=True) for key, value in configuration.items()})
        except (sqlite3.Error, InputError) as error:
            self._connection.close()
            raise self._refusal(error) if isinstance(error, sqlite3.Error) else error from error

    def plan(self, cases: Sequence[Case]) -> list[Case]:
        """Say which cases the run has. **Returns** those that are not finished: new ones, those whose digest is another
        one now, and those that ended without a row, which are tried again. What is finished of cases that the run has
        no longer stays in the file and is not shown.
        """
        try:
            self._connection.execute("DELETE FROM planned")
            rows = [(k, case.name, case.digest) for k, case in enumerate(cases)]
            self._connection.executemany("INSERT INTO planned VALUES (?, ?, ?)", rows)
            self._commit()
            done = self._connection.execute(f"SELECT planned.name FROM {_DONE} WHERE row IS NOT NULL")
            finished = {name for (name,) in done}
        except sqlite3.Error as error:
            raise self._refusal(error) from error
        return [case for case in cases if case.name not in finished]

    def keep(self, case: Case, outcome: Outcome) -> None:
        """Keep what became of a case, at once."""
        row = (case.name, case.digest, outcome.row, outcome.failure, outcome.seconds)
        try:
            self._connection.execute("INSERT OR REPLACE INTO finished VALUES (?, ?, ?, ?, ?)", row)
            self._commit()
        except sqlite3.Error as error:
            raise self._refusal(error) from error

    def rows(self) -> list[dict[str, Any]]:
        """Rows of the cases planned and finished, in their order, with keys ``name``, ``failure`` and ``seconds``."""
        done = self._connection.execute(
            f"SELECT planned.name, row, failure, seconds FROM {_DONE} ORDER BY planned.position"
        )
        return [
            {"name": name, "failure": failure, "seconds": seconds, **(json.loads(row) if row else {})}
            for name, row, failure, seconds in done
        ]

    def close(self) -> None:
        """Let go of the file."""
        self._connection.close()

    def __enter__(self) -> "Store":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _commit(self) -> None:
        """End the transaction, and begin the next at once: it keeps other writers away and lets readers read."""
        self._connection.execute("COMMIT")
        self._connection.execute("BEGIN IMMEDIATE")

    def _begin(self, configuration: Mapping[str, str]) -> None:
        """Make what a new file holds, or see that the file is of this run."""
        there = {name for (name,) in self._connection.execute("SELECT name FROM sqlite_master")}
        if there:
            self._compare(there, configuration)
        else:
            for table in _TABLES:
                self._connection.execute(table)
            self._connection.executemany("INSERT INTO run VALUES (?, ?)", list(configuration.items()))
        self._connection.execute("DROP VIEW IF EXISTS results")
        self._connection.execute(self._view())
        self._commit()

    def _view(self) -> str:
        own = ("name", "seconds", "failure")
        columns = [name for name in self._columns if name not in own]
        shown = [f"json_extract(row, '$.{name}') AS \"{name}\"" for name in _plain(columns)]
        failure = "coalesce(failure, json_extract(row, '$.failure')) AS failure"
        listed = ", ".join(["planned.name AS name", *shown, "seconds", failure])
        return f"CREATE VIEW results AS SELECT {listed} FROM {_DONE} ORDER BY planned.position"

    def _compare(self, there: set[str], wanted: Mapping[str, str]) -> None:
        """Refuse a file of something else."""
        if not {"run", "planned", "finished"} <= there:
            raise InputError(f"{self.path}: is an SQLite file of something else; choose another file")
        found = dict(self._connection.execute("SELECT key, value FROM run"))
        if differing := [key for key in {**wanted, **found} if wanted.get(key) != found.get(key)]:
            what = "; ".join(
                f"{key} is {found.get(key, 'not set')} there, {wanted.get(key, 'not set')} here" for key in differing
            )
            raise InputError(
                f"{self.path}: holds the results of another run ({what}); choose another file, or remove this one"
            )

    def _refusal(self, error: sqlite3.Error) -> InputError:
        if "not a database" in str(error):
            return InputError(f"{self.path}: is no SQLite file; choose another file")
        if "locked" in str(error):
            return InputError(f"{self.path}: another run is writing to it; wait for its end, or choose another file")
        return InputError(f"{self.path}: cannot be written ({error}); choose another file")


def _plain(names: Iterable[str]) -> list[str]:
    """Names that can stand in SQL as they are."""
    assert all(name.isidentifier() for name in names), names
    return list(names)
