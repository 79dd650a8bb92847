"""Checks one closed file record by record against its checksums, its indexes and its statistics."""

from __future__ import annotations

import struct
from collections.abc import Iterator

from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, DataEnd, Schema

from .chunks import ChunkMessage, iter_messages, read_chunk_head, unpack_chunk
from .mcap_index import FileIndex
from .records import (
    DEFINITIONS,
    ENDING,
    HEAD,
    INDEX,
    INDEX_ENTRY,
    MAGIC,
    BrokenRecordError,
    FileBytes,
    iter_records,
    parse_record,
    read_footer,
    read_records,
)

_MAX_FAULTS = 50
# What may stand in a summary, beside records of others from 128 on.
_SUMMARY = {
    *DEFINITIONS,
    Opcode.STATISTICS,
    Opcode.CHUNK_INDEX,
    Opcode.ATTACHMENT_INDEX,
    Opcode.METADATA_INDEX,
    Opcode.SUMMARY_OFFSET,
}
_PRIVATE = 0x80
_MAX_RECORD = 1 << 26  # a larger attachment is not taken into memory [bytes]


class FileChecker:
    """Yields the messages of a file while it notes every fault it meets, in sentences."""

    def __init__(self, index: FileIndex) -> None:
        self.index = index
        self.faults: list[str] = []
        self._counts: dict[int, int] = {}
        self._entries: dict[int, set[tuple[int, int]]] = {}  # channel -> (log time, offset) in the last chunk
        self._places: dict[int, int] = {}  # channel -> offset of its message index, of the last chunk
        self._chunk: tuple[str, ChunkIndex | None] | None = None  # the last one in words, and its entry in the index
        self._chunk_indexes: dict[int, ChunkIndex] = {}
        self._indexed = False  # whether readers go by an index of chunks; else they go from front to back
        # Definitions, (opcode, id): those of the summary, and those met in the data so far.
        self._repeated: set[tuple[int, int]] = set()
        self._defined: set[tuple[int, int]] = set()

    def messages(self) -> Iterator[ChunkMessage]:
        """Yield the messages in the file's order; `faults` is complete afterwards."""
        with FileBytes(self.index.path) as data:
            behind = self._read_summary(data)
            end: tuple[int, int] | None = None  # where the data section ends, and its checksum
            try:
                for opcode, start, after in iter_records(data, len(MAGIC), len(data) - len(MAGIC)):
                    if opcode == Opcode.DATA_END:
                        record = parse_record(opcode, data[start:after])
                        assert isinstance(record, DataEnd)
                        end = start - HEAD.size, record.data_section_crc
                        if behind is not None and after != behind:
                            self._fault(f"what lies from byte {after} to {behind} is of no section of the file")
                        break
                    yield from self._record(opcode, start, data, after)
            except BrokenRecordError as error:
                self._fault(str(error))
            self._end_chunk()
            if end is None:
                self._fault("the data section has no end")
            elif end[1] and data.checksum(0, end[0]) != end[1]:
                self._fault("the checksum of the data section does not fit")
        self._compare_totals()

    def _record(self, opcode: int, start: int, data: FileBytes, end: int) -> Iterator[ChunkMessage]:
        if opcode == Opcode.CHUNK:
            self._end_chunk()
            yield from self._take_chunk(data[start:end], start - HEAD.size)
        elif opcode == Opcode.MESSAGE_INDEX:
            self._message_index(data[start:end], start - HEAD.size)
        elif opcode in DEFINITIONS:
            self._define(opcode, data[start : start + 4])
        elif opcode in (Opcode.ATTACHMENT, Opcode.METADATA):
            self._try_reading(opcode, data, start, end)
        elif opcode == Opcode.MESSAGE:
            self._expect_definition(data[start : start + 2])
            for message in iter_messages(data[start - HEAD.size : end]):
                self._count(message)
                yield message
        elif opcode < _PRIVATE and (opcode != Opcode.HEADER or start != len(MAGIC) + HEAD.size):
            self._fault(f"at byte {start - HEAD.size}, a record of opcode {opcode} has no place among the data")

    def _take_chunk(self, body: bytes, offset: int) -> Iterator[ChunkMessage]:
        where = f"the chunk at byte {offset}"
        self._entries, self._places = {}, {}
        try:
            raw = unpack_chunk(body)
            self._compare_definitions(raw, where)
            messages = list(iter_messages(raw))
        except BrokenRecordError as error:
            self._fault(f"{where} is damaged: {error}")
            return
        places = []
        for opcode, start, _ in iter_records(raw):
            if opcode == Opcode.MESSAGE:
                places.append(start - HEAD.size)
                self._expect_definition(raw[start : start + 2])
            elif opcode in DEFINITIONS:
                self._define(opcode, raw[start : start + 4])
        for message, place in zip(messages, places, strict=True):
            self._entries.setdefault(message.channel_id, set()).add((message.log_time, place))
            self._count(message)
        times = [message.log_time for message in messages]
        claimed = read_chunk_head(body)[:2]
        if times and claimed != (min(times), max(times)):
            self._fault(f"{where} gives other times than its messages have")
        entry = self._chunk_indexes.pop(offset, None)
        if entry is None:
            if self._indexed:
                self._fault(f"{where} is not in the index of the file")
        elif (entry.message_start_time, entry.message_end_time) != claimed or entry.chunk_length != len(body) + 9:
            self._fault(f"{where} is described wrongly by the index of the file")
        self._chunk = (where, entry)
        yield from messages

    def _compare_definitions(self, raw: bytes, where: str) -> None:
        """Definitions in a chunk must be those of the summary."""
        for record in read_records(raw, DEFINITIONS):
            assert isinstance(record, Schema | Channel)
            known = self.index.schemas if isinstance(record, Schema) else self.index.channels
            if known.get(record.id, record) != record:
                self._fault(f"{where} defines {type(record).__name__.lower()} {record.id} otherwise than the summary")

    def _try_reading(self, opcode: int, data: FileBytes, start: int, end: int) -> None:
        """A record that nobody here needs, but readers of others do."""
        if end - start > _MAX_RECORD:
            return
        try:
            parse_record(opcode, data[start:end])
        except BrokenRecordError as error:
            self._fault(f"at byte {start - HEAD.size}, {error}")

    def _define(self, opcode: int, numbers: bytes) -> None:
        """Take note of a definition, by its number and that of a channel's schema, which has to come before.

        The summary has to repeat it, where it repeats any.
        """
        key = opcode, int.from_bytes(numbers[:2], "little")
        schema = Opcode.SCHEMA, int.from_bytes(numbers[2:], "little")
        if opcode == Opcode.CHANNEL and schema[1] and schema not in self._defined:
            self._defined.add(schema)
            self._fault(f"channel {key[1]} comes before its schema {schema[1]}")
        if key not in self._defined:
            self._defined.add(key)
            if self._repeated and key not in self._repeated:
                self._fault(f"the summary lacks {Opcode(opcode).name.lower()} {key[1]}: readers do not find it")

    def _expect_definition(self, number: bytes) -> None:
        """A message has to come behind its channel's definition."""
        key = Opcode.CHANNEL, int.from_bytes(number, "little")
        if key not in self._defined:
            self._defined.add(key)
            self._fault(f"a message of channel {key[1]} comes before the channel's definition")

    def _message_index(self, body: bytes, offset: int) -> None:
        try:
            channel_id, size = INDEX.unpack_from(body)
            entries = set(INDEX_ENTRY.iter_unpack(body[INDEX.size : INDEX.size + size]))
        except struct.error:
            raise BrokenRecordError("a message index is cut short") from None
        found = self._entries.get(channel_id)
        self._places[channel_id] = offset
        if found is not None and entries != found:
            self._fault(f"the message index of channel {channel_id} does not fit its chunk")

    def _end_chunk(self) -> None:
        """Compare the message indexes behind a chunk with its messages, and with where the index of the file says."""
        if self._chunk is None:
            return
        (where, entry), self._chunk = self._chunk, None
        missing = sorted(self._entries.keys() - self._places.keys())
        if missing and self._indexed:
            self._fault(f"{where} has no message index of channels {missing}")
        if entry is not None and entry.message_index_offsets != self._places:
            self._fault(f"{where} has its message indexes elsewhere than the index of the file says: readers miss some")

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

    def _read_summary(self, data: FileBytes) -> int | None:
        """Take the summary; returns where the data must end: where it begins, or the footer. None without a footer."""
        footer = read_footer(data)
        if footer is not None and footer.summary_start:
            offsets = footer.summary_offset_start
            if offsets and not footer.summary_start <= offsets <= len(data) - ENDING:
                self._fault("the footer points outside the summary")
            for opcode, first, last in iter_records(data, footer.summary_start, len(data) - ENDING):
                if opcode == Opcode.CHUNK_INDEX:
                    record = parse_record(opcode, data[first:last])
                    assert isinstance(record, ChunkIndex)
                    self._chunk_indexes[record.chunk_start_offset] = record
                    self._indexed = True
                elif opcode in DEFINITIONS:
                    self._repeated.add((opcode, int.from_bytes(data[first : first + 2], "little")))
                elif opcode == Opcode.ATTACHMENT_INDEX:
                    self._try_reading(opcode, data, first, last)
                elif opcode not in _SUMMARY and opcode < _PRIVATE:
                    self._fault(f"the summary holds a record of opcode {opcode}, which has no place there")
        return None if footer is None else footer.summary_start or len(data) - ENDING

    def _fault(self, sentence: str) -> None:
        if len(self.faults) < _MAX_FAULTS:
            self.faults.append(sentence)
