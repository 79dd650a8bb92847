"""When blocks are due: real time, faster, slower, or as fast as possible."""

from __future__ import annotations

from squeal_rig.instruments.settings import BLOCKS_PER_SECOND

#: Blocks made at one go while catching up; more would keep everybody else waiting.
_MOST_AT_ONCE = 10
#: Time behind [s] worth a warning: ten blocks.
LATE = 0.1
#: Time behind [s] at which catching up is given up and the gap reported.
OVERRUN = 0.5


class Pacer:
    """Says how many blocks are due, by a steady clock.

    Args:
        real_time_factor: sampled seconds per second; 0 is as fast as possible.
    """

    def __init__(self, real_time_factor: float) -> None:
        self._period = 1.0 / (BLOCKS_PER_SECOND * real_time_factor) if real_time_factor > 0.0 else 0.0
        self._start = 0.0
        self._made = 0
        self._worst = 0.0
        self.overruns = 0
        self.skipped_seconds = 0.0

    @property
    def period(self) -> float:
        """Time between blocks [s]; 0 as fast as possible."""
        return self._period

    def worst_behind(self) -> float:
        """Longest time a block was late since this was last asked [s]."""
        worst, self._worst = self._worst, 0.0
        return worst

    def start(self, now: float) -> None:
        """Count from now [s] on: the first block is due when its last sample was taken."""
        self._start, self._made = now, 0

    def due(self, now: float) -> tuple[int, bool]:
        """Blocks due now, and whether there was an overrun: then what was missed is skipped and counted anew."""
        if self._period == 0.0:
            return 1, False
        # A timer may fire some nanoseconds early by its own clock's rounding.
        waiting = int((now - self._start) / self._period + 1e-6) - self._made
        # The block due now is not behind, however long blocks take.
        overrun = (waiting - 1) * self._period > OVERRUN
        if overrun:
            self.overruns += 1
            self.skipped_seconds += waiting * self._period
            self.start(now)
            waiting = 1
            self._start -= self._period
        self._worst = max(self._worst, (waiting - 1) * self._period)
        count = min(waiting, _MOST_AT_ONCE)
        self._made += count
        return count, overrun

    def put_back(self, count: int) -> None:
        """That many of the blocks due were not made after all: they are due once more."""
        self._made -= count
