"""Figs. 10 to 12 and Table 1: the nonlinear model in time."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from squeal_rig.configuration.declared import declarations
from squeal_rig.estimation.harmonics import Harmonic, superharmonics
from squeal_rig.estimation.spectra import amplitude_spectrum, peak_frequency
from squeal_rig.model.core.statics import equilibrium
from squeal_rig.model.linear.eigen import eigenvalues, squeal_frequency
from squeal_rig.model.motion.trajectory import Trajectory, displaced_state, simulate
from squeal_rig.model.parameters import RigParameters
from squeal_rig.studies.reproduction.linear import threshold_preload
from squeal_rig.studies.reproduction.paper import FrequencyRow, PaperNumbers

Values = NDArray[np.float64]

SAMPLE_RATE = 51200.0
#: Start of every run but those with an impact: this many static compressions off the equilibrium, towards the belt.
#: Near the threshold a start grows for a while even where it decays in the end, so it must be far below separation.
SMALL_START = 1e-3
#: Start of the runs with an impact, in static compressions: within the subcritical range of Fig. 12.
IMPACT_START = 0.6
_MODE_BAND = (500.0, 3000.0)
_SETTLE = 2.0
_SPECTRUM = 1.0
_TABLE_DURATION = 10.0
#: Runs of a rig without damping, for each of which the start differs by 1e-9 from the one before.
CHAOTIC_STARTS = 10
_JUMP_SETTLE = 4.0
#: Fig. 12: squeal is a peak after the transient above this many static compressions. Squeal separates the pad, which
#: takes about one; free vibration has decayed far below.
SQUEAL_COMPRESSIONS = 0.5
_JUMP_RESOLUTION = 0.002

Progress = Callable[[str], None]


@dataclass(frozen=True)
class SpectrumCase:
    """Fig. 10: spectrum of x at one point, its fundamental [Hz], the super-harmonics found, the paper's word."""

    preload: float
    stiffness: float
    frequencies: Values
    amplitudes: Values
    fundamental: float
    harmonics: tuple[Harmonic, ...]
    paper_present: bool
    unstable: bool

    @property
    def present(self) -> bool:
        """Whether any super-harmonic was found."""
        return bool(self.harmonics)


@dataclass(frozen=True)
class ForceCase:
    """Fig. 11: normal contact force [N] over time [s] at one stiffness [N/m]."""

    stiffness: float
    t: Values
    normal_force: Values


@dataclass(frozen=True)
class TableRow:
    """Table 1 computed: frequencies [Hz], share of time off the belt, beside the paper's row."""

    paper: FrequencyRow
    f_nonlinear: float
    f_linear: float
    contact_loss_share: float
    duration: float

    @property
    def error(self) -> float:
        """|f_nl - f_lin|/f_nl, the paper's error column."""
        return abs(self.f_nonlinear - self.f_linear) / self.f_nonlinear

    @property
    def contact_loss_s(self) -> float:
        """Time off the belt in the run [s]."""
        return self.contact_loss_share * self.duration


@dataclass(frozen=True)
class UndampedRow:
    """Table 1 without damping: frequencies [Hz] and shares of time off the belt, both (n,), of runs whose starts are
    equal to 1e-8."""

    frequencies: Values
    contact_loss_shares: Values


@dataclass(frozen=True)
class PeakCurve:
    """A curve of Fig. 12: peak |x - x*| [m] (n,) over preload (n,) [N]; jump and threshold [N] or None."""

    stiffness: float
    belt_speed: float
    start: float
    preloads: Values
    peaks: Values
    jump: float | None
    threshold: float | None
    paper_jump: float | None


def _settled(p: RigParameters, settle: float, keep: float, start: float = SMALL_START) -> Trajectory:
    """The motion of the last `keep` seconds [s] of a run, after `settle` seconds."""
    run = simulate(p, settle, SAMPLE_RATE, displaced_state(p, start))
    last = [run.x[-1], run.y[-1], run.vx[-1], run.vy[-1]]
    return simulate(p, keep, SAMPLE_RATE, last)


def spectrum_cases(p: RigParameters, paper: PaperNumbers) -> list[SpectrumCase]:
    """Fig. 10: spectra of x at V = 1 m/s after the transient, super-harmonics by the criterion of `superharmonics`."""
    cases = []
    for (preload, stiffness), present in paper.superharmonics.items():
        q = p.replace(preload=preload, belt_speed=1.0, pad_stiffness=stiffness)
        x = _settled(q, _SETTLE, _SPECTRUM).x
        frequencies, amplitudes = amplitude_spectrum(x, SAMPLE_RATE)
        fundamental, harmonics = superharmonics(frequencies, amplitudes, _MODE_BAND)
        unstable = not math.isnan(squeal_frequency(eigenvalues(q)))
        cases.append(
            SpectrumCase(preload, stiffness, frequencies, amplitudes, fundamental, tuple(harmonics), present, unstable)
        )
    return cases


def force_cases(p: RigParameters, paper: PaperNumbers, stiffnesses: Sequence[float] = (2e7, 10e7)) -> list[ForceCase]:
    """Fig. 11: contact force in squeal at the table's operating point, 10 ms after the transient."""
    cases = []
    for k in stiffnesses:
        q = p.replace(preload=paper.table_preload, belt_speed=paper.table_speed, pad_stiffness=k)
        run = _settled(q, _SETTLE, 0.01)
        cases.append(ForceCase(k, run.t, run.normal_force))
    return cases


def table_rows(p: RigParameters, paper: PaperNumbers, duration: float = _TABLE_DURATION) -> list[TableRow]:
    """Table 1: squeal frequency of x over the last second, contact loss over the whole run from a small start."""
    rows = []
    for row in paper.table:
        q = _at_table(p, paper, row)
        frequency, share = _table_run(q, duration, SMALL_START)
        linear = squeal_frequency(eigenvalues(q, linear=True))
        rows.append(TableRow(row, frequency, linear, share, duration))
    return rows


def undamped_rows(p: RigParameters, paper: PaperNumbers, duration: float = _TABLE_DURATION) -> list[UndampedRow]:
    """Table 1 of a rig without damping, whose motion is chaotic.

    What differs in the last digits, of the start or of the arithmetic, has grown to the size of the motion well within
    the run: a single run says less than the range of several.
    """
    starts = SMALL_START * (1.0 + 1e-9 * np.arange(CHAOTIC_STARTS))
    rows = []
    for row in paper.table:
        q = _at_table(p, paper, row)
        runs = np.array([_table_run(q, duration, start) for start in starts.tolist()])
        rows.append(UndampedRow(runs[:, 0], runs[:, 1]))
    return rows


def _at_table(p: RigParameters, paper: PaperNumbers, row: FrequencyRow) -> RigParameters:
    return p.replace(preload=paper.table_preload, belt_speed=paper.table_speed, pad_stiffness=row.k)


def _table_run(q: RigParameters, duration: float, start: float) -> tuple[float, float]:
    """Squeal frequency of x over the last second [Hz], and share of time off the belt, of a run from `start`."""
    run = simulate(q, duration, SAMPLE_RATE, displaced_state(q, start))
    spectrum = amplitude_spectrum(run.x[-round(_SPECTRUM * SAMPLE_RATE) :], SAMPLE_RATE)
    return peak_frequency(*spectrum, *_MODE_BAND), float(np.mean(run.normal_force <= 0.0))


def peak_displacement(p: RigParameters, start: float, settle: float = _JUMP_SETTLE) -> float:
    """Largest |x - x*| [m] of the last quarter of a run from `start` static compressions.

    Raises:
        ModelError: the motion left every bound.
    """
    x_rest = equilibrium(p)[0]
    keep = 0.25 * settle
    # A quarter of the run is enough to pass the slowest beat of the two modes.
    return float(np.max(np.abs(_settled(p, settle - keep, keep, start).x - x_rest)))


def _squeals(p: RigParameters, start: float) -> tuple[float, bool]:
    """Peak of x [m] after the transient, and whether it is squeal."""
    peak = peak_displacement(p, start)
    return peak, peak > SQUEAL_COMPRESSIONS * (p.pretension_length - equilibrium(p)[1])


def peak_curve(p: RigParameters, preloads: Values, start: float, paper_jump: float | None, highest: float) -> PeakCurve:
    """A curve of Fig. 12, with the jump located by bisection to 0.2 %.

    The jump is the lowest preload from which on the peak displacement exceeds `SQUEAL_COMPRESSIONS`; a curve without
    such a preload up to `highest` [N] has none.
    """
    peaks, loud = [], []
    for f in preloads:
        peak, squeals = _squeals(p.replace(preload=float(f)), start)
        peaks.append(peak)
        loud.append(squeals)
    return PeakCurve(
        0.5 * (p.k1 + p.k2),
        p.belt_speed,
        start,
        preloads,
        np.array(peaks),
        _jump(p, preloads, loud, start, highest),
        threshold_preload(p, highest),
        paper_jump,
    )


def _jump(p: RigParameters, preloads: Values, loud: list[bool], start: float, highest: float) -> float | None:
    """The jump [N] by bisection between the last quiet preload and the first from which on all are loud."""
    first = next((i for i in range(len(loud)) if all(loud[i:])), None)
    low, high = (
        (float(preloads[-1]), highest) if first is None else (float(preloads[first - 1]), float(preloads[first]))
    )
    if first is None and not (highest > low and _squeals(p.replace(preload=highest), start)[1]):
        return None
    if first == 0:
        return float(preloads[0])
    while high - low > _JUMP_RESOLUTION * high:
        middle = 0.5 * (low + high)
        if _squeals(p.replace(preload=middle), start)[1]:
            high = middle
        else:
            low = middle
    return high


def peak_curves(p: RigParameters, paper: PaperNumbers, start: float, progress: Progress) -> list[PeakCurve]:
    """All curves of Fig. 12 for one kind of start; preloads up to the parameter's own bound count for the jump."""
    highest = float(declarations(RigParameters)["preload"].upper)
    preloads = np.linspace(10.0, 300.0, 30)
    curves = []
    for jump in paper.jumps:
        progress(f"Fig. 12: k = {jump.pad_stiffness:.0e} N/m, V = {jump.belt_speed:g} m/s, start {start:g} u")
        q = p.replace(pad_stiffness=jump.pad_stiffness, belt_speed=jump.belt_speed)
        reported = None if math.isnan(jump.value) else jump.value
        curves.append(peak_curve(q, preloads, start, reported, highest))
    return curves
