"""Intervals of estimated friction: scatter that repeats shrink, and bounds of data sheets that they do not.

A data sheet's gain or offset error is one unknown number, the same in every sample of a rig. It is taken as uniform
within its bound (JCGM 100:2008, 4.3.7) and put beside the scatter by propagating distributions (JCGM 101:2008).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
import scipy  # its parts load when they are used
from numpy.typing import NDArray

from squeal_rig.instruments.description import RigDescription

Values = NDArray[np.float64]

#: Probability that an interval covers what it is of.
LEVEL = 0.95
# Draws of a distribution: a quantile near 0.95 is met within 0.002.
_DRAWS = 4096
# One axis for the scatter, one for the sum of many small bounds, one for each of the largest bounds.
_AXES = 16
_LARGEST = _AXES - 2


@dataclass(frozen=True)
class MeanWithError:
    """Mean of values, its standard error from their scatter, and how many degrees of freedom that has."""

    mean: float
    standard_error: float
    freedom: float


def correlation_factor(residuals: Values) -> float:
    """By how much neighbours that are alike raise the variance of a mean: 1 + 2 sum (1 - k/n) rho_k, at least 1.

    The sum of the n - k products over that of the n squares is (1 - k/n) rho_k as it stands. Over the lags k up to the
    first whose autocorrelation is not positive, or a third of n (Geyer, Statistical Science 7, 1992, 3.3; Anderson, The
    Statistical Analysis of Time Series, 8.2).
    """
    n = len(residuals)
    power = float(np.dot(residuals, residuals))
    factor = 1.0
    if not power > 0.0:
        return factor
    for lag in range(1, n // 3 + 1):
        alike = float(np.dot(residuals[lag:], residuals[:-lag])) / power
        if alike <= 0.0:
            break
        factor += 2.0 * alike
    return factor


def mean_with_error(values: Sequence[float] | Values) -> MeanWithError:
    """Mean of values in the order of time, with its standard error; nan where there are too few finite ones.

    Values that are alike are worth fewer: n/factor of them (`correlation_factor`), with one degree of freedom less.
    """
    known = np.asarray([value for value in values if math.isfinite(value)])
    n = len(known)
    if n < 2:
        return MeanWithError(float(known[0]) if n else math.nan, math.nan, math.nan)
    mean = float(known.mean())
    residuals = known - mean
    factor = correlation_factor(residuals)
    error = math.sqrt(factor * float(np.dot(residuals, residuals)) / (n - 1) / n)
    return MeanWithError(mean, error, max(1.0, n / factor - 1.0))


def half_width(standard_error: float, freedom: float, bounds: Iterable[float] = (), level: float = LEVEL) -> float:
    """Half the width of an interval around an estimate that covers with probability `level`.

    The error is `standard_error` times Student's t of `freedom` degrees plus, for every entry of `bounds`, a uniform
    error within it. Without bounds that is the closed form; with them the distribution's quantile, from 4096 draws at
    fixed points that fill the space evenly (a Sobol sequence: the same numbers every time).
    """
    widths = [abs(bound) for bound in bounds if bound != 0.0]
    if not (math.isfinite(standard_error) and freedom > 0.0):
        return math.nan
    if not widths:
        return standard_error * float(scipy.special.stdtrit(freedom, 0.5 + 0.5 * level))
    widths.sort(reverse=True)
    kept, small = widths[:_LARGEST], widths[_LARGEST:]
    errors = standard_error * _student_draws(round(freedom, 1))
    errors = errors + _uniform_draws()[:, 2 : len(kept) + 2] @ np.array(kept)
    if small:  # the sum of many is as good as normal
        errors = errors + math.sqrt(sum(width**2 for width in small) / 3.0) * scipy.special.ndtri(
            0.5 * (_uniform_draws()[:, 1] + 1.0)
        )
    return float(np.quantile(np.abs(errors), level))


@cache
def _uniform_draws() -> Values:
    from scipy.stats import qmc  # slow to load, and only rigs with bounds need it

    points = qmc.Sobol(_AXES, scramble=False).random(_DRAWS)
    draws: Values = 2.0 * (points + 0.5 / _DRAWS) - 1.0
    return draws


@cache
def _student_draws(freedom: float) -> Values:
    draws: Values = np.asarray(scipy.special.stdtrit(freedom, 0.5 * (_uniform_draws()[:, 0] + 1.0)), dtype=np.float64)
    return draws


@dataclass(frozen=True)
class PointMeans:
    """Means at operating points, each (n,): friction coefficient, belt speed [m/s], preload and arm forces [N]."""

    mu: Values
    belt_speed: Values
    preload: Values
    arm_left: Values
    arm_right: Values


@dataclass(frozen=True)
class Shift:
    """What one unknown error of an instrument, at its bound, does to every point (n,) of a `PointMeans`."""

    name: str
    mu: Values
    belt_speed: Values
    preload: Values


def systematic_shifts(rig: RigDescription, points: PointMeans) -> list[Shift]:
    """Shifts of mu and of the operating point by each gain and offset error of the data sheets, to first order.

    From mu = (torque/R) / (F_l sin th1 + F_r sin th2 + F (sin th1 + sin th2)), Eq. (2.1) of means: a gain error e of
    the torque moves mu by e mu, one of a force by -e mu times that force's share of the denominator. Readings of
    preload and speed are the coordinates of the point too. Gain error and offset error are separate unknown numbers.
    """
    p = rig.parameters
    sines = {"arm_left": math.sin(p.arm_angle_1), "arm_right": math.sin(p.arm_angle_2)}
    sines["preload"] = sines["arm_left"] + sines["arm_right"]
    readings: Mapping[str, Values] = {name: getattr(points, name) for name in (*sines, "belt_speed")}
    normal = np.sum([sines[name] * readings[name] for name in sines], axis=0)
    none = np.zeros(len(points.mu))
    per_unit = {name: -points.mu * sine / normal for name, sine in sines.items()}
    per_unit["motor_torque"] = 1.0 / (rig.drum_radius * normal)
    per_unit["belt_speed"] = none
    readings = {**readings, "motor_torque": points.mu * normal * rig.drum_radius}
    shifts = []
    for kind, errors in (("gain", rig.gain_error), ("offset", rig.offset_error)):
        for channel, bound in errors.items():
            if bound == 0.0 or channel not in per_unit:
                continue
            off = bound * readings[channel] if kind == "gain" else np.full(len(points.mu), bound)
            speed, preload = (off if channel == name else none for name in ("belt_speed", "preload"))
            shifts.append(Shift(f"{kind} of {channel}", per_unit[channel] * off, speed, preload))
    return shifts
