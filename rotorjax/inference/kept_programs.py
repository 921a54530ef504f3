"""Programs kept from one process to the next, beside what JAX keeps: to trace a kernel takes longer than to load what
was compiled of it.

What is kept is JAX's own portable form (`jax.export`), no pickle. Its name says what it was made of: the sources of
this package, the versions of what they stand on, the structure and the shapes. Where JAX keeps nothing, or a class is
not this package's own, nothing is kept.
"""

import contextlib
import functools
import hashlib
import importlib.metadata
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
from jax import export

from rotorjax.compilation import compiler_options
from rotorjax.data.files import write_whole
from rotorjax.errors import InputError

FOLDER = "traced"
"""Within JAX's compilation cache."""
DIGEST = hashlib.sha256().digest_size


def kept_program(
    function: Callable[..., Any], made_of: str, arguments: tuple[Any, ...], *, often: bool = False
) -> Callable[..., Any]:
    """A compiled function of arguments of these shapes: found, or traced and kept. **Arguments:** ``made_of``: what it
    depends on beside the shapes; ``often`` as in `rotorjax.compilation.compiler_options`.
    """
    file, found = _file(made_of, arguments), None
    if file is not None:
        found = _read(file)
        if found is None:
            traced = export.export(jax.jit(function))(*arguments)
            found = traced.serialize()
            _write(file, bytes(found))
    call = function if found is None else export.deserialize(bytearray(found)).call
    return jax.jit(call, compiler_options=compiler_options(often=often))


def _file(made_of: str, arguments: tuple[Any, ...]) -> Path | None:
    folder = jax.config.values["jax_compilation_cache_dir"]
    # An address in the text is another one in the next process.
    if not folder or " at 0x" in made_of:
        return None
    shapes = [(leaf.shape, str(leaf.dtype)) for leaf in jax.tree.leaves(arguments)]
    name = hashlib.sha256(
        "\n".join((_sources(), made_of, str(jax.tree.structure(arguments)), str(shapes))).encode()
    ).hexdigest()
    return Path(folder) / FOLDER / name


@functools.cache
def _sources() -> str:
    """A digest of all code that a program may be made of."""
    text = hashlib.sha256()
    for file in sorted(Path(__file__).parents[1].rglob("*.py")):
        text.update(file.read_bytes())
    versions = [importlib.metadata.version(name) for name in ("jax", "jaxlib", "equinox")]
    return " ".join((text.hexdigest(), *versions, sys.version, jax.default_backend()))


def _read(file: Path) -> bytes | None:
    """What was kept; none where there is nothing, or not the whole of it."""
    try:
        content = file.read_bytes()
    except OSError:
        return None
    return content[DIGEST:] if hashlib.sha256(content[DIGEST:]).digest() == content[:DIGEST] else None


def _write(file: Path, content: bytes) -> None:
    """All of it or nothing; a folder that cannot be written to keeps nothing."""
    with contextlib.suppress(OSError, InputError):
        file.parent.mkdir(parents=True, exist_ok=True)
        write_whole(file, hashlib.sha256(content).digest() + content)
