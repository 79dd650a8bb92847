"""Every estimator of mu over windows of one recorded stretch, side by side."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from squeal_rig.estimation.differentiator import differentiator
from squeal_rig.estimation.friction import corrected_ratio_of_means, sample_friction
from squeal_rig.estimation.settings import FrictionSettings
from squeal_rig.instruments.description import RigDescription
from squeal_rig.instruments.driver import Samples
from squeal_rig.instruments.means import contact_forces

Values = NDArray[np.float64]

MEAN_OF_RATIOS, RATIO_OF_MEANS, CORRECTED = "Eq. (2.2)", "ratio of means", "ratio of means, corrected"
MEAN_OF_CORRECTED, LEAST_SQUARES = "Eq. (2.2), corrected", "least squares, corrected"
#: In this order. Each takes its numerator from the torque and its denominator from Eq. (2.1); a corrected one adds
#: m y'' + c_y y' to it. The last two do so sample by sample, the third by the momentum at a window's two ends.
ESTIMATORS = (MEAN_OF_RATIOS, RATIO_OF_MEANS, CORRECTED, MEAN_OF_CORRECTED, LEAST_SQUARES)


def window_estimates(rig: RigDescription, daq: Samples, window: float) -> dict[str, Values]:
    """Estimator -> mu of each whole window of so many seconds (windows,), of samples (n,) without a gap.

    Eq. (2.1) itself, sample by sample, has the mean of Eq. (2.2); samples below the friction estimator's least load do
    not count. Least squares is sum F_t N / sum N^2, which needs no least load.
    """
    p, minimum = rig.parameters, FrictionSettings().minimum_normal_load
    length = round(window * rig.sample_rate)
    tangential, normal = contact_forces(daq, p, rig.drum_radius)
    y = np.ascontiguousarray(daq["y"])
    differentiate = differentiator(float(rig.sample_rate))
    reach = differentiate.reach
    slope, curvature = differentiate(y)
    corrected = np.full(len(y), math.nan)
    corrected[reach : len(y) - reach] = normal[reach : len(y) - reach] + p.mass * curvature + p.damping_y * slope
    found: dict[str, list[float]] = {name: [] for name in ESTIMATORS}
    for begin in range(0, len(y) - length + 1, length):
        part = slice(begin, begin + length)
        f, n = tangential[part], normal[part]
        known = np.isfinite(corrected[part])
        f_known, n_known = f[known], corrected[part][known]
        found[MEAN_OF_RATIOS].append(_mean_of_valid(f, n, minimum))
        found[RATIO_OF_MEANS].append(float(f.sum() / n.sum()))
        found[CORRECTED].append(corrected_ratio_of_means(f, n, y[part], differentiate, p.mass, p.damping_y))
        found[MEAN_OF_CORRECTED].append(_mean_of_valid(f_known, n_known, minimum))
        found[LEAST_SQUARES].append(float(np.dot(f_known, n_known) / np.dot(n_known, n_known)))
    return {name: np.array(values) for name, values in found.items()}


def _mean_of_valid(tangential: Values, normal: Values, minimum: float) -> float:
    mu, valid = sample_friction(tangential, normal, minimum)
    return float(mu[valid].mean()) if valid.any() else math.nan
