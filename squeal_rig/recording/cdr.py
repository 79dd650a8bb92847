"""Serialises the few messages that are written without ROS.

CDR, little-endian (OMG DDSI-RTPS 2.3, section 10): numbers are aligned to their size from the end of the header.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from struct import pack

from squeal_rig.errors import RecordingError

CDR_HEADER = b"\x00\x01\x00\x00"  # little-endian


class CdrWriter:
    """Bytes of one message, field by field."""

    def __init__(self) -> None:
        self._out = bytearray()

    def octet(self, value: int) -> None:
        """An uint8 or a byte."""
        self._out.append(value)

    def uint32(self, value: int) -> None:
        """An uint32, or a sequence's length."""
        self._align(4)
        self._out += pack("<I", value)

    def int32(self, value: int) -> None:
        """An int32."""
        self._align(4)
        self._out += pack("<i", value)

    def doubles(self, values: Sequence[float]) -> None:
        """Float64 values, without a length."""
        if values:
            self._align(8)
            self._out += pack(f"<{len(values)}d", *values)

    def text(self, value: str) -> None:
        """A string."""
        data = value.encode() + b"\0"
        self.uint32(len(data))
        self._out += data

    def done(self) -> bytes:
        """The whole message."""
        return CDR_HEADER + bytes(self._out)

    def _align(self, size: int) -> None:
        self._out += bytes(-len(self._out) % size)


def seconds_of(stamp_ns: int) -> tuple[int, int]:
    """A stamp [ns] as seconds and nanoseconds; RecordingError where a message cannot hold it."""
    seconds, nanoseconds = divmod(int(stamp_ns), 10**9)
    if not -(2**31) <= seconds < 2**31:
        raise RecordingError(f"The stamp is {stamp_ns} ns; it must fit 32-bit seconds.")
    return seconds, nanoseconds


def float64_message(value: float) -> bytes:
    """A std_msgs/Float64."""
    writer = CdrWriter()
    writer.doubles([value])
    return writer.done()


def multi_array_message(rows: Sequence[Sequence[float]], row_label: str, column_label: str) -> bytes:
    """A std_msgs/Float64MultiArray of a table with labelled dimensions."""
    height, width = len(rows), len(rows[0])
    writer = CdrWriter()
    writer.uint32(2)
    for label, size, stride in ((row_label, height, height * width), (column_label, width, width)):
        writer.text(label)
        writer.uint32(size)
        writer.uint32(stride)
    writer.uint32(0)
    writer.uint32(height * width)
    writer.doubles([float(value) for row in rows for value in row])
    return writer.done()


def diagnostics_message(
    stamp_ns: int, frame_id: str, statuses: Sequence[tuple[int, str, str, Mapping[str, str]]]
) -> bytes:
    """A diagnostic_msgs/DiagnosticArray; a status is (level, name, message, values), its hardware_id empty."""
    writer = CdrWriter()
    seconds, nanoseconds = seconds_of(stamp_ns)
    writer.int32(seconds)
    writer.uint32(nanoseconds)
    writer.text(frame_id)
    writer.uint32(len(statuses))
    for level, name, message, values in statuses:
        writer.octet(level)
        for text in (name, message, ""):
            writer.text(text)
        writer.uint32(len(values))
        for key, value in values.items():
            writer.text(key)
            writer.text(value)
    return writer.done()


def text_of(value: object) -> str:
    """A value as a diagnostic text; floats are written so that they read back bit for bit, nan as `none`."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return "none" if math.isnan(value) else repr(float(value))
    return str(value)
