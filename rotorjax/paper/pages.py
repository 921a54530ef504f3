"""Everything about the paper, written to a folder: a CSV file and a page per table, figures, and
the audit at a glance.
"""

import tempfile
from pathlib import Path

from rotorjax.data.files import refusals, write_whole
from rotorjax.errors import InputError
from rotorjax.paper.errata import Erratum, errata
from rotorjax.paper.figures import figures
from rotorjax.paper.real import real_data
from rotorjax.paper.sheet import Sheet
from rotorjax.paper.study import Study
from rotorjax.paper.tables import every
from rotorjax.reporting import plots

SOURCE = (
    "Huang, Pham, Nguyen, Chiu: *A Hybrid Diagnostic Framework with Compensation Algorithms for Inherent Rotor Faults "
    "Using Rotor Experiments*, "
    "Sensors 2026, 26, 2565, [doi 10.3390/s26082565](https://doi.org/10.3390/s26082565), CC BY 4.0"
)
TITLE = "# The paper's tables, recomputed"
FIGURES = {"table_01": "figure_04", "table_04": "figure_07", "table_06": "figure_09", "figure_10": "figure_10"}
"""The page on which each figure stands."""


def reproduce(study: Study, folder: Path) -> str:
    """Compute everything, then write it. **Returns** a few lines on what was found. **Errors.** `InputError` if the
    folder cannot be made.
    """
    sheets = [*every(study), real_data()]
    found = errata(study)
    drawn = figures(study)
    files = {f"{sheet.name}.csv": sheet.csv() for sheet in sheets}
    for sheet in sheets:
        picture = FIGURES.get(sheet.name)
        shown = f"\n![{drawn[picture][1]}]({picture}.svg)\n\n*{drawn[picture][1]}*\n" if picture else ""
        files[f"{sheet.name}.md"] = sheet.markdown() + shown
    files |= {f"{name}.svg": plots.svg(picture).decode() for name, (picture, _) in drawn.items()}
    files["README.md"] = _readme(sheets, found)
    prepare(folder)
    for name, text in files.items():
        write_whole(folder / name, text)
    return _summary(sheets, found)


def prepare(folder: Path) -> None:
    """Make the folder. **Errors.** `InputError` if it cannot be made, or holds another README.md,
    which would be lost.
    """
    with refusals(folder, "cannot be made a folder", "give another"):
        folder.mkdir(parents=True, exist_ok=True)
    with refusals(folder, "cannot be written to", "give another"):
        tempfile.TemporaryFile(dir=folder).close()
    readme = folder / "README.md"
    with refusals(readme, "cannot be read", "give another folder"):
        if readme.is_file() and readme.read_text(encoding="utf-8", errors="replace").startswith(TITLE):
            return
    for path in [readme, *folder.glob("table_*"), *folder.glob("figure_*")]:
        if path.exists():
            raise InputError(f"{path}: is not from here and would be overwritten; give a new folder")


def _summary(sheets: list[Sheet], found: list[Erratum]) -> str:
    lines = [f"{sheet.title}: {_tally(sheet)}" for sheet in sheets]
    return "\n".join(
        [*lines, f"Inconsistencies recomputed: {len(found)}, of which {sum(e.holds for e in found)} are confirmed."]
    )


def _tally(sheet: Sheet) -> str:
    return ", ".join(f"{count} {verdict}" for verdict, count in sheet.tally().items())


def _readme(sheets: list[Sheet], found: list[Erratum]) -> str:
    rows = "\n".join(
        f"| [{sheet.title}]({sheet.name}.md) | [csv]({sheet.name}.csv) | {_tally(sheet)} |" for sheet in sheets
    )
    listed = "\n".join(
        f"{k}. **{e.where}.** {e.text}{'' if e.holds else ' *(not confirmed by the recomputation)*'}"
        for k, e in enumerate(found, 1)
    )
    return f"""{TITLE}

{SOURCE}.

Written by `rotorjax paper --output paper_tables`; the tests recompute the numbers. Each row shows the paper's value, ours, the difference and a verdict:
*reproduced*; *reproduced from rebuilt features* (the rig's raw signals are not public: features are the model's map times the printed diagnosis);
*not reproducible*, with the reason; *ours*, what the paper does not have. Table 2 is input.

| table | | rows by verdict |
| --- | --- | --- |
{rows}

## What comes out

- **The network** is trained as described to the accuracy printed, if table 1 is read in kg mm and m; whitening and linear least squares get there in a fraction of a second, and ten thousand times lower.
  The map is linear: its exact inverse is four by four numbers.
- **One speed cannot carry the diagnosis.** With sensors good to 1 µm, U = 8 g mm has a standard error of 18 g mm at 1500 rpm. A second speed cures the sensors' noise (33-fold), not a better network; on the paper's own vectors it shows
  instead that the model does not fit both speeds ([jointly](table_04_05_joint.md)).
- **IFbC and IFC are the same thing** where the inverse is exact, and make the error of U worse on the paper's own numbers, while they take that of the bow away. One complex gain for U and one for s lowers all eight mean errors below those
  without compensation, also for cases left out ([figure 10](figure_10.md)); additive compensation is better only for s at 1500 rpm.
- **On measured data** of another rig ([RK4](real_rk4.md)) neither an additive fault nor a gain is enough by itself: there is a residual unbalance and an offset of the phase reference. Both together, or the fitted
  physics, bring the error from 60 to 3-10 g mm on runs that were not used.

## Inconsistencies in print

Each is recomputed from what is printed.

{listed}
"""
