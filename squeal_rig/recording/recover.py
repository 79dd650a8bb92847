"""Saves what is intact in a damaged bag into a new one, and tells what is lost."""

from __future__ import annotations

from pathlib import Path

from mcap.records import Channel, Schema

from squeal_rig.errors import RecordingError

from .bag_metadata import custom_data_of
from .chunks import ChunkMessage, iter_messages
from .findings import Recovery
from .qos_yaml import qos_from_yaml
from .reader import find_files, missing_files
from .records import take_definitions
from .salvage import Damaged, Salvage, Salvaged
from .schemas import MessageSchema, full_type_name
from .sealed import PROVENANCE, is_intact, unsealed
from .writer import MAX_TIME, BagWriter, ChannelHandle, is_numbered

_MAX_STEP = 2**31


def recover(source: str | Path, directory: str | Path) -> Recovery:
    """Save every intact message of a file, or of all files in a folder, into a new bag.

    Raises RecordingError when nothing can be read, when nothing is intact, or when the new bag cannot be written.
    """
    paths = find_files(Path(source))
    rescue = _Rescue(Path(directory))
    try:
        for path in paths:
            # As a power failure leaves the last one: no bar to the others.
            if len(paths) > 1 and path.is_file() and path.stat().st_size == 0:
                rescue.report.empty_files.append(path.name)
                rescue.report.closed = False
            else:
                rescue.take_file(path)
        report = rescue.report
        if Path(source).is_dir():
            report.missing_files = missing_files(Path(source))
            report.unended = rescue.ours and report.closed and "ending" not in rescue.custom
        if rescue.writer is None:
            raise RecordingError(f"{source} holds no intact chunk: nothing can be recovered.")
        rescue.writer.add_custom_data(_custom_data(rescue, report))
        rescue.writer.close(rescue.ending())
    except BaseException as error:
        if rescue.writer is not None:
            rescue.writer.close(f"aborted: {type(error).__name__}: {error}")
        raise
    return report


class _Rescue:
    """Goes through files of one bag; the new bag begins with the first intact piece."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self.writer: BagWriter | None = None
        self.report = Recovery()
        self.custom: dict[str, str] = {}
        self.ours = False
        self._handles: dict[str, ChannelHandle] = {}
        self._definitions: dict[str, MessageSchema] = {}
        self._numbers: dict[str, int] = {}
        self._last_time: int | None = None
        self._damage = False
        self._proves = False

    def ending(self) -> str:
        """How the recording ended, as far as the files tell."""
        known = self.custom.get("ending")
        if known is not None and self.report.closed:
            return known
        return "aborted: the recording was not closed; recovered"

    @property
    def _taken(self) -> int:
        """Messages that were found, saved or not."""
        return self.report.messages + sum(self.report.refused.values())

    def take_file(self, path: Path) -> None:
        """Save what is intact in one file."""
        salvage, report = Salvage(path), self.report
        file = _File(salvage)
        taken_before, lost_before = self._taken, report.lost
        for piece in salvage.pieces():
            if isinstance(piece, Damaged):
                report.damaged_chunks += 1
                self._damage = True
                continue
            if not piece.proved and self._proves:
                report.damaged_chunks += 1  # every other chunk has a checksum: this one's was wiped out
                self._damage = True
                continue
            self._proves = self._proves or piece.proved
            self._save(piece, file)
        loose = salvage.loose
        self.ours = self.ours or is_numbered(loose.library)
        if loose.closed and loose.statistics is None and (loose.damaged_ends or is_numbered(loose.library)):
            report.uncounted += 1
        report.closed = report.closed and loose.closed
        report.files_within += loose.files_within
        if loose.statistics is not None:
            missing = loose.statistics.message_count - (self._taken - taken_before)
            report.lost = max(report.lost, lost_before + max(missing, 0))
        if not loose.closed:
            report.unread_bytes += file.unread()
        self._save_metadata(loose.metadata)

    def _save(self, piece: Salvaged, file: _File) -> None:
        report = self.report
        try:
            file.define(piece.records)
            messages = list(iter_messages(piece.records))
        except RecordingError:
            report.damaged_chunks += 1
            self._damage = True
            return
        report.chunks += 1
        if not messages:
            return
        first, last = min(m.log_time for m in messages), max(m.log_time for m in messages)
        if self._damage and self._last_time is not None:
            report.lost_seconds += max(first - self._last_time, 0) * 1e-9
        self._damage, self._last_time = False, max(last, self._last_time or 0)
        for message in messages:
            self._save_message(message, file, piece.proved)

    def _save_message(self, message: ChunkMessage, file: _File, proved: bool) -> None:
        try:
            handle = self._handle(message.channel_id, file)
            if message.log_time > MAX_TIME or message.publish_time > MAX_TIME:
                raise RecordingError("their times are out of bounds")
        except RecordingError as error:
            self.report.refused[str(error)] = self.report.refused.get(str(error), 0) + 1
            return
        assert self.writer is not None
        self.writer.write(handle, message.data, message.log_time, message.publish_time, message.sequence)
        self.report.messages += 1
        self.report.unproved += not proved
        # Numbers of ours begin at 0 and go on over all files; others number nothing, or as they like.
        default = message.sequence if not file.starts_at_zero else 0
        step = message.sequence - self._numbers.get(handle.topic, default)
        if 0 < step < _MAX_STEP and file.numbered:
            self.report.lost += step
        self._numbers[handle.topic] = message.sequence + 1

    def _handle(self, channel_id: int, file: _File) -> ChannelHandle:
        channel, schema = file.channel(channel_id)
        known = self._handles.get(channel.topic)
        if known is not None and known.schema.name == schema.name and known.schema.data == schema.data:
            return known
        if channel.message_encoding != "cdr":
            raise RecordingError(f"{channel.topic} is encoded as {channel.message_encoding!r}, not as cdr")
        try:
            qos = qos_from_yaml(channel.metadata.get("offered_qos_profiles", ""))
        except RecordingError:
            qos = ()  # the messages are worth more than how they were offered
        definition = MessageSchema(
            full_type_name(schema.name),
            schema.data.decode(errors="replace"),
            channel.metadata.get("topic_type_hash", ""),
            schema.encoding,
        )
        changed = self._definitions.setdefault(definition.type_name, definition).conflict(definition)
        if changed is not None:
            raise RecordingError(f"{changed} of {channel.topic} has other fields than before: a bag cannot hold both")
        if self.writer is None:
            self.writer = BagWriter(self.directory, custom_data={"recovered": "true"})
        handle = self.writer.add_topic(channel.topic, schema.name, qos, definition)
        self._handles[channel.topic] = handle
        return handle

    def _save_metadata(self, records: list[tuple[str, dict[str, str]]]) -> None:
        """Keep the metadata whose checksum fits; of the provenance the last one."""
        for name, values in records:
            if is_intact(values) is False:
                self.report.lost_records += 1
            elif name == PROVENANCE:
                self.custom |= unsealed(values)
            elif name == "rosbag2":
                self.custom = custom_data_of(values.get("serialized_metadata", "")) | self.custom
            elif self.writer is not None:
                self.writer.add_metadata(name, values)
        closing = [values for name, values in records if name == "rosbag2"][-1:]
        if closing:
            ending = custom_data_of(closing[0].get("serialized_metadata", "")).get("ending")
            self.custom |= {"ending": ending} if ending else {}


class _File:
    """Definitions of one file: those of the chunk itself first, then of other chunks, then from outside chunks."""

    def __init__(self, salvage: Salvage) -> None:
        self._salvage = salvage
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}

    @property
    def numbered(self) -> bool:
        """Whether messages are numbered one by one."""
        return is_numbered(self._salvage.loose.library)

    @property
    def starts_at_zero(self) -> bool:
        """Whether the first message of a topic has the number 0: in the first file of a bag of ours."""
        return self.numbered and self._salvage.path.stem.endswith("_0")

    def define(self, records: bytes) -> None:
        """Take the definitions in a chunk."""
        take_definitions(records, self._schemas, self._channels)

    def channel(self, channel_id: int) -> tuple[Channel, Schema]:
        """Return a channel with its schema; RecordingError where its definition is lost."""
        loose = self._salvage.loose
        channel = self._channels.get(channel_id) or loose.channels.get(channel_id)
        schema = None
        if channel is not None:
            schema = self._schemas.get(channel.schema_id) or loose.schemas.get(channel.schema_id)
        if channel is None or schema is None:
            raise RecordingError("their topic's definition is lost")
        return channel, schema

    def unread(self) -> int:
        """Bytes behind the last intact piece."""
        return max(self._salvage.size - self._salvage.end_of_intact, 0)


def _custom_data(rescue: _Rescue, report: Recovery) -> dict[str, str]:
    return rescue.custom | {
        "recovered_lost_messages": str(report.lost),
        "recovered_uncounted_files": str(report.uncounted),
        "recovered_lost_seconds": f"{report.lost_seconds:.3f}",
        "recovered_damaged_chunks": str(report.damaged_chunks),
        "recovered_unproved_messages": str(report.unproved),
        "recovered_was_closed": "true" if report.closed else "false",
    }
