"""What runs in the process beside the rig: waits for its silence, then kills it and has the driver made safe."""

from __future__ import annotations

import json
import os
import select
import signal
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Any

from squeal_rig.safety.awake import AwakeTime
from squeal_rig.safety.outside import ARMED, DISARMED, FROM_OUTSIDE, LOADED, NOT_LOADED

_LOOK = 0.02
# A unit that does not accept the safe command is asked again, for so long [s]; later a rig may have been started anew.
_TRIES_FOR, _TRIES_EVERY = 10.0, 0.5
_WAIT_FOR_READER = 1.0


def watch() -> int:
    """Watch the process that has started us, by what it writes to our standard input; returns the exit code."""
    line = _first_line()
    if not line:
        return 0
    given = json.loads(line)
    rig: int | None = None
    try:
        rig = os.pidfd_open(given["rig"])  # a number of a process may be given to another one later
    except ProcessLookupError:
        pass  # it has ended already
    except OSError as error:
        _write(f"the watchdog cannot watch the rig's process: {described_error(error)}")
        return 1
    if os.getppid() != given["rig"]:  # it has ended already: its number may be another's by now
        rig = None
    make_safe = _Loading(given["driver"], given["settings"])
    clock, armed, heard = AwakeTime(time.monotonic(), 5.0 * _LOOK), False, 0.0
    while True:
        readable, _, _ = select.select([0], [], [], _LOOK)
        now = clock.look(time.monotonic())
        if readable:
            words = os.read(0, 4096)
            if not words:
                if armed:
                    _act("the rig's process has ended while it drove the rig", rig, make_safe)
                return 0
            heard = now
            for word in (ARMED, DISARMED):
                if word in words:
                    last = max((ARMED, DISARMED), key=words.rfind)
                    armed = last == ARMED
        elif armed and now - heard > given["limit"]:
            told = f"the rig's process has been silent for {now - heard:.1f} s, {given['limit']:g} s is the limit"
            _act(told, rig, make_safe)
            return 1


def _first_line() -> bytes:
    line = b""
    while not line.endswith(b"\n"):
        byte = os.read(0, 1)
        if not byte:
            return b""
        line += byte
    return line


class _Loading:
    """The driver's own way, loaded now, since there is no time for it later; and beside, since we watch meanwhile."""

    def __init__(self, driver: str, values: dict[str, Any]) -> None:
        self._call: Callable[[], None] | None = None
        self._error: Exception | None = None
        self._thread = threading.Thread(target=self._load, args=(driver, values), daemon=True)
        self.known = bool(driver)
        self._thread.start()

    def _load(self, driver: str, values: dict[str, Any]) -> None:
        if driver:
            self._import(driver, values)
        if self._error is not None:
            _write(f"the watchdog cannot load the driver {driver!r}: {described_error(self._error)}")
        with suppress(OSError):
            os.write(1, LOADED if self._error is None else NOT_LOADED)

    def _import(self, driver: str, values: dict[str, Any]) -> None:
        try:
            from squeal_rig.instruments.driver import driver_class
            from squeal_rig.instruments.settings import RigSettings

            settings, kind = RigSettings.from_mapping(values), driver_class(driver)
            self._call = partial(getattr(kind, FROM_OUTSIDE), settings)
        except Exception as error:
            self._error = error

    def __call__(self) -> None:
        self._thread.join()
        if self._error is not None:
            raise self._error
        if self._call is not None:
            self._call()


def _act(told: str, rig: int | None, make_safe: _Loading) -> None:
    """Kill first: a process that is still there would command its set points again."""
    if rig is not None:
        with suppress(OSError):
            signal.pidfd_send_signal(rig, signal.SIGKILL)
    done = "its driver cannot be made safe from outside"
    if make_safe.known:
        done = _made_safe(make_safe, told)
    _tell(told, done)


def _made_safe(make_safe: _Loading, told: str) -> str:
    """Ask the driver until it accepts, or for long enough; the first refusal is told at once, the end returned."""
    begun, refused = time.monotonic(), False
    while True:
        try:
            make_safe()
            return f"the driver has accepted the safe command after {time.monotonic() - begun:.3f} s"
        except Exception as error:
            sentence = f"the driver did NOT accept the safe command: {described_error(error)}"
        if time.monotonic() - begun > _TRIES_FOR:
            return sentence
        if not refused:
            _tell(told, f"{sentence}; it is asked again")
            refused = True
        time.sleep(_TRIES_EVERY)


def _tell(told: str, done: str) -> None:
    _write(f"emergency stop from outside: {told}; {done}")


def _write(sentence: str) -> None:
    """Write to standard error, whose reader may have gone or stand still: neither may keep the rig from its stop."""

    def write() -> None:
        with suppress(OSError):
            os.write(2, f"{sentence}\n".encode(errors="backslashreplace"))

    thread = threading.Thread(target=write, daemon=True)
    thread.start()
    thread.join(_WAIT_FOR_READER)


def described_error(error: Exception) -> str:
    """An error in one line, with its kind."""
    return f"{type(error).__name__}: {' '.join(str(error).split())}"
