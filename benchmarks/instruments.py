"""What instruments and actuators cost, beside the physics: processor time per sampled second at 51.2 kHz."""

from __future__ import annotations

import time
from collections.abc import Callable

from squeal_rig.instruments.acquisition import Acquisition
from squeal_rig.instruments.chain import Chain
from squeal_rig.instruments.data_sheets import data_sheet_names, load_data_sheets
from squeal_rig.instruments.settings import BLOCKS_PER_SECOND, RigSettings
from squeal_rig.instruments.virtual import VirtualRig
from squeal_rig.model import RigParameters
from squeal_rig.model.core.layout import sample_room
from squeal_rig.model.motion.trajectory import Motion

CASE = RigParameters().replace(damping_x=20.0, damping_y=20.0, preload=300.0)
_REPEATS, _BLOCKS = 7, 50


def processor_time(block: Callable[[], object]) -> float:
    """Processor seconds per sampled second of something done for each block: the best of some repeats."""
    for _ in range(_BLOCKS):
        block()
    times = []
    for _ in range(_REPEATS):
        begun = time.process_time()
        for _ in range(_BLOCKS):
            block()
        times.append(time.process_time() - begun)
    return min(times) * BLOCKS_PER_SECOND / _BLOCKS


def section() -> str:
    """Table by data sheet, every figure of this run."""
    rows = [
        "| data sheets | the rig as a driver | of it instruments alone | times the rig with ideal ones |",
        "|---|---|---|---|",
    ]
    ideal = 0.0
    for name in ("ideal", *(name for name in data_sheet_names() if name != "ideal")):
        settings = RigSettings(instruments=name)
        rig = Acquisition(VirtualRig(), CASE, settings)
        rig.impact()
        whole = processor_time(rig.next_block)
        ideal = ideal or whole
        chain, samples = Chain(load_data_sheets(name), settings.sample_rate, 1), rig.next_block().daq
        measuring = processor_time(lambda chain=chain, samples=samples: chain.measure(samples.copy()))  # type: ignore[misc]
        rows.append(f"| {name} | {whole:.1%} | {measuring:.1%} | {whole / ideal:.1f} |")
    motion, out = Motion(CASE, 51200), sample_room(64)
    others = [CASE.replace(preload=preload) for preload in (299.0, 301.0)]
    number = iter(range(10**9))
    change = processor_time(lambda: motion.set_parameters(others[next(number) % 2])) / BLOCKS_PER_SECOND
    piece = processor_time(lambda: motion.advance(out)) / BLOCKS_PER_SECOND
    table = "\n".join(rows)
    return f"""
Share of one core in real time at 51.2 kHz, all channels, in squeal at F = 300 N, c = 20 N s/m; no ROS in it. Processor
time, the best of {_REPEATS} repeats of {_BLOCKS} blocks.

{table}

Actuators with ripple or inertia change the parameters every 64 samples: a change (`Motion.set_parameters`) costs
{change * 1e6:.0f} us, the motion of 64 samples {piece * 1e6:.0f} us.
"""


if __name__ == "__main__":
    print(section())  # noqa: T201
