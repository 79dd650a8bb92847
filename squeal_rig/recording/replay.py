"""When a recorded message is due in a replay, which topics are played, and under which names."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Collection, Iterable, Sequence
from fnmatch import fnmatchcase

from squeal_rig.errors import RecordingError

from .qos_yaml import QosProfile
from .reader import Bag, RawMessage

_NAME = re.compile(r"(?:/[A-Za-z_][A-Za-z0-9_]*)+")
_LONGEST_NAME = 247  # rmw's bound


def matching_topics(topics: Iterable[str], patterns: Sequence[str]) -> list[str]:
    """Topics that match a pattern: an absolute pattern on the whole name, a relative one in any namespace."""
    chosen = []
    for topic in topics:
        for pattern in patterns:
            if fnmatchcase(topic, pattern if pattern.startswith("/") else f"*/{pattern}"):
                chosen.append(topic)
                break
    return chosen


def check_topic_name(name: str) -> None:
    """Raise RecordingError where a name is none that ROS lets a topic have."""
    if len(name) > _LONGEST_NAME or not _NAME.fullmatch(name) or "__" in name:
        raise RecordingError(f"{name[:_LONGEST_NAME]!r} is no name of a ROS topic")


def remapped(topics: Collection[str], rules: Sequence[str]) -> dict[str, str]:
    """Recorded name -> name to play under. A rule is `/from:=/to`; both may name a namespace when they end with `/`.

    Raises RecordingError for a rule of another form, one that matches no topic, and two topics under one name.
    """
    names = {topic: topic for topic in topics}
    for rule in rules:
        old, separator, new = rule.partition(":=")
        if (
            not separator
            or not old.startswith("/")
            or not new.startswith("/")
            or old.endswith("/") != new.endswith("/")
        ):
            raise RecordingError(f"remap {rule!r} is no rule: write /from:=/to, or /from/:=/to/ for a namespace.")
        touched = [topic for topic in topics if topic == old or (old.endswith("/") and topic.startswith(old))]
        if not touched:
            raise RecordingError(f"remap {rule!r} matches no topic that is played.")
        names |= {topic: new + topic[len(old) :] for topic in touched}
        try:
            check_topic_name(names[touched[0]])
        except RecordingError as error:
            raise RecordingError(f"remap {rule!r} cannot be: {error}") from None
    name, count = Counter(names.values()).most_common(1)[0] if names else ("", 0)
    if count > 1:
        raise RecordingError(f"remap puts several topics under the name {name}.")
    return names


def is_latched(qos: Sequence[QosProfile]) -> bool:
    """Whether a topic keeps its last value for those who come late."""
    return any(profile.durability == "transient_local" for profile in qos)


def last_before(bag: Bag, topics: Collection[str], time: int) -> list[RawMessage]:
    """The last message of each topic with a log time below `time` [ns], in the order of their log times."""
    last: dict[str, RawMessage] = {}
    if topics:
        for message in bag.messages(topics, end=time):
            last[message.topic] = message
    return sorted(last.values(), key=lambda message: message.log_time)


class Beat:
    """When something is due that comes every `period` [s] of the steady clock: on a grid, however late it was asked."""

    def __init__(self, period: float) -> None:
        self._period = period
        self._next: float | None = None

    def due(self, now: float) -> bool:
        """Whether it is due now [s], and taken as done; what was missed altogether is left out."""
        if self._next is None:
            self._next = now
        if now < self._next:
            return False
        self._next += (math.floor((now - self._next) / self._period) + 1) * self._period
        return True

    def left(self, now: float) -> float:
        """Time until it is due [s], 0 where it is."""
        return max(0.0, self._next - now) if self._next is not None else 0.0


class ReplayClock:
    """Recorded time as a function of the steady clock: runs, pauses, jumps, changes its rate.

    Steady times in s, log times in ns. At rate 0 nothing is waited for but the bound on the data rate.
    """

    def __init__(self, log_time: int, rate: float, max_bytes_per_second: float, now: float) -> None:
        self._log, self._steady = log_time, now
        self._limit = max_bytes_per_second
        self._sent = 0
        self.rate = rate
        self.paused = False

    def now(self, steady: float) -> int:
        """Recorded time at a steady time; at rate 0 that of the last jump."""
        if self.paused or self.rate == 0.0:
            return self._log
        return self._log + round((steady - self._steady) * 1e9 * self.rate)

    def due(self, log_time: int) -> float:
        """Steady time at which a message is due; inf while paused."""
        if self.paused:
            return math.inf
        if self.rate == 0.0:
            return self._steady + self._sent / self._limit
        return self._steady + (log_time - self._log) * 1e-9 / self.rate

    def published(self, log_time: int, size: int) -> None:
        """Take note of a published message: at rate 0 its bytes count against the bound."""
        if self.rate == 0.0:
            self._log = log_time
            self._sent += size

    def jump(self, log_time: int, steady: float) -> None:
        """Go on from another recorded time."""
        self._log, self._steady, self._sent = log_time, steady, 0

    def set_rate(self, rate: float, steady: float) -> None:
        """Go on at another rate from the same recorded time."""
        self.jump(self.now(steady), steady)
        self.rate = rate

    def pause(self, steady: float) -> None:
        """Stop the time."""
        self.jump(self.now(steady), steady)
        self.paused = True

    def resume(self, steady: float) -> None:
        """Let the time go on."""
        if self.paused:
            self.paused = False
            self.jump(self._log, steady)
