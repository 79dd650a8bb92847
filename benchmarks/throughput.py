"""Speed of one trajectory against bare state propagation, of many runs, and of stability maps."""

from __future__ import annotations

import json
import math
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numba
import numpy as np

from benchmarks.case import CASE, RATE, START, best_time, speeds_in_turns
from squeal_rig.model import Motion, RigParameters, simulate, simulate_many, stability_map
from squeal_rig.model.core.layout import Vector, pack, sample_room
from squeal_rig.model.motion.cubic import TERMS
from squeal_rig.model.motion.exact import empty_flow
from squeal_rig.model.motion.propagator import OFF_BELT, propagators

SECONDS = 2.0


def trajectory_speed() -> float:
    """Simulated seconds per wall second of one trajectory in squeal, samples with all six columns written."""
    run, duration = engine_in_blocks()
    run()
    return duration / best_time(run, 9)


def engine_in_blocks() -> tuple[Callable[[], None], float]:
    """A run in blocks of 512 samples, and how long it simulates [s]."""
    motion, block = Motion(CASE, RATE, START), sample_room(512)
    blocks = int(SECONDS * RATE / len(block))

    def run() -> None:
        for _ in range(blocks):
            motion.advance(block)

    return run, blocks * len(block) / RATE


def one_call() -> None:
    """`simulate` as a user calls it."""
    simulate(CASE, 5.0, initial_state=START)


@numba.njit(nogil=True, fastmath={"contract"})
def _propagate(state: Vector, drift: Vector, m: Vector, out: Vector) -> None:
    x, y, vx, vy = state
    for i in range(out.shape[0]):
        out[i, 0], out[i, 1], out[i, 2], out[i, 3], out[i, 4], out[i, 5] = x, y, vx, vy, y, y
        x, y, vx, vy = (
            drift[0] + m[0] * x + m[1] * y + (m[2] * vx + m[3] * vy),
            drift[1] + m[4] * x + m[5] * y + (m[6] * vx + m[7] * vy),
            drift[2] + m[8] * x + m[9] * y + (m[10] * vx + m[11] * vy),
            drift[3] + m[12] * x + m[13] * y + (m[14] * vx + m[15] * vy),
        )
    state[0], state[1], state[2], state[3] = x, y, vx, vy


def propagation_speed() -> float:
    """The limit: z <- P z + d and six columns written, nothing else."""
    flow, block = empty_flow(), sample_room(512)
    quiet = CASE.replace(preload=20.0)
    propagators(pack(quiet), 1.0 / RATE, flow)
    linear = flow[:OFF_BELT].reshape(TERMS, -1)[:5, 4:8]  # of one step
    drift, matrix = linear[0].copy(), linear[1:].T.ravel()
    state, blocks = START.copy(), int(SECONDS * RATE / len(block))

    def run() -> None:
        for _ in range(blocks):
            _propagate(state, drift, matrix, block)

    run()
    return blocks * len(block) / RATE / best_time(run, 9)


def simulate_speed() -> tuple[float, float, float]:
    """`simulate(p, 5.0)` in a fresh process, by simulated s per wall s: its first call once the code is loaded, later
    ones, and the engine in blocks, which take turns; the process whose first call was best.
    """
    code = "import json; from benchmarks.throughput import _simulate_speed; print(json.dumps(_simulate_speed()))"
    found: list[tuple[float, float, float]] = []
    for _ in range(5):
        output = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout
        found.append(tuple(json.loads(output)))
    return max(found)


def _simulate_speed() -> tuple[float, float, float]:
    simulate(CASE, 1e-3)  # loads the code
    begin = time.perf_counter()
    one_call()
    first = 5.0 / (time.perf_counter() - begin)
    later, blocks = speeds_in_turns([(one_call, 5.0), engine_in_blocks()], 1.0)
    return first, max(later), max(blocks)


def operating_arrays(n: int) -> dict[str, Vector]:
    """Operating points of the paper's range with c = 20 N s/m, spread evenly by an additive recurrence."""
    ways = np.outer(np.arange(n), [0.7548776662466927, 0.5698402909980532, 0.3247179572447460]) % 1.0
    return {
        "preload": 50.0 + 250.0 * ways[:, 0],
        "belt_speed": 1.0 + 3.0 * ways[:, 1],
        "pad_stiffness": 2e7 + 8e7 * ways[:, 2],
    }


def operating_points(n: int) -> list[RigParameters]:
    """The same as sets of parameters."""
    arrays = operating_arrays(n)
    return [CASE.replace(**{name: float(array[i]) for name, array in arrays.items()}) for i in range(n)]


@dataclass(frozen=True)
class ManyRuns:
    """`simulate_many` over n points: best wall time [s], peak resident memory of its process [MB]."""

    points: int
    duration: float
    threads: int
    seconds: float
    memory: float
    separating: float


def many_runs(points: int, duration: float, threads: int, repeats: int = 1) -> ManyRuns:
    """Measured in a process of its own, for the memory."""
    code = (
        "import json; from benchmarks.throughput import _many_runs;"
        f" print(json.dumps(_many_runs({points}, {duration}, {threads}, {repeats})))"
    )
    output = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout
    return ManyRuns(points, duration, threads, *json.loads(output))


def _many_runs(points: int, duration: float, threads: int, repeats: int) -> tuple[float, float, float]:
    simulate_many(CASE, 0.01)
    rows = simulate_many(CASE, duration, initial_compressions=3.0, **operating_arrays(min(points, 200))).summaries

    def run() -> None:
        arrays = operating_arrays(points)
        simulate_many(CASE, duration, initial_compressions=3.0, threads=threads, **arrays)

    seconds = best_time(run, repeats, 60.0)
    memory = math.nan
    status = Path("/proc/self/status")  # unlike getrusage it forgets the parent's peak
    if status.is_file():
        lines = status.read_text(encoding="utf-8").splitlines()
        memory = next(float(line.split()[1]) for line in lines if line.startswith("VmHWM")) / 1024.0
    return seconds, memory, float(np.mean(rows["separations"] > 0))


def thread_efficiency(points: int, threads: int) -> float:
    """Share of `threads` times the speed of one thread that so many reach on runs of half a second, which take turns:
    the best of each.
    """
    arrays = operating_arrays(points)

    def run(workers: int) -> None:
        simulate_many(CASE, 0.5, initial_compressions=3.0, threads=workers, **arrays)

    run(threads)
    one, all_of_them = speeds_in_turns([(lambda: run(1), 1.0), (lambda: run(threads), 1.0)])
    return max(all_of_them) / max(one) / threads


def map_times(points: int = 10_000_000) -> dict[str, float]:
    """Wall time [s] of a map of so many points with all bands, by damping."""
    rows = 1000
    grids = {"preload": np.linspace(10.0, 300.0, rows)[:, None], "pad_stiffness": np.linspace(1e7, 1e8, points // rows)}
    cases = {"no": (0.0, 0.0), "equal": (20.0, 20.0), "unequal": (20.0, 60.0)}
    times = {}
    for name, (c_x, c_y) in cases.items():
        p = CASE.replace(damping_x=c_x, damping_y=c_y)
        stability_map(p, preload=300.0)
        times[name] = best_time(lambda p=p: stability_map(p, **grids), 2)  # type: ignore[misc]
    return times
