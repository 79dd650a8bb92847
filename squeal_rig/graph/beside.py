"""A process beside a node, for what takes longer than a callback may: one question at a time, the latest one wins."""

from __future__ import annotations

import json
import math
import subprocess
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, BinaryIO

#: An answer, and the longest line that is one.
Answer = Any
_LONGEST_LINE = 1 << 20
#: What the process says first, once it can be asked.
READY = "ready"


class Beside:
    """Asks another process, a line of JSON each way; its standard input ends with us, and so does it.

    The process says `READY` once it has started, which may take long on a busy machine. From then on, a question that
    takes longer than `patience` [s] is given up once there is a newer one, and after `limit` [s] in any case: its
    process is killed and the next question gets a new one. Where the process ends by itself it is asked once more.

    Args:
        command: starts the process.
        woken: called from another thread when `look` has something to do.
        patience, limit: [s].
    """

    def __init__(
        self, command: Sequence[str], woken: Callable[[], None], patience: float = 3.0, limit: float = 600.0
    ) -> None:
        self._command, self._woken = command, woken
        self._patience, self._limit = patience, limit
        self._lock = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._listener: threading.Thread | None = None
        self._wanted: Any = None
        self._asked: Any = None
        self._failed: Any = None
        self._since = math.inf  # while the process starts
        self._lines: list[tuple[subprocess.Popen[bytes], bytes]] = []
        self.ended = 0

    def ask(self, question: Any) -> None:
        """Ask something that JSON can hold; what was asked before and has no answer yet is not wanted any more."""
        self._wanted = question
        self.look()

    def look(self) -> tuple[Any, Answer | None, str] | None:
        """Go on; returns (question, answer, "") or (question, None, why there is none) once there is one, else None.

        To be called now and then, and when woken.
        """
        with self._lock:
            lines, self._lines = self._lines, []
        found = None
        for process, line in lines:
            if process is self._process:
                found = self._read(line) or found
        if self._asked is not None:
            spent = time.monotonic() - self._since
            if spent > self._limit:
                found = self._asked, None, f"it took longer than {self._limit:g} s"
                self._done()
                self._end()
            elif spent > self._patience and self._wanted not in (None, self._asked):
                self._end()
        if self._asked is None and self._wanted is not None:
            self._send()
        return found

    def close(self) -> None:
        """End the process; nothing is wanted any more."""
        self._wanted = None
        self._end()

    def _end(self) -> None:
        process, self._process, self._asked = self._process, None, None
        if process is not None:
            process.kill()
            process.wait()
            assert process.stdin is not None
            with suppress(OSError):  # a question that it has not read is for nobody
                process.stdin.close()
            if self._listener is not None:  # it wakes a node that may be gone afterwards
                self._listener.join(1.0)

    def _done(self) -> Any:
        """What was asked, which is not wanted any more."""
        asked, self._asked = self._asked, None
        if self._wanted == asked:
            self._wanted = None
        return asked

    def _read(self, line: bytes) -> tuple[Any, Answer | None, str] | None:
        try:
            answer = json.loads(line)
            if answer == READY:
                self._since = time.monotonic()
                return None
            return self._done(), answer, ""
        except ValueError:
            pass  # the end of its output, or no line of it: what comes below is for one that is gone
        process, asked = self._process, self._asked
        self._end()
        self.ended += 1
        if asked is None:
            return None
        if asked != self._failed:
            self._failed = asked
            self._wanted = self._wanted or asked
            return None
        self._asked = asked
        code = None if process is None else process.returncode
        return self._done(), None, f"the process that computes it ended with {code}"

    def _send(self) -> None:
        if self._process is None:
            # A session of its own: Ctrl-C in a terminal reaches the node, which ends it.
            self._process = subprocess.Popen(
                list(self._command), stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True
            )
            self._listener = threading.Thread(target=self._listen, args=(self._process,), name="beside", daemon=True)
            self._listener.start()
            self._since = math.inf
        else:
            self._since = time.monotonic()
        self._asked = self._wanted
        assert self._process.stdin is not None
        with suppress(OSError):  # it has ended: its last line will tell
            self._process.stdin.write(json.dumps(self._asked).encode() + b"\n")
            self._process.stdin.flush()

    def _listen(self, process: subprocess.Popen[bytes]) -> None:
        output: BinaryIO = process.stdout  # type: ignore[assignment]
        with output:
            line = b"first"
            while line:
                line = output.readline(_LONGEST_LINE)
                with self._lock:
                    self._lines.append((process, line))
                self._woken()
