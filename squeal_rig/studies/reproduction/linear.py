"""Figs. 5 to 9: eigenvalues over the pad stiffness, critical stiffness over the preload, and maps beyond the paper."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from squeal_rig.model.linear.eigen import eigenvalues, is_unstable
from squeal_rig.model.linear.stability import critical_pad_stiffness, stability_band
from squeal_rig.model.parameters import RigParameters
from squeal_rig.studies.reproduction.paper import PaperNumbers, Threshold

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

    paper: Threshold
    k_cr: float
    confirmed: bool

    @property
    def error(self) -> float:
        """Relative difference to the paper's value."""
        return self.k_cr / self.paper.k_cr - 1.0


def eigenvalue_loci(p: RigParameters, top: float = 1e8, points: int = 401) -> list[Locus]:
    """Figs. 5 to 8: eigenvalues of the linear model over k1 = k2."""
    stiffness = np.linspace(0.0, top, points)
    loci = []
    for figure, preload, speed in FIGURE_POINTS:
        q = p.replace(preload=preload, belt_speed=speed)
        values = np.array([eigenvalues(q.replace(pad_stiffness=float(k)), linear=True) for k in stiffness])
        loci.append(Locus(figure, preload, speed, stiffness, values, critical_pad_stiffness(q)))
    return loci


def critical_curve(p: RigParameters, speed: float, preloads: Values) -> Values:
    """Fig. 9: k_cr [N/m] (n,) over preloads (n,) [N] at one belt speed [m/s]."""
    q = p.replace(belt_speed=speed)
    return np.array([critical_pad_stiffness(q.replace(preload=float(f))) for f in preloads])


def threshold_rows(p: RigParameters, paper: PaperNumbers) -> list[ThresholdRow]:
    """The eight thresholds, each confirmed by eigenvalues: stable 0.1 % below, unstable 0.1 % above."""
    rows = []
    for threshold in paper.thresholds:
        q = p.replace(preload=threshold.preload, belt_speed=threshold.belt_speed)
        k_cr = critical_pad_stiffness(q)
        below, above = (
            is_unstable(eigenvalues(q.replace(pad_stiffness=k_cr * side), linear=True))
            for side in (1.0 - _SIDE, 1.0 + _SIDE)
        )
        rows.append(ThresholdRow(threshold, k_cr, above and not below))
    return rows


def critical_map(p: RigParameters, preloads: Values, speeds: Values) -> Values:
    """k_cr [N/m] over (speeds, preloads), shape (m, n); nan where no stiffness is unstable."""
    return np.array([critical_curve(p, float(v), preloads) for v in speeds])


def growth_map(p: RigParameters, preloads: Values, stiffnesses: Values) -> Values:
    """Largest Re lambda [1/s] of the linear model over (preloads, stiffnesses), shape (m, n)."""
    return np.array(
        [
            [
                float(eigenvalues(p.replace(preload=float(f), pad_stiffness=float(k)), linear=True).real.max())
                for k in stiffnesses
            ]
            for f in preloads
        ]
    )


def threshold_preload(p: RigParameters, highest: float) -> float | None:
    """Lowest preload [N] up to `highest` at which the stiffness of `p` becomes unstable; None where there is none."""
    k = 0.5 * (p.k1 + p.k2)

    def unstable(preload: float) -> bool:
        lower, upper = stability_band(p.replace(preload=preload))
        return bool(lower < k < upper)

    grid = np.linspace(0.0, highest, 401)
    first = next((i for i, f in enumerate(grid) if unstable(float(f))), None)
    if first is None:
        return None
    if first == 0:
        return 0.0
    low, high = float(grid[first - 1]), float(grid[first])
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if unstable(middle) else (middle, high)
    return high
