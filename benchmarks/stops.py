"""Emergency stops at full load, from the request to the safe command accepted by the driver.

`make bench ARGS=stops` writes them to docs/benchmarks.md; `python -m benchmarks.stops --stops 20` prints a short run.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from std_msgs.msg import String

from squeal_rig.configuration.files import config_directory
from squeal_rig.graph import qos
from tests.faults.bench import install_driver
from tests.graph.domains import private_domain
from tests.graph.observer import Observer
from tests.graph.processes import Processes, parameters
from tests.graph.statuses import status_of

PATIENCE = 120.0
_MOVED_EVERY = 10
_POINT = {"preload": 300.0, "belt_speed": 1.0}  # where it squeals


class Load:
    """All nodes at 51.2 kHz with the recorder on, squealing, and ourselves to stop them."""

    def __init__(self, processes: Processes, observer: Observer, faults: Path, folder: Path) -> None:
        self.observer, self.faults, self.processes = observer, faults, processes
        self._files = ["--params-file", str(config_directory() / "rig.yaml")]
        for name in ("friction_estimator", "stability", "squeal_detector", "supervisor"):
            processes.node(name, *self._files)
        processes.node("recorder", *self._files, *parameters(directory=str(folder / "bag")))
        self.safe = observer.follow("rig/safe")
        self.blocks = observer.follow_samples("daq/samples", depth=4)
        self.asking = observer.node.create_publisher(String, "emergency_stop", qos.EVENTS)
        self.start_rig()
        self.move()

    def start_rig(self) -> None:
        """Start the rig, and wait until it samples."""
        self.blocks.clear()
        self.rig = self.processes.node("rig", *self._files, *parameters(driver="faulty", supervisor_required=True))
        self.observer.wait_for(lambda: len(self.blocks) > 2, "samples", PATIENCE)

    def stopped(self) -> dict[str, str]:
        """What `rig/safe` tells; empty where the rig is not stopped."""
        told = status_of(self.safe[-1], "rig safe") if self.safe else None
        return told[2] if told is not None and told[2]["stopped"] == "true" else {}

    def stop(self, reason: str) -> dict[str, str]:
        """Ask for a stop; what `rig/safe` tells of it, also where the rig is stopped for another reason already."""
        asked = time.time_ns()
        self.asking.publish(String(data=reason))
        return self.observer.wait_for(
            lambda: int(self.stopped().get("requested [ns]", "0")) >= asked and self.stopped(), reason
        )

    def move(self) -> None:
        """Let the rig go again, and squeal."""
        observer, told = self.observer, [""]

        def released() -> bool:
            observer.set({"reset_reason": "a measurement"}, node="supervisor")
            done, told[0] = observer.trigger("reset", rig="supervisor")
            return bool(done or told[0].startswith("nothing to reset"))

        try:
            observer.wait_for(released, "the supervisor's reset", PATIENCE)
        except AssertionError:
            raise AssertionError(f"the supervisor is not reset: {told[0]}") from None
        observer.wait_for(lambda: observer.trigger("reset")[0], "the rig's reset", PATIENCE)
        observer.set({**_POINT, "mu0": 0.26, "preload_slew_rate": 1e6, "belt_acceleration": 1e5}, atomically=True)


@contextmanager
def full_load() -> Iterator[Load]:
    """A load on a domain of its own, with a driver that can be held up."""
    with private_domain() as domain, tempfile.TemporaryDirectory(prefix="squeal_rig_") as name:
        folder = Path(name)
        for part in ("faults", "package", "logs"):
            (folder / part).mkdir()
        os.environ.update(install_driver(folder / "package", folder / "faults"))
        processes, observer = Processes(domain, folder / "logs"), Observer(domain)
        try:
            yield Load(processes, observer, folder / "faults", folder)
        finally:
            for path in (folder / "faults").iterdir():
                path.unlink()
            processes.end_all()
            observer.close()


def delays(load: Load, count: int, blocking: bool) -> list[float]:
    """Times [ms] from the request to the accepted command; `blocking`: while a callback of the rig does not return.

    A tenth of them are of a rig that moves, the others of one that is stopped already and commanded again.
    """
    found = []
    for number in range(count):
        if blocking:
            (load.faults / "hang").touch()
            time.sleep(0.03)
        told = load.stop(f"number {number}{' blocking' if blocking else ''}")
        found.append(1e-6 * (int(told["accepted [ns]"]) - int(told["requested [ns]"])))
        if blocking:
            (load.faults / "hang").unlink()
        if number % _MOVED_EVERY == 0:
            load.move()
        load.observer.spin(0.05 + 0.01 * (number % 7))  # at all places between two blocks
    return found


def outside(load: Load, count: int) -> list[float]:
    """Times [ms] from the moment that the driver holds the GIL to the driver made safe from outside."""
    found = []
    for _ in range(count):
        begun = time.time_ns()
        (load.faults / "hold").write_text("600")
        mark = load.faults / "done from outside"
        load.observer.wait_for(lambda mark=mark: mark.exists() and mark.read_text(), "the watchdog", PATIENCE)
        found.append(1e-6 * (int(mark.read_text().split()[0]) - begun))
        load.observer.wait_for(lambda: not load.rig.running, "the rig's end", PATIENCE)
        for path in load.faults.iterdir():
            path.unlink()
        load.start_rig()
        load.move()
    return found


def row(what: str, times: list[float]) -> str:
    """A line of the table."""
    p50, p99 = np.percentile(times, [50, 99])
    return f"| {what} | {len(times)} | {p50:.1f} | {p99:.1f} | {max(times):.1f} |"


def section(stops: int = 200, killed: int = 10) -> str:
    """The text of docs/benchmarks.md: so many stops of each kind, so many rigs killed from outside."""
    before = os.getloadavg()[0]
    with full_load() as load:
        rows = [
            row("request to accepted, rig running", delays(load, stops, False)),
            row("request to accepted, a callback of the rig blocks", delays(load, stops, True)),
            row("GIL held to made safe from outside", outside(load, killed)),
        ]
    after = os.getloadavg()[0]
    return f"""From the request (source time stamp of a message on `emergency_stop`) to the safe command accepted
by the driver, as `rig/safe` tells it: 51.2 kHz, squealing, all nodes and the recorder. One stop in ten is of a rig that
moves, the others repeat it. A callback that blocks releases the GIL; where a driver holds it, the watchdog acts
(`watchdog_timeout`, 1 s).
Load of the machine (1 min average) before and after: {before:.1f}, {after:.1f}.

| | times | p50 [ms] | p99 [ms] | worst [ms] |
|---|---|---|---|---|
{chr(10).join(rows)}
"""


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--stops", type=int, default=200)
    parser.add_argument("--outside", type=int, default=10)
    asked = parser.parse_args()
    sys.stdout.write(section(asked.stops, asked.outside))
    return 0


if __name__ == "__main__":
    sys.exit(main())
