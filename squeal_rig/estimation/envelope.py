"""How fast squeal grows and dies: the slope of the logarithm of a tone's amplitude, where it is a straight line."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Values = NDArray[np.float64]

# Width of the Gaussian filter as a share of the tone's frequency: an exponential passes it unchanged, and what is 8
# standard deviations of its kernel away (12 ms at 1 kHz) is 1e-14 of itself.
_WIDTH = 1.0 / 8.0
_KERNEL_REACH = 8.0
# Amplitudes used: below this share of the loudest, nearer to which the contact is no longer linear; and above so many
# means of a quiet stretch [s], that which this share of those before are below.
_BELOW_TOP, _ABOVE_FLOOR, _STRETCH, _QUIET = 0.02, 5.0, 0.01, 0.25
#: Least growth over the stretch [nepers], and least number of periods in it.
LEAST_NEPERS, LEAST_PERIODS = 1.0, 5.0
# A slope is given up to this standard error, as a share, and this deviation from a straight line [nepers RMS].
_LARGEST_ERROR, _STRAIGHT = 0.05, 0.05
# Added to the deviation that is noise's [nepers]: far above it samples count alike.
_LEAST_DEVIATION = 0.01


@dataclass(frozen=True)
class Rate:
    """A slope [1/s] (growth positive), its standard error from the noise before [1/s], the RMS deviation from it
    [nepers], the frequency over the stretch [Hz] and the stretch [s]; nan where there is none.
    """

    rate: float = math.nan
    error: float = math.nan
    residual: float = math.nan
    frequency: float = math.nan
    duration: float = math.nan


def analytic(signal: Values, sample_rate: float, frequency: float) -> NDArray[np.complex128]:
    """The analytic signal (n,) of x (n,) around a frequency [Hz], through a Gaussian filter; zero beyond both ends."""
    reach = math.ceil(_KERNEL_REACH * sample_rate / (2.0 * math.pi * _WIDTH * frequency))
    count = 1 << (len(signal) + reach - 1).bit_length()
    transform = np.fft.fft(signal - signal.mean(), count)
    axis = np.fft.fftfreq(count, 1.0 / sample_rate)
    transform *= 2.0 * np.exp(-0.5 * ((axis - frequency) / (_WIDTH * frequency)) ** 2)
    return np.fft.ifft(transform)[: len(signal)]


def growth_rate(signal: Values, sample_rate: float, frequency: float) -> Rate:
    """Growth [1/s] up to the loudest part of a signal (n,) [m], around a frequency [Hz]; `Rate()` where the amplitude
    is no exponential there.
    """
    reach = math.ceil(_KERNEL_REACH * sample_rate / (2.0 * math.pi * _WIDTH * frequency))
    if len(signal) < 3 * reach:
        return Rate()
    moving = analytic(signal, sample_rate, frequency)[reach // 2 : -(reach // 2)]
    amplitude = np.abs(moving)
    top = float(np.quantile(amplitude, 0.98))
    above = np.flatnonzero(amplitude >= _BELOW_TOP * top)
    if top <= 0.0 or above.size == 0:
        return Rate()
    end = int(above[0])
    stretch = max(1, min(end, round(_STRETCH * sample_rate)))
    means = [float(np.mean(amplitude[i : i + stretch])) for i in range(0, max(1, end - stretch + 1), stretch)]
    # The least of many means is less than noise is. And what a filter in double precision leaves of the loud part is
    # there at least.
    quiet = max(float(np.quantile(means, _QUIET, method="lower")), 1e-11 * top / _ABOVE_FLOOR)
    below = np.flatnonzero(amplitude[:end] < quiet * _ABOVE_FLOOR)
    begin = int(below[-1]) + 1 if below.size else 0
    return _fitted(moving[begin:end], quiet, sample_rate, frequency)


def decay_rate(signal: Values, sample_rate: float, frequency: float) -> Rate:
    """Growth [1/s], negative, from the loudest part of a signal on: `growth_rate` of it backwards."""
    found = growth_rate(signal[::-1], sample_rate, frequency)
    return Rate(-found.rate, found.error, found.residual, found.frequency, found.duration)


def _fitted(moving: NDArray[np.complex128], noise: float, sample_rate: float, frequency: float) -> Rate:
    """The straight line by weighted least squares: noise moves the logarithm of an amplitude by their ratio.

    `noise` is the mean amplitude of noise alone, sqrt(pi/2) of its deviation in phase. Behind the filter it stays alike
    for 1/(sqrt(pi) width), the integral of its autocorrelation exp(-(pi width t)^2).
    """
    count = len(moving)
    if count < LEAST_PERIODS * sample_rate / frequency:
        return Rate()
    amplitude = np.abs(moving)
    weights = 1.0 / (_LEAST_DEVIATION**2 + (noise / amplitude) ** 2)
    weights /= weights.sum()
    t = np.arange(count) / sample_rate
    t -= weights @ t
    along = weights * t / (weights @ t**2)
    logarithm = np.log(amplitude)
    slope = float(along @ logarithm)
    residual = math.sqrt(float(weights @ (logarithm - weights @ logarithm - slope * t) ** 2))
    alike = sample_rate / (math.sqrt(math.pi) * _WIDTH * frequency)
    error = math.sqrt(2.0 / math.pi * alike * float(np.sum((along * noise / amplitude) ** 2)))
    if abs(slope) * count / sample_rate < LEAST_NEPERS or residual > _STRAIGHT or error > _LARGEST_ERROR * abs(slope):
        return Rate()
    turning = abs(float(along @ np.unwrap(np.angle(moving))))
    return Rate(slope, error, residual, turning / (2.0 * math.pi), count / sample_rate)
