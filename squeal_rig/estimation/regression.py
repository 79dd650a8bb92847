"""The friction law refitted from windows (the paper's Fig. 4b), with intervals of its coefficients."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from squeal_rig.estimation.confidence import PointMeans, half_width, systematic_shifts
from squeal_rig.estimation.tolerances import PointTolerance, least_valid_share, point_tolerance
from squeal_rig.instruments.description import RigDescription
from squeal_rig.model.core.law import COEFFICIENTS, friction_basis, friction_law_slope

Values = NDArray[np.float64]

#: Two operating points are one when they agree to this share of the larger.
_SAME_POINT = 1e-3
# Two neighbouring windows are steady when they agree to this share, and the noise's tolerance.
_STEADY = 1e-9

#: Columns of `friction/model`.
MODEL_COLUMNS = (*COEFFICIENTS, "rms_residual", "operating_points")
#: And those behind, where the rig's instruments have noise: half of each coefficient's 95 % interval.
INTERVAL_COLUMNS = tuple(f"{name}_half_width" for name in COEFFICIENTS)


@dataclass(frozen=True)
class FrictionModel:
    """A fitted law: coefficients by name [SI], RMS of the residuals over operating points, and how many there were.

    `half_widths` are those of the coefficients' 95 % intervals [SI], `systematic` the part of each that more windows do
    not shrink; nan where nothing tells the scatter.
    """

    coefficients: Mapping[str, float]
    rms_residual: float
    operating_points: int
    half_widths: Mapping[str, float] = field(default_factory=dict)
    systematic: Mapping[str, float] = field(default_factory=dict)

    def row(self, intervals: bool = False) -> tuple[float, ...]:
        """The numbers in the order of `MODEL_COLUMNS`, and of `INTERVAL_COLUMNS` where wanted."""
        numbers = (*self.coefficients.values(), self.rms_residual, float(self.operating_points))
        return (*numbers, *(self.half_widths[name] for name in COEFFICIENTS)) if intervals else numbers


class _Point:
    """Windows of one operating point: its coordinates are the first one's, or their mean where there is noise."""

    def __init__(self, belt_speed: float, preload: float) -> None:
        self.belt_speed, self.preload = belt_speed, preload
        self.windows = 0
        self.mu = 0.0
        self.sums = np.zeros(4)  # speed, preload, arm forces
        self._mean = self.scatter = 0.0  # sum of squares about the mean, by Welford's recurrence

    def take(self, belt_speed: float, preload: float, mu: float, arms: tuple[float, float]) -> None:
        """Take one window."""
        self.windows += 1
        self.mu += mu
        self.sums += (belt_speed, preload, *arms)
        before, self._mean = self._mean, self._mean + (mu - self._mean) / self.windows
        self.scatter += (mu - before) * (mu - self._mean)


class FrictionRegression:
    """Gathers windows by operating point and fits the law to the points' means.

    Without noise equal points have equal numbers and every point counts alike. Where the rig has noise, tolerances are
    those of `point_tolerance`, and a point counts by its windows.
    """

    def __init__(self) -> None:
        self._points: list[_Point] = []
        self._previous: tuple[float, float] | None = None
        self._rig: RigDescription | None = None
        self._window, self._minimum_normal_load = 1, 0.0
        self._tolerance = PointTolerance()

    def take_rig(self, rig: RigDescription, window_samples: int, minimum_normal_load: float) -> None:
        """Take the rig whose noise the tolerances follow, samples of a window and the estimator's least load [N]."""
        self._rig, self._window, self._minimum_normal_load = rig, window_samples, minimum_normal_load
        self._tolerance = point_tolerance(rig, window_samples)

    def add(
        self, belt_speed: float, preload: float, mu: float, arms: tuple[float, float] = (math.nan, math.nan)
    ) -> None:
        """Take one window of steady operation: speed [m/s], preload [N], friction coefficient, mean arm forces [N]."""
        for point in self._points:
            known = (point.belt_speed, point.preload)
            if not self._tolerance.exact:
                known = (point.sums[0] / point.windows, point.sums[1] / point.windows)
            if self._alike(known, (belt_speed, preload), _SAME_POINT, 1e-9):
                point.take(belt_speed, preload, mu, arms)
                return
        self._points.append(_Point(belt_speed, preload))
        self._points[-1].take(belt_speed, preload, mu, arms)

    def add_window(self, window: Mapping[str, float]) -> bool:
        """Take a window of `friction/windows` if it was steady and whole; returns whether it was taken.

        The ratio of means is used: it holds in squeal too, where Eq. (2.2) is biased. A window in which the operating
        point moved differs from the one before it or after it; `steady` is what two equal neighbours are. Where there
        is noise, neighbours may differ by `point_tolerance` and samples may be as invalid as `least_valid_share` says:
        of steady windows, so many are refused as the two functions' probabilities tell.
        """
        point = (window["belt_speed"], window["preload"])
        steady = self._previous is not None and self._alike(point, self._previous, _STEADY, 0.0)
        self._previous = point
        if not steady or not math.isfinite(window["mu_ratio_of_means"]) or not self._is_valid(window):
            return False
        arms = (window.get("arm_left", math.nan), window.get("arm_right", math.nan))
        self.add(*point, window["mu_ratio_of_means"], arms)
        return True

    def _alike(self, one: tuple[float, float], other: tuple[float, float], share: float, least: float) -> bool:
        """Whether two points (speed, preload) are one: within a share of `other`, a least difference and the noise."""
        noise = (self._tolerance.belt_speed, self._tolerance.preload)
        return all(
            math.isfinite(a) and abs(a - b) <= max(tolerance, least) + share * abs(b)
            for a, b, tolerance in zip(one, other, noise, strict=True)
        )

    def _is_valid(self, window: Mapping[str, float]) -> bool:
        share = window["valid_share"]
        if share >= 1.0 or self._rig is None or not self._rig.noise:
            return share >= 1.0
        p = self._rig.parameters
        sines = math.sin(p.arm_angle_1), math.sin(p.arm_angle_2)
        normal = sines[0] * window["arm_left"] + sines[1] * window["arm_right"] + sum(sines) * window["preload"]
        return share >= least_valid_share(self._rig, normal, self._minimum_normal_load, self._window)

    def fit(self) -> FrictionModel | None:
        """Least squares over the operating points, or None while they do not determine every coefficient."""
        wanted = len(COEFFICIENTS)
        if len(self._points) < wanted:
            return None
        exact = self._tolerance.exact
        count = np.array([point.windows for point in self._points])
        mu = np.array([point.mu for point in self._points]) / count
        means = np.array([point.sums for point in self._points]).T / count
        if exact:
            means[:2] = np.array([(point.belt_speed, point.preload) for point in self._points]).T
        speed, preload = means[:2]
        basis = friction_basis(speed, preload)
        # Scaled columns, so that the rank is judged on the points' layout and not on the units.
        scale = np.max(np.abs(basis), axis=0)
        scale[scale == 0.0] = 1.0
        noisy = self._rig is not None and bool(self._rig.noise)  # in any channel: it is in mu
        weight = np.sqrt(count / np.mean(count)) if noisy else np.ones(len(count))
        matrix = basis / scale
        coefficients, _, rank, _ = np.linalg.lstsq(matrix * weight[:, None], mu * weight, rcond=1e-6)
        if rank < wanted:
            return None
        residual = mu - matrix @ coefficients
        fitted = dict(zip(COEFFICIENTS, (coefficients / scale).tolist(), strict=True))
        inverse = np.linalg.pinv(matrix * weight[:, None]) / scale[:, None]  # of weighted mu to coefficients
        half, systematic = self._intervals(fitted, PointMeans(mu, *means), residual * weight, inverse, weight)
        return FrictionModel(fitted, float(np.sqrt(np.mean(residual**2))), len(self._points), half, systematic)

    def _intervals(
        self, fitted: Mapping[str, float], points: PointMeans, residual: Values, inverse: Values, weight: Values
    ) -> tuple[dict[str, float], dict[str, float]]:
        """Half widths of the 95 % intervals, and of their systematic part alone, by coefficient.

        The scatter is that of the points about the fitted law, weighted by windows, with Student's t of as many degrees
        of freedom as there are points beyond the coefficients (N. R. Draper and H. Smith, Applied Regression Analysis,
        3rd ed., 5.1, 9.2): whatever is alike within a point is in it. With just as many points as coefficients it is
        that of the windows within points. Beside it stand the sheets' gain and offset errors, the same at all points:
        each moves the coefficients by the fit of what it does to the points (`systematic_shifts`).
        """
        spare = len(residual) - len(COEFFICIENTS)
        if spare > 0:
            variance, freedom = float(residual @ residual) / spare, float(spare)
        else:
            freedom = float(sum(point.windows - 1 for point in self._points))
            mean_count = float(np.mean([point.windows for point in self._points]))
            scatter = sum(point.scatter for point in self._points)
            variance = scatter / freedom / mean_count if freedom else math.nan
        errors = np.sqrt(variance * (inverse**2).sum(axis=1))
        shifts = []
        if self._rig is not None and np.isfinite(points.arm_left + points.arm_right).all():
            slope_v, slope_f = friction_law_slope(fitted, points.preload), _preload_slope(fitted, points.belt_speed)
            for shift in systematic_shifts(self._rig, points):
                moved = shift.mu - slope_v * shift.belt_speed - slope_f * shift.preload
                shifts.append(inverse @ (moved * weight))
        table = np.array(shifts).reshape(len(shifts), len(COEFFICIENTS))
        half, systematic = {}, {}
        for i, name in enumerate(COEFFICIENTS):
            half[name] = half_width(float(errors[i]), freedom, table[:, i])
            systematic[name] = half_width(0.0, 1.0, table[:, i])
        return half, systematic


def _preload_slope(c: Mapping[str, float], speed: Values) -> Values:
    """d mu/dF [1/N] of the law, which is linear in its coefficients and in the preload."""
    basis = friction_basis(speed, np.ones(len(speed))) - friction_basis(speed, np.zeros(len(speed)))
    slope: Values = basis @ np.array([c[name] for name in COEFFICIENTS])
    return slope
