"""Nodes as child processes of the command line, in sessions of their own."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from squeal_rig.errors import ExperimentError
from squeal_rig.graph import signals

# A busy machine may take some seconds to end a node that is all right.
_STOP_TIMEOUT = 20.0
_LOOK = 0.1  # how often is looked whether a node has ended or still writes [s]
_START = Path(__file__).parents[1] / "nodes" / "start.py"


def node_command(name: str, ros_arguments: Sequence[object], session: bool = False) -> list[str]:
    """What starts a node; one of a session ends when its standard input does."""
    options = ["--session"] if session else []
    return [sys.executable, str(_START), *options, name, "--ros-args", *map(str, ros_arguments)]


@contextmanager
def signals_held() -> Iterator[None]:
    """Hold back what ends a process, here and in what is started meanwhile: a node takes them once it can."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, signals.ENDING)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


class NodeProcess:
    """One node, which ends with this process however that ends; what it prints goes to a log file."""

    def __init__(self, name: str, log_directory: Path, ros_arguments: Sequence[str]) -> None:
        self.name = name
        self._log = log_directory / f"{name}.log"
        with self._log.open("wb") as log, signals_held():
            # A session of its own: Ctrl-C in the terminal reaches us alone, and we end the nodes in order. Its stdin
            # ends when we do, by kill -9 or as the terminal closes: then the node ends too.
            self._process = subprocess.Popen(
                node_command(name, ros_arguments, session=True),
                stdin=subprocess.PIPE,
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


def stop_all(nodes: Sequence[NodeProcess], writing: Path | None = None) -> dict[str, int]:
    """End nodes by SIGINT, all at once; one that does not follow is killed. Returns name -> exit code.

    A node that still writes what it holds into the folder `writing` is waited for as long as the folder grows.
    """
    for node in nodes:
        node.signal(signal.SIGINT)
    deadline, size = time.monotonic() + _STOP_TIMEOUT, _size(writing)
    codes = {}
    for node in nodes:
        code = node.wait(_LOOK)
        while code is None and time.monotonic() < deadline:
            if _size(writing) != size:
                deadline, size = time.monotonic() + _STOP_TIMEOUT, _size(writing)
            code = node.wait(_LOOK)
        if code is None:
            node.signal(signal.SIGKILL)
            code = node.wait(_STOP_TIMEOUT)
        codes[node.name] = code if code is not None else -signal.SIGKILL
    return codes


def _size(folder: Path | None) -> int:
    """Bytes of the files in a folder; 0 where there is none."""
    size = 0
    for file in () if folder is None else folder.glob("*"):
        with suppress(FileNotFoundError):  # a draft that has just got its name
            size += file.stat().st_size
    return size
