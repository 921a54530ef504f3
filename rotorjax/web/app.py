"""The page and what it asks: files in, progress, results; one explanation at a time."""

import contextlib
import shutil
import tempfile
from collections.abc import AsyncIterator, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

import jinja2
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import UploadFile
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.requests import ClientDisconnect, Request
from starlette.responses import FileResponse, JSONResponse, Response
from starlette.routing import Route
from starlette.types import Message, Receive

from rotorjax.data.example import FILES
from rotorjax.errors import InputError
from rotorjax.web import guard
from rotorjax.web.child import explaining
from rotorjax.web.jobs import REPORT, BusyError, Jobs
from rotorjax.web.uploads import (
    MEGABYTE,
    MOST_FILES,
    Limits,
    TooLargeError,
    Upload,
    place_for,
    refuse_before_reading,
    shown_name,
    sorted_out,
)

BAD_REQUEST, BUSY, TOO_LARGE, ACCEPTED, STORAGE = 400, 409, 413, 202, 507
PARTS = {"page.css": "text/css", "page.js": "text/javascript"}
"""Parts of the page besides itself."""


class _Site:
    """The answers, over one `Jobs`."""

    def __init__(self, jobs: Jobs, limits: Limits):
        self.jobs, self.limits = jobs, limits

    async def page(self, request: Request) -> Response:
        environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined)
        megabytes = {name: f"{size / MEGABYTE:g}" for name, size in self.limits._asdict().items()}
        text = environment.from_string(_part("page.html")).render(megabytes=megabytes, together=self.limits.together)
        return Response(text, media_type="text/html")

    async def part(self, request: Request) -> Response:
        name = request.path_params["name"]
        if name not in PARTS:
            raise HTTPException(404)
        return Response(_part(name), media_type=PARTS[name])

    async def explain(self, request: Request) -> Response:
        """Take files; 202 with the explanation begun, or why there is none."""
        with self.jobs.receiving() as folder:
            refuse_before_reading(int(request.headers.get("content-length") or 0), self.limits)
            uploads = await _received(Request(request.scope, self._counted(request.receive)), folder)
            return self._begun(uploads, folder)

    async def example(self, request: Request) -> Response:
        """The same with the example that comes with the package."""
        with self.jobs.receiving() as folder:
            uploads = []
            for name in FILES:
                path = place_for(folder, name)
                path.write_bytes((files("rotorjax") / "data" / "example" / name).read_bytes())
                uploads.append(Upload(name, path, path.stat().st_size))
            return self._begun(uploads, folder)

    async def cancel(self, request: Request) -> Response:
        await self.jobs.cancel()
        return await self.job(request)

    async def job(self, request: Request) -> Response:
        """How far the explanation is, or what came of it."""
        job = self.jobs.job
        return JSONResponse({"state": "none"} if job is None else job.as_dict())

    async def result(self, request: Request) -> Response:
        name = request.path_params["name"]
        path = self.jobs.result(request.path_params["id"], name)
        if path is None:
            raise HTTPException(404, "these results are gone: another explanation has been begun since")
        policy = {"Content-Security-Policy": guard.REPORT}
        return FileResponse(path, headers=policy, media_type=None if name != REPORT else "text/html")

    def _begun(self, uploads: Sequence[Upload], folder: Path) -> Response:
        job = self.jobs.begin(sorted_out(uploads, self.limits), folder)
        return JSONResponse(job.as_dict(), status_code=ACCEPTED)

    def _counted(self, receive: Receive) -> Receive:
        """What comes, as long as it is not too much."""
        came = 0

        async def counted() -> Message:
            nonlocal came
            message = await receive()
            came += len(message.get("body", b""))
            refuse_before_reading(came, self.limits)
            return message

        return counted


async def _received(request: Request, folder: Path) -> list[Upload]:
    """The files of a request, stored in a folder.

    **Errors.** `InputError`.
    """
    uploads = []
    try:
        async with request.form(max_files=MOST_FILES, max_fields=1) as form:
            for _, part in form.multi_items():
                if not isinstance(part, UploadFile):
                    raise InputError("text was sent where files belong")
                name = shown_name(part.filename or "")
                path = place_for(folder, name)
                size = await run_in_threadpool(_store, part, path)
                uploads.append(Upload(name, path, size))
    except HTTPException as error:
        if "Too many files" in str(error.detail):
            raise InputError(f"more than {MOST_FILES} files at one time: give a rig file and what it needs") from error
        raise InputError(f"the files did not arrive whole ({error.detail}); give them again") from error
    return uploads


def _store(part: UploadFile, path: Path) -> int:
    with path.open("xb") as file:
        shutil.copyfileobj(part.file, file)
    return path.stat().st_size


async def _refused(request: Request, error: Exception) -> Response:
    """Bad input, with the messages that `rotorjax explain` has."""
    assert isinstance(error, InputError)
    status = BUSY if isinstance(error, BusyError) else TOO_LARGE if isinstance(error, TooLargeError) else BAD_REQUEST
    return JSONResponse({"problems": error.shown()}, status_code=status)


async def _full(request: Request, error: Exception) -> Response:
    """The disk is full, say."""
    return JSONResponse({"problems": [f"the files cannot be stored: {error}"]}, status_code=STORAGE)


async def _left(request: Request, error: Exception) -> Response:
    """Nobody is there any more."""
    return Response(status_code=BAD_REQUEST)


async def _not_there(request: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)
    return JSONResponse({"problems": [error.detail]}, status_code=error.status_code)


def _part(name: str) -> str:
    return files("rotorjax").joinpath(f"web/templates/{name}").read_text(encoding="utf-8")


def application(port: int, limits: Limits | None = None, command: list[str] | None = None) -> Starlette:
    """The page and all that it asks.

    **Arguments:** ``port`` at which it is served; ``limits`` of sizes; ``command`` of the process that explains
    (`rotorjax.web.worker` by default).
    """
    root = Path(tempfile.mkdtemp(prefix="rotorjax-serve-"))
    jobs = Jobs(root, command or explaining())
    site = _Site(jobs, limits or Limits())

    @contextlib.asynccontextmanager
    async def lifespan(_: Any) -> AsyncIterator[None]:
        await jobs.start()
        try:
            yield
        finally:
            await jobs.close()

    routes = [
        Route("/", site.page),
        Route("/explain", site.explain, methods=["POST"]),
        Route("/example", site.example, methods=["POST"]),
        Route("/cancel", site.cancel, methods=["POST"]),
        Route("/job", site.job),
        Route("/jobs/{id}/{name}", site.result),
        Route("/{name}", site.part),
    ]
    return Starlette(
        routes=routes,
        middleware=[Middleware(guard.Guard, port=port)],
        exception_handlers={InputError: _refused, OSError: _full, ClientDisconnect: _left, HTTPException: _not_there},
        lifespan=lifespan,
    )
