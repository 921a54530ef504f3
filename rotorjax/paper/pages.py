"""Everything about the paper, written to a folder: a CSV file and a page per table, figures, and the audit at a glance."""

from pathlib import Path

from rotorjax import plots
from rotorjax.errors import InputError
from rotorjax.io.files import write_whole
from rotorjax.paper.errata import Erratum, errata
from rotorjax.paper.figures import figures
from rotorjax.paper.real import real_data
from rotorjax.paper.sheet import Sheet
from rotorjax.paper.study import Study
from rotorjax.paper.tables import every

SOURCE = (
    "Huang, Pham, Nguyen, Chiu: *A Hybrid Diagnostic Framework with Compensation Algorithms for Inherent Rotor Faults Using Rotor Experiments*, "
    "Sensors 2026, 26, 2565, [doi 10.3390/s26082565](https://doi.org/10.3390/s26082565), CC BY 4.0"
)
FIGURES = {"table_01": "figure_04", "table_04": "figure_07", "table_06": "figure_09", "figure_10": "figure_10"}
"""The page on which each figure stands."""


def reproduce(study: Study, folder: Path) -> str:
    """Compute everything, then write it. **Returns** a few lines on what was found. **Errors.** `InputError` if the folder cannot be made."""
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
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be made a folder ({error.strerror}); give another") from error
    for name, text in files.items():
        write_whole(folder / name, text)
    return _summary(sheets, found)


def _summary(sheets: list[Sheet], found: list[Erratum]) -> str:
    lines = [f"{sheet.title}: {_tally(sheet)}" for sheet in sheets]
    return "\n".join([*lines, f"Inconsistencies recomputed: {len(found)}, of which {sum(e.holds for e in found)} are confirmed."])


def _tally(sheet: Sheet) -> str:
    return ", ".join(f"{count} {verdict}" for verdict, count in sheet.tally().items())


def _readme(sheets: list[Sheet], found: list[Erratum]) -> str:
    rows = "\n".join(f"| [{sheet.title}]({sheet.name}.md) | [csv]({sheet.name}.csv) | {_tally(sheet)} |" for sheet in sheets)
    listed = "\n".join(f"{k}. **{e.where}.** {e.text}{'' if e.holds else ' *(not confirmed by the recomputation)*'}" for k, e in enumerate(found, 1))
    return f"""# The paper's tables, recomputed

{SOURCE}.

Written by `rotorjax paper --output paper_tables`; the tests recompute every number. Each row shows the paper's value, ours, the difference and a verdict:
*reproduced*; *reproduced from rebuilt features* (the rig's raw signals are not public: features are the model's map times the printed diagnosis);
*not reproducible*, with the reason; *ours*, what the paper does not have. Table 2 is input.

| table | | rows by verdict |
| --- | --- | --- |
{rows}

## What comes out

- **The network** is trained as described to the accuracy printed, if table 1 is read in kg mm and m; whitening and linear least squares get there in a fraction of a second, and ten thousand times lower.
  The map is linear: its exact inverse is four by four numbers.
- **One speed cannot carry the diagnosis.** With sensors good to 1 µm, U = 8 g mm has a standard error of 18 g mm at 1500 rpm. A second speed cures that, not a better network.
- **IFbC and IFC are the same thing** where the inverse is exact, and make the error of U worse on the paper's own numbers. One complex gain for U and one for s lowers all eight mean errors below those
  without compensation, also for cases left out ([figure 10](figure_10.md)).
- **On measured data** of another rig ([RK4](real_rk4.md)) IFbC and IFC take little away, because there too the error is mostly a phase; a gain, or the fitted physics, takes most of it.

## Inconsistencies in print

Each is recomputed from the printed numbers.

{listed}
"""
