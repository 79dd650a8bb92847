"""The friction law refitted from windows (the paper's Fig. 4b)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from squeal_rig.model.core.law import COEFFICIENTS, friction_basis

#: Two operating points are one when they agree to this share of the larger.
_SAME_POINT = 1e-3


#: Columns of `friction/model`.
MODEL_COLUMNS = (*COEFFICIENTS, "rms_residual", "operating_points")


@dataclass(frozen=True)
class FrictionModel:
    """A fitted law: coefficients by name [SI], RMS of the residuals over operating points, and how many there were."""

    coefficients: Mapping[str, float]
    rms_residual: float
    operating_points: int

    def row(self) -> tuple[float, ...]:
        """The numbers in the order of `MODEL_COLUMNS`."""
        return (*self.coefficients.values(), self.rms_residual, float(self.operating_points))


class FrictionRegression:
    """Gathers windows by operating point and fits the law to the points' means."""

    def __init__(self) -> None:
        self._points: list[list[float]] = []  # [speed, preload, sum of mu, windows]
        self._previous: tuple[float, float] | None = None

    def add(self, belt_speed: float, preload: float, mu: float) -> None:
        """Take one window of steady operation: speed [m/s], preload [N], friction coefficient."""
        for point in self._points:
            if np.allclose(point[:2], (belt_speed, preload), rtol=_SAME_POINT, atol=1e-9):
                point[2] += mu
                point[3] += 1
                return
        self._points.append([belt_speed, preload, mu, 1])

    def add_window(self, window: Mapping[str, float]) -> bool:
        """Take a window of `friction/windows` if it was steady and whole; returns whether it was taken.

        The ratio of means is used: it holds in squeal too, where Eq. (2.2) is biased. A window in which the operating
        point moved differs from the one before it or after it; `steady` is what two equal neighbours are.
        """
        point = (window["belt_speed"], window["preload"])
        steady = self._previous is not None and np.allclose(point, self._previous, rtol=1e-9, atol=0.0)
        self._previous = point
        if not steady or window["valid_share"] < 1.0 or not math.isfinite(window["mu_ratio_of_means"]):
            return False
        self.add(*point, window["mu_ratio_of_means"])
        return True

    def fit(self) -> FrictionModel | None:
        """Least squares over the operating points, or None while they do not determine every coefficient."""
        wanted = len(COEFFICIENTS)
        if len(self._points) < wanted:
            return None
        speed, preload, total, count = np.array(self._points).T
        mu = total / count
        basis = friction_basis(speed, preload)
        # Scaled columns, so that the rank is judged on the points' layout and not on the units.
        scale = np.max(np.abs(basis), axis=0)
        scale[scale == 0.0] = 1.0
        matrix = basis / scale
        coefficients, _, rank, _ = np.linalg.lstsq(matrix, mu, rcond=1e-6)
        if rank < wanted:
            return None
        residual = mu - matrix @ coefficients
        fitted = dict(zip(COEFFICIENTS, (coefficients / scale).tolist(), strict=True))
        return FrictionModel(fitted, float(np.sqrt(np.mean(residual**2))), len(self._points))
