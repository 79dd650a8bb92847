"""The last seconds of a running system, kept in memory until something happens that is worth a recording."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

from .writer import ChannelHandle


class KeptMessage(NamedTuple):
    """One message on its way to a bag; times in [ns]."""

    handle: ChannelHandle
    data: bytes
    log_time: int
    publish_time: int


class MessageRing:
    """Messages of the last `duration` [s] in at most `max_bytes` of payload.

    The last message of a latched topic is kept however old it is, within the same bound: a snapshot without the rig's
    description could not be evaluated.
    """

    def __init__(self, duration: float, max_bytes: int) -> None:
        self._duration = round(duration * 1e9)
        self._max_bytes = max_bytes
        self._messages: deque[KeptMessage] = deque()
        self._latched: dict[int, KeptMessage] = {}
        self.bytes = 0
        self.shortened = False  # whether the bound on memory, not on time, has dropped messages since the last take

    def __len__(self) -> int:
        return len(self._messages)

    @property
    def seconds(self) -> float:
        """Time between the oldest and the newest message [s]."""
        return (self._messages[-1].log_time - self._messages[0].log_time) * 1e-9 if self._messages else 0.0

    def add(self, message: KeptMessage, latched: bool = False) -> None:
        """Keep a message; what is too old or too much goes."""
        if latched:
            self._latched[message.handle.channel.id] = message
        self._messages.append(message)
        self.bytes += len(message.data)
        oldest = message.log_time - self._duration
        while self._messages and (self._messages[0].log_time < oldest or self.bytes > self._max_bytes):
            dropped = self._messages.popleft()
            self.bytes -= len(dropped.data)
            self.shortened = self.shortened or dropped.log_time >= oldest

    def take(self) -> list[KeptMessage]:
        """Return all messages, oldest first, and forget them.

        Latched values from before the first message come first, with its log time and their own publish time.
        """
        if not self._messages:
            return []
        start = self._messages[0].log_time
        inside = {id(message) for message in self._messages}
        earlier = [m._replace(log_time=start) for m in self._latched.values() if id(m) not in inside]
        taken = [*earlier, *self._messages]
        self._messages.clear()
        self.bytes, self.shortened = 0, False
        return taken
