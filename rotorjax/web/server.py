"""The server: an address on this machine, reached from nowhere else."""

import contextlib
import errno
import os
import signal
import socket
import threading
import webbrowser
from collections.abc import Callable

import uvicorn

from rotorjax.errors import InputError
from rotorjax.web.app import application
from rotorjax.web.uploads import Limits

HOST = "127.0.0.1"
GRACE_S = 1
"""That answers under way have when the server ends."""


def serve(port: int, limits: Limits, *, on_start: Callable[[str], None], open_browser: bool) -> None:
    """Serve until Ctrl-C.

    **Arguments:** ``port``: 0 for any that is free; ``on_start``: called with the address once it answers;
    ``open_browser`` there. **Errors.** `InputError` where the port cannot be had; ``KeyboardInterrupt``.
    """
    listening = listen(port)
    with contextlib.closing(listening):
        port = listening.getsockname()[1]
        server = uvicorn.Server(configuration(port, limits))
        address = f"http://{HOST}:{port}/"
        on_start(address)
        if open_browser:
            threading.Thread(target=webbrowser.open, args=(address,), daemon=True).start()
        if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) == signal.SIG_DFL:
            # A terminal that is closed ends the server as a regular end does, which removes its files.
            signal.signal(signal.SIGHUP, lambda *_: signal.raise_signal(signal.SIGTERM))
        server.run(sockets=[listening])
        # Where Ctrl-C is not Python's to begin with, as in the background of a script, nothing is raised.
        raise KeyboardInterrupt


def configuration(port: int, limits: Limits, command: list[str] | None = None) -> uvicorn.Config:
    """How uvicorn serves the page. **Arguments:** ``command`` of the process that explains."""
    return uvicorn.Config(
        application(port, limits, command),
        log_config=None,
        log_level="error",
        access_log=False,
        ws="none",
        lifespan="on",
        proxy_headers=False,
        server_header=False,
        timeout_graceful_shutdown=GRACE_S,
    )


def listen(port: int) -> socket.socket:
    """A socket that listens on this machine only.

    **Errors.** `InputError` where the port is taken, or is not for this user.
    """
    listening = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        if os.name == "posix":
            # A port of a server that has just ended can be had again; elsewhere this would take one that is in use.
            listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind((HOST, port))
        listening.listen(128)
    except OSError as error:
        listening.close()
        cure = "choose another, or --port 0 for any that is free"
        if error.errno == errno.EADDRINUSE:
            raise InputError(f"--port {port}: another program has it (rotorjax serve, perhaps); {cure}") from error
        raise InputError(f"--port {port}: cannot be had ({error.strerror or error}); {cure}") from error
    return listening
