"""Super-harmonics of a spectrum, by a stated criterion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from squeal_rig.estimation.spectra import level_db, peak_frequency

Values = NDArray[np.float64]

#: A super-harmonic is looked for within this share of the fundamental about n times it.
SEARCH_SHARE = 0.02
#: It must stand out of the median of its surroundings (a quarter of the fundamental on either side) by this much [dB].
LEAST_PROMINENCE = 20.0
#: And lie at most this far below the fundamental [dB]: lower lines are geometry and rounding, not contact.
FURTHEST_BELOW = 80.0


@dataclass(frozen=True)
class Harmonic:
    """A line at about `order` times the fundamental: frequency [Hz], its amplitude [dB re 1 um], prominence [dB]."""

    order: int
    frequency: float
    level: float
    prominence: float


def superharmonics(
    frequencies: Values, amplitudes: Values, band: tuple[float, float], highest_order: int = 5
) -> tuple[float, list[Harmonic]]:
    """Fundamental [Hz] and the super-harmonics found.

    The fundamental is the highest line in `band` [Hz]. A super-harmonic of order n is the highest line within 2 % of
    the fundamental about n times it, if it stands 20 dB out of the median around it and at most 80 dB below the
    fundamental.

    Args:
        frequencies: (n,) [Hz], evenly spaced from 0.
        amplitudes: (n,) [m].
        band: where the fundamental lies [Hz].
        highest_order: orders looked for, 2 to this.
    """
    fundamental = peak_frequency(frequencies, amplitudes, *band)
    if not np.isfinite(fundamental):
        return fundamental, []
    inside = (frequencies >= band[0]) & (frequencies <= band[1])
    reference = level_db(float(amplitudes[inside].max()))
    found = []
    for order in range(2, highest_order + 1):
        centre = order * fundamental
        near = np.abs(frequencies - centre) <= SEARCH_SHARE * fundamental
        around = np.abs(frequencies - centre) <= 0.25 * fundamental
        if not near.any() or centre > frequencies[-1]:
            continue
        level = level_db(float(amplitudes[near].max()))
        prominence = level - level_db(float(np.median(amplitudes[around])))
        if prominence >= LEAST_PROMINENCE and level >= reference - FURTHEST_BELOW:
            line = float(frequencies[near][np.argmax(amplitudes[near])])
            found.append(Harmonic(order, line, level, prominence))
    return fundamental, found
