"""When a recorded message is due in a replay, and which topics are played."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from fnmatch import fnmatchcase


def matching_topics(topics: Iterable[str], patterns: Sequence[str]) -> list[str]:
    """Topics that match a pattern: an absolute pattern on the whole name, a relative one in any namespace."""
    chosen = []
    for topic in topics:
        for pattern in patterns:
            if fnmatchcase(topic, pattern if pattern.startswith("/") else f"*/{pattern}"):
                chosen.append(topic)
                break
    return chosen


class ReplaySchedule:
    """Due times of recorded messages, in seconds after the start of the replay.

    Args:
        first_log_time: log time of the first message [ns].
        rate: speed; 0 is as fast as `max_bytes_per_second` allows.
        max_bytes_per_second: bound of the data rate at rate 0 [bytes/s].
    """

    def __init__(self, first_log_time: int, rate: float, max_bytes_per_second: float) -> None:
        self._first = first_log_time
        self._rate = rate
        self._limit = max_bytes_per_second
        self._sent = 0

    def due(self, log_time: int, size: int) -> float:
        """When the message of that log time [ns] and size [bytes] is due [s]."""
        if self._rate > 0.0:
            return (log_time - self._first) * 1e-9 / self._rate
        due = self._sent / self._limit
        self._sent += size
        return due
