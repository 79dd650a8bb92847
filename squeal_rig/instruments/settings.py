"""Settings of the rig that are not physics of the pad: instruments, actuators, pacing."""

from __future__ import annotations

import math
from dataclasses import dataclass

from squeal_rig.configuration.declared import Declared, quantity

#: One block is published every 10 ms of sampled time.
BLOCKS_PER_SECOND = 100


@dataclass(frozen=True)
class PresetChoice(Declared):
    """Which preset the rig's parameters start from."""

    preset: str = quantity("yavuz_sen_2023", "preset the parameters start from", read_only=True)


@dataclass(frozen=True)
class RigSettings(Declared):
    """Settings of the node `rig`."""

    driver: str = quantity("virtual", "what stands behind the rig, as an installed package offers it", read_only=True)
    autostart: bool = quantity(True, "configure and activate the rig at start", read_only=True)
    sample_rate: int = quantity(
        51200,
        "samples per second; a block is 10 ms of whole ones",
        unit="Hz",
        lower=1000,
        upper=2_000_000,
        multiple=BLOCKS_PER_SECOND,
        read_only=True,
    )
    real_time_factor: float = quantity(
        1.0,
        "sampled seconds per second: 1 is wall clock, 0 as fast as possible",
        lower=0.0,
        upper=1000.0,
        read_only=True,
    )
    drum_radius: float = quantity(
        0.05,
        "radius of the drum that drives the belt",
        unit="m",
        lower=1e-3,
        upper=10.0,
        read_only=True,
        assumed=True,
    )
    preload_slew_rate: float = quantity(
        500.0,
        "fastest change of the preload in force (hydraulics)",
        unit="N/s",
        lower=1e-3,
        upper=1e9,
        assumed=True,
    )
    belt_acceleration: float = quantity(
        5.0,
        "fastest change of the belt speed in force (motor)",
        unit="m/s^2",
        lower=1e-6,
        upper=1e6,
        assumed=True,
    )
    stiffness_slew_rate: float = quantity(
        2.0e8,
        "fastest change of an arm's stiffness in force",
        unit="N/(m s)",
        lower=1.0,
        upper=1e15,
        assumed=True,
    )
    impact_impulse: float = quantity(0.05, "size of an impact on the pad", unit="N s", lower=0.0, upper=1000.0)
    impact_direction: float = quantity(
        -0.5 * math.pi,
        "direction of an impact, counter-clockwise from the belt's direction; -pi/2 is towards the belt",
        unit="rad",
        lower=-math.pi,
        upper=math.pi,
    )

    @property
    def block_size(self) -> int:
        """Samples in one block."""
        return self.sample_rate // BLOCKS_PER_SECOND
