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
    driver_config: str = quantity(
        "", "YAML file of the driver's own settings, which the driver reads; its defaults when empty", read_only=True
    )
    instruments: str = quantity(
        "ideal",
        "data sheets of the rig's instruments: a file of config/instruments/ without .yaml, or a path; the virtual rig"
        " behaves by them, estimators take their tolerances from them",
        read_only=True,
    )
    instruments_seed: int = quantity(
        1, "seed of the virtual instruments' noise", lower=0, upper=2**31 - 1, read_only=True
    )
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

    supervisor_required: bool = quantity(
        False,
        "it moves only while a supervisor's heartbeat comes, and a watchdog process sees to it that it can be stopped",
        read_only=True,
    )
    heartbeat_timeout: float = quantity(
        0.5,
        "time without the supervisor's heartbeat after which the rig falls to its safe state",
        unit="s",
        lower=0.1,
        upper=60.0,
        read_only=True,
    )
    watchdog_timeout: float = quantity(
        1.0,
        "time that the rig's process cannot be stopped from within after which the watchdog kills it",
        unit="s",
        lower=0.2,
        upper=60.0,
        read_only=True,
    )

    @property
    def block_size(self) -> int:
        """Samples in one block."""
        return self.sample_rate // BLOCKS_PER_SECOND
