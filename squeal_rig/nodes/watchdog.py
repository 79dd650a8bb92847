"""No node: the process beside a rig that stops it where its own process cannot."""

from __future__ import annotations

import signal

from squeal_rig.safety.watching import watch


def main() -> int:
    """Watch the rig that has started us until it ends; returns the exit code."""
    # Ctrl-C is for the rig, which then says good-bye: who ends before it would leave it unwatched.
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    return watch()
