"""The rig's samples at a sound card's rate, piece by piece and without a seam."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy import signal

Values = NDArray[np.float64]

# As scipy.signal.resample_poly designs its filter: half length in the slower of both rates, and Kaiser's beta.
_HALF_LENGTH, _BETA = 10, 5.0


# What is slower than this is no sound [Hz].
_LOWEST = 20.0


class WithoutOffset:
    """Takes the constant part from a trace at a rate [Hz] by a high-pass of first order; pieces join without a seam."""

    def __init__(self, rate: int) -> None:
        self._pole = math.exp(-2.0 * math.pi * _LOWEST / rate)
        self._state: Values | None = None

    def add(self, values: Values) -> Values:
        """Take samples (n,), n > 0; returns as many. What is not finite is silent, and what follows begins anew."""
        if not np.isfinite(values).all():
            self._state = None
            return np.zeros(len(values))
        begin = np.array([-values[0]]) if self._state is None else self._state
        result: tuple[Values, Values] = signal.lfilter([1.0, -1.0], [1.0, -self._pole], values, zi=begin)
        self._state = result[1]
        return result[0]


class Resampler:
    """Resamples a trace from one whole rate to another [Hz] by a polyphase filter; pieces join without a seam.

    What comes out is `scipy.signal.resample_poly` of all that was put in, but for the end, which waits for what
    follows: the same filter, and every output is summed over the same inputs in the same order.
    """

    def __init__(self, rate_in: int, rate_out: int) -> None:
        common = math.gcd(rate_in, rate_out)
        self.up, self.down = rate_out // common, rate_in // common
        longest = max(self.up, self.down)
        self._half = _HALF_LENGTH * longest if longest > 1 else 0
        design: Values = (
            signal.firwin(2 * self._half + 1, 1.0 / longest, window=("kaiser", _BETA)) if longest > 1 else np.ones(1)
        )
        # Zeros ahead bring an output of the filter onto the first sample, as resample_poly does.
        self._shift = -self._half % self.down
        self._ahead = (self._half + self._shift) // self.down
        self._taps: Values = np.concatenate((np.zeros(self._shift), self.up * design))
        # Inputs an output reaches back over, in whole periods of the pattern of phases, so that pieces keep it.
        self._reach = -(-(len(self._taps) // self.up + 1) // self.down) * self.down
        self._kept: Values = np.zeros(0)
        self._first = 0  # number of the first input kept: a multiple of `down`
        self._done = 0  # outputs given

    def add(self, values: Values) -> Values:
        """Take samples (n,); returns the outputs (m,) that no later sample changes."""
        self._kept = np.concatenate((self._kept, values))
        last = self._first + len(self._kept)
        # Output k of the filter stands at input k down/up and needs none after it.
        whole = max(0, -(-last * self.up // self.down) - self._ahead)
        if whole <= self._done:
            return np.zeros(0)
        offset = self._first // self.down * self.up
        outputs: Values = signal.upfirdn(self._taps, self._kept, self.up, self.down)
        begin = self._done + self._ahead - offset
        given = outputs[begin : begin + whole - self._done]
        self._done = whole
        # The next output's oldest input, rounded down to a whole period.
        oldest = (whole + self._ahead) * self.down // self.up - self._reach
        keep = max(self._first, oldest // self.down * self.down)
        self._kept, self._first = self._kept[keep - self._first :], keep
        return given
