"""What two readings of one thing may differ by: tolerances out of a rig's noise, each with its false-alarm probability.

Where a rig names no noise and no ripple every tolerance is zero. Noise is taken as normal; `correlation` is the time
over which it stays alike, so that a mean over T has the variance noise^2 min(1, correlation/T) (Papoulis, Probability,
Random Variables and Stochastic Processes, 4th ed., 12.1: ergodicity of the mean).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
import scipy  # its parts load when they are used

from squeal_rig.configuration.declared import declarations
from squeal_rig.estimation.settings import SquealSettings
from squeal_rig.instruments.description import RigDescription
from squeal_rig.instruments.driver import Samples
from squeal_rig.model.parameters import RigParameters

#: Probability with which means of one operating point are taken for two: once in 30 years of comparisons every 10 ms.
FALSE_SPLIT = 1e-11
#: Probability with which a window of noise alone is taken for squeal: once in 30 years of windows of 0.1 s.
FALSE_ALARM = 1e-10
#: Probability with which a window has fewer valid samples than noise alone explains.
FALSE_INVALID = 1e-6
_DENOMINATOR = ("arm_left", "arm_right", "preload")
# Lines of a Hann window are alike to their neighbours by 2/3 and 1/6: so many are worth one.
_LINES_ALIKE = 1.0 + 2.0 * (4.0 / 9.0 + 1.0 / 36.0)


def standard_error(rig: RigDescription, channel: str, samples: int) -> float:
    """Standard error of a channel's mean over consecutive samples, in its unit; zero where it has no noise."""
    noise = rig.noise.get(channel, 0.0)
    alike = max(1.0, rig.correlation.get(channel, 0.0) * rig.sample_rate)
    return noise * math.sqrt(min(1.0, alike / max(1, samples)))


@dataclass(frozen=True)
class PointTolerance:
    """By how much the means of preload [N] and belt speed [m/s] may differ at one operating point; zero: not at all."""

    preload: float = 0.0
    belt_speed: float = 0.0

    @property
    def exact(self) -> bool:
        """Whether equal points have equal numbers."""
        return self.preload == 0.0 and self.belt_speed == 0.0


def point_tolerance(
    rig: RigDescription, samples: int, others: int | None = None, probability: float = FALSE_SPLIT
) -> PointTolerance:
    """What means over `samples` and over `others` (as many, when None) may differ by at one operating point.

    z sqrt(s1^2 + s2^2) + 2 ripple, with standard errors s and z such that both channels together exceed it with at most
    `probability`: two normal deviates, two sides each, z = -Phi^-1(probability/4). A periodic deviation moves a mean by
    at most its amplitude, whatever its period.
    """
    z = -NormalDist().inv_cdf(0.25 * probability)

    def of(channel: str) -> float:
        first = standard_error(rig, channel, samples)
        second = standard_error(rig, channel, samples if others is None else others)
        return z * math.hypot(first, second) + 2.0 * rig.ripple.get(channel, 0.0)

    return PointTolerance(of("preload"), of("belt_speed"))


def set_point_tolerance(rig: RigDescription, samples: int, probability: float = FALSE_SPLIT) -> PointTolerance:
    """What a mean over `samples` may differ from the set point that is in force: noise, ripple and the sheet's bounds.

    As `point_tolerance`, with one mean, one amplitude of ripple, and what gain and offset of the channel may be off by:
    each the root of the sum of squares of three bounds, whose sum is at most sqrt(3) times that (Cauchy-Schwarz).
    """
    z = -NormalDist().inv_cdf(0.25 * probability)
    p = rig.parameters

    def of(channel: str, value: float) -> float:
        bound = rig.gain_error.get(channel, 0.0) * abs(value) + rig.offset_error.get(channel, 0.0)
        return z * standard_error(rig, channel, samples) + rig.ripple.get(channel, 0.0) + math.sqrt(3.0) * bound

    return PointTolerance(of("preload", p.preload), of("belt_speed", p.belt_speed))


def measured_point(rig: RigDescription, daq: Samples, exact: int = -1) -> tuple[float, float]:
    """Preload [N] and belt speed [m/s] in force in a block: sample `exact` where there is no noise, else the means.

    What lies beyond the bounds of the rig's parameters by less than `set_point_tolerance` is put on the bound: a belt
    at rest may be read as negative.
    """
    if point_tolerance(rig, len(daq)).exact:
        return float(daq["preload"][exact]), float(daq["belt_speed"][exact])
    tolerance, known = set_point_tolerance(rig, len(daq)), declarations(RigParameters)

    def of(channel: str, allowed: float) -> float:
        mean, bounds = float(np.mean(daq[channel])), known[channel]
        bounded = min(max(mean, bounds.lower), bounds.upper)
        return bounded if abs(mean - bounded) <= allowed else mean

    return of("preload", tolerance.preload), of("belt_speed", tolerance.belt_speed)


def denominator_noise(rig: RigDescription) -> float:
    """Standard deviation of one sample of the denominator of Eq. (2.1) [N], from the noise of its channels."""
    sines = math.sin(rig.parameters.arm_angle_1), math.sin(rig.parameters.arm_angle_2)
    factors = {"arm_left": sines[0], "arm_right": sines[1], "preload": sines[0] + sines[1]}
    return math.sqrt(sum((factor * rig.noise.get(channel, 0.0)) ** 2 for channel, factor in factors.items()))


def least_valid_share(
    rig: RigDescription, mean_normal: float, minimum: float, samples: int, probability: float = FALSE_INVALID
) -> float:
    """Smallest share of valid samples that noise alone leaves a window whose every sample is valid without it.

    A sample falls below `minimum` [N] with q = Phi((minimum - mean)/s), s the noise of the denominator; of n samples,
    alike over the longest correlation of its channels, a share of at most q + z sqrt(q (1 - q)/n) does, but with
    `probability` = Phi(-z) (normal approximation of the binomial, and one sample more for small n q).
    """
    noise = denominator_noise(rig)
    if noise == 0.0 or not math.isfinite(mean_normal):
        return 1.0
    q = float(scipy.special.ndtr((minimum - mean_normal) / noise))
    alike = max(1.0, *(rig.correlation.get(name, 0.0) * rig.sample_rate for name in _DENOMINATOR))
    independent = max(1.0, samples / alike)
    z = -NormalDist().inv_cdf(probability)
    # Where less than `probability` samples of the whole window fall below, none may.
    if q * samples < probability:
        return 1.0
    return max(0.0, 1.0 - q - z * math.sqrt(q * (1.0 - q) / independent) - 1.0 / independent)


def band_noise(rig: RigDescription, low: float, high: float) -> float:
    """Mean square of the noise of x in the band [low, high] Hz [m^2].

    Its one-sided density at low frequency is 2 noise^2 correlation, and no larger anywhere: instruments pass less of
    higher ones. White noise has the correlation of one sample.
    """
    correlation = max(rig.correlation.get("x", 0.0), 1.0 / rig.sample_rate)
    density = 2.0 * rig.noise.get("x", 0.0) ** 2 * correlation
    return min(density * (high - low), rig.noise.get("x", 0.0) ** 2)


def noise_level(rig: RigDescription, settings: SquealSettings, probability: float = FALSE_ALARM) -> float:
    """Mean square [m^2] in the detector's band that noise alone exceeds in a window with at most `probability`.

    P0 chi2^-1(1 - probability; f)/f with P0 of `band_noise`: a sum of squares of alike lines is as chi-square of f
    degrees of freedom (Welch, IEEE Trans. Audio Electroacoust. 15, 1967), f = 2 lines/1.944 for a Hann window.
    """
    floor = band_noise(rig, settings.band_low, settings.band_high)
    if floor == 0.0:
        return 0.0
    lines = max(1.0, (settings.band_high - settings.band_low) * settings.window)
    freedom = max(1.0, 2.0 * lines / _LINES_ALIKE)
    return floor * float(scipy.special.chdtri(freedom, probability)) / freedom
