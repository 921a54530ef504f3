"""The catalogue of effects as text: made from the classes, kept in a file, printed without loading JAX.

python -m rotorjax.reporting.catalogue        writes data/catalogue.json anew; a test says when that is due
"""

import inspect
import json
import textwrap
from importlib.resources import files
from pathlib import Path
from typing import Any

from rotorjax.effects.terms import NAMED
from rotorjax.model.contract import Effect, Parameter
from rotorjax.reporting.tables import Table

WIDTH = 100

_QUANTITIES = {
    "one": "",
    "mass": " × M",
    "stiffness": " × K",
    "damping": " × C",
    "compliance": " / K",
    "period": " / ω_n",
    "eccentricity": " × e (G6.3 at ω_n)",
    "unbalance": " × M e (G6.3 at ω_n)",
    "force": " × K e (G6.3 at ω_n)",
    "cubic": " × K / e² (G6.3 at ω_n)",
    "curvature": " / e (G6.3 at ω_n)",
    "drag": " × C / (e ω_n)",
}


def prior_text(declared: Parameter) -> str:
    """The prior scale as it is declared: a number times a quantity of the rig, in the unit shown to people."""
    unit = declared.unit
    if declared.of == "one":
        return f"{declared.scale / unit.factor:.3g}"
    return f"{declared.scale:.3g}{_QUANTITIES[declared.of]}"


def effect_page(cls: type[Effect]) -> str:
    """One effect in full: meaning, equation, parameters with unit and prior scale, relatives, source."""
    rows = [
        [
            p.name + ("" if not p.axes else f" (per {', '.join(p.axes)})"),
            p.unit.shown if p.of == "one" else p.unit.si,
            prior_text(p),
            p.meaning,
        ]
        for p in cls.parameters()
    ]
    table = Table(
        "Parameters; zero means that the effect is absent", ["parameter", "unit", "prior scale", "meaning"], rows
    )
    parts = [f"{cls.name} ({cls.family}): {cls.meaning}", inspect.cleandoc(cls.__doc__ or ""), table.text()]
    if cls.relatives:
        parts.append(f"Known relatives, hard to tell from it: {', '.join(cls.relatives)}")
    parts.append(f"Enough to find it, or what it ties with: {cls.sufficient}")
    parts.append(f"Source: {cls.source}")
    return "\n\n".join("\n".join(textwrap.wrap(part, WIDTH)) if "\n" not in part else part for part in parts)


def snapshot() -> dict[str, dict[str, Any]]:
    """What data/catalogue.json holds: family, meaning and page of every effect."""
    return {
        name: {"family": cls.family, "meaning": cls.meaning, "page": effect_page(cls)} for name, cls in NAMED.items()
    }


def main() -> None:
    """Write data/catalogue.json."""
    path = Path(str(files("rotorjax") / "data" / "catalogue.json"))
    path.write_text(json.dumps(snapshot(), indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
