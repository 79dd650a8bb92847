"""Squeal detection: level of the pad's displacement in a band over a window, with hysteresis."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from squeal_rig.errors import ParameterError
from squeal_rig.estimation.settings import SquealSettings
from squeal_rig.estimation.spectra import (
    REFERENCE,
    amplitude_spectrum,
    band_rms,
    level_db,
    peak_frequency,
    refuse_empty_band,
)
from squeal_rig.estimation.tolerances import noise_level
from squeal_rig.instruments.description import RigDescription
from squeal_rig.instruments.driver import Samples
from squeal_rig.instruments.numbering import SEQ_MODULUS


@dataclass(frozen=True)
class SquealState:
    """Whether the rig squeals: level [dB re 1 um] and frequency [Hz] of the last window, stamps in ns.

    `since` is the stamp of the window in which squeal began, None while there is none.
    """

    stamp: int
    detected: bool
    level: float
    frequency: float
    since: int | None


class SquealDetector:
    """Takes blocks of `daq/samples`; gives a state at the end of every window.

    Windows follow one another by sample count; a gap in the samples starts a window anew, since a spectrum over a gap
    would be none of the rig's. A window with a value that is not finite gives no state, and `state` has no level then.

    Where the rig's displacement has noise (`take_rig`), the mean square that noise alone exceeds with the probability
    `tolerances.FALSE_ALARM` is added to those of both levels: a rig that does not squeal is not called squealing, and
    squeal that has ended is called so. Levels in the states are what was measured, with the noise in them.

    Raises:
        ParameterError: the band reaches above half the sample rate, or the window is too short for it.
    """

    def __init__(self, sample_rate: int, settings: SquealSettings) -> None:
        if settings.band_high > 0.5 * sample_rate:
            raise ParameterError(
                f"band_high = {settings.band_high:g} Hz is above half the sample rate, {0.5 * sample_rate:g} Hz:"
                " nothing can be seen there"
            )
        self._rate = sample_rate
        self._settings = settings
        self._signal = np.empty(max(2, round(settings.window * sample_rate)))
        refuse_empty_band(sample_rate, len(self._signal), settings.band_low, settings.band_high)
        self._filled = 0
        self._expected: int | None = None
        self._stamp = 0
        #: Levels [dB re 1 um] at which squeal begins and ends, noise considered.
        self.on_level, self.off_level = settings.on_level, settings.off_level
        self.state = SquealState(0, False, level_db(0.0), float("nan"), None)

    def take_rig(self, rig: RigDescription) -> None:
        """Take the rig whose noise the levels are to stand out of."""
        s, noise = self._settings, noise_level(rig, self._settings)
        self.on_level, self.off_level = s.on_level, s.off_level
        if noise:
            self.on_level, self.off_level = (
                level_db(math.sqrt(REFERENCE**2 * 10.0 ** (0.1 * level) + noise)) for level in (s.on_level, s.off_level)
            )

    def add_samples(self, stamp: int, daq: Samples) -> list[SquealState]:
        """Take a block; returns the states of the windows it completed."""
        seq = int(daq["seq"][0])
        if self._expected is not None and seq != self._expected:
            self._filled = 0
        self._expected = (seq + len(daq)) % SEQ_MODULUS
        states, taken = [], 0
        while taken < len(daq):
            if self._filled == 0:
                self._stamp = stamp + round(float(daq["t"][taken]) * 1e9)
            count = min(len(daq) - taken, len(self._signal) - self._filled)
            self._signal[self._filled : self._filled + count] = daq["x"][taken : taken + count]
            self._filled += count
            taken += count
            if self._filled == len(self._signal):
                if np.isfinite(self._signal).all():
                    states.append(self._judge())
                else:
                    self.state = SquealState(self._stamp, False, float("nan"), float("nan"), None)
                self._filled = 0
        return states

    def _judge(self) -> SquealState:
        s = self._settings
        frequencies, amplitudes = amplitude_spectrum(self._signal, self._rate)
        level = level_db(band_rms(frequencies, amplitudes, s.band_low, s.band_high))
        detected = level >= (self.off_level if self.state.detected else self.on_level)
        frequency = peak_frequency(frequencies, amplitudes, s.band_low, s.band_high) if detected else float("nan")
        since = (self.state.since if self.state.detected else self._stamp) if detected else None
        self.state = SquealState(self._stamp, detected, level, frequency, since)
        return self.state
