"""Nodes as child processes of the command line, in sessions of their own."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from squeal_rig.errors import ExperimentError

_STOP_TIMEOUT = 5.0


class NodeProcess:
    """One node, started as `python -m squeal_rig.nodes.<name>`; what it prints goes to a log file."""

    def __init__(self, name: str, log_directory: Path, ros_arguments: Sequence[str]) -> None:
        self.name = name
        self._log = log_directory / f"{name}.log"
        command = [sys.executable, "-m", f"squeal_rig.nodes.{name}", "--ros-args", *ros_arguments]
        with self._log.open("wb") as log:
            # A session of its own: Ctrl-C in the terminal reaches us alone, and we end the nodes in order.
            self._process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )

    @property
    def pid(self) -> int:
        """Number of the process."""
        return self._process.pid

    def check(self) -> None:
        """Raise `ExperimentError` with the node's own last words if it has ended."""
        code = self._process.poll()
        if code is not None:
            raise ExperimentError(f"node {self.name} ended with exit code {code}: {self.last_words()}")

    def last_words(self) -> str:
        """Last line the node printed."""
        lines = self._log.read_text(encoding="utf-8", errors="replace").split("\n")
        return next((line for line in reversed(lines) if line.strip()), "it printed nothing")

    def signal(self, number: signal.Signals) -> None:
        """Send a signal if the node still runs."""
        if self._process.poll() is None:
            os.kill(self._process.pid, number)

    def wait(self, timeout: float) -> int | None:
        """Exit code, or None when the node still runs after `timeout` [s]."""
        try:
            return self._process.wait(timeout)
        except subprocess.TimeoutExpired:
            return None


def stop_all(nodes: Sequence[NodeProcess]) -> dict[str, int]:
    """End nodes by SIGINT, all at once; one that does not follow is killed. Returns name -> exit code."""
    for node in nodes:
        node.signal(signal.SIGINT)
    deadline = time.monotonic() + _STOP_TIMEOUT
    codes = {}
    for node in nodes:
        code = node.wait(max(0.0, deadline - time.monotonic()))
        if code is None:
            node.signal(signal.SIGKILL)
            code = node.wait(_STOP_TIMEOUT)
        codes[node.name] = code if code is not None else -signal.SIGKILL
    return codes
