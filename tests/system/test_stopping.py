"""How a session ends its nodes: one that writes is waited for, one that hangs is not."""

import signal
import subprocess
import sys
import time

import pytest

from squeal_rig.session import processes

# Ignores SIGINT; grows a file for so long, then ends by itself.
WRITER = """
import signal, sys, time
signal.signal(signal.SIGINT, signal.SIG_IGN)
print("ready", flush=True)
end = time.monotonic() + float(sys.argv[2])
while time.monotonic() < end:
    with open(sys.argv[1], "ab") as file:
        file.write(b"x")
    time.sleep(0.1)
sys.stdin.read() if sys.argv[3:] else None
"""


class Writer(processes.NodeProcess):
    """A process that is no node: started with a script of ours."""

    def __init__(self, name, *arguments):
        self.name = name
        self._process = subprocess.Popen(
            [sys.executable, "-c", WRITER, *map(str, arguments)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            start_new_session=True,
        )
        assert self._process.stdout.readline() == b"ready\n"


@pytest.mark.slow
def test_a_node_that_still_writes_is_waited_for_and_one_that_hangs_is_killed(tmp_path, monkeypatch):
    monkeypatch.setattr(processes, "_STOP_TIMEOUT", 6.0)
    busy = Writer("recorder", tmp_path / "bag", 15.0)
    assert processes.stop_all([busy], tmp_path) == {"recorder": 0}
    hanging, begun = Writer("recorder", tmp_path / "bag", 0.3, "hang"), time.monotonic()
    assert processes.stop_all([hanging], tmp_path) == {"recorder": -signal.SIGKILL}
    assert time.monotonic() - begun >= 6.0
