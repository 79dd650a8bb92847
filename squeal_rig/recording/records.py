"""MCAP records, one behind the other in a file or in the bytes of a chunk: the one place that walks and reads them.

Record layouts: https://mcap.dev/spec, section Records.
"""

from __future__ import annotations

import io
import zlib
from collections.abc import Callable, Container, Iterator
from pathlib import Path
from struct import Struct

from mcap import records
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import Channel, Footer, McapRecord, Schema

from squeal_rig.configuration.files import only_regular, reason_of
from squeal_rig.errors import RecordingError

MAGIC = b"\x89MCAP0\r\n"
# Bounds on what is read at once: far above what recorders write, far below what ends a process.
MAX_CHUNK_BYTES = 1 << 28  # uncompressed
MAX_CHUNK_MESSAGES = 1 << 20
MAX_CHANNELS = 4096
_MAX_READ = MAX_CHUNK_BYTES + (1 << 20)

HEAD = Struct("<BQ")  # of every record: opcode, length of what follows
MESSAGE = Struct("<HIQQ")  # channel, sequence, log time, publish time; then the payload
MESSAGE_RECORD = Struct(HEAD.format + MESSAGE.format[1:])
CHUNK = Struct("<QQQI")  # start time, end time, uncompressed size, CRC of the uncompressed bytes
INDEX = Struct("<HI")  # of messages: channel, bytes of the entries
INDEX_ENTRY = Struct("<QQ")  # log time, offset in the uncompressed chunk
FOOTER = Struct("<QQI")  # start of the summary, start of the summary offsets, CRC of the summary
ENDING = HEAD.size + FOOTER.size + len(MAGIC)
DEFINITIONS = (Opcode.SCHEMA, Opcode.CHANNEL)
_PIECE = 1 << 20

_READERS: dict[int, Callable[[ReadDataStream], McapRecord]] = {
    Opcode.HEADER: records.Header.read,
    Opcode.FOOTER: records.Footer.read,
    Opcode.SCHEMA: records.Schema.read,
    Opcode.CHANNEL: records.Channel.read,
    Opcode.CHUNK_INDEX: records.ChunkIndex.read,
    Opcode.STATISTICS: records.Statistics.read,
    Opcode.METADATA: records.Metadata.read,
    Opcode.METADATA_INDEX: records.MetadataIndex.read,
    Opcode.ATTACHMENT: records.Attachment.read,
    Opcode.ATTACHMENT_INDEX: records.AttachmentIndex.read,
    Opcode.DATA_END: records.DataEnd.read,
}


class _WholeReads(ReadDataStream):
    """Refuses a text or a list that is longer than its record, which mcap cuts short without a word."""

    def read(self, length: int) -> bytes:
        data = super().read(length)
        if len(data) != length:
            raise EndOfFile
        return data


class BrokenRecordError(RecordingError):
    """Bytes are no MCAP record; the message says what is wrong, the caller adds in which file."""


class FileBytes:
    """A file as bytes: `data[start:end]` reads from the disk, and less where the file ends before."""

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self._stream = open(path, "rb", opener=only_regular)
            self._size = self._stream.seek(0, io.SEEK_END)
        except (OSError, ValueError) as error:
            raise self._refused(error) from None

    def __len__(self) -> int:
        return self._size

    def __getitem__(self, place: slice) -> bytes:
        start, end, _ = place.indices(self._size)
        if end - start > _MAX_READ:
            raise BrokenRecordError(
                f"{end - start} bytes from byte {start} on are one record; at most {_MAX_READ} are read"
            )
        try:
            self._stream.seek(start)
            return self._stream.read(max(end - start, 0))
        except OSError as error:
            raise self._refused(error) from None

    def __enter__(self) -> FileBytes:
        return self

    def __exit__(self, *_: object) -> None:
        self._stream.close()

    def checksum(self, start: int, end: int) -> int:
        """Return the CRC32 of a piece of the file."""
        crc = 0
        for at in range(start, end, _PIECE):
            crc = zlib.crc32(self[at : min(at + _PIECE, end)], crc)
        return crc

    def _refused(self, error: OSError | ValueError) -> RecordingError:
        return RecordingError(f"Cannot read {self.path}: {reason_of(error)}.")


Bytes = bytes | FileBytes


def iter_records(data: Bytes, start: int = 0, end: int | None = None) -> Iterator[tuple[int, int, int]]:
    """Yield (opcode, body start, body end) of the records between two offsets.

    Raises BrokenRecordError at the first one that overruns the end.
    """
    at, stop = start, len(data) if end is None else min(end, len(data))
    in_memory = data if isinstance(data, bytes) else None  # where slices need not be made
    while at < stop:
        body = at + HEAD.size
        if body > stop:
            raise BrokenRecordError(f"the record at byte {at} is cut short")
        opcode, size = HEAD.unpack(data[at:body]) if in_memory is None else HEAD.unpack_from(in_memory, at)
        if size > stop - body:
            raise BrokenRecordError(f"the record at byte {at} is longer than what holds it")
        at = body + size
        yield opcode, body, at


def read_records(data: Bytes, wanted: Container[int], start: int = 0, end: int | None = None) -> Iterator[McapRecord]:
    """Yield the records of the wanted opcodes as `mcap` reads them."""
    for opcode, first, last in iter_records(data, start, end):
        if opcode in wanted:
            yield parse_record(opcode, data[first:last])


def parse_record(opcode: int, body: bytes) -> McapRecord:
    """Return a record of one of the kinds in `_READERS`; BrokenRecordError instead of mcap's many exceptions."""
    try:
        return _READERS[opcode](_WholeReads(io.BytesIO(body)))
    except Exception as error:  # mcap raises its own, struct's and unicode errors here
        name = Opcode(opcode).name.lower().replace("_", " ")
        article = "an" if name.startswith("a") else "a"
        raise BrokenRecordError(f"{article} {name} record cannot be read ({type(error).__name__}: {error})") from None


def record_bytes(record: McapRecord) -> bytes:
    """Return a record as it stands in a file."""
    builder = RecordBuilder()
    record.write(builder)
    packed: bytes = builder.end()  # type: ignore[no-untyped-call]
    return packed


def take_definitions(data: Bytes, schemas: dict[int, Schema], channels: dict[int, Channel]) -> None:
    """Add the schemas and channels among the records to those known, by their ids."""
    for record in read_records(data, DEFINITIONS):
        if isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel):
            channels[record.id] = record


def read_footer(data: FileBytes) -> Footer | None:
    """Return the footer of a file; None where the file was not closed."""
    ending = data[max(len(data) - ENDING, 0) : len(data)]
    if len(ending) != ENDING or ending[-len(MAGIC) :] != MAGIC or ending[0] != Opcode.FOOTER:
        return None
    return Footer(*FOOTER.unpack_from(ending, HEAD.size))


def summary_fits(data: FileBytes, footer: Footer) -> bool | None:
    """Whether the summary has its checksum, which covers the footer up to itself; None where it has none."""
    if not footer.summary_start or not footer.summary_crc:
        return None
    return data.checksum(footer.summary_start, len(data) - len(MAGIC) - 4) == footer.summary_crc
