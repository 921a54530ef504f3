"""Training data: fault cases drawn from a prior, the features they cause at one speed, in memory or in files.

A case is f = J(Ω) m with the fault m = (U_x, U_y, s_x, s_y) and the map J of `rotorjax.diagnosis.features`; U and s are
uniform up to the prior's largest, both angles uniform over the circle. Source: Huang et al. 2026, Sensors 26:2565,
section 2.2.

**Files.** A folder of `stream` holds `MANIFEST`, written first and again after every chunk, and one archive per chunk.
An archive counts only once the manifest lists its SHA-256, and both come into place by renaming a finished, synced
temporary file: a run killed at any moment leaves a folder that the same call completes. Chunk k is drawn from
``fold_in(key, k)``, so that it does not depend on which run makes it.
"""

import dataclasses
import functools
import hashlib
import io
import itertools
import json
import math
import os
import tempfile
import zipfile
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Key

from rotorjax.arrays import AnyArray, require_float64
from rotorjax.diagnosis.features import feature_map
from rotorjax.errors import InputError
from rotorjax.model.rotor import Jeffcott
from rotorjax.units import GRAM_MILLIMETRE

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
LARGEST_AMPLIFICATION = 1e10
"""Of bow into features. 1/(1 - τ²) loses a digit for each power of ten: beyond this it is a pole met but for rounding.
"""
SUM_TOLERANCE = 1e-9
"""What the sum of a split's fractions may miss one by: they are decimal numbers rounded to binary."""


@dataclasses.dataclass(frozen=True)
class FaultPrior:
    """Faults uniform in magnitude up to a largest one, and over all angles; the paper's by default.

    **Fields:** ``largest_unbalance_kg_m`` [kg m], 1000 g mm by default; ``largest_bow_m`` [m], 50 mm by default.
    **Errors.** ``ValueError`` for one that is negative or not finite, or both zero.
    Source: Huang et al. 2026, Sensors 26:2565, section 2.2.
    """

    largest_unbalance_kg_m: float = 1000 * GRAM_MILLIMETRE
    largest_bow_m: float = 0.05

    def __post_init__(self) -> None:
        sizes = (self.largest_unbalance_kg_m, self.largest_bow_m)
        if not (all(math.isfinite(size) and size >= 0.0 for size in sizes) and max(sizes) > 0.0):
            raise ValueError(
                "the largest unbalance [kg m] and bow [m] must be finite and not negative, and one of them positive, "
                f"but are {sizes[0]:g} and {sizes[1]:g}; "
                "give zero for the one that is absent"
            )


class Dataset(NamedTuple):
    """Cases: ``features`` (f1, f2, f3, f4) [m], and ``faults`` (U_x, U_y [kg m], s_x, s_y [m]) that cause them."""

    features: Float[AnyArray, "sample 4"]
    faults: Float[AnyArray, "sample 4"]


class Split(NamedTuple):
    """Disjoint parts of a dataset that together are all of it."""

    train: Dataset
    validation: Dataset
    test: Dataset


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
    prior: FaultPrior = FaultPrior()
    chunk: int = 250_000

    def __post_init__(self) -> None:
        _check(self.speed_rpm, self.count)
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


def _check(speed_rpm: float, count: int) -> None:
    if count < 1:
        raise ValueError(f"count is {count}: a dataset has at least one case; give a positive count")
    if not (math.isfinite(speed_rpm) and speed_rpm > 0.0):
        raise ValueError(
            f"speed_rpm is {speed_rpm:g}: it must be positive and finite; for the other sense of rotation build the "
            "rotor with rotation='y-to-x'"
        )


def _fault(draw: Float[Array, "4"], largest: Float[Array, "2"]) -> Float[Array, "4"]:
    """One case: four numbers uniform over [0, 1) -> (U_x, U_y, s_x, s_y)."""
    size, angle = largest * draw[:2], 2.0 * jnp.pi * draw[2:]
    return jnp.stack([size * jnp.cos(angle), size * jnp.sin(angle)], axis=1).reshape(4)


@functools.partial(jax.jit, static_argnames="count")
def _faults(key: Key[Array, ""], largest: Float[Array, "2"], count: int) -> Float[Array, "sample 4"]:
    return jax.vmap(lambda draw: _fault(draw, largest))(jax.random.uniform(key, (count, 4)))


@functools.partial(jax.jit, static_argnames="count")
def _cases(key: Key[Array, ""], largest: Float[Array, "2"], linear: Float[Array, "4 4"], count: int) -> Dataset:
    def case(draw: Float[Array, "4"]) -> Dataset:
        fault = _fault(draw, largest)
        return Dataset(linear @ fault, fault)

    return jax.vmap(case)(jax.random.uniform(key, (count, 4)))


def _largest(prior: FaultPrior) -> Float[Array, "2"]:
    return jnp.array([prior.largest_unbalance_kg_m, prior.largest_bow_m])


def _map(rotor: Jeffcott, speed_rpm: float) -> Float[Array, "4 4"]:
    """J at the speed, checked: finite here, the features of every case are."""
    linear = feature_map(rotor, speed_rpm)[0]
    if not (np.all(np.isfinite(linear)) and np.max(np.abs(linear[:, 2:])) < LARGEST_AMPLIFICATION):
        raise ValueError(
            f"the features at {speed_rpm:g} rpm are not finite: an undamped rotor has no steady state at its critical "
            "speeds "
            f"({', '.join(f'{float(speed):g}' for speed in rotor.critical_speeds_rpm())} rpm); give a damping ratio "
            "above zero or another speed"
        )
    return jnp.asarray(linear)


def sample_faults(key: Key[Array, ""], count: int, prior: FaultPrior = FaultPrior()) -> Float[Array, "sample 4"]:
    """Faults drawn from the prior.

    U = U_max a, s = s_max b, α = 2πc, θ = 2πd with a, b, c, d uniform over [0, 1).

    **Arguments:** ``key`` of JAX; ``count`` of faults; ``prior``. **Returns** (U cos α, U sin α) [kg m] and
    (s cos θ, s sin θ) [m], shape (sample, 4).
    **Errors.** ``ValueError`` for a count below one, or in single precision.
    Source: Huang et al. 2026, Sensors 26:2565, section 2.2.
    """
    require_float64("a dataset")
    _check(1.0, count)
    return _faults(key, _largest(prior), count)


def make_dataset(
    rotor: Jeffcott, speed_rpm: float, count: int, *, key: Key[Array, ""], prior: FaultPrior = FaultPrior()
) -> Dataset:
    """Fault cases drawn from the prior, with their features at one speed.

    f = J(Ω) m for every m of ``sample_faults(key, count, prior)``. J is the response to four unit faults: the features
    are linear in the fault, so that a case costs a 4x4 product and not a response.

    **Arguments:** ``rotor``; ``speed_rpm`` [rpm]; ``count`` of cases; ``key`` of JAX; ``prior`` of the faults.
    **Returns** a `Dataset`.
    **Errors.** ``ValueError`` for a count below one, a speed that is not positive, an undamped rotor at a critical
    speed, or in single precision. A map that cannot be inverted (equal axes) is no error: the features are right, the
    faults behind them ambiguous. Source: Huang et al. 2026, Sensors 26:2565, equations 1-14 and section 2.2.
    """
    require_float64("a dataset")
    _check(speed_rpm, count)
    return _cases(key, _largest(prior), _map(rotor, speed_rpm), count)


def with_noise(dataset: Dataset, key: Key[Array, ""], level: float) -> Dataset:
    """The same cases with Gaussian noise on their features.

    f_i + level h_i ε, ε ~ N(0, 1) independent, h_i = (max f_i - min f_i) / 2 over the dataset's cases.

    **Arguments:** ``dataset``; ``key`` of JAX; ``level`` [1] of each feature's half range. **Returns** a `Dataset` with
    the same faults.
    **Errors.** ``ValueError`` for a level that is negative or not finite, or in single precision.
    """
    require_float64("a dataset")
    if not (math.isfinite(level) and level >= 0.0):
        raise ValueError(
            f"the level of noise is {level:g}: it must be finite and not negative; give a fraction of the half range, "
            "like 0.01"
        )
    features = jnp.asarray(dataset.features)
    half_range = 0.5 * (jnp.max(features, axis=0) - jnp.min(features, axis=0))
    return Dataset(features + level * half_range[None, :] * jax.random.normal(key, features.shape), dataset.faults)


def split(
    dataset: Dataset, *, key: Key[Array, ""], fractions: tuple[float, float, float] = (0.70, 0.15, 0.15)
) -> Split:
    """A dataset in random order, cut into training, validation and test cases.

    **Arguments:** ``dataset``; ``key`` of JAX; ``fractions`` of the cases, to the nearest whole case. **Returns** a
    `Split`.
    **Errors.** ``ValueError`` for fractions that are negative or do not add up to one, or a part that would be left
    without a case.
    """
    if not (all(fraction >= 0.0 for fraction in fractions) and abs(sum(fractions) - 1.0) < SUM_TOLERANCE):
        raise ValueError(
            f"the fractions of a split must not be negative and must add up to one, but are {fractions}; the paper's "
            "are (0.70, 0.15, 0.15)"
        )
    count = len(dataset.features)
    ends = [0, round(count * fractions[0]), round(count * (fractions[0] + fractions[1])), count]
    if any(
        fraction > 0.0 and end == start
        for fraction, (start, end) in zip(fractions, itertools.pairwise(ends), strict=True)
    ):
        raise ValueError(
            f"a part of the split {fractions} of {count} cases is empty; make more cases, or give its fraction as zero"
        )
    order = np.asarray(jax.random.permutation(key, count))
    parts = [order[start:end] for start, end in itertools.pairwise(ends)]
    return Split(*(Dataset(dataset.features[part], dataset.faults[part]) for part in parts))


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
    that cannot be made.
    """
    require_float64("a dataset")
    linear, largest = _map(recipe.rotor, recipe.speed_rpm), _largest(recipe.prior)
    entries = _open_folder(recipe, folder)
    todo: list[int] = []
    done = 0
    for k, entry in enumerate(entries):
        if entry.sha256 is not None and _digest(folder / entry.file) == entry.sha256:
            done += entry.rows
        else:
            todo.append(k)
    progress(done, recipe.count)
    pending: deque[tuple[int, Future[str]]] = deque()

    def finish() -> None:
        nonlocal done
        k, written = pending.popleft()
        entries[k] = entries[k]._replace(sha256=written.result())
        _write_manifest(folder, recipe, entries)
        done += entries[k].rows
        progress(done, recipe.count)

    with ThreadPoolExecutor(WRITERS) as pool:
        for k in todo:
            # Made in this thread: JAX's settings, double precision among them, may hold for one thread only.
            made = _cases(jax.random.fold_in(recipe.key, k), largest, linear, entries[k].rows)
            pending.append((k, pool.submit(_write_chunk, folder / entries[k].file, made)))
            if len(pending) > WRITERS:
                finish()
        while pending:
            finish()


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
