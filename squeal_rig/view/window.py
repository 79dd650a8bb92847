"""The newest samples of one channel, kept as long as no sample is missing."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Values = NDArray[np.float64]


class LastSamples:
    """The last `size` samples of a trace; a gap in their numbers begins it anew."""

    def __init__(self, size: int) -> None:
        self._kept = np.zeros(2 * size)
        self._size, self._filled = size, 0
        self._expected: int | None = None

    def add(self, seq: int, values: Values) -> None:
        """Take samples (n,), the first of which has the number `seq`."""
        if self._expected is not None and seq != self._expected:
            self._filled = 0
        self._expected = (seq + len(values)) % 2**32
        values = values[-self._size :]
        if self._filled + len(values) > len(self._kept):
            keep = min(self._filled, self._size)
            self._kept[:keep] = self._kept[self._filled - keep : self._filled]
            self._filled = keep
        self._kept[self._filled : self._filled + len(values)] = values
        self._filled += len(values)

    def whole(self) -> Values | None:
        """The last `size` samples; None while there are fewer."""
        return None if self._filled < self._size else self._kept[self._filled - self._size : self._filled].copy()
