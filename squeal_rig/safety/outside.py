"""The process beside the rig that stops it where the rig itself cannot: from within the rig."""

from __future__ import annotations

import json
import os
import subprocess
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any

# What is written after the first line, one byte each: still here; a rig is driven from now on; it no longer is.
ALIVE, ARMED, DISARMED = b".", b"A", b"D"
#: What the process answers, once: it is ready; it could not load the driver.
LOADED, NOT_LOADED = b"L", b"N"
#: Classmethod of a driver, with the rig's settings: command no preload and a belt at rest from any process.
FROM_OUTSIDE = "make_safe_from_outside"
_LAST_WAIT = 2.0
_RESTART_EVERY = 5.0


class Outside:
    """Starts the process and tells it, again and again, that we are still here.

    It acts where we are silent for longer than `limit` [s] while a rig is driven, or end without saying so: it kills
    us and calls `make_safe_from_outside` of the driver, if it has one.

    Args:
        command: starts the process; `watch` of `squeal_rig.safety.watching` is what it runs.
        driver: name of the driver, empty where it cannot be made safe from outside.
        settings: the rig's, by name.
    """

    def __init__(self, command: Sequence[str], driver: str, settings: Mapping[str, Any], limit: float) -> None:
        self._command = list(command)
        first = {"rig": os.getpid(), "driver": driver, "settings": dict(settings), "limit": limit}
        self._first = json.dumps(first).encode() + b"\n"
        self._armed, self._answer = False, b""
        self.restarts = 0
        self._started = 0.0
        self._process = self._start()

    @property
    def running(self) -> bool:
        """Whether the process is there."""
        return self._process.poll() is None

    @property
    def ready(self) -> bool:
        """Whether the process has said that it has loaded the driver: before it, a rig had better not move."""
        self._hear()
        return self._answer == LOADED

    @property
    def failed(self) -> bool:
        """Whether the process has said that it could not load the driver."""
        self._hear()
        return self._answer == NOT_LOADED

    def _hear(self) -> None:
        if not self._answer and self._process.stdout is not None:
            with suppress(OSError, ValueError):
                self._answer = os.read(self._process.stdout.fileno(), 1)

    def beat(self) -> None:
        """Say that we are here; a process that has ended is started anew, now and then."""
        if not self.running and time.monotonic() - self._started > _RESTART_EVERY:
            self._end()
            self.restarts += 1
            self._started = time.monotonic()  # a machine that cannot start it now is asked again later
            with suppress(OSError):
                self._process = self._start()
                self._answer = b""
                self.arm(self._armed)
        self._say(ALIVE)

    def arm(self, armed: bool) -> None:
        """Say whether a rig is driven."""
        self._armed = armed
        self._say(ARMED if armed else DISARMED)

    def close(self) -> None:
        """Say good-bye, and wait for the end of the process."""
        self.arm(False)
        self._end()

    def _start(self) -> subprocess.Popen[bytes]:
        # A session of its own: Ctrl-C in a terminal is for us.
        process = subprocess.Popen(self._command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True)
        assert process.stdin is not None
        assert process.stdout is not None
        os.set_blocking(process.stdout.fileno(), False)
        with suppress(OSError):
            os.write(process.stdin.fileno(), self._first)
        os.set_blocking(process.stdin.fileno(), False)
        self._started = time.monotonic()
        return process

    def _say(self, word: bytes) -> None:
        assert self._process.stdin is not None
        # It has ended, which `running` tells; or it does not read, and then it is the one that hangs.
        with suppress(OSError, ValueError):
            os.write(self._process.stdin.fileno(), word)

    def _end(self) -> None:
        assert self._process.stdin is not None
        with suppress(OSError):
            self._process.stdin.close()
        if self._process.stdout is not None:
            self._process.stdout.close()
        try:
            self._process.wait(_LAST_WAIT)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
