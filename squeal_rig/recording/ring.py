"""The last seconds of a running system, kept in memory until something happens that is worth a recording."""

from __future__ import annotations

import sys
from collections import deque
from typing import NamedTuple

from .writer import ChannelHandle


class KeptMessage(NamedTuple):
    """One message on its way to a bag; times in [ns]."""

    handle: ChannelHandle
    data: bytes
    log_time: int
    publish_time: int


# What Python takes beside a message's payload: the tuple (seen by the collector), two numbers, a place in the queue.
_OVERHEAD = sys.getsizeof(KeptMessage(None, b"", 0, 0)) + 16 + 2 * sys.getsizeof(2**62) + 8  # type: ignore[arg-type]


class MessageRing:
    """Messages of the last `duration` [s] in at most `max_bytes` of memory, all that a message takes counted.

    The last message of a latched topic is kept however old it is, within the same bound: a snapshot without the rig's
    description could not be evaluated.
    """

    def __init__(self, duration: float, max_bytes: int) -> None:
        self._duration = round(duration * 1e9)
        self._max_bytes = max_bytes
        self._messages: deque[KeptMessage] = deque()
        self._latched: dict[int, KeptMessage] = {}  # by channel, wherever they are
        self._aged: dict[int, KeptMessage] = {}  # of these the ones that have left the queue
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
            channel = message.handle.channel.id
            self._latched[channel] = message
            if channel in self._aged:
                self.bytes -= _size(self._aged.pop(channel))
        self._messages.append(message)
        self.bytes += _size(message)
        oldest = message.log_time - self._duration
        while self._messages and (self._messages[0].log_time < oldest or self.bytes > self._max_bytes):
            dropped = self._messages.popleft()
            self.shortened = self.shortened or dropped.log_time >= oldest
            self._leave(dropped)
        while self.bytes > self._max_bytes:  # latched values alone
            channel, dropped = next(iter(self._aged.items()))
            del self._aged[channel], self._latched[channel]
            self.bytes -= _size(dropped)

    def take(self) -> list[KeptMessage]:
        """Return all messages, oldest first, and forget them.

        Latched values from before the first message come first, with its log time and their own publish time.
        """
        if not self._messages:
            return []
        start = self._messages[0].log_time
        taken = [*(message._replace(log_time=start) for message in self._aged.values()), *self._messages]
        while self._messages:
            self._leave(self._messages.popleft())
        self.shortened = False
        return taken

    def _leave(self, message: KeptMessage) -> None:
        channel = message.handle.channel.id
        if self._latched.get(channel) is message:
            self._aged[channel] = message
        else:
            self.bytes -= _size(message)


def _size(message: KeptMessage) -> int:
    return sys.getsizeof(message.data) + _OVERHEAD
