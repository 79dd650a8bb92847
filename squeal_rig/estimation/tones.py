"""Tones in a window of x: lines that stand out of the noise beside them by a stated factor, with their level."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from squeal_rig.errors import ParameterError
from squeal_rig.estimation.detection import RANK, mean_of_rank, reference_bins, tonality_for
from squeal_rig.estimation.settings import SquealSettings, ToneSettings
from squeal_rig.estimation.spectra import amplitude_spectrum, level_db

Values = NDArray[np.float64]

# A Hann line spreads over so many bins on either side; and how much noise bandwidth, in bins.
_HALF_WIDTH, _NOISE_BANDWIDTH = 2, 1.5
# Below this share of the loudest line, leakage and rounding of the transform stand beside it [power]: -120 dB.
_DYNAMICS = 1e-12


@dataclass(frozen=True)
class Tone:
    """One tone: frequency [Hz], level of its RMS [dB re 1 um], tonality [dB over the noise beside it]."""

    frequency: float
    level: float
    tonality: float


class ToneFinder:
    """Finds the tones of windows of one length.

    Raises:
        ParameterError: the band reaches above half the sample rate, or the window is too short for the band.
    """

    def __init__(self, sample_rate: float, samples: int, band: SquealSettings, settings: ToneSettings) -> None:
        if band.band_high > 0.5 * sample_rate:
            raise ParameterError(
                f"band_high = {band.band_high:g} Hz is above half the sample rate, {0.5 * sample_rate:g} Hz:"
                " nothing can be seen there"
            )
        self._rate, self._samples = sample_rate, samples
        count, spacing = samples // 2 + 1, sample_rate / samples
        first, last = max(3, math.ceil(band.band_low / spacing)), min(count - 4, math.floor(band.band_high / spacing))
        if last < first:
            raise ParameterError(f"no line of a window of {samples / sample_rate:g} s lies in the band: lengthen it")
        #: Indices of the lines of the band in a spectrum (n // 2 + 1,).
        self.lines = np.arange(first, last + 1)
        self._references = np.array([reference_bins(int(line), count) for line in self.lines])
        self._threshold = tonality_for(settings.false_alarm)
        self._rank_mean = mean_of_rank()

    @property
    def threshold(self) -> float:
        """Tonality a tone must have [dB]."""
        return 10.0 * math.log10(self._threshold)

    def tonalities(self, amplitudes: Values) -> Values:
        """Power of every line of the band over the noise beside it (lines,), from an amplitude spectrum (n // 2 + 1,);
        inf where that noise is zero.
        """
        powers = amplitudes**2
        noise = np.partition(powers[self._references], RANK - 1, axis=1)[:, RANK - 1] / self._rank_mean
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio: Values = np.where(powers[self.lines] > 0.0, powers[self.lines] / noise, 0.0)
        return ratio

    def tones(self, signal: Values, least_level: float) -> list[Tone]:
        """Tones of a window (n,) [m] that reach `least_level` [dB re 1 um], the loudest first."""
        _, amplitudes = amplitude_spectrum(signal, self._rate)
        lines = self.lines
        middle = amplitudes[lines]
        highest = (middle >= amplitudes[lines - 1]) & (middle > amplitudes[lines + 1])
        loud = middle**2 > _DYNAMICS * float(amplitudes.max(initial=0.0)) ** 2
        # A line's amplitude is at most its RMS times the root of 2, and 1.42 dB less half a bin away.
        high = 20.0 * np.log10(np.maximum(middle, 1e-300) / 1e-6) >= least_level + 3.0103 - 1.5
        if not np.any(highest & loud & high):
            return []
        tonality = self.tonalities(amplitudes)
        found = []
        for i in np.flatnonzero(highest & loud & high & (tonality >= self._threshold)):
            line = int(lines[i])
            level = level_db(self._rms(amplitudes, line))
            if level >= least_level:
                ratio = 10.0 * math.log10(min(float(tonality[i]), 1e30))
                found.append(Tone(self._frequency(amplitudes, line), level, ratio))
        return sorted(found, key=lambda tone: -tone.level)

    @staticmethod
    def _rms(amplitudes: Values, line: int) -> float:
        around = amplitudes[line - _HALF_WIDTH : line + _HALF_WIDTH + 1]
        return math.sqrt(0.5 * float(np.sum(around**2)) / _NOISE_BANDWIDTH)

    def _frequency(self, amplitudes: Values, line: int) -> float:
        """Exact for a lone tone under a Hann window: from the ratio of the two highest lines (Grandke, IEEE Trans.
        Instrum. Meas. IM-32, 1983, Eq. 15).
        """
        left, middle, right = (float(value) for value in amplitudes[line - 1 : line + 2])
        side, beside = (1.0, right) if right >= left else (-1.0, left)
        ratio = beside / middle
        return (line + side * (2.0 * ratio - 1.0) / (ratio + 1.0)) * self._rate / self._samples
