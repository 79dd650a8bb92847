"""The other side of `Beside`: a process that answers a node's questions and lets everybody else go first."""

from __future__ import annotations

import json
import os
import queue
import signal
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from squeal_rig.graph.beside import READY

# The nodes' callbacks come first.
_NICENESS = 19


def answer_beside(answer: Callable[[str], Any]) -> int:
    """Answer line by line until standard input ends, and then end at once whatever is being computed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    os.nice(_NICENESS)
    with suppress(OSError):  # Linux schedules a session, which this process is, as one group: nice counts within it
        Path("/proc/self/autogroup").write_text(str(_NICENESS), encoding="ascii")
    questions: queue.SimpleQueue[str] = queue.SimpleQueue()

    def listen() -> None:
        for line in sys.stdin:
            questions.put(line)
        os._exit(0)

    threading.Thread(target=listen, daemon=True).start()
    sys.stdout.write(json.dumps(READY) + "\n")
    sys.stdout.flush()
    while True:
        sys.stdout.write(json.dumps(answer(questions.get())) + "\n")
        sys.stdout.flush()
