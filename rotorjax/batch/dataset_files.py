"""A dataset of any length in files, made in memory of a few chunks.

A folder of `stream` holds `MANIFEST`, written first and again after every chunk, and one archive per chunk.
An archive counts only once the manifest lists its SHA-256, and both come into place by renaming a finished, synced
temporary file: a run killed at any moment leaves a folder that the same call completes. Chunk k is drawn from
``fold_in(key, k)``, so that it does not depend on which run makes it.
"""

import dataclasses
import hashlib
import io
import json
import math
import os
import tempfile
import zipfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from jax import Array
from jaxtyping import Key

from rotorjax.arrays import require_float64
from rotorjax.batch.case import Case, Outcome
from rotorjax.batch.runner import run
from rotorjax.batch.threads import Threads
from rotorjax.diagnosis.dataset import CaseSampler, Dataset, FaultPrior, check_wanted
from rotorjax.errors import InputError
from rotorjax.model.rotor import Jeffcott

MANIFEST = "manifest.json"
FORMAT, VERSION = "rotorjax dataset", 1
PARTIAL = ".partial"
"""Ending of a temporary file; what a killed run leaves behind with it is removed by the next."""
COMPRESSION = 1
"""Level of deflate. Random mantissas hardly shrink: this saves 3.5 % of the raw size, level 6 saves 3.9 % for more
time.
"""
WRITERS = min(4, os.cpu_count() or 1)
"""Chunks compressed and written at one time: deflate is nearly all of a stream's time and runs outside Python's lock.
"""
MOST_CHUNKS = 10_000
"""The manifest is rewritten per chunk, which takes time in proportion to the square of their number."""


@dataclasses.dataclass(frozen=True, eq=False)
class Recipe:
    """All that determines the cases of a stream; a folder's manifest records it.

    **Fields:** ``rotor``; ``speed_rpm`` [rpm]; ``count`` of cases; ``key`` of JAX; ``prior`` of the faults; ``chunk``:
    cases per file. A stream holds `WRITERS` + 1 chunks in memory, some 160 bytes a case each.
    **Errors.** ``ValueError`` for a speed that is not positive, a count or chunk below one, or more than `MOST_CHUNKS`
    chunks.
    """

    rotor: Jeffcott
    speed_rpm: float
    count: int
    _: dataclasses.KW_ONLY
    key: Key[Array, ""]
    prior: FaultPrior = dataclasses.field(default_factory=FaultPrior)
    chunk: int = 250_000

    def __post_init__(self) -> None:
        check_wanted(self.speed_rpm, self.count)
        if self.chunk < 1 or math.ceil(self.count / self.chunk) > MOST_CHUNKS:
            raise ValueError(
                f"{self.count} cases in chunks of {self.chunk}: a chunk has at least one case, and there are at most "
                f"{MOST_CHUNKS}; change chunk"
            )

    def rows(self) -> list[int]:
        """Cases in each chunk."""
        return [min(self.chunk, self.count - start) for start in range(0, self.count, self.chunk)]

    def record(self) -> dict[str, Any]:
        """What a manifest says of it; equal records give equal cases."""
        return {
            "rotor": {
                field.name: np.asarray(getattr(self.rotor, field.name)).tolist()
                for field in dataclasses.fields(self.rotor)
            },
            "speed_rpm": float(self.speed_rpm),
            "prior": {name: float(value) for name, value in dataclasses.asdict(self.prior).items()},
            "key": {
                "generator": str(jax.random.key_impl(self.key)),
                "data": np.asarray(jax.random.key_data(self.key)).tolist(),
            },
            "count": self.count,
            "chunk": self.chunk,
            # Another version of JAX may draw other numbers from one key.
            "jax": jax.__version__,
        }


class _Entry(NamedTuple):
    """A chunk in the manifest; its digest is none until its file is in place."""

    file: str
    rows: int
    sha256: str | None


def _plan(rows: list[int]) -> list[_Entry]:
    return [_Entry(f"chunk-{k:06d}.npz", number, None) for k, number in enumerate(rows)]


def stream(recipe: Recipe, folder: Path, *, progress: Callable[[int, int], object] = lambda done, total: None) -> None:
    """Write a dataset of any length to files, in memory of a few chunks; complete what an interrupted call left.

    Chunk k is ``make_dataset(rotor, speed_rpm, rows, key=fold_in(key, k), prior=prior)``, a NumPy archive of
    ``features`` and ``faults`` in double precision. The same recipe gives the same bytes on one machine with the same
    libraries.

    **Arguments:** ``recipe``; ``folder``: new, empty, or that of an earlier call with the same recipe, of which the
    chunks whose hash is right are kept; ``progress(done, total)`` is called after every chunk with numbers of cases.
    Not for two calls at once.
    **Errors.** ``ValueError`` as for `make_dataset`; `InputError` for a folder of another recipe, or of other files, or
    that cannot be made or written to.
    """
    require_float64("a dataset")
    sampler = CaseSampler.of(recipe.rotor, recipe.speed_rpm, recipe.prior)
    chunks = _Chunks(recipe, folder)

    def make(index: int) -> dict[str, str]:
        # Double precision may be a setting of the calling thread alone.
        with jax.enable_x64(True):
            made = sampler.draw(jax.random.fold_in(recipe.key, index), chunks.entries[index].rows)
        path = folder / chunks.entries[index].file
        try:
            return {"sha256": _write_chunk(path, made)}
        except OSError as error:
            return {"failure": f"{path}: not written ({error.strerror or error}); mend that, call stream again"}

    cases = [Case(entry.file, k) for k, entry in enumerate(chunks.entries)]
    run(make, cases, chunks, Threads(WRITERS), told=lambda _: progress(chunks.rows_made, recipe.count))


class _Chunks:
    """The chunks of a folder, of which the manifest says which are made."""

    def __init__(self, recipe: Recipe, folder: Path):
        self._recipe, self._folder = recipe, folder
        self.entries = _open_folder(recipe, folder)

    @property
    def rows_made(self) -> int:
        """Cases in the chunks that are made."""
        return sum(entry.rows for entry in self.entries if entry.sha256 is not None)

    def plan(self, cases: Sequence[Case]) -> list[Case]:
        """Those that are missing, or whose file is not the one that was made."""
        for k, entry in enumerate(self.entries):
            if entry.sha256 is not None and _digest(self._folder / entry.file) != entry.sha256:
                self.entries[k] = entry._replace(sha256=None)
        return [case for case in cases if self.entries[case.payload].sha256 is None]

    def keep(self, case: Case, outcome: Outcome) -> None:
        """Write in the manifest that a chunk is made; `InputError` where it could not be."""
        made = json.loads(outcome.row or "{}")
        if "sha256" not in made:
            raise InputError(made.get("failure") or f"{self._folder / case.name}: {outcome.failure}")
        self.entries[case.payload] = self.entries[case.payload]._replace(**made)
        _write_manifest(self._folder, self._recipe, self.entries)


def read_dataset(folder: Path) -> Iterator[Dataset]:
    """The chunks that `stream` wrote, each read when asked for, its hash compared first.

    **Arguments:** ``folder``. **Returns** an iterator of `Dataset` of NumPy arrays, shape (rows of the chunk, 4).
    **Errors.** `InputError`, a ``ValueError``: at once for a folder without a manifest or with an incomplete one;
    during iteration for a file that is missing or was changed.
    """
    _, entries = _read_manifest(folder)
    missing = sum(entry.sha256 is None for entry in entries)
    if missing:
        raise InputError(
            f"{folder}: {missing} of {len(entries)} chunks are not written yet; call stream again with the same recipe "
            "to complete them"
        )
    return (_read_chunk(folder / entry.file, entry) for entry in entries)


def _open_folder(recipe: Recipe, folder: Path) -> list[_Entry]:
    """The chunks planned or made, after leftovers of a killed run are removed and a first manifest is written."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            f"{folder}: cannot be made a folder ({error.strerror or error}); choose another path"
        ) from error
    for left in folder.glob(f".*{PARTIAL}"):
        left.unlink()
    if not (folder / MANIFEST).exists():
        if any(folder.iterdir()):
            raise InputError(f"{folder}: holds other files and no {MANIFEST}; give a new or an empty folder")
        entries = _plan(recipe.rows())
        _write_manifest(folder, recipe, entries)
        return entries
    recorded, entries = _read_manifest(folder)
    wanted = recipe.record()
    differing = [name for name in wanted | recorded if wanted.get(name) != recorded.get(name)]
    if differing:
        told = "; ".join(
            f"{name} {json.dumps(recorded.get(name))}, asked for {json.dumps(wanted.get(name))}" for name in differing
        )
        raise InputError(f"{folder}: holds a dataset of another recipe ({told}); give another folder")
    return entries


def _write_manifest(folder: Path, recipe: Recipe, entries: list[_Entry]) -> None:
    content = {
        "format": FORMAT,
        "version": VERSION,
        "arrays": {"features": "f1, f2, f3, f4 [m]", "faults": "U_x, U_y [kg m], s_x, s_y [m]"},
        "recipe": recipe.record(),
        "chunks": [entry._asdict() for entry in entries],
    }
    with _replacing(folder / MANIFEST) as file:
        file.write((json.dumps(content, indent=1) + "\n").encode())


def _read_manifest(folder: Path) -> tuple[dict[str, Any], list[_Entry]]:
    """The recipe's record, and the chunks, whose names and numbers of rows must be those of the recipe."""
    path = folder / MANIFEST
    try:
        content = json.loads(path.read_bytes())
        kind, recipe = (content["format"], content["version"]), content["recipe"]
        entries = [_Entry(**chunk) for chunk in content["chunks"]]
        rows = [min(recipe["chunk"], recipe["count"] - start) for start in range(0, recipe["count"], recipe["chunk"])]
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}; give the folder that stream wrote") from error
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"{path}: not the manifest of a dataset ({error!r}); make the dataset again in another folder"
        ) from error
    if kind != (FORMAT, VERSION):
        raise InputError(
            f"{path}: format {kind[0]!r}, version {kind[1]!r}, but this is for {FORMAT!r}, version {VERSION}; make the "
            "dataset again elsewhere"
        )
    if [entry._replace(sha256=None) for entry in entries] != _plan(rows):
        raise InputError(
            f"{path}: its chunks are not those of its recipe, so that it was changed; make the dataset again in "
            "another folder"
        )
    return recipe, entries


def _write_chunk(path: Path, dataset: Dataset) -> str:
    """Write an archive and return its SHA-256."""
    with _replacing(path) as file:
        # Not np.savez_compressed, whose level is 6. A fixed date: equal cases give equal bytes.
        with zipfile.ZipFile(file, "w") as archive:
            for name, array in dataset._asdict().items():
                buffer = io.BytesIO()
                np.save(buffer, np.asarray(array), allow_pickle=False)
                member = zipfile.ZipInfo(f"{name}.npy", date_time=(1980, 1, 1, 0, 0, 0))
                archive.writestr(member, buffer.getbuffer(), zipfile.ZIP_DEFLATED, COMPRESSION)
        file.seek(0)
        return hashlib.file_digest(file, "sha256").hexdigest()


def _read_chunk(path: Path, entry: _Entry) -> Dataset:
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise InputError(
            f"{path}: {error.strerror or error}; call stream again with the same recipe to complete the dataset"
        ) from error
    if hashlib.sha256(raw).hexdigest() != entry.sha256:
        raise InputError(
            f"{path}: its SHA-256 is not the manifest's, so that it was changed or damaged; call stream again with the "
            "same recipe to restore it"
        )
    with np.load(io.BytesIO(raw), allow_pickle=False) as archive:
        dataset = Dataset(archive["features"], archive["faults"])
    if not all(array.shape == (entry.rows, 4) and array.dtype == np.float64 for array in dataset):
        raise InputError(
            f"{path}: not {entry.rows} rows of four numbers in double precision; make the dataset again in another "
            "folder"
        )
    return dataset


def _digest(path: Path) -> str | None:
    """SHA-256 of a file, none where there is no file."""
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except FileNotFoundError:
        return None


@contextmanager
def _replacing(path: Path) -> Iterator[io.BufferedRandom]:
    """A temporary file that takes the path's place once it is complete and on the disk, and never before."""
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=PARTIAL)
    try:
        with os.fdopen(handle, "w+b") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise
    if os.name == "posix":  # elsewhere a folder cannot be opened
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)
