"""What is being done and for how long, on standard error; Ctrl-C ends at once."""

import contextlib
import os
import shutil
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator

from rotorjax.cli.terminal import aside
from rotorjax.data.names import harmless

INTERRUPTED = 130
TICK_S = 1.0
QUIET_S = 10.0
"""After which a line is repeated where it cannot be renewed in place, for what takes a minute."""


@contextlib.contextmanager
def progress_line(kept: str = "", quiet_s: float = QUIET_S) -> Iterator[Callable[[str], None]]:
    """Says on standard error what is being done and for how long: on a terminal in place, gone at the end, elsewhere a
    line for every stage, repeated while it goes on.

    While it lasts Ctrl-C ends the process at once, in the midst of a compilation too.

    **Arguments:** ``kept``: what is said then, such as where the results so far are; ``quiet_s``: after which a line is
    repeated where it cannot be renewed in place.
    """
    began, terminal, stage, over = time.monotonic(), sys.stderr.isatty(), [""], threading.Event()
    shown = [began]

    def show(line: str) -> None:
        shown[0] = time.monotonic()
        told = f"{shown[0] - began:4.0f} s  {harmless(line)}"
        if terminal:
            # What is cut off would stand on a line that the next one does not replace.
            told = f"{told} ..."[: shutil.get_terminal_size().columns - 1]
        aside(f"\r\x1b[K{told}" if terminal else told, end="" if terminal else "\n")

    def progress(line: str) -> None:
        # What goes on is told in place; elsewhere it waits until there has been nothing for a while.
        new = line.partition(" (")[0] != stage[0].partition(" (")[0]
        stage[0] = line
        if terminal or new:
            show(line)

    def tick() -> None:
        while not over.wait(TICK_S):
            if stage[0] and (terminal or time.monotonic() - shown[0] >= quiet_s):
                show(stage[0])

    threading.Thread(target=tick, daemon=True).start()
    try:
        with interruptible(kept):
            yield progress
    finally:
        over.set()
        if terminal:
            aside("\r\x1b[K", end="")


@contextlib.contextmanager
def interruptible(kept: str = "") -> Iterator[None]:
    """Ends the process at Ctrl-C without waiting for compiled code to come back. Files, and rows of a database, are
    written whole or not at all, so that nothing is lost. **Arguments:** ``kept`` as for `progress_line`.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    woken, waker = socket.socketpair()
    waker.setblocking(False)
    before = signal.set_wakeup_fd(waker.fileno(), warn_on_full_buffer=False)

    def wait() -> None:
        while number := woken.recv(1):
            if number[0] == signal.SIGINT:
                aside(f"\nrotorjax: stopped{'; ' if kept else ''}{harmless(kept)}")
                os._exit(INTERRUPTED)

    waiting = threading.Thread(target=wait, daemon=True)
    waiting.start()
    try:
        yield
    finally:
        signal.set_wakeup_fd(before)
        waker.close()
        waiting.join()
        woken.close()
