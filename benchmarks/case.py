"""The case all peers solve, and how time and error are measured."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from statistics import median

import numpy as np
from numpy.typing import NDArray

from squeal_rig.model import RigParameters, displaced_state, simulate
from squeal_rig.model.core.layout import Vector, pack
from tests.model.dop853 import reference

RATE = 51200.0
DURATION = 0.05
CASE = RigParameters().replace(preload=300.0, belt_speed=1.0, pad_stiffness=6e7, damping_x=20.0, damping_y=20.0)
START = displaced_state(CASE, 3.0)
PACKED = pack(CASE)
TIMES = np.arange(int(DURATION * RATE) + 1) / RATE
# Solvers with mixed tolerances see lengths of 1e-5 m and speeds of 0.1 m/s: state in these units.
SCALE = np.array([1e-5, 1e-5, 0.1, 0.1])
_TURN = 0.01  # wall time of a turn at least [s]
_FEWEST_ROUNDS = 9


@dataclass(frozen=True)
class Point:
    """One setting of one solver: its error (share of the amplitude), its best wall time [s] for `DURATION`, and what
    was timed.
    """

    solver: str
    setting: str
    error: float
    seconds: float
    run: Callable[[], object] = field(repr=False)


def best_time(run: Callable[[], object], repeats: int = 5, at_most: float = 4.0, at_least: float = 0.2) -> float:
    """Shortest wall time [s] of some repeats, more of them where they are short: others on the machine only make it
    longer.
    """
    times: list[float] = []
    while not times or (sum(times) < at_most and (len(times) < repeats or sum(times) < at_least)):
        begin = time.perf_counter()
        run()
        times.append(time.perf_counter() - begin)
    return min(times)


def speeds_in_turns(runs: list[tuple[Callable[[], object], float]], at_least: float = 3.0) -> list[list[float]]:
    """Simulated s per wall s of runs, each with the time it simulates [s]: (runs, rounds), for so long [s] in all.

    They take turns, since machines change their speed: a round sees one of them, and ratios within it mean something.
    A short run is repeated within its turn, so that what the others left in the caches does not count.
    """
    repeats = [max(1, math.ceil(_TURN / best_time(run, 3, at_least=0.0))) for run, _ in runs]
    speeds: list[list[float]] = [[] for _ in runs]
    end = time.perf_counter() + at_least
    while time.perf_counter() < end or len(speeds[0]) < _FEWEST_ROUNDS:
        for (run, duration), times, found in zip(runs, repeats, speeds, strict=True):
            begin = time.perf_counter()
            for _ in range(times):
                run()
            found.append(times * duration / (time.perf_counter() - begin))
    return speeds


def ratio(speeds: list[float], peer: list[float]) -> float:
    """By how much the first of two that took turns is faster: the median of the rounds."""
    return median(own / other for own, other in zip(speeds, peer, strict=True))


def faster_by(own: Point, peer: Point) -> float:
    """By how much one of two points is faster, measured in turns."""
    return ratio(*speeds_in_turns([(own.run, DURATION), (peer.run, DURATION)], 2.0))


def expected_states() -> Vector:
    """The reference solution at `TIMES`."""
    states: NDArray[np.float64] = reference(CASE, START, TIMES)[0]
    return states


def error_of(states: Vector, expected: Vector) -> float:
    """Largest error of x and y as a share of the largest displacement."""
    return float(np.max(np.abs(states[:, :2] - expected[:, :2])) / np.max(np.abs(expected[:, :2])))


def amplification() -> float:
    """How much a small change of the start has grown at its largest."""
    nudged = START.copy()
    change = 1e-8 * abs(START[1])
    nudged[1] -= change
    one, other = (simulate(CASE, DURATION, initial_state=start) for start in (START, nudged))
    return float(max(np.max(np.abs(one.x - other.x)), np.max(np.abs(one.y - other.y))) / change)


def measured(solver: str, setting: str, run: Callable[[], Vector], expected: Vector) -> Point:
    """Error and best time; `run` is called once before, to compile."""
    error = error_of(run(), expected)
    return Point(solver, setting, error, best_time(run), run)
