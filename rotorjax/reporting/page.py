"""The HTML report: one file that needs no network and no script."""

import base64
from collections.abc import Mapping
from typing import Any, NamedTuple

import jinja2

from rotorjax.data.names import harmless
from rotorjax.reporting.sizes import Size
from rotorjax.reporting.tables import Table, is_number
from rotorjax.reporting.wording import plain_name


class Picture(NamedTuple):
    """A figure for the report: caption and SVG as a data address."""

    caption: str
    source: str

    @classmethod
    def of(cls, caption: str, svg: bytes) -> "Picture":
        """From an SVG file's content."""
        return cls(caption, "data:image/svg+xml;base64," + base64.b64encode(svg).decode("ascii"))

    @classmethod
    def every(cls, pairs: list[tuple[str, bytes]]) -> list["Picture"]:
        """From pairs of caption and SVG."""
        return [cls.of(caption, svg) for caption, svg in pairs]


class Headline(NamedTuple):
    """What is seen without scrolling."""

    verdict: str
    """In a word or two: it has a colour of its own."""
    sentence: str
    fall: str
    """How far the error falls."""
    effects: list[tuple[str, str, list[Size]]]
    """Name, meaning, and sizes of every effect found."""
    lines: list[str]
    """What ties, and what to measure next."""
    pictures: list[Picture]


class Page(NamedTuple):
    """What a report shows, from top to bottom."""

    title: str
    headline: Headline
    measurement: str
    findings: list[str]
    """What else is to be known, beside the headline."""
    tables: list[Table]
    pictures: list[Picture]
    where: list[Table]
    cost: str = ""
    """The last line: what it took."""
    phase: str = "lead"
    """How phases are shown."""


def html_report(page: Page) -> str:
    """A report as one HTML file that needs no network."""
    return rendered("report.html", page._asdict())


def rendered(template: str, content: Mapping[str, Any]) -> str:
    """A page from one of the templates. All text is escaped, control characters are written out."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("rotorjax", "reporting/templates"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=lambda value: harmless(value) if type(value) is str else value,
    )
    environment.tests["numeric"] = is_number
    environment.filters["plain"] = plain_name
    return environment.get_template(template).render(content)
