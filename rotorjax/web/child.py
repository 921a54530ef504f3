"""The process that explains, as the server sees it: kept for the next explanation, or killed."""

import asyncio
import contextlib
import json
import os
import sys
from collections.abc import AsyncIterator, Mapping, Sequence
from pathlib import Path
from typing import Any

LONGEST_LINE = 2**20
"""Bytes of one answer."""
ROOT = Path(__file__).parents[2]


class Child:
    """One process at a time: begun when there is none, because it was killed or has died."""

    def __init__(self, command: Sequence[str], folder: Path):
        self._command = [*command, str(folder)]
        self._process: asyncio.subprocess.Process | None = None
        self._changing = asyncio.Lock()

    async def start(self) -> asyncio.subprocess.Process:
        """The process, which is begun unless there is one."""
        async with self._changing:
            if self._process is None or self._process.returncode is not None:
                # It finds this very package, and nothing in the folder in which the server was started.
                path = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH"))))
                self._process = await asyncio.create_subprocess_exec(
                    *self._command,
                    stdin=asyncio.subprocess.PIPE,
                    stdout=asyncio.subprocess.PIPE,
                    env={**os.environ, "PYTHONPATH": path},
                    limit=LONGEST_LINE,
                    start_new_session=True,  # Ctrl-C in the terminal is for the server
                )
            return self._process

    async def answers(self, job: Mapping[str, Any]) -> AsyncIterator[dict[str, Any]]:
        """What the process says of one job: how far it is, and one last answer; where none comes it has died."""
        process = await self.start()
        assert process.stdin is not None
        assert process.stdout is not None
        with contextlib.suppress(ConnectionError):
            process.stdin.write(json.dumps(job).encode() + b"\n")
            await process.stdin.drain()
        while line := await process.stdout.readline():
            answer = json.loads(line)
            yield answer
            if "progress" not in answer:
                return
        await process.wait()

    async def end(self) -> None:
        """Kill the process, whatever it is at."""
        async with self._changing:
            process, self._process = self._process, None
            if process is None:
                return
            with contextlib.suppress(ProcessLookupError):
                process.kill()
            await process.wait()


def explaining() -> list[str]:
    """The command of a process that explains."""
    return [sys.executable, "-P", "-m", "rotorjax.web.worker"]
