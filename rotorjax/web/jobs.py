"""One explanation at a time: what it is at, what came of it, and the files that it needs and leaves."""

import asyncio
import contextlib
import dataclasses
import re
import secrets
import shutil
import time
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any, Literal

from rotorjax.errors import InputError
from rotorjax.web.child import Child
from rotorjax.web.uploads import Given
from rotorjax.web.worker import REPORT, RESULT, RIG

RESULTS = (REPORT, RIG, RESULT)
_SPENT = re.compile(r"(?P<stage>.*) \((?P<spent>[\d,]+) of (?P<limit>[\d,]+) linearisations\)")
"""A line of progress with what is spent of the limit."""

State = Literal["running", "done", "refused", "cancelled", "broken"]
"""Refused is bad input, broken a defect or a process that has died."""


class BusyError(InputError):
    """Another explanation is being made."""


@dataclasses.dataclass
class Job:
    """One explanation."""

    files: list[str]
    """Names of what it is made from."""
    folder: Path
    """Of the files given, and of the results."""
    id: str = dataclasses.field(default_factory=lambda: secrets.token_hex(8))
    began: float = dataclasses.field(default_factory=time.monotonic)
    ended: float | None = None
    state: State = "running"
    stages: list[tuple[float, str]] = dataclasses.field(default_factory=list)
    """Seconds after the beginning, and what was begun then."""
    line: str = ""
    """What is being done, as it was told last."""
    spent: int | None = None
    """Single cases linearised so far, where that is told."""
    limit: int | None = None
    problems: list[str] = dataclasses.field(default_factory=list)
    """Why there is no result, a line each."""
    found: dict[str, Any] = dataclasses.field(default_factory=dict)
    """Verdict, sentence and notes, once it is done."""

    def take(self, answer: dict[str, Any]) -> None:
        """An answer of the process that explains; none counts after the end."""
        if self.state != "running":
            return
        if "progress" in answer:
            self._goes_on(str(answer["progress"]))
        elif "done" in answer:
            self.state, self.found = "done", dict(answer["done"])
        elif "problems" in answer:
            self.state, self.problems = "refused", list(answer["problems"])
        elif "died" in answer:
            self.state, self.problems = "broken", [str(answer["died"])]
        else:
            told = f"a defect of rotorjax, please report it with what stands in the terminal: {answer.get('defect')}"
            self.state, self.problems = "broken", [told]
        if self.state != "running":
            self.ended = time.monotonic()

    def _goes_on(self, line: str) -> None:
        spent = _SPENT.fullmatch(line)
        if spent:
            self.spent, self.limit = (int(spent[name].replace(",", "")) for name in ("spent", "limit"))
        stage = spent["stage"] if spent else line
        # How far a file is read is told behind a comma.
        if not self.stages or not f"{stage}, ".startswith(f"{self.stages[-1][1]}, "):
            self.stages.append((time.monotonic() - self.began, stage))
        self.line = line

    def as_dict(self) -> dict[str, Any]:
        """What the page shows of it."""
        return {
            "id": self.id,
            "state": self.state,
            "files": self.files,
            "elapsed_s": round((self.ended or time.monotonic()) - self.began, 1),
            "stages": [{"at_s": round(at, 1), "stage": stage} for at, stage in self.stages],
            "line": self.line,
            "spent": self.spent,
            "limit": self.limit,
            "problems": self.problems,
            **{"verdict": None, "sentence": None, "notes": [], **self.found},
        }


class Jobs:
    """The explanation that goes on, or the last one; the process that makes them."""

    def __init__(self, root: Path, command: list[str]):
        self.job: Job | None = None
        self._root = root
        self._child = Child(command, root)
        self._taken = False
        self._task: asyncio.Task[None] | None = None

    async def start(self) -> None:
        """Have a process loaded before the first explanation."""
        await self._child.start()

    @contextlib.contextmanager
    def receiving(self) -> Iterator[Path]:
        """A new folder for the files of an explanation, which is removed again unless it is begun.

        **Errors.** `BusyError`.
        """
        if self._taken or self._running:
            raise BusyError("busy: another explanation is being made; wait until it has ended, or cancel it")
        self._taken = True
        folder = self._root / secrets.token_hex(8)
        folder.mkdir(mode=0o700)
        try:
            yield folder
        finally:
            self._taken = False
            if self.job is None or self.job.folder != folder:
                _remove(folder)

    def begin(self, given: Given, folder: Path) -> Job:
        """Explain what was received; the results of the explanation before are gone then."""
        if self.job is not None:
            _remove(self.job.folder)
        recordings = given.recordings
        tables = [table.name for table in (given.table, given.healthy) if table is not None]
        shown = [given.rig.name, *tables, *recordings]
        self.job = Job(shown, folder)
        ask = {
            "rig": str(given.rig.path),
            "table": None if given.table is None else str(given.table.path),
            "healthy": None if given.healthy is None else str(given.healthy.path),
            "recordings": {name: str(upload.path) for name, upload in recordings.items()},
            "folder": str(folder),
            "title": given.title,
            "shown": given.shown,
        }
        self._task = asyncio.create_task(self._run(self.job, ask))
        return self.job

    async def cancel(self) -> None:
        """End the explanation that goes on, at once; nothing of it is kept."""
        job = self.job
        if job is None or not self._running:
            return
        job.state, job.ended, task = "cancelled", time.monotonic(), self._task
        await self._child.end()
        await _finished(task)
        await self._child.start()

    async def close(self) -> None:
        """End everything, and keep nothing."""
        if self._running and self.job is not None:
            self.job.state = "cancelled"
        await self._child.end()
        await _finished(self._task)
        _remove(self._root)

    def result(self, job: str, name: str) -> Path | None:
        """A file that the last explanation has left."""
        if self.job is None or self.job.id != job or self.job.state != "done" or name not in RESULTS:
            return None
        return self.job.folder / name

    @property
    def _running(self) -> bool:
        return self.job is not None and self.job.state == "running"

    async def _run(self, job: Job, ask: dict[str, Any]) -> None:
        """One explanation to its end, whatever that is."""
        if job.state != "running":
            _remove(job.folder)
            return
        try:
            async for answer in self._child.answers(ask):
                job.take(answer)
            job.take({"died": "the process that explains has died (killed, or out of memory); try again"})
        except Exception as error:  # nobody foresaw it: told, and the next one goes on, with another process
            job.take({"defect": f"{type(error).__name__}: {error}"})
            await self._child.end()
        if job.state == "done":
            _remove(job.folder, but=RESULTS)
        else:
            _remove(job.folder)


async def _finished(task: asyncio.Task[None] | None) -> None:
    if task is not None:
        await task


def _remove(folder: Path, *, but: Collection[str] = ()) -> None:
    """A folder and all in it, or all but some files."""
    if not but:
        shutil.rmtree(folder, ignore_errors=True)
        return
    for path in folder.iterdir():
        if path.name not in but:
            path.unlink()
