"""All cases on one page, first what needs attention: failures, unexplained, undecided, then what was explained, the
largest error of the model as declared first. One HTML file without script or network.
"""

import os
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import quote

from rotorjax.reporting.page import rendered
from rotorjax.reporting.tables import duration, number
from rotorjax.reporting.wording import plain_name

FAILED = "failed"
OR = "or"
"""Between what ties."""
ORDER = (FAILED, "unexplained", "undecided", "explained", "nothing missing")
"""Verdicts, what needs attention first."""


class Line(NamedTuple):
    """One case on the page."""

    name: str
    link: str
    """To its report; empty if there is none."""
    verdict: str
    missing: list[str]
    """Effects with their sizes, or the message of a failure."""
    open: list[str]
    """What ties, and what to measure next."""
    before: str
    after: str
    held_out: str
    balance: list[str]


def verdict_of(row: Mapping[str, Any]) -> str:
    """Verdict of a row, or that it failed."""
    return row.get("verdict") or FAILED


def by_attention(rows: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Rows, what needs attention first."""
    return sorted(
        rows,
        key=lambda row: (ORDER.index(verdict_of(row)), -(row.get("error_before_um") or 0.0), row["name"]),
    )


def counted(rows: Sequence[Mapping[str, Any]]) -> dict[str, int]:
    """Verdict -> number of cases, what needs attention first."""
    counts = Counter(map(verdict_of, rows))
    return {verdict: counts[verdict] for verdict in ORDER if counts[verdict]}


def overview(rows: Sequence[Mapping[str, Any]], *, title: str, folder: Path, planned: int | None = None) -> str:
    """The page. **Arguments:** ``folder``: where it will be, for links to reports; ``planned``: cases of the run, where
    it is not at its end.
    """
    lines = [_line(row, folder) for row in by_attention(rows)]
    took = duration(sum(row.get("seconds") or 0.0 for row in rows))
    page = {
        "took": took,
        "title": title,
        "counts": list(counted(rows).items()),
        "lines": lines,
        "planned": planned or len(rows),
    }
    return rendered("overview.html", page)


def _line(row: Mapping[str, Any], folder: Path) -> Line:
    if row.get("failure"):
        return Line(row["name"], "", FAILED, row["failure"].split("\n"), [], "", "", "", [])
    further = row.get("next_measurement")
    measure = [] if further is None else [f"measure next: {further}"]
    wrong = [f"written down wrongly: {row['change']}"] if row.get("change") else []
    force = [f"force: {words}" for words in row["missing_force"]] if row["verdict"] == "unexplained" else []
    return Line(
        row["name"],
        _link(row.get("report"), folder),
        row["verdict"],
        [*wrong, *(row["sizes_in_words"] or map(plain_name, row["effects"])), *force],
        [*map(_in_words, row["ties"]), *measure],
        number(row["error_before_um"]),
        number(row["error_after_um"]),
        number(row["error_held_out_um"]),
        row["balance_in_words"],
    )


def _in_words(tie: str) -> str:
    """A tie with the field's names of effects."""
    return f" {OR} ".join(" + ".join(map(plain_name, names.split(" + "))) for names in tie.split(f" {OR} "))


def _link(report: str | None, folder: Path) -> str:
    """From the page to a report, relative where that can be, so that both can be moved together."""
    if report is None:
        return ""
    try:
        return quote(Path(os.path.relpath(report, folder)).as_posix())
    except ValueError:  # another drive
        return Path(report).resolve().as_uri()
