"""Offline analysis of a bag: what happened at each operating point, and the course of the run."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from squeal_rig.errors import ModelError, RecordingError
from squeal_rig.estimation.confidence import PointMeans, half_width, mean_with_error, systematic_shifts
from squeal_rig.estimation.friction import FrictionEstimator
from squeal_rig.estimation.settings import FrictionSettings, SquealSettings
from squeal_rig.estimation.spectra import amplitude_spectrum, peak_frequency
from squeal_rig.estimation.squeal import SquealDetector
from squeal_rig.estimation.tolerances import measured_point, point_tolerance, set_point_tolerance
from squeal_rig.instruments.description import RigDescription
from squeal_rig.model.core.law import friction_coefficient, friction_refusal
from squeal_rig.model.cycles.zones import zone
from squeal_rig.model.linear.eigen import StabilityReport, stability_report
from squeal_rig.model.parameters import RigParameters
from squeal_rig.recording import Bag
from squeal_rig.recording.gaps import samples_missing
from squeal_rig.samples.blocks import RecordedBlock, recorded_blocks

Values = NDArray[np.float64]

#: Segments shorter than this [s] are ramps and switchings, not operating points.
SHORTEST_SEGMENT = 0.3
#: Signal kept of each segment for its spectrum [s]: the last part, where it has settled.
_SPECTRUM_SECONDS = 0.5
# What rings down loses more than this [dB/s], or, where the eigenvalues say stable, half of what they say, if that is
# less; squeal keeps its level. Slow falls show over the last windows only. The detector is late by so many windows,
# whose levels may be of what came after.
_FALLING, _SLOWLY, _LAST, _LATE = -3.0, -0.1, 10, 2
_DB_PER_NEPER = 20.0 / math.log(10.0)
_WORDS = {True: "squeal", False: "quiet", None: "no numbers"}
_MODE_BAND = (200.0, 5000.0)
#: Zone of an operating point for which it cannot be computed.
NOT_AVAILABLE = "not available"
# A zone takes some tenths of a second.
_MOST_ZONES = 200


@dataclass
class Segment:
    """A stretch of the run with one operating point, squealing throughout or not at all; None: x is no number there.

    Times in s since the first sample; shares of the samples whose truth is known; `signal` is the last part of x
    [m], `levels` are those of the detector's windows [dB re 1 um].
    """

    begin: float
    parameters: RigParameters
    squealing: bool | None
    end: float = 0.0
    samples: int = 0
    off_belt: int = 0
    true_samples: int = 0
    mu: list[float] = field(default_factory=list)
    mu_ratio: list[float] = field(default_factory=list)
    mu_true: list[float] = field(default_factory=list)
    signal: list[Values] = field(default_factory=list)
    levels: list[float] = field(default_factory=list)
    sample_rate: float = 0.0
    stability: StabilityReport | None = None
    zone: str = NOT_AVAILABLE
    mu_corrected: list[float] = field(default_factory=list)
    arms: list[tuple[float, float]] = field(default_factory=list)
    preloads: list[float] = field(default_factory=list)
    belt_speeds: list[float] = field(default_factory=list)
    rig: RigDescription | None = None

    @property
    def mean_preload(self) -> float:
        """Mean of the blocks' preloads [N]."""
        return math.fsum(self.preloads) / len(self.preloads)

    @property
    def mean_belt_speed(self) -> float:
        """Mean of the blocks' belt speeds [m/s]."""
        return math.fsum(self.belt_speeds) / len(self.belt_speeds)

    def confidence(self) -> tuple[float, float]:
        """Half the 95 % interval of the mean ratio of means: of its scatter between windows, and of all that is known.

        The scatter counts windows that are alike as fewer (`mean_with_error`); all that is known are the bounds of gain
        and offset of the data sheets besides, which more windows do not shrink (`systematic_shifts`). nan where there
        are fewer than two windows.
        """
        found = mean_with_error(self.mu_ratio)
        if self.rig is None or not math.isfinite(found.standard_error):
            return math.nan, math.nan
        arms = [np.array([np.mean(side)]) for side in zip(*self.arms, strict=True)]
        speed, preload = np.array([self.mean_belt_speed]), np.array([self.mean_preload])
        shifts = systematic_shifts(self.rig, PointMeans(np.array([found.mean]), speed, preload, *arms))
        bounds = [float(shift.mu[0]) for shift in shifts]
        scatter = half_width(found.standard_error, found.freedom)
        return scatter, half_width(found.standard_error, found.freedom, bounds)

    @property
    def hard_squeal(self) -> bool:
        """Whether it squeals for good where the eigenvalues call it stable."""
        known_stable = self.stability is not None and not self.stability.unstable
        # In contact the motion of a stable rig is linear, and no squeal.
        in_contact = self.true_samples > 0 and self.off_belt == 0
        return bool(self.squealing) and known_stable and not in_contact and not self.rings_down

    @property
    def rings_down(self) -> bool:
        """Whether its level falls until its end, as after a hit that dies out: loud, and no squeal."""
        if not self.squealing or len(self.levels) < _LATE + 3:
            return False
        levels = self.levels[:-_LATE][-_LAST - 1 :]

        def slope(windows: int) -> float:
            return (levels[-1] - levels[-1 - windows]) / (windows * SquealSettings().window)

        if slope(2) < _FALLING or self.stability is None or self.stability.unstable:
            return slope(2) < _FALLING
        falling = max(_FALLING, min(_SLOWLY, 0.5 * self.stability.growth_rate * _DB_PER_NEPER))
        return max(slope(2), slope(len(levels) - 1)) < falling

    @property
    def duration(self) -> float:
        """Length [s]."""
        return self.end - self.begin

    @property
    def contact_loss_share(self) -> float:
        """Share of time off the belt; nan where no truth was recorded."""
        return self.off_belt / self.true_samples if self.true_samples else math.nan

    @property
    def contact_loss_time(self) -> float:
        """Time off the belt [s]."""
        return self.contact_loss_share * self.duration

    @property
    def mu_set(self) -> float:
        """Friction coefficient of the law at this operating point."""
        return friction_coefficient(self.parameters)

    def spectrum(self) -> tuple[Values, Values]:
        """Frequencies [Hz] and amplitudes [m] of x over the segment's last half second."""
        return amplitude_spectrum(np.concatenate(self.signal), self.sample_rate)

    def squeal_frequency(self) -> float:
        """Measured squeal frequency [Hz]; nan where there is no squeal."""
        return peak_frequency(*self.spectrum(), *_MODE_BAND) if self.squealing else math.nan


@dataclass
class Course:
    """The run in time: one row a block (10 ms), one row a detector window, one row a friction window."""

    blocks: list[tuple[float, ...]] = field(default_factory=list)
    levels: list[tuple[float, ...]] = field(default_factory=list)
    windows: list[dict[str, float]] = field(default_factory=list)

    BLOCK_COLUMNS = ("t", "preload", "belt_speed", "x_min", "x_max", "y_min", "y_max", "off_belt")
    LEVEL_COLUMNS = ("t", "detected", "level", "frequency")

    def block_column(self, name: str) -> Values:
        """One column of the block rows."""
        return np.array([row[self.BLOCK_COLUMNS.index(name)] for row in self.blocks])

    def level_column(self, name: str) -> Values:
        """One column of the detector's rows."""
        return np.array([row[self.LEVEL_COLUMNS.index(name)] for row in self.levels])

    def window_column(self, name: str) -> Values:
        """One field of the friction windows."""
        return np.array([window[name] for window in self.windows])


@dataclass(frozen=True)
class Analysis:
    """All that is known of a recorded run; `no_zone`: why some operating point has no zone."""

    title: str
    sample_rate: int
    lost_samples: int
    restarts: int
    segments: list[Segment]
    course: Course
    duration: float
    no_zone: str = ""


def analyse_bag(path: Path | str) -> Analysis:
    """Analyse a recording of the rig from its samples alone, with today's code.

    Raises:
        RecordingError: the bag cannot be read or holds no samples.
    """
    bag = Bag(path)
    analyser: _Analyser | None = None
    for block in recorded_blocks(bag):
        if analyser is None:
            analyser = _Analyser(block)
        analyser.add(block)
    if analyser is None:
        raise RecordingError(f"{path} holds no samples")
    return analyser.finished(Path(path).name)


class _Analyser:
    """Goes once through the blocks of a run."""

    def __init__(self, first: RecordedBlock) -> None:
        self._rate = first.rig.sample_rate
        self._friction = FrictionEstimator(first.rig, FrictionSettings())
        self._squeal = SquealDetector(self._rate, SquealSettings())
        self._squeal.take_rig(first.rig)
        self._described = first.rig
        self._course = Course()
        self._segments: list[Segment] = []
        self._end = 0  # samples from the first one to the end of the newest block
        self._next_seq = int(first.daq["seq"][0])
        # The estimator's sample number `_origin` is number 0 of the course; another one once the rig was started anew.
        self._origin = self._next_seq
        self._restarts = 0

    def add(self, block: RecordedBlock) -> None:
        """Take the next block."""
        daq, rig = block.daq, block.rig
        self._friction.rig = rig
        if rig is not self._described:
            self._squeal.take_rig(rig)
            self._described = rig
        seq = int(daq["seq"][0])
        missing = samples_missing(self._next_seq, seq)
        if missing is None:
            self._restarts += 1
            self._origin = seq - self._end
        begin, length = (self._end + (missing or 0)) / self._rate, len(daq) / self._rate
        self._end += (missing or 0) + len(daq)
        self._next_seq = seq + len(daq)
        for state in self._squeal.add_samples(block.stamp, daq):
            self._course.levels.append((begin + length, float(state.detected), state.level, state.frequency))
        windows = self._friction.add_samples(block.stamp, daq)[2]
        if block.truth is not None:
            windows += self._friction.add_truth(block.truth)
        off_belt = math.nan if block.truth is None else float(np.mean(block.truth["normal_force"] <= 0.0))
        extremes = [float(f(daq[axis])) for axis in ("x", "y") for f in (np.min, np.max)]
        self._course.blocks.append(
            (begin, float(daq["preload"][-1]), float(daq["belt_speed"][-1]), *extremes, off_belt)
        )
        segment = self._segment_of(block, begin, restarted=missing is None)
        if missing:
            segment.signal.clear()  # a spectrum across a gap is none of the rig's
        self._extend(segment, block, begin + length)
        offset = self._origin / self._rate
        for window in windows:
            times = {name: window.values[name] - offset for name in ("t_start", "t_end")}
            self._course.windows.append({**window.values, **times})

    def _segment_of(self, block: RecordedBlock, begin: float, restarted: bool) -> Segment:
        """The segment the block belongs to: a new one when the operating point or squeal has changed, or the rig has
        been started anew.

        Where the rig has noise, a block's mean preload and speed may differ from the segment's by `point_tolerance`: of
        blocks at one operating point it splits off wrongly the share `tolerances.FALSE_SPLIT`. A ramp splits where it
        moves by more than that. A changed set point splits too.
        """
        preload, belt_speed = measured_point(block.rig, block.daq, exact=0)
        p = block.rig.parameters.replace(preload=preload, belt_speed=belt_speed)
        state = self._squeal.state
        squealing = None if math.isnan(state.level) else state.detected
        last = self._segments[-1] if self._segments else None
        if last is None or restarted or squealing != last.squealing or not self._continues(last, p, block):
            last = Segment(begin, p, squealing, sample_rate=float(self._rate), rig=block.rig)
            self._segments.append(last)
        last.preloads.append(preload)
        last.belt_speeds.append(belt_speed)
        return last

    @staticmethod
    def _continues(segment: Segment, p: RigParameters, block: RecordedBlock) -> bool:
        """Whether a block with these measured parameters is of the segment's operating point."""
        tolerance = point_tolerance(block.rig, len(block.daq), len(block.daq) * len(segment.preloads))
        if tolerance.exact or segment.rig is None:
            return p == segment.parameters
        at = {"preload": p.preload, "belt_speed": p.belt_speed}
        return (
            segment.rig.parameters == block.rig.parameters
            and segment.parameters.replace(**at) == p
            and abs(p.preload - segment.mean_preload) <= tolerance.preload
            and abs(p.belt_speed - segment.mean_belt_speed) <= tolerance.belt_speed
        )

    def _extend(self, segment: Segment, block: RecordedBlock, end: float) -> None:
        segment.end = end
        segment.samples += len(block.daq)
        if block.truth is not None:
            segment.true_samples += len(block.truth)
            segment.off_belt += int(np.count_nonzero(block.truth["normal_force"] <= 0.0))
        segment.signal.append(np.array(block.daq["x"]))
        keep = math.ceil(_SPECTRUM_SECONDS * self._rate / len(block.daq))
        del segment.signal[:-keep]

    def finished(self, title: str) -> Analysis:
        """The analysis, once all blocks were taken."""
        segments, half = [s for s in self._segments if s.duration >= SHORTEST_SEGMENT], 0.5 / self._rate
        for segment in segments:
            _settle(segment)
            segment.levels = [level for t, _, level, _ in self._course.levels if segment.begin < t <= segment.end]
            for window in self._course.windows:
                # Both ends are sums of other numbers: half a sample is rounding.
                if segment.begin - half <= window["t_start"] and window["t_end"] <= segment.end + half:
                    segment.mu.append(window["mu"])
                    segment.mu_ratio.append(window["mu_ratio_of_means"])
                    segment.mu_true.append(window["mu_true"])
                    segment.mu_corrected.append(window["mu_corrected"])
                    segment.arms.append((window["arm_left"], window["arm_right"]))
            try:
                segment.stability = stability_report(segment.parameters)
            except ModelError:
                segment.stability = None  # shown as none: there is nothing to compare with
        no_zone = _find_zones(segments)
        duration = self._end / self._rate
        lost = self._friction.lost_samples
        return Analysis(title, self._rate, lost, self._restarts, segments, self._course, duration, no_zone)


def _settle(segment: Segment) -> None:
    """Give a segment of a rig with noise its operating point: the set point where the means tell no other one.

    So the same operating point has the same parameters whenever it comes, and is judged alike.
    """
    if segment.rig is None:
        return
    p = segment.rig.parameters
    tolerance = set_point_tolerance(segment.rig, segment.samples)
    if point_tolerance(segment.rig, segment.samples).exact:
        return
    at = {"preload": segment.mean_preload, "belt_speed": segment.mean_belt_speed}
    for name, mean in at.items():
        if abs(mean - getattr(p, name)) <= getattr(tolerance, name):
            at[name] = getattr(p, name)
    segment.parameters = segment.parameters.replace(**at)


def _find_zones(segments: list[Segment]) -> str:
    """Find the zone of each segment, once for each operating point; returns why one has none."""
    known: dict[RigParameters, str] = {}
    reason = ""
    for segment in segments:
        p = segment.parameters
        if p not in known and len(known) == _MOST_ZONES:
            return f"it is computed for the first {_MOST_ZONES} different operating points"
        if p not in known:
            known[p], reason = _zone_of(p, reason)
        segment.zone = known[p]
    return reason


def _zone_of(p: RigParameters, reason: str) -> tuple[str, str]:
    """Name of a zone with the reason as it is, or that there is none, and why."""
    refusal = friction_refusal(p)
    if refusal:
        return NOT_AVAILABLE, refusal
    try:
        return zone(p).name, reason
    except ModelError as error:
        return NOT_AVAILABLE, str(error)


def segment_rows(analysis: Analysis) -> Iterator[dict[str, Any]]:
    """One row a segment, for tables: name with unit -> value (nan where there is none)."""
    for segment in analysis.segments:
        s = segment.stability
        yield {
            "from [s]": segment.begin,
            "to [s]": segment.end,
            "F [N]": segment.parameters.preload,
            "V [m/s]": segment.parameters.belt_speed,
            "k [N/m]": 0.5 * (segment.parameters.k1 + segment.parameters.k2),
            "k_cr [N/m]": s.critical_pad_stiffness if s else math.nan,
            "margin": s.margin if s else math.nan,
            "eigenvalues": "none" if s is None else "unstable" if s.unstable else "stable",
            "zone": segment.zone,
            "rig": "rings down" if segment.rings_down else _WORDS[segment.squealing],
            "mu set": segment.mu_set,
            "mu (2.2)": _mean(segment.mu),
            "mu ratio": _mean(segment.mu_ratio),
            "mu corrected": _mean(segment.mu_corrected),
            "± 95 % scatter": segment.confidence()[0],
            "± 95 % with sheets": segment.confidence()[1],
            "mu true": _mean(segment.mu_true),
            "f squeal [Hz]": segment.squeal_frequency(),
            "f eigen [Hz]": s.squeal_frequency if s else math.nan,
            "off belt [s]": segment.contact_loss_time,
            "off belt share": segment.contact_loss_share,
        }


def _mean(values: Iterable[float]) -> float:
    finite = [value for value in values if math.isfinite(value)]
    return float(np.mean(finite)) if finite else math.nan
