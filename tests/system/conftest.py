"""The command line, as a process on a private ROS domain or in this one."""

import sys

import pytest

from squeal_rig.cli import main


@pytest.fixture(scope="module")
def command_line(processes):
    """Runs `squeal-rig ARGUMENTS` to its end; returns (exit code, stdout, stderr)."""

    def run(*arguments, cwd=None, timeout=60.0):
        child = processes.command(*arguments, cwd=cwd)
        return child.wait(timeout), child.output, child.errors

    return run


@pytest.fixture
def in_process(monkeypatch, capsys):
    """Runs the command line in this process, which saves a second a time; as `command_line` otherwise."""

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["squeal-rig", *map(str, arguments)])
        try:
            code = main()
        except SystemExit as end:
            code = end.code
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return run
