"""Reads a bag of any length in bounded memory: a directory of rosbag2, or a single MCAP file."""

from __future__ import annotations

import heapq
import re
from collections.abc import Collection, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path
from typing import NamedTuple

from mcap.records import Channel

from squeal_rig.errors import RecordingError

from .bag_metadata import METADATA_FILE, custom_data_of, paths_of, read_metadata
from .chunks import ChunkMessage
from .mcap_index import Block, FileIndex, index_file, read_block
from .qos_yaml import QosProfile, qos_from_yaml
from .records import FileBytes
from .schemas import MessageSchema
from .sealed import PROVENANCE, unsealed

_MAX_WAITING = 1 << 30
_MAX_FILES = 100_000  # a higher number is no count of files


class RawMessage(NamedTuple):
    """One recorded message: CDR bytes; received and sent at log_time and publish_time [ns]."""

    topic: str
    data: bytes
    log_time: int
    publish_time: int
    sequence: int


class MetadataRecord(NamedTuple):
    """A named record of texts."""

    name: str
    values: Mapping[str, str]


@dataclass(frozen=True)
class TopicInfo:
    """One topic of a bag, over all its files."""

    name: str
    type_name: str
    message_count: int
    qos: tuple[QosProfile, ...]
    type_hash: str
    schema: MessageSchema
    serialization_format: str


class Bag:
    """A closed bag. Opening it reads the indexes only.

    Raises RecordingError, naming the file, when a file is missing, damaged or was not closed.

    path: directory or file; files; topics by name; start_time, end_time: first and last log time [ns], 0
    without messages; message_count; custom_data: provenance and `ending`; metadata_records as written.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        metadata = read_metadata(self.path) if self.path.is_dir() else None
        self.files = find_files(self.path) if metadata is None else paths_of(metadata.files, self.path)
        self._indexes = [index_file(file) for file in self.files]
        self.topics: Mapping[str, TopicInfo] = _topics(self._indexes)
        holding = [index for index in self._indexes if index.message_count]
        self.message_count = sum(index.message_count for index in holding)
        self.start_time = min((index.start_time for index in holding), default=0)
        self.end_time = max((index.end_time for index in holding), default=0)
        records = [MetadataRecord(*record) for index in self._indexes for record in index.metadata]
        self.custom_data: Mapping[str, str] = (
            _embedded_custom_data(records) if metadata is None else metadata.custom_data
        )
        self.metadata_records = tuple(
            MetadataRecord(name, unsealed(values)) for name, values in records if name not in ("rosbag2", PROVENANCE)
        )

    @property
    def duration(self) -> float:
        """Time from the first to the last message [s]."""
        return (self.end_time - self.start_time) * 1e-9

    @property
    def ending(self) -> str | None:
        """How the recording ended; None where the bag does not say."""
        return self.custom_data.get("ending")

    def time_span(self, topic: str) -> tuple[int, int]:
        """First and last log time [ns] of a topic, (0, 0) where it has no message: of its first and its last block."""
        wanted = [_wanted_channels(index, (topic,)) for index in self._indexes]
        blocks = sorted(
            ((block.start_time, number, block) for number, index in enumerate(self._indexes) for block in index.blocks),
            key=itemgetter(0, 1),
        )
        ends = []
        for order, pick in ((blocks, min), (reversed(blocks), max)):
            for _, number, block in order:
                if not _may_hold(block, wanted[number], 0, 2**64):
                    continue
                with FileBytes(self.files[number]) as data:
                    times = [message.log_time for message in read_block(data, block, wanted[number])]
                if times:
                    ends.append(pick(times))
                    break
        return (ends[0], ends[1]) if ends else (0, 0)

    def messages(
        self, topics: Collection[str] | None = None, start: int | None = None, end: int | None = None
    ) -> Iterator[RawMessage]:
        """Yield messages in log-time order over all files; equal times keep the order of writing.

        topics: names, None for all; a name the bag does not have is an error. start <= log time < end [ns].
        """
        if topics is not None:
            missing = sorted(set(topics) - set(self.topics))
            if missing:
                raise RecordingError(f"{self.path} has no topic {missing[0]}; it has {', '.join(sorted(self.topics))}.")
        low = 0 if start is None else start
        high = 2**64 if end is None else end
        return self._messages(topics, low, high)

    def _messages(self, topics: Collection[str] | None, start: int, end: int) -> Iterator[RawMessage]:
        """Merge by a heap: a block waits under its first log time and is read when nothing earlier is left.

        So memory holds only blocks whose times overlap.
        """
        wanted = [_wanted_channels(index, topics) for index in self._indexes]
        names = [{key: channel.topic for key, channel in index.channels.items()} for index in self._indexes]
        heap: list[tuple[int, int, int, int, Block | ChunkMessage]] = []
        for number, index in enumerate(self._indexes):
            for block in index.blocks:
                if _may_hold(block, wanted[number], start, end):
                    heap.append((block.start_time, number, block.offset, -1, block))
        heapq.heapify(heap)
        with ExitStack() as stack:
            files: dict[int, FileBytes] = {}
            waiting = 0  # bytes of the messages in the heap
            while heap:
                _, number, offset, _, item = heapq.heappop(heap)
                if isinstance(item, ChunkMessage):
                    waiting -= len(item.data)
                    topic = names[number][item.channel_id]
                    yield RawMessage(topic, item.data, item.log_time, item.publish_time, item.sequence)
                    continue
                if number not in files:
                    files[number] = stack.enter_context(FileBytes(self.files[number]))
                found = read_block(files[number], item, wanted[number])
                for place, message in enumerate(found):
                    if start <= message.log_time < end:
                        waiting += len(message.data)
                        heapq.heappush(heap, (message.log_time, number, offset, place, message))
                if waiting > _MAX_WAITING:
                    raise RecordingError(
                        f"{self.path}: the times of its chunks overlap so far that more than {_MAX_WAITING} bytes of"
                        " messages would have to be sorted in memory."
                    )


def find_files(path: Path) -> tuple[Path, ...]:
    """Return the files of a bag that has no metadata.yaml, in the order of their numbers."""
    if path.is_file():
        return (path,)
    if not path.is_dir():
        raise RecordingError(f"There is no bag at {path}.")
    files = sorted(path.glob("*.mcap"), key=lambda file: (_file_number(file), file.name))
    if not files:
        raise RecordingError(f"{path} is not a bag: it holds neither {METADATA_FILE} nor an MCAP file.")
    return tuple(files)


def missing_files(directory: Path) -> list[str]:
    """Names of files that a bag's folder lacks, by metadata.yaml or, where that is not there, by the files' numbers."""
    there = {path.name for path in directory.glob("*.mcap")}
    try:
        metadata = read_metadata(directory)
    except RecordingError:
        metadata = None
    if metadata is not None:
        return [path.name for path in paths_of(metadata.files, directory) if path.name not in there]
    numbered = [re.fullmatch(r"(.*_)(\d+)\.mcap", name) for name in there]
    stems = {match[1] for match in numbered if match}
    if len(stems) != 1 or None in numbered:
        return []
    last = max(int(match[2]) for match in numbered if match)
    if last > _MAX_FILES:
        return []
    return [name for number in range(last) if (name := f"{min(stems)}{number}.mcap") not in there]


def _file_number(path: Path) -> int:
    match = re.search(r"_(\d+)$", path.stem)
    return int(match[1]) if match else 0


def _topics(indexes: Collection[FileIndex]) -> dict[str, TopicInfo]:
    topics: dict[str, TopicInfo] = {}
    for index in indexes:
        for channel in index.channels.values():
            schema = index.schemas.get(channel.schema_id)
            if schema is None:
                raise RecordingError(f"{index.path} has no message definition for topic {channel.topic}.")
            known = topics.get(channel.topic)
            if known is not None and known.type_name != schema.name:
                raise RecordingError(
                    f"{index.path} has topic {channel.topic} as {schema.name} and as {known.type_name}."
                )
            type_hash = channel.metadata.get("topic_type_hash", "")
            definition = MessageSchema(schema.name, schema.data.decode(errors="replace"), type_hash, schema.encoding)
            changed = None if known is None else known.schema.conflict(definition)
            if changed is not None:
                raise RecordingError(
                    f"{index.path} has topic {channel.topic} in two definitions: {changed} has other fields."
                )
            topics[channel.topic] = TopicInfo(
                name=channel.topic,
                type_name=schema.name,
                message_count=index.message_counts.get(channel.id, 0) + (known.message_count if known else 0),
                qos=_qos_of(index.path, channel),
                type_hash=type_hash,
                schema=definition,
                serialization_format=channel.message_encoding,
            )
    return topics


def _qos_of(path: Path, channel: Channel) -> tuple[QosProfile, ...]:
    try:
        return qos_from_yaml(channel.metadata.get("offered_qos_profiles", ""))
    except RecordingError as error:
        raise RecordingError(f"{path}, topic {channel.topic}: {error}") from None


def _wanted_channels(index: FileIndex, topics: Collection[str] | None) -> frozenset[int]:
    return frozenset(key for key, channel in index.channels.items() if topics is None or channel.topic in topics)


def _may_hold(block: Block, wanted: frozenset[int], start: int, end: int) -> bool:
    in_time = block.end_time >= start and block.start_time < end
    return in_time and (block.channels is None or not wanted.isdisjoint(block.channels))


def _embedded_custom_data(records: Collection[MetadataRecord]) -> dict[str, str]:
    """Return the custom data a file carries itself: rosbag2's serialized metadata, the last one counts."""
    texts = [record.values.get("serialized_metadata", "") for record in records if record.name == "rosbag2"]
    return custom_data_of(texts[-1]) if texts else {}
