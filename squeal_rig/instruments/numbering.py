"""Following the sample numbers of a run through its blocks: what was lost, and where another run began."""

from __future__ import annotations

from squeal_rig.instruments.driver import Samples

SEQ_MODULUS = 2**32
# What a gap in the numbers may be longer than the time that has passed between the stamps [s].
_SLACK = 0.01


def samples_ahead(seq: int, expected: int) -> int:
    """How many samples a number lies ahead of another, below zero behind it: `seq` wraps, so the nearer way counts."""
    return (seq - expected + SEQ_MODULUS // 2) % SEQ_MODULUS - SEQ_MODULUS // 2


class Numbering:
    """Numbers samples over a whole run, although `seq` wraps at 2^32.

    `restarts` counts other runs: numbers that run backwards, or ahead of the time that the stamps tell. A rig started
    again is one, a second rig on the same topic one with nearly every block. `lost_samples` are those missing within
    runs.
    """

    def __init__(self) -> None:
        self.lost_samples = self.restarts = 0
        self._end: int | None = None
        self._time = 0.0

    def take(self, stamp: int, daq: Samples, sample_rate: float) -> tuple[int, bool]:
        """Take a block; returns the number of its first sample in its run, and whether another run began with it."""
        seq, begin = int(daq["seq"][0]), stamp * 1e-9 + float(daq["t"][0])
        start, restarted = seq, False
        if self._end is not None:
            gap = samples_ahead(seq, self._end)
            restarted = not 0 <= gap / sample_rate <= max(begin - self._time, 0.0) + _SLACK
            self.restarts += restarted
            if not restarted:
                self.lost_samples += gap
                start = self._end + gap
        self._end, self._time = start + len(daq), begin + len(daq) / sample_rate
        return start, restarted
