"""The live node, measured on real processes: real time kept, processor and memory, highest rate, latency, start."""

from __future__ import annotations

import os
import statistics
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from benchmarks.live import PATIENCE, Blocks, Listener, environment, listening
from squeal_rig.configuration.files import config_directory
from squeal_rig.graph.conversions import cloud
from squeal_rig.instruments.acquisition import Acquisition
from squeal_rig.instruments.settings import RigSettings
from squeal_rig.instruments.virtual import VirtualRig
from squeal_rig.model import RigParameters
from tests.graph.processes import Child

RATES = (51_200, 102_400, 204_800, 400_000, 800_000, 1_000_000, 2_000_000)
#: From here on a block does not fit into what Fast DDS shares with its readers by default [Hz].
LARGE = 400_000
PROFILES = ("FASTRTPS_DEFAULT_PROFILES_FILE", str(config_directory() / "fastdds.xml"))
DAMPED = ("damping_x:=20.0", "damping_y:=20.0")
RATE_SECONDS = 10.0
WINDOW = 0.02
WINDOWS = 500
UPDATES = 400
#: Between two updates of a parameter [s].
_REST = 0.1
STARTS = 5
#: Blocks at the start of a run that are not counted: discovery and the first use of everything [s].
_SETTLING = 2.0


@dataclass(frozen=True)
class Stretch:
    """Some time of a run: blocks that came and that were lost, shares of one core, lateness of blocks [ms]."""

    blocks: int
    lost: int
    overruns: int
    share: float
    own_share: float
    lateness: tuple[float, float, float]  # p50, p99, worst


@dataclass(frozen=True)
class Endurance:
    """A run quiet, then squealing; resident memory [MB] at its start, middle and end."""

    minutes: float
    quiet: Stretch
    squealing: Stretch
    memory: tuple[float, float, float]


def stretch(listener: Listener, node: Child, seconds: float) -> Stretch:
    """Follow a running simulator for that long."""
    blocks = listener.blocks
    count, lost, overruns = blocks.count, blocks.lost, listener.overruns
    started, cpu, own = time.monotonic(), node.cpu_seconds(), time.process_time()
    listener.spin(seconds)
    wall = time.monotonic() - started
    share, own_share = (node.cpu_seconds() - cpu) / wall, (time.process_time() - own) / wall
    # The health of the last second is still to come.
    listener.spin(1.5)
    late = np.array(blocks.latest[count:]) / 1e6
    p50, p99 = np.percentile(late, [50, 99])
    return Stretch(
        len(late), blocks.lost - lost, listener.overruns - overruns, share, own_share, (p50, p99, float(late.max()))
    )


def endurance(listener: Listener, minutes: float) -> Endurance:
    """51.2 kHz in real time: the first half quiet, the second squealing."""
    listener.listen_to_blocks()
    with listener.running("simulator", DAMPED) as node:
        listener.wait_for(lambda: listener.blocks.count > 0, "the first block", PATIENCE)
        listener.spin(_SETTLING)
        start = node.memory()
        quiet = stretch(listener, node, 30.0 * minutes)
        middle = node.memory()
        listener.squeal()
        squealing = stretch(listener, node, 30.0 * minutes)
        return Endurance(minutes, quiet, squealing, (start, middle, node.memory()))


def at_rate(listener: Listener, rate: int, seconds: float) -> Stretch:
    """Squealing in real time at a sample rate [Hz]."""
    listener.listen_to_blocks()
    with listener.running("simulator", (*DAMPED, f"sample_rate:={rate}")) as node:
        listener.wait_for(lambda: listener.blocks.count > 0, "the first block", PATIENCE)
        listener.squeal()
        listener.spin(_SETTLING)
        return stretch(listener, node, seconds)


def block_costs(rate: int) -> tuple[float, float]:
    """Median times [ms] to make a block in squeal (model and channels), and to serialise both of its messages."""
    p = RigParameters().replace(damping_x=20.0, damping_y=20.0, preload=300.0, pad_stiffness=6e7)
    rig = Acquisition(VirtualRig(), p, RigSettings(sample_rate=rate))
    rig.start(time.time_ns())
    rig.impact()
    for _ in range(100):
        block = rig.next_block()
    return _median_ms(rig.next_block), _median_ms(lambda: [cloud(s, block.stamp) for s in (block.daq, block.truth)])


def _median_ms(action: Callable[[], object]) -> float:
    times = []
    for _ in range(100):
        started = time.perf_counter()
        action()
        times.append(time.perf_counter() - started)
    return 1e3 * statistics.median(times)


def latencies(listener: Listener, windows: int) -> list[float]:
    """Time [ms] from a window's last sample to its `friction/mu` in our process, squealing, many short windows."""
    listener.listen_to_blocks()
    with (
        listener.running("friction_estimator", (f"window:={WINDOW}",)),
        listener.running("simulator", DAMPED),
    ):
        listener.wait_for(lambda: listener.blocks.count > 0, "the first block", PATIENCE)
        listener.squeal()
        listener.listen_to_friction()
        listener.wait_for(lambda: len(listener.means) >= windows, f"{windows} windows of friction", PATIENCE)
        listener.spin(0.5)
        ends = dict(listener.windows)  # by the value of mu: no two windows of squeal share one
        return [(came - ends[mu]) / 1e6 for mu, came in listener.means if mu in ends]


def update_times(listener: Listener, updates: int) -> list[float]:
    """Time [ms] from asking the rig for another preload, by its parameter service, to the stability summary of it."""
    with (
        listener.running("friction_estimator"),
        listener.running("stability"),
        listener.running("simulator", DAMPED),
    ):
        listener.listen_to_stability()
        listener.wait_for(lambda: listener.summaries, "a stability summary", PATIENCE)
        listener.set({"preload": 50.0}, atomically=True)  # the service is found here, not in the first time
        times = []
        for number in range(updates):
            preload = 50.0 + 0.25 * (number + 1)  # no two updates share one
            listener.spin(_REST + number % 10 * 1e-3)  # at another moment of a block each time
            asked = time.monotonic()
            listener.set({"preload": preload}, atomically=True)
            listener.wait_for(
                lambda preload=preload: listener.summaries[-1][0] == preload, "the summary of an update", PATIENCE
            )
            times.append(1e3 * (next(came for told, came in listener.summaries if told == preload) - asked))
        return times


def start_times(listener: Listener) -> tuple[float, float]:
    """Times [s] from the start of the simulator's process to its first block: when due, and when it came to us."""
    listener.listen_to_blocks()
    with listener.running("simulator", DAMPED) as node:
        listener.wait_for(lambda: listener.blocks.count > 0, "the first block", PATIENCE)
        blocks: Blocks = listener.blocks
        return (blocks.first_due - node.started) / 1e9, (blocks.first_received - node.started) / 1e9


def first_start(listener: Listener) -> float:
    """Time [s] to the first block where nothing has been compiled before."""
    with tempfile.TemporaryDirectory(prefix="squeal_rig_bench_") as empty, environment("NUMBA_CACHE_DIR", empty):
        return start_times(listener)[0]


# --- the section


def section(minutes: float) -> str:
    """Measure all of it; the section of docs/benchmarks.md, without its heading."""
    loads = [os.getloadavg()[0]]
    with listening() as listener:
        start_times(listener)  # compiles what is not yet compiled
        starts = [start_times(listener) for _ in range(STARTS)]
        first = first_start(listener)
        delays = latencies(listener, WINDOWS)
        updates = update_times(listener, UPDATES)
        rates = {rate: at_rate(listener, rate, RATE_SECONDS) for rate in RATES}
        with environment(*PROFILES):
            large = {rate: at_rate(listener, rate, RATE_SECONDS) for rate in RATES if rate >= LARGE}
        loads.append(os.getloadavg()[0])
        long = endurance(listener, minutes)
        loads.append(os.getloadavg()[0])
    p50, p99 = np.percentile(delays, [50, 99])
    update_p50, update_p99 = np.percentile(updates, [50, 99])
    due, came = (statistics.median(times) for times in zip(*starts, strict=True))
    return f"""\
Real processes on a ROS domain of their own; one subscriber to `daq/samples`, in Python, counts blocks by `seq`.
Load of the machine (1 min average) before, between and after, with other work on it:
{", ".join(f"{load:.1f}" for load in loads)}.

### 51.2 kHz in real time, {minutes:g} min

{_endurance_table(long)}

Resident memory at start, middle, end: {", ".join(f"{value:.1f}" for value in long.memory)} MB.

### Highest sample rate in real time

Squealing, {RATE_SECONDS:g} s each; a rate holds when no block was lost and the node never fell 0.5 s behind.
Both messages together take 160 bytes a sample. Fast DDS shares 512 KiB with its readers by default, less than one
block at 1 MHz; `config/fastdds.xml` makes that 16 MiB. By default: {_highest(rates)}
With that file: {_highest(large)}

{_rate_table({"default": rates, "fastdds.xml": large})}

### From block end to `friction/mu`

From the time the last sample of a window was taken to the arrival of its `friction/mu` in a third process, squealing,
{len(delays)} windows of {WINDOW:g} s: p50 {p50:.1f} ms, p99 {p99:.1f} ms, worst {max(delays):.1f} ms.

### From a parameter update to `stability/summary`

From the call of the rig's parameter service in a third process to the arrival of the summary of the new value there,
{len(updates)} updates of the preload, {_REST:g} s apart: p50 {update_p50:.1f} ms, p99 {update_p99:.1f} ms, worst \
{max(updates):.1f} ms.

### Start of a node

From the start of the process to its first block: {due:.2f} s (median of {STARTS}, worst \
{max(time[0] for time in starts):.2f} s),
received by a subscriber already there after {came:.2f} s (worst \
{max(time[1] for time in starts):.2f} s; the rest is discovery).
The first start ever, with everything to compile: {first:.1f} s.
"""


def _endurance_table(run: Endurance) -> str:
    rows = [
        "| | blocks | lost | overruns | simulator, share of a core | block end to subscriber p50, p99, worst [ms] |",
        "|---|---|---|---|---|---|",
    ]
    for name, part in (("quiet", run.quiet), ("squealing", run.squealing)):
        late = ", ".join(f"{value:.1f}" for value in part.lateness)
        rows.append(f"| {name} | {part.blocks} | {part.lost} | {part.overruns} | {part.share:.1%} | {late} |")
    return "\n".join(rows)


def holds(part: Stretch) -> bool:
    """Whether real time was kept and every block came."""
    return part.lost == 0 and part.overruns == 0


def _highest(rates: dict[int, Stretch]) -> str:
    kept = [rate for rate, part in rates.items() if holds(part)]
    highest = f"{max(kept) / 1e3:g} kHz" if kept else "none of these"
    bound = " (the bound of `sample_rate`)" if kept and max(kept) == max(RATES) else ""
    return f"highest that holds {highest}{bound}."


def _rate_table(runs: dict[str, dict[int, Stretch]]) -> str:
    rows = [
        "| rate [kHz] | Fast DDS | holds | lost | overruns | simulator | subscriber"
        " | block end to subscriber p50, p99, worst [ms] | model and channels [ms] | serialising [ms] |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for name, rates in runs.items():
        for rate, part in rates.items():
            late = ", ".join(f"{value:.1f}" for value in part.lateness)
            made, serialised = block_costs(rate)
            rows.append(
                f"| {rate / 1e3:g} | {name} | {'yes' if holds(part) else 'no'} | {part.lost} | {part.overruns} |"
                f" {part.share:.0%} | {part.own_share:.0%} | {late} | {made:.2f} | {serialised:.3f} |"
            )
    return "\n".join(rows)
