"""What the package writes, nobody else can write, whatever umask it was started with."""

import os
from pathlib import Path

import pytest

REFERENCE = Path(__file__).parents[2] / "bags" / "reference"


@pytest.fixture
def careless():
    """A process that was started with a mask that closes nothing."""
    before = os.umask(0)
    yield
    os.umask(before)


def _open_to_all(folder):
    return [path for path in folder.rglob("*") if path.stat().st_mode & 0o002]


def test_files_and_folders_of_commands_are_closed_to_others(careless, in_process, tmp_path):
    code, _, errors = in_process("bag", "cut", REFERENCE, tmp_path / "deep" / "piece", "--end", "0.1")
    assert (code, errors) == (0, "")
    code, _, errors = in_process("bag", "export", REFERENCE, tmp_path / "out", "--to", "csv", "--topic", "/pad/state")
    assert code in (0, 2), errors
    assert len(list(tmp_path.rglob("*"))) >= 4
    assert _open_to_all(tmp_path) == []


def test_nodes_close_what_they_write_before_they_do_anything(careless, tmp_path):
    from squeal_rig.nodes import start

    with pytest.raises(ModuleNotFoundError):
        start.start("no_such_node")
    (tmp_path / "bag").mkdir(mode=0o777)
    assert _open_to_all(tmp_path) == []
