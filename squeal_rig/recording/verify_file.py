"""Checks one closed file record by record against its checksums, its indexes and its statistics."""

from __future__ import annotations

import io
import zlib
from collections.abc import Iterator
from struct import Struct
from typing import BinaryIO

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, DataEnd, Header, MessageIndex, Schema

from squeal_rig.errors import RecordingError

from .chunks import ChunkMessage, iter_definitions, iter_records, unpack_chunk
from .mcap_file import MAGIC
from .mcap_index import FileIndex, iter_file_records, parse_record

_RECORD = Struct("<BQ")
_BODY = Struct("<HIQQ")
_CHUNK_TIMES = Struct("<QQ")
_PIECE = 1 << 20
_MAX_FAULTS = 50


class FileChecker:
    """Yields the messages of a file while it notes every fault it meets, in sentences."""

    def __init__(self, index: FileIndex) -> None:
        self.index = index
        self.faults: list[str] = []
        self._counts: dict[int, int] = {}
        self._entries: dict[int, set[tuple[int, int]]] = {}  # channel -> (log time, offset) in the last chunk
        self._unindexed: set[int] = set()
        self._chunks = 0
        with open(index.path, "rb") as stream:
            self._size = stream.seek(0, io.SEEK_END)
            self._chunk_indexes = {entry.chunk_start_offset: entry for entry in self._summary(stream)}

    @property
    def numbered(self) -> bool:
        """Whether the writer numbers messages one by one, as ours does."""
        with open(self.index.path, "rb") as stream:
            stream.seek(len(MAGIC))
            _, length = _RECORD.unpack(stream.read(_RECORD.size))
            header: Header = parse_record(self.index.path, Header.read, stream.read(length))
        return header.library.startswith("squeal_rig")

    def messages(self) -> Iterator[ChunkMessage]:
        """Yield the messages in the file's order; `faults` is complete afterwards."""
        path = self.index.path
        with open(path, "rb") as stream:
            crc_end, crc = 0, None
            try:
                for opcode, offset, length in iter_file_records(path, stream, len(MAGIC), self._size - len(MAGIC)):
                    if opcode == Opcode.DATA_END:
                        stream.seek(offset)
                        ending: DataEnd = parse_record(path, DataEnd.read, stream.read(length))
                        crc_end, crc = offset - _RECORD.size, ending.data_section_crc
                        break
                    yield from self._record(stream, opcode, offset, length)
            except RecordingError as error:
                self._fault(str(error))
            self._unindexed_left()
            if crc is None:
                self._fault("the data section has no end")
            elif crc and _crc_of(stream, crc_end) != crc:
                self._fault("the checksum of the data section does not fit")
        self._compare_totals()

    def _record(self, stream: BinaryIO, opcode: int, offset: int, length: int) -> Iterator[ChunkMessage]:
        path = self.index.path
        if opcode == Opcode.CHUNK:
            self._unindexed_left()
            stream.seek(offset)
            yield from self._chunk(stream.read(length), offset - _RECORD.size)
        elif opcode == Opcode.MESSAGE_INDEX:
            stream.seek(offset)
            self._message_index(parse_record(path, MessageIndex.read, stream.read(length)))
        elif opcode == Opcode.MESSAGE:
            stream.seek(offset)
            data = stream.read(length)
            if length < _BODY.size:
                self._fault(f"a message at byte {offset} is cut short")
                return
            message = _message(data, 0, length)
            self._count(message)
            yield message

    def _chunk(self, body: bytes, offset: int) -> Iterator[ChunkMessage]:
        where = f"the chunk at byte {offset}"
        self._chunks += 1
        self._entries = {}
        try:
            raw = unpack_chunk(body)
            self._definitions(raw, where)
            messages = list(self._messages_of(raw))
        except RecordingError as error:
            self._fault(f"{where} is damaged: {error}")
            return
        self._unindexed = set(self._entries)
        times = [message.log_time for message in messages]
        claimed = _CHUNK_TIMES.unpack_from(body)
        if times and claimed != (min(times), max(times)):
            self._fault(f"{where} gives other times than its messages have")
        entry = self._chunk_indexes.pop(offset, None)
        if entry is None:
            if self._chunk_indexes:
                self._fault(f"{where} is not in the index of the file")
        elif (entry.message_start_time, entry.message_end_time) != claimed or entry.chunk_length != len(body) + 9:
            self._fault(f"{where} is described wrongly by the index of the file")
        yield from messages

    def _messages_of(self, raw: bytes) -> Iterator[ChunkMessage]:
        for opcode, start, end in iter_records(raw):
            if opcode == Opcode.MESSAGE:
                if end - start < _BODY.size:
                    raise RecordingError("a message record is cut short")
                message = _message(raw, start, end)
                self._entries.setdefault(message.channel_id, set()).add((message.log_time, start - _RECORD.size))
                self._count(message)
                yield message

    def _definitions(self, raw: bytes, where: str) -> None:
        """Definitions in a chunk must be those of the summary."""
        for record in iter_definitions(raw):
            known: Schema | Channel | None
            if isinstance(record, Schema):
                known = self.index.schemas.get(record.id)
            else:
                known = self.index.channels.get(record.id)
            if known is not None and known != record:
                self._fault(f"{where} defines {type(record).__name__.lower()} {record.id} otherwise than the summary")

    def _message_index(self, index: MessageIndex) -> None:
        found = self._entries.get(index.channel_id)
        self._unindexed.discard(index.channel_id)
        if found is not None and {(int(time), int(at)) for time, at in index.records} != found:
            self._fault(f"the message index of channel {index.channel_id} does not fit its chunk")

    def _unindexed_left(self) -> None:
        if self._unindexed:
            self._fault(f"channels {sorted(self._unindexed)} of a chunk have no message index")
        self._unindexed = set()

    def _count(self, message: ChunkMessage) -> None:
        self._counts[message.channel_id] = self._counts.get(message.channel_id, 0) + 1

    def _compare_totals(self) -> None:
        if self._chunk_indexes:
            self._fault(f"{len(self._chunk_indexes)} chunks of the index are not in the file")
        for channel_id in sorted(self._counts.keys() | self.index.message_counts.keys()):
            found, told = self._counts.get(channel_id, 0), self.index.message_counts.get(channel_id, 0)
            if found != told:
                self._fault(f"the statistics say {told} messages on channel {channel_id}; there are {found}")
            channel = self.index.channels.get(channel_id)
            if found and (channel is None or channel.schema_id not in self.index.schemas):
                self._fault(f"channel {channel_id} has {found} messages and no definition")

    def _summary(self, stream: BinaryIO) -> Iterator[ChunkIndex]:
        """Yield the chunk indexes of the summary."""
        path = self.index.path
        stream.seek(self._size - len(MAGIC) - 20)
        start = int.from_bytes(stream.read(8), "little")
        if start:
            for opcode, offset, length in iter_file_records(path, stream, start, self._size - len(MAGIC)):
                if opcode == Opcode.CHUNK_INDEX:
                    stream.seek(offset)
                    yield ChunkIndex.read(ReadDataStream(io.BytesIO(stream.read(length))))

    def _fault(self, sentence: str) -> None:
        if len(self.faults) < _MAX_FAULTS:
            self.faults.append(sentence)


def _message(data: bytes, start: int, end: int) -> ChunkMessage:
    channel_id, sequence, log_time, publish_time = _BODY.unpack_from(data, start)
    return ChunkMessage(channel_id, sequence, log_time, publish_time, data[start + _BODY.size : end])


def _crc_of(stream: BinaryIO, end: int) -> int:
    stream.seek(0)
    crc, left = 0, end
    while left > 0 and (part := stream.read(min(left, _PIECE))):
        crc = zlib.crc32(part, crc)
        left -= len(part)
    return crc
