"""The rig's blocks out of a bag, in order, with the description that held for each."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from squeal_rig.errors import RecordingError
from squeal_rig.instruments.channels import DAQ_CHANNELS, TRUTH_CHANNELS, block_from_cdr
from squeal_rig.instruments.description import RigDescription
from squeal_rig.recording import Bag, RawMessage, decoder_of
from squeal_rig.recording.gaps import CLOUD_TYPE

_MAX_TRUTHS = 16
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
        self._waiting: list[tuple[int, Any, int]] = []
        self._truths: dict[int, Any] = {}

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
            self._truths[int(samples["seq"][0])] = samples
        else:
            self._waiting.append((stamp, samples, message.log_time))
        # Truth follows its block within the same callback of the rig: one block of patience is enough.
        while self._waiting and self.rig is not None:
            first = int(self._waiting[0][1]["seq"][0])
            if first not in self._truths and self.topics[TRUTH] is not None and len(self._waiting) < 3:
                break
            yield self._next(self.rig)
        while len(self._truths) > _MAX_TRUTHS:  # those whose block was lost
            self._truths.pop(next(iter(self._truths)))

    def rest(self) -> Iterator[RecordedBlock]:
        """Yield the blocks still waiting at the end of the bag."""
        if self.rig is None:
            raise RecordingError(f"{self.path} holds no message on {DESCRIPTION}: the rig's constants are not known")
        while self._waiting:
            yield self._next(self.rig)

    def _next(self, rig: RigDescription) -> RecordedBlock:
        stamp, daq, log_time = self._waiting.pop(0)
        return RecordedBlock(stamp, daq, self._truths.pop(int(daq["seq"][0]), None), rig, log_time)


def recorded_blocks(bag: Bag) -> Iterator[RecordedBlock]:
    """Blocks of `daq/samples` joined with `truth/samples` by `seq`, in bounded memory.

    Raises:
        RecordingError: no samples or no description in the bag, or a message is damaged.
    """
    joiner = BlockJoiner(bag)
    for message in bag.messages(joiner.names):
        yield from joiner.take(message)
    yield from joiner.rest()
