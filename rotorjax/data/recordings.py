"""Recordings in time, read piece by piece: CSV, NumPy .npz, WAV and MATLAB .mat here, others in `recording_formats`.

Nothing in a file is executed: no pickles, no objects, numbers only.
"""

import csv
import dataclasses
import zipfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from rotorjax.data.files import refusals
from rotorjax.data.section import nearest
from rotorjax.errors import InputError

PIECE = 2**18
"""Samples held at once, per channel: 2 MB each."""
_DELIMITERS = (",", ";", "\t")
_OTHER = (
    "neither text in UTF-8 nor a recording in a format that is read; export it as CSV, NPZ, WAV, MAT, HDF5, TDMS or "
    "UFF 58"
)

Pieces = Iterator[Float[np.ndarray, "sample _"]]


@contextmanager
def _readable(path: Path) -> Iterator[None]:
    """Whatever comes up in a damaged file, in this code or in a package that reads a format, as a refusal."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        what = " ".join(f"{type(error).__name__}: {error}".split())
        raise InputError(f"{path}: cannot be read ({what}); export it anew") from error


@dataclasses.dataclass(frozen=True)
class Recording:
    """Channels of a file, not yet read."""

    path: Path
    names: tuple[str, ...]
    lengths: tuple[int, ...] | None
    """Samples of each channel; none where only reading tells."""
    rate_hz: float | None
    """Sampling rate that the file states, if any."""
    read: Callable[[Sequence[int]], Pieces]
    """Pieces of some channels by their index, at most ``PIECE`` samples each."""
    share_of_full_scale: bool = False
    """Whether the numbers are shares of a full scale that the file does not state."""

    def index(self, channel: str | int) -> int:
        """Where a channel stands, by its name or its number, counted from 0.

        **Errors.** `InputError` with the channels that there are.
        """
        if isinstance(channel, str) and self.names.count(channel) == 1:
            return self.names.index(channel)
        if isinstance(channel, str) and channel in self.names:
            raise InputError(
                f"{self.path}: {self.names.count(channel)} channels are called {channel!r}; give its number"
            )
        if isinstance(channel, int) and channel < len(self.names):
            return channel
        has = f"it has {len(self.names)}, counted from 0" if isinstance(channel, int) else nearest(channel, self.names)
        raise InputError(
            f"{self.path}: no channel {channel!r}; {has}; [waveform] of the rig file says which channel is what"
        )

    def together(self, channels: Sequence[int]) -> Pieces:
        """Pieces of channels that have one length.

        **Errors.** `InputError` where they do not, and where the file turns out to be damaged.
        """
        if self.lengths and len({self.lengths[k] for k in channels}) > 1:
            told = ", ".join(f"{self.names[k]} {self.lengths[k]}" for k in channels)
            raise InputError(
                f"{self.path}: channels of differing lengths ({told} samples); sample them at one rate, or cut them to "
                "the time that they share"
            )
        with _readable(self.path):
            yield from self.read(channels)


class Array(NamedTuple):
    """A numeric array of a file: one channel, or one per column."""

    name: str
    shape: tuple[int, ...]

    def channels(self) -> list[str]:
        """Their names: that of the array, with the number of the column in brackets if there are several."""
        if len(self.shape) == 1 or 1 in self.shape:
            return [self.name]
        return [f"{self.name}[{k}]" for k in range(self.shape[1])]


def open_recording(path: Path) -> Recording:
    """What a recording holds, by what its file begins with; no sample is read yet.

    **Errors.** `InputError` for a file that cannot be read, and where a package is needed that is not installed.
    """
    from rotorjax.data import recording_formats as formats  # noqa: PLC0415 - it needs `Recording`

    with refusals(path, cure="give the path of a recording"), path.open("rb") as file:
        begin = file.read(1024)
    kinds: tuple[tuple[bool, Callable[[Path], Recording]], ...] = (
        (begin.startswith(b"PK\x03\x04"), _open_npz),
        (begin[:4] in (b"RIFF", b"RIFX", b"RF64") and begin[8:12] == b"WAVE", _open_wav),
        (b"\x89HDF\r\n" in (begin[:6], begin[512:518]), formats.open_hdf5),
        (path.suffix.lower() == ".mat", _open_mat),
        (begin.startswith(b"TDSm"), formats.open_tdms),
        (begin.split(b"\n", 1)[0].strip() == b"-1" or path.suffix.lower() in (".uff", ".unv"), formats.open_uff),
    )
    with _readable(path):
        found = next((opened for matches, opened in kinds if matches), _open_csv)(path)
    if not found.names:
        raise InputError(f"{path}: holds no channel of numbers; export the recording anew")
    return found


def cut(values: Float[np.ndarray, "sample _"]) -> Pieces:
    """Pieces of what is in memory, or mapped into it."""
    for start in range(0, len(values), PIECE):
        yield np.asarray(values[start : start + PIECE], dtype=float)


def side_by_side(columns: Sequence[Any]) -> Pieces:
    """Pieces of columns that can be sliced."""
    for start in range(0, len(columns[0]), PIECE):
        yield np.stack([np.asarray(c[start : start + PIECE], dtype=float) for c in columns], axis=1)


# Text


class _Layout(NamedTuple):
    """How a text file is laid out."""

    delimiter: str
    names: tuple[str, ...]
    first: int
    """Lines before the first row of numbers."""


def _open_csv(path: Path) -> Recording:
    layout = _layout(path)
    return Recording(path, layout.names, None, None, lambda channels: _read_csv(path, layout, channels))


def _layout(path: Path) -> _Layout:
    lines = _lines(path)
    skipped = 0
    for line in lines:
        if line.strip() and not line.startswith("#"):
            break
        skipped += 1
    else:
        raise InputError(f"{path}: the file is empty; give a recording with one row per sample")
    delimiter = max(_DELIMITERS, key=line.count)
    try:
        cells = [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter, skipinitialspace=True))]
    except csv.Error as error:
        raise InputError(f"{path}: {_OTHER}") from error
    if all(_is_number(cell, delimiter) for cell in cells):
        return _Layout(delimiter, tuple(str(k) for k in range(len(cells))), skipped)
    return _Layout(delimiter, tuple(cells), skipped + 1)


def _is_number(cell: str, delimiter: str) -> bool:
    try:
        float(cell.replace(",", ".") if delimiter == ";" else cell)
    except ValueError:
        return False
    return True


def _lines(path: Path) -> Iterator[str]:
    try:
        with path.open(encoding="utf-8-sig", newline=None) as file:
            yield from file
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: {_OTHER}") from error


def _refuse_other_widths(path: Path, rows: list[tuple[int, str]], layout: _Layout) -> None:
    """Every row must have the cells of the first line; empty ones may follow, and nameless ones lack.

    **Errors.** `InputError`.
    """
    mark, width, empty = layout.delimiter, len(layout.names), f"{layout.delimiter} \t\r\n"
    named = max((k for k, name in enumerate(layout.names, start=1) if name), default=1)
    for number, line in rows:
        more = line.rstrip(empty).count(mark) >= width
        if more or line.count(mark) < named - 1:
            commas = "; decimal commas take semicolons between cells" if more and mark == "," else ""
            raise InputError(
                f"{path}:{number}: {line.count(mark) + 1} cells, the first line has {width}; cut the record before "
                f"this line, or mend it{commas}"
            )


def _read_csv(path: Path, layout: _Layout, channels: Sequence[int]) -> Pieces:
    numbered = islice(enumerate(_lines(path), start=1), layout.first, None)
    while piece := list(islice(numbered, PIECE)):
        if rows := [(number, line) for number, line in piece if line.strip()]:
            yield _rows(path, layout, rows, channels)


def _rows(path: Path, layout: _Layout, rows: list[tuple[int, str]], channels: Sequence[int]) -> np.ndarray:
    _refuse_other_widths(path, rows, layout)
    lines = [line.replace(",", ".") for _, line in rows] if layout.delimiter == ";" else [line for _, line in rows]
    try:
        return np.loadtxt(lines, delimiter=layout.delimiter, usecols=list(channels), ndmin=2, comments=None)
    except ValueError as error:
        for (number, _), line in zip(rows, lines, strict=True):
            cells = line.split(layout.delimiter)
            for k in channels:
                cell = cells[k] if k < len(cells) else ""
                if not _is_number(cell, layout.delimiter):
                    cure = "leave that line out" if number == layout.first + 1 else "cut the record there"
                    raise InputError(
                        f"{path}:{number}: channel {layout.names[k]!r}: {cell.strip()!r} is not a number; {cure}"
                    ) from error
        raise


# NumPy


def _open_npz(path: Path) -> Recording:
    with zipfile.ZipFile(path) as archive:
        held = [_header(archive, name) for name in archive.namelist() if name.endswith(".npy")]
    arrays = [(array, k) for array, k in held if array is not None]
    names = [(name, array, k) for array, _ in arrays for k, name in enumerate(array.channels())]
    lengths = tuple(_length(array.shape) for _, array, _ in names)
    where = [(array, k) for _, array, k in names]
    return Recording(
        path, tuple(name for name, _, _ in names), lengths, None,
        lambda channels: _read_npz(path, [where[c] for c in channels]),
    )  # fmt: skip


def _length(shape: tuple[int, ...]) -> int:
    """Samples of an array: a single row is a channel as a single column is."""
    return max(shape) if 1 in shape else shape[0]


def _header(archive: zipfile.ZipFile, name: str) -> tuple[Array | None, bool]:
    """Name and shape of an array, if it can be a channel, and whether its columns follow one another."""
    with archive.open(name) as file:
        shape, fortran, kind = _array_header(file)
    fits = kind.kind in "biuf" and len(shape) in (1, 2) and max(shape) > 1
    return (Array(name.removesuffix(".npy"), shape) if fits else None), fortran


def _array_header(file: Any) -> tuple[tuple[int, ...], bool, np.dtype]:
    version = np.lib.format.read_magic(file)
    readers = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
    if version not in readers:
        raise ValueError(f"array format {version[0]}.{version[1]}")
    return readers[version](file)


def _read_npz(path: Path, wanted: list[tuple[Array, int]]) -> Pieces:
    """Pieces as they are unpacked: no array is held whole, but one whose columns follow one another."""
    with zipfile.ZipFile(path) as archive:
        flows = [_flow(archive, array, column) for array, column in wanted]
        for parts in zip(*flows, strict=True):
            yield np.stack(parts, axis=1)


def _flow(archive: zipfile.ZipFile, array: Array, column: int) -> Iterator[Float[np.ndarray, "sample"]]:
    with archive.open(f"{array.name}.npy") as file:
        shape, fortran, kind = _array_header(file)
        samples, width = _length(shape), 1 if len(shape) == 1 or 1 in shape else shape[1]
        if fortran and width > 1:
            whole = np.frombuffer(file.read(), kind).reshape(shape, order="F")[:, column]
            yield from (piece[:, 0] for piece in cut(whole[:, None]))
            return
        for start in range(0, samples, PIECE):
            count = min(PIECE, samples - start)
            part = np.frombuffer(file.read(count * width * kind.itemsize), kind)
            if len(part) < count * width:
                raise InputError(f"{archive.filename}: array {array.name!r} ends early; save the file anew")
            yield part.reshape(count, width)[:, column].astype(float)


# WAV and MATLAB


def _open_wav(path: Path) -> Recording:
    rate, data = _wav(path)
    width = 1 if data.ndim == 1 else data.shape[1]
    return Recording(
        path, tuple(str(k) for k in range(width)), (len(data),) * width, float(rate),
        lambda channels: _read_wav(path, channels), data.dtype.kind in "iu",
    )  # fmt: skip


def _wav(path: Path) -> tuple[int, np.ndarray]:
    import warnings  # noqa: PLC0415

    from scipy.io import wavfile  # noqa: PLC0415

    with warnings.catch_warnings():
        # Chunks that are no samples.
        warnings.simplefilter("ignore", wavfile.WavFileWarning)
        try:
            return wavfile.read(path, mmap=True)
        except ValueError as error:
            if "mmap" not in str(error):
                raise
        # Samples of 24 bits fit no type that a file can be mapped to.
        return wavfile.read(path)


def _read_wav(path: Path, channels: Sequence[int]) -> Pieces:
    """Whole numbers as shares of the full scale, -1 to 1; others as they are."""
    _, data = _wav(path)
    table = data[:, None] if data.ndim == 1 else data
    bits = 8 * data.dtype.itemsize
    middle, full = {"u": (2.0 ** (bits - 1),) * 2, "i": (0.0, 2.0 ** (bits - 1))}.get(data.dtype.kind, (0.0, 1.0))
    for start in range(0, len(table), PIECE):
        yield (np.asarray(table[start : start + PIECE, list(channels)], dtype=float) - middle) / full


_MATLAB_NUMBERS = {"double", "single", "logical", *(f"{u}int{bits}" for u in ("", "u") for bits in (8, 16, 32, 64))}


def _open_mat(path: Path) -> Recording:
    from scipy.io import whosmat  # noqa: PLC0415

    arrays = [Array(n, s) for n, s, kind in whosmat(path) if kind in _MATLAB_NUMBERS and len(s) == 2 and max(s) > 1]
    where = [(array, k) for array in arrays for k, _ in enumerate(array.channels())]
    return Recording(
        path, tuple(name for array in arrays for name in array.channels()),
        tuple(_length(array.shape) for array, _ in where), None,
        lambda channels: _read_mat(path, [where[c] for c in channels]),
    )  # fmt: skip


def _read_mat(path: Path, wanted: list[tuple[Array, int]]) -> Pieces:
    """Pieces of variables that are read whole: the format has them compressed as one."""
    from scipy.io import loadmat  # noqa: PLC0415

    data = loadmat(path, variable_names=[array.name for array, _ in wanted])
    columns = [
        data[array.name].ravel() if 1 in array.shape else data[array.name][:, column] for array, column in wanted
    ]
    return side_by_side(columns)
