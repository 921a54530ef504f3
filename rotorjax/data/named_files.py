"""Which recordings a rig file names, read without a word about anything else in it."""

import tomllib
from pathlib import Path
from typing import Any


def recordings_named(rig: Path) -> tuple[str, ...]:
    """Recordings that a rig file names, that of the slow roll last; none where it cannot be read, which is said with
    its line where the rig file itself is read.
    """
    try:
        content: dict[str, Any] = tomllib.loads(rig.read_bytes().decode("utf-8-sig"))
    except (OSError, ValueError, RecursionError):
        return ()
    recordings, waveform = content.get("recordings"), content.get("waveform")
    if not isinstance(recordings, dict) or not recordings:
        return ()
    slow_roll = waveform.get("slow_roll") if isinstance(waveform, dict) else None
    named = dict.fromkeys((*recordings, slow_roll))
    return tuple(name for name in named if isinstance(name, str) and name and "\0" not in name)
