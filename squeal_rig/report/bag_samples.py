"""The rig's blocks out of a bag, in order, with the description that held for each."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from squeal_rig.errors import RecordingError
from squeal_rig.instruments.channels import DAQ_CHANNELS, TRUTH_CHANNELS, block_from_cdr
from squeal_rig.instruments.description import RigDescription
from squeal_rig.recording import Bag, as_mapping, decoder_of

DESCRIPTION, DAQ, TRUTH = "rig/description", "daq/samples", "truth/samples"


@dataclass(frozen=True)
class RecordedBlock:
    """A block as recorded: stamp [ns], samples, truth of the same samples or None, description in force."""

    stamp: int
    daq: Any
    truth: Any
    rig: RigDescription


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


def recorded_blocks(bag: Bag) -> Iterator[RecordedBlock]:
    """Blocks of `daq/samples` joined with `truth/samples` by `seq`, in bounded memory.

    Raises:
        RecordingError: no samples or no description in the bag, or a message is damaged.
    """
    topics = {name: rig_topic(bag, name) for name in (DESCRIPTION, DAQ, TRUTH)}
    for name in (DESCRIPTION, DAQ):
        if topics[name] is None:
            raise RecordingError(f"{bag.path} has no topic {name}: not a recording of the rig")
    decode = decoder_of(bag.topics[topics[DESCRIPTION]].schema)  # type: ignore[index]
    rig: RigDescription | None = None
    waiting: list[tuple[int, Any]] = []
    truths: dict[int, Any] = {}
    for message in bag.messages([topic for topic in topics.values() if topic is not None]):
        if message.topic == topics[DESCRIPTION]:
            rig = RigDescription.from_yaml(as_mapping(decode(message.data))["data"])
            continue
        stamp, _, samples = block_from_cdr(
            message.data, TRUTH_CHANNELS if message.topic == topics[TRUTH] else DAQ_CHANNELS
        )
        if message.topic == topics[TRUTH]:
            truths[int(samples["seq"][0])] = samples
        else:
            waiting.append((stamp, samples))
        # Truth follows its block within the same callback of the rig: one block of patience is enough.
        while waiting and rig is not None:
            stamp, daq = waiting[0]
            truth = truths.pop(int(daq["seq"][0]), None)
            if truth is None and topics[TRUTH] is not None and len(waiting) < 3:
                break
            waiting.pop(0)
            yield RecordedBlock(stamp, daq, truth, rig)
    if rig is None:
        raise RecordingError(f"{bag.path} holds no message on {DESCRIPTION}: the rig's constants are not known")
    for stamp, daq in waiting:
        yield RecordedBlock(stamp, daq, truths.pop(int(daq["seq"][0]), None), rig)
