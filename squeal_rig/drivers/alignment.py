"""Samples of several signals on one grid of sample numbers, by the device's time where it can be believed.

A client of openDAQ was seen to get other times than its server sent, and the same time again for every packet (openDAQ
issues 1202 and 1291). So a time is a claim: it is believed where it continues the count, or where samples may have been
lost for as long as it says; otherwise the own count goes on, the fault is counted and told.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Mapping, Sequence
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

Values = NDArray[np.float64]

# A sample that would have been taken so long [s] after it arrived, by the fastest packet before, is from no future.
_SLACK = 0.1
# What the device's clock may run apart from this machine's, as a share: no quartz is that bad.
_DRIFT = 1e-3
# First times of two signals that are further apart than this [s] are not of one clock.
_APART = 2.0


class Track:
    """One signal's count of samples. Number 0 is the grid's first sample; times are in s since the device's origin."""

    def __init__(self, name: str, rate: int) -> None:
        self._name, self._rate = name, rate
        self.end: int | None = None
        self.faults: Counter[str] = Counter()
        self._shift = 0
        self._anchor = 0.0

    def take(self, exact: Fraction | None, count: int, now: float, front: int | None) -> tuple[int, str]:
        """Number of a packet's first sample, and a sentence where its time is not believed.

        Args:
            exact: the number that its time says, None where the time is damaged.
            count: samples in it.
            now: steady time of its arrival [s].
            front: where the other signals are, None where there is none yet.
        """
        expected = self.end
        start, sentence = self._placed(exact, count, now, expected if expected is not None else front)
        self.end = start + count
        latest = now - self.end / self._rate
        self._anchor = latest if expected is None else min(self._anchor + _DRIFT * count / self._rate, latest)
        return start, sentence

    def _placed(self, exact: Fraction | None, count: int, now: float, expected: int | None) -> tuple[int, str]:
        if exact is None:
            return expected or 0, self._fault("time is damaged")
        claimed = round(exact)
        off = "" if exact == claimed else self._once("is not sampled with the others, off by", exact - claimed)
        if self.end is None:  # its first packet
            if expected is None or abs(claimed - expected) <= _APART * self._rate:
                return claimed, off
            self._shift = expected - claimed
            return expected, self._fault("time differs from that of the other signals", claimed - expected)
        assert expected is not None
        if claimed == expected:
            self._shift = 0  # as it was before a damaged time
            return expected, off
        if claimed + self._shift == expected:
            return expected, off
        for number in (claimed, claimed + self._shift):
            in_time = (number + count) / self._rate + self._anchor <= now + _SLACK
            if number > expected and in_time:
                return number, off
        self._shift = expected - claimed
        what = "time jumps ahead" if claimed > expected else "time runs back"
        return expected, self._fault(what, claimed - expected)

    def _fault(self, what: str, samples: int = 0) -> str:
        self.faults[what] += 1
        by = f" by {abs(samples) / self._rate:.6g} s" if samples else ""
        times = f", {self.faults[what]} times so far" if self.faults[what] > 1 else ""
        return f"{self._name}: {what}{by}: not believed, its samples are numbered without it{times}"

    def _once(self, what: str, share: Fraction) -> str:
        self.faults[what] += 1
        if self.faults[what] > 1:
            return ""
        return f"{self._name} {what} {1e6 * float(share) / self._rate:.3g} us: taken to the nearest sample"


class Aligner:
    """Whole blocks out of packets of every signal.

    Args:
        signals: name -> samples that it comes late by.
        rate: samples per second.
        size: samples in a block.
    """

    def __init__(self, signals: Mapping[str, int], rate: int, size: int) -> None:
        self._delays, self._rate, self._size = dict(signals), rate, size
        self._tracks = {name: Track(name, rate) for name in signals}
        self._waiting: dict[str, deque[tuple[int, Values]]] = {name: deque() for name in signals}
        self._zero: Fraction | None = None
        self._begin: int | None = None
        self._lost = 0

    @property
    def faults(self) -> dict[str, int]:
        """What was not believed, by kind, over all signals."""
        total: Counter[str] = Counter()
        for track in self._tracks.values():
            total += track.faults
        return dict(total)

    def add(self, name: str, time: Fraction | None, values: Values, now: float) -> str:
        """Take a packet: time of its first sample [s] (None: damaged), values (n,), arrival by a steady clock [s].

        Returns a sentence where its time is not believed, else an empty one.
        """
        if self._zero is None and time is not None:
            self._zero = time
        exact = None if time is None or self._zero is None else (time - self._zero) * self._rate
        ends = [track.end for track in self._tracks.values() if track.end is not None]
        front = max(ends) - len(values) if ends else None
        start, sentence = self._tracks[name].take(exact, len(values), now, front)
        self._waiting[name].append((start - self._delays[name], values))
        return sentence

    def time_of(self, number: int) -> Fraction:
        """Device's time of a sample [s]."""
        return (self._zero or Fraction(0)) + Fraction(number, self._rate)

    def take_block(self) -> tuple[int, int, dict[str, Values]] | None:
        """(number of its first sample, samples lost before it, name -> values) of the next whole block, or None.

        A sample that one signal has lost is lost for all, and with it what the block before it had already.
        """
        while all(self._waiting.values()):
            if self._begin is None:
                self._begin = max(queue[0][0] for queue in self._waiting.values())
            begin, end = self._begin, self._begin + self._size
            if any(queue[-1][0] + len(queue[-1][1]) < end for queue in self._waiting.values()):
                return None
            holes = [hole for queue in self._waiting.values() if (hole := _first_after_hole(queue, begin, end))]
            if not holes:
                block = {name: _cut(queue, begin, end) for name, queue in self._waiting.items()}
                lost, self._lost, self._begin = self._lost, 0, end
                return begin, lost, block
            self._lost += max(holes) - begin
            self._begin = max(holes)
            for queue in self._waiting.values():
                _drop(queue, self._begin)
        return None


def _first_after_hole(queue: Sequence[tuple[int, Values]], begin: int, end: int) -> int | None:
    """Where the samples go on after the last hole in begin to end; None without one."""
    here, found = begin, None
    for start, values in queue:
        if here >= end:
            break
        if start > here:
            found = start
        here = max(here, start + len(values))
    return found


def _cut(queue: deque[tuple[int, Values]], begin: int, end: int) -> Values:
    """Samples begin to end, which are all there; what comes before the end is forgotten."""
    out = np.empty(end - begin)
    for start, values in queue:
        low, high = max(start, begin), min(start + len(values), end)
        if low < high:
            out[low - begin : high - begin] = values[low - start : high - start]
    _drop(queue, end)
    return out


def _drop(queue: deque[tuple[int, Values]], before: int) -> None:
    while queue and queue[0][0] + len(queue[0][1]) <= before:
        queue.popleft()
