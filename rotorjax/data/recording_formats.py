"""Recordings in HDF5 (MATLAB 7.3 too), TDMS and universal files (UFF 58), by packages of the extra ``formats``."""

import importlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from rotorjax.data.recordings import PIECE, Array, Pieces, Recording, side_by_side
from rotorjax.errors import InputError

UFF_OF_TIME = {0, 1}
"""Kinds of function in a data set 58 that hold samples in time: general, and time response."""


def _package(path: Path, kind: str, name: str, called: str) -> Any:
    """A package that reads a format.

    **Errors.** `InputError` with the extra to install, where it is missing.
    """
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise InputError(
            f"{path}: {kind} takes the package {called}, which is not installed: pip install 'rotorjax[formats]'"
        ) from error


def open_hdf5(path: Path) -> Recording:
    """Numeric datasets, named by their path in the file; ``name[k]`` is a column of one that has several.

    MATLAB stores matrices turned; they are turned back. Links out of the file are not followed.
    """
    h5py = _package(path, "an HDF5 file (MATLAB 7.3 is one)", "h5py", "h5py")
    arrays: list[tuple[Array, bool]] = []

    def note(name: str, item: Any) -> None:
        if not isinstance(item, h5py.Dataset) or item.is_virtual or item.external:
            return
        if item.dtype.kind in "biuf" and item.ndim in (1, 2) and item.size > 1:
            turned = "MATLAB_class" in item.attrs
            arrays.append((Array(name, item.shape[::-1] if turned else item.shape), turned))

    with h5py.File(path, "r") as file:
        file.visititems(note)
    where = [(array, turned, k) for array, turned in arrays for k, _ in enumerate(array.channels())]

    def read(channels: Sequence[int]) -> Pieces:
        with h5py.File(path, "r") as file:
            wanted = [where[c] for c in channels]
            for start in range(0, _samples(wanted[0][0].shape), PIECE):
                span = slice(start, start + PIECE)
                yield np.stack([_part(file[array.name], span, turned, k) for array, turned, k in wanted], axis=1)

    names = tuple(name for array, _ in arrays for name in array.channels())
    return Recording(path, names, tuple(_samples(array.shape) for array, _, _ in where), None, read)


def _samples(shape: tuple[int, ...]) -> int:
    return max(shape) if 1 in shape else shape[0]


def _part(data: Any, span: slice, turned: bool, column: int) -> np.ndarray:
    """Some samples of one column of a dataset."""
    if data.ndim == 1:
        return np.asarray(data[span], dtype=float)
    if 1 in data.shape:
        return np.asarray(data[0, span] if data.shape[0] == 1 else data[span, 0], dtype=float)
    return np.asarray(data[column, span] if turned else data[span, column], dtype=float)


def open_tdms(path: Path) -> Recording:
    """Numeric channels, named ``group/channel``, or by the channel alone where that is unique; scaled as stored."""
    nptdms = _package(path, "a TDMS file", "nptdms", "npTDMS")
    with nptdms.TdmsFile.open(path) as file:
        held = [
            (group.name, channel.name, len(channel), _rate(channel.properties.get("wf_increment")))
            for group in file.groups()
            for channel in group.channels()
            if np.dtype(channel.dtype).kind in "biuf" and len(channel) > 1
        ]
    alone = [channel for _, channel, _, _ in held]

    def read(channels: Sequence[int]) -> Pieces:
        with nptdms.TdmsFile.open(path) as file:
            yield from side_by_side([file[held[c][0]][held[c][1]] for c in channels])

    names = tuple(channel if alone.count(channel) == 1 else f"{group}/{channel}" for group, channel, _, _ in held)
    rates = {rate for _, _, _, rate in held}
    return Recording(
        path, names, tuple(length for *_, length, _ in held), rates.pop() if len(rates) == 1 else None, read
    )


def _rate(step: Any) -> float | None:
    """Sampling rate of a step in time [Hz]; none where it is not stated."""
    return 1.0 / float(step) if step is not None and float(step) > 0.0 else None


def open_uff(path: Path) -> Recording:
    """Data sets 58 of samples in time, named by the first line of their text where that tells them apart, and by
    their number otherwise.
    """
    pyuff = _package(path, "a universal file (UFF 58)", "pyuff", "pyuff")
    file = pyuff.UFF(str(path))
    sets = [(k, file.read_sets(k)) for k, kind in enumerate(file.get_set_types()) if int(kind) == 58]
    held = [(k, s) for k, s in sets if s["func_type"] in UFF_OF_TIME and np.isrealobj(s["data"])]
    texts = [str(s.get("id1", "")).strip() for _, s in held]
    plain = len(set(texts)) == len(texts) and all(texts)
    names = tuple(texts) if plain else tuple(str(k) for k in range(len(held)))
    rates = {_rate(s.get("abscissa_inc")) for _, s in held if s.get("abscissa_spacing", 1) == 1}
    lengths = tuple(len(s["data"]) for _, s in held)
    numbers = [k for k, _ in held]

    def read(channels: Sequence[int]) -> Pieces:
        file = pyuff.UFF(str(path))
        return side_by_side([np.asarray(file.read_sets(numbers[c])["data"]) for c in channels])

    return Recording(path, names, lengths, rates.pop() if len(rates) == 1 else None, read)
