"""Amplitude spectra of sampled displacement, calibrated so that a sine's peak is its amplitude."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from squeal_rig.errors import ParameterError

Values = NDArray[np.float64]

#: Reference of displacement levels [m].
REFERENCE = 1e-6
#: Level given for a signal that is exactly zero [dB].
SILENCE_DB = -400.0


def amplitude_spectrum(signal: Values, sample_rate: float) -> tuple[Values, Values]:
    """One-sided amplitude spectrum, Hann window, mean removed.

    Args:
        signal: (n,), any unit.
        sample_rate: [Hz].

    Returns:
        frequencies [Hz] and amplitudes in the signal's unit, each (n // 2 + 1,): a sine on a bin shows its amplitude.
    """
    window = np.hanning(len(signal) + 1)[:-1]
    transform = np.fft.rfft((signal - signal.mean()) * window)
    amplitudes: Values = np.hypot(transform.real, transform.imag).astype(np.float64) * (2.0 / window.sum())
    frequencies: Values = np.arange(len(amplitudes), dtype=np.float64) * (sample_rate / len(signal))
    return frequencies, amplitudes


def refuse_empty_band(sample_rate: float, samples: int, low: float, high: float) -> None:
    """ParameterError where a spectrum of so many samples has no line in the band [low, high] Hz."""
    spacing = sample_rate / samples
    if math.floor(high / spacing) < math.ceil(low / spacing):
        raise ParameterError(
            f"no line of a window of {samples / sample_rate:g} s lies between {low:g} and {high:g} Hz: lengthen it"
        )


def band_rms(frequencies: Values, amplitudes: Values, low: float, high: float) -> float:
    """RMS of the signal in the band [low, high] Hz, from its amplitude spectrum (n,) with Hann window.

    The Hann window spreads a line's power over 1.5 bins (its equivalent noise bandwidth), which is divided out.
    """
    inside = (frequencies >= low) & (frequencies <= high)
    return float(np.sqrt(0.5 * np.sum(amplitudes[inside] ** 2) / 1.5))


def peak_frequency(frequencies: Values, amplitudes: Values, low: float, high: float) -> float:
    """Frequency [Hz] of the highest line in [low, high] Hz, by a parabola through the logarithms of three lines."""
    inside = np.flatnonzero((frequencies >= low) & (frequencies <= high))
    inside = inside[(inside > 0) & (inside < len(amplitudes) - 1)]
    if inside.size == 0 or not np.any(amplitudes[inside] > 0.0):
        return math.nan
    top = int(inside[np.argmax(amplitudes[inside])])
    left, middle, right = np.log(np.maximum(amplitudes[top - 1 : top + 2], 1e-300))
    curvature = left - 2.0 * middle + right
    shift = 0.5 * (left - right) / curvature if curvature < 0.0 else 0.0
    return float(frequencies[top] + shift * (frequencies[1] - frequencies[0]))


def level_db(value: float) -> float:
    """Level [dB re 1 um] of an RMS or amplitude [m]."""
    return 20.0 * math.log10(value / REFERENCE) if value > 0.0 else SILENCE_DB
