"""What was written down wrongly, put right in the text of a rig file; everything else stays as the user wrote it."""

from collections.abc import Callable
from typing import Any

import tomlkit

from rotorjax.data.declarations import TRUE_AMPLITUDES, Mistake

_OPPOSITE = {"+x": "-x", "x": "-x", "-x": "+x", "+y": "-y", "y": "-y", "-y": "+y"}
Edit = Callable[..., bool]
"""Changes a document, given what the mistake is about. **Returns** whether it could."""


def put_right(document: tomlkit.TOMLDocument, mistake: Mistake) -> bool:
    """Change the document where a mistake was written down. **Returns** whether that is in the rig file: numbers in
    another unit are in the table.
    """
    return _EDITS[mistake.kind](document, *mistake.about) if mistake.kind in _EDITS else False


def _other(key: str, usual: str, unusual: str) -> Edit:
    """Of two conventions the one that is not stated."""

    def edit(document: tomlkit.TOMLDocument) -> bool:
        convention = _section(document, "convention")
        convention[key] = usual if convention.get(key, usual) != usual else unusual
        return True

    return edit


def _amplitude(true: str) -> Edit:
    def edit(document: tomlkit.TOMLDocument) -> bool:
        _section(document, "convention")["amplitude"] = true
        return True

    return edit


def _slow_roll(document: tomlkit.TOMLDocument) -> bool:
    convention = _section(document, "convention")
    convention["slow_roll_subtracted"] = not convention.get("slow_roll_subtracted", False)
    return True


def _probes_exchanged(document: tomlkit.TOMLDocument, *pair: str) -> bool:
    probes: Any = document["probes"]
    _exchange(probes, *(pair or tuple(probes)))
    return True


def _probe_reversed(document: tomlkit.TOMLDocument, probe: str) -> bool:
    probes: Any = document["probes"]
    probes[probe]["angle_deg"] = _turned(probes[probe]["angle_deg"])
    return True


def _no_weight(document: tomlkit.TOMLDocument) -> bool:
    rotor: Any = document["rotor"]
    rotor["gravity"] = "none"
    return True


def _weight_turned(document: tomlkit.TOMLDocument) -> bool:
    rotor: Any = document["rotor"]
    stated = rotor["gravity"]
    if isinstance(stated, str):
        rotor["gravity"] = _OPPOSITE[stated]
    else:
        stated["angle_deg"] = _turned(stated["angle_deg"])
    return True


def _runs_exchanged(document: tomlkit.TOMLDocument, one: str, other: str) -> bool:
    _exchange(document["runs"], one, other)
    return True


def _trial_weight_absent(document: tomlkit.TOMLDocument, run: str) -> bool:
    runs: Any = document["runs"]
    del runs[run]["unbalance"]
    return True


def _trial_weight_opposite(document: tomlkit.TOMLDocument, run: str) -> bool:
    runs: Any = document["runs"]
    weights = runs[run]["unbalance"]
    for weight in weights if isinstance(weights, list) else [weights]:
        weight["angle_deg"] = _turned(weight.get("angle_deg", 0.0))
    return True


def _section(document: tomlkit.TOMLDocument, name: str) -> Any:
    if name not in document:
        document[name] = tomlkit.table()
    return document[name]


def _exchange(tables: Any, one: str, other: str) -> None:
    """What two tables hold, under each other's name."""
    held = dict(tables[one]), dict(tables[other])
    for name, new in zip((other, one), held, strict=True):
        for key in list(tables[name]):
            del tables[name][key]
        for key, value in new.items():
            tables[name][key] = value


def _turned(angle: float) -> float:
    """By half a turn, to within one."""
    turned = float(angle) + 180.0
    return turned if turned <= 180.0 else turned - 360.0


_EDITS: dict[str, Edit] = {
    "rotation_reversed": _other("rotation", "x-to-y", "y-to-x"),
    "weight_angles_reversed": _other("weight_angles", "with-rotation", "against-rotation"),
    "phase_sign_reversed": _other("phase", "lead", "lag"),
    **{kind: _amplitude(true) for kind, true in TRUE_AMPLITUDES.items()},
    "probes_exchanged": _probes_exchanged,
    "probe_reversed": _probe_reversed,
    "weight_absent": _no_weight,
    "weight_direction": _weight_turned,
    "runs_exchanged": _runs_exchanged,
    "trial_weight_absent": _trial_weight_absent,
    "trial_weight_opposite": _trial_weight_opposite,
    "slow_roll_subtracted": _slow_roll,
}
"""Kind of mistake -> what changes the rig file; kinds that are in the table are not here."""
