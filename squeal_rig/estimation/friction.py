"""Friction from what a rig can measure: Eq. (2.1) for each sample, Eq. (2.2) and ratios of means for each window.

The denominator of Eq. (2.1) is N - m y'' - c_y y' (vertical balance of Eq. (2.3), to first order in r/L). Over a window
its missing part is a difference between two ends, by the momentum theorem: the integral of m y'' is m y'. So the
corrected ratio of means needs y' at two instants only, from a band-limited differentiator, and averages no
differentiated noise. What it does not correct is the numerator: the torque is that at the drum, with whatever inertia
and filter lie between it and the contact.

Windows are counted in samples by `seq`, never in arrivals: live, replayed and offline estimates are the same numbers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from squeal_rig.estimation.confidence import correlation_factor
from squeal_rig.estimation.differentiator import Differentiator, differentiator
from squeal_rig.estimation.settings import FrictionSettings
from squeal_rig.instruments.channels import FRICTION_WINDOW_RECORD
from squeal_rig.instruments.description import RigDescription
from squeal_rig.instruments.driver import Samples
from squeal_rig.instruments.means import contact_forces
from squeal_rig.instruments.numbering import Numbering, samples_ahead

Values = NDArray[np.float64]

# Parts of a window whose scatter tells the window's standard error, and the fewest samples that a part must have.
_PARTS, _LEAST_PART = 20, 4


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


def corrected_ratio_of_means(
    tangential: Values, normal: Values, y: Values, differentiate: Differentiator, mass: float, damping: float
) -> float:
    """Ratio of means with the denominator's missing m y'' + c_y y', over samples (n,) without a gap.

    Means by the trapezoidal rule between the first and the last sample whose y' is known, `reach` from either end.

    Args:
        tangential: F_t [N].
        normal: denominator of Eq. (2.1) [N].
        y: displacement away from the belt [m].
        differentiate: for their sample rate.
        mass: m [kg].
        damping: c_y [N s/m].
    """
    size = 2 * differentiate.reach + 1
    ends = _Ends(size)
    ends.take(np.array([y, tangential, normal]))
    return ends.corrected_ratio(float(tangential.sum()), float(normal.sum()), differentiate, mass, damping)


class _Ends:
    """The first and the last samples of a window: y, tangential and normal force (3, size) each."""

    def __init__(self, size: int) -> None:
        self._size = size
        self._first = self._last = np.empty((3, 0))
        self._count = 0

    def take(self, piece: Values) -> None:
        """Take the next samples (3, n) of the window."""
        if self._first.shape[1] < self._size:
            self._first = np.hstack([self._first, piece[:, : self._size - self._first.shape[1]]])
        kept = max(0, self._size - piece.shape[1])
        last = self._last[:, max(0, self._last.shape[1] - kept) :] if kept else self._last[:, :0]
        self._last = np.hstack([last, piece[:, -self._size :]])
        self._count += piece.shape[1]

    def corrected_ratio(
        self, tangential: float, normal: float, differentiate: Differentiator, mass: float, damping: float
    ) -> float:
        """The corrected ratio from the sums of all samples [N]; nan where the window is too short."""
        reach = differentiate.reach
        if self._count < 2 * self._size:
            return math.nan
        with np.errstate(all="ignore"):  # whatever a stranger's samples hold; what is no number stays none
            begin, end = differentiate(self._first[0])[0][0], differentiate(self._last[0])[0][0]
            rise = self._last[0, reach] - self._first[0, reach]
            outside = self._first[1:, :reach].sum(axis=1) + self._last[1:, -reach:].sum(axis=1)
            outside += 0.5 * (self._first[1:, reach] + self._last[1:, reach])
            missing = differentiate.sample_rate * (mass * (end - begin) + damping * rise)
            denominator = normal - outside[1] + missing
            return float((tangential - outside[0]) / denominator) if denominator > 0.0 else math.nan


class _Sums:
    """Running sums of one window."""

    def __init__(self, ends: int) -> None:
        self.arm_left = self.arm_right = 0.0
        self.ends = _Ends(ends)
        self.parts = np.zeros((2, _PARTS))
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
        self._differentiate = differentiator(float(rig.sample_rate))
        self._borders = np.linspace(0, self._length, _PARTS + 1).astype(np.int64)
        self._open: dict[int, _Sums] = {}
        self._numbering = Numbering()
        self._begun = False
        self._next = 0
        self._daq_end = self._truth_end = 0

    @property
    def window_samples(self) -> int:
        """Samples in a window."""
        return self._length

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
            sums = self._open.setdefault(index, self._empty())
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
            sums.arm_left += float(daq["arm_left"][piece].sum())
            sums.arm_right += float(daq["arm_right"][piece].sum())
            sums.ends.take(np.array([daq["y"][piece], tangential[piece], normal[piece]]))
            self._add_to_parts(sums, start + piece.start - index * self._length, tangential[piece], normal[piece])
        self._daq_end = start + len(daq)
        return mu, valid, self._completed()

    def add_truth(self, truth: Samples) -> list[FrictionWindow]:
        """Take a block of true samples; returns the windows now complete."""
        start, near = int(truth["seq"][0]), self._truth_end
        if self._begun:
            start = near + samples_ahead(start, near)
        for index, piece in self._pieces(start, len(truth)):
            sums = self._open.setdefault(index, self._empty())
            sums.true_count += piece.stop - piece.start
            sums.mu_true += float(truth["mu"][piece].sum())
        self._truth_end = start + len(truth)
        return self._completed() if self._begun else []

    def _empty(self) -> _Sums:
        return _Sums(2 * self._differentiate.reach + 1)

    def _add_to_parts(self, sums: _Sums, offset: int, tangential: Values, normal: Values) -> None:
        """Add forces [N], the first at `offset` samples from the window's start, to the sums of the window's parts."""
        if self._length < _PARTS * _LEAST_PART:
            return
        first = int(np.searchsorted(self._borders, offset, side="right")) - 1
        cuts = self._borders[first + 1 :] - offset
        starts = np.concatenate([[0], cuts[cuts < len(normal)]])
        with np.errstate(all="ignore"):
            for row, values in zip(sums.parts, (tangential, normal), strict=True):
                row[first : first + len(starts)] += np.add.reduceat(values, starts)

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
            "mu_corrected": self._corrected(sums),
            "mu_standard_error": self._standard_error(sums, ratio),
            "arm_left": sums.arm_left / sums.count,
            "arm_right": sums.arm_right / sums.count,
        }

    def _corrected(self, sums: _Sums) -> float:
        if sums.count < self._length or sums.normal / sums.count < self._settings.minimum_normal_load:
            return math.nan
        p = self.rig.parameters
        return sums.ends.corrected_ratio(sums.tangential, sums.normal, self._differentiate, p.mass, p.damping_y)

    def _standard_error(self, sums: _Sums, ratio: float) -> float:
        """Standard error of the ratio of means, from its parts to first order: theirs is F_t - ratio N, of mean zero.

        W. G. Cochran, Sampling Techniques, 3rd ed., 2.11; with `correlation_factor` for parts that are alike.
        """
        if sums.count < self._length or self._length < _PARTS * _LEAST_PART or not math.isfinite(ratio):
            return math.nan
        with np.errstate(all="ignore"):
            residuals = sums.parts[0] - ratio * sums.parts[1]
            scatter = float(np.dot(residuals, residuals)) * _PARTS / (_PARTS - 1)
            return math.sqrt(correlation_factor(residuals) * scatter) / sums.normal if scatter < math.inf else math.nan
