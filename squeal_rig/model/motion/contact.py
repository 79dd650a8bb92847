"""Contact events of a motion: when the pad leaves the belt and when it meets it, to rounding."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from squeal_rig.errors import ModelError
from squeal_rig.model.core.layout import STATE_SIZE, Vector, pack, sample_room
from squeal_rig.model.motion import exact, stepping
from squeal_rig.model.motion.propagator import make_propagators, substeps_needed
from squeal_rig.model.motion.trajectory import checked_state, displaced_state, refuse_unless_positive
from squeal_rig.model.parameters import RigParameters

_BLOCK = 1024
_ROOM = 64 * _BLOCK


@dataclass(frozen=True)
class ContactEvents:
    """Events in order: time [s], whether the pad leaves the belt (else it meets it), speed vy [m/s]; arrays (n,).

    `contact_time` [s] is the time spent on the belt within `duration` [s].
    """

    time: Vector
    leaves: NDArray[np.bool_]
    speed: Vector
    contact_time: float
    duration: float


def contact_events(
    p: RigParameters, duration: float, sample_rate: float = 51200.0, initial_state: ArrayLike | None = None
) -> ContactEvents:
    """Contact events of the exact engine over a whole number of sample intervals, `duration` or just above.

    Args:
        p: parameters.
        duration: time simulated [s].
        sample_rate: intervals per second [Hz]; the events do not depend on it beyond rounding.
        initial_state: (x, y, vx, vy) [m, m/s]; as in `simulate` when None.

    Raises:
        ParameterError: an argument is out of its bounds.
        ModelError: no equilibrium in contact to start from, or the motion left every bound.
    """
    refuse_unless_positive(duration=(duration, "s"), sample_rate=(sample_rate, "Hz"))
    state = displaced_state(p, 0.1) if initial_state is None else checked_state(initial_state)
    q, flow, w = pack(p), exact.empty_flow(), exact.workspace()
    interval = 1.0 / sample_rate
    substeps = substeps_needed(q, interval, interval)
    make_propagators(q, interval / substeps, flow)
    tally, room, block = np.zeros(exact.TALLY_SIZE), np.empty((_ROOM, 2)), sample_room(_BLOCK, STATE_SIZE)
    found = []
    samples = math.ceil(duration * sample_rate * (1.0 - 1e-12))
    for first in range(0, samples, _BLOCK):
        part = block[: samples - first]
        ended, filled = stepping.advance(state, q, flow, substeps, w, tally, room, part)
        exact.refuse_unless_done(ended, filled * interval)
        count = int(tally[exact.EVENTS])
        if count > _ROOM:
            raise ModelError(f"more than {_ROOM} contact events in {_BLOCK} samples: the pad chatters")
        events = room[:count].copy()
        events[:, exact.EVENT_TIME] += first * interval
        found.append(events)
    events = np.concatenate(found)
    speed = events[:, exact.EVENT_SPEED]
    return ContactEvents(
        events[:, exact.EVENT_TIME], speed > 0.0, speed, float(tally[exact.CONTACT_TIME]), samples * interval
    )
