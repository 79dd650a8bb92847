"""One MCAP chunk: messages packed on the way in, unpacked on the way out. Nothing here touches a file.

Every chunk carries the schema and channel records of the messages in it, so that one damaged chunk never
orphans another.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Container, Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import zstandard
from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, Schema

from squeal_rig.errors import RecordingError

from .records import (
    CHUNK,
    HEAD,
    INDEX,
    INDEX_ENTRY,
    MAX_CHUNK_BYTES,
    MAX_CHUNK_MESSAGES,
    MESSAGE,
    MESSAGE_RECORD,
    BrokenRecordError,
    iter_records,
    record_bytes,
)

COMPRESSIONS = ("zstd", "none")
# Level 1 packs as fast as a disk takes it; higher levels gain little on noisy floats.
_ZSTD_LEVEL = 1
_LENGTH, _SIZE = struct.Struct("<I"), struct.Struct("<Q")


class ChunkMessage(NamedTuple):
    """One message of an unpacked chunk; times in [ns]."""

    channel_id: int
    sequence: int
    log_time: int
    publish_time: int
    data: bytes


@dataclass(frozen=True)
class PackedChunk:
    """A finished chunk: the chunk record with its message indexes, and its entry for the summary.

    The offsets in `index` count from the start of `data`; `placed_at` moves them to a place in a file.
    """

    data: bytes
    index: ChunkIndex
    message_counts: dict[int, int]

    def placed_at(self, offset: int) -> ChunkIndex:
        """Return the summary entry for a chunk that starts at this offset of the file."""
        places = {key: offset + at for key, at in self.index.message_index_offsets.items()}
        return replace(self.index, chunk_start_offset=offset, message_index_offsets=places)


class ChunkBuilder:
    """Collects messages until `pack` makes a chunk of them; `clear` starts the next one."""

    def __init__(self, compression: str = "zstd") -> None:
        if compression not in COMPRESSIONS:
            raise RecordingError(f"Compression is {compression!r}; it must be one of {', '.join(COMPRESSIONS)}.")
        self._compressor = zstandard.ZstdCompressor(level=_ZSTD_LEVEL) if compression == "zstd" else None
        self.clear()

    def clear(self) -> None:
        """Forget all messages."""
        self.size = 0
        self.message_count = 0
        self._parts: list[bytes] = []
        self._written_schemas: set[int] = set()
        self._entries: dict[int, list[tuple[int, int]]] = {}

    def add(self, schema: Schema, channel: Channel, message: ChunkMessage) -> None:
        """Add one message, before it the records that it needs and the chunk does not have yet."""
        entries = self._entries.get(channel.id)
        if entries is None:
            entries = self._entries[channel.id] = []
            if schema.id not in self._written_schemas:
                self._written_schemas.add(schema.id)
                self._append(record_bytes(schema))
            self._append(record_bytes(channel))
        entries.append((message.log_time, self.size))
        head = MESSAGE_RECORD.pack(
            Opcode.MESSAGE,
            MESSAGE.size + len(message.data),
            channel.id,
            message.sequence,
            message.log_time,
            message.publish_time,
        )
        self._append(head)
        self._append(message.data)
        self.message_count += 1

    def pack(self) -> PackedChunk:
        """Return the chunk of all messages since the last `clear`. At least one message is needed."""
        raw = b"".join(self._parts)
        packed = raw if self._compressor is None else self._compressor.compress(raw)
        name = b"" if self._compressor is None else b"zstd"
        times = [entry[0] for entries in self._entries.values() for entry in entries]
        start, end = min(times), max(times)
        body = (
            CHUNK.pack(start, end, len(raw), zlib.crc32(raw))
            + len(name).to_bytes(4, "little")
            + name
            + len(packed).to_bytes(8, "little")
        )
        chunk_length = HEAD.size + len(body) + len(packed)
        parts = [HEAD.pack(Opcode.CHUNK, len(body) + len(packed)), body, packed]
        offsets: dict[int, int] = {}
        offset = chunk_length
        for channel_id, entries in self._entries.items():
            offsets[channel_id] = offset
            size = len(entries) * INDEX_ENTRY.size
            parts.append(HEAD.pack(Opcode.MESSAGE_INDEX, INDEX.size + size) + INDEX.pack(channel_id, size))
            parts += [INDEX_ENTRY.pack(*entry) for entry in entries]
            offset += HEAD.size + INDEX.size + size
        index = ChunkIndex(
            chunk_length=chunk_length,
            chunk_start_offset=0,
            compression=name.decode(),
            compressed_size=len(packed),
            message_end_time=end,
            message_index_length=offset - chunk_length,
            message_index_offsets=offsets,
            message_start_time=start,
            uncompressed_size=len(raw),
        )
        return PackedChunk(b"".join(parts), index, {key: len(entries) for key, entries in self._entries.items()})

    def _append(self, part: bytes) -> None:
        self._parts.append(part)
        self.size += len(part)


class ChunkHead(NamedTuple):
    """What a chunk record says before its data, which lies from byte `start` to `end` of the record's body.

    Times in [ns], size and CRC of the uncompressed bytes; CRC 0 is none.
    """

    start_time: int
    end_time: int
    raw_size: int
    crc: int
    compression: bytes
    start: int
    end: int


def read_chunk_head(body: bytes) -> ChunkHead:
    """Return the head of a chunk from the record's body, of which the first bytes are enough."""
    name = CHUNK.size + 4
    try:
        start_time, end_time, raw_size, crc = CHUNK.unpack_from(body)
        start = name + _LENGTH.unpack_from(body, CHUNK.size)[0] + 8
        size = _SIZE.unpack_from(body, start - 8)[0]
    except struct.error:
        raise BrokenRecordError("the chunk is cut short") from None
    return ChunkHead(start_time, end_time, raw_size, crc, body[name : start - 8], start, start + size)


def unpack_chunk(body: bytes) -> bytes:
    """Return the uncompressed records of a chunk record (without its 9-byte head).

    Raises BrokenRecordError when the chunk is damaged: wrong sizes, undecodable data, a CRC that does not fit.
    """
    head = read_chunk_head(body)
    if head.end > len(body):
        raise BrokenRecordError("the chunk's sizes do not fit")
    if head.raw_size > MAX_CHUNK_BYTES:
        raise BrokenRecordError(f"the chunk has {head.raw_size} bytes uncompressed; at most {MAX_CHUNK_BYTES} are read")
    try:
        raw = _decompress(head.compression, body[head.start : head.end], head.raw_size)
    except (ArithmeticError, ValueError, RuntimeError, MemoryError, zstandard.ZstdError) as error:
        raise BrokenRecordError(f"the chunk cannot be decompressed ({error})") from None
    if len(raw) != head.raw_size or (head.crc and zlib.crc32(raw) != head.crc):
        raise BrokenRecordError("the chunk's checksum does not fit")
    return raw


def _decompress(name: bytes, packed: bytes, raw_size: int) -> bytes:
    """Return what is packed, of which no more is made than a byte above the size that the chunk claims."""
    if name == b"":
        return packed
    if name == b"zstd":
        told = zstandard.get_frame_parameters(packed).content_size
        if told not in (raw_size, zstandard.CONTENTSIZE_UNKNOWN):  # a frame that tells its size is allotted it unasked
            raise BrokenRecordError(f"the chunk's data tell {told} bytes where its head tells {raw_size}")
        return zstandard.ZstdDecompressor().decompress(packed, max_output_size=raw_size)
    if name == b"lz4":
        try:
            import lz4.frame  # only foreign bags use it
        except ImportError:
            raise BrokenRecordError("the chunk is compressed with lz4: install the Python package lz4") from None
        return bytes(lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=raw_size + 1))
    raise BrokenRecordError(f"the chunk is compressed with {name!r}, which is not known")


def iter_messages(raw: bytes, wanted: Container[int] | None = None) -> Iterator[ChunkMessage]:
    """Yield the messages of the uncompressed records, only of the wanted channel ids where given."""
    left = MAX_CHUNK_MESSAGES
    for opcode, start, end in iter_records(raw):
        if opcode == Opcode.MESSAGE:
            if end - start < MESSAGE.size:
                raise BrokenRecordError("a message record is cut short")
            left -= 1
            if left < 0:
                raise BrokenRecordError(f"the chunk has more than {MAX_CHUNK_MESSAGES} messages")
            channel_id, sequence, log_time, publish_time = MESSAGE.unpack_from(raw, start)
            if wanted is None or channel_id in wanted:
                yield ChunkMessage(channel_id, sequence, log_time, publish_time, raw[start + MESSAGE.size : end])
