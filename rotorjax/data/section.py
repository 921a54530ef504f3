"""Checked access to a TOML document: every problem is collected with its line, key and cure."""

import difflib
import math
import re
import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from rotorjax.data.files import read_text
from rotorjax.data.names import harmless, unseen
from rotorjax.errors import InputError

LARGEST = 1e15
"""No number of a rig file is larger, not even a stiffness in N/m."""
_REQUIRED = object()
_NAME = r"""(?:[A-Za-z0-9_-]+|"(?:[^"\\]|\\.)*"|'[^']*')"""
_KEY = re.compile(rf"^\s*({_NAME}(?:\s*\.\s*{_NAME})*)\s*=")
_HEADER = re.compile(rf"^\s*\[{{1,2}}\s*({_NAME}(?:\s*\.\s*{_NAME})*)\s*\]{{1,2}}\s*(?:\#.*)?$")
_LONGEST = 60
"""Characters of a value that a message repeats."""
_DEEPEST = 50
"""Tables and lists within one another: a rig file has five."""
_DEEP_KEY = re.compile(rf"(?<![A-Za-z0-9_-])(?:{_NAME}[ \t]*\.[ \t]*){{{_DEEPEST}}}")
_DEEP_BRACKETS = re.compile(rf"(?:[\[{{]\s*){{{_DEEPEST}}}")
_LARGEST_WHOLE = 2**63 - 1
"""TOML has whole numbers of 64 bits."""
_TOKEN = re.compile(
    r'''(?P<long>"""(?:[^\\]|\\.)*?"{3,5}|\'{3}.*?\'{3,5})|"(?:[^"\\\n]|\\.)*"|'[^'\n]*'|\#[^\n]*''', re.DOTALL
)
"""Strings and comments of a valid document; ``long``: those that may have several lines."""
_KINDS = {"runs": "run name", "probes": "probe name", "planes": "plane name", "recordings": "file name"}


def close_to(name: str, known: Iterable[str], likeness: float) -> list[str]:
    """The known name that is spelled most alike, if any is alike enough."""
    return difflib.get_close_matches(name.lower(), known, 1, likeness) or difflib.get_close_matches(
        name, known, 1, likeness
    )


def nearest(name: str, known: Iterable[str]) -> str:
    """``; did you mean 'x'?`` or the list of what is known: the end of a message about an unknown name."""
    names = sorted(known)
    near = close_to(name, names, 0.5) or [one for one in names if name and (name in one or one in name)][:1]
    if near:
        return f"did you mean {near[0]!r}?"
    return f"known here: {', '.join(names)}" if names else "remove it"


class Document:
    """A parsed TOML file that knows the line of every key and gathers what is wrong with it."""

    def __init__(self, path: Path):
        self.path = path
        self.text = read_text(path)
        self.problems: list[str] = []
        if not self.text.strip():
            raise InputError(f"{path}: the file is empty; `rotorjax example DIR` writes a rig file to start from")
        self.data = parsed(path, self.text)
        self._lines: dict[str, int] = {}
        header = ""
        for number, line in enumerate(_without_long_strings(self.text).split("\n"), start=1):
            if match := _HEADER.match(line.rstrip("\r")):
                header = _joined(match[1])
                self._lines.setdefault(header, number)
            elif match := _KEY.match(line):
                key = _joined(match[1])
                self._lines.setdefault(f"{header}.{key}" if header else key, number)
        self._look_through((), self.data, 0)

    def _look_through(self, path: tuple[str, ...], value: Any, depth: int) -> None:
        """Report keys with characters that are not seen, such as an escape: they are names that will be printed.

        **Errors.** `InputError` for what no later check could handle: far too deep nesting, endless numbers.
        """
        if depth > _DEEPEST:
            raise InputError(f"{self.place(path)}: nested too deeply; mend the brackets, or the dots of the key")
        if isinstance(value, int) and abs(value) > _LARGEST_WHOLE:
            raise InputError(f"{self.place(path)}: {shown(value)} is beyond any rotor; check its digits")
        for key, inner in value.items() if isinstance(value, dict) else ():
            if control := unseen(key):
                kind = _KINDS.get(path[0], "key") if path else "section"
                self.report((*path, key), f"{kind} holds the control character {control}; delete it")
            self._look_through((*path, key), inner, depth + 1)
        for inner in value if isinstance(value, list) else ():
            self._look_through(path, inner, depth + 1)

    def section(self, name: str) -> "Section":
        """A table of the top level, empty if absent."""
        return Section(self, (name,), self.data.get(name, {}))

    def report(self, path: tuple[str, ...], rule: str) -> None:
        """Note a problem at a key."""
        self.problems.append(f"{self.place(path)}: {rule}")

    def place(self, path: tuple[str, ...]) -> str:
        """File, line of the key or of the nearest table above it, and the key."""
        name = harmless(".".join(path)).replace("\n", r"\n")
        for length in range(len(path), 0, -1):
            if line := self._lines.get(".".join(path[:length])):
                return f"{self.path}:{line}: {name}"
        return f"{self.path}: {name}"

    def raise_problems(self) -> None:
        """Raise if anything was reported."""
        if self.problems:
            raise InputError(*self.problems)


def parsed(path: Path, text: str) -> dict[str, Any]:
    """A TOML document.

    **Errors.** `InputError` with line and column.
    """
    # The parser takes a time and a memory that grow with the square of a key's parts.
    if deep := _DEEP_KEY.search(text):
        raise InputError(f"{_place(path, text, deep)}: a key of more than {_DEEPEST} parts; delete dots")
    try:
        return tomllib.loads(text)
    except RecursionError as error:
        place = _place(path, text, _DEEP_BRACKETS.search(text))
        raise InputError(f"{place}: not valid TOML: nested too deeply; mend the brackets") from error
    except ValueError as error:
        where = re.search(r"at line (\d+)", str(error))
        last = len(text.rstrip().split("\n")) if "end of document" in str(error) else None
        line = where[1] if where else last
        place = f"{path}:{line}" if line else str(path)
        if "Exceeds the limit" in str(error):
            place = _place(path, text, re.search(r"[0-9_]{4000}", text))
            raise InputError(f"{place}: holds a number of thousands of digits; mend it") from error
        twice = " (the same key or section appears twice)" if "overwrite" in str(error) or "twice" in str(error) else ""
        raise InputError(
            f"{place}: not valid TOML: {error}{twice}; mend that line, or give the rig file if this is another"
        ) from error


def _place(path: Path, text: str, found: re.Match[str] | None) -> str:
    """File, and the line in which a match begins."""
    if found is None:
        return str(path)
    before = text[: found.start()].count("\n")
    return f"{path}:{before + 1}"


def _without_long_strings(text: str) -> str:
    """A valid document whose strings of several lines are empty lines: what is in them is no key."""
    return _TOKEN.sub(lambda token: "\n" * token[0].count("\n") if token["long"] else token[0], text)


def _joined(key: str) -> str:
    """A key as it is written, quoted or dotted, with plain dots between its parts."""
    parts = re.findall(_NAME, key)
    return ".".join(next(iter(tomllib.loads(f"{part} = 0"))) for part in parts)


def shown(value: Any) -> str:
    """A value as Python writes it, cut where it is long."""
    # Python writes no decimal number of more than some thousand digits.
    text = hex(value) if isinstance(value, int) and value.bit_length() > 2**12 else repr(value)
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 3]}..."


class Section:
    """One table of the document. Keys that nobody asked for are problems: call `close` when done."""

    def __init__(self, document: Document, path: tuple[str, ...], data: Any):
        self.document, self.path = document, path
        self.asked: set[str] = set()
        """Keys that were asked for: all that may be here, also those that are not."""
        self.reported = not isinstance(data, dict)
        """Whether this is no table at all, so that what it lacks needs no message of its own."""
        if not isinstance(data, dict):
            document.report(path, f"must be a table, not {shown(data)}")
            data = {}
        self.data: dict[str, Any] = data

    def __contains__(self, key: str) -> bool:
        self.asked.add(key)
        return key in self.data

    def problem(self, key: str, rule: str) -> None:
        """Note a problem at one of this table's keys."""
        self.document.report((*self.path, key), rule)

    def missing(self, key: str, cure: str) -> None:
        """Note that a key is missing."""
        if not self.reported:
            self.problem(key, f"is missing; {cure}")

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
            self.missing(key, "give a number")
            return math.nan
        return self.checked(key, value, above=above, least=least)

    def checked(self, key: str, value: Any, *, above: float = -math.inf, least: float = -math.inf) -> float:
        """The same check for a value found elsewhere."""
        if isinstance(value, bool) or not isinstance(value, int | float):
            bare = "; write it without quotes and without unit" if isinstance(value, str) else ""
            self.problem(key, f"must be a number, not {shown(value)}{bare}")
        elif isinstance(value, float) and not math.isfinite(value):
            self.problem(key, f"must be finite, not {value}")
        elif abs(value) > LARGEST:
            self.problem(key, f"{shown(value)} is beyond any rotor; check its unit")
        elif not value > above:
            self.problem(key, f"must be above {above:g}, not {value:g}")
        elif not value >= least:
            self.problem(key, f"must be at least {least:g}, not {value:g}")
        else:
            return float(value)
        return math.nan

    def pair(
        self, key: str, *, above: float = -math.inf, least: float = -math.inf, also: tuple[str, ...] = ()
    ) -> tuple[float, float]:
        """``{ x = 1.0, y = 2.0 }``, or one number for both. **Arguments:** ``also``: keys that may be there instead."""
        value = self.raw(key)
        if value is None:
            self.missing(key, "give { x = ..., y = ... }")
            return math.nan, math.nan
        if not isinstance(value, dict):
            one = self.checked(key, value, above=above, least=least)
            return one, one
        table = Section(self.document, (*self.path, key), value)
        table.asked |= set(also)
        both = table.number("x", above=above, least=least), table.number("y", above=above, least=least)
        table.close()
        return both

    def choice(self, key: str, options: tuple[str, ...], cure: str = "") -> str:
        """One of a few words; the first is the default. **Arguments:** ``cure``: which to write when, for those who
        wrote something else.
        """
        value = self.raw(key, options[0])
        if value not in options:
            near = close_to(value, options, 0.5) if isinstance(value, str) else []
            end = cure or "".join(f"did you mean {name!r}?" for name in near)
            self.problem(
                key, f"{shown(value)} is not one of {', '.join(map(repr, options))}{f'; {end}' if end else ''}"
            )
            return options[0]
        return value

    def flag(self, key: str) -> bool:
        """True or false; false if absent."""
        value = self.raw(key, False)
        if not isinstance(value, bool):
            self.problem(key, f"must be true or false, not {shown(value)}")
        return value is True

    def table(self, key: str) -> "Section":
        """A table within this one, empty if absent."""
        return Section(self.document, (*self.path, key), self.raw(key, {}))

    def tables(self) -> list[tuple[str, "Section"]]:
        """Every entry as a table of its own."""
        return [(key, self.table(key)) for key in self.data]

    def close(self, cure: str = "", words: tuple[str, ...] = ()) -> None:
        """Report the keys that nobody asked for. **Arguments:** ``cure``: what to write instead of keys that hold one
        of these ``words``.
        """
        for key in self.data:
            if key not in self.asked:
                meant = cure and any(word in key for word in words)
                self.problem(key, f"unknown key; {cure if meant else nearest(key, self.asked)}")
