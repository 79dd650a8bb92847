"""What each source of error does to each estimator, in steady sliding and in squeal, and what averaging buys."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from squeal_rig.instruments.acquisition import Acquisition
from squeal_rig.instruments.data_sheets import DataSheets
from squeal_rig.instruments.driver import Samples
from squeal_rig.instruments.settings import BLOCKS_PER_SECOND, RigSettings
from squeal_rig.instruments.virtual import VirtualRig
from squeal_rig.model.parameters import RigParameters
from squeal_rig.studies.friction_bias.campaign import described, warm_chain
from squeal_rig.studies.friction_bias.estimators import ESTIMATORS, window_estimates
from squeal_rig.studies.friction_bias.sources import ALL, IDEAL, Source

Values = NDArray[np.float64]

#: Window of the tables [s], and the windows of the picture of averaging [s].
WINDOW = 0.2
WINDOWS = (0.02, 0.05, 0.1, 0.2, 0.3, 0.6)
#: Specimens of every instrument.
SPECIMENS = 8
# Recorded [s] once it moves as it will, after so long [s]; instruments begin so much earlier [s].
_RECORDED, _SETTLING, _BEFORE = 1.2, 2.4, 0.2
# A light impact: a hard one finds other motions at this operating point.
_IMPACT = 1e-3


@dataclass(frozen=True)
class Condition:
    """How the rig moves: a name, its parameters, and whether it is hit at the start."""

    name: str
    parameters: RigParameters
    hit: bool


def conditions(p: RigParameters) -> tuple[Condition, Condition]:
    """Steady sliding and squeal of a rig, both at 1 m/s with a damping of 20 N s/m."""
    damped = p.replace(damping_x=20.0, damping_y=20.0, belt_speed=1.0)
    sliding = damped.replace(preload=200.0, pad_stiffness=1e7)
    return (
        Condition("steady sliding", sliding, hit=False),
        Condition("squeal", damped.replace(preload=300.0, pad_stiffness=4e7), hit=True),
    )


@dataclass(frozen=True)
class Stretch:
    """True values of a stretch of one motion, sampled as by ideal instruments, and the mean true mu of it."""

    settings: RigSettings
    daq: Samples
    mu: float


@dataclass(frozen=True)
class Errors:
    """Relative errors of one estimator, of windows (specimens, windows), under one source in one motion."""

    motion: str
    source: str
    estimator: str
    window: float
    relative: Values

    @property
    def bias(self) -> float:
        """Mean of all."""
        return float(self.relative.mean())

    @property
    def window_scatter(self) -> float:
        """Standard deviation between windows of one specimen: what averaging longer makes smaller."""
        return float(np.sqrt(self.relative.var(axis=1, ddof=1).mean())) if self.relative.shape[1] > 1 else float("nan")

    @property
    def specimen_scatter(self) -> float:
        """Standard deviation between specimens' means: what it does not."""
        return float(self.relative.mean(axis=1).std(ddof=1)) if len(self.relative) > 1 else float("nan")

    @property
    def rms(self) -> float:
        """Root mean square of all."""
        return float(np.sqrt(np.mean(self.relative**2)))


@dataclass(frozen=True)
class FrictionErrors:
    """All errors: with the tables' window, and over `WINDOWS` for ideal instruments and all sources together."""

    table: list[Errors]
    averaging: list[Errors]


def move(condition: Condition, actuators: DataSheets) -> Stretch:
    """Let the rig move with these actuators and ideal instruments, until it has settled and then for the record."""
    settings = RigSettings(impact_impulse=_IMPACT)
    rig = Acquisition(VirtualRig(actuators), condition.parameters, settings)
    rig.start(0)
    if condition.hit:
        rig.impact()
    for _ in range(round((_SETTLING - _BEFORE) * BLOCKS_PER_SECOND)):
        rig.next_block()
    blocks = [rig.next_block() for _ in range(round((_RECORDED + _BEFORE) * BLOCKS_PER_SECOND))]
    daq = np.concatenate([block.daq for block in blocks])
    truth = np.concatenate([block.truth for block in blocks if block.truth is not None])
    return Stretch(settings, daq, float(truth["mu"][_skipped(settings) :].mean()))


def estimates(condition: Condition, stretch: Stretch, source: Source, window: float) -> dict[str, Values]:
    """Estimator -> relative error of each window of each specimen (specimens, windows)."""
    rig = described(condition.parameters, source.sheets, stretch.settings)
    found: dict[str, list[Values]] = {name: [] for name in ESTIMATORS}
    for seed in range(SPECIMENS if source.name != IDEAL else 1):
        seen = _seen(stretch, source.sheets, seed)
        for name, mu in window_estimates(rig, seen, window).items():
            found[name].append(mu / stretch.mu - 1.0)
    return {name: np.array(rows) for name, rows in found.items()}


def friction_errors(p: RigParameters, chosen: list[Source]) -> FrictionErrors:
    """Errors of every estimator under every source, in both motions of `conditions`."""
    table, averaging = [], []
    for condition in conditions(p):
        moved: dict[object, Stretch] = {}
        for source in chosen:
            key = (source.sheets.hydraulics, source.sheets.belt_drive)
            if key not in moved:
                moved[key] = move(condition, source.actuators)
            for window in WINDOWS if source.name in (IDEAL, ALL) else (WINDOW,):
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore", RuntimeWarning)
                    found = estimates(condition, moved[key], source, window)
                rows = [Errors(condition.name, source.name, name, window, relative) for name, relative in found.items()]
                averaging += rows if source.name in (IDEAL, ALL) else []
                table += rows if window == WINDOW else []
    return FrictionErrors(table, averaging)


def by_source(rows: list[Errors], motion: str) -> Mapping[str, dict[str, Errors]]:
    """Source -> estimator -> its errors in one motion, in the order they were found in."""
    table: dict[str, dict[str, Errors]] = {}
    for row in rows:
        if row.motion == motion:
            table.setdefault(row.source, {})[row.estimator] = row
    return table


def _skipped(settings: RigSettings) -> int:
    return round(_BEFORE * settings.sample_rate)


def _seen(stretch: Stretch, sheets: DataSheets, seed: int) -> Samples:
    """The stretch as one specimen of the instruments reads it, without the time in which their filters settle."""
    seen = stretch.daq.copy()
    warm_chain(sheets, stretch.settings.sample_rate, seed, stretch.daq).measure(seen)
    kept: Samples = seen[_skipped(stretch.settings) :]
    return kept
