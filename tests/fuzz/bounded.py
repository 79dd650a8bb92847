"""Tries inputs in a child process of bounded memory, each step of it in bounded time."""

import ctypes
import importlib
import io
import multiprocessing
import os
import re
import resource
import sys
import tempfile
import traceback
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import typer

from squeal_rig.cli import app
from squeal_rig.errors import SquealRigError

_UsageError = typer.BadParameter.__bases__[0]

#: Longest time for one step of an input [s].
DEADLINE = 20.0
#: Memory that a child may take beyond what its libraries have reserved [bytes].
MEMORY = 1 << 30


class Notes:
    """What is found while a case is tried; `step` names what is tried, and is told to the parent before it begins."""

    def __init__(self, tell):
        self.found = []
        self._tell = tell

    def wrong(self, sentence):
        """A wrong thing was called sound."""
        self.found.append(f"called sound: {sentence}")

    def step(self, name, action, *arguments):
        """The action's value; None where it refuses with an error of ours. Any other error is a finding."""
        self._tell(name)
        told = io.StringIO()
        try:
            with redirect_stdout(told), redirect_stderr(told):
                value = action(*arguments)
        except SquealRigError:
            value = None
        except BaseException:
            self.found.append(f"exception in {name}\n{traceback.format_exc()}")
            value = None
        if "Traceback" in told.getvalue():
            self.found.append(f"printed by {name}\n{told.getvalue()}")
        return value


def command(*words):
    """Run the command line `squeal-rig` in this process; returns its exit code. What it refuses is an error of ours."""
    try:
        code = app(list(map(str, words)), standalone_mode=False)
    except _UsageError as error:
        raise SquealRigError(str(error)) from None
    return code or 0


class BoundedChild:
    """Examines cases of one class; a child that ended or took too long is told and replaced."""

    def __init__(self, kind, corpus):
        self._kind, self._corpus = kind, corpus
        self._child = self._connection = None

    def examine(self, case):
        """The findings of one case, each a text whose first line says what it is."""
        if self._child is None:
            self.start()
        self._connection.send(case)
        step, found = "the beginning", []
        while True:
            if not self._connection.poll(DEADLINE):
                self.close()
                return [*found, f"no end of {step} within {DEADLINE:g} s"]
            try:
                what, value = self._connection.recv()
            except (EOFError, ConnectionError):
                self._child.join()
                code = self._child.exitcode
                self.close()
                return [*found, f"the process ended with {code} in {step}"]
            if what == "done":
                return found + value
            step = value

    def close(self):
        """End the child; nothing is found in that."""
        if self._child is not None:
            self._child.kill()
            self._child.join()
            self._connection.close()
            self._child = None
        return []

    def start(self):
        """Start the child, and wait until it is ready."""
        context = multiprocessing.get_context("spawn")
        self._connection, other = context.Pipe()
        self._child = context.Process(target=_serve, args=(other, self._kind, str(self._corpus)), daemon=True)
        self._child.start()
        other.close()
        while self._connection.recv() != ("ready", None):
            pass


def _serve(connection, kind, corpus):
    os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"
    module = importlib.import_module(f"tests.fuzz.{kind}")
    die_with_parent()
    with tempfile.TemporaryDirectory(prefix="squeal_rig_fuzz_") as folder:
        os.chdir(folder)
        module.prepare(Path(corpus))
        status = Path("/proc/self/status").read_text(encoding="utf-8")
        limit = int(re.search(r"VmSize:\s+(\d+) kB", status)[1]) * 1024 + MEMORY
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
        connection.send(("ready", None))
        while True:
            try:
                case = connection.recv()
            except EOFError:
                return
            notes = Notes(lambda name: connection.send(("step", name)))
            module.examine(case, notes)
            connection.send(("done", notes.found))


def die_with_parent():
    """Have the kernel end this process when the runner is gone, however that went."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(1, 9)
