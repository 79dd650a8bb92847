"""A bag being played, without ROS: the thread-safe controls, and the messages at the moments they are due."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Collection

from squeal_rig.errors import RecordingError

from .reader import Bag, RawMessage
from .replay import ReplayClock, is_latched, last_before

# The last stretch before a message is due is spun: a sleeping thread wakes up to some 0.1 ms late.
_SPIN = 0.0003
# A turn of a loop takes at least so long [s]: a few messages are not played thousands of times a second.
_SHORTEST_TURN = 0.1


class Transport:
    """Plays chosen topics of a bag; `run` blocks in the player's thread, the other methods are for any thread.

    Args:
        bag: what to play.
        topics: the topics to play.
        rate: speed, 0 for as fast as the bound lets.
        max_bytes_per_second: bound of the data rate at rate 0 [bytes/s].
        start: where to begin, and begin again in a loop [s after the bag's first message].

    Before playing begins anywhere but at the bag's start, the last values of latched topics from before are played.

    Raises:
        RecordingError: start lies behind the bag's end.
    """

    def __init__(
        self, bag: Bag, topics: Collection[str], rate: float, max_bytes_per_second: float, start: float = 0.0
    ) -> None:
        self._bag = bag
        self._topics = tuple(topics)
        self._latched = tuple(name for name in topics if is_latched(bag.topics[name].qos))
        self._start = self.log_time("start_offset", start)
        self._clock = ReplayClock(self._start, rate, max_bytes_per_second, time.monotonic())
        self._changed = threading.Condition()
        self._stopping = False
        self._steps = 0
        self._target: int | None = None
        self.loop = False
        self.loops = 0
        self.published = 0
        self.worst_lateness = 0.0

    def log_time(self, name: str, offset: float) -> int:
        """Log time [ns] of an offset [s] after the bag's first message; RecordingError behind the end."""
        if offset > self._bag.duration:
            raise RecordingError(f"{name} = {offset:g} s is out of bounds: the bag ends at {self._bag.duration:.3f} s.")
        return self._bag.start_time + round(offset * 1e9)

    # --- controls

    @property
    def paused(self) -> bool:
        """Whether it is paused."""
        return self._clock.paused

    @property
    def position(self) -> float:
        """Where it is [s after the bag's first message]."""
        return (self.now() - self._bag.start_time) * 1e-9

    def now(self) -> int:
        """The recorded time that is played now [ns]."""
        return min(self._clock.now(time.monotonic()), self._bag.end_time)

    def pause(self) -> None:
        """Stop before the next message."""
        with self._changed:
            self._clock.pause(time.monotonic())
            self._changed.notify()

    def resume(self) -> None:
        """Go on."""
        with self._changed:
            self._clock.resume(time.monotonic())
            self._changed.notify()

    def step(self) -> None:
        """Play one message while paused; RecordingError while not."""
        with self._changed:
            if not self._clock.paused:
                raise RecordingError("step plays one message of a paused bag: call ~/pause first")
            self._steps += 1
            self._changed.notify()

    def seek(self, offset: float) -> None:
        """Go on from another place [s after the bag's first message], paused or not."""
        with self._changed:
            self._target = self.log_time("seek_to", offset)
            self._changed.notify()

    def set_rate(self, rate: float) -> None:
        """Go on at another speed from the same place."""
        with self._changed:
            self._clock.set_rate(rate, time.monotonic())
            self._changed.notify()

    def stop(self) -> None:
        """End `run`."""
        with self._changed:
            self._stopping = True
            self._changed.notify()

    # --- playing

    def run(self, publish: Callable[[RawMessage], None], tick: Callable[[int], float]) -> None:
        """Call `publish` with every message when it is due, and `tick` with the recorded time before it.

        `tick` returns after how long [s] it wants to be called again at the latest. This returns at the end of the bag,
        or once stopped. Raises RecordingError when the bag is damaged, or holds nothing that a loop could repeat.
        """
        position = self._start
        while not self._stopping:
            begun, published = time.monotonic(), self.published
            target = self._play_from(position, publish, tick)
            if target is None and (not self.loop or self._stopping):
                return
            if target is None:
                if position == self._start and self.published == published:
                    raise RecordingError(
                        "The bag has no message to play from start_offset on: a loop would repeat nothing."
                    )
                self.loops += 1
                with self._changed:
                    left = begun + _SHORTEST_TURN - time.monotonic()
                    self._changed.wait_for(lambda: self._stopping or self._target is not None, left)
            position = self._start if target is None else target

    def _play_from(
        self, position: int, publish: Callable[[RawMessage], None], tick: Callable[[int], float]
    ) -> int | None:
        """Play until the end (None) or until somebody seeks (the new position)."""
        earlier = last_before(self._bag, self._latched, position) if position > self._bag.start_time else []
        for message in earlier:
            publish(message)
        with self._changed:
            self._clock.jump(position, time.monotonic())
        for message in self._bag.messages(self._topics, position):
            if not self._wait(message, tick):
                break
            publish(message)
            self.published += 1
            self._clock.published(message.log_time, len(message.data))
        with self._changed:
            target, self._target = self._target, None
        return target

    def _wait(self, message: RawMessage, tick: Callable[[int], float]) -> bool:
        """Wait until a message is due; False when it is not to be played, since somebody stops or seeks."""
        while True:
            until_tick = tick(min(self.now(), message.log_time))
            with self._changed:
                if self._stopping or self._target is not None:
                    return False
                now = time.monotonic()
                if self._clock.paused and self._steps:
                    self._steps -= 1
                    self._clock.jump(message.log_time, now)
                    return True
                left = self._clock.due(message.log_time) - now
                if left > _SPIN:
                    self._changed.wait(min(left - _SPIN, until_tick))
            if left > _SPIN:
                continue
            due = now + left
            while time.monotonic() < due:
                pass  # spun, not slept: see _SPIN
            self.worst_lateness = max(self.worst_lateness, -left)
            tick(message.log_time)
            return True
