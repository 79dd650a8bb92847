"""Commands on a private ROS domain, and one bag to look at."""

import sys

import pytest
from nodes.domains import private_domain
from nodes.processes import Processes

from squeal_rig.cli import main


@pytest.fixture(scope="module")
def processes(tmp_path_factory):
    """Starts commands and nodes on a domain of the module's own; all are gone at its end."""
    with private_domain() as domain:
        started = Processes(domain, tmp_path_factory.mktemp("logs"))
        yield started
        started.end_all()


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
