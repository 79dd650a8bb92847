"""Sampling a rig block by block: operating points with slew, sample numbers, stamps, tare."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from squeal_rig.configuration.declared import declarations
from squeal_rig.errors import DriverError
from squeal_rig.instruments.channels import FORCE_CHANNELS
from squeal_rig.instruments.driver import Driver, Samples
from squeal_rig.instruments.numbering import SEQ_MODULUS
from squeal_rig.instruments.settings import BLOCKS_PER_SECOND, RigSettings
from squeal_rig.model.parameters import RUN_TIME_CONCERNS, RigParameters

_NS = 10**9


@dataclass(frozen=True)
class Block:
    """10 ms of samples. `stamp` is the time of the first sample [ns]; `truth` is None on hardware."""

    stamp: int
    daq: Samples
    truth: Samples | None
    warnings: tuple[str, ...]


class Acquisition:
    """A rig being sampled: steps the driver and keeps what is in force, which follows the set points with slew."""

    def __init__(self, driver: Driver, parameters: RigParameters, settings: RigSettings) -> None:
        self._driver = driver
        self.settings = settings
        self.set_point = parameters
        self.in_force = parameters
        self.samples = 0
        self.tare: Mapping[str, float] = {}
        self._since_start = 0
        self._start = 0
        self._last: Samples | None = None
        driver.open(parameters, settings)

    def start(self, stamp: int) -> None:
        """Set the time of the next sample [ns]: at activation, reset, resume and after an overrun."""
        self._start, self._since_start = stamp, 0

    def next_block(self) -> Block:
        """The next block of samples.

        Raises:
            DriverError, ModelError: the driver cannot go on.
        """
        self.in_force = slewed(self.in_force, self.set_point, self.settings, 1.0 / BLOCKS_PER_SECOND)
        reading = self._driver.read(self.in_force)
        n, rate = len(reading.daq), self.settings.sample_rate
        for channel, offset in self.tare.items():
            reading.daq[channel] -= offset
        stamp = self._start + self._since_start * _NS // rate
        numbers = np.arange(n, dtype=np.uint32)
        t, seq = numbers / rate, numbers + np.uint32(self.samples % SEQ_MODULUS)  # uint32 wraps by itself
        for samples in (reading.daq, reading.truth):
            if samples is not None:
                samples["t"], samples["seq"] = t, seq
        self._last = reading.daq
        self.samples += n
        self._since_start += n
        return Block(stamp, reading.daq, reading.truth, reading.warnings)

    def reset(self) -> None:
        """Pad at rest at the equilibrium of what is in force; the tare is forgotten."""
        self._driver.reset()
        self.tare = {}

    def impact(self) -> tuple[float, float]:
        """An impact at the next block boundary; returns its impulse [N s] in x and y."""
        size, direction = self.settings.impact_impulse, self.settings.impact_direction
        impulse = size * math.cos(direction), size * math.sin(direction)
        self._driver.impact(*impulse)
        return impulse

    def take_tare(self) -> Mapping[str, float]:
        """Take the force channels' means over the last block as the tare; returns it, in their units."""
        if self._last is None:
            raise DriverError("no block was read yet: there is nothing to take as tare")
        last, old = self._last, self.tare
        self.tare = {channel: float(last[channel].mean()) + old.get(channel, 0.0) for channel in FORCE_CHANNELS}
        return self.tare

    def close(self) -> None:
        """Let go of the driver."""
        self._driver.close()


def slewed(in_force: RigParameters, set_point: RigParameters, settings: RigSettings, dt: float) -> RigParameters:
    """Parameters in force one block of `dt` [s] later: slewed quantities move at most their rate times dt.

    All other parameters take their set points at once.
    """
    if in_force is set_point:
        return in_force
    rates = {
        "preload": settings.preload_slew_rate,
        "belt_speed": settings.belt_acceleration,
        "k1": settings.stiffness_slew_rate,
        "k2": settings.stiffness_slew_rate,
    }
    moved = {}
    for name, rate in rates.items():
        now, goal = getattr(in_force, name), getattr(set_point, name)
        moved[name] = goal if abs(goal - now) <= rate * dt else now + math.copysign(rate * dt, goal - now)
    arrived = all(getattr(set_point, name) == value for name, value in moved.items())
    return set_point if arrived else dataclasses.replace(set_point, **moved)


def change_refusal(name: str) -> str | None:
    """A sentence when a rig parameter may not change while the rig is active, else None."""
    concern = declarations(RigParameters)[name].concern
    if concern in RUN_TIME_CONCERNS:
        return None
    return f"{name} is a constant of the {concern}: it cannot change while the rig is active, deactivate it first"
