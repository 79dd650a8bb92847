"""A campaign of 100 000 points on a Dask cluster of two workers beside the bare `simulate_many`.

`make bench ARGS=campaigns` writes it to docs/benchmarks.md; `python -m benchmarks.campaigns --points 10000` prints it.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from squeal_rig.experiments.campaign.measuring import head
from squeal_rig.experiments.campaign.plans import Campaign, parse_campaign
from squeal_rig.experiments.campaign.running import Progress, Where, run_direct, start
from squeal_rig.experiments.campaign.store import read
from squeal_rig.model.motion.ensemble import simulate_many
from tests.experiments.killing import kill_a_worker

WORKERS, KILLS = 2, 8
PLAN = """\
campaign: {points} points
rig: {{preset: yavuz_sen_2023, damping_x: 20.0, damping_y: 20.0}}
measure: level
factors:
  preload: {{from: 50.0, to: 300.0, count: 25}}
  belt_speed: {{from: 1.0, to: 4.0, count: 20}}
  pad_stiffness: {{from: 2.0e+7, to: 1.0e+8, count: {stiffnesses}}}
protocol: [{{start: 3.0}}, {{settle: {{longest: 0.2}}}}, {{dwell: 0.3}}]
"""


def plan(points: int) -> Campaign:
    """A plan of so many points, a multiple of 500."""
    return parse_campaign(PLAN.format(points=points, stiffnesses=points // 500), "the plan")


@dataclass
class Cost:
    """Wall time [s], processor time of all processes [s], peak resident memory [MB] of this process and of the largest
    other one; how often a worker was killed, and points done at each kill.
    """

    wall: float = 0.0
    processor: float = 0.0
    own: float = 0.0
    worker: float = 0.0
    kills: list[int] = field(default_factory=list)


def _processor() -> float:
    used = os.times()
    return used.user + used.system + used.children_user + used.children_system


def _peak() -> float:
    lines = Path("/proc/self/status").read_text(encoding="utf-8").splitlines()
    return next(float(line.split()[1]) for line in lines if line.startswith("VmHWM")) / 1024.0


def bare(points: int) -> tuple[Cost, float]:
    """`simulate_many` over the same points by as many threads; and the mean RMS of x [m]."""
    campaign = plan(points)
    varied = {f.name: head(campaign, 0, points)[f.name] for f in campaign.design.factors}
    simulate_many(campaign.base, 0.01)  # loads the code
    begin, used = time.perf_counter(), _processor()
    dwell = campaign.protocol[-1].duration
    found = simulate_many(
        campaign.base, dwell, settle=campaign.settle, initial_compressions=campaign.start, threads=WORKERS, **varied
    ).summaries
    return Cost(time.perf_counter() - begin, _processor() - used, _peak()), float(np.mean(found["rms_x"]))


def on_cluster(points: int, workers: int, folder: str, kills: int = 0) -> Cost:
    """The campaign from an empty folder to its end, start and end of the cluster included."""
    cost = Cost()
    every = points // (kills + 1) if kills else points + 1

    def tell(progress: Progress) -> None:
        if progress.done < points and progress.done >= every * (len(cost.kills) + 1):
            kill_a_worker()
            cost.kills.append(progress.done)

    begin, used = time.perf_counter(), _processor()
    store = start(Path(folder), plan(points))
    with ThreadPoolExecutor(1) as pool:
        done: list[bool] = []
        watching = pool.submit(_largest_child, done)
        try:
            run_direct(store, Where(workers), tell)
        finally:
            store.close()
            done.append(True)
        cost.worker = watching.result()
    cost.wall, cost.processor, cost.own = time.perf_counter() - begin, _processor() - used, _peak()
    return cost


def _largest_child(done: list[bool]) -> float:
    """Largest resident memory of a child [MB] until `done` has something in it."""
    largest = 0.0
    while not done:
        for process in psutil.Process().children():
            try:
                largest = max(largest, process.memory_info().rss / 1024.0**2)
            except psutil.Error:
                continue
        time.sleep(0.2)
    return largest


def _alone(function: Callable[..., Any], *arguments: object) -> Any:
    """A call in a process of its own, for its memory."""
    with get_context("spawn").Pool(1) as pool:
        return pool.apply(function, arguments)


def _same(one: Path, other: Path) -> bool:
    a, b = read(one, "points"), read(other, "points")
    return a.keys() == b.keys() and all(np.array_equal(a[n], b[n], equal_nan=a[n].dtype.kind == "f") for n in a)


def section(points: int = 100_000) -> str:
    """Measure, and tell in Markdown."""
    few = points // 10
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        alone, _ = _alone(bare, points)
        costs = {
            "2 workers": _alone(on_cluster, points, WORKERS, str(folder / "two")),
            f"2 workers, killed {KILLS} times": _alone(on_cluster, points, WORKERS, str(folder / "killed"), KILLS),
            "1 worker": _alone(on_cluster, points, 1, str(folder / "one")),
            f"2 workers, {few} points": _alone(on_cluster, few, WORKERS, str(folder / "few")),
        }
        same = all(_same(folder / "two", folder / other) for other in ("killed", "one"))
    rows = [
        "| | wall [s] | processor [s] | points/s | peak memory [MB], largest worker's |",
        "|---|---|---|---|---|",
        f"| bare `simulate_many`, {WORKERS} threads | {alone.wall:.1f} | {alone.processor:.1f} |"
        f" {points / alone.wall:.0f} | {alone.own:.0f} |",
    ]
    for what, cost in costs.items():
        count = few if "points" in what else points
        rows.append(
            f"| {what} | {cost.wall:.1f} | {cost.processor:.1f} | {count / cost.wall:.0f} |"
            f" {cost.own:.0f}, {cost.worker:.0f} |"
        )
    two = costs["2 workers"]
    killed = ", ".join(str(done) for done in costs[f"2 workers, killed {KILLS} times"].kills)
    return (
        f"\n{points} points of 0.5 s each (c = 20 N s/m, squealing), start and end of the cluster included: overhead"
        f" {two.wall / alone.wall - 1.0:+.1%} of wall time, {two.processor / alone.processor - 1.0:+.1%} of processor"
        f" time. A worker was killed at {killed} points done. Results of 2 workers, of 2 that are killed and of 1 are"
        f" {'the same in every bit' if same else 'NOT the same'}.\n\n" + "\n".join(rows) + "\n"
    )


def main() -> None:
    """Print a run."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.campaigns", description=__doc__)
    parser.add_argument("--points", type=int, default=100_000, help="points, a multiple of 500 (default: 100000)")
    sys.stdout.write(section(parser.parse_args().points))


if __name__ == "__main__":
    main()
