"""Checked access to a TOML document: every problem is collected with its line, key and cure."""

import difflib
import math
import re
import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from rotorjax.data.files import read_text
from rotorjax.errors import InputError

LARGEST = 1e15
"""No number of a rig file is larger, not even a stiffness in N/m."""
_REQUIRED = object()
_HEADER = re.compile(r"^\s*\[+\s*(.+?)\s*\]+\s*(#.*)?$")
_KEY = re.compile(r"^\s*([A-Za-z0-9_.\"'-]+)\s*=")


def close_to(name: str, known: Iterable[str], likeness: float) -> list[str]:
    """The known name that is spelled most alike, if any is alike enough."""
    return difflib.get_close_matches(name.lower(), known, 1, likeness) or difflib.get_close_matches(
        name, known, 1, likeness
    )


def nearest(name: str, known: Iterable[str]) -> str:
    """``; did you mean 'x'?`` or the list of what is known: the end of a message about an unknown name."""
    names = sorted(known)
    near = close_to(name, names, 0.5) or [known for known in names if name and name in known][:1]
    if near:
        return f"did you mean {near[0]!r}?"
    return f"known here: {', '.join(names)}" if names else "remove it"


class Document:
    """A parsed TOML file that knows the line of every key and gathers what is wrong with it."""

    def __init__(self, path: Path):
        self.path = path
        self.text = read_text(path)
        self.problems: list[str] = []
        try:
            self.data = tomllib.loads(self.text)
        except tomllib.TOMLDecodeError as error:
            where = re.search(r"at line (\d+)", str(error))
            place = f"{path}:{where[1]}" if where else str(path)
            raise InputError(
                f"{place}: not valid TOML: {error}; mend that line, or give the rig file if this is another"
            ) from error
        self._lines: dict[str, int] = {}
        header = ""
        for number, line in enumerate(self.text.splitlines(), start=1):
            if match := _HEADER.match(line):
                header = match[1].replace('"', "").replace("'", "")
                self._lines.setdefault(header, number)
            elif match := _KEY.match(line):
                key = match[1].replace('"', "").replace("'", "")
                self._lines.setdefault(f"{header}.{key}" if header else key, number)

    def section(self, name: str) -> "Section":
        """A table of the top level, empty if absent."""
        return Section(self, (name,), self.data.get(name, {}))

    def report(self, path: tuple[str, ...], rule: str) -> None:
        """Note a problem at a key."""
        self.problems.append(f"{self.place(path)}: {rule}")

    def place(self, path: tuple[str, ...]) -> str:
        """File, line of the key or of the nearest table above it, and the key."""
        for length in range(len(path), 0, -1):
            if line := self._lines.get(".".join(path[:length])):
                return f"{self.path}:{line}: {'.'.join(path)}"
        return f"{self.path}: {'.'.join(path)}"

    def raise_problems(self) -> None:
        """Raise if anything was reported."""
        if self.problems:
            raise InputError(*self.problems)


class Section:
    """One table of the document. Keys that nobody asked for are problems: call `close` when done."""

    def __init__(self, document: Document, path: tuple[str, ...], data: Any):
        self.document, self.path = document, path
        self.asked: set[str] = set()
        if not isinstance(data, dict):
            document.report(path, f"must be a table, not {data!r}")
            data = {}
        self.data: dict[str, Any] = data

    def __contains__(self, key: str) -> bool:
        return key in self.data

    def problem(self, key: str, rule: str) -> None:
        """Note a problem at one of this table's keys."""
        self.document.report((*self.path, key), rule)

    def raw(self, key: str, default: Any = None) -> Any:
        """The value as parsed, unchecked."""
        self.asked.add(key)
        return self.data.get(key, default)

    def number(
        self, key: str, default: Any = _REQUIRED, *, above: float = -math.inf, least: float = -math.inf
    ) -> float:
        """A finite number, greater than ``above`` and at least ``least``."""
        value = self.raw(key, default)
        if value is _REQUIRED:
            self.problem(key, "is missing; give a number")
            return math.nan
        return self.checked(key, value, above=above, least=least)

    def checked(self, key: str, value: Any, *, above: float = -math.inf, least: float = -math.inf) -> float:
        """The same check for a value found elsewhere."""
        if isinstance(value, bool) or not isinstance(value, int | float):
            self.problem(key, f"must be a number, not {value!r}")
        elif not math.isfinite(value):
            self.problem(key, f"must be finite, not {value}")
        elif abs(value) > LARGEST:
            self.problem(key, f"{value:g} is beyond any rotor; check its unit")
        elif not value > above:
            self.problem(key, f"must be above {above:g}, not {value:g}")
        elif not value >= least:
            self.problem(key, f"must be at least {least:g}, not {value:g}")
        else:
            return float(value)
        return math.nan

    def pair(self, key: str, *, above: float = -math.inf, least: float = -math.inf) -> tuple[float, float]:
        """``{ x = 1.0, y = 2.0 }``, or one number for both."""
        value = self.raw(key)
        if value is None:
            self.problem(key, "is missing; give { x = ..., y = ... }")
            return math.nan, math.nan
        if not isinstance(value, dict):
            one = self.checked(key, value, above=above, least=least)
            return one, one
        table = Section(self.document, (*self.path, key), value)
        both = table.number("x", above=above, least=least), table.number("y", above=above, least=least)
        table.close()
        return both

    def choice(self, key: str, options: tuple[str, ...]) -> str:
        """One of a few words; the first is the default."""
        value = self.raw(key, options[0])
        if value not in options:
            self.problem(key, f"{value!r} is not one of {', '.join(map(repr, options))}")
            return options[0]
        return value

    def flag(self, key: str) -> bool:
        """True or false; false if absent."""
        value = self.raw(key, False)
        if not isinstance(value, bool):
            self.problem(key, f"must be true or false, not {value!r}")
        return value is True

    def table(self, key: str) -> "Section":
        """A table within this one, empty if absent."""
        return Section(self.document, (*self.path, key), self.raw(key, {}))

    def tables(self) -> list[tuple[str, "Section"]]:
        """Every entry as a table of its own."""
        return [(key, self.table(key)) for key in self.data]

    def close(self) -> None:
        """Report the keys that nobody asked for."""
        for key in self.data:
            if key not in self.asked:
                self.problem(key, f"unknown key; {nearest(key, self.asked)}")
