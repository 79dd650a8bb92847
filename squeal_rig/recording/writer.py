"""Writes a bag that rosbag2 Jazzy, `rosbags` and `mcap` read: `<name>/<name>_0.mcap` and `metadata.yaml`.

What a crash costs: messages leave memory at most `flush_interval` after the first one of their chunk came in,
provided `flush` is called from a timer of that period; a message that arrives later flushes by itself.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import datetime, timezone
from itertools import count
from pathlib import Path

from mcap.records import Channel, Schema

from squeal_rig import __version__
from squeal_rig.errors import DiskError, RecordingError

from .bag_metadata import BagMetadata, FileEntry, TopicEntry, metadata_yaml, write_metadata
from .chunks import ChunkBuilder, ChunkMessage
from .mcap_file import McapFile
from .qos_yaml import QosProfile, qos_to_yaml
from .records import MAX_CHANNELS, MAX_CHUNK_BYTES
from .schemas import MessageSchema, full_type_name, installed_schema
from .sealed import PROVENANCE, sealed

MAX_TIME = 2**63 - 1  # rosbag2 keeps times as int64 [ns]
_OURS = "squeal_rig"
LIBRARY = f"{_OURS} {__version__}"
_BROKEN_OFF = ("stopped", "aborted")  # how endings begin that are no completion
_MAX_MESSAGE = MAX_CHUNK_BYTES // 2
_SEQUENCE_MASK = 2**32 - 1


def new_directory() -> Path:
    """A new, empty folder bags/<UTC stamp>, with _2, _3 ... behind where another bag was begun in the same second."""
    stamp = f"{datetime.now(timezone.utc):%Y%m%dT%H%M%SZ}"
    for number in count(1):
        directory = Path("bags") / (stamp if number == 1 else f"{stamp}_{number}")
        try:
            directory.mkdir(parents=True)
        except FileExistsError:
            continue
        except OSError:
            pass  # the writer meets it again, and says what is wrong
        break
    return directory


def refuse_written(directory: Path) -> None:
    """`RecordingError` where a new bag would meet what is there already."""
    if directory.is_dir():
        if any(directory.iterdir()):
            raise RecordingError(f"The bag directory {directory} exists already and is not empty.")
    elif directory.exists():
        raise RecordingError(f"The bag directory {directory} exists already and is a file.")


def is_numbered(library: str) -> bool:
    """Whether the writer of a file numbers the messages of a topic one by one, as ours does."""
    return library.startswith(_OURS)


@dataclass
class ChannelHandle:
    """What `add_topic` returns and `write` takes. `message_count` counts over all files of the bag."""

    topic: str
    schema: Schema
    channel: Channel
    entry: TopicEntry
    definition: MessageSchema
    message_count: int = 0


class BagWriter:
    """One bag being written. Methods may be called from several threads.

    Raises DiskError from any method when the disk refuses; `close` still leaves a valid bag then, but for a file that
    not even the reserve was enough to finish, which can be recovered.
    """

    def __init__(
        self,
        directory: str | Path,
        *,
        chunk_size: int = 1 << 20,
        flush_interval: float = 0.5,
        compression: str = "zstd",
        max_file_size: int | None = None,
        max_file_duration: float | None = None,
        custom_data: Mapping[str, str] | None = None,
        reserve_bytes: int = 4 << 20,
    ) -> None:
        """Create the directory (it must be new or empty) and its first file.

        chunk_size [bytes] uncompressed; flush_interval [s]; compression "zstd" or "none"; max_file_size
        [bytes] and max_file_duration [s] of log time start a new file; custom_data goes into every file when
        it is opened and into metadata.yaml; reserve_bytes of the disk are left free.
        """
        for name, value in (
            ("chunk_size", chunk_size),
            ("flush_interval", flush_interval),
            ("max_file_size", max_file_size),
            ("max_file_duration", max_file_duration),
        ):
            if value is not None and not value > 0:
                raise RecordingError(f"{name} is {value}; it must be above 0.")
        if reserve_bytes < 0:
            raise RecordingError(f"reserve_bytes is {reserve_bytes}; it must not be below 0 bytes.")
        self.directory = Path(directory).absolute()
        self._chunk_size = min(chunk_size, max_file_size or chunk_size, _MAX_MESSAGE)
        self._flush_interval = flush_interval
        self._max_file_size = max_file_size
        self._max_file_duration_ns = None if max_file_duration is None else round(max_file_duration * 1e9)
        self._reserve = reserve_bytes
        self._custom = dict(custom_data or {})
        self._chunk = ChunkBuilder(compression)
        self._chunk_deadline = 0.0
        self._handles: dict[str, ChannelHandle] = {}
        self._schemas: dict[tuple[str, str, str], Schema] = {}
        self._closed_files: list[McapFile] = []
        self._file_start: int | None = None
        self._messages = 0
        self._heading: Callable[[], Sequence[tuple[str, Mapping[str, str]]]] = lambda: ()
        self._lock = threading.RLock()
        self._closed = False
        self._make_directory()
        self._file = self._open_file(0)

    @property
    def bytes_written(self) -> int:
        """Bytes in the files so far."""
        return self._file.size + sum(file.size for file in self._closed_files)

    @property
    def message_count(self) -> int:
        """Messages taken so far, the ones still in memory included."""
        return self._messages

    def add_topic(
        self,
        topic: str,
        type_name: str,
        offered_qos: Sequence[QosProfile] = (),
        schema: MessageSchema | None = None,
    ) -> ChannelHandle:
        """Declare a topic; the definition of its type is looked up where no schema is given.

        A topic declared twice with the same type returns the first handle; another definition of it is refused.
        """
        with self._lock:
            self._check_open()
            known = self._handles.get(topic)
            if known is not None:
                if known.entry.type_name not in (type_name, full_type_name(type_name)):
                    raise RecordingError(
                        f"Topic {topic} has type {known.entry.type_name}; it cannot be {type_name} too."
                    )
                changed = None if schema is None else known.definition.conflict(schema)
                if changed is not None:
                    raise RecordingError(f"Topic {topic}: {changed} has other fields than when the topic was declared.")
                return known
            if len(self._handles) >= MAX_CHANNELS:
                raise RecordingError(f"A bag holds at most {MAX_CHANNELS} topics.")
            definition = installed_schema(type_name) if schema is None else schema
            handle = self._new_handle(topic, definition, tuple(offered_qos))
            self._file.define(handle.schema, handle.channel)
            self._handles[topic] = handle
            return handle

    def write(
        self, handle: ChannelHandle, data: bytes, log_time: int, publish_time: int, sequence: int | None = None
    ) -> None:
        """Add one message: its CDR bytes, when it was received and when it was sent [ns].

        Messages of a topic are numbered from 0 over all files; `sequence` keeps the number of another bag.
        """
        if not 0 <= log_time <= MAX_TIME or not 0 <= publish_time <= MAX_TIME:
            raise RecordingError(
                f"A message on {handle.topic} has log time {log_time} ns and publish time {publish_time} ns;"
                f" both must lie in 0..{MAX_TIME} ns."
            )
        if len(data) > _MAX_MESSAGE:
            raise RecordingError(f"A message on {handle.topic} has {len(data)} bytes; the bound is {_MAX_MESSAGE}.")
        with self._lock:
            self._check_open()
            self._split_if_due(log_time)
            if self._chunk.size >= self._chunk_size:
                self._write_chunk()  # the disk refused it: take nothing more into memory until it yields
            if self._chunk.message_count == 0:
                self._chunk_deadline = time.monotonic() + self._flush_interval
            number = handle.message_count & _SEQUENCE_MASK if sequence is None else sequence
            message = ChunkMessage(handle.channel.id, number, log_time, publish_time, bytes(data))
            self._chunk.add(handle.schema, handle.channel, message)
            handle.message_count += 1
            self._messages += 1
            if self._file_start is None:
                self._file_start = log_time
            if self._chunk.size >= self._chunk_size or time.monotonic() >= self._chunk_deadline:
                self._write_chunk()

    def add_metadata(self, name: str, mapping: Mapping[str, str]) -> None:
        """Write a named record of texts into the current file at once (for instance a parameter change).

        It carries its own checksum, since MCAP gives records outside chunks none.
        """
        with self._lock:
            self._check_open()
            self._file.append_metadata(name, sealed(mapping))

    def add_custom_data(self, mapping: Mapping[str, str]) -> None:
        """Add facts that became known after the start; they are in the current file at once."""
        with self._lock:
            self._check_open()
            self._custom |= mapping
            self._file.append_metadata(PROVENANCE, sealed(self._custom))

    def keep_in_every_file(self, records: Callable[[], Sequence[tuple[str, Mapping[str, str]]]]) -> None:
        """Name the records that each following file of the bag is to begin with."""
        self._heading = records

    def flush(self) -> None:
        """Hand every message to the operating system. Call it from a timer of period `flush_interval`."""
        with self._lock:
            if not self._closed:
                self._write_chunk()

    def split(self) -> None:
        """Close the current file and go on in a new one."""
        with self._lock:
            self._check_open()
            self._write_chunk()
            following = self._open_file(len(self._closed_files) + 1)  # first: if it fails, the old one goes on
            try:
                self._finish_file()
            finally:  # one that the disk refused to finish is closed all the same: the bag ends in the next
                self._file = following
                self._file_start = None

    def close(self, ending: str) -> None:
        """Close the bag; `ending` says how the recording ended and is kept in custom_data as `ending`.

        Where the last messages no longer fit on the disk, the bag is closed without them, its ending says so,
        custom_data counts them as `messages_lost_at_end`, and DiskError is raised. A second call does nothing.
        """
        with self._lock:
            if self._closed:
                return
            self._closed = True
            self._custom["ending"] = ending
            lost, refusal = self._chunk.message_count, None
            try:
                self._write_chunk(closing=True)
            except DiskError as error:
                refusal = error
                self._custom["messages_lost_at_end"] = str(lost)
                if not ending.startswith(_BROKEN_OFF):
                    self._custom["ending"] = f"stopped: the last {lost} messages are lost: {error}"
            self._finish_file()
            write_metadata(self.directory, self._metadata([*self._closed_files]))
            if refusal is not None:
                raise refusal

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        if error is None:
            self.close("complete")
            return
        with suppress(RecordingError):  # the first error is the one to tell
            self.close(f"aborted: {type(error).__name__}: {error}")

    def _make_directory(self) -> None:
        try:
            self.directory.mkdir(parents=True, exist_ok=True)
            refuse_written(self.directory)
        except OSError as error:
            raise DiskError(f"Cannot create the bag directory {self.directory}: {error.strerror}.") from None

    def _open_file(self, number: int) -> McapFile:
        path = self.directory / f"{self.directory.name}_{number}.mcap"
        file = McapFile(path, LIBRARY, self._reserve)
        # rosbag2 keeps its metadata in the file too: provenance survives a crash and a lost metadata.yaml.
        try:
            file.append_metadata("rosbag2", {"serialized_metadata": metadata_yaml(self._metadata([]))})
            file.append_metadata(PROVENANCE, sealed(self._custom))
            for name, values in self._heading():
                file.append_metadata(name, sealed(values))
            for handle in self._handles.values():
                file.define(handle.schema, handle.channel)
        except DiskError:
            file.discard()
            raise
        return file

    def _finish_file(self) -> None:
        described = self._metadata([self._file])  # no other: what a split costs does not grow with the bag
        with suppress(DiskError):  # on a full disk the summary is worth more; finish tells if that fails
            values = {"serialized_metadata": metadata_yaml(described)}
            self._file.append_metadata("rosbag2", values, closing=True)
        try:
            self._file.finish()
        finally:
            self._closed_files.append(self._file)

    def _split_if_due(self, log_time: int) -> None:
        duration = self._max_file_duration_ns
        too_long = duration is not None and self._file_start is not None and log_time - self._file_start >= duration
        if too_long or (self._max_file_size is not None and self._file.size >= self._max_file_size):
            if self._file.totals.message_count or self._chunk.message_count:
                self.split()

    def _write_chunk(self, *, closing: bool = False) -> None:
        if self._chunk.message_count:
            packed = self._chunk.pack()
            self._file.append_chunk(packed, closing=closing)
            self._chunk.clear()

    def _new_handle(self, topic: str, definition: MessageSchema, qos: tuple[QosProfile, ...]) -> ChannelHandle:
        key = (definition.type_name, definition.text, definition.encoding)
        schema = self._schemas.get(key)
        if schema is None:
            text = definition.text.encode()
            schema = Schema(len(self._schemas) + 1, text, definition.encoding if text else "", definition.type_name)
            self._schemas[key] = schema
        channel = Channel(
            id=len(self._handles) + 1,
            topic=topic,
            message_encoding="cdr",
            metadata={"offered_qos_profiles": qos_to_yaml(qos), "topic_type_hash": definition.type_hash},
            schema_id=schema.id,
        )
        entry = TopicEntry(topic, definition.type_name, qos=qos, type_hash=definition.type_hash)
        return ChannelHandle(topic, schema, channel, entry, definition)

    def _metadata(self, files: Sequence[McapFile]) -> BagMetadata:
        counted = [
            replace(handle.entry, message_count=sum(file.count(handle.channel.id) for file in files))
            for handle in self._handles.values()
        ]
        entries = [
            FileEntry(file.path.name, file.totals.start_time, file.totals.end_time, file.totals.message_count)
            for file in files
        ]
        return BagMetadata(tuple(entries), tuple(counted), self._custom)

    def _check_open(self) -> None:
        if self._closed:
            raise RecordingError(f"The bag {self.directory} is closed.")
