"""The first pass over a recording: which channel is what, whether its samples can be used, and where its pulses are."""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from rotorjax.data.pulses import Mended, Trigger, mended
from rotorjax.data.recordings import Recording
from rotorjax.data.waveform_sections import TIME, Waveform
from rotorjax.errors import InputError

SAME_RATE = 1e-3
"""Sampling rates within 0.1 % are one, stated with fewer digits."""
GAP = 1.5
"""A step in time this many times the usual is a gap."""
LIMITED = 10.0
"""A channel is clipped where its outermost value comes this many times as often as the next one: a sine that is sampled
with few digits has 2.4 times as many.
"""
IN_A_ROW, FEWEST_LIMITED = 3, 8
"""Samples at the limit in a row, and in all, from which they are no accident of rounding."""

Progress = Callable[[str], None]
Piece = tuple[Float[np.ndarray, "sample"], Float[np.ndarray, "sample"], Float[np.ndarray, "sample probe"]]
"""Time [s], reference, displacement [m]."""


class Scan(NamedTuple):
    """A recording whose pulses are known."""

    recording: Recording
    probes: tuple[str, ...]
    pulses: Mended
    edge_error: float
    """Of one pulse, for not knowing its edge between samples [s]."""
    step: float
    """Time between samples [s]."""
    samples: int
    pieces: Callable[[], Iterator[Piece]]
    """The samples once more."""


class _Channels(NamedTuple):
    """Where what stands in a file."""

    reference: int
    probes: tuple[int, ...]
    time: int | None
    rate: float | None


def scan(recording: Recording, waveform: Waveform, *, rate_hz: float | None, progress: Progress) -> Scan:
    """Read a recording once: its pulses, mended, and all that can be wrong with its channels.

    **Arguments:** ``rate_hz``: sampling rate instead of that of the rig file. **Errors.** `InputError` with file,
    channel and cure.
    """
    channels = _channels(recording, waveform, rate_hz)
    checks = _Checks(recording, waveform, channels)
    size = recording.path.stat().st_size
    held: list[Piece] = []
    pulses: list[np.ndarray] = []
    trigger: Trigger | None = None
    with_name = f"{recording.path}: channel {recording.names[channels.reference]!r} (phase reference)"
    progress(f"reading {recording.path.name}, {_size_text(size)}")
    try:
        for piece in _pieces(recording, waveform, channels, checks):
            time, reference, _ = piece
            trigger = trigger or Trigger(
                reference, threshold=waveform.reference.threshold, edge=waveform.reference.edge
            )
            pulses.append(trigger.feed(time, reference))
            held = [piece] if checks.samples == len(time) else []
            if not held:
                share = f", {checks.samples / recording.lengths[0]:.0%} of it" if recording.lengths else ""
                progress(f"reading {recording.path.name}, {_size_text(size)}{share}: {checks.samples} samples")
        checks.close()
        marks = np.concatenate(pulses)
        assert trigger is not None
        trigger.require_pulses(len(marks))
        found = mended(marks)
    except ValueError as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{with_name}: {error}") from error
    again = (lambda: iter(held)) if held else (lambda: _pieces(recording, waveform, channels, None))
    return Scan(recording, tuple(waveform.probes), found, trigger.edge_error, checks.step, checks.samples, again)


def _size_text(size: int) -> str:
    """Size of a file."""
    for unit, name in ((1e9, "GB"), (1e6, "MB")):
        if size >= unit:
            return f"{size / unit:.3g} {name}"
    return f"{size / 1e3:.3g} kB"


def _channels(recording: Recording, waveform: Waveform, rate_hz: float | None) -> _Channels:
    """Where the channels stand that the rig file names."""
    reference = recording.index(waveform.reference.channel)
    used = {reference: "the phase reference"}
    for probe, channel in waveform.probes.items():
        place = recording.index(channel.channel)
        if place in used:
            raise InputError(
                f"{recording.path}: channel {channel.channel!r} is to be probe {probe} and {used[place]}; mend "
                "[waveform] of the rig file"
            )
        used[place] = f"probe {probe}"
        if recording.share_of_full_scale and channel.scale is None:
            raise InputError(
                f"{recording.path}: channel {channel.channel!r} (probe {probe}) holds shares of its full scale; state "
                f"that in {channel.unit} as scale = ... for {probe} under [waveform]"
            )
    time = waveform.time if waveform.time is not None else TIME if TIME in recording.names else None
    stated = rate_hz or waveform.sample_rate_hz
    own = recording.rate_hz
    if own and stated and abs(own / stated - 1.0) > SAME_RATE:
        raise InputError(
            f"{recording.path}: sampled at {own:g} Hz by its own account, at {stated:g} Hz by sample_rate_hz; leave "
            "that out"
        )
    if time is None and not own and not stated:
        raise InputError(
            f"{recording.path}: nothing says how fast it was sampled; state sample_rate_hz under [waveform], or which "
            'channel is the time in seconds: time = "NAME"'
        )
    place = None if time is None else recording.index(time)
    return _Channels(reference, tuple(list(used)[1:]), place, own or stated)


def _pieces(recording: Recording, waveform: Waveform, channels: _Channels, checks: "_Checks | None") -> Iterator[Piece]:
    """Time, reference and displacement, piece by piece."""
    order = [channels.reference, *channels.probes, *([] if channels.time is None else [channels.time])]
    start = 0
    for piece in recording.together(order):
        if channels.time is None:
            assert channels.rate is not None
            time = (start + np.arange(len(piece))) / channels.rate
        else:
            time = piece[:, -1]
        start += len(piece)
        raw = piece[:, 1 : 1 + len(channels.probes)]
        if checks is not None:
            checks.see(time, piece, raw)
        moved = [channel.displacement(raw[:, k]) for k, channel in enumerate(waveform.probes.values())]
        yield time, piece[:, 0], np.stack(moved, axis=1)


class _Checks:
    """What can be wrong with samples, looked for piece by piece."""

    def __init__(self, recording: Recording, waveform: Waveform, channels: _Channels):
        self.recording, self.channels = recording, channels
        self.probes = tuple(waveform.probes)
        self.samples, self.step = 0, 0.0
        self._first, self._last = np.inf, -np.inf
        self._low, self._high = np.full(len(self.probes), np.inf), np.full(len(self.probes), -np.inf)

    def _place(self, k: int) -> str:
        """The channel of a probe, in a message."""
        name = self.recording.names[self.channels.probes[k]]
        return f"{self.recording.path}: channel {name!r} (probe {self.probes[k]})"

    def see(self, time: np.ndarray, piece: np.ndarray, raw: np.ndarray) -> None:
        """Check one piece.

        **Errors.** `InputError`.
        """
        self._time(time)
        broken = np.argwhere(~np.isfinite(piece))
        if len(broken):
            row, column = broken[0].tolist()
            place = (
                f"{self.recording.path}: channel {self.recording.names[self.channels.reference]!r} (phase reference)"
            )
            place = self._place(column - 1) if 0 < column <= len(self.probes) else place
            raise InputError(
                f"{place} has a gap: no number at t = {time[row]:.6g} s, {int((~np.isfinite(piece)).sum())} such "
                "samples hereabouts; cut the record to one side of it"
            )
        for k in range(len(self.probes)):
            if share := _clipped(raw[:, k]):
                raise InputError(
                    f"{self._place(k)} is clipped: {share:.2g} of its samples stand at its limit; widen the range of "
                    "the recorder, or bring the probe to the middle of its own"
                )
        self._low = np.minimum(self._low, raw.min(axis=0))
        self._high = np.maximum(self._high, raw.max(axis=0))
        self.samples += len(time)

    def _time(self, time: np.ndarray) -> None:
        """Whether the time rises in even steps."""
        if self.channels.time is None:
            assert self.channels.rate is not None
            self.step = 1.0 / self.channels.rate
            return
        place = self._place_of_time(self.channels.time)
        steps = np.diff(time, prepend=self._last)
        bad = np.flatnonzero(~(steps > 0.0))
        if len(bad):
            raise InputError(
                f"{place} does not rise at t = {time[bad[0]]:.9g} s; write it with more digits, or leave it out and "
                "state sample_rate_hz under [waveform]"
            )
        self.step = self.step or float(np.median(steps[1:])) if len(time) > 1 else self.step
        gap = np.flatnonzero((steps > GAP * self.step) & np.isfinite(steps))
        if len(gap):
            raise InputError(
                f"{place} has a gap before t = {time[gap[0]]:.9g} s, {steps[gap[0]]:.3g} s instead of "
                f"{self.step:.3g} s; cut the record to one side of it, or make two recordings of it"
            )
        self._first, self._last = min(self._first, time[0]), time[-1]

    def _place_of_time(self, channel: int) -> str:
        """That of the time, in a message."""
        return f"{self.recording.path}: channel {self.recording.names[channel]!r} (time)"

    def close(self) -> None:
        """Check what only the whole shows.

        **Errors.** `InputError`.
        """
        if self.samples == 0:
            raise InputError(f"{self.recording.path}: holds no sample; export the recording anew")
        for k in np.flatnonzero(self._low == self._high).tolist():
            raise InputError(
                f"{self._place(k)} is constant at {self._low[k]:g}; check that the probe is connected and that this is "
                "its channel"
            )
        stated = self.channels.rate
        if self.channels.time is not None and stated and self.samples > 1:
            own = (self.samples - 1) / (self._last - self._first)
            if abs(own / stated - 1.0) > SAME_RATE:
                raise InputError(
                    f"{self._place_of_time(self.channels.time)} rises as at {own:g} Hz, where {stated:g} Hz is stated; "
                    "leave sample_rate_hz out, or the time if that is wrong"
                )


def _clipped(values: Float[np.ndarray, "sample"]) -> float:
    """Share of samples at the outermost value of a channel that was cut off there; zero for one that was not."""
    for side in (values, -values):
        at_limit = side == side.max()
        count = int(at_limit.sum())
        together = np.convolve(at_limit, np.ones(IN_A_ROW), "valid").max(initial=0.0) if count >= FEWEST_LIMITED else 0
        if together < IN_A_ROW or count == len(values):
            continue
        following = side[~at_limit].max()
        if count > LIMITED * int((side == following).sum()):
            return count / len(values)
    return 0.0
