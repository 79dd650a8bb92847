"""A simulator as a process of its own, and a listener in ours that sees every block it publishes."""

from __future__ import annotations

import os
import re
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Float64
from std_srvs.srv import Trigger

from squeal_rig.graph import qos
from squeal_rig.graph.conversions import status_values
from squeal_rig.recording import samples_from_cdr
from squeal_rig.session.processes import NodeProcess, stop_all

NS = 10**9
BLOCK_NS = NS // 100
_TICK = os.sysconf("SC_CLK_TCK")
#: Longest wait for a node [s]: a first start compiles.
_PATIENCE = 300.0


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


class Listener:
    """Our node on the graph: takes blocks, windows and health, and talks to the rig."""

    def __init__(self) -> None:
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        self._node = Node("benchmark")
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._subscriptions: list[Any] = []
        self.blocks = Blocks()
        self.overruns = 0
        self.windows: list[tuple[float, int]] = []  # mu, end of the window [ns]
        self.means: list[tuple[float, int]] = []  # mu, when it came [ns]
        self._node.create_subscription(DiagnosticArray, "/diagnostics", self._on_health, qos.EVENTS)
        self._set = self._node.create_client(SetParametersAtomically, "rig/set_parameters_atomically")
        self._impact = self._node.create_client(Trigger, "rig/impact")

    def listen_to_blocks(self) -> None:
        """Take `daq/samples` of the next run."""
        self.forget()
        make = self._node.create_subscription
        self._subscriptions.append(make(PointCloud2, "daq/samples", self.blocks.take, qos.BLOCKS, raw=True))

    def listen_to_friction(self) -> None:
        """Take `friction/mu` and the windows that tell what time it belongs to."""
        self.forget()
        make = self._node.create_subscription
        self._subscriptions.append(make(PointCloud2, "friction/windows", self._on_window, qos.EVENTS, raw=True))
        self._subscriptions.append(make(Float64, "friction/mu", self._on_mu, qos.EVENTS))

    def forget(self) -> None:
        """End all of that, and start a new count."""
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
        self._subscriptions = []
        self.blocks, self.overruns = Blocks(), 0
        self.windows, self.means = [], []

    def spin(self, seconds: float, until: Callable[[], bool] = lambda: False) -> bool:
        """Take what comes for that long [s], or until a condition holds; whether it did."""
        deadline = time.monotonic() + seconds
        while not (done := until()) and (left := deadline - time.monotonic()) > 0.0:
            self._executor.spin_once(timeout_sec=min(left, 0.1))
        return done

    def wait(self, until: Callable[[], bool], what: str) -> None:
        """Spin until a condition holds, within bounds."""
        if not self.spin(_PATIENCE, until):
            raise TimeoutError(f"{what} did not come within {_PATIENCE:g} s")

    def squeal(self) -> None:
        """Take the rig to 300 N and 6e7 N/m, give the pad an impact, and wait until it vibrates."""
        values = {"preload": 300.0, "k1": 6e7, "k2": 6e7}
        wanted = [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
        self._answer(self._set, SetParametersAtomically.Request(parameters=wanted))
        self._answer(self._impact, Trigger.Request())
        self.wait(lambda: self.blocks.rms_x > 1e-6, "squeal")

    def close(self) -> None:
        """Leave the graph."""
        self._node.destroy_node()
        rclpy.try_shutdown()

    def _answer(self, client: Any, request: Any) -> None:
        self.wait(client.service_is_ready, f"service {client.srv_name}")
        future = client.call_async(request)
        self.wait(future.done, f"the answer of {client.srv_name}")

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


class RunningNode:
    """A node process with what /proc tells of it; a context manager that ends it."""

    def __init__(self, name: str, parameters: Sequence[str] = ()) -> None:
        self._logs = tempfile.TemporaryDirectory(prefix="squeal_rig_bench_")
        arguments = [part for parameter in parameters for part in ("-p", parameter)]
        self.started = time.time_ns()
        self.process = NodeProcess(name, Path(self._logs.name), arguments)

    def __enter__(self) -> RunningNode:
        return self

    def __exit__(self, *_error: object) -> None:
        stop_all([self.process])
        self._logs.cleanup()

    def cpu_seconds(self) -> float:
        """Processor time of all of its threads so far, user and system [s]."""
        fields = Path(f"/proc/{self.process.pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / _TICK

    def memory(self) -> float:
        """Resident memory now [MB]."""
        status = Path(f"/proc/{self.process.pid}/status").read_text(encoding="utf-8")
        found = re.search(r"VmRSS:\s+(\d+) kB", status)
        return int(found[1]) / 1024.0 if found else float("nan")
