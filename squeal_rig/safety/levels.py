"""Levels of the supervisor, and what is told of them."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

#: Most characters that are kept of a reason: it comes from anybody, and is told in every state and trip.
LONGEST_REASON = 200


def shortened(reason: str) -> str:
    """A reason in one line of at most `LONGEST_REASON` characters."""
    line = " ".join(reason[: 4 * LONGEST_REASON].split())
    return line if len(line) <= LONGEST_REASON else line[: LONGEST_REASON - 4] + " ..."


class Level(IntEnum):
    """What is done: nothing, a warning, set points to zero with the slew, the driver's safe command at once."""

    OK = 0
    WARN = 1
    RAMP_DOWN = 2
    STOP = 3

    @property
    def words(self) -> str:
        """The level as it is published."""
        return ("ok", "warn", "ramp down", "emergency stop")[self]


@dataclass(frozen=True)
class Finding:
    """A rule that is broken now: its name, the level it asks for, and a sentence with value, bound and unit."""

    rule: str
    level: Level
    sentence: str


@dataclass(frozen=True)
class Event:
    """Something to publish and log: a rule that began to be broken, a stop that was asked for, or a reset.

    `value` and `limit` are in the sentence; `raised` tells whether the supervisor's level rose with it.
    """

    rule: str
    level: Level
    sentence: str
    raised: bool = False
