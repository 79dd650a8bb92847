"""What a bag holds, as a table."""

from __future__ import annotations

from datetime import datetime, timezone
from pathlib import Path

from rich.console import Group
from rich.table import Table

from squeal_rig.recording import Bag


def bag_info(path: Path | str) -> Group:
    """Size, time, ending, provenance and topics of a bag, to print.

    Raises:
        RecordingError: the bag cannot be read.
    """
    bag = Bag(path)
    facts = Table(title=f"Bag {bag.path}", title_justify="left", show_header=False)
    facts.add_column(style="bold")
    facts.add_column()
    size = sum(file.stat().st_size for file in bag.files)
    facts.add_row("files", f"{len(bag.files)}, {size / 1e6:.2f} MB")
    start = datetime.fromtimestamp(bag.start_time * 1e-9, timezone.utc)
    facts.add_row("start", f"{start:%Y-%m-%d %H:%M:%S} UTC")
    facts.add_row("duration", f"{bag.duration:.3f} s")
    facts.add_row("messages", str(bag.message_count))
    for key, value in bag.custom_data.items():
        facts.add_row(key, str(value))
    topics = Table(title="Topics", title_justify="left")
    for column, justify in (
        ("topic", "left"),
        ("type", "left"),
        ("messages", "right"),
        ("rate [Hz]", "right"),
    ):
        topics.add_column(column, justify=justify)  # type: ignore[arg-type]
    for name, topic in sorted(bag.topics.items()):
        rate = f"{topic.message_count / bag.duration:.1f}" if bag.duration > 0.0 else "-"
        topics.add_row(name, topic.type_name, str(topic.message_count), rate)
    return Group(facts, topics)
