"""Time as far as we were there to see it pass."""

from __future__ import annotations


class AwakeTime:
    """A clock that counts at most `most` [s] between two looks at it.

    Who was held up himself, by a debugger or a machine that sleeps, cannot say that the others were silent meanwhile:
    what they sent waits in his queues.
    """

    def __init__(self, now: float, most: float = 0.1) -> None:
        self._most = most
        self._seen = now
        self.time = 0.0

    def look(self, now: float) -> float:
        """The time [s] at `now` [s] of a steady clock."""
        self.time += min(max(now - self._seen, 0.0), self._most)
        self._seen = now
        return self.time
