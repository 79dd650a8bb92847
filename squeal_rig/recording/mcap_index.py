"""Finds its way in one MCAP file: definitions, chunks in file order, metadata records.

A closed file is indexed from its summary, or by scanning where that has no chunk index (unchunked files).
"""

from __future__ import annotations

import io
import os
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from struct import Struct
from typing import Any, BinaryIO, TypeVar

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, Footer, Header, Metadata, MetadataIndex, Schema, Statistics

from squeal_rig.errors import RecordingError

from .chunks import MAX_CHUNK_BYTES, ChunkMessage, iter_definitions, iter_messages, unpack_chunk
from .mcap_file import MAGIC

_RECORD = Struct("<BQ")
_FOOTER_RECORD = 9 + 20
_CHUNK_TIMES = Struct("<QQ")
_RUN_BYTES = 1 << 20  # loose messages are taken together up to this size

Record = TypeVar("Record")


@dataclass(frozen=True)
class Block:
    """A piece of a file that is read at once: a chunk, or a run of messages outside chunks.

    Times are the first and last log time [ns]; `channels` are the channel ids in it, None where not known.
    """

    offset: int
    length: int
    start_time: int
    end_time: int
    is_chunk: bool = True
    channels: frozenset[int] | None = None


@dataclass
class FileIndex:
    """What one file holds. `message_counts` is per channel id."""

    path: Path
    profile: str = ""
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    message_counts: dict[int, int] = field(default_factory=dict)
    blocks: list[Block] = field(default_factory=list)
    metadata: list[tuple[str, dict[str, str]]] = field(default_factory=list)
    start_time: int = 0
    end_time: int = 0

    @property
    def message_count(self) -> int:
        """Messages in the file."""
        return sum(self.message_counts.values())


def index_file(path: Path) -> FileIndex:
    """Return the index of a closed file; RecordingError when it is not closed, damaged or no MCAP file."""
    try:
        with open(path, "rb") as stream:
            return _index_stream(path, stream)
    except OSError as error:
        raise RecordingError(f"Cannot read {path}: {error.strerror}.") from None


def read_block(stream: BinaryIO, path: Path, block: Block, wanted: frozenset[int] | None) -> list[ChunkMessage]:
    """Return the messages of a block in the file's order, only of the wanted channel ids where given.

    Raises RecordingError, naming file and offset, when the block is damaged.
    """
    try:
        stream.seek(block.offset)
        data = stream.read(block.length)
        if len(data) != block.length:
            raise RecordingError("it is cut short")
        return list(iter_messages(unpack_chunk(data[_RECORD.size :]) if block.is_chunk else data, wanted))
    except OSError as error:
        raise RecordingError(f"Cannot read {path}: {error.strerror}.") from None
    except RecordingError as error:
        raise RecordingError(f"{path} is damaged at byte {block.offset}: {error}.") from None


def _index_stream(path: Path, stream: BinaryIO) -> FileIndex:
    size = os.fstat(stream.fileno()).st_size
    index = FileIndex(path, profile=_read_header(path, stream))
    ending = _FOOTER_RECORD + len(MAGIC)
    stream.seek(max(size - ending, 0))
    data = stream.read(ending)
    if len(data) != ending or data[-len(MAGIC) :] != MAGIC or data[0] != Opcode.FOOTER:
        raise RecordingError(
            f"{path} was not closed: the recording ended before its index was written;"
            " its complete chunks can be recovered."
        )
    footer = parse_record(path, Footer.read, data[9 : -len(MAGIC)])
    if footer.summary_start > size - ending:
        raise RecordingError(f"{path} is damaged: its footer points outside the file.")
    if footer.summary_start and footer.summary_crc:
        _check_summary(path, stream, footer, size)
    statistics = _read_summary(index, stream, footer, size) if footer.summary_start else None
    if statistics is None or (not index.blocks and statistics.message_count):
        _scan(index, stream, (footer.summary_start or size - ending))
    else:
        index.message_counts = dict(statistics.channel_message_counts)
        index.start_time, index.end_time = statistics.message_start_time, statistics.message_end_time
    return index


def _check_summary(path: Path, stream: BinaryIO, footer: Footer, size: int) -> None:
    """Compare the checksum of the summary, which runs up to the checksum's own place in the footer."""
    left, crc = size - len(MAGIC) - 4 - footer.summary_start, 0
    stream.seek(footer.summary_start)
    while left > 0 and (part := stream.read(min(left, _RUN_BYTES))):
        crc = zlib.crc32(part, crc)
        left -= len(part)
    if crc != footer.summary_crc:
        raise RecordingError(f"{path} is damaged: the checksum of its summary does not fit.")


def _read_header(path: Path, stream: BinaryIO) -> str:
    stream.seek(0)
    head = stream.read(len(MAGIC) + _RECORD.size)
    if len(head) < len(MAGIC) + _RECORD.size or head[: len(MAGIC)] != MAGIC or head[len(MAGIC)] != Opcode.HEADER:
        raise RecordingError(f"{path} is not an MCAP file.")
    size = int.from_bytes(head[-8:], "little")
    header: Header = parse_record(path, Header.read, stream.read(min(size, 1 << 20)))
    return header.profile


def _read_summary(index: FileIndex, stream: BinaryIO, footer: Footer, size: int) -> Statistics | None:
    """Fill the index from the summary; return its statistics, None where there are none."""
    path = index.path
    statistics: Statistics | None = None
    places: list[MetadataIndex] = []
    for opcode, offset, length in iter_file_records(path, stream, footer.summary_start, size - 37):
        if opcode not in (
            Opcode.SCHEMA,
            Opcode.CHANNEL,
            Opcode.STATISTICS,
            Opcode.CHUNK_INDEX,
            Opcode.METADATA_INDEX,
        ):
            continue
        stream.seek(offset)
        body = stream.read(length)
        if opcode == Opcode.SCHEMA:
            schema = parse_record(path, Schema.read, body)
            index.schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = parse_record(path, Channel.read, body)
            index.channels[channel.id] = channel
        elif opcode == Opcode.STATISTICS:
            statistics = parse_record(path, Statistics.read, body)
        elif opcode == Opcode.CHUNK_INDEX:
            index.blocks.append(_block(parse_record(path, ChunkIndex.read, body), size, path))
        else:
            places.append(parse_record(path, MetadataIndex.read, body))
    index.blocks.sort(key=lambda block: block.offset)
    for place in places:
        stream.seek(place.offset + _RECORD.size)
        body = stream.read(min(max(place.length - _RECORD.size, 0), size))
        record = parse_record(path, Metadata.read, body)
        index.metadata.append((record.name, record.metadata))
    return statistics


def _block(chunk: ChunkIndex, size: int, path: Path) -> Block:
    if chunk.chunk_start_offset + chunk.chunk_length > size or chunk.chunk_length < _RECORD.size:
        raise RecordingError(f"{path} is damaged: its index points outside the file.")
    return Block(
        chunk.chunk_start_offset,
        chunk.chunk_length,
        chunk.message_start_time,
        chunk.message_end_time,
        channels=frozenset(chunk.message_index_offsets) or None,
    )


def _scan(index: FileIndex, stream: BinaryIO, end: int) -> None:
    """Fill the index by reading the data section from front to back."""
    path = index.path
    index.blocks, index.metadata, index.message_counts = [], [], {}
    run: _Run | None = None
    for opcode, offset, length in iter_file_records(path, stream, len(MAGIC), end):
        if opcode == Opcode.MESSAGE:
            if run is None or offset - _RECORD.size != run.end or run.end - run.start >= _RUN_BYTES:
                run = _close_run(index, stream, run, offset - _RECORD.size)
            run.end = offset + length
        elif opcode == Opcode.CHUNK:
            stream.seek(offset)
            times = _CHUNK_TIMES.unpack(stream.read(_CHUNK_TIMES.size))
            block = Block(offset - _RECORD.size, length + _RECORD.size, *times)
            _count(index, stream, block)
            index.blocks.append(block)
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            stream.seek(offset - _RECORD.size)
            _define(index, stream.read(length + _RECORD.size))
        elif opcode == Opcode.METADATA:
            stream.seek(offset)
            record = parse_record(path, Metadata.read, stream.read(length))
            index.metadata.append((record.name, record.metadata))
    _close_run(index, stream, run, 0)
    index.start_time = min((block.start_time for block in index.blocks), default=0)
    index.end_time = max((block.end_time for block in index.blocks), default=0)


@dataclass
class _Run:
    start: int
    end: int


def _close_run(index: FileIndex, stream: BinaryIO, run: _Run | None, next_start: int) -> _Run:
    """Turn a finished run of loose messages into a block and start the next run."""
    if run is not None:
        block = Block(run.start, run.end - run.start, 0, 0, is_chunk=False)
        times = _count(index, stream, block)
        index.blocks.append(Block(block.offset, block.length, min(times), max(times), is_chunk=False))
    return _Run(next_start, next_start)


def _count(index: FileIndex, stream: BinaryIO, block: Block) -> list[int]:
    """Count the messages of a block, take its definitions and return its log times [ns]."""
    messages = read_block(stream, index.path, block, None)
    for message in messages:
        index.message_counts[message.channel_id] = index.message_counts.get(message.channel_id, 0) + 1
    if block.is_chunk:
        stream.seek(block.offset + _RECORD.size)
        _define(index, unpack_chunk(stream.read(block.length - _RECORD.size)))
    return [message.log_time for message in messages]


def _define(index: FileIndex, records: bytes) -> None:
    for record in iter_definitions(records):
        if isinstance(record, Schema):
            index.schemas[record.id] = record
        else:
            index.channels[record.id] = record


def iter_file_records(path: Path, stream: BinaryIO, start: int, end: int) -> Iterator[tuple[int, int, int]]:
    """Yield (opcode, body offset, body length) of the records between two offsets of a file.

    Raises RecordingError, naming file and offset, at the first record that overruns `end`.
    """
    at = start
    while at < end:
        stream.seek(at)
        head = stream.read(_RECORD.size)
        opcode, length = _RECORD.unpack(head) if len(head) == _RECORD.size else (0, MAX_CHUNK_BYTES)
        if length > end - at - _RECORD.size:
            raise RecordingError(f"{path} is damaged at byte {at}: a record is longer than the file.")
        yield opcode, at + _RECORD.size, length
        at += _RECORD.size + length


def parse_record(path: Path, read: Callable[[Any], Record], body: bytes) -> Record:
    """Return a record parsed by one of mcap's readers; RecordingError instead of their many exceptions."""
    try:
        return read(ReadDataStream(io.BytesIO(body)))
    except Exception as error:  # mcap raises its own, struct's and unicode errors here
        raise RecordingError(f"{path} is damaged: a record cannot be read ({type(error).__name__}).") from None
