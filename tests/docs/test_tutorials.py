"""Every tutorial from start to end, as it is printed: what it says is shown is shown."""

import os
import re
import signal
import subprocess
import sys
from contextlib import suppress

import pytest

from .pages import ROOT, TUTORIALS, blocks

pytestmark = pytest.mark.docs
_PATIENCE = 580.0
_NEEDS = {"mock_up_to_rig": ("opendaq", "pymodbus")}  # wheels that not every Python has
_COMMANDS = {
    "squeal-rig": '-m squeal_rig.cli "$@"',
    "python": '"$@"',
    "pytest": '-m pytest "$@"',
    # What a tutorial installs goes beside it, with the tools that are here.
    "pip": '-m pip -q "$@" --no-build-isolation --no-deps --upgrade --target "$INSTALLED"',
}


class Terminal:
    """A user's shell with the package's environment active, in a ROS domain of the test's own."""

    def __init__(self, home, domain):
        commands, installed, self._folder = home / "commands", home / "installed", home / "work"
        commands.mkdir()
        self._folder.mkdir()
        for name, line in _COMMANDS.items():
            script = commands / name
            script.write_text(f"#!/bin/sh\nexec {sys.executable} {line}\n", encoding="utf-8")
            script.chmod(0o755)
        self._environment = {
            **os.environ,
            "PATH": f"{commands}{os.pathsep}{os.environ['PATH']}",
            "PYTHONPATH": f"{installed}{os.pathsep}{ROOT}",
            "INSTALLED": str(installed),
            "ROS_DOMAIN_ID": str(domain),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "COLUMNS": "160",
        }
        self._groups = []

    def save(self, name, text):
        (self._folder / name).write_text(text + "\n", encoding="utf-8")

    def run(self, command, where):
        """What a command prints; it ends with 0."""
        process = subprocess.Popen(
            command,
            env=self._environment,
            cwd=self._folder,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,  # in the order in which a terminal shows them
            text=True,
            start_new_session=True,
        )
        self._groups.append(process.pid)
        output, _ = process.communicate(timeout=_PATIENCE)
        assert process.returncode == 0, f"{where}: {output[-4000:]}"
        return output

    def close(self):
        """End what still runs in the background."""
        for group in self._groups:
            with suppress(ProcessLookupError):
                os.killpg(group, signal.SIGKILL)


@pytest.fixture
def terminal(domain, tmp_path):
    opened = Terminal(tmp_path, domain)
    yield opened
    opened.close()


@pytest.mark.parametrize("page", TUTORIALS, ids=lambda page: page.stem)
def test_a_tutorial_works_as_it_is_printed(page, terminal, compiled):
    for module in _NEEDS.get(page.stem, ()):
        pytest.importorskip(module)
    session, output = "", ""
    for block in blocks(page):
        where = f"{page.name}:{block.line}"
        if named := re.match(r"# (\w+\.(?:py|yaml))\n", block.text):
            terminal.save(named[1], block.text)
        elif block.language == "bash":
            output = terminal.run(["bash", "-e", "-c", block.text], where)
        elif block.language == "python":
            # What was printed before is printed again, and taken away.
            before = terminal.run([sys.executable, "-c", session], where) if session else ""
            session += f"\n{block.text}\n"
            output = terminal.run([sys.executable, "-c", session], where).removeprefix(before)
        elif block.language == "text":
            _assert_shown(block.text, output, where)


def _assert_shown(expected, output, where):
    """Every line stands in the output, one after the other; dots stand for anything."""
    # The display is redrawn, and long lines are broken.
    rest = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", output)
    for line in filter(None, map(str.strip, expected.splitlines())):
        pattern = ".*".join(re.escape(part) for part in line.split("..."))
        found = re.search(pattern, rest)
        assert found, f"{where}: {line!r} is not shown in {rest[-3000:]!r}"
        rest = rest[found.end() :]
