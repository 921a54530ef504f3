"""How much may be computed: counted in single cases linearised, a number that does not depend on the machine."""

import contextlib
import math
from collections.abc import Callable, Iterator
from typing import Any


def unwatched(_: int) -> None:
    """Do nothing with what is spent."""


class Budget:
    """Single cases linearised so far, and how many may be. **Arguments:** ``watch``: called with the count whenever it
    grows; a copy, or one that was saved, has none.
    """

    def __init__(self, limit: int | None = None, *, watch: Callable[[int], None] = unwatched) -> None:
        self.limit, self.spent, self._watch, self._reserved = limit, 0, watch, 0

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_watch": unwatched}

    def spend(self, count: int) -> None:
        """Add to what is spent."""
        self.spent += count
        self._watch(self.spent)

    @property
    def exhausted(self) -> bool:
        """Whether the limit is reached."""
        return self.limit is not None and self.spent >= self.limit

    @property
    def left(self) -> float | int:
        """How many may still be."""
        return math.inf if self.limit is None else max(0, self.limit - self.spent)

    def reserve(self, most: int) -> None:
        """Keep ``most`` of the limit, a tenth of it at most, until they are released."""
        if self.limit is not None:
            self._reserved = min(most, self.limit // 10)
            self.limit -= self._reserved

    def release(self) -> None:
        """What was reserved may be spent."""
        if self.limit is not None:
            self.limit += self._reserved
        self._reserved = 0

    @contextlib.contextmanager
    def ahead(self, most: int) -> Iterator[None]:
        """While it is open, up to ``most`` of what is reserved may be spent before it is released, however far beyond
        the limit the last step led.
        """
        limit = self.limit
        if limit is not None:
            self.limit = max(limit, self.spent) + min(most, self._reserved)
        try:
            yield
        finally:
            self.limit = limit

    @contextlib.contextmanager
    def share(self, most: float | int) -> Iterator[None]:
        """While it is open, no more than ``most`` of what is left."""
        limit = self.limit
        if most < self.left:
            self.limit = self.spent + int(most)
        try:
            yield
        finally:
            self.limit = limit
