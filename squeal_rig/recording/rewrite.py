"""New bags out of others: a piece of one, or several in one. Payloads, times, types and QoS stay as they are."""

from __future__ import annotations

import heapq
from collections.abc import Collection, Iterator, Mapping, Sequence
from operator import itemgetter
from pathlib import Path

from squeal_rig.errors import RecordingError

from .reader import Bag, RawMessage
from .replay import is_latched, last_before, matching_topics
from .schemas import MessageSchema
from .writer import BagWriter, ChannelHandle

_ENDING = "ending"


def cut(
    source: str | Path,
    directory: str | Path,
    start: float = 0.0,
    end: float | None = None,
    topics: Sequence[str] = (),
) -> int:
    """Copy start <= t < end [s] after the bag's first message; returns the number of messages.

    topics: patterns as the player takes them, all where there are none. The last value of a latched topic from before
    the start comes first, with the start as its log time: without the rig's description the rest says little.
    Raises RecordingError where nothing is left or the bags cannot be read or written.
    """
    bag = Bag(source)
    if end is not None and not end > start:
        raise RecordingError(f"end = {end:g} s must be above start = {start:g} s.")
    if not 0.0 <= start <= bag.duration:
        raise RecordingError(f"start = {start:g} s is not within the bag, which is {bag.duration:.3f} s long.")
    chosen = list(bag.topics) if not topics else matching_topics(bag.topics, topics)
    if not chosen:
        raise RecordingError(f"No topic of {bag.path} matches {', '.join(topics)}.")
    first = bag.start_time + round(start * 1e9)
    last = None if end is None else bag.start_time + round(min(end, bag.duration + 1.0) * 1e9)
    facts = dict(bag.custom_data)
    ending = facts.pop(_ENDING, "")
    facts |= {"cut_from": bag.path.name, "cut_start_s": f"{start!r}", "cut_end_s": "" if end is None else f"{end!r}"}
    with BagWriter(directory, custom_data=facts) as writer:
        handles = _handles(writer, bag, chosen)
        latched = [name for name in chosen if start > 0.0 and is_latched(bag.topics[name].qos)]
        for message in last_before(bag, latched, first):
            writer.write(handles[message.topic], message.data, first, message.publish_time)
        # From the beginning is all: a damaged file may hold messages from before what its index calls the first.
        for message in bag.messages(chosen, first if start > 0.0 else None, last):
            writer.write(handles[message.topic], message.data, message.log_time, message.publish_time)
        _copy_records(writer, bag)
        if writer.message_count == 0:
            until = "the end" if end is None else f"{end:g} s"
            raise RecordingError(f"{bag.path} has no message from {start:g} s to {until}.")
        writer.close(f"cut from a bag that ended: {ending}" if ending else "cut from a bag")
    return writer.message_count


def merge(sources: Sequence[str | Path], directory: str | Path) -> int:
    """Put several bags into one, in log-time order; returns the number of messages.

    Raises RecordingError where a topic has two types or a type two definitions, or the bags cannot be read or written.
    """
    bags = [Bag(source) for source in sources]
    if len(bags) < 2:
        raise RecordingError(f"Two bags or more can be merged, into a new folder named last; bags given: {len(bags)}.")
    facts: dict[str, str] = {"merged_from": ", ".join(bag.path.name for bag in bags)}
    for number, bag in enumerate(bags):
        facts |= {f"{number}.{key}": value for key, value in bag.custom_data.items()}
    _check_definitions(bags)
    with BagWriter(directory, custom_data=facts) as writer:
        handles: dict[str, ChannelHandle] = {}
        for bag in bags:
            handles |= _handles(writer, bag, list(bag.topics))
            _copy_records(writer, bag)
        for _, _, message in heapq.merge(*(_keyed(bag, n) for n, bag in enumerate(bags)), key=itemgetter(0, 1)):
            writer.write(handles[message.topic], message.data, message.log_time, message.publish_time)
        writer.close("merged from " + str(len(bags)) + " bags")
    return writer.message_count


def _check_definitions(bags: Sequence[Bag]) -> None:
    """Readers know a type by its name: messages of a second definition would be read by the first."""
    known: dict[str, tuple[Bag, MessageSchema]] = {}
    for bag in bags:
        for topic in bag.topics.values():
            first, schema = known.setdefault(topic.type_name, (bag, topic.schema))
            changed = schema.conflict(topic.schema)
            if changed is not None:
                raise RecordingError(
                    f"{bag.path}: {changed} of {topic.name} has other fields than in {first.path};"
                    " one bag cannot hold both."
                )


def _keyed(bag: Bag, number: int) -> Iterator[tuple[int, int, RawMessage]]:
    return ((message.log_time, number, message) for message in bag.messages())


def _handles(writer: BagWriter, bag: Bag, topics: Collection[str]) -> Mapping[str, ChannelHandle]:
    handles = {}
    for name in topics:
        topic = bag.topics[name]
        if topic.serialization_format != "cdr":
            raise RecordingError(f"{bag.path}: {name} is stored as {topic.serialization_format!r}, not as cdr.")
        handles[name] = writer.add_topic(name, topic.type_name, topic.qos, topic.schema)
    return handles


def _copy_records(writer: BagWriter, bag: Bag) -> None:
    for record in bag.metadata_records:
        writer.add_metadata(record.name, record.values)
