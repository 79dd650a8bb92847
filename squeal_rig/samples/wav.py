"""WAV files of measured channels: 32-bit float, each channel scaled so that its peak is at 90 % of full scale."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from squeal_rig.errors import RecordingError

_PEAK = 0.9
_FLOAT = 3  # WAVE_FORMAT_IEEE_FLOAT
_MAX_BYTES = 2**32 - 2**16
_MAX_GAP = 60.0  # a longer silence [s] is no gap of a recording but another run

Piece = tuple[NDArray[np.int64], NDArray[np.float64]]
Pieces = Callable[[], Iterator[Piece]]


def write_wav(path: Path, rate: int, channels: Sequence[tuple[str, str]], pieces: Pieces) -> tuple[int, str]:
    """Write channels (name, unit) sampled at `rate` [Hz]; `pieces` gives (seq (n,), values (n, channels)), twice.

    Lost samples, by `seq`, become silence of their length. The scale of each channel is in the file's comment, and in
    the returned note. Returns (frames, note).

    Raises:
        RecordingError: more than a WAV file can hold, or `seq` goes back or leaps.
    """
    peaks, frames, lost = _survey(pieces, len(channels), rate)
    size = frames * len(channels) * 4
    if size > _MAX_BYTES:
        raise RecordingError(
            f"The WAV would have {size} bytes; the format ends at {_MAX_BYTES}: cut the bag or choose fewer columns."
        )
    scales = [peak / _PEAK if peak > 0.0 else 1.0 for peak in peaks]
    comment = "; ".join(
        f"{name}: full scale = {scale!r} {unit}" for (name, unit), scale in zip(channels, scales, strict=True)
    )
    with open(path, "wb") as stream:
        stream.write(_head(rate, len(channels), frames, comment))
        expected: int | None = None
        for seq, values in pieces():
            frame = _placed(seq, values / scales, expected)
            stream.write(frame.astype("<f4").tobytes())
            expected = int(seq[-1]) + 1
    silence = f"; {lost} lost samples are silence" if lost else ""
    return frames, comment + silence


def _survey(pieces: Pieces, channels: int, rate: int) -> tuple[list[float], int, int]:
    """Return the peaks, the frames with gaps filled, and the lost samples."""
    peaks = np.zeros(channels)
    first: int | None = None
    last, count = -1, 0
    for seq, values in pieces():
        steps = np.diff(seq, prepend=seq[0] - 1 if first is None else last)
        if (steps < 1).any() or (steps > _MAX_GAP * rate).any():
            raise RecordingError("seq goes back or leaps within the recording: cut the bag to one run first.")
        first = int(seq[0]) if first is None else first
        last, count = int(seq[-1]), count + len(seq)
        peaks = np.maximum(peaks, np.nan_to_num(np.abs(values), posinf=0.0).max(axis=0))
    frames = 0 if first is None else last - first + 1
    return [float(peak) for peak in peaks], frames, frames - count


def _placed(seq: NDArray[np.int64], values: NDArray[np.float64], expected: int | None) -> NDArray[Any]:
    """Values at their places by seq, zeros between."""
    start = int(seq[0]) if expected is None else expected
    count = int(seq[-1]) + 1 - start
    if count == len(seq):
        return values
    placed = np.zeros((count, values.shape[1]))
    placed[seq - start] = values
    return placed


def _head(rate: int, channels: int, frames: int, comment: str) -> bytes:
    block, data = channels * 4, frames * channels * 4
    text = comment.encode() + b"\0"
    text += b"\0" * (len(text) % 2)
    listed = b"INFO" + b"ICMT" + struct.pack("<I", len(text)) + text
    chunks = b"fmt " + struct.pack("<IHHIIHHH", 18, _FLOAT, channels, rate, rate * block, block, 32, 0)
    chunks += b"fact" + struct.pack("<II", 4, frames)
    chunks += b"LIST" + struct.pack("<I", len(listed)) + listed
    chunks += b"data" + struct.pack("<I", data)
    return b"RIFF" + struct.pack("<I", 4 + len(chunks) + data) + b"WAVE" + chunks
