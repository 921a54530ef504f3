"""A worker of the page that explains nothing: what it does stands in the table. Needs no JAX: it starts at once."""

import os
import sys
import time
from pathlib import Path

from rotorjax.errors import InputError
from rotorjax.web import worker


def explained(job, named, progress, options):
    """In the place of an explanation."""
    what = Path(job["table"]).read_text().strip()
    progress(f"reading {job['table']}")
    progress("what is missing beside the model as declared (12,345 of 700,000 linearisations)")
    if what == "endless":
        time.sleep(3600.0)
    if what == "dies":
        os._exit(3)
    if what == "raises":
        print("told where it belongs", file=sys.stdout)
        raise RuntimeError(f"nobody foresaw {job['table']}")
    if what == "bad":
        raise InputError(f"{job['table']}:2: column 2 (speed_rpm): -5 must be above 0", f"{job['rig']}: no run 'a'")
    for name in (worker.REPORT, worker.RIG, worker.RESULT):
        (Path(job["folder"]) / name).write_text(f"<title>{name}</title><figure>of {what}</figure>")
    return {"verdict": "nothing missing", "sentence": "Nothing is missing.", "notes": [named(f"{job['rig']}: a note")]}


if __name__ == "__main__":
    worker._explained, worker._load, worker._forget = explained, lambda: None, lambda: None
    worker.main()
