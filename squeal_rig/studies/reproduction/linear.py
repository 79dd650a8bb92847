"""Figs. 5 to 9: eigenvalues over the pad stiffness, critical stiffness over the preload, and maps beyond the paper."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from squeal_rig.estimation.calibration.targets import Target
from squeal_rig.model.linear.eigen import critical_pad_stiffness, stability_band
from squeal_rig.model.linear.maps import stability_map
from squeal_rig.model.parameters import RigParameters
from squeal_rig.studies.reproduction.paper import PaperNumbers

Values = NDArray[np.float64]

#: Operating points (F [N], V [m/s]) of Figs. 5 to 8.
FIGURE_POINTS = ((5, 50.0, 1.0), (6, 50.0, 4.0), (7, 200.0, 1.0), (8, 200.0, 4.0))
#: The stiffnesses of the dashed lines [N/m].
STIFFNESS_LINES = (2e7, 4e7, 6e7)
FIGURE_9_SPEEDS = (1.0, 4.0)
_SIDE = 1e-3


@dataclass(frozen=True)
class Locus:
    """Eigenvalues (n, 4) [rad/s] over the pad stiffness (n,) [N/m], with k_cr [N/m]."""

    figure: int
    preload: float
    belt_speed: float
    stiffness: Values
    eigenvalues: NDArray[np.complex128]
    k_cr: float


@dataclass(frozen=True)
class ThresholdRow:
    """A threshold of the paper beside the rig's, and whether eigenvalues confirm it 0.1 % on either side."""

    paper: Target
    k_cr: float
    confirmed: bool

    @property
    def error(self) -> float:
        """Relative difference to the paper's value."""
        return self.k_cr / self.paper.value - 1.0


def eigenvalue_loci(p: RigParameters, top: float = 1e8, points: int = 401) -> list[Locus]:
    """Figs. 5 to 8: eigenvalues of the linear model over k1 = k2."""
    stiffness = np.linspace(0.0, top, points)
    loci = []
    for figure, preload, speed in FIGURE_POINTS:
        q = p.replace(preload=preload, belt_speed=speed)
        values = stability_map(q, bands=False, eigenvalues=True, pad_stiffness=stiffness).eigenvalues
        assert values is not None
        loci.append(Locus(figure, preload, speed, stiffness, values, critical_pad_stiffness(q)))
    return loci


def threshold_rows(p: RigParameters, paper: PaperNumbers) -> list[ThresholdRow]:
    """The eight thresholds, each confirmed by eigenvalues: stable 0.1 % below, unstable 0.1 % above."""
    rows = []
    for threshold in paper.thresholds:
        q = p.replace(preload=threshold.preload, belt_speed=threshold.belt_speed)
        k_cr = critical_pad_stiffness(q)
        sides = k_cr * np.array([1.0 - _SIDE, 1.0 + _SIDE])
        below, above = ~np.isnan(stability_map(q, bands=False, pad_stiffness=sides).squeal_frequency)
        rows.append(ThresholdRow(threshold, k_cr, bool(above and not below)))
    return rows


def critical_map(p: RigParameters, preloads: Values, speeds: Values) -> Values:
    """Fig. 9 and beyond: k_cr [N/m] over (speeds [m/s], preloads [N]), (m, n); nan where no stiffness is unstable."""
    return stability_map(p, preload=preloads, belt_speed=speeds[:, None]).critical_pad_stiffness


def growth_map(p: RigParameters, preloads: Values, stiffnesses: Values) -> Values:
    """Largest Re lambda [1/s] of the linear model over (preloads, stiffnesses), shape (m, n)."""
    return stability_map(p, bands=False, preload=preloads[:, None], pad_stiffness=stiffnesses).growth_rate


def threshold_preload(p: RigParameters, highest: float) -> float | None:
    """Lowest preload [N] up to `highest` at which the stiffness of `p` becomes unstable; None where there is none."""
    k = 0.5 * (p.k1 + p.k2)
    grid = np.linspace(0.0, highest, 401)
    found = stability_map(p, preload=grid)
    unstable = (found.critical_pad_stiffness < k) & (k < found.upper_pad_stiffness)
    if not unstable.any():
        return None
    first = int(unstable.argmax())
    if first == 0:
        return 0.0
    low, high = float(grid[first - 1]), float(grid[first])
    for _ in range(40):
        middle = 0.5 * (low + high)
        lower, upper = stability_band(p.replace(preload=middle))
        low, high = (low, middle) if lower < k < upper else (middle, high)
    return high
