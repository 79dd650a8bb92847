"""Settings of what is shown."""

from __future__ import annotations

from dataclasses import dataclass

from squeal_rig.configuration.declared import Declared, quantity

#: Longest array that stock tools draw unasked (PlotJuggler's default).
MOST_VALUES = 500


@dataclass(frozen=True)
class ViewSettings(Declared):
    """Settings of the node `view`."""

    rate: float = quantity(
        5.0, "oscilloscope, spectrum and numbers a second", unit="Hz", lower=0.1, upper=20.0, read_only=True
    )
    points: int = quantity(MOST_VALUES, "longest array that is published", lower=16, upper=MOST_VALUES, read_only=True)
    spectrum_window: float = quantity(
        0.2, "length of the window a spectrum is taken over", unit="s", lower=0.02, upper=2.0, read_only=True
    )
    spectrum_high: float = quantity(
        10_000.0,
        "upper end of the spectrum, half the sample rate where that is lower",
        unit="Hz",
        lower=100.0,
        upper=1e6,
        read_only=True,
    )
