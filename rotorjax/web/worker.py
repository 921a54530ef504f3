"""The process in which explanations are made: ``python -m rotorjax.web.worker FOLDER``.

Asked and answered in lines of JSON on standard input and output, so that nothing is unpickled. It loads JAX at once,
serves one explanation after the other, and can be killed in the midst of any. When the server is gone it removes the
server's folder, which is left only where that was killed, and ends.
"""

import dataclasses
import importlib
import json
import os
import queue
import shutil
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TextIO

from rotorjax.data.names import harmless
from rotorjax.errors import InputError

REPORT, RIG, RESULT = "report.html", "explained.toml", "explanation.json"
"""Files that an explanation writes."""
LONGEST = 2000
"""Characters of a line that is told."""

Tell = Callable[[dict[str, Any]], None]
"""Gives one answer."""


def main(options: Mapping[str, Any] | None = None) -> None:
    """Serve until standard input ends. **Arguments:** ``options``: for `rotorjax.discovery.explain.explain`."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    answers = _answers()

    def tell(message: dict[str, Any]) -> None:
        answers.write(json.dumps(message) + "\n")
        answers.flush()

    jobs: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
    threading.Thread(target=_listen, args=(jobs, Path(sys.argv[1])), daemon=True).start()
    _load()
    while True:
        job = jobs.get()
        try:
            serve(job, tell, options or {})
        finally:
            _forget()


def serve(job: Mapping[str, Any], tell: Tell, options: Mapping[str, Any]) -> None:
    """One explanation: answers ``progress`` as it goes, then ``done``, ``problems`` or ``defect``.

    **Arguments:** ``job``: paths of ``rig``, ``table`` and ``healthy`` (or none), and ``recordings`` (name in the rig
    file -> path), the ``folder`` to write to, the ``title``, and ``shown``: path -> name by which people know a file.
    """

    def named(text: str) -> str:
        for path, name in job["shown"].items():
            text = text.replace(path, name).replace(Path(path).name, name)
        return harmless(text)[:LONGEST]

    try:
        done = _explained(job, named, lambda line: tell({"progress": named(line)}), options)
    except InputError as error:
        tell({"problems": [named(problem) for problem in error.shown()]})
    except Exception as error:  # a defect is told as such, and the next explanation goes on
        traceback.print_exc()
        tell({"defect": named(f"{type(error).__name__}: {error}")})
    else:
        tell({"done": done})


def _explained(
    job: Mapping[str, Any], named: Callable[[str], str], progress: Callable[[str], None], options: Mapping[str, Any]
) -> dict[str, Any]:
    from rotorjax.data.files import write_whole  # noqa: PLC0415 - it is told first that reading begins
    from rotorjax.data.rig import read_measurement  # noqa: PLC0415
    from rotorjax.discovery.explain import explain  # noqa: PLC0415
    from rotorjax.reporting.explanation_json import explanation_json  # noqa: PLC0415

    progress(f"reading {job['table'] or job['rig']}")
    rig, measurement = _read(job, progress)
    healthy = None if job["healthy"] is None else read_measurement(job["healthy"], rig)
    found = explain(rig.model, measurement, **options, progress=progress, healthy=healthy)
    progress("drawing the report")
    folder, notes = Path(job["folder"]), [*measurement.notes, *(() if healthy is None else healthy.notes)]
    own = job["shown"].get(job["table"])
    if rig.healthy is not None and healthy is None and own != rig.healthy.name:
        notes.append(
            f"the model was not calibrated on the healthy rotor, as {rig.healthy.name}, which the rig file names, was "
            "not given"
        )
    if not rig.write(folder / RIG, found.model, found.mistake):
        cure = "" if found.mistake is None else f"; change by hand: {found.mistake.cure}"
        notes.append(f"the saved rig file still has the wrong entry{cure}")
    told = explanation_json(found, rig)
    write_whole(folder / RESULT, json.dumps(told, indent=2, allow_nan=False, ensure_ascii=False) + "\n")
    found.report(folder / REPORT, rig, title=job["title"])
    return {"verdict": told["verdict"], "sentence": told["sentence"], "notes": [named(note) for note in notes]}


def _read(job: Mapping[str, Any], progress: Callable[[str], None]) -> tuple[Any, Any]:
    """Rig file and measurement."""
    from rotorjax.data.rig import read_measurement, read_rig  # noqa: PLC0415

    rig = read_rig(job["rig"])
    if job["table"] is not None:
        return rig, read_measurement(job["table"], rig)
    from rotorjax.data.record_vectors import read_recordings  # noqa: PLC0415

    # Only what was given is read, whatever paths the rig file names.
    places, waveform = job["recordings"], rig.waveform
    recordings = tuple(recorded._replace(file=places[recorded.file]) for recorded in waveform.recordings)
    slow_roll = waveform.slow_roll and places[waveform.slow_roll]
    waveform = dataclasses.replace(waveform, recordings=recordings, slow_roll=slow_roll)
    stored = dataclasses.replace(rig, waveform=waveform)
    return rig, read_recordings(stored, progress=progress).measurement(stored)


def _load() -> None:
    """What takes seconds to import, before it is needed."""
    from rotorjax.compilation import use_double_precision  # noqa: PLC0415

    use_double_precision()
    for module in ("rotorjax.discovery.explain", "rotorjax.reporting.results"):
        importlib.import_module(module)


def _forget() -> None:
    from rotorjax.compilation import spare_memory  # noqa: PLC0415

    spare_memory()


def _listen(jobs: "queue.SimpleQueue[dict[str, Any]]", folder: Path) -> None:
    """Take what is asked; end with the server, in the midst of a computation too."""
    for line in sys.stdin:
        jobs.put(json.loads(line))
    shutil.rmtree(folder, ignore_errors=True)
    os._exit(0)


def _answers() -> TextIO:
    """Standard output for answers alone: what else is printed goes to standard error."""
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    return answers


if __name__ == "__main__":
    main()
