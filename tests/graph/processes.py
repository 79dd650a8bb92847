"""Nodes as child processes: what `ros2 run` would start, with what they print kept in a file."""

import os
import re
import signal
import subprocess
import sys
import time
from contextlib import nullcontext
from pathlib import Path

import yaml

import squeal_rig
from squeal_rig.configuration.files import config_directory
from squeal_rig.session.processes import node_command, signals_held

from . import PATIENCE

# The children run the very package the tests run, from whatever folder they are started in.
_PACKAGE_PARENT = str(Path(squeal_rig.__file__).parents[1])
_TICK = os.sysconf("SC_CLK_TCK")


class Child:
    """A child process in a session of its own, since a shell's background children ignore SIGINT."""

    def __init__(self, command, log, domain, cwd=None, held=False):
        self._logs = log.with_suffix(".out"), log.with_suffix(".err")
        environment = {
            **os.environ,
            "ROS_DOMAIN_ID": str(domain),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "PYTHONPATH": os.pathsep.join(filter(None, (_PACKAGE_PARENT, os.environ.get("PYTHONPATH")))),
            "PYTHONUNBUFFERED": "1",
            "COLUMNS": "160",
        }
        self.started = time.time_ns()
        hold = signals_held() if held else nullcontext()
        with self._logs[0].open("wb") as output, self._logs[1].open("wb") as errors, hold:
            self.process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=errors,
                start_new_session=True,
                env=environment,
                cwd=cwd,
            )

    @property
    def running(self):
        return self.process.poll() is None

    @property
    def output(self):
        """What it printed for people to read on."""
        return self._logs[0].read_text(encoding="utf-8", errors="replace")

    @property
    def errors(self):
        """What it printed to stderr: refusals, and the log of ROS."""
        return self._logs[1].read_text(encoding="utf-8", errors="replace")

    def cpu_seconds(self):
        """Processor time of all of its threads so far, user and system [s]."""
        fields = Path(f"/proc/{self.process.pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / _TICK

    def memory(self):
        """Resident memory now [MB]."""
        status = Path(f"/proc/{self.process.pid}/status").read_text(encoding="utf-8")
        return int(re.search(r"VmRSS:\s+(\d+) kB", status)[1]) / 1024.0

    def send(self, number):
        self.process.send_signal(number)  # to none that has ended: its number may be another's

    def wait(self, timeout=PATIENCE):
        """Exit code; `TimeoutExpired` after that many seconds."""
        return self.process.wait(timeout)

    def end(self, *numbers):
        """Send signals one right after the other; returns exit code and the time it took [s]."""
        begin = time.monotonic()
        for number in numbers or (signal.SIGINT,):
            self.send(number)
        return self.wait(), time.monotonic() - begin

    def kill(self):
        if self.running:
            self.send(signal.SIGKILL)
            self.wait()


class Processes:
    """Starts children on one domain and sees to it that none survives the tests."""

    def __init__(self, domain, folder):
        self.domain = domain
        self.folder = folder
        self._children = []

    def start(self, command, cwd=None, held=False):
        """Start a command; signals sent before it looks after them are kept for it where they are `held`."""
        log = self.folder / str(len(self._children))
        child = Child(list(map(str, command)), log, self.domain, cwd, held)
        self._children.append(child)
        return child

    def node(self, executable, *ros_arguments, cwd=None):
        """Start one node of the package; arguments as after `--ros-args`."""
        return self.start(node_command(executable, ros_arguments), cwd, held=True)

    def command(self, *arguments, cwd=None):
        """Start the command `squeal-rig`."""
        return self.start([sys.executable, "-m", "squeal_rig.cli", *arguments], cwd)

    def end_all(self):
        """Ask every child to end, then see to it."""
        for child in self._children:
            if child.running:
                child.send(signal.SIGINT)
        for child in self._children:
            try:
                child.wait(10.0)
            except subprocess.TimeoutExpired:
                child.kill()


#: Parameters of a supervisor, and of a rig, that do not take a busy machine's delays for a fault.
PATIENT = {
    "stale_warn": 60.0,
    "stale_stop": 60.0,
    "node_timeout": 600.0,
    "time_jump": 60.0,
    "disorder": 1000,
    "lost_share": 1.0,
}
PATIENT_RATE = 12_800
PATIENT_RIG = {"heartbeat_timeout": 60.0, "watchdog_timeout": 60.0}


def patient_config(folder):
    """Parameter file of the package, both of them patient, at a rate that a busy machine follows too."""
    values = yaml.safe_load((config_directory() / "rig.yaml").read_text(encoding="utf-8"))
    for node, more in (("rig", PATIENT_RIG | {"sample_rate": PATIENT_RATE}), ("supervisor", PATIENT)):
        values[f"/**/{node}"]["ros__parameters"] |= more
    file = folder / "patient.yaml"
    file.write_text(yaml.safe_dump(values), encoding="utf-8")
    return file


def has_ended(pid):
    """Whether a process has ended; one that nobody has waited for yet has, too."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()[0]
    except OSError:
        return True
    return state == "Z"


def parameters(**values):
    """`-p name:=value` for every value, as text; a list as one of texts."""
    return [word for name, value in values.items() for word in ("-p", f"{name}:={_text(value)}")]


def _text(value):
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(f"'{item}'" for item in value) + "]"
    return str(value).lower() if isinstance(value, bool) else str(value)
