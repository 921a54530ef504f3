"""Pages and pictures of the documentation site that come from the package itself: the catalogue, and the gallery.

    python docs/generate.py

writes to build/docs, where `docs/hooks.py` finds them. Pictures of the gallery are compared with small ones kept in
`docs/expected`; where one looks different the script names it and exits with 1. What was looked at and is as it should
be is kept with

    python docs/generate.py --accept
"""

import argparse
import inspect
import re
import shutil
import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from PIL import Image, ImageFilter
from signatures import DRAWN, signature

from rotorjax import (
    Effect,
    ExcitationEffect,
    MatrixEffect,
    ReadingEffect,
    RestoringEffect,
    SpeedEffect,
    SupportEffect,
    WaveformEffect,
)
from rotorjax.compilation import use_double_precision
from rotorjax.effects import CATALOG
from rotorjax.effects.terms import TERMS
from rotorjax.model.contract import Plan
from rotorjax.reporting.catalogue import prior_text

ROOT = Path(__file__).resolve().parent.parent
OUTPUT = ROOT / "build" / "docs"
EXPECTED = ROOT / "docs" / "expected"
DPI = 130
SMALL_WIDTH = 240
"""Pixels across a small picture."""
BLUR, ALIKE = 3.0, 3.0
"""Small pictures are blurred by so many pixels before they are compared, and may then differ by so many grey levels of
255, root mean square: all shifted by two pixels of the drawing makes 1 to 2.5, a corner with a legend gone 3.3 or more.
"""
FAMILIES = {
    "excitation": "what drives the rotor besides what was installed on purpose",
    "structure": "what rotor and support do differently from the nominal rotor",
    "restoring": "nonlinear forces; the response comes from harmonic balance",
    "reading": "what the measuring chain makes of the motion, and what the true speed is",
}
ENTERS = {
    ExcitationEffect: "on the right-hand side: a force F on the disk, or an offset s of the support path (force K s)",
    MatrixEffect: "on the left-hand side, in D = K + iωC − ω²M with ω = nΩ",
    SupportEffect: "in the support path: its axes, or a compliance in series with it",
    RestoringEffect: "on the left-hand side beside K q: f is positive where it resists the motion",
    ReadingEffect: "in the vibration vector z that a probe shows; phase lead is positive",
    WaveformEffect: "in the waveform that a probe delivers, before it is analysed into orders",
    SpeedEffect: "in the speed Ω at which the model is evaluated",
}
_PICTURE = re.compile(r"^```python(?: title=\"([\w-]+)\.png\")?\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def main() -> None:
    """Write everything anew."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--accept", action="store_true", help="keep what the pictures look like now")
    accept = parser.parse_args().accept
    use_double_precision()
    shutil.rmtree(OUTPUT, ignore_errors=True)
    for name, cls in CATALOG.items():
        drawn, values = signature(name)
        _save(drawn, f"catalogue/pictures/{name}.png")
        _write(f"catalogue/{name}.md", effect_page(cls, values))
    _write("catalogue/index.md", index_page())
    draw_gallery((ROOT / "docs" / "gallery.md").read_text(encoding="utf-8"))
    if accept:
        keep_small()
    elif different := look_different():
        sys.exit(
            f"These pictures look different: {', '.join(different)}. Look at them, then --accept them or mend them."
        )


def effect_page(cls: type[Effect], values: dict[str, str]) -> str:
    """One effect in full. **Arguments:** ``values`` behind each line of its picture."""
    sizes = DRAWN[cls.name]
    second = "phase" if len(sizes.orders) == 1 else f"amplitude at {sizes.orders[1]:g}X"
    absent = "" if len(sizes.orders) == 1 else f" Without the effect there is no {sizes.orders[1]:g}X."
    rows = [
        f"| `{p.name}`{_axes(p.axes)} | {_plain(p.meaning)} | {p.unit.si} | {_plain(prior_text(p))} |"
        for p in cls.parameters()
    ]
    return f"""# {cls.name}

*Family: {cls.family}.* {_sentence(cls.meaning)}

| | |
| --- | --- |
| Equation | {_plain(_line(cls.__doc__ or ""))} |
| Where it enters | {"; ".join(text for hook, text in ENTERS.items() if issubclass(cls, hook))} |
| Relatives, hard to tell from it | {", ".join(f"[{r}]({r}.md)" for r in cls.relatives) or "none known"} |
| Plan of measurement that shows it | {_plan(cls.sufficient)} |
| Source | {_plain(cls.source)} |

## Parameters

Zero means that the effect is absent. The prior scale is one standard deviation of the prior; symbols are explained in
[the catalogue](index.md#symbols).

| parameter | meaning | unit | prior scale |
| --- | --- | --- | --- |
{chr(10).join(rows)}

## Signature over speed

![Response over speed without {cls.name} and with two sizes of it](pictures/{cls.name}.png)

*Amplitude at 1X and {second} that probe {sizes.probe} shows of the [standard rotor](index.md#standard-rotor)
{"with horizontal shaft (gravity along −y)" if sizes.gravity else "without gravity"}.{absent}*

{chr(10).join(f"- {label}: {_plain(text)}" for label, text in values.items())}

## Use

```text
rotorjax explain DATA.csv --rig RIG.toml --only {cls.name}
rotorjax compare DATA.csv --rig RIG.toml --effect {cls.name}
rotorjax effects {cls.name}
```

In Python: `rig.model + rotorjax.effects.{cls.__name__}()`. In a rig file: the section `[effects.{cls.name}]`, with the
parameters above in SI.
"""


def index_page() -> str:
    """The catalogue by family."""
    parts = [(ROOT / "docs" / "catalogue" / "index.md").read_text(encoding="utf-8").rstrip()]
    for family, words in FAMILIES.items():
        rows = [
            f"| [{name}]({name}.md) | {_plain(cls.meaning)} | {_plain(_formula(cls))} |"
            for name, cls in CATALOG.items()
            if cls.family == family
        ]
        parts.append(f"## {family.capitalize()}\n\n{_sentence(words)}")
        parts.append("\n".join(["| effect | what it is | equation |", "| --- | --- | --- |", *rows]))
    terms = [
        f"| `{name}` | {_plain(cls.meaning)} | {_plain(_line(cls.__doc__ or ''))} |"
        for name, cls in TERMS.items()
        if not name.endswith("_y")
    ]
    parts.append(
        "## Simple terms of a missing force\n\nWhere no effect of the catalogue explains the data, the missing "
        "force is compared with these terms. Each acts along x and exists along y, too (`_y` in place of `_x`), but "
        "for the last three, which act in every direction; each can be added like an effect: "
        "`--effect term_cubic_x`."
    )
    parts.append("\n".join(["| term | what it is | equation |", "| --- | --- | --- |", *terms]))
    return "\n\n".join(parts) + "\n"


def draw_gallery(page: str) -> None:
    """Run the code of the gallery from top to bottom; a block with a title draws on `ax` or `drawn`."""
    names: dict[str, object] = {}
    for title, code in _PICTURE.findall(page):
        exec(compile(code, f"gallery: {title}", "exec"), names)
        if title:
            drawn = names.pop("drawn", None) or names["ax"].figure  # type: ignore[attr-defined]
            _save(drawn, f"pictures/{title}.png")  # type: ignore[arg-type]


def keep_small() -> None:
    """Write small pictures of the gallery in the place of those kept."""
    shutil.rmtree(EXPECTED, ignore_errors=True)
    EXPECTED.mkdir()
    for path in sorted((OUTPUT / "pictures").glob("*.png")):
        _small(path).save(EXPECTED / path.name, optimize=True)


def look_different() -> list[str]:
    """Pictures of the gallery that do not look as those kept, or have no counterpart."""
    drawn = {path.name: path for path in (OUTPUT / "pictures").glob("*.png")}
    kept = {path.name: path for path in EXPECTED.glob("*.png")}
    return sorted(
        name
        for name in drawn.keys() | kept.keys()
        if name not in drawn or name not in kept or not _alike(_small(drawn[name]), Image.open(kept[name]))
    )


def _small(path: Path) -> Image.Image:
    whole = Image.open(path).convert("L")
    return whole.resize((SMALL_WIDTH, round(whole.height * SMALL_WIDTH / whole.width)), Image.Resampling.LANCZOS)


def _alike(one: Image.Image, other: Image.Image) -> bool:
    if one.size != other.size:
        return False
    first, second = (np.asarray(image.filter(ImageFilter.GaussianBlur(BLUR)), float) for image in (one, other))
    return bool(np.sqrt(np.mean((first - second) ** 2)) < ALIKE)


def _formula(cls: type[Effect]) -> str:
    """What stands before the words of the docstring: up to the first punctuation outside brackets."""
    line, depth = _line(cls.__doc__ or ""), 0
    for at, sign in enumerate(line):
        depth += (sign in "([{") - (sign in ")]}")
        if depth == 0 and sign in ":;,." and line[at + 1 : at + 2] in ("", " "):
            return line[:at]
    return line


def _line(text: str) -> str:
    return " ".join(inspect.cleandoc(text).split())


def _plan(plan: Plan) -> str:
    return str(plan)


def _axes(axes: tuple[str, ...]) -> str:
    return f" per {', '.join(axes)}" if axes else ""


def _sentence(text: str) -> str:
    return _plain(text[0].upper() + text[1:]) + "."


def _plain(text: str) -> str:
    """Text in which Markdown sees nothing of its own."""
    return re.sub(r"([\\*_\[\]<>|])", r"\\\1", text)


def _save(drawn: Figure, place: str) -> None:
    path = OUTPUT / place
    path.parent.mkdir(parents=True, exist_ok=True)
    drawn.savefig(path, dpi=DPI)


def _write(place: str, text: str) -> None:
    path = OUTPUT / place
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
