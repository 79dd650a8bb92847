"""First and second derivative of a sampled displacement, band-limited: what the inertia-corrected estimator rests on.

Finite impulse response of odd length, linear phase, no delay: central differences of eighth order (Fornberg, Math.
Comp. 51, 1988, table 1) behind a low-pass with its edge at `PASS_BAND`, a sinc in a Kaiser window (Oppenheim and
Schafer, Discrete-Time Signal Processing, 3rd ed., 7.5). A parabola is differentiated exactly.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

Values = NDArray[np.float64]

#: Half of the amplitude is left at this frequency [Hz]; nothing of squeal's contact force lies far above.
PASS_BAND = 8000.0
#: Or at this share of the sample rate, where that is lower.
_LARGEST_SHARE = 0.25
# Half-length in periods of the edge, and the Kaiser window's shape: ripple of 0.3 % in the pass band.
_PERIODS, _SHAPE = 2.5, 5.0
# Central differences over four samples on either side.
_AHEAD = np.array([4.0 / 5.0, -1.0 / 5.0, 4.0 / 105.0, -1.0 / 280.0])
_FIRST = np.concatenate([-_AHEAD[::-1], [0.0], _AHEAD])
_BESIDE = np.array([8.0 / 5.0, -1.0 / 5.0, 8.0 / 315.0, -1.0 / 560.0])
_SECOND = np.concatenate([_BESIDE[::-1], [-2.0 * _BESIDE.sum()], _BESIDE])


@dataclass(frozen=True)
class Differentiator:
    """Coefficients (reach,) of both derivatives, in 1/s and 1/s^2, for a sample rate [Hz].

    y' = sum first[k-1] (y[i+k] - y[i-k]) and y'' = sum second[k-1] (y[i+k] + y[i-k] - 2 y[i]).
    """

    sample_rate: float
    first: Values
    second: Values

    @property
    def reach(self) -> int:
        """Samples on either side that a value needs."""
        return len(self.first)

    def __call__(self, y: Values) -> tuple[Values, Values]:
        """First and second derivative (n - 2 reach,) of samples (n,), at all but the outermost `reach` samples."""
        reach = self.reach
        count = max(0, len(y) - 2 * reach)
        middle = y[reach : reach + count]
        slope, curvature = np.zeros(count), np.zeros(count)
        for k in range(1, reach + 1):
            after, before = y[reach + k : reach + k + count], y[reach - k : reach - k + count]
            slope += self.first[k - 1] * (after - before)
            curvature += self.second[k - 1] * ((after - middle) + (before - middle))
        return slope, curvature

    def response(self, frequency: Values) -> tuple[Values, Values]:
        """What is left of y' and y'' at frequencies [Hz], as shares of the true ones."""
        w = 2.0 * math.pi * np.asarray(frequency, dtype=np.float64) / self.sample_rate
        k = np.arange(1, self.reach + 1)
        sine, cosine = np.sin(np.multiply.outer(w, k)), np.cos(np.multiply.outer(w, k))
        rate = self.sample_rate
        return 2.0 * sine @ self.first / (w * rate), 2.0 * (1.0 - cosine) @ self.second / (w * rate) ** 2

    def noise_gain(self, mass: float, damping: float) -> float:
        """Standard deviation of m y'' + c y' [N] per standard deviation of white noise in y [m].

        Args:
            mass: m [kg].
            damping: c [N s/m].
        """
        ahead = mass * self.second + damping * self.first
        behind = mass * self.second - damping * self.first
        middle = -2.0 * mass * float(self.second.sum())
        return math.sqrt(float((ahead**2).sum() + (behind**2).sum()) + middle**2)


@cache
def differentiator(sample_rate: float) -> Differentiator:
    """The differentiator for a sample rate [Hz]."""
    edge = min(PASS_BAND, _LARGEST_SHARE * sample_rate)
    half = math.ceil(_PERIODS * sample_rate / edge)
    low_pass = np.sinc(2.0 * edge / sample_rate * np.arange(-half, half + 1)) * np.kaiser(2 * half + 1, _SHAPE)
    low_pass /= low_pass.sum()
    first, second = (np.convolve(stencil, low_pass)[half + 5 :] for stencil in (_FIRST, _SECOND))
    return Differentiator(sample_rate, first * sample_rate, second * sample_rate**2)
