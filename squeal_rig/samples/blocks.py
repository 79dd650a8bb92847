"""The rig's blocks out of a bag, in order, with the description that held for each."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from squeal_rig.errors import RecordingError
from squeal_rig.instruments.channels import DAQ_CHANNELS, TRUTH_CHANNELS, block_from_cdr
from squeal_rig.instruments.description import RigDescription
from squeal_rig.instruments.numbering import samples_ahead
from squeal_rig.recording import Bag, RawMessage, decoder_of
from squeal_rig.recording.gaps import CLOUD_TYPE

# Blocks that wait for their truth, and truths for their block: a recorder that was held up takes what has piled up
# topic by topic. More than its queues hold (`graph.qos.BLOCKS_IN`).
_MOST_WAITING = 512
DESCRIPTION, DAQ, TRUTH = "rig/description", "daq/samples", "truth/samples"


@dataclass(frozen=True)
class RecordedBlock:
    """A block as recorded: stamp [ns], samples, truth of the same samples or None, description in force.

    `log_time` is when the samples were recorded [ns].
    """

    stamp: int
    daq: Any
    truth: Any
    rig: RigDescription
    log_time: int = 0


def rig_topic(bag: Bag, name: str) -> str | None:
    """The bag's topic of that relative name, in whatever namespace; None where there is none.

    Raises:
        RecordingError: the bag holds more than one rig.
    """
    found = [topic for topic in bag.topics if topic == f"/{name}" or topic.endswith(f"/{name}")]
    if len(found) > 1:
        raise RecordingError(
            f"{bag.path} holds {len(found)} topics {name}: {', '.join(sorted(found))}; one rig at a time"
        )
    return found[0] if found else None


def text_reader(bag: Bag, topic: str) -> Callable[[bytes], str]:
    """A function from the messages of a topic to their texts; RecordingError, also from it, where they hold none."""
    decode = decoder_of(bag.topics[topic].schema)

    def read(data: bytes) -> str:
        text = getattr(decode(data), "data", None)
        if not isinstance(text, str):
            raise RecordingError(f"{bag.path}: {topic} is {bag.topics[topic].type_name}, which holds no text.")
        return text

    return read


class BlockJoiner:
    """Joins `daq/samples` with `truth/samples` by `seq`, message by message, in bounded memory."""

    def __init__(self, bag: Bag) -> None:
        self.path = bag.path
        self.topics = {name: rig_topic(bag, name) for name in (DESCRIPTION, DAQ, TRUTH)}
        for name in (DESCRIPTION, DAQ):
            if self.topics[name] is None:
                raise RecordingError(f"{bag.path} has no topic {name}: not a recording of the rig")
        for name in (DAQ, TRUTH):
            topic = bag.topics.get(str(self.topics[name]))
            if topic is not None and topic.type_name != CLOUD_TYPE:
                raise RecordingError(f"{bag.path}: {topic.name} is {topic.type_name}, not {CLOUD_TYPE}")
        self._text = text_reader(bag, str(self.topics[DESCRIPTION]))
        self.rig: RigDescription | None = None
        self._waiting: deque[tuple[int, Any, int, RigDescription | None]] = deque()
        self._truths: dict[int, tuple[int, Any]] = {}  # by number: stamp [ns] and samples
        self._last_block: int | None = None
        self._last_truth: int | None = None

    @property
    def names(self) -> list[str]:
        """The bag's topics to read."""
        return [topic for topic in self.topics.values() if topic is not None]

    def take(self, message: RawMessage) -> Iterator[RecordedBlock]:
        """Take the next message of one of `names`; yields the blocks that are whole now."""
        if message.topic == self.topics[DESCRIPTION]:
            self.rig = RigDescription.from_yaml(self._text(message.data))
            return
        channels = TRUTH_CHANNELS if message.topic == self.topics[TRUTH] else DAQ_CHANNELS
        stamp, _, samples = block_from_cdr(message.data, channels)
        if samples["seq"].dtype.kind not in "ui":
            raise RecordingError(f"{message.topic} numbers its samples in {samples['seq'].dtype}, not in whole numbers")
        if message.topic == self.topics[TRUTH]:
            self._last_truth = int(samples["seq"][0])
            self._truths[self._last_truth] = (stamp, samples)
        else:
            seq = int(samples["seq"][0])
            if self._last_block is not None and samples_ahead(seq, self._last_block) <= 0:
                # Another run: the truths of the one before tell nothing of its blocks, whatever their numbers.
                self._last_truth = None
                oldest = self._waiting[0][0] if self._waiting else stamp
                self._truths = {n: truth for n, truth in self._truths.items() if truth[0] >= min(oldest, stamp)}
            self._last_block = seq
            self._waiting.append((stamp, samples, message.log_time, self.rig))
        while self._waiting and self.rig is not None and not self._truth_may_come():
            yield self._next(self.rig)
        while len(self._truths) > _MOST_WAITING:  # those whose block was lost
            self._truths.pop(next(iter(self._truths)))

    def _truth_may_come(self) -> bool:
        """Whether the truth of the block that has waited longest is not here, and can be on its way still."""
        first = int(self._waiting[0][1]["seq"][0])
        if first in self._truths or self.topics[TRUTH] is None or len(self._waiting) > _MOST_WAITING:
            return False
        return self._last_truth is None or samples_ahead(self._last_truth, first) < 0  # they come in order

    def rest(self) -> Iterator[RecordedBlock]:
        """Yield the blocks still waiting at the end of the bag."""
        if self.rig is None:
            raise RecordingError(f"{self.path} holds no message on {DESCRIPTION}: the rig's constants are not known")
        while self._waiting:
            yield self._next(self.rig)

    def _next(self, rig: RigDescription) -> RecordedBlock:
        stamp, daq, log_time, known = self._waiting.popleft()
        _, truth = self._truths.pop(int(daq["seq"][0]), (stamp, None))
        return RecordedBlock(stamp, daq, truth, known or rig, log_time)


def recorded_blocks(bag: Bag) -> Iterator[RecordedBlock]:
    """Blocks of `daq/samples` joined with `truth/samples` by `seq`, in bounded memory.

    Raises:
        RecordingError: no samples or no description in the bag, or a message is damaged.
    """
    joiner = BlockJoiner(bag)
    for message in bag.messages(joiner.names):
        yield from joiner.take(message)
    yield from joiner.rest()
