"""Names that users give: characters that would do something to a terminal, or to the order of reading, are not part of
one.
"""

import unicodedata

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
