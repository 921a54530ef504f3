"""Verdicts on cases drawn by seed: how many of each, and the page that lists them."""

import collections
from pathlib import Path

import tabulate

from rotorjax.data.files import write_whole


def summary(rows: list[list[str]]) -> str:
    """How many of each verdict, the last column."""
    counts = collections.Counter(row[-1] for row in rows)
    return f"{len(rows)} cases: " + ", ".join(f"{count} {verdict}" for verdict, count in counts.most_common()) + "."


def write_page(path: Path, title: str, about: str, heads: list[str], rows: list[list[str]]) -> None:
    """Title, what the verdicts mean, their numbers and every case, in Markdown."""
    table = tabulate.tabulate(rows, heads, tablefmt="pipe", disable_numparse=True)
    write_whole(path, f"# {title}\n\n{about}\n\n{summary(rows)}\n\n{table}\n")
