"""No node: the process beside the node `stability`. A line of JSON in, parameters by name; one out, their status."""

from __future__ import annotations

import json
import os
import queue
import signal
import sys
import threading

from squeal_rig.errors import SquealRigError
from squeal_rig.estimation.hard_squeal import Status, hard_squeal, unavailable
from squeal_rig.model.parameters import RigParameters

# The node's callbacks come first.
_NICENESS = 10


def main() -> int:
    """Answer until standard input ends, and then end at once whatever is being computed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    os.nice(_NICENESS)
    questions: queue.SimpleQueue[str] = queue.SimpleQueue()

    def listen() -> None:
        for line in sys.stdin:
            questions.put(line)
        os._exit(0)

    threading.Thread(target=listen, daemon=True).start()
    while True:
        sys.stdout.write(json.dumps(_answered(questions.get())) + "\n")
        sys.stdout.flush()


def _answered(line: str) -> Status:
    try:
        return hard_squeal(RigParameters.from_mapping(json.loads(line)))
    except SquealRigError as error:
        return unavailable(str(error))
    except Exception as error:
        return unavailable(f"{type(error).__name__}: {error}")
