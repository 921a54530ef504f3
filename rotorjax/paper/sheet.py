"""A table of the reproduction: the paper's value, ours, the difference, a verdict with its reason;
as CSV and Markdown.
"""

import csv
import io
import math
from typing import Literal, NamedTuple

Verdict = Literal["reproduced", "reproduced from rebuilt features", "not reproducible", "ours"]
REBUILT: Verdict = "reproduced from rebuilt features"
NOT: Verdict = "not reproducible"

COLUMNS = ("case", "parameter", "unit", "paper", "ours", "difference")
LAST = ("verdict", "reason")
UNITS = {"U": "g mm", "alpha": "degree", "s": "mm", "theta": "degree"}
"""Of the four values of a fault, in the paper's names."""
ROUNDING = 1e-6
"""Share of a value that counts as rounding."""
DIGITS = 6
"""Significant digits of the CSV files."""


class Row(NamedTuple):
    """One value of the paper and ours. A verdict of "ours" marks what the paper does not have."""

    case: str
    parameter: str
    unit: str
    paper: float | None
    ours: float | None
    verdict: Verdict
    reason: str = ""
    more: tuple[float | str | None, ...] = ()
    """Values of the sheet's further columns."""


def our_row(case: str, parameter: str, value: float, reason: str, more: tuple[float | str | None, ...] = ()) -> Row:
    """A value of a fault that the paper does not have."""
    return Row(case, parameter, UNITS[parameter], None, value, "ours", reason, more)


class Sheet(NamedTuple):
    """One table: file name without ending, title, what it shows, further columns, rows."""

    name: str
    title: str
    text: str
    more: tuple[str, ...]
    rows: tuple[Row, ...]

    def columns(self) -> tuple[str, ...]:
        """Heads of all columns."""
        return (*COLUMNS, *self.more, *LAST)

    def cells(self, digits: int) -> list[list[str]]:
        """Text of every row."""
        return [
            [
                row.case, row.parameter, row.unit,
                *(figure(v, digits) for v in (row.paper, row.ours, _difference(row))),
                *(v if isinstance(v, str) else figure(v, digits) for v in row.more), row.verdict, row.reason,
            ]
            for row in self.rows
        ]  # fmt: skip

    def csv(self) -> str:
        """As comma-separated values."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerows([self.columns(), *self.cells(DIGITS)])
        return text.getvalue()

    def markdown(self) -> str:
        """As a page."""
        rows = [list(self.columns()), ["---"] * len(self.columns()), *self.cells(4)]
        body = "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in rows)
        return f"# {self.title}\n\n{self.text}\n\n{body}\n"

    def tally(self) -> dict[str, int]:
        """Verdict -> number of rows."""
        verdicts = [row.verdict for row in self.rows]
        return {verdict: verdicts.count(verdict) for verdict in dict.fromkeys(verdicts)}


def _difference(row: Row) -> float | None:
    """Ours less the paper's; what is rounding beside them is zero."""
    if row.paper is None or row.ours is None:
        return None
    return 0.0 if abs(row.ours - row.paper) < ROUNDING * abs(row.paper) else row.ours - row.paper


def figure(value: float | None, digits: int) -> str:
    """A number to some significant digits, empty for none."""
    return "" if value is None or not math.isfinite(value) else f"{value:.{digits}g}"
