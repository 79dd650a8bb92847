"""Friction and stability computed again from a recording, with today's code: a bag of what the live nodes published."""

from __future__ import annotations

import hashlib
import math
import time
from collections import Counter, OrderedDict, deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from squeal_rig.configuration.declared import declarations
from squeal_rig.errors import DiskError, RecordingError, SquealRigError
from squeal_rig.estimation.friction_follower import MODEL, MU, SAMPLES, WINDOWS, FrictionFollower, Message
from squeal_rig.estimation.hard_squeal import COMPUTING, STATE_KEY, hard_squeal, pending
from squeal_rig.estimation.settings import FrictionSettings
from squeal_rig.estimation.stability_follower import (
    DESCRIPTION_KEY,
    EIGENVALUES,
    SAMPLE_KEY,
    SUMMARY,
    WINDOW_KEY,
    Estimate,
    InForce,
    StabilityFollower,
    description_crc,
    summary_of,
)
from squeal_rig.instruments.channels import FRICTION_WINDOW_NEEDED, block_from_cdr
from squeal_rig.instruments.description import RigDescription
from squeal_rig.recording import (
    Bag,
    BagWriter,
    MessageSchema,
    QosProfile,
    RawMessage,
    TopicInfo,
    as_mapping,
    decoder_of,
    installed_schema,
    provenance,
    samples_from_cdr,
)
from squeal_rig.recording.cdr import text_of
from squeal_rig.recording.gaps import CLOUD_TYPE
from squeal_rig.recording.parameter_log import AT_START, parameters_of
from squeal_rig.samples.blocks import DAQ, DESCRIPTION, BlockJoiner, RecordedBlock

#: Topic -> (type, whether its last value is kept for those who come late).
ESTIMATED = {
    SAMPLES: (CLOUD_TYPE, False),
    WINDOWS: (CLOUD_TYPE, False),
    MU: ("std_msgs/msg/Float64", False),
    MODEL: ("std_msgs/msg/Float64MultiArray", True),
    EIGENVALUES: ("std_msgs/msg/Float64MultiArray", True),
    SUMMARY: ("diagnostic_msgs/msg/DiagnosticArray", True),
}
# A summary may be recorded a little before what it was made from: it waits for this much of the log [ns].
_PATIENCE = 500_000_000
_REMEMBERED = 3000  # blocks, 30 s of them

Write = Callable[[Iterable[Message], int], None]


@dataclass(frozen=True)
class EstimateReport:
    """What was computed: recorded and computing time [s], messages by topic.

    `unexplained` counts summaries whose causes the log does not hold, `rejected` what the live nodes would refuse too.
    """

    recorded: float
    computing: float
    counts: dict[str, int] = field(default_factory=dict)
    unexplained: int = 0
    rejected: int = 0

    @property
    def speed(self) -> float:
        """Recorded seconds per second."""
        return self.recorded / self.computing if self.computing > 0.0 else math.inf


def estimate_bag(source: str | Path, directory: str | Path) -> EstimateReport:
    """Compute friction and stability again and write them into a new bag, under the topics of the live nodes.

    The estimator's settings are those of the recorded node where the bag tells them. Summaries of stability are made
    for the same causes as the recorded ones; where none were recorded, whenever the node would have been due.

    Raises:
        RecordingError: the bag cannot be read, is no recording of the rig, or the new one cannot be written.
    """
    began = time.perf_counter()
    bag = Bag(source)
    joiner = BlockJoiner(bag)
    if bag.topics[str(joiner.topics[DESCRIPTION])].message_count == 0:
        raise RecordingError(f"{source} holds no message on {DESCRIPTION}: the rig's constants are not known")
    prefix = str(joiner.topics[DAQ])[: -len(DAQ)]
    facts = {f"source.{key}": value for key, value in bag.custom_data.items()}
    counts = dict.fromkeys(ESTIMATED, 0)
    with BagWriter(directory, custom_data=provenance() | facts | {"estimated_from": bag.path.name}) as writer:
        handles = {}
        for name, (kind, latched) in ESTIMATED.items():
            topic = prefix + name
            handles[name] = writer.add_topic(topic, kind, _qos(bag, topic, latched), schema_of(bag, kind))

        def write(messages: Iterable[Message], log_time: int) -> None:
            """Write messages under the log time [ns] of what they were computed from."""
            for name, data in messages:
                writer.write(handles[name], data, log_time, log_time)
                counts[name] += 1

        summaries = bag.topics.get(prefix + SUMMARY)
        live = [summaries.name] if summaries is not None and summaries.message_count else []
        work = _Estimation(
            recorded_settings(bag, f"{prefix}friction_estimator"), OfflineStability(write, summaries), write
        )
        for message in bag.messages([*joiner.names, *live]):
            if message.topic in live:
                work.stability.take_recorded(message)
                continue
            with work.refusing():
                for block in joiner.take(message):
                    work.take(block)
            if joiner.rig is not None:
                work.stability.take_rig(joiner.rig, message.log_time)
        for block in joiner.rest():
            with work.refusing():
                work.take(block)
        work.stability.finish()
    took = time.perf_counter() - began
    return EstimateReport(bag.duration, took, counts, work.stability.unexplained, work.rejected)


def recorded_settings(bag: Bag, node: str) -> FrictionSettings:
    """Settings the live estimator ran with, where the bag tells them; the defaults elsewhere."""
    known = declarations(FrictionSettings)
    for record in bag.metadata_records:
        if record.name == AT_START:
            try:
                name, _, values = parameters_of(record.values)
            except RecordingError:
                continue
            if name == node:
                return FrictionSettings.from_mapping({key: values[key] for key in known if key in values})
    return FrictionSettings()


def schema_of(bag: Bag, type_name: str) -> MessageSchema:
    """The definition of a type: any topic's of the bag, else the one installed.

    Raises:
        RecordingError: neither is there.
    """
    for topic in bag.topics.values():
        if topic.type_name == type_name and topic.schema.text:
            return topic.schema
    try:
        return installed_schema(type_name)
    except RecordingError:
        raise RecordingError(
            f"{bag.path} carries no definition of {type_name}, and none is installed: record /diagnostics,"
            " friction/* and stability/* too, or install ROS 2's common_interfaces."
        ) from None


def _qos(bag: Bag, topic: str, latched: bool) -> tuple[QosProfile, ...]:
    known = bag.topics.get(topic)
    if known is not None and known.qos:
        return known.qos
    return (QosProfile(depth=1, durability="transient_local") if latched else QosProfile(),)


class _Estimation:
    """What the nodes `friction_estimator` and `stability` do, fed from a bag."""

    def __init__(self, settings: FrictionSettings, stability: OfflineStability, write: Write) -> None:
        self._friction = FrictionFollower(settings)
        self._write = write
        self.stability = stability
        self.rejected = 0

    def take(self, block: RecordedBlock) -> None:
        """Take the next block."""
        self._friction.take_rig(block.rig)
        messages = self._friction.take_block(block.stamp, block.daq)
        with self.refusing():
            self.stability.take_block(InForce.after(block.daq, block.rig), block.log_time)
        if block.truth is not None:
            messages += self._friction.take_truth(block.truth)
        self._write(messages, block.log_time)
        for name, data in messages:
            if name == WINDOWS:
                with self.refusing():
                    self.stability.take_estimate(Estimate.of(block_from_cdr(data, FRICTION_WINDOW_NEEDED).samples[0]))

    @contextmanager
    def refusing(self) -> Iterator[None]:
        """What a live node refuses and counts is refused and counted."""
        try:
            yield
        except DiskError:
            raise
        except SquealRigError:
            self.rejected += 1


class OfflineStability:
    """Makes the summaries and writes them.

    A recorded summary says from which description, sample and window it was made; the same is made again from the log.
    `unexplained` counts those whose causes the log does not hold. Where none are recorded (`recorded` is None or has no
    message) a summary is made whenever the node would be due.
    """

    def __init__(self, write: Write, recorded: TopicInfo | None) -> None:
        self._write = write
        self._decode = decoder_of(recorded.schema) if recorded is not None and recorded.message_count else None
        self._follower = StabilityFollower()
        self._rig: RigDescription | None = None
        self._rigs: dict[str, RigDescription] = {}
        self._blocks: OrderedDict[str, InForce] = OrderedDict()
        self._windows: OrderedDict[str, Estimate] = OrderedDict()
        self._pending: deque[tuple[int, int, dict[str, str]]] = deque()
        self.unexplained = 0

    def take_rig(self, rig: RigDescription, now: int) -> None:
        """Take the description in force at a log time [ns]; nothing happens where it is the known one."""
        if rig is self._rig:
            return
        changed, self._rig = rig != self._rig, rig
        self._rigs[description_crc(rig)] = rig
        if changed:
            self._follower.take_rig(rig)
            wanted = self._follower.lacks_hard_squeal() if self._decode is None else None
            if wanted is not None:
                self._follower.take_hard_squeal(wanted, hard_squeal(wanted))
            self._schedule(now)

    def take_block(self, in_force: InForce, now: int) -> None:
        """Take what is in force at the end of a block."""
        _remember(self._blocks, str(in_force.sample), in_force)
        self._follower.take_block(in_force)
        self._schedule(now)

    def take_estimate(self, estimate: Estimate) -> None:
        """Take a window's friction coefficient."""
        _remember(self._windows, text_of(estimate.window_end), estimate)
        self._follower.take_estimate(estimate)

    def take_recorded(self, message: RawMessage) -> None:
        """Take a recorded summary: its causes are to be evaluated again."""
        if self._decode is None:
            return
        decoded = self._decode(message.data)
        try:
            causes = {pair.key: pair.value for status in decoded.status for pair in status.values}
            stamp = decoded.header.stamp.sec * 10**9 + decoded.header.stamp.nanosec
        except (AttributeError, TypeError):
            raise RecordingError(f"{message.topic} holds no messages of {ESTIMATED[SUMMARY][0]}.") from None
        if DESCRIPTION_KEY not in causes:
            self._decode = None  # of a version that named no causes
            return
        self._pending.append((message.log_time, stamp, causes))

    def finish(self) -> None:
        """Evaluate what still waits."""
        while self._pending:
            self._repeat(*self._pending.popleft())

    def _schedule(self, now: int) -> None:
        if self._decode is None:
            if self._follower.is_due(now * 1e-9):
                self._write(self._follower.summary(now * 1e-9, now), now)
            return
        while self._pending and now - self._pending[0][0] > _PATIENCE:
            self._repeat(*self._pending.popleft())

    def _repeat(self, log_time: int, stamp: int, causes: dict[str, str]) -> None:
        """Make the summary again that names these causes."""
        rig = self._rigs.get(causes.get(DESCRIPTION_KEY, ""))
        in_force = self._blocks.get(causes.get(SAMPLE_KEY, ""))
        estimate = self._windows.get(causes.get(WINDOW_KEY, ""))
        missing = (SAMPLE_KEY in causes and in_force is None) or (WINDOW_KEY in causes and estimate is None)
        if rig is None or missing:
            self.unexplained += 1
            return
        hard = None
        if STATE_KEY in causes:
            hard = pending() if causes[STATE_KEY] == COMPUTING else hard_squeal(rig.parameters)
        self._write(summary_of(rig, in_force, estimate, stamp, hard), log_time)


def _remember(known: OrderedDict[str, Any], key: str, value: Any) -> None:
    known[key] = value
    while len(known) > _REMEMBERED:
        known.popitem(last=False)


@dataclass(frozen=True)
class TopicComparison:
    """Messages recorded, computed again, and how many of the recorded ones are among those, equal in every field."""

    topic: str
    recorded: int
    computed: int
    equal: int


def compare_estimates(recorded: Bag, computed: Bag) -> list[TopicComparison]:
    """Compare the estimated topics of both bags; floats must be equal bit for bit, padding does not count.

    Of samples and windows those fields count that the recorded bag has: later versions append some.
    """
    comparisons = []
    for name in sorted(topic for topic in computed.topics if topic.endswith(tuple(ESTIMATED))):
        if name in recorded.topics:
            fields = _cloud_fields(recorded, name)
            first, second = _fingerprints(recorded, name, fields), _fingerprints(computed, name, fields)
            equal = sum((first & second).values())
            comparisons.append(TopicComparison(name, first.total(), second.total(), equal))
    return comparisons


def _cloud_fields(bag: Bag, topic: str) -> tuple[str, ...]:
    """Fields of a topic's samples as its first message has them; none where it is of another type, or empty."""
    if bag.topics[topic].type_name != CLOUD_TYPE:
        return ()
    first = next(iter(bag.messages([topic])), None)
    return samples_from_cdr(first.data).samples.dtype.names or () if first is not None else ()


def _fingerprints(bag: Bag, topic: str, fields: tuple[str, ...]) -> Counter[bytes]:
    """Digests of all decoded fields of every message; of samples the named ones."""
    known = bag.topics[topic]
    if known.type_name == CLOUD_TYPE:
        return Counter(_cloud_fingerprint(message.data, fields) for message in bag.messages([topic]))
    decode = decoder_of(known.schema)
    # repr of a float tells every bit of it but those of a nan
    texts = (repr(as_mapping(decode(message.data))) for message in bag.messages([topic]))
    return Counter(hashlib.blake2b(text.encode(), digest_size=16).digest() for text in texts)


def _cloud_fingerprint(data: bytes, fields: tuple[str, ...]) -> bytes:
    stamp, frame, samples = samples_from_cdr(data)
    kinds = [(name, samples.dtype[name].str) for name in fields if name in (samples.dtype.names or ())]
    digest = hashlib.blake2b(f"{stamp} {frame} {kinds}".encode(), digest_size=16)
    for name, _ in kinds:
        digest.update(samples[name].tobytes())
    return digest.digest()
