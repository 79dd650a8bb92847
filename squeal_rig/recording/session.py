"""What a recorder does, without ROS: topics and messages in, bags and snapshots out."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from squeal_rig.errors import DiskError, RecordingError

from .parameter_log import ParameterLog
from .provenance import provenance
from .qos_yaml import QosProfile
from .replay import is_latched
from .ring import KeptMessage, MessageRing
from .schemas import installed_schema
from .settings import RecorderSettings
from .writer import BagWriter, ChannelHandle, new_directory

_MB = 10**6
SNAPSHOT = "snapshot"


@dataclass
class SessionTopic:
    """One topic, over all bags of a session; `latest` is the last message of a latched one."""

    name: str
    type_name: str
    offered: tuple[QosProfile, ...]
    latched: bool
    handle: ChannelHandle | None = None
    latest: tuple[bytes, int, int] | None = None
    number: int = 0

    def missed(self, number: int | None) -> int:
        """How many messages a publisher's own number of the next one shows to be missing; it may number nothing (0)."""
        missing = number - self.number - 1 if number and self.number else 0
        self.number = number or self.number
        return max(missing, 0)


class RecordingSession:
    """One recorder's life: a bag at a time, begun by `start` and ended by `stop`.

    The first bag is `settings.directory`, each that follows has a number behind it; without a directory each is a new
    one. A bag begun later starts with the last values of latched topics. Every method raises RecordingError, DiskError
    where nothing can be written any more. A single message that cannot be recorded is counted in `refused`, the last
    reason is `refusal`.
    """

    def __init__(self, settings: RecorderSettings) -> None:
        self._settings = settings
        self._writer: BagWriter | None = None
        self._topics: dict[str, SessionTopic] = {}
        self._parameters = ParameterLog()
        self._facts: dict[str, str] = {}
        self._ring: MessageRing | None = None
        self._bags = 0
        self.snapshots = settings.mode == SNAPSHOT
        self.snapshot_count = 0
        self.directory: Path | None = None
        self.fault = ""
        self.refused = 0
        self.refusal = ""

    @property
    def recording(self) -> bool:
        """Whether a bag is open."""
        return self._writer is not None

    @property
    def state(self) -> str:
        """The state in words."""
        if self._writer is None:
            return "not recording"
        if self.snapshots:
            return f"keeping {self._settings.snapshot_duration:g} s in memory for {self.directory}"
        return f"recording to {self.directory}"

    @property
    def bytes_written(self) -> int:
        """Bytes in the files of the open bag."""
        return self._writer.bytes_written if self._writer is not None else 0

    @property
    def message_count(self) -> int:
        """Messages in the open bag."""
        return self._writer.message_count if self._writer is not None else 0

    @property
    def seconds_in_memory(self) -> float:
        """Time that a snapshot taken now would cover [s]."""
        return self._ring.seconds if self._ring is not None else 0.0

    def start(self, now: int) -> None:
        """Begin a bag at a time [ns]."""
        if self._writer is not None:
            raise RecordingError(f"{self.state} already")
        s = self._settings
        directory = self._next_directory()
        writer = BagWriter(
            directory,
            compression=s.compression,
            max_file_size=round(s.max_file_size * _MB) or None,
            max_file_duration=s.max_file_duration or None,
            reserve_bytes=round(s.disk_reserve * _MB),
            custom_data=provenance() | {"mode": s.mode} | self._facts,
        )
        self._bags += 1
        for topic in self._topics.values():
            topic.handle = None  # that of the bag before
        self._writer, self.directory, self.fault, self.refused = writer, directory, "", 0
        self._ring = MessageRing(s.snapshot_duration, round(s.snapshot_memory * _MB)) if self.snapshots else None
        try:
            self._begin(writer, now)
        except RecordingError as error:
            with suppress(RecordingError):  # the first error is the one to tell
                self.stop(f"aborted: {error}")
            self.fault = str(error)
            raise

    def _begin(self, writer: BagWriter, now: int) -> None:
        """Put into a new bag what is known by now."""
        writer.keep_in_every_file(lambda: self._parameters.current(time.time_ns()))
        for name, values in self._parameters.current(now):
            writer.add_metadata(name, values)
        for topic in self._topics.values():
            topic.handle = writer.add_topic(topic.name, topic.type_name, topic.offered)
            if topic.latest is not None:
                data, _, published = topic.latest
                self.write(topic, data, now, published)

    def stop(self, ending: str, facts: Mapping[str, str] | None = None) -> None:
        """Close the bag; nothing happens where none is open."""
        writer, self._writer, self._ring = self._writer, None, None
        if writer is None:
            return
        refused = {"refused_messages": str(self.refused)} if self.refused else {}
        with suppress(DiskError):  # the disk is full; closing tells it, and has its own reserve
            writer.add_custom_data({**(facts or {}), **refused})
        writer.close(ending)

    def add_topic(self, name: str, type_name: str, offered: Sequence[QosProfile]) -> SessionTopic:
        """Make a topic known: to the open bag and to those after it."""
        installed_schema(type_name)
        topic = SessionTopic(name, type_name, tuple(offered), is_latched(offered))
        if self._writer is not None:
            topic.handle = self._writer.add_topic(name, type_name, offered)
        self._topics[name] = topic
        return topic

    def write(self, topic: SessionTopic, data: bytes, log_time: int, publish_time: int) -> None:
        """Take one message; where no bag is open only the last one of a latched topic is kept."""
        if topic.latched:
            topic.latest = data, log_time, publish_time
        if self._writer is None or topic.handle is None:
            return
        if self._ring is not None:
            self._ring.add(KeptMessage(topic.handle, data, log_time, publish_time), topic.latched)
        else:
            self._record(self._writer, KeptMessage(topic.handle, data, log_time, publish_time))

    def _record(self, writer: BagWriter, message: KeptMessage) -> None:
        try:
            writer.write(*message)
        except DiskError:
            raise
        except RecordingError as error:  # one message that cannot be recorded is no reason to lose the others
            self.refused += 1
            self.refusal = str(error)

    def parameters_at_start(self, node: str, values: Mapping[str, Any], now: int, facts: Mapping[str, str]) -> None:
        """Take all parameters of a node, and facts of the run that are among them."""
        name, record = self._parameters.at_start(node, values, now)
        self._facts |= facts
        if self._writer is not None:
            self._writer.add_metadata(name, record)
            if facts:
                self._writer.add_custom_data(facts)

    def parameters_changed(self, node: str, values: Mapping[str, Any], deleted: tuple[str, ...], now: int) -> None:
        """Take a change of a node's parameters."""
        name, record = self._parameters.changed(node, values, deleted, now)
        if self._writer is not None:
            self._writer.add_metadata(name, record)

    def flush(self) -> None:
        """Hand what is in memory to the operating system, but for a snapshot's ring."""
        if self._writer is not None:
            self._writer.flush()

    def split(self) -> str:
        """Go on in a new file."""
        if self._writer is None or self.snapshots:
            raise RecordingError(
                "there is no file to split: "
                + ("in snapshot mode each snapshot is one" if self.snapshots else self.state)
            )
        self._writer.split()
        return f"{self.directory} goes on in a new file"

    def snapshot(self, reason: str, now: int) -> str:
        """Write what is in memory into a file of its own; returns a sentence."""
        if not self.snapshots:
            raise RecordingError(
                "everything is recorded already: mode is 'continuous', a snapshot needs mode 'snapshot'"
            )
        if self._writer is None or self._ring is None:
            raise RecordingError("nothing is kept in memory: call ~/start first")
        seconds, shortened = self._ring.seconds, self._ring.shortened
        messages = self._ring.take()
        if not messages:
            raise RecordingError("nothing is in memory yet")
        if self._writer.message_count:
            self._writer.split()
        self._writer.add_metadata(
            SNAPSHOT,
            {"reason": reason, "time_ns": str(now), "messages": str(len(messages)), "seconds": f"{seconds:.3f}"},
        )
        for message in messages:
            self._record(self._writer, message)
        self._writer.flush()
        self.snapshot_count += 1
        limit = f", cut short by {self._settings.snapshot_memory:g} MB of memory" if shortened else ""
        return f"snapshot, {reason}: {len(messages)} messages of {seconds:.1f} s written to {self.directory}{limit}"

    def _next_directory(self) -> Path:
        given = self._settings.directory
        if not given:
            return new_directory()
        return Path(given) if self._bags == 0 else Path(f"{given}_{self._bags + 1}")
