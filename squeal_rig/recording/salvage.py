"""Finds what is intact in an MCAP file of any state: not closed, cut short, with flipped bits, with bytes too many.

Records are followed one behind the other as long as each ends where another one begins. Where that breaks, the next
chunk is found by its shape, wherever it is, so a damaged length never hides what comes after it. What counts is a
chunk's own checksum.
"""

from __future__ import annotations

import re
import zlib
from collections.abc import Generator, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, Footer, Header, McapRecord, Metadata, Schema, Statistics

from squeal_rig.errors import RecordingError

from .chunks import ChunkHead, read_chunk_head, unpack_chunk
from .records import (
    CHUNK,
    ENDING,
    HEAD,
    MAGIC,
    BrokenRecordError,
    FileBytes,
    iter_records,
    parse_record,
    read_footer,
    read_records,
    summary_fits,
)

# A chunk record: opcode, length below 4 GiB, times, size, checksum, name of the compression. Or a file within the file.
_SHAPE = re.compile(
    rb"\x06(?=.{4}\x00{4}.{28}(?:\x04\x00{3}zstd|\x03\x00{3}lz4|\x00{4}))|" + re.escape(MAGIC) + rb"\x01", re.DOTALL
)
_SHAPE_BYTES = HEAD.size + CHUNK.size + 8
_DATA_END = HEAD.pack(Opcode.DATA_END, 4)
_LAST_OPCODE = max(Opcode)
_TAKEN = (Opcode.HEADER, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.METADATA)
_SUMMARY = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.STATISTICS, Opcode.CHUNK_INDEX)
_RUN_BYTES = 1 << 20
_MAX_SUMMARY, _MAX_TRIES = 1 << 26, 16
_FIRST_WINDOW, _WINDOW = 1 << 12, 1 << 22  # searched at once, at first and further on


@dataclass(frozen=True)
class Salvaged:
    """Records that can be read: those of a chunk, or a run of messages outside chunks.

    `proved` says whether a checksum vouches for them.
    """

    records: bytes
    proved: bool


@dataclass(frozen=True)
class Damaged:
    """A chunk that is there but not intact."""


@dataclass
class LooseRecords:
    """What stands outside chunks: definitions, metadata, and what the summary says where its checksum fits.

    `files_within` counts other MCAP files inside this one (in an attachment, in a message): they are no part of it.
    `damaged_ends` says whether the file does not begin as one should, or has a summary that lacks its checksum's proof.
    """

    library: str = ""
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    metadata: list[tuple[str, dict[str, str]]] = field(default_factory=list)
    statistics: Statistics | None = None
    closed: bool = False
    files_within: int = 0
    damaged_ends: bool = False


class Salvage:
    """One file being salvaged. Iterate over `pieces` once; `loose` is complete only afterwards, but for the summary.

    Raises RecordingError where the file cannot be read at all.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.loose = LooseRecords()
        self.end_of_intact = 0  # offset behind the last intact piece
        self._indexed: set[tuple[int, ...]] = set()  # the chunks that the summary names
        with FileBytes(path) as data:
            self.size = len(data)
            if not self.size:
                raise RecordingError(f"{path} is empty: there is nothing to recover.")
            self._begun = data[: len(MAGIC)] == MAGIC
            self.loose.damaged_ends = not self._begun
            self._read_summary(data)

    def pieces(self) -> Iterator[Salvaged | Damaged]:
        """Yield every intact piece and every damaged chunk in the file's order."""
        with FileBytes(self.path) as data:
            at = yield from self._follow(data, len(MAGIC), searched=False)
            if not self._begun:
                at = 0
            while (found := self._search(data, at)) is not None:
                at = yield from self._follow(data, found, searched=True)

    def _follow(self, data: FileBytes, start: int, searched: bool) -> Generator[Salvaged | Damaged, None, int]:
        """Yield the pieces of a row of records; returns from where on to search for the next one.

        In a row that was searched for, only chunks of the index count where there is one.
        """
        at, run = start + searched, bytearray()
        try:
            for opcode, body, end in iter_records(data, start):
                if run and (opcode != Opcode.MESSAGE or len(run) >= _RUN_BYTES):
                    yield Salvaged(bytes(run), proved=False)
                    run.clear()
                at = body - HEAD.size + 1  # unless the record is left behind, the search goes on within it
                believed = _record_may_begin(data, end)
                if opcode == Opcode.MESSAGE:
                    run += data[body - HEAD.size : end]
                    self.end_of_intact = end
                elif opcode == Opcode.CHUNK:
                    head = _chunk_head(data, body, end)
                    if head is None or (searched and self._indexed and _signature(head) not in self._indexed):
                        break
                    piece = _chunk(data[body:end])
                    yield piece
                    if isinstance(piece, Salvaged):
                        believed, self._begun, self.end_of_intact = True, True, end
                elif opcode == Opcode.ATTACHMENT:
                    believed = believed or _attachment_fits(data[body:end])
                elif believed and opcode in _TAKEN:
                    self._take(opcode, data[body:end])
                if not believed:
                    break
                at = end
        except BrokenRecordError:
            pass  # what follows is searched
        if run:
            yield Salvaged(bytes(run), proved=False)
        return at

    def _search(self, data: FileBytes, at: int) -> int | None:
        """Return where the next chunk begins; a whole file within this one is passed over."""
        while (found := _next_shape(data, at)) is not None:
            if data[found : found + 1] != MAGIC[:1]:
                return found
            at = found + len(MAGIC)
            if not self._begun:  # the file's own beginning, out of place
                self._begun = True
                return at
            self.loose.files_within += 1
            at = _end_of_row(data, at)
        return None

    def _take(self, opcode: int, body: bytes) -> None:
        """Take one record; of two with the same number the one from a proved summary counts."""
        try:
            self._take_parsed(parse_record(opcode, body))
        except BrokenRecordError:
            return  # such a record is no loss of samples

    def _take_parsed(self, record: McapRecord) -> None:
        loose = self.loose
        if isinstance(record, Header):
            loose.library = loose.library or record.library
        elif isinstance(record, Schema):
            loose.schemas.setdefault(record.id, record)
        elif isinstance(record, Channel):
            loose.channels.setdefault(record.id, record)
        elif isinstance(record, Metadata):
            loose.metadata.append((record.name, record.metadata))

    def _read_summary(self, data: FileBytes) -> None:
        footer = read_footer(data)
        if footer is None:
            return
        self.loose.closed = True
        fits = summary_fits(data, footer)
        start = footer.summary_start if fits else _moved_summary(data, footer) if fits is False else None
        if start is None:
            self.loose.damaged_ends = self.loose.damaged_ends or fits is False
            return
        try:
            for record in read_records(data, _SUMMARY, start, len(data) - ENDING):
                if isinstance(record, Statistics):
                    self.loose.statistics = record
                elif isinstance(record, ChunkIndex):
                    times = (record.message_start_time, record.message_end_time)
                    self._indexed.add((*times, record.uncompressed_size, record.compressed_size))
                else:
                    self._take_parsed(record)
        except BrokenRecordError:
            return  # what came before it counts


def _moved_summary(data: FileBytes, footer: Footer) -> int | None:
    """Return where the summary begins that bytes lost or added before it have moved; None where no checksum fits."""
    low, stop = max(len(data) - _MAX_SUMMARY, 0), len(data) - len(MAGIC)
    tail = data[low:stop]
    place = len(tail)
    for _ in range(_MAX_TRIES):
        place = tail.rfind(_DATA_END, 0, place)
        if place < 0:
            break
        start = low + place + len(_DATA_END) + 4
        if data.checksum(start, stop - 4) == footer.summary_crc:
            return start
    return None


def _record_may_begin(data: FileBytes, at: int) -> bool:
    """Whether the bytes at an offset look like a record, or the file ends there."""
    head = data[at : at + HEAD.size]
    if len(head) < HEAD.size or head.startswith(MAGIC):
        return True
    opcode, length = HEAD.unpack(head)
    return bool(0 < opcode <= _LAST_OPCODE and length < 2**32)


def _chunk_head(data: FileBytes, start: int, end: int) -> ChunkHead | None:
    """Return the head of a chunk record's body; None where its sizes contradict one another: it is no chunk."""
    try:
        head = read_chunk_head(data[start : min(start + _SHAPE_BYTES + 8, end)])
    except BrokenRecordError:
        return None
    fits = head.end == end - start and (head.compression != b"" or head.raw_size == head.end - head.start)
    return head if fits else None


def _signature(head: ChunkHead) -> tuple[int, ...]:
    return head.start_time, head.end_time, head.raw_size, head.end - head.start


def _chunk(body: bytes) -> Salvaged | Damaged:
    try:
        records = unpack_chunk(body)
        for _ in iter_records(records):
            pass  # without a checksum, at least the records must follow one another
    except BrokenRecordError:
        return Damaged()
    return Salvaged(records, proved=read_chunk_head(body).crc != 0)


def _attachment_fits(body: bytes) -> bool:
    return zlib.crc32(body[:-4]) == int.from_bytes(body[-4:], "little")


def _next_shape(data: FileBytes, at: int) -> int | None:
    """Return the offset of what looks like a chunk or like the beginning of a file, from an offset on."""
    window = _FIRST_WINDOW
    while at < len(data):
        match = _SHAPE.search(data[at : at + window + _SHAPE_BYTES])
        if match is not None:
            return at + match.start()
        at += window
        window = min(2 * window, _WINDOW)
    return None


def _end_of_row(data: FileBytes, start: int) -> int:
    """Return where the records from an offset on cannot be followed any more."""
    at = start
    try:
        for _, _, end in iter_records(data, start):
            if not _record_may_begin(data, end):
                break
            at = end
    except BrokenRecordError:
        pass  # up to here they follow one another
    return at
