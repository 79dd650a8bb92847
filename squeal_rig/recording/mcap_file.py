"""One MCAP file being written: header, definitions, chunks, summary.

Each chunk reaches the operating system in one write, so a killed process loses only what was still in memory.
A write that fails (disk full) is taken back, so the file can still be closed properly.
"""

from __future__ import annotations

import os
import zlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from squeal_rig.errors import DiskError

from .chunks import PackedChunk
from .records import FOOTER, HEAD, MAGIC, record_bytes

_BEFORE_CRC = HEAD.size + FOOTER.size - 4  # of the footer record


@dataclass
class FileTotals:
    """What one file holds so far; times are log times [ns], 0 while it holds no message."""

    message_count: int = 0
    start_time: int = 0
    end_time: int = 0


class McapFile:
    """Writes one file. Every method raises DiskError where the disk refuses."""

    def __init__(self, path: Path, library: str, reserve_bytes: int) -> None:
        self.path = path
        self.size = 0
        self.totals = FileTotals()
        self._reserve = reserve_bytes
        self._summary_bound = 4096  # bytes that closing still writes, at most
        self._crc = 0
        self._finishing = False
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._counts: dict[int, int] = {}
        self._chunk_index = bytearray()  # as records: a tenth of the memory that objects would take
        self._chunk_count = 0
        self._metadata_indexes: list[MetadataIndex] = []
        try:
            self._stream = open(path, "xb", buffering=0)
        except OSError as error:
            raise DiskError(f"Cannot create {path}: {error.strerror}.") from None
        try:
            self._append(MAGIC + record_bytes(Header(profile="ros2", library=library)))
        except DiskError:
            self.discard()
            raise

    def discard(self) -> None:
        """Give up a file that holds nothing yet."""
        self._stream.close()
        self.path.unlink(missing_ok=True)

    def define(self, schema: Schema, channel: Channel) -> None:
        """Write the definitions of one topic, so that it is known even without messages."""
        records: list[McapRecord] = [] if schema.id in self._schemas else [schema]
        data = b"".join(map(record_bytes, [*records, channel]))
        self._append(data)
        self._summary_bound += len(data) + 10
        self._schemas[schema.id] = schema
        self._channels[channel.id] = channel

    def append_metadata(self, name: str, values: Mapping[str, str], *, closing: bool = False) -> None:
        """Write one metadata record. A closing one may use the reserved space."""
        data = record_bytes(Metadata(name=name, metadata=dict(values)))
        offset = self.size
        self._append(data, closing=closing)
        index = MetadataIndex(offset=offset, length=len(data), name=name)
        self._metadata_indexes.append(index)
        self._summary_bound += len(record_bytes(index))

    def append_chunk(self, chunk: PackedChunk, *, closing: bool = False) -> None:
        """Write one chunk with its message indexes; nothing stays of it when the disk refuses.

        A closing chunk may use the reserved space, but not what the summary needs.
        """
        index = chunk.placed_at(self.size)
        self._append(chunk.data, closing=closing)
        record = record_bytes(index)
        self._chunk_index += record
        self._chunk_count += 1
        self._summary_bound += len(record)
        totals = self.totals
        first = totals.message_count == 0
        totals.start_time = index.message_start_time if first else min(totals.start_time, index.message_start_time)
        totals.end_time = max(totals.end_time, index.message_end_time)
        for channel_id, count in chunk.message_counts.items():
            self._counts[channel_id] = self._counts.get(channel_id, 0) + count
            totals.message_count += count

    def count(self, channel_id: int) -> int:
        """Return the messages of a channel in this file."""
        return self._counts.get(channel_id, 0)

    def finish(self) -> None:
        """Write the summary and the footer and close the file."""
        self._finishing = True
        try:
            self._append(record_bytes(DataEnd(self._crc)))
            start = self.size
            groups: list[tuple[Opcode, bytes | bytearray]] = [
                (Opcode.SCHEMA, _joined(self._schemas.values())),
                (Opcode.CHANNEL, _joined(self._channels.values())),
                (Opcode.STATISTICS, record_bytes(self._statistics())),
                (Opcode.CHUNK_INDEX, self._chunk_index),
                (Opcode.METADATA_INDEX, _joined(self._metadata_indexes)),
            ]
            summary, offsets = b"", b""
            for opcode, group in groups:
                if group:
                    offsets += record_bytes(SummaryOffset(opcode, start + len(summary), len(group)))
                summary += group
            offset_start = start + len(summary)
            footer = record_bytes(Footer(summary_start=start, summary_offset_start=offset_start, summary_crc=0))
            # The CRC covers the summary and the footer up to the CRC field itself.
            crc = zlib.crc32(summary + offsets + footer[:_BEFORE_CRC])
            ending = footer[:_BEFORE_CRC] + crc.to_bytes(4, "little") + MAGIC
            self._append(summary + offsets + ending)
            os.fsync(self._stream.fileno())
        except OSError as error:
            raise DiskError(f"Cannot close {self.path}: {error.strerror}.") from None
        finally:
            self._stream.close()
            # A bag of many files keeps the totals of each, never the indexes: memory does not grow with its length.
            self._chunk_index, self._metadata_indexes = bytearray(), []

    def _statistics(self) -> Statistics:
        return Statistics(
            attachment_count=0,
            channel_count=len(self._channels),
            channel_message_counts={key: self._counts.get(key, 0) for key in self._channels},
            chunk_count=self._chunk_count,
            message_count=self.totals.message_count,
            message_end_time=self.totals.end_time,
            message_start_time=self.totals.start_time,
            metadata_count=len(self._metadata_indexes),
            schema_count=len(self._schemas),
        )

    def _append(self, data: bytes, *, closing: bool = False) -> None:
        """Write all of `data`, or leave the file as it was.

        Enough of the disk stays free for the summary and, unless closing, for the reserve on top of it.
        """
        try:
            kept = 0 if self._finishing else self._summary_bound + (0 if closing else self._reserve)
            disk = os.fstatvfs(self._stream.fileno())
            free = disk.f_bavail * disk.f_frsize
            if free < len(data) + kept:
                raise DiskError(
                    f"The disk of {self.path.parent} is full: {free} bytes are free,"
                    f" {len(data)} are to be written and {kept} kept to close the bag."
                )
            view = memoryview(data)
            while view:
                view = view[self._stream.write(view) :]
        except OSError as error:
            self._take_back()
            raise DiskError(f"Cannot write to {self.path}: {error.strerror}.") from None
        except BaseException:  # an interrupt between two writes must not leave half a record
            self._take_back()
            raise
        self.size += len(data)
        self._crc = zlib.crc32(data, self._crc)

    def _take_back(self) -> None:
        try:
            self._stream.truncate(self.size)
            self._stream.seek(self.size)
        except OSError:
            pass  # the error that led here is the one to tell


def _joined(records: Iterable[McapRecord]) -> bytes:
    return b"".join(map(record_bytes, records))
