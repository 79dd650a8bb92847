"""Starts a node by its name, `start.py [--session] NAME [ARGUMENT ...]`; with `--session` it ends when stdin does.

Run as a file: `python -m` would put the current folder on the import path, and what lies there before what is
installed; `-P` is not known before Python 3.11.
"""

from __future__ import annotations

import os
import sys

#: What is started in this way too, by the nodes `stability`, `rig` and `page`.
BESIDE = ("hard_squeal", "watchdog", "operating_map")
NODES = (
    "foxglove",
    "friction_estimator",
    "page",
    "player",
    "recorder",
    "rig",
    "simulator",
    "squeal_detector",
    "stability",
    "supervisor",
    "view",
)


def start(name: str, session: bool = False) -> int:
    """Run a node on the arguments of this process; returns its exit code."""
    # Here and not above: as a file we first have to put the import path right.
    from importlib import import_module

    from squeal_rig.configuration.new_files import close_to_strangers
    from squeal_rig.graph import signals

    signals.watch()
    close_to_strangers()
    if session:
        signals.end_with_stdin()
    code: int = import_module(f"squeal_rig.nodes.{name}").main()
    return code


def main() -> int:
    """Run the node that the arguments name."""
    session = sys.argv[1:2] == ["--session"]
    sys.argv = sys.argv[2 if session else 1 :]
    if not sys.argv or sys.argv[0] not in (*NODES, *BESIDE):
        sys.stderr.write(f"start.py: give one of {', '.join(NODES)}\n")
        return 2
    return start(sys.argv[0], session)


if __name__ == "__main__":
    here = os.path.dirname(os.path.realpath(__file__))
    # Not the folder of this file; the package's own, in a clone that is not installed, after all others.
    sys.path = [path for path in sys.path if os.path.realpath(path) != here]
    sys.path.append(os.path.dirname(os.path.dirname(here)))
    sys.exit(main())
