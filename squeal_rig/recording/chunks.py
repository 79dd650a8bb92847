"""One MCAP chunk: messages packed on the way in, unpacked on the way out. Nothing here touches a file.

Every chunk carries the schema and channel records of the messages in it, so that one damaged chunk never
orphans another. Record layouts: https://mcap.dev/spec, section Records.
"""

from __future__ import annotations

import io
import zlib
from collections.abc import Container, Iterator
from dataclasses import dataclass
from struct import Struct
from typing import NamedTuple

import zstandard
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, McapRecord, Schema

from squeal_rig.errors import RecordingError

COMPRESSIONS = ("zstd", "none")
# Level 1 packs as fast as a disk takes it; higher levels gain little on noisy floats.
_ZSTD_LEVEL = 1
MAX_CHUNK_BYTES = 2**31  # a larger size in a chunk header is damage, not data

_RECORD = Struct("<BQ")  # opcode, length of what follows
_MESSAGE = Struct("<BQHIQQ")  # record head, then channel, sequence, log time, publish time
_MESSAGE_BODY = Struct("<HIQQ")
_CHUNK_HEAD = Struct("<QQQI")  # start time, end time, uncompressed size, CRC of the uncompressed bytes
_INDEX_HEAD = Struct("<BQHI")
_INDEX_ENTRY = Struct("<QQ")


class ChunkMessage(NamedTuple):
    """One message of an unpacked chunk; times in [ns]."""

    channel_id: int
    sequence: int
    log_time: int
    publish_time: int
    data: bytes


def record_bytes(record: McapRecord) -> bytes:
    """Return a record as it stands in a file."""
    builder = RecordBuilder()
    record.write(builder)
    packed: bytes = builder.end()  # type: ignore[no-untyped-call]
    return packed


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
        index = self.index
        return ChunkIndex(
            chunk_length=index.chunk_length,
            chunk_start_offset=offset,
            compression=index.compression,
            compressed_size=index.compressed_size,
            message_end_time=index.message_end_time,
            message_index_length=index.message_index_length,
            message_index_offsets={key: offset + at for key, at in index.message_index_offsets.items()},
            message_start_time=index.message_start_time,
            uncompressed_size=index.uncompressed_size,
        )


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
        head = _MESSAGE.pack(
            Opcode.MESSAGE,
            _MESSAGE_BODY.size + len(message.data),
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
            _CHUNK_HEAD.pack(start, end, len(raw), zlib.crc32(raw))
            + len(name).to_bytes(4, "little")
            + name
            + len(packed).to_bytes(8, "little")
        )
        chunk_length = _RECORD.size + len(body) + len(packed)
        parts = [_RECORD.pack(Opcode.CHUNK, len(body) + len(packed)), body, packed]
        offsets: dict[int, int] = {}
        offset = chunk_length
        for channel_id, entries in self._entries.items():
            offsets[channel_id] = offset
            size = len(entries) * _INDEX_ENTRY.size
            parts.append(_INDEX_HEAD.pack(Opcode.MESSAGE_INDEX, 6 + size, channel_id, size))
            parts += [_INDEX_ENTRY.pack(*entry) for entry in entries]
            offset += _INDEX_HEAD.size + size
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


def unpack_chunk(record_body: bytes) -> bytes:
    """Return the uncompressed records of a chunk record (without its 9-byte head).

    Raises RecordingError when the chunk is damaged: wrong sizes, undecodable data, a CRC that does not fit.
    """
    try:
        _, _, raw_size, crc = _CHUNK_HEAD.unpack_from(record_body, 0)
        at = _CHUNK_HEAD.size
        name_size = int.from_bytes(record_body[at : at + 4], "little")
        name = record_body[at + 4 : at + 4 + name_size]
        at += 4 + name_size
        size = int.from_bytes(record_body[at : at + 8], "little")
        packed = record_body[at + 8 : at + 8 + size]
        if len(packed) != size or raw_size > MAX_CHUNK_BYTES:
            raise RecordingError("the chunk's sizes do not fit")
        raw = _decompress(name, packed, raw_size)
    except (ArithmeticError, ValueError, RuntimeError, MemoryError, zstandard.ZstdError) as error:
        raise RecordingError(f"the chunk cannot be decompressed ({error})") from None
    except Exception as error:  # struct.error is a bare Exception
        if isinstance(error, RecordingError):
            raise
        raise RecordingError("the chunk is cut short") from None
    if len(raw) != raw_size or (crc and zlib.crc32(raw) != crc):
        raise RecordingError("the chunk's checksum does not fit")
    return raw


def _decompress(name: bytes, packed: bytes, raw_size: int) -> bytes:
    if name == b"":
        return packed
    if name == b"zstd":
        return zstandard.ZstdDecompressor().decompress(packed, max_output_size=raw_size)
    if name == b"lz4":
        try:
            import lz4.frame  # only foreign bags use it
        except ImportError:
            raise RecordingError("the chunk is compressed with lz4: install the Python package lz4") from None
        return bytes(lz4.frame.decompress(packed))
    raise RecordingError(f"the chunk is compressed with {name!r}, which is not known")


def iter_records(raw: bytes) -> Iterator[tuple[int, int, int]]:
    """Yield (opcode, body start, body end) of the records in raw; RecordingError when one overruns."""
    at, stop = 0, len(raw)
    while at < stop:
        if at + _RECORD.size > stop:
            raise RecordingError("a record is cut short")
        opcode, size = _RECORD.unpack_from(raw, at)
        at += _RECORD.size
        if size > stop - at:
            raise RecordingError("a record is longer than what holds it")
        yield opcode, at, at + size
        at += size


def iter_messages(raw: bytes, wanted: Container[int] | None = None) -> Iterator[ChunkMessage]:
    """Yield the messages of the uncompressed records, only of the wanted channel ids where given."""
    for opcode, start, end in iter_records(raw):
        if opcode != Opcode.MESSAGE:
            continue
        if end - start < _MESSAGE_BODY.size:
            raise RecordingError("a message record is cut short")
        channel_id, sequence, log_time, publish_time = _MESSAGE_BODY.unpack_from(raw, start)
        if wanted is None or channel_id in wanted:
            data = raw[start + _MESSAGE_BODY.size : end]
            yield ChunkMessage(channel_id, sequence, log_time, publish_time, data)


def iter_definitions(raw: bytes) -> Iterator[Schema | Channel]:
    """Yield the schema and channel records among the uncompressed records."""
    for opcode, start, end in iter_records(raw):
        if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            kind = Schema if opcode == Opcode.SCHEMA else Channel
            try:
                yield kind.read(ReadDataStream(io.BytesIO(raw[start:end])))
            except Exception as error:  # mcap raises its own, struct's and unicode errors here
                raise RecordingError(f"a {kind.__name__.lower()} record cannot be read ({error})") from None
