"""Settings of recorder and player."""

from __future__ import annotations

from dataclasses import dataclass

from squeal_rig.model.declared import Declared, quantity

#: What a run is understood from; names are relative to the rig's namespace, but for the absolute ones.
DEFAULT_TOPICS = (
    "rig/description",
    "daq/samples",
    "truth/samples",
    "pad/state",
    "contact/wrench",
    "friction/mu",
    "friction/windows",
    "friction/samples",
    "friction/model",
    "stability/eigenvalues",
    "stability/summary",
    "squeal/state",
    "/diagnostics",
    "/parameter_events",
    "/rosout",
    "/clock",
)


@dataclass(frozen=True)
class RecorderSettings(Declared):
    """Settings of the recorder."""

    directory: str = quantity("", "bag to write, a new folder; bags/<UTC stamp> when empty", read_only=True)
    topics: tuple[str, ...] = quantity(
        DEFAULT_TOPICS, "topics to record; '*' is every topic of the graph", read_only=True
    )
    compression: str = quantity("zstd", "compression of the chunks", options=("zstd", "none"), read_only=True)


@dataclass(frozen=True)
class PlayerSettings(Declared):
    """Settings of the player."""

    bag: str = quantity("", "bag to play: a folder or an .mcap file", read_only=True)
    rate: float = quantity(
        1.0,
        "speed of the replay: 1 is as recorded, 0 as fast as possible",
        lower=0.0,
        upper=100.0,
        read_only=True,
    )
    topics: tuple[str, ...] = quantity(
        ("daq/*", "truth/*", "rig/description"),
        "topics to play, patterns with * and ?, in any namespace",
        read_only=True,
    )
    clock: bool = quantity(False, "publish the recorded time on /clock", read_only=True)
    wait_for_subscribers: float = quantity(
        0.0,
        "longest wait at start for a subscriber to every topic played",
        unit="s",
        lower=0.0,
        upper=600.0,
        read_only=True,
    )
    max_rate: float = quantity(
        50.0,
        "most data published per second at rate 0",
        unit="MB/s",
        lower=0.1,
        upper=10000.0,
        read_only=True,
    )
