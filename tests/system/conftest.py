"""The command line in this process."""

import pytest

from tests.command_line import in_this_process


@pytest.fixture
def in_process():
    """Runs `squeal-rig ARGUMENTS`; returns (exit code, stdout, stderr)."""
    return in_this_process
