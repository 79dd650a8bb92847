"""What stands under a campaign: a rig that is set, hit and run; here the fast engine alone, in `session` the graph."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from functools import lru_cache
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from squeal_rig.errors import ModelError
from squeal_rig.instruments.actuators import slewed
from squeal_rig.instruments.settings import RigSettings
from squeal_rig.model.core.layout import sample_room
from squeal_rig.model.motion.trajectory import Motion, resting_state
from squeal_rig.model.parameters import RigParameters

Values = NDArray[np.float64]

#: Samples of a block: set points move from block to block, as the rig's do.
BLOCK = 512
# Samples that are kept of a run at once, while nothing moves.
_MANY = 8 * BLOCK


class Bench(Protocol):
    """A rig under a campaign. `sample_rate` [Hz] is its own."""

    sample_rate: int

    def set_parameters(self, values: Mapping[str, float]) -> None:
        """Change set points."""

    def reset(self) -> None:
        """Wait until what is set is in force, and put the pad at rest at the equilibrium there."""

    def hit(self, impulse: float, direction: float) -> None:
        """Hit the pad with an impulse [N s] in a direction [rad]."""

    def smallest_hit(self) -> tuple[float, float]:
        """Smallest hit [N s] that starts squeal at the set point, and its direction [rad]; nan where there is none."""

    def run(self, duration: float) -> Iterator[Values]:
        """Run for a time [s]; gives x (n,) [m] in pieces."""


class EngineBench:
    """The model alone, with the slew rates of a rig; nothing is measured in real time."""

    def __init__(self, base: RigParameters, settings: RigSettings | None = None) -> None:
        self._settings = settings or RigSettings()
        self.sample_rate = self._settings.sample_rate
        self._set_point = self._in_force = base
        self._motion: Motion | None = None

    def set_parameters(self, values: Mapping[str, float]) -> None:
        self._set_point = self._set_point.replace(**values)

    def reset(self) -> None:
        self._in_force = self._set_point
        self._motion = Motion(self._in_force, self.sample_rate)

    def hit(self, impulse: float, direction: float) -> None:
        kick = impulse / self._in_force.mass
        self._moving().kick(kick * math.cos(direction), kick * math.sin(direction))

    def smallest_hit(self) -> tuple[float, float]:
        return _smallest_hit(self._set_point)

    def run(self, duration: float) -> Iterator[Values]:
        motion = self._moving()
        left = round(duration * self.sample_rate)
        while left > 0:
            moved = slewed(self._in_force, self._set_point, self._settings, BLOCK / self.sample_rate)
            if moved is not self._in_force:
                self._in_force = moved
                motion.set_parameters(moved)
            out = sample_room(min(left, BLOCK if self._in_force is not self._set_point else _MANY))
            motion.advance(out)
            left -= len(out)
            yield out[:, 0].copy()

    def _moving(self) -> Motion:
        if self._motion is None:
            self._motion = Motion(self._in_force, self.sample_rate, resting_state(self._in_force))
        return self._motion


@lru_cache(maxsize=64)
def _smallest_hit(p: RigParameters) -> tuple[float, float]:
    from squeal_rig.model.cycles.hits import smallest_hit

    try:
        found = smallest_hit(p)
    except ModelError:
        return math.nan, math.nan
    return found.impulse, found.direction
