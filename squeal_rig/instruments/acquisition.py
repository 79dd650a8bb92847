"""Sampling a rig block by block: operating points with slew, sample numbers, stamps, tare."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from squeal_rig.configuration.declared import declarations
from squeal_rig.errors import DriverError
from squeal_rig.instruments.actuators import safe_point, slewed
from squeal_rig.instruments.channels import FORCE_CHANNELS
from squeal_rig.instruments.driver import Capabilities, Driver, Samples
from squeal_rig.instruments.numbering import SEQ_MODULUS
from squeal_rig.instruments.settings import BLOCKS_PER_SECOND, RigSettings
from squeal_rig.model.parameters import RUN_TIME_CONCERNS, RigParameters

_NS = 10**9
# Blocks that a device may have kept while nobody asked: a minute's.
_MOST_OLD = 60 * BLOCKS_PER_SECOND
#: What a refusal says where only the driver stands in the way.
NOT_MOVABLE = "cannot be moved by this rig's driver"


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
        self._safe = False
        self._keeps_time = driver.capabilities(settings).keeps_time
        self._has_old = False
        driver.open(parameters, settings)

    def start(self, stamp: int) -> None:
        """Set the time of the next sample [ns]: at activation, reset, resume and after an overrun.

        What a device has sampled until now was not asked for: it is forgotten, and was not lost.
        """
        self._start, self._since_start = stamp, 0
        self._has_old = self._keeps_time

    def next_block(self) -> Block:
        """The next block of samples.

        Raises:
            DriverError, ModelError: the driver cannot go on, or has no block yet.
        """
        block = self.poll()
        if block is None:
            raise DriverError("the device has no whole block of samples yet")
        return block

    def poll(self) -> Block | None:
        """The next block of samples, None where the device has none yet.

        Raises:
            DriverError, ModelError: the driver cannot go on.
        """
        wanted = safe_point(self.set_point) if self._safe else self.set_point
        goal = slewed(self.in_force, wanted, self.settings, 1.0 / BLOCKS_PER_SECOND)
        if self._has_old:
            self._has_old = False
            for _ in range(_MOST_OLD):
                if self._driver.read(goal) is None:
                    break
        reading = self._driver.read(goal)
        if reading is None:
            return None
        self.in_force = goal
        n, rate = len(reading.daq), self.settings.sample_rate
        for channel, offset in self.tare.items():
            reading.daq[channel] -= offset
        self.samples += reading.lost
        self._since_start += reading.lost
        stamp = self._start + self._since_start * _NS // rate if reading.stamp is None else reading.stamp
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
        """Pad at rest at the equilibrium of what is in force; the tare is forgotten.

        After a stop nothing is in force: what had not come to rest by then is not taken up again.
        """
        if self._safe:
            self.in_force = safe_point(self.set_point)
        self._driver.reset()
        self._safe = False
        self.tare = {}

    def make_safe(self) -> None:
        """Command no preload and a belt at rest, from any thread; set points count again after `reset`."""
        self._safe = True  # also where the driver refuses
        self._driver.make_safe()

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


def change_refusal(name: str, capabilities: Capabilities) -> str | None:
    """A sentence when a rig parameter may not change while the rig is active, else None."""
    concern = declarations(RigParameters)[name].concern
    if concern not in RUN_TIME_CONCERNS:
        return f"{name} is a constant of the {concern}: it cannot change while the rig is active, deactivate it first"
    if name not in capabilities.set_points:
        return f"{name} {NOT_MOVABLE} while it is active"
    return None
