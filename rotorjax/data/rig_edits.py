"""What was written down wrongly, put right in the text of a rig file; everything else stays as the user wrote it."""

import contextlib
import tomllib
from collections.abc import Callable
from typing import Any

import tomlkit

from rotorjax.data.declarations import TRUE_AMPLITUDES, WEIGHT_UNITS, Mistake

_OPPOSITE = {"+x": "-x", "x": "-x", "-x": "+x", "+y": "-y", "y": "-y", "-y": "+y"}
Edit = Callable[..., None]
"""Changes a document, or the plain values in it, given what the mistake is about."""


def put_right(text: str, mistake: Mistake) -> tuple[tomlkit.TOMLDocument, bool]:
    """The document with what was written down wrongly changed, and whether that is in the rig file: numbers in another
    unit are in the table.

    A section that does not come out right as it is laid out (dotted keys, a run in several places) is written anew.
    """
    document, wanted = tomlkit.parse(text), tomllib.loads(text)
    if mistake.kind not in _EDITS:
        return document, False
    edit = _EDITS[mistake.kind]
    edit(wanted, *mistake.about)
    with contextlib.suppress(Exception):
        edit(document, *mistake.about)
        if tomllib.loads(tomlkit.dumps(document)) == wanted:
            return document, True
    stated, document = tomllib.loads(text), tomlkit.parse(text)
    for name in wanted:
        if wanted[name] != stated.get(name):
            document.pop(name, None)
            document.add(tomlkit.nl())
            document.add(name, tomlkit.item(wanted[name]))
    return document, True


def _other(key: str, usual: str, unusual: str) -> Edit:
    """Of two conventions the one that is not stated."""

    def edit(document: Any) -> None:
        convention = _section(document, "convention")
        convention[key] = usual if convention.get(key, usual) != usual else unusual

    return edit


def _amplitude(true: str) -> Edit:
    def edit(document: Any) -> None:
        _section(document, "convention")["amplitude"] = true

    return edit


def _slow_roll(document: Any) -> None:
    convention = _section(document, "convention")
    convention["slow_roll_subtracted"] = not convention.get("slow_roll_subtracted", False)


def _probes_exchanged(document: Any, *pair: str) -> None:
    probes = document["probes"]
    _exchange(probes, *(pair or tuple(probes)))


def _probe_reversed(document: Any, probe: str) -> None:
    probes = document["probes"]
    probes[probe]["angle_deg"] = _turned(probes[probe]["angle_deg"])


def _no_weight(document: Any) -> None:
    rotor = document["rotor"]
    rotor["gravity"] = "none"


def _weight_turned(document: Any) -> None:
    rotor = document["rotor"]
    stated = rotor["gravity"]
    if isinstance(stated, str):
        rotor["gravity"] = _OPPOSITE[stated]
    else:
        stated["angle_deg"] = _turned(stated["angle_deg"])


def _runs_exchanged(document: Any, one: str, other: str) -> None:
    _exchange(document["runs"], one, other)


def _trial_weight_absent(document: Any, run: str) -> None:
    runs = document["runs"]
    del runs[run]["unbalance"]


def _trial_weight_opposite(document: Any, run: str) -> None:
    runs = document["runs"]
    weights = runs[run]["unbalance"]
    for weight in weights if isinstance(weights, list) else [weights]:
        weight["angle_deg"] = _turned(weight.get("angle_deg", 0.0))


def _weights_unit(document: Any, unit: str) -> None:
    planes = document.get("planes", {})
    for run in document["runs"].values():
        weights = run.get("unbalance", [])
        for weight in weights if isinstance(weights, list) else [weights]:
            factor = WEIGHT_UNITS[unit][0]
            if unit == "g":
                factor = float(planes[weight.get("plane", next(iter(planes)))]["radius_mm"])
            weight["magnitude_g_mm"] = float(f"{float(weight['magnitude_g_mm']) * factor:.12g}")


def _section(document: Any, name: str) -> Any:
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
    "weights_unit": _weights_unit,
    "slow_roll_subtracted": _slow_roll,
}
"""Kind of mistake -> what changes the rig file; kinds that are in the table are not here."""
