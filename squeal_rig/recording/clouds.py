"""Samples in and out of a serialised sensor_msgs/PointCloud2, without ROS: one point is one sample.

The message is read where it lies: the samples are a structured view of its bytes, fields by name and offset.
CDR layout: OMG DDSI-RTPS 2.3, section 10; numbers are aligned to their size, from the end of the header.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from struct import Struct
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from squeal_rig.errors import RecordingError

from .cdr import CDR_HEADER, CdrWriter, seconds_of

# sensor_msgs/PointField: datatype number -> numpy code
_CODES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
_NUMBERS = {code: number for number, code in _CODES.items()}
_HEADER = 4
MAX_FIELDS = 1024  # the widest of ours has 12; ten thousands would keep a node busy for seconds
MAX_POINT_STEP = 1 << 16  # [bytes]; a larger one is damage, and numpy's own limit is not far above
_MAX_LAYOUTS = 64

Samples = npt.NDArray[np.void]


class SampleBlock(NamedTuple):
    """Samples of one message: structured array (n,), time of the first one [ns], frame."""

    stamp_ns: int
    frame_id: str
    samples: Samples


@dataclass(frozen=True)
class _Layout:
    """All of a message between its stamp and its point data; equal bytes mean an equal layout."""

    frame_id: str
    dtype: np.dtype[np.void]
    height: int
    width: int
    row_step: int
    start: int  # offset of the point data
    size: int


# Layouts seen, by (byte order, bytes between stamp and point data), and the lengths of those byte strings.
_layouts: dict[tuple[bool, bytes], _Layout] = {}
_ends: list[int] = []


def samples_from_cdr(data: bytes) -> SampleBlock:
    """Return the samples of a serialised PointCloud2: a read-only view of `data`, a copy of padded rows.

    Raises RecordingError when the bytes are no such message.
    """
    if len(data) < 16:
        raise RecordingError(f"A PointCloud2 of {len(data)} bytes is cut short.")
    if data[0] != 0 or data[1] > 1:
        raise RecordingError(f"A PointCloud2 has the CDR encoding 0x{data[:2].hex()}; 0x0000 and 0x0001 can be read.")
    little = data[1] == 1
    seconds, nanoseconds = (_STAMP_LE if little else _STAMP_BE).unpack_from(data, _HEADER)
    layout = _known_layout(data, little)
    if layout is None:
        layout = _parse_layout(data, little)
    end = layout.start + layout.size
    if len(data) < end + 1:
        raise RecordingError(f"A PointCloud2 of {len(data)} bytes is cut short: its points end at byte {end}.")
    return SampleBlock(seconds * 1_000_000_000 + nanoseconds, layout.frame_id, _view(data, layout))


def cdr_from_samples(samples: npt.NDArray[Any], stamp_ns: int, frame_id: str = "rig") -> bytes:
    """Return a serialised PointCloud2 of height 1 with these samples, structured array (n,), stamp in [ns].

    Raises RecordingError where a field or the stamp does not fit the message.
    """
    seconds, nanoseconds = seconds_of(stamp_ns)
    if samples.ndim != 1 or samples.dtype.names is None:
        raise RecordingError(f"Samples are a structured array (n,), not {samples.dtype} of shape {samples.shape}.")
    head = CDR_HEADER + _STAMP_LE.pack(seconds, nanoseconds) + _head_after_stamp(samples.dtype, len(samples), frame_id)
    # One copy of the points: a block of a fast rig is near a megabyte.
    return b"".join((head, np.ascontiguousarray(samples).view(np.uint8).data, b"\x01"))


@lru_cache(maxsize=64)
def _head_after_stamp(dtype: np.dtype[Any], count: int, frame_id: str) -> bytes:
    """All of a message between its stamp and its point data: the same in every block of a run."""
    fields, big = _fields_of(dtype)
    writer = CdrWriter()  # the stamp ends at byte 12, so alignment counts from here as well
    writer.text(frame_id)
    for number in (1, count, len(fields)):
        writer.uint32(number)
    for name, offset, datatype, repeat in fields:
        writer.text(name)
        writer.uint32(offset)
        writer.octet(datatype)
        writer.uint32(repeat)
    writer.octet(big)
    for number in (dtype.itemsize, dtype.itemsize * count, dtype.itemsize * count):
        writer.uint32(number)
    return writer.done()[len(CDR_HEADER) :]


_STAMP_LE, _STAMP_BE = Struct("<iI"), Struct(">iI")


def _known_layout(data: bytes, little: bool) -> _Layout | None:
    """Return the layout when these very bytes were parsed before; a recording repeats them."""
    for end in _ends:
        layout = _layouts.get((little, data[12:end]))
        if layout is not None:
            return layout
    return None


def _remember(data: bytes, little: bool, layout: _Layout) -> None:
    if len(_layouts) >= _MAX_LAYOUTS:
        _layouts.clear()
        _ends.clear()
    if layout.start not in _ends:
        _ends.append(layout.start)
    _layouts[little, data[12 : layout.start]] = layout


class _Cursor:
    """Reads aligned values; RecordingError past the end."""

    def __init__(self, data: bytes, at: int, little: bool) -> None:
        self.data, self.at, self._order = data, at, "little" if little else "big"

    def uint32(self) -> int:
        start = (self.at + 3) & ~3  # the header has 4 bytes: aligned from its end is aligned from its start
        self.at = start + 4
        if self.at > len(self.data):
            raise RecordingError(f"A PointCloud2 of {len(self.data)} bytes is cut short within its fields.")
        return int.from_bytes(self.data[start : self.at], self._order)  # type: ignore[arg-type]

    def uint8(self) -> int:
        self.at += 1
        if self.at > len(self.data):
            raise RecordingError(f"A PointCloud2 of {len(self.data)} bytes is cut short within its fields.")
        return self.data[self.at - 1]

    def text(self) -> str:
        size = self.uint32()
        start, self.at = self.at, self.at + size
        if self.at > len(self.data):
            raise RecordingError(f"A PointCloud2 of {len(self.data)} bytes is cut short within a text.")
        if size == 0:
            return ""
        try:
            text = self.data[start : self.at].decode()
        except UnicodeDecodeError:
            raise RecordingError("A PointCloud2 has a name that is not UTF-8.") from None
        if text[-1] != "\0":
            raise RecordingError("A PointCloud2 has a text that does not end with a zero byte.")
        return text[:-1]


def _parse_layout(data: bytes, little: bool) -> _Layout:
    cursor = _Cursor(data, 12, little)
    frame_id = cursor.text()
    height, width, count = cursor.uint32(), cursor.uint32(), cursor.uint32()
    if count > MAX_FIELDS:
        raise RecordingError(f"A PointCloud2 has {count} fields; at most {MAX_FIELDS} are read.")
    fields = []
    for _ in range(count):
        name, offset = cursor.text(), cursor.uint32()
        fields.append((name, offset, cursor.uint8(), cursor.uint32()))
    big = cursor.uint8()
    point_step, row_step, size = cursor.uint32(), cursor.uint32(), cursor.uint32()
    if big > 1:
        raise RecordingError(f"A PointCloud2 has is_bigendian {big}; it must be 0 or 1.")
    if not 0 < point_step <= MAX_POINT_STEP:
        raise RecordingError(f"A PointCloud2 has point_step {point_step}; it must lie in 1..{MAX_POINT_STEP} bytes.")
    if height * width == 0:
        needed, height, width = 0, 0, 0
    elif row_step < width * point_step and height > 1:
        raise RecordingError(f"A PointCloud2 has row_step {row_step} bytes, less than {width} points of {point_step}.")
    else:
        needed = (height - 1) * row_step + width * point_step
    if size < needed:
        raise RecordingError(f"A PointCloud2 tells {size} bytes of points where {needed} are needed.")
    if size > len(data) - cursor.at:
        raise RecordingError(f"A PointCloud2 tells {size} bytes of points and has {len(data) - cursor.at}.")
    layout = _Layout(frame_id, _dtype(fields, point_step, bool(big)), height, width, row_step, cursor.at, size)
    _remember(data, little, layout)
    return layout


def _dtype(fields: list[tuple[str, int, int, int]], point_step: int, big: bool) -> np.dtype[np.void]:
    """Return the structured type of one point; padding is left unnamed."""
    names: list[str] = []
    formats: list[Any] = []
    for name, offset, datatype, count in fields:
        code = _CODES.get(datatype)
        if code is None:
            raise RecordingError(f"Field {name!r} of a PointCloud2 has datatype {datatype}; 1 to 8 are known.")
        if not name or name in names:
            raise RecordingError(f"A PointCloud2 has the field name {name!r} more than once or empty.")
        if count == 0 or offset + count * int(code[1]) > point_step:
            raise RecordingError(
                f"Field {name!r} of a PointCloud2 has {count} values from byte {offset};"
                f" a point has {point_step} bytes."
            )
        typed = (">" if big else "<") + code
        names.append(name)
        formats.append(typed if count == 1 else (typed, (count,)))
    if not names:
        raise RecordingError("A PointCloud2 has no fields.")
    offsets = [field[1] for field in fields]
    return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": point_step})


def _view(data: bytes, layout: _Layout) -> Samples:
    if layout.height <= 1:
        return np.frombuffer(data, layout.dtype, layout.width, layout.start)
    strides = (layout.row_step, layout.dtype.itemsize)
    rows: Samples = np.ndarray((layout.height, layout.width), layout.dtype, data, layout.start, strides)
    return rows.reshape(-1)  # a view while rows have no padding


def _fields_of(dtype: np.dtype[Any]) -> tuple[list[tuple[str, int, int, int]], bool]:
    """Return (name, offset, datatype, count) of each field, and whether the numbers are big-endian."""
    fields: list[tuple[str, int, int, int]] = []
    orders: set[bool] = set()
    for name in dtype.names or ():
        part, offset = dtype.fields[name][:2]  # type: ignore[index]  # there are names, so there are fields
        base = part.base
        number = _NUMBERS.get(f"{base.kind}{base.itemsize}")
        if number is None or len(part.shape) > 1:
            raise RecordingError(f"Field {name!r} is {part}; a PointCloud2 holds 1 to 8 byte numbers.")
        if base.itemsize > 1:
            orders.add(base.newbyteorder("=") != base if np.little_endian else base.newbyteorder("=") == base)
        fields.append((name, offset, number, part.shape[0] if part.shape else 1))
    if not fields or not 0 < dtype.itemsize <= MAX_POINT_STEP:
        raise RecordingError(
            f"A point has {len(fields)} fields in {dtype.itemsize} bytes; bound {MAX_POINT_STEP} bytes."
        )
    if len(orders) > 1:
        raise RecordingError("The fields of a point must share one byte order.")
    return fields, orders == {True}
