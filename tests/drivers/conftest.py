"""The twin of the hardware as a process of its own."""

import importlib.util
import os
import signal
import subprocess
import sys
import time

import pytest

# The twin loads, or compiles, the model before it says that it serves.
_COMPILING = 600.0
EXTRA = [name for name in ("opendaq", "pymodbus") if importlib.util.find_spec(name) is None]


class Served:
    """A server process that has said its line."""

    def __init__(self, module, log, *arguments, word):
        self._command = [sys.executable, "-m", module, *map(str, arguments)]
        self._log, self._word = log, word
        self.start()

    def start(self):
        """Start it, once it serves; returns its line."""
        with self._log.open("wb") as output:
            self.process = subprocess.Popen(
                self._command, stdout=output, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL, start_new_session=True
            )
        deadline = time.monotonic() + _COMPILING
        while self._word not in (text := self._log.read_text()):
            assert self.process.poll() is None, text
            assert time.monotonic() < deadline, "it does not serve"
            time.sleep(0.05)
        self.line = next(line for line in text.splitlines() if self._word in line)

    def kill(self):
        """End it without a word, as a pulled cable does."""
        if self.process.poll() is None:
            os.kill(self.process.pid, signal.SIGKILL)
            self.process.wait()


def needs_extra():
    """Skip, with the reason, where the extra `hardware` is not installed."""
    if EXTRA:
        pytest.skip(f"{' and '.join(EXTRA)} not installed: the extra 'hardware'")


def serve_twin(folder, *arguments):
    """A twin on ports of its own; `config` is the driver's file for it."""
    from squeal_rig.testing.daq_server import free_port

    config = folder / "twin.yaml"
    ports = ("--daq-port", free_port(), "--modbus-port", free_port())
    twin = Served(
        "squeal_rig.testing.twin", folder / "twin.log", *ports, "--write-config", config, *arguments, word="twin: "
    )
    twin.config = config
    # Machines of tests stand still for longer than a rig may: staleness has a test of its own.
    config.write_text(
        config.read_text() + "stale_after: 20.0\nqueue: 60.0\nclock_tolerance: 600.0\nsafe_timeout: 5.0\n"
    )
    return twin


@pytest.fixture(scope="module")
def twin(tmp_path_factory):
    """The twin, for a module."""
    needs_extra()
    served = serve_twin(tmp_path_factory.mktemp("twin"))
    yield served
    served.kill()
