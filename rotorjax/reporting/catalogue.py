"""The catalogue of effects as text: made from the classes, kept in a file, printed without loading JAX.

python -m rotorjax.reporting.catalogue        writes data/catalogue.json anew; a test says when that is due
"""

import inspect
import json
from importlib.resources import files
from pathlib import Path
from typing import Any

from rotorjax.data.synonyms import SYNONYMS
from rotorjax.effects.terms import NAMED
from rotorjax.model.contract import Effect
from rotorjax.model.parameters import Parameter
from rotorjax.reporting.tables import Table

_QUANTITIES = {
    "one": "",
    "mass": " × M",
    "stiffness": " × K",
    "damping": " × C",
    "compliance": " / K",
    "period": " / ω_n",
    "eccentricity": " × e (G6.3 at ω_n)",
    "runout": " × r (6.35 µm, or e / 4 if that is more; e: G6.3 at ω_n)",
    "unbalance": " × M e (G6.3 at ω_n)",
    "force": " × K e (G6.3 at ω_n)",
    "cubic": " × K / e² (G6.3 at ω_n)",
    "curvature": " / e (G6.3 at ω_n)",
    "drag": " × C / (e ω_n)",
    "slowness": " / (e ω_n) (G6.3)",
    "sweep": " × (C / 2M)²",
}


def prior_text(declared: Parameter) -> str:
    """The prior scale as it is declared: a number times a quantity of the rig, in the unit shown to people."""
    unit = declared.unit
    if declared.of == "one":
        return f"{declared.scale / unit.factor:.3g}"
    return f"{declared.scale:.3g}{_QUANTITIES[declared.of]}"


def effect_page(cls: type[Effect]) -> list[str | Table]:
    """One effect in full: meaning, equation, parameters with unit and prior scale, relatives, synonyms, source."""
    rows = [
        [
            p.name + ("" if not p.axes else f" (per {', '.join(p.axes)})"),
            p.unit.shown if p.of == "one" else p.unit.si,
            prior_text(p),
            p.meaning,
        ]
        for p in cls.parameters()
    ]
    headers = ["parameter", "unit", "prior scale", "meaning"]
    table = Table("Parameters; zero means that the effect is absent", headers, rows, spare=["prior scale"])
    parts = [f"{cls.name} ({cls.family}): {cls.meaning}", *_paragraphs(cls.__doc__ or ""), table]
    if cls.relatives:
        parts.append(f"Known relatives, hard to tell from it: {', '.join(cls.relatives)}")
    parts.append(f"Enough to find it, or what it ties with: {cls.sufficient}")
    if cls.name in SYNONYMS:
        parts.append(f"Also looked for as: {', '.join(SYNONYMS[cls.name])}")
    parts.append(f"Source: {cls.source}")
    return parts


def _paragraphs(docstring: str) -> list[str]:
    """A docstring's paragraphs as one line each, but where lines are indented."""
    paragraphs = inspect.cleandoc(docstring).split("\n\n")
    return [part if "\n " in part else part.replace("\n", " ") for part in paragraphs]


def snapshot() -> dict[str, dict[str, Any]]:
    """What data/catalogue.json holds: family, meaning and page of every effect, tables as their fields."""
    return {
        name: {
            "family": cls.family,
            "meaning": cls.meaning,
            "page": [part._asdict() if isinstance(part, Table) else part for part in effect_page(cls)],
        }
        for name, cls in NAMED.items()
    }


def main() -> None:
    """Write data/catalogue.json."""
    path = Path(str(files("rotorjax") / "data" / "catalogue.json"))
    path.write_text(json.dumps(snapshot(), indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
