"""Bands and levels of squeal by name, and what of a published procedure can be said on this rig.

Source for what SAE J2521 calls squeal: a peak of at least 70 dB(A) of sound pressure between 1.25 kHz (full suspension
corner) or 2 kHz and 16 kHz, reported as the share of applications above it. Its table of applications is not public.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from squeal_rig.errors import ParameterError


@dataclass(frozen=True)
class Band:
    """A band [Hz] and the RMS displacement at which a tone in it is squeal [dB re 1 um]."""

    name: str
    low: float
    high: float
    level: float
    description: str


BANDS = {
    band.name: band
    for band in (
        Band("rig", 500.0, 5000.0, -12.0, "where this rig squeals, with its first harmonics"),
        Band("fundamental", 700.0, 1400.0, -12.0, "the squeal of this rig alone, without harmonics"),
        Band("wide", 200.0, 16000.0, -12.0, "all that the sample rate shows, up to where hearing ends"),
    )
}
#: Bands of published procedures [Hz]; their level is of sound pressure, which is not known here.
SOUND_BANDS = {
    "sae_j2521": (2000.0, 16000.0),
    "sae_j2521_suspension_corner": (1250.0, 16000.0),
}


def band(name: str) -> Band:
    """A band by its name.

    Raises:
        ParameterError: there is none, or it asks for what is not known here.
    """
    if name in SOUND_BANDS:
        low, high = SOUND_BANDS[name]
        raise ParameterError(
            f"band = {name!r} cannot be used: it asks for 70 dB(A) of sound pressure from {low:g} to {high:g} Hz, and"
            " no sound pressure is known here (the rig squeals at 0.9 to 1.2 kHz, below that band; the harmonics"
            " inside it are listed with every event)"
        )
    if name not in BANDS:
        raise ParameterError(f"band = {name!r} is not known: it must be one of {', '.join(BANDS)}")
    return BANDS[name]


def harmonics_inside(frequency: float, low: float, high: float) -> list[int]:
    """Orders n whose line n times `frequency` [Hz] lies in a band [Hz], edges included; none where there is none."""
    if not (math.isfinite(frequency) and frequency > 0.0):
        return []
    first, last = max(1, math.ceil(low / frequency)), math.floor(high / frequency)
    return list(range(first, last + 1))
