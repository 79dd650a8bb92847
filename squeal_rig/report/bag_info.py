"""What a bag holds, as a table."""

from __future__ import annotations

from datetime import datetime, timezone
from pathlib import Path

from rich.console import Group, RenderableType
from rich.table import Table

from squeal_rig.errors import RecordingError
from squeal_rig.recording import Bag, decoder_of
from squeal_rig.recording.gaps import CLOUD_TYPE, SampleCount
from squeal_rig.recording.messages import statuses
from squeal_rig.recording.parameter_log import AT_START, CHANGE
from squeal_rig.safety.levels import Level

_TRIPS = "supervisor/trips"
_TRIP_LEVELS = (Level.RAMP_DOWN.words, Level.STOP.words)
_MOST_TRIPS = 5  # shown; the others are counted


def bag_info(path: Path | str, quick: bool = False) -> Group:
    """Size, time, ending, provenance, topics and samples of a bag, to print.

    quick: read the indexes only; no samples are counted, no trips told.

    Raises:
        RecordingError: the bag cannot be read.
    """
    bag = Bag(path)
    facts = _facts(bag)
    for trip in [] if quick else _trips(bag):
        facts.add_row("supervisor", trip)
    parts: list[RenderableType] = [facts, _topics(bag)]
    counts = {} if quick else sample_counts(bag)
    if counts:
        parts.append(_samples(counts))
    return Group(*parts)


def sample_counts(bag: Bag) -> dict[str, SampleCount]:
    """Samples, gaps by `seq`, rejected samples and damaged blocks of each topic of samples."""
    counts = {name: SampleCount() for name, topic in bag.topics.items() if topic.type_name == CLOUD_TYPE}
    for message in bag.messages(list(counts)):
        counts[message.topic].add(message.data)
    return counts


def _facts(bag: Bag) -> Table:
    facts = Table(title=f"Bag {bag.path}", title_justify="left", show_header=False)
    facts.add_column(style="bold")
    facts.add_column()
    size = sum(file.stat().st_size for file in bag.files)
    facts.add_row("files", f"{len(bag.files)}, {size / 1e6:.2f} MB")
    facts.add_row("start", _moment(bag.start_time))
    facts.add_row("duration", f"{bag.duration:.3f} s")
    facts.add_row("messages", str(bag.message_count))
    facts.add_row("ended", bag.ending or "the bag does not say")
    for key, value in bag.custom_data.items():
        if key != "ending":
            facts.add_row(key, value)
    records = bag.metadata_records
    nodes = sorted({record.values.get("node", "") for record in records if record.name == AT_START})
    if nodes:
        facts.add_row("parameters of", ", ".join(nodes))
    changes = sum(record.name == CHANGE for record in records)
    facts.add_row("parameter changes", str(changes))
    for record in records:
        if record.name == "snapshot":
            values = record.values
            facts.add_row("snapshot", f"{values.get('reason', '')}, {values.get('seconds', '?')} s")
    return facts


def _trips(bag: Bag) -> list[str]:
    """What the supervisor took the rig out of operation for, and when: a bag's end says that of the recording only."""
    told: list[str] = []
    more = 0
    try:
        for name in [topic for topic in bag.topics if f"/{topic}".endswith(f"/{_TRIPS}")]:
            decode = decoder_of(bag.topics[name].schema)
            for message in bag.messages([name]):
                seconds = (message.publish_time - bag.start_time) * 1e-9
                if seconds < 0.0:  # latched: a recorder that comes later gets those of before, too
                    continue
                for _, (_, sentence, values) in statuses(decode(message.data)):
                    if values.get("raised the level") != "true" or values.get("level") not in _TRIP_LEVELS:
                        continue
                    if len(told) < _MOST_TRIPS:
                        told.append(f"{values['level']} at {seconds:.1f} s: {sentence}")
                    else:
                        more += 1
    except RecordingError as error:
        told.append(f"its trips cannot be read: {error}")
    return [*told, f"{more} more"] if more else told


def _moment(time: int) -> str:
    """A time [ns] for people; as it is where their calendar ends."""
    try:
        return f"{datetime.fromtimestamp(time * 1e-9, timezone.utc):%Y-%m-%d %H:%M:%S} UTC"
    except (ValueError, OverflowError, OSError):
        return f"{time} ns"


def _topics(bag: Bag) -> Table:
    topics = Table(title="Topics", title_justify="left")
    for column, justify in (("topic", "left"), ("type", "left"), ("messages", "right"), ("rate [Hz]", "right")):
        topics.add_column(column, justify=justify)  # type: ignore[arg-type]
    for name, topic in sorted(bag.topics.items()):
        begin, end = bag.time_span(name)
        rate = f"{(topic.message_count - 1) / (end - begin) * 1e9:.1f}" if end > begin else "-"
        topics.add_row(name, topic.type_name, str(topic.message_count), rate)
    return topics


def _samples(counts: dict[str, SampleCount]) -> Table:
    table = Table(title="Samples", title_justify="left")
    table.add_column("topic")
    for column in ("samples", "gaps", "lost", "rejected", "damaged blocks"):
        table.add_column(column, justify="right")
    for name, count in sorted(counts.items()):
        gaps, lost = (str(count.gaps), str(count.lost)) if count.counted else ("-", "-")
        table.add_row(name, str(count.samples), gaps, lost, str(count.rejected), str(count.damaged))
    return table
