"""Settings of the estimators."""

from __future__ import annotations

from dataclasses import dataclass

from squeal_rig.configuration.declared import Declared, quantity
from squeal_rig.errors import ParameterError


@dataclass(frozen=True)
class FrictionSettings(Declared):
    """Settings of the friction estimator."""

    window: float = quantity(
        0.2, "length T of the windows of Eq. (2.2)", unit="s", lower=0.001, upper=60.0, read_only=True
    )
    minimum_normal_load: float = quantity(
        10.0,
        "denominator of Eq. (2.1) below which a sample is not valid",
        unit="N",
        lower=1e-6,
        upper=1e6,
        read_only=True,
    )


@dataclass(frozen=True)
class SquealSettings(Declared):
    """Settings of the squeal detector. Levels are of the pad's displacement along the belt, RMS in the band."""

    window: float = quantity(
        0.1, "length of the window a level is taken over", unit="s", lower=0.02, upper=10.0, read_only=True
    )
    band_low: float = quantity(500.0, "lower edge of the band", unit="Hz", lower=1.0, upper=1e6, read_only=True)
    band_high: float = quantity(5000.0, "upper edge of the band", unit="Hz", lower=1.0, upper=1e6, read_only=True)
    on_level: float = quantity(
        -12.0, "level at which squeal begins", unit="dB re 1 um", lower=-200.0, upper=200.0, read_only=True
    )
    off_level: float = quantity(
        -18.0, "level at which squeal ends", unit="dB re 1 um", lower=-200.0, upper=200.0, read_only=True
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.band_low < self.band_high:
            raise ParameterError(f"band_low = {self.band_low:g} Hz must be below band_high = {self.band_high:g} Hz")
        if not self.off_level <= self.on_level:
            raise ParameterError(
                f"off_level = {self.off_level:g} dB re 1 um must not be above on_level = {self.on_level:g} dB re 1 um"
            )


@dataclass(frozen=True)
class ToneSettings(Declared):
    """Settings of squeal as tones: when a line is a tone, and a tone squeal. Band and levels are `SquealSettings`'."""

    tone_window: float = quantity(
        0.1,
        "length of the windows tones are looked for in, which overlap by half",
        unit="s",
        lower=0.04,
        upper=2.0,
        read_only=True,
    )
    false_alarm: float = quantity(
        1e-10, "probability that a line of white noise is taken for a tone", lower=1e-20, upper=0.1, read_only=True
    )
    least_duration: float = quantity(
        0.1, "shortest tone that is called squeal", unit="s", lower=0.0, upper=60.0, read_only=True
    )


@dataclass(frozen=True)
class StabilitySettings(Declared):
    """Settings of the stability node."""

    hard_squeal: bool = quantity(
        True, "find zone, borders and smallest hit of every set point too, in a process beside the node"
    )
