"""Goes through all of a bag and tells whether it can be trusted. Memory is bounded by one chunk."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from squeal_rig.errors import RecordingError

from .bag_metadata import BagMetadata, read_metadata
from .findings import Verdict
from .gaps import CLOUD_TYPE, SampleCount
from .mcap_index import FileIndex, index_file
from .messages import Decode, decoder_of
from .reader import Bag, find_files, missing_files
from .records import MAGIC, FileBytes
from .schemas import MessageSchema, installed_schema
from .sealed import is_intact
from .verify_file import FileChecker
from .writer import is_numbered

# What our recorder and `recover` count in a bag's custom data.
_OWN_COUNTS = {
    "lost_messages": "messages were lost on the way to the recorder",
    "refused_messages": "messages could not be recorded",
    "messages_lost_at_end": "messages were lost at the end, when the disk was full",
    "recovered_lost_messages": "messages were missing already when it was recovered",
    "recovered_uncounted_files": "of its files had lost the count of what they should hold when it was recovered",
}
_OUT_OF_ORDER = 10**9  # [ns]


@dataclass
class _Topic:
    """What is followed of a topic through all files."""

    type_name: str
    schema: MessageSchema
    count: int = 0
    last_log: int = -1
    last_publish: int = -1
    backwards: int = 0
    longest_back: int = 0
    publish_backwards: int = 0
    sent_later: int = 0
    next_number: int | None = None
    missing: int = 0
    numbered: bool = False
    decode: Decode | None = None
    undecodable: str = ""
    last: bytes = b""


def verify(path: str | Path) -> Verdict:
    """Check a bag's files, checksums, indexes, order, numbering, samples, definitions and metadata.yaml.

    Raises RecordingError only where there is no bag at all.
    """
    path = Path(path)
    verdict = Verdict(path)
    files = find_files(path)
    if not any(map(_may_be_mcap, files)):
        raise RecordingError(f"{path} is no bag: nothing of it begins or ends as an MCAP file does.")
    topics: dict[str, _Topic] = {}
    indexes: list[FileIndex] = []
    for file in files:
        try:
            index = index_file(file)
        except RecordingError as error:
            verdict.error(file.name, str(error))
            continue
        indexes.append(index)
        verdict.bytes += file.stat().st_size
        _check_file(index, topics, verdict)
    for name, topic in topics.items():
        _judge_topic(name, topic, verdict)
    for name, count in verdict.samples.items():
        _judge_samples(name, count, verdict)
    if indexes:
        _check_metadata(path, indexes, topics, verdict)
    return verdict


def _may_be_mcap(path: Path) -> bool:
    with FileBytes(path) as data:
        return MAGIC in (data[: len(MAGIC)], data[max(len(data) - len(MAGIC), 0) : len(data)])


def _check_file(index: FileIndex, topics: dict[str, _Topic], verdict: Verdict) -> None:
    """Take one file's messages; checksums and indexes are the checker's."""
    checker = FileChecker(index)
    numbered = is_numbered(index.library)
    for message in checker.messages():
        channel = index.channels.get(message.channel_id)
        schema = None if channel is None else index.schemas.get(channel.schema_id)
        if channel is None or schema is None:
            continue  # the checker tells
        topic = topics.get(channel.topic)
        if topic is None:
            text = schema.data.decode(errors="replace")
            definition = MessageSchema(
                schema.name, text, channel.metadata.get("topic_type_hash", ""), schema.encoding or "ros2msg"
            )
            topic = topics[channel.topic] = _Topic(schema.name, definition)
            _begin_topic(channel.topic, topic, verdict)
        elif topic.type_name != schema.name:
            verdict.error(channel.topic, f"is {topic.type_name} and {schema.name} in one bag")
        topic.numbered = numbered
        _follow(topic, message)
        if topic.type_name == CLOUD_TYPE:
            verdict.samples.setdefault(channel.topic, SampleCount()).add(message.data)
        verdict.messages += 1
    for fault in checker.faults:
        verdict.error(index.path.name, fault)
    for name, values in index.metadata:
        if is_intact(values) is False:
            verdict.error(index.path.name, f"the metadata record {name!r} is damaged: its checksum does not fit")


def _begin_topic(name: str, topic: _Topic, verdict: Verdict) -> None:
    try:
        topic.decode = decoder_of(topic.schema)
    except RecordingError as error:
        verdict.warn(name, f"cannot be decoded from the bag alone: {error}")
    try:
        installed = installed_schema(topic.type_name)
    except RecordingError:
        return
    if topic.schema.type_hash and installed.type_hash != topic.schema.type_hash:
        verdict.warn(
            name, f"{topic.type_name} has hash {topic.schema.type_hash}; the one installed {installed.type_hash}"
        )


def _follow(topic: _Topic, message: Any) -> None:
    topic.backwards += message.log_time < topic.last_log
    topic.longest_back = max(topic.longest_back, topic.last_log - message.log_time)
    topic.publish_backwards += message.publish_time < topic.last_publish
    topic.sent_later += message.publish_time > message.log_time
    topic.last_log, topic.last_publish = message.log_time, message.publish_time
    if topic.next_number is not None:
        topic.missing += max(message.sequence - topic.next_number, 0)
    topic.next_number = message.sequence + 1
    if topic.count == 0:
        _try_decoding(topic, message.data)
    topic.last = message.data
    topic.count += 1


def _try_decoding(topic: _Topic, data: bytes) -> None:
    if topic.decode is not None and not topic.undecodable:
        try:
            topic.decode(data)
        except RecordingError as error:
            topic.undecodable = str(error)


def _judge_topic(name: str, topic: _Topic, verdict: Verdict) -> None:
    _try_decoding(topic, topic.last)
    if topic.undecodable:
        verdict.error(name, f"its messages do not fit their definition: {topic.undecodable}")
    if topic.backwards:
        # Of several publishers on one topic the middleware hands over messages a little out of order.
        tell = verdict.error if topic.longest_back > _OUT_OF_ORDER else verdict.warn
        tell(name, f"log time goes back {topic.backwards} times, by {topic.longest_back * 1e-9:.6f} s at most")
    if topic.publish_backwards:
        verdict.warn(
            name, f"publish time goes back {topic.publish_backwards} times: several publishers, or a clock set"
        )
    if topic.sent_later:
        verdict.warn(name, f"{topic.sent_later} messages were published later than they were received: a clock set")
    if topic.numbered and topic.missing:
        verdict.error(name, f"{topic.missing} messages are missing by their numbers")


def _judge_samples(name: str, count: SampleCount, verdict: Verdict) -> None:
    if count.damaged:
        verdict.error(name, f"{count.damaged} blocks are no PointCloud2 with samples")
    if count.lost:
        verdict.error(name, f"{count.lost} samples are missing in {count.gaps} gaps by seq")
    if count.back:
        verdict.warn(name, f"seq goes back {count.back} times: the rig was started anew, or a replay looped")


def _check_metadata(path: Path, indexes: list[FileIndex], topics: dict[str, _Topic], verdict: Verdict) -> None:
    """Compare metadata.yaml with the files; one file alone needs none."""
    if path.is_dir():
        try:
            metadata = read_metadata(path)
        except RecordingError as error:
            verdict.error("metadata.yaml", str(error))
            return
        if metadata is None:
            verdict.warn("metadata.yaml", "is missing: rosbag2 wants `ros2 bag reindex` first")
            for name in missing_files(path):
                verdict.error(name, "is not there, by the numbers of the other files")
        else:
            for fault in _disagreements(metadata, indexes, topics):
                verdict.error("metadata.yaml", fault)
    try:
        told = Bag(path).custom_data
    except RecordingError as error:
        verdict.error(path.name, str(error))
        return
    if "ending" not in told:
        # A recorder of ours says it in the last file.
        ours = path.is_dir() and any(is_numbered(index.library) for index in indexes)
        tell = verdict.error if ours else verdict.warn
        tell(path.name, "does not say how the recording ended" + (": its last file is not there" if ours else ""))
    for key, meaning in _OWN_COUNTS.items():
        if told.get(key, "0") != "0":
            verdict.warn(path.name, f"says of itself that {told[key]} {meaning}")


def _disagreements(metadata: BagMetadata, indexes: list[FileIndex], topics: dict[str, _Topic]) -> Iterator[str]:
    there = {index.path.name: index for index in indexes}
    for entry in metadata.files:
        index = there.pop(Path(entry.path).name, None)
        if index is None:
            yield f"names {entry.path}, which is missing or cannot be read"
        elif entry.message_count != index.message_count and entry.message_count:
            yield f"says {entry.message_count} messages are in {entry.path}; there are {index.message_count}"
    yield from (f"does not name {name}" for name in there)
    for topic in metadata.topics:
        found = topics.get(topic.name)
        count = found.count if found is not None else 0
        if topic.message_count != count:
            yield f"says {topic.message_count} messages of {topic.name}; there are {count}"
        if found is not None and found.type_name != topic.type_name:
            yield f"says {topic.name} is {topic.type_name}; it is {found.type_name}"
