"""Signals that end a process, from before the first large import until after the last line of Python.

Nothing but the standard library is imported here: a node looks after its signals first, then imports for half a second.
"""

from __future__ import annotations

import os
import signal
import threading
from types import FrameType

#: SIGHUP comes as a terminal or connection closes: a rig that it killed would go on with its last set points.
ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

_asked = False


def watch() -> None:
    """Take note of them from now on, also of those that whoever started us has held back; nohup stays in force."""
    for number in ENDING:
        if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, _on_signal)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, ENDING)


def asked_to_end() -> bool:
    """Whether one of them has come."""
    return _asked


def ignore() -> None:
    """Ignore them until the process has ended.

    Python gives signals with a handler back to the system while it finalises, and the next one would kill; not so
    those that are ignored.
    """
    for number in ENDING:
        signal.signal(number, signal.SIG_IGN)


def end_with_stdin() -> None:
    """Ask ourselves to end once our standard input ends: with whoever holds its other end, however that one ended."""

    def wait() -> None:
        while os.read(0, 4096):
            pass  # nobody sends anything: it is the end that is waited for
        os.kill(os.getpid(), signal.SIGTERM)

    threading.Thread(target=wait, name="end_with_stdin", daemon=True).start()


def _on_signal(_number: int, _frame: FrameType | None) -> None:
    global _asked  # noqa: PLW0603
    _asked = True  # nothing more, so that a second signal during teardown does no harm
