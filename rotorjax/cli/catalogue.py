"""What `rotorjax effects` prints, from the catalogue kept as text: no JAX, so that it starts at once."""

import json
from importlib.resources import files
from typing import Any

from rotorjax.data.synonyms import SYNONYMS, meant_by, misspelt, nearest_effect, words_of
from rotorjax.errors import InputError
from rotorjax.reporting.tables import Table, laid_out, wrapped

LINE = 100
"""Columns to which paragraphs are wrapped where nothing limits them."""
_HEADERS = ("family", "effect", "what it is")


def effect_text(name: str | None, width: int | None) -> str:
    """The catalogue, the page of an effect, or the effects whose name, meaning or synonyms have a word.

    **Errors.** `InputError` with the nearest name for a word that finds nothing, or looks like a mistake in a name.
    """
    catalogue = json.loads((files("rotorjax") / "data" / "catalogue.json").read_text(encoding="utf-8"))
    if name is None:
        return _all(catalogue, width)
    if name in catalogue:
        return _page(catalogue[name]["page"], width)
    found = _found(name, catalogue)
    if not found:
        raise InputError(f"unknown effect {name!r}; {nearest_effect(name, catalogue)}")
    rows = [[catalogue[effect]["family"], effect, catalogue[effect]["meaning"], why] for effect, why in found.items()]
    title = f"No effect is called {name!r}; these are about it"
    table = Table(title, [*_HEADERS, "also called"], rows, spare=["family", "also called"])
    return laid_out([table, "`rotorjax effects NAME` shows one in full."], width)


def _all(catalogue: dict[str, Any], width: int | None) -> str:
    rows = [
        [effect["family"], name, effect["meaning"]]
        for name, effect in catalogue.items()
        if not name.startswith("term_")
    ]
    note = (
        "\n`rotorjax effects NAME` shows its equation, parameters, prior scales and source, `rotorjax effects WORD` "
        "what a word finds.\nSimple terms of a missing force, along one axis or with a power that is fitted: "
    )
    note += ", ".join(name for name in catalogue if name.startswith("term_")) + "."
    return laid_out([Table("", _HEADERS, rows, note, spare=["family"])], width)


def _page(page: list[Any], width: int | None) -> str:
    line = LINE if width is None else min(width, LINE)
    return laid_out([Table(**part) if isinstance(part, dict) else wrapped(part, line) for part in page], width)


def _found(name: str, catalogue: dict[str, Any]) -> dict[str, str]:
    """Effects that a word is about, and the synonym that it is in: by synonyms first, then by what is written of them;
    none for what looks like a mistake in a name.
    """
    meant = meant_by(name, catalogue)
    if any(words_of(synonym) == words_of(name) for synonym in meant.values()):
        return meant
    if misspelt(name, catalogue):
        return {}
    written = [effect for effect in SYNONYMS if words_of(name) and words_of(name) <= _written(catalogue[effect])]
    return {effect: meant.get(effect, "") for effect in SYNONYMS if effect in meant or effect in written}


def _written(entry: dict[str, Any]) -> frozenset[str]:
    """Words of what is written of an effect, but for the literature."""
    return words_of(" ".join([entry["meaning"], *(part for part in entry["page"][:-1] if isinstance(part, str))]))
