"""Settings of recorder and player."""

from __future__ import annotations

from dataclasses import dataclass

from squeal_rig.configuration.declared import Declared, quantity
from squeal_rig.errors import ParameterError

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
    "run/events",
    "rig/safe",
    "emergency_stop",
    "supervisor/state",
    "supervisor/trips",
    "/diagnostics",
    "/parameter_events",
    "/rosout",
    "/clock",
)


MODES = ("continuous", "snapshot")
_SLOWEST = 0.01


@dataclass(frozen=True)
class RecorderSettings(Declared):
    """Settings of the recorder."""

    directory: str = quantity("", "bag to write, a new folder; bags/<UTC stamp> when empty", read_only=True)
    topics: tuple[str, ...] = quantity(
        DEFAULT_TOPICS, "topics to record; '*' is every topic of the graph, 'daq/*' a pattern", read_only=True
    )
    compression: str = quantity("zstd", "compression of the chunks", options=("zstd", "none"), read_only=True)
    autostart: bool = quantity(True, "start at once; otherwise ~/start does", read_only=True)
    max_file_size: float = quantity(
        0.0, "size at which the bag goes on in a new file; 0 is never", unit="MB", lower=0.0, upper=1e7, read_only=True
    )
    max_file_duration: float = quantity(
        0.0,
        "time after which the bag goes on in a new file; 0 is never",
        unit="s",
        lower=0.0,
        upper=1e7,
        read_only=True,
    )
    disk_reserve: float = quantity(
        64.0,
        "space of the disk left free: the recording ends before it is used",
        unit="MB",
        lower=0.0,
        upper=1e7,
        read_only=True,
    )
    mode: str = quantity(
        "continuous",
        "continuous writes everything; snapshot keeps the last seconds in memory until they are asked for",
        options=MODES,
        read_only=True,
    )
    snapshot_duration: float = quantity(
        10.0, "time kept in memory for a snapshot", unit="s", lower=0.1, upper=3600.0, read_only=True
    )
    snapshot_memory: float = quantity(
        512.0, "most memory that a snapshot may take", unit="MB", lower=0.1, upper=1e6, read_only=True
    )
    snapshot_on_squeal: bool = quantity(True, "write a snapshot when squeal begins")
    snapshot_delay: float = quantity(
        2.0,
        "time a snapshot waits after squeal has begun, so that it shows the beginning and what follows",
        unit="s",
        lower=0.0,
        upper=3600.0,
    )


@dataclass(frozen=True)
class PlayerSettings(Declared):
    """Settings of the player."""

    bag: str = quantity("", "bag to play: a folder or an .mcap file", read_only=True)
    rate: float = quantity(
        1.0,
        "speed of the replay: 1 is as recorded, 0.01 the slowest, 0 as fast as max_rate lets",
        lower=0.0,
        upper=100.0,
    )
    topics: tuple[str, ...] = quantity(
        ("daq/*", "truth/*", "rig/description"),
        "topics to play, patterns with * and ?, in any namespace",
        read_only=True,
    )
    remap: tuple[str, ...] = quantity(
        (), "topics to play under another name: /from:=/to, or /from/:=/to/ for a namespace", read_only=True
    )
    start_offset: float = quantity(
        0.0, "where to begin, after the bag's first message", unit="s", lower=0.0, upper=1e9, read_only=True
    )
    seek_to: float = quantity(
        0.0, "setting it goes on from there, after the bag's first message", unit="s", lower=0.0, upper=1e9
    )
    loop: bool = quantity(False, "begin again at start_offset when the bag ends")
    start_paused: bool = quantity(False, "wait for ~/resume or ~/step", read_only=True)
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

    def __post_init__(self) -> None:
        super().__post_init__()
        if 0.0 < self.rate < _SLOWEST:
            raise ParameterError(f"rate = {self.rate:g} is out of bounds: it must be 0, or 0.01 to 100")
