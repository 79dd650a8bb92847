"""Samples made small enough to be drawn: envelope, fewer values of a trace, lines of a spectrum."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from squeal_rig.estimation.spectra import REFERENCE, amplitude_spectrum

Values = NDArray[np.float64]

#: Level that nothing drawn falls below [dB re 1 um]: an exact zero has none.
FLOOR_DB = -140.0


def envelope(values: Values) -> tuple[float, float, float]:
    """Least, greatest and mean of a trace (n,)."""
    return float(values.min()), float(values.max()), float(values.mean())


def decimated(values: Values, points: int) -> tuple[Values, int]:
    """A trace (n,) of at most `points` values: means of so many neighbours each, which is returned too.

    Means, since what a screen cannot resolve must not come back as a slow wave; a rest shorter than that is left out.
    """
    step = max(1, -(-len(values) // points))
    whole = len(values) - len(values) % step
    return values[:whole].reshape(-1, step).mean(axis=1), step


@dataclass(frozen=True)
class Lines:
    """A spectrum (n,): frequencies [Hz] of its lines, and levels [dB re 1 um]."""

    frequencies: Values
    levels: Values


def spectrum_lines(displacement: Values, sample_rate: float, high: float, points: int) -> Lines:
    """Spectrum of a displacement (n,) [m] up to `high` [Hz], at most `points` lines.

    The level of a line is that of its RMS, as the squeal detector's is: a tone has the same in both.
    Where there are more, each is the greatest of its neighbours, so that no peak gets lost or is moved.
    """
    frequencies, amplitudes = amplitude_spectrum(displacement, sample_rate)
    count = int(np.searchsorted(frequencies, high, side="right"))
    step = max(1, -(-count // points))
    groups = np.full((-(-count // step), step), -1.0)
    groups.flat[:count] = amplitudes[:count]
    greatest = step * np.arange(len(groups)) + groups.argmax(axis=1)
    with np.errstate(divide="ignore"):
        levels = 20.0 * np.log10(amplitudes[greatest] / (math.sqrt(2.0) * REFERENCE))
    return Lines(frequencies[greatest], np.maximum(levels, FLOOR_DB))
