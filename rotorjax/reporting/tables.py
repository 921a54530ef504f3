"""Tables and numbers as people read them, laid out for a terminal. Needs no JAX, so that a command which only prints
starts at once.
"""

import math
import re
import textwrap
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import tabulate

from rotorjax.units import figures

NARROWEST = 40
"""Columns of a terminal below which nothing is fitted any more."""
TEXT = 24
"""Columns that a column of text keeps while other columns can be left out instead."""
LEAST_TEXT = 10
"""Columns that it keeps where nothing else can be left out; longer words are cut there."""
PADDING = 2
"""Columns that a head has beside it."""
LEFT_OUT = "Left out to fit the terminal:"
"""How the line below a table begins that names the columns left out."""


class Table(NamedTuple):
    """A table for people: title, heads of the columns, rows of text, a line below."""

    title: str
    headers: Sequence[str]
    rows: list[list[str]]
    note: str = ""
    spare: Sequence[str] = ()
    """Heads of the columns that a narrow terminal can do without, the least important first."""

    def text(self, width: int | None = None) -> str:
        """For a terminal. **Arguments:** ``width``: columns that it may take; where it would take more, text is
        wrapped within its cells and columns of `spare` are left out.
        """
        body, left_out = self._fitted(max(width, NARROWEST)) if width is not None else (self._body(), [])
        left = f"{LEFT_OUT} {', '.join(left_out)}" if left_out else ""
        title, note, left = (wrapped(line, width) for line in (self.title, self.note, left))
        return "\n".join(part for part in (title, body, note, left) if part)

    def without_empty(self, heads: Sequence[str]) -> "Table":
        """The table without those of these columns that hold nothing but dashes."""
        empty = [k for k, head in enumerate(self.headers) if head in heads and all(row[k] == "-" for row in self.rows)]
        table = self
        for k in empty:
            table = table._without(self.headers[k])
        return table

    def columns(self) -> list[tuple[str, bool]]:
        """Head of every column, and whether it holds numbers, which stand to the right."""
        cells = zip(*self.rows, strict=True) if self.rows else [()] * len(self.headers)
        return [
            (head, any(is_number(cell) for cell in column)) for head, column in zip(self.headers, cells, strict=True)
        ]

    def _body(self, limits: list[int | None] | None = None, *, cut: bool = False) -> str:
        """Heads and rows. **Arguments:** ``limits``: columns of text that each column may take; ``cut``: whether words
        longer than that are cut.
        """
        alignment = ["right" if numbers else "left" for _, numbers in self.columns()]
        rows = [list(map(_cut, row, limits)) for row in self.rows] if cut and limits else self.rows
        return tabulate.tabulate(
            rows, self.headers, tablefmt="simple", disable_numparse=True, colalign=alignment,
            maxcolwidths=limits, break_long_words=cut, break_on_hyphens=False,
        )  # fmt: skip

    def _fitted(self, width: int) -> tuple[str, list[str]]:
        """Heads and rows within so many columns, and the heads of what was left out."""
        left_out: list[str] = []
        table = self
        while (body := table._wrapped_to(width, TEXT, cut=False)) is None:
            spare = next((head for head in self.spare if head in table.headers), None)
            if spare is None:
                return table._wrapped_to(width, LEAST_TEXT, cut=True) or table._body(), left_out
            left_out.append(spare)
            table = table._without(spare)
        return body, left_out

    def _without(self, head: str) -> "Table":
        """The table without the columns of that head."""
        kept = [k for k, other in enumerate(self.headers) if other != head]
        return self._replace(
            headers=[self.headers[k] for k in kept], rows=[[row[k] for k in kept] for row in self.rows]
        )

    def _wrapped_to(self, width: int, least: int, *, cut: bool) -> str | None:
        """Heads and rows with the widest columns of text wrapped until a line takes no more than ``width``; none where
        a column would have to be narrower than its head or than ``least``.
        """
        body, columns = self._body(), self.columns()
        excess = _width(body) - width
        if excess <= 0:
            return body
        size = [max([len(head) + PADDING, *(len(row[k]) for row in self.rows)]) for k, (head, _) in enumerate(columns)]
        floor = {k: max(len(head) + PADDING, least) for k, (head, numbers) in enumerate(columns) if not numbers}
        for _ in range(excess):
            widest = max(floor, key=lambda k: size[k] - floor[k], default=None)
            if widest is None or size[widest] <= floor[widest]:
                return None
            size[widest] -= 1
        body = self._body([size[k] if k in floor else None for k in range(len(columns))], cut=cut)
        return body if _width(body) <= width else None


def _cut(cell: str, limit: int | None) -> str:
    """A cell whose names are cut after a dot or an underline where they are longer than a line."""
    if limit is None:
        return cell
    lines = []
    for word in cell.split(" "):
        rest = word
        while len(rest) > limit:
            at = rest.rfind(".", 0, limit) + 1 or rest.rfind("_", 0, limit) + 1 or limit
            lines, rest = [*lines, rest[:at] + "\n"], rest[at:]
        lines.append(rest + " ")
    return "".join(lines).rstrip()


def _width(text: str) -> int:
    return max(map(len, text.splitlines()))


def wrapped(text: str, width: int | None) -> str:
    """Lines of a text wrapped to a width, points of a list hanging; what is indented stays as it is, to be copied."""
    if width is None:
        return text
    lines = []
    for line in text.splitlines():
        hanging = "  " if line.startswith("- ") else ""
        short = len(line) <= width or line.startswith(" ")
        lines += [line] if short else textwrap.wrap(
            line, max(width, NARROWEST), subsequent_indent=hanging, break_long_words=False, break_on_hyphens=False
        )  # fmt: skip
    return "\n".join(lines)


def laid_out(
    parts: Iterable[str | Table], width: int | None = None, *, everything: str = "the output sent to a file"
) -> str:
    """Paragraphs and tables one below the other.

    **Arguments:** ``width``: columns of the terminal, if it is one; ``everything``: where else all columns are to be
    had, said once if any were left out.
    """
    shown = [part.text(width) if isinstance(part, Table) else wrapped(part, width) for part in parts]
    if any(LEFT_OUT in text for text in shown):
        shown.append(wrapped(f"Columns were left out: a wider terminal, or {everything}, shows them all.", width))
    return "\n\n".join(shown)


def is_number(cell: str) -> bool:
    """Whether a cell is a number, with its error or a percentage, an order or a vector at its angle, or the dash."""
    return bool(re.fullmatch(r"-|[<>] \d[\d.]* %|[-+]?\d[\d.]*(e[-+]?\d+)?(X| %| at -?\d+°| ± \d[\d.]*)?", cell))


def number(value: float | None, digits: int = 3) -> str:
    """A number to some significant digits, trailing zeros kept; a dash for none."""
    if value is None or not math.isfinite(value):
        return "-"
    return figures(value, digits)


def duration(seconds: float) -> str:
    """A time in the unit in which people would say it."""
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 5400.0 else f"{seconds / 3600.0:.1f} h"
