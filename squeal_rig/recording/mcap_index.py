"""Finds its way in one MCAP file: definitions, chunks in file order, metadata records.

A closed file is indexed from its summary, or by scanning where that has no chunk index (unchunked files).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, Header, Metadata, MetadataIndex, Schema, Statistics

from squeal_rig.errors import RecordingError

from .chunks import ChunkMessage, iter_messages, unpack_chunk
from .records import (
    DEFINITIONS,
    ENDING,
    HEAD,
    MAGIC,
    MAX_CHANNELS,
    BrokenRecordError,
    FileBytes,
    iter_records,
    parse_record,
    read_footer,
    read_records,
    summary_fits,
    take_definitions,
)

_RUN_BYTES = 1 << 20  # loose messages are taken together up to this size
_SUMMARY = frozenset({Opcode.SCHEMA, Opcode.CHANNEL, Opcode.STATISTICS, Opcode.CHUNK_INDEX, Opcode.METADATA_INDEX})


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
    library: str = ""
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
        with FileBytes(path) as data:
            index = _index(data)
    except BrokenRecordError as error:
        raise RecordingError(f"{path} is damaged: {error}.") from None
    if len(index.channels) > MAX_CHANNELS:
        raise RecordingError(f"{path} has {len(index.channels)} topics; at most {MAX_CHANNELS} are read.")
    return index


def read_block(data: FileBytes, block: Block, wanted: frozenset[int] | None) -> list[ChunkMessage]:
    """Return the messages of a block in the file's order, only of the wanted channel ids where given.

    Raises RecordingError, naming file and offset, when the block is damaged.
    """
    try:
        return list(iter_messages(_records_of(data, block), wanted))
    except BrokenRecordError as error:
        raise RecordingError(f"{data.path} is damaged at byte {block.offset}: {error}.") from None


def _records_of(data: FileBytes, block: Block) -> bytes:
    found = data[block.offset : block.offset + block.length]
    if len(found) != block.length:
        raise BrokenRecordError("it is cut short")
    return unpack_chunk(found[HEAD.size :]) if block.is_chunk else found


def _index(data: FileBytes) -> FileIndex:
    path = data.path
    index = FileIndex(path, library=_read_header(data).library)
    footer = read_footer(data)
    if footer is None:
        raise RecordingError(
            f"{path} was not closed: the recording ended before its index was written;"
            " its complete chunks can be recovered."
        )
    start, end = footer.summary_start, len(data) - ENDING
    if start > end:
        raise BrokenRecordError("its footer points outside the file")
    if summary_fits(data, footer) is False:
        raise BrokenRecordError("the checksum of its summary does not fit")
    statistics = _take_summary(index, data, start, end) if start else None
    if statistics is None or (not index.blocks and statistics.message_count):
        _scan(index, data, start or end)
    else:
        index.message_counts = dict(statistics.channel_message_counts)
        index.start_time, index.end_time = statistics.message_start_time, statistics.message_end_time
    return index


def _read_header(data: FileBytes) -> Header:
    at = len(MAGIC)
    head = data[: at + HEAD.size]
    if len(head) < at + HEAD.size or head[:at] != MAGIC or head[at] != Opcode.HEADER:
        raise RecordingError(f"{data.path} is not an MCAP file.")
    header = next(read_records(data, {Opcode.HEADER}, at))
    assert isinstance(header, Header)
    return header


def _take_summary(index: FileIndex, data: FileBytes, first: int, last: int) -> Statistics | None:
    """Fill the index from the summary; return its statistics, None where there are none."""
    statistics: Statistics | None = None
    for record in read_records(data, _SUMMARY, first, last):
        if isinstance(record, Schema):
            index.schemas[record.id] = record
        elif isinstance(record, Channel):
            index.channels[record.id] = record
        elif isinstance(record, Statistics):
            statistics = record
        elif isinstance(record, ChunkIndex):
            index.blocks.append(_block(record, len(data)))
        elif isinstance(record, MetadataIndex):
            opcode, start, end = next(iter_records(data, record.offset), (0, 0, 0))
            if opcode != Opcode.METADATA or end != record.offset + record.length:
                raise BrokenRecordError(f"its index names a metadata record at byte {record.offset} that is not there")
            _take_metadata(index, data[start:end])
    index.blocks.sort(key=lambda block: block.offset)
    for block, following in pairwise(index.blocks):
        if following.offset < block.offset + block.length:  # its messages would be read twice
            raise BrokenRecordError(f"its index lists the chunk at byte {following.offset} twice or within another one")
    return statistics


def _take_metadata(index: FileIndex, body: bytes) -> None:
    record = parse_record(Opcode.METADATA, body)
    assert isinstance(record, Metadata)
    index.metadata.append((record.name, record.metadata))


def _block(chunk: ChunkIndex, size: int) -> Block:
    if chunk.chunk_start_offset + chunk.chunk_length > size or chunk.chunk_length < HEAD.size:
        raise BrokenRecordError("its index points outside the file")
    return Block(
        chunk.chunk_start_offset,
        chunk.chunk_length,
        chunk.message_start_time,
        chunk.message_end_time,
        channels=frozenset(chunk.message_index_offsets) or None,
    )


def _scan(index: FileIndex, data: FileBytes, end: int) -> None:
    """Fill the index by reading the data section from front to back."""
    index.blocks, index.metadata, index.message_counts = [], [], {}
    run_start = run_end = 0  # of loose messages one behind the other
    for opcode, offset, after in iter_records(data, len(MAGIC), end):
        if opcode == Opcode.MESSAGE:
            if offset - HEAD.size != run_end or run_end - run_start >= _RUN_BYTES:
                _count(index, data, run_start, run_end, is_chunk=False)
                run_start = offset - HEAD.size
            run_end = after
        elif opcode == Opcode.CHUNK:
            _count(index, data, offset - HEAD.size, after, is_chunk=True)
        elif opcode in DEFINITIONS:
            take_definitions(data[offset - HEAD.size : after], index.schemas, index.channels)
        elif opcode == Opcode.METADATA:
            _take_metadata(index, data[offset:after])
    _count(index, data, run_start, run_end, is_chunk=False)
    index.start_time = min((block.start_time for block in index.blocks), default=0)
    index.end_time = max((block.end_time for block in index.blocks), default=0)


def _count(index: FileIndex, data: FileBytes, start: int, end: int, is_chunk: bool) -> None:
    """Make a block of a piece of the file: count its messages and take its definitions."""
    block = Block(start, end - start, 0, 0, is_chunk)
    try:
        found = _records_of(data, block)
        take_definitions(found, index.schemas, index.channels)
        messages = list(iter_messages(found))
    except BrokenRecordError as error:
        raise BrokenRecordError(f"at byte {start}, {error}") from None
    for message in messages:
        index.message_counts[message.channel_id] = index.message_counts.get(message.channel_id, 0) + 1
    if messages:
        times = [message.log_time for message in messages]
        index.blocks.append(Block(start, end - start, min(times), max(times), is_chunk))
