"""Names that users give: characters that would do something to a terminal, or to the order of reading, are not part of
one.
"""

import unicodedata
from collections.abc import Collection, Iterable
from typing import TypeVar

Name = TypeVar("Name", str, float, int)

_NOT_SEEN = {"Cc", "Cf", "Cs", "Zl", "Zp"}
"""Unicode categories of what moves, hides or turns text: controls (escape, carriage return, backspace), formats (zero
width, right-to-left override), lone surrogates, separators of lines and paragraphs.
"""


def unseen(text: str) -> str | None:
    """The first control character of a text as its code point, ``U+001B``; none if there is none."""
    return next((f"U+{ord(c):04X}" for c in text if unicodedata.category(c) in _NOT_SEEN), None)


def harmless(text: str) -> str:
    """A text with control characters, all but the end of a line, written out as a Python string would have them."""
    if text.isprintable():
        return text
    return "".join(c if c == "\n" or unicodedata.category(c) not in _NOT_SEEN else _escaped(c) for c in text)


def _escaped(character: str) -> str:
    return character.encode("unicode_escape", "surrogatepass").decode("ascii")


def one_of(name: Name, known: Collection[Name], what: str) -> Name:
    """The name itself. **Arguments:** ``what`` it is a name of. **Errors.** ``ValueError`` with the known ones if it is
    not among them.
    """
    if name not in known:
        raise ValueError(f"there is no {what} {name!r}; choose among {', '.join(map(str, known)) or 'none'}")
    return name


def several(names: str | Iterable[str]) -> tuple[str, ...]:
    """Names that one gives as a collection, or a single one as it is."""
    return (names,) if isinstance(names, str) else tuple(names)
