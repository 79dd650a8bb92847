"""Friction from what a rig can measure: Eq. (2.1) for each sample, Eq. (2.2) and the ratio of means for each window.

Windows are counted in samples by `seq`, never in arrivals: live, replayed and offline estimates are the same numbers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from squeal_rig.estimation.settings import FrictionSettings
from squeal_rig.instruments.channels import FRICTION_WINDOW_RECORD
from squeal_rig.instruments.description import RigDescription
from squeal_rig.instruments.driver import Samples
from squeal_rig.instruments.means import contact_forces
from squeal_rig.instruments.numbering import SEQ_MODULUS, Numbering

Values = NDArray[np.float64]


def sample_friction(tangential: Values, normal: Values, minimum_normal_load: float) -> tuple[Values, NDArray[np.bool_]]:
    """Eq. (2.1) for each sample, and whether it is valid; invalid samples are zero, never nan or inf.

    A sample is valid where its denominator is at least `minimum_normal_load` [N] and both terms are finite.
    """
    valid = np.isfinite(tangential) & np.isfinite(normal) & (normal >= minimum_normal_load)
    mu = np.divide(tangential, normal, out=np.zeros(len(normal)), where=valid)
    return mu, valid


@dataclass(frozen=True)
class FrictionWindow:
    """One window: `stamp` [ns] of its first sample, and its record (`FRICTION_WINDOW_CHANNELS`) as name -> value."""

    stamp: int
    values: dict[str, float]

    def as_record(self) -> Samples:
        """Structured array (1,) of the window."""
        record = np.zeros(1, FRICTION_WINDOW_RECORD)
        for name, value in self.values.items():
            record[name] = value
        return record


class _Sums:
    """Running sums of one window."""

    def __init__(self) -> None:
        self.stamp: int | None = None
        self.count = self.valid = self.true_count = 0
        self.mu = self.tangential = self.normal = self.preload = self.speed = self.mu_true = 0.0


class FrictionEstimator:
    """Turns blocks of `daq/samples` (and `truth/samples`, where there are any) into windows of friction.

    The first window is the first that begins after the first block: one joined halfway is dropped. A window with lost
    samples is kept; its `valid_share` tells.

    Args:
        rig: the rig's constants.
        settings: window [s] and the smallest denominator [N].
    """

    def __init__(self, rig: RigDescription, settings: FrictionSettings) -> None:
        self.rig = rig
        self._settings = settings
        self._length = max(1, round(settings.window * rig.sample_rate))
        self._open: dict[int, _Sums] = {}
        self._numbering = Numbering()
        self._begun = False
        self._next = 0
        self._daq_end = self._truth_end = 0

    @property
    def lost_samples(self) -> int:
        """Samples missing between blocks so far."""
        return self._numbering.lost_samples

    def add_samples(self, stamp: int, daq: Samples) -> tuple[Values, NDArray[np.bool_], list[FrictionWindow]]:
        """Take a block of DAQ samples; returns mu (n,) and valid (n,) of Eq. (2.1), and the windows now complete."""
        tangential, normal = contact_forces(daq, self.rig.parameters, self.rig.drum_radius)
        mu, valid = sample_friction(tangential, normal, self._settings.minimum_normal_load)
        start, restarted = self._numbering.take(stamp, daq, self.rig.sample_rate)
        if restarted:
            self._open.clear()
        if restarted or not self._begun:
            self._next = -(-start // self._length)
            self._begun, self._truth_end = True, start
        for index, piece in self._pieces(start, len(daq)):
            sums = self._open.setdefault(index, _Sums())
            if sums.stamp is None:
                sums.stamp = stamp + round(float(daq["t"][piece.start]) * 1e9)
            ok = valid[piece]
            sums.count += len(ok)
            sums.valid += int(ok.sum())
            sums.mu += float(mu[piece].sum())
            sums.tangential += float(tangential[piece].sum())
            sums.normal += float(normal[piece].sum())
            sums.preload += float(daq["preload"][piece].sum())
            sums.speed += float(daq["belt_speed"][piece].sum())
        self._daq_end = start + len(daq)
        return mu, valid, self._completed()

    def add_truth(self, truth: Samples) -> list[FrictionWindow]:
        """Take a block of true samples; returns the windows now complete."""
        start, near = int(truth["seq"][0]), self._truth_end
        if self._begun:
            start = near + (start - near + SEQ_MODULUS // 2) % SEQ_MODULUS - SEQ_MODULUS // 2
        for index, piece in self._pieces(start, len(truth)):
            sums = self._open.setdefault(index, _Sums())
            sums.true_count += piece.stop - piece.start
            sums.mu_true += float(truth["mu"][piece].sum())
        self._truth_end = start + len(truth)
        return self._completed() if self._begun else []

    def _pieces(self, start: int, count: int) -> list[tuple[int, slice]]:
        """(window, slice of the block) for every window a block touches, but for windows already gone."""
        pieces = []
        for index in range(start // self._length, (start + count - 1) // self._length + 1):
            low, high = max(start, index * self._length), min(start + count, (index + 1) * self._length)
            if index >= self._next:
                pieces.append((index, slice(low - start, high - start)))
        return pieces

    def _completed(self) -> list[FrictionWindow]:
        """Windows that are over, in order; truth may lag by one window before a window goes without it."""
        windows = []
        while (self._next + 1) * self._length <= self._daq_end:
            end = (self._next + 1) * self._length
            overdue = self._daq_end - end >= self._length
            if self.rig.publishes_truth and self._truth_end < end and not overdue:
                break
            sums = self._open.pop(self._next, None)
            if sums is not None and sums.stamp is not None:
                windows.append(FrictionWindow(sums.stamp, self._values(self._next, sums)))
            self._next += 1
        return windows

    def _values(self, index: int, sums: _Sums) -> dict[str, float]:
        period = self._length / self.rig.sample_rate
        mu = sums.mu / sums.valid if sums.valid else math.nan
        mean_normal = sums.normal / sums.count
        ratio = sums.tangential / sums.normal if mean_normal >= self._settings.minimum_normal_load else math.nan
        mu_true = sums.mu_true / sums.true_count if sums.true_count else math.nan
        return {
            "t_start": index * period,
            "t_end": (index + 1) * period,
            "mu": mu,
            "mu_ratio_of_means": ratio,
            "valid_share": sums.valid / self._length,
            "preload": sums.preload / sums.count,
            "belt_speed": sums.speed / sums.count,
            "mu_true": mu_true,
            "difference": mu - mu_true,
        }
