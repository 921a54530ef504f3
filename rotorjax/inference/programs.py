"""Compiled programs that take the leaves of a pytree and rows: any number of rows, evaluated in chunks of one size."""

import contextvars
import dataclasses
import functools
import os
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple, TypeVar

import jax
import numpy as np
from jax import Array

from rotorjax.compilation import compiler_options, release_freed_memory
from rotorjax.inference.kept_programs import kept_program
from rotorjax.model.conditions import Layout
from rotorjax.model.model import Model

LINEAR_CHUNK = 128
"""Rows evaluated together where each costs little."""
MOST_ROWS = 512
"""Rows of the balance of forces kept whole at one time, with those of one point more: every row has the matrix of its
motion.
"""

_WORKERS = ThreadPoolExecutor(os.cpu_count())
"""Compiled code, NumPy's too, leaves the interpreter to others while it runs."""
_AHEAD = ThreadPoolExecutor(2)
"""So does the compiler: one program is traced while another is compiled."""
Item = TypeVar("Item")
Result = TypeVar("Result")


def side_by_side(function: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
    """A function of every item, on all processors."""
    if len(items) == 1:
        return [function(items[0])]
    # What NumPy does on overflow is a setting of the thread's context.
    return list(
        _WORKERS.map(
            lambda item, context: context.run(function, item), items, [contextvars.copy_context() for _ in items]
        )
    )


def in_background(job: Callable[[], object]) -> None:
    """Begin something that makes programs, not to be waited for: what needs such a program waits for it, or makes it
    itself.
    """
    _AHEAD.submit(job)


class Program:
    """A kernel that takes the leaves of a pytree, its first argument, one by one: traced when it is first called, or
    found.
    """

    def __init__(
        self, kernel: Callable[..., tuple[Array, ...]], structure: Any, *, ours: bool, often: bool = False
    ) -> None:
        self._kernel, self._structure, self._ours, self._often = kernel, structure, ours, often
        self._call: Callable[..., tuple[Array, ...]] | None = None
        self._making = threading.Lock()

    @property
    def warm(self) -> bool:
        """Whether it was called before."""
        return self._call is not None

    def __call__(self, leaves: list[Any], *rows: np.ndarray) -> tuple[Array, ...]:
        """One chunk."""
        if self._call is not None:
            return self._call(leaves, *rows)
        with self._making:
            if self._call is None:
                call = self._made(leaves, *rows)
                parts = jax.block_until_ready(call(leaves, *rows))
                self._call = call
                release_freed_memory()
                return parts
        return self._call(leaves, *rows)

    def _made(self, leaves: list[Any], *rows: np.ndarray) -> Callable[..., tuple[Array, ...]]:
        def kernel(leaves: list[Any], *rows: Array) -> tuple[Array, ...]:
            return self._kernel(jax.tree.unflatten(self._structure, leaves), *rows)

        # What a class of somebody else does is not said by its name.
        return (
            kept_program(kernel, f"{self._kernel.__name__} {self._structure}", (leaves, *rows), often=self._often)
            if self._ours
            else jax.jit(kernel, compiler_options=compiler_options(often=self._often))
        )


@functools.lru_cache
def _program(
    kernel: Callable[..., tuple[Array, ...]],
    structure: Any,
    shapes: tuple[tuple[int, ...], ...],
    *,
    ours: bool,
    often: bool,
) -> Program:
    """The same one whenever it is asked for."""
    del shapes  # a program for each
    return Program(kernel, structure, ours=ours, often=often)


def in_chunks(
    function: Callable[..., Sequence[Array | np.ndarray]], rows: Sequence[np.ndarray], size: int, *, warm: bool
) -> list[np.ndarray]:
    """A function of rows, evaluated in chunks of one size; the last is filled up with copies of its last row.
    **Arguments:** ``warm``: whether what it calls is compiled.
    """
    count = len(rows[0])

    def chunk(first: int) -> list[np.ndarray]:
        index = np.minimum(np.arange(first, first + size), count - 1)
        return [np.asarray(part) for part in function(*(values[index] for values in rows))]

    firsts, parts = range(0, count, size), []
    if not warm:
        # The first by itself: it may have to be compiled.
        parts, firsts = [chunk(0)], firsts[1:]
    parts += side_by_side(chunk, firsts) if firsts else []
    return [np.concatenate(several)[:count] for several in zip(*parts, strict=True)]


class Compiled(NamedTuple):
    """A kernel at the values of one pytree. Called with rows, any number of them, which are evaluated in chunks of one
    size.
    """

    program: Program
    # Flat, and the structure apart: to look that up anew in every call costs as much as some rows.
    leaves: list[Any]
    size: int

    def __call__(self, *rows: np.ndarray) -> list[np.ndarray]:
        """All rows."""
        return in_chunks(self.chunk, rows, self.size, warm=self.program.warm)

    def chunk(self, *rows: np.ndarray) -> tuple[Array, ...]:
        """As many rows as are evaluated together."""
        return self.program(self.leaves, *rows)

    def make(self, *rows: np.ndarray) -> None:
        """Trace and compile it, if that was not done. **Arguments:** ``rows`` like those to come."""
        index = np.zeros(self.size, int)
        self.program(self.leaves, *(values[index] for values in rows))


def compiled(
    kernel: Callable[..., tuple[Array, ...]], tree: Any, model: Model, size: int, *, often: bool = False
) -> Compiled:
    """A kernel whose first argument is a pytree. **Arguments:** ``model``: what the tree was made of; ``size``: rows
    evaluated together; ``often`` as in `rotorjax.compilation.compiler_options`.
    """
    leaves, structure = jax.tree.flatten(tree)
    ours = all(type(part).__module__.startswith("rotorjax.") for part in (model.rotor, *model.effects))
    return Compiled(
        _program(kernel, structure, tuple(np.shape(leaf) for leaf in leaves), ours=ours, often=often), leaves, size
    )


def nameless(model: Model) -> Model:
    """The model without the names of probes and planes, which compiled code must not depend on, and
    without slow roll.
    """
    layout = model.layout
    blank = Layout(
        tuple(map(str, range(len(layout.probes)))), tuple(map(str, range(len(layout.planes)))), layout.orders
    )
    return dataclasses.replace(model, layout=blank, slow_roll=None)
