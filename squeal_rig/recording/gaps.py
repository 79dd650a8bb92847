"""Whether the samples of a topic are all there: gaps and repetitions by `seq`, samples not valid, damaged blocks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from squeal_rig.errors import RecordingError

from .clouds import samples_from_cdr

CLOUD_TYPE = "sensor_msgs/msg/PointCloud2"
_SEQ_MODULUS = 2**32


def samples_missing(expected: int, seq: int) -> int | None:
    """Samples missing before number `seq`; None where the numbers begin anew: a rig started again, or a replay.

    Numbers wrap at 2^32, so what lies less than half of that ahead is taken for ahead.
    """
    ahead = (seq - expected) % _SEQ_MODULUS
    return ahead if ahead < _SEQ_MODULUS // 2 else None


@dataclass
class SampleCount:
    """What was seen of one topic of samples.

    lost: samples missing between two others, in `gaps` places; back: places where `seq` went back (a restarted rig);
    rejected: samples that say of themselves that they are not valid; damaged: messages that are no block.
    """

    samples: int = 0
    lost: int = 0
    gaps: int = 0
    back: int = 0
    rejected: int = 0
    damaged: int = 0
    counted: bool = False  # whether the samples carry `seq`
    _next: int | None = None

    def add(self, data: bytes) -> None:
        """Take the CDR bytes of the topic's next PointCloud2."""
        try:
            samples = samples_from_cdr(data).samples
        except RecordingError:
            self.damaged += 1
            return
        names = samples.dtype.names or ()
        self.samples += len(samples)
        if "valid" in names:
            self.rejected += int(np.count_nonzero(samples["valid"] == 0))
        if "seq" in names and samples["seq"].ndim == 1 and samples["seq"].dtype.kind in "ui" and len(samples):
            self._follow(samples["seq"].astype(np.int64))

    def _follow(self, seq: np.ndarray[tuple[int], np.dtype[np.int64]]) -> None:
        self.counted = True
        expected = int(seq[0]) if self._next is None else self._next
        steps = np.diff(seq, prepend=expected - 1) % _SEQ_MODULUS
        if not (steps == 1).all():
            back = (steps == 0) | (steps > _SEQ_MODULUS // 2)
            jumps = steps[~back & (steps != 1)]
            self.back += int(np.count_nonzero(back))
            self.gaps += len(jumps)
            self.lost += int((jumps - 1).sum())
        self._next = (int(seq[-1]) + 1) % _SEQ_MODULUS
