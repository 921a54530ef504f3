"""Tables and numbers as people read them. Needs no JAX, so that a command which only prints starts at once."""

import math
import re
from collections.abc import Sequence
from typing import NamedTuple

import tabulate


class Table(NamedTuple):
    """A table for people: title, heads of the columns, rows of text, a line below."""

    title: str
    headers: Sequence[str]
    rows: list[list[str]]
    note: str = ""

    def text(self) -> str:
        """For a terminal."""
        alignment = ["right" if numbers else "left" for _, numbers in self.columns()]
        body = tabulate.tabulate(self.rows, self.headers, tablefmt="simple", disable_numparse=True, colalign=alignment)
        return "\n".join(part for part in (self.title, body, self.note) if part)

    def columns(self) -> list[tuple[str, bool]]:
        """Head of every column, and whether it holds numbers, which stand to the right."""
        cells = zip(*self.rows, strict=True) if self.rows else [()] * len(self.headers)
        return [
            (head, any(is_number(cell) for cell in column)) for head, column in zip(self.headers, cells, strict=True)
        ]


def is_number(cell: str) -> bool:
    """Whether a cell is a number, an order or a vector at its angle, or the dash that stands for none."""
    return bool(re.fullmatch(r"-|[-+]?\d[\d.]*(e[-+]?\d+)?(X| at -?\d+°)?", cell))


def number(value: float | None, digits: int = 3) -> str:
    """A number to some significant digits, trailing zeros kept; a dash for none."""
    if value is None or not math.isfinite(value):
        return "-"
    text = f"{value:#.{digits}g}"
    return f"{value:.0f}" if "e+" in text and abs(value) < 1e7 else text.rstrip(".")
