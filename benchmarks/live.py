"""A simulator as a process of its own, and a listener in ours that sees every block it publishes."""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from std_msgs.msg import Float64

from squeal_rig.graph.conversions import status_number, status_values
from squeal_rig.recording import samples_from_cdr
from tests.graph.domains import private_domain
from tests.graph.observer import Observer
from tests.graph.processes import Child, Processes

NS = 10**9
BLOCK_NS = NS // 100
#: Longest wait for anything [s]: a first start compiles.
PATIENCE = 300.0


@dataclass
class Blocks:
    """What came of `daq/samples` in one run; times in ns since the epoch."""

    count: int = 0
    lost: int = 0
    first_due: int = 0
    first_received: int = 0
    latest: list[int] = field(default_factory=list)
    rms_x: float = 0.0
    _next: int | None = None

    def take(self, data: bytes) -> None:
        """One block as it came off the wire."""
        now = time.time_ns()
        stamp, _, daq = samples_from_cdr(data)
        seq, n = int(daq["seq"][0]), len(daq)
        if self._next is None:
            # The first block of all, also where it was published before we were matched.
            self.first_received, self.first_due = now, stamp - seq * BLOCK_NS // n + BLOCK_NS
        else:
            self.lost += ((seq - self._next) % 2**32) // n
        self._next = (seq + n) % 2**32
        self.latest.append(now - stamp - BLOCK_NS)
        self.count += 1
        if self.count % 100 == 0:
            self.rms_x = float(np.std(daq["x"]))


class Listener(Observer):
    """Our node on the graph: takes blocks, windows, summaries and health, talks to the rig, and starts nodes."""

    def __init__(self, processes: Processes) -> None:
        super().__init__(processes.domain)
        self.processes = processes
        self._subscriptions: list[Any] = []
        self.forget()
        self.listen("/diagnostics", self._on_health)

    def listen_to_blocks(self) -> None:
        """Take `daq/samples` of the next run."""
        self.forget()
        self._subscriptions.append(self.listen("daq/samples", self.blocks.take, raw=True))

    def listen_to_friction(self) -> None:
        """Take `friction/mu` and the windows that tell what time it belongs to."""
        self.forget()
        self._subscriptions.append(self.listen("friction/windows", self._on_window, raw=True))
        self._subscriptions.append(self.listen("friction/mu", self._on_mu))

    def listen_to_stability(self) -> None:
        """Take the preload of the set point out of `stability/summary`."""
        self.forget()
        self._subscriptions.append(self.listen("stability/summary", self._on_summary))

    def forget(self) -> None:
        """End all of that, and start a new count."""
        for subscription in self._subscriptions:
            self.node.destroy_subscription(subscription)
        self._subscriptions = []
        self.blocks, self.overruns = Blocks(), 0
        self.windows: list[tuple[float, int]] = []
        self.means: list[tuple[float, int]] = []
        self.summaries: list[tuple[float, float]] = []

    @contextmanager
    def running(self, name: str, settings: Sequence[str] = ()) -> Iterator[Child]:
        """A node as a process, ended with the block."""
        node = self.processes.node(name, *(part for setting in settings for part in ("-p", setting)))
        try:
            yield node
        finally:
            node.end()

    def squeal(self) -> None:
        """Take the rig to 300 N and 6e7 N/m, give the pad an impact, and wait until it vibrates."""
        self.set({"preload": 300.0, "k1": 6e7, "k2": 6e7}, atomically=True)
        self.trigger("impact")
        self.wait_for(lambda: self.blocks.rms_x > 1e-6, "squeal", PATIENCE)

    def _on_health(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == "rig":
                self.overruns = int(status_values(status)["overruns"])

    def _on_window(self, data: bytes) -> None:
        stamp, _, window = samples_from_cdr(data)
        length = float(window["t_end"][0] - window["t_start"][0])
        self.windows.append((float(window["mu"][0]), stamp + round(length * 1e9)))

    def _on_mu(self, message: Float64) -> None:
        self.means.append((message.data, time.time_ns()))

    def _on_summary(self, message: DiagnosticArray) -> None:
        self.summaries.append((status_number(message.status[0], "preload [N]"), time.monotonic()))


@contextmanager
def listening() -> Iterator[Listener]:
    """A listener on a domain of its own; every node that it started ends with the block."""
    with private_domain() as domain, tempfile.TemporaryDirectory(prefix="squeal_rig_bench_") as logs:
        listener = Listener(Processes(domain, Path(logs)))
        try:
            yield listener
        finally:
            listener.processes.end_all()
            listener.close()


@contextmanager
def environment(name: str, value: str) -> Iterator[None]:
    """A variable of the environment of the processes started meanwhile."""
    before = os.environ.get(name)
    os.environ[name] = value
    try:
        yield
    finally:
        if before is None:
            del os.environ[name]
        else:
            os.environ[name] = before
