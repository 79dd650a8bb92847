"""Measure everything, or one part, and write docs/benchmarks.md with its plots."""

from __future__ import annotations

import argparse
import os
import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from benchmarks import cycles, instruments
from benchmarks.case import DURATION, amplification, expected_states, ratio, speeds_in_turns
from benchmarks.peers import Point, all_points, real_time
from benchmarks.taylor import lanes_speed, slip_points, slip_table
from benchmarks.throughput import (
    ManyRuns,
    many_runs,
    map_times,
    one_call,
    propagation_speed,
    simulate_speed,
    thread_efficiency,
    trajectory_speed,
)

DOCS = Path(__file__).resolve().parents[1] / "docs"
ASKED = 1e-6
STRICT = 1e-9
PARTS = ("engine", "cycles", "instruments", "nodes", "stops", "campaigns", "page")
#: Sections in this order after the engine's; each part is written anew without the others.
CYCLES, INSTRUMENTS, NODES = "## Cycles and hits\n", "## Instruments and actuators\n", "## The live node\n"
STOPS, CAMPAIGNS, PAGE = "## Emergency stop\n", "## Campaigns\n", "## The operator's page\n"


def machine() -> str:
    """Processor, cores and versions; no names of hosts or paths."""
    model = platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.is_file():
        lines = cpuinfo.read_text(encoding="utf-8").splitlines()
        model = next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), model)
    packages = []
    for name in ("numpy", "numba", "scipy", "numbalsoda", "diffrax", "heyoka", "jax"):
        try:
            packages.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            packages.append(f"{name} absent")
    system = f"{platform.system()}, Python {platform.python_version()}"
    return f"{model}, {os.cpu_count()} cores; {system}; {', '.join(packages)}."


def peer_table(points: list[Point], limit: float, speed: float) -> str:
    """Every point, and how much slower it is than the exact engine."""
    exact = next(point for point in points if point.solver == "exact")
    rows = [
        "| solver | setting | error (share of amplitude) | times real time | exact is faster by |",
        "|---|---|---|---|---|",
    ]
    for point in points:
        rows.append(
            f"| {point.solver} | {point.setting} | {point.error:.1e} | {real_time(point):.3g} |"
            f" {point.seconds / exact.seconds:.3g} |"
        )
    rows.append("")
    rows.append(
        f"In 2 s of squeal the engine runs {speed:.0f} times real time, bare state propagation (one 4 x 4 product a"
        f" sample, the limit) {limit:.0f}: the physics costs {limit / speed:.1f} times the limit."
    )
    return "\n".join(rows)


def best_at(points: list[Point], prefix: str) -> Point | None:
    """The fastest point of a solver that reaches the error asked for, else its most exact one."""
    own = [point for point in points if point.solver.startswith(prefix)]
    good = [point for point in own if point.error <= ASKED]
    if good:
        return min(good, key=lambda point: point.seconds)
    return min(own, key=lambda point: point.error) if own else None


def strongest_text(points: list[Point], first: float, later: float, blocks: float) -> str:
    """The strongest peer where the exact engine works, in turns with it and with `simulate`, whose speeds in a fresh
    process are `first`, `later` and, of the engine, `blocks` in simulated s per wall s.
    """
    text = (
        f"`simulate(p, 5.0)` runs {first:.0f} times real time in the first call of a fresh process, once the code is"
        f" loaded, and {later:.0f} later: {first / blocks:.2f} and {later / blocks:.2f} of the engine in blocks,"
        f" {blocks:.0f} in the same process. What the first call lacks goes into memory never used before, 32 bytes a"
        " sample."
    )
    peers = [point for point in points if point.solver not in ("exact", "RK4 (own)") and point.error <= STRICT]
    if not peers:
        return f"No peer reaches an error of {STRICT:g}.\n\n{text}"
    best = min(peers, key=lambda point: point.seconds)
    exact = next(point for point in points if point.solver == "exact")
    runs = [(best.run, DURATION), (exact.run, DURATION), (one_call, 5.0)]
    peer, own, called = speeds_in_turns(runs, 5.0)
    simulated = ratio(called, peer)
    return (
        f"At errors <= {STRICT:g} the strongest peer is {best.solver} ({best.setting}, error {best.error:.1e}):"
        f" {real_time(best):.0f} times real time. Measured in turns with it, the engine is {ratio(own, peer):.1f} times"
        f" as fast on this case and `simulate(p, 5.0)` {simulated:.1f} times; in its first call, which has"
        f" {first / later:.2f} of the speed of later ones, {simulated * first / later:.1f} times.\n\n{text}"
    )


def lanes_text(lanes: tuple[int, float, float, float] | None) -> str:
    """heyoka's batch mode beside `simulate_many` on one core."""
    if lanes is None:
        return "heyoka's batch mode: not measured (heyoka is not installed)."
    width, peer, own, faster = lanes
    return (
        f"The peer is heyoka's batch mode, {width} runs in SIMD lanes on one core, without any samples: {peer:.0f}"
        f" simulated s per wall s. `simulate_many` with one thread does {own:.0f}, summaries of every sample included:"
        f" in turns it is {faster:.1f} times as fast. heyoka's event callbacks are Python here, which costs it a part"
        " of that: the lanes wait for each other's."
    )


def ratio_table(points: list[Point]) -> str:
    """Peers at their fastest setting within the error asked for."""
    exact = next(point for point in points if point.solver == "exact")
    rows = [
        f"| peer at error <= {ASKED:g}, or its best | setting | error | exact is faster by |",
        "|---|---|---|---|",
    ]
    for prefix in ("RK4", "SciPy", "numbalsoda", "diffrax", "heyoka"):
        point = best_at(points, prefix)
        if point is not None:
            rows.append(
                f"| {point.solver} | {point.setting} | {point.error:.1e} | {point.seconds / exact.seconds:.0f} |"
            )
    return "\n".join(rows)


def many_table(runs: list[ManyRuns]) -> str:
    """Scaling of `simulate_many` with points and threads."""
    rows = [
        "| points | each [s] | threads | wall [s] | simulated s per wall s | peak memory [MB] | share that separates |",
        "|---|---|---|---|---|---|---|",
    ]
    for run in runs:
        speed = run.points * run.duration / run.seconds
        rows.append(
            f"| {run.points} | {run.duration:g} | {run.threads} | {run.seconds:.3g} | {speed:.0f} |"
            f" {run.memory:.0f} | {run.separating:.0%} |"
        )
    return "\n".join(rows)


def draw(points: list[Point], runs: list[ManyRuns]) -> None:
    """The work-precision diagram and the scaling of `simulate_many`."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(figsize=(7.0, 4.5), layout="constrained")
    for solver in dict.fromkeys(point.solver for point in points):
        own = sorted((p for p in points if p.solver == solver), key=lambda p: p.seconds)
        axes.loglog([p.error for p in own], [real_time(p) for p in own], "o-", label=solver)
    axes.axhline(1.0, color="0.7", lw=0.8)
    axes.axvline(ASKED, color="0.7", lw=0.8)
    axes.set_xlabel("error over 50 ms, share of the amplitude")
    axes.set_ylabel("simulated time / wall time")
    axes.legend(fontsize=7)
    figure.savefig(DOCS / "work_precision.png", dpi=150, metadata={"Software": None})
    figure, axes = plt.subplots(figsize=(6.0, 4.0), layout="constrained")
    for threads, duration in sorted({(run.threads, run.duration) for run in runs}):
        own = [run for run in runs if (run.threads, run.duration) == (threads, duration)]
        speeds = [run.points * run.duration / run.seconds for run in own]
        axes.semilogx([run.points for run in own], speeds, "o-", label=f"threads: {threads}, each {duration:g} s")
    axes.set_xlabel("operating points")
    axes.set_ylabel("simulated s per wall s")
    axes.set_ylim(bottom=0.0)
    axes.legend()
    figure.savefig(DOCS / "simulate_many.png", dpi=150, metadata={"Software": None})


def engine() -> str:
    """Measure the engine against its peers; all of the page above the live node."""
    speed, limit = trajectory_speed(), propagation_speed()
    points, notes = all_points(expected_states())
    cores = os.cpu_count() or 1
    alone, together = (many_runs(2000, 0.5, threads, 3) for threads in (1, cores))
    runs = [many_runs(n, duration, cores) for n, duration in ((100, 0.5), (1000, 0.5), (10_000, 0.5), (100_000, 0.05))]
    efficiency = thread_efficiency(500, cores)
    maps = map_times()
    speeds = simulate_speed()
    try:
        slip_text = slip_table(slip_points(), STRICT)
        lanes = lanes_speed(64, 0.5, 3.0)
    except ImportError as error:
        slip_text, lanes = f"Not measured ({error}).", None
    draw(points, [alone, *runs])
    map_text = ", ".join(f"{seconds:.1f} s ({name} damping)" for name, seconds in maps.items())
    return f"""# Benchmarks

Written by `make bench`; every ratio is of figures measured in one run. {machine()}
Times are the best of some repeats, since other work on the machine only adds. Ratios to heyoka in sentences and in the
table of slip friction are medians of rounds in which both take turns, since machines change their speed.

The case: preset, F = 300 N, V = 1 m/s, k = 6e7 N/m, c = 20 N s/m, the pad let go 3 static compressions towards the
belt, 50 ms at 51.2 kHz, about 90 contact events. Reference: DOP853, rtol 1e-12, atol 1e-18 m, restarted at each event.
This start amplifies a small change {amplification():.0f} times, so the reference's 1e-12 cannot come out below 1e-10.
Peers have compiled right-hand sides. heyoka finds the contact events and goes on from each in the other mode, the
others run straight through them.

## Work and precision

![work-precision diagram](work_precision.png)

{strongest_text(points, *speeds)}

{ratio_table(points)}

{peer_table(points, limit, speed)}
{"".join(f"{chr(10)}{note}" for note in notes)}

## Friction that sees the slip

The same case with `friction_direction: slip` (V_reg = 0.01 m/s), with `friction_speed: slip`
(mu = 0.82 - 0.02 s/m |V - vx|), and with both. Reference as above.

{slip_text}

## Many operating points

Points spread evenly over the paper's range, c = 20 N s/m, started 3 static compressions off. 2000 points:
{alone.seconds:.2f} s with 1 thread, {together.seconds:.2f} s with {cores}. Making the parameters is part of it: one
set, and arrays of what varies. The efficiency of {cores} threads on 500 points, by the best of some rounds, is
{efficiency:.0%}.

{lanes_text(lanes)}

![scaling of simulate_many](simulate_many.png)

{many_table([alone, together, *runs])}

## Stability maps

10 million points with k_cr, upper bound and margin: {map_text}.
"""


def main() -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("part", nargs="?", choices=PARTS, help="measure this alone")
    parser.add_argument(
        "--minutes", type=float, default=1.0, help="length of the runs of the live node and of the page (default: 1)"
    )
    parser.add_argument("--rate", type=int, default=51_200, help="sample rate of the rig of the page [Hz]")
    arguments = parser.parse_args()
    if not 0.1 <= arguments.minutes <= 1440.0:
        parser.error(f"--minutes = {arguments.minutes:g} is out of bounds: it must be 0.1 to 1440 min")
    DOCS.mkdir(exist_ok=True)
    page = DOCS / "benchmarks.md"
    above, _, seen = page.read_text(encoding="utf-8").partition(PAGE) if page.is_file() else ("", "", "")
    above, _, many = above.partition(CAMPAIGNS)
    above, _, stops = above.partition(STOPS)
    above, _, below = above.partition(NODES)
    above, _, measuring = above.partition(INSTRUMENTS)
    above, _, between = above.partition(CYCLES)
    asked = PARTS if arguments.part is None else (arguments.part,)
    if "nodes" in asked:
        from benchmarks.nodes import section  # the other figures need no ROS

        below = f"\n{section(arguments.minutes)}"
    if "cycles" in asked:
        between = f"\n{cycles.section()}"
    if "instruments" in asked:
        measuring = instruments.section()
    if "stops" in asked:
        from benchmarks.stops import section as stops_section

        stops = f"\n{stops_section()}"
    if "campaigns" in asked:
        from benchmarks.campaigns import section as campaigns_section

        many = campaigns_section()
    if "page" in asked:
        from benchmarks.page import measured

        seen = f"\n{measured(arguments.minutes, rate=arguments.rate)}"
    if "engine" in asked:
        above = engine()
    later = (
        (CYCLES, between), (INSTRUMENTS, measuring), (NODES, below), (STOPS, stops), (CAMPAIGNS, many), (PAGE, seen),
    )  # fmt: skip
    parts = [above, *(title + text for title, text in later if text)]
    page.write_text("\n\n".join(part.rstrip() for part in parts if part) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
