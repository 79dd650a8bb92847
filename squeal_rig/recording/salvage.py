"""Finds what is intact in an MCAP file of any state: not closed, cut short, with flipped bits.

Nothing but a chunk's own bytes is believed: chunks are found by their shape anywhere in the file and proved by their
checksum, so a damaged length never hides what comes after it.
"""

from __future__ import annotations

import io
import mmap
import os
import re
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from struct import Struct

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Footer, Header, Metadata, Schema, Statistics

from squeal_rig.errors import RecordingError

from .chunks import MAX_CHUNK_BYTES, iter_records, unpack_chunk
from .mcap_file import MAGIC

_RECORD = Struct("<BQ")
_CHUNK_HEAD = Struct("<QQQI")
# A chunk record: opcode, length below 4 GiB, times, size, checksum, name of the compression.
_CHUNK = re.compile(rb"\x06(?=.{4}\x00{4}.{28}(?:\x04\x00{3}zstd|\x03\x00{3}lz4|\x00{4}))", re.DOTALL)
_LOOSE = frozenset(
    {Opcode.HEADER, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.MESSAGE_INDEX, Opcode.METADATA}
    | {Opcode.ATTACHMENT}
)
_ENDING = 9 + 20 + len(MAGIC)
_RUN_BYTES = 1 << 20
_FREED_AT_ONCE = 1 << 25


@dataclass(frozen=True)
class Salvaged:
    """Records that can be read: those of a chunk, or a run of messages outside chunks.

    `proved` says whether a checksum vouches for them.
    """

    offset: int
    records: bytes
    proved: bool


@dataclass(frozen=True)
class Damaged:
    """A chunk that is there but not intact; its own claims about its times [ns], which nothing vouches for."""

    offset: int
    length: int
    start_time: int
    end_time: int


@dataclass
class LooseRecords:
    """What stands outside chunks: definitions, metadata, and what the summary says where its checksum fits."""

    library: str = ""
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    metadata: list[tuple[str, dict[str, str]]] = field(default_factory=list)
    statistics: Statistics | None = None
    closed: bool = False


class Salvage:
    """One file being salvaged. Iterate over `pieces` once; `loose` is complete only afterwards, but for the summary.

    Raises RecordingError where the file cannot be read at all.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.loose = LooseRecords()
        self.size = 0
        self.end_of_intact = 0  # offset behind the last intact piece
        with self._mapped() as data:
            self.size = len(data)
            self._read_summary(data)

    def pieces(self) -> Iterator[Salvaged | Damaged]:
        """Yield every intact piece and every damaged chunk in the file's order."""
        with self._mapped() as data:
            at = freed = len(MAGIC)
            yield from self._loose(data, at)
            while (match := _CHUNK.search(data, at)) is not None:
                offset = match.start()
                end = _end_of_chunk(data, offset)
                if end is None:
                    at = offset + 1
                    continue
                piece = _proved(data, offset, end)
                yield piece
                if isinstance(piece, Salvaged):
                    at = self.end_of_intact = end
                else:
                    at = offset + 1  # its length may be what is damaged
                yield from self._loose(data, end)
                if at - freed >= _FREED_AT_ONCE:  # what was read need not stay in memory
                    data.madvise(mmap.MADV_DONTNEED, 0, at // mmap.PAGESIZE * mmap.PAGESIZE)
                    freed = at

    def _mapped(self) -> mmap.mmap:
        try:
            with open(self.path, "rb") as stream:
                if os.fstat(stream.fileno()).st_size == 0:
                    raise RecordingError(f"{self.path} is empty: there is nothing to recover.")
                return mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)
        except (OSError, ValueError) as error:
            raise RecordingError(f"Cannot read {self.path}: {getattr(error, 'strerror', error)}.") from None

    def _loose(self, data: mmap.mmap, start: int) -> Iterator[Salvaged]:
        """Take the records outside chunks from an offset on, as far as they can be followed."""
        at, run = start, bytearray()
        while at + _RECORD.size <= len(data):
            opcode, length = _RECORD.unpack_from(data, at)
            if opcode not in _LOOSE or length > len(data) - at - _RECORD.size:
                break
            end = at + _RECORD.size + length
            if opcode == Opcode.MESSAGE:
                run += data[at:end]
                if len(run) >= _RUN_BYTES:
                    yield Salvaged(at, bytes(run), proved=False)
                    run.clear()
                self.end_of_intact = end
            elif opcode not in (Opcode.MESSAGE_INDEX, Opcode.ATTACHMENT):
                self._take(opcode, data[at + _RECORD.size : end])
            at = end
        if run:
            yield Salvaged(at, bytes(run), proved=False)

    def _take(self, opcode: int, body: bytes, proved: bool = False) -> None:
        """Take one record; of two with the same number the one from a proved summary counts."""
        loose, stream = self.loose, ReadDataStream(io.BytesIO(body))
        try:
            if opcode == Opcode.HEADER:
                loose.library = loose.library or Header.read(stream).library
            elif opcode == Opcode.SCHEMA:
                schema = Schema.read(stream)
                loose.schemas = {schema.id: schema} | loose.schemas
            elif opcode == Opcode.CHANNEL:
                channel = Channel.read(stream)
                loose.channels = {channel.id: channel} | loose.channels
            elif opcode == Opcode.METADATA:
                record = Metadata.read(stream)
                loose.metadata.append((record.name, record.metadata))
            elif opcode == Opcode.STATISTICS and proved:
                loose.statistics = Statistics.read(stream)
        except Exception:  # mcap raises many kinds on damaged bytes; such a record is no loss of samples
            return

    def _read_summary(self, data: mmap.mmap) -> None:
        ending = data[-_ENDING:]
        if len(ending) != _ENDING or ending[-len(MAGIC) :] != MAGIC or ending[0] != Opcode.FOOTER:
            return
        self.loose.closed = True
        footer = Footer.read(ReadDataStream(io.BytesIO(ending[9:29])))
        start, stop = footer.summary_start, len(data) - _ENDING
        if not 0 < start <= stop or not footer.summary_crc:
            return
        crc = 0
        for at in range(start, len(data) - len(MAGIC) - 4, _RUN_BYTES):
            crc = zlib.crc32(data[at : min(at + _RUN_BYTES, len(data) - len(MAGIC) - 4)], crc)
        if crc != footer.summary_crc:
            return
        summary = data[start:stop]
        for opcode, first, end in iter_records(summary):
            self._take(opcode, summary[first:end], proved=True)


def _end_of_chunk(data: mmap.mmap, offset: int) -> int | None:
    """Return where the chunk record at an offset ends; None where its sizes contradict one another or the file."""
    _, length = _RECORD.unpack_from(data, offset)
    body = offset + _RECORD.size
    end = body + length
    name = body + _CHUNK_HEAD.size + 4
    if end > len(data) or name + 8 > len(data):
        return None
    _, _, raw_size, _ = _CHUNK_HEAD.unpack_from(data, body)
    name_size = int.from_bytes(data[name - 4 : name], "little")
    packed = int.from_bytes(data[name + name_size : name + name_size + 8], "little")
    fits = name + name_size + 8 + packed == end and raw_size <= MAX_CHUNK_BYTES
    return end if fits and (name_size or packed == raw_size) else None


def _proved(data: mmap.mmap, offset: int, end: int) -> Salvaged | Damaged:
    body = data[offset + _RECORD.size : end]
    start_time, end_time, _, crc = _CHUNK_HEAD.unpack_from(body, 0)
    try:
        records = unpack_chunk(body)
        for _ in iter_records(records):  # without a checksum, at least the records must follow one another
            pass
    except RecordingError:
        return Damaged(offset, end - offset, start_time, end_time)
    return Salvaged(offset, records, proved=crc != 0)
