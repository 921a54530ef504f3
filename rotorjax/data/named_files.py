"""Which recordings and which healthy table a rig file names, read without a word about anything else in it."""

from pathlib import Path
from typing import Any

from rotorjax.data.names import harmless
from rotorjax.data.section import parsed


def recordings_named(rig: Path) -> tuple[str, ...]:
    """Recordings that a rig file names, that of the slow roll last; none where it cannot be read, which is said with
    its line where the rig file itself is read.
    """
    content = _content(rig)
    if content is None:
        return ()
    recordings, waveform = content.get("recordings"), content.get("waveform")
    if not isinstance(recordings, dict) or not recordings:
        return ()
    slow_roll = waveform.get("slow_roll") if isinstance(waveform, dict) else None
    named = dict.fromkeys((*recordings, slow_roll))
    # Names with control characters are refused where the rig file is read for good; none can be opened.
    return tuple(harmless(name) for name in named if isinstance(name, str) and name)


def healthy_named(rig: Path) -> str | None:
    """The table of the healthy rotor that a rig file names, in the same way."""
    model = (_content(rig) or {}).get("model")
    name = model.get("healthy") if isinstance(model, dict) else None
    return harmless(name) if isinstance(name, str) and name else None


def can_be_read(rig: Path) -> bool:
    """Whether a rig file is TOML, and nothing keeps it from being read."""
    return _content(rig) is not None


def _content(rig: Path) -> dict[str, Any] | None:
    try:
        return parsed(rig, rig.read_bytes().decode("utf-8-sig"))
    except (OSError, ValueError):
        return None
