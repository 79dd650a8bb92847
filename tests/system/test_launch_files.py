"""The launch files, where `ros2 launch` is installed: they end with what they are for."""

import os
import shutil
import signal
import sys
import time
from pathlib import Path

import pytest

from tests.graph import PATIENCE
from tests.graph.processes import Processes
from tests.made_bag import write_squeal

pytest.importorskip("rclpy")
pytest.importorskip("launch_ros")
pytest.importorskip("ros2launch")

_ROOT = Path(__file__).parents[2]
_ROS2 = "import sys; from ros2cli.cli import main; sys.exit(main())"


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """A prefix in which ROS finds the package as it stands here."""
    prefix = tmp_path_factory.mktemp("prefix")
    for folder in ("share/ament_index/resource_index/packages", "share/squeal_rig", "lib"):
        (prefix / folder).mkdir(parents=True)
    (prefix / "share/ament_index/resource_index/packages/squeal_rig").touch()
    shutil.copy(_ROOT / "package.xml", prefix / "share/squeal_rig")
    for name in ("config", "launch"):
        shutil.copytree(_ROOT / name, prefix / "share/squeal_rig" / name)
    shutil.copytree(_ROOT / "scripts", prefix / "lib/squeal_rig")
    return prefix


@pytest.fixture
def launch(domain, installed, tmp_path, monkeypatch):
    """Starts `ros2 launch squeal_rig FILE ARGUMENTS`; none outlives the test."""
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"{installed}{os.pathsep}{sys.prefix}")
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path / "ros"))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(sys.path))
    folder = tmp_path / "logs"
    folder.mkdir()
    processes = Processes(domain, folder)

    def start(*arguments):
        return processes.start([sys.executable, "-c", _ROS2, "launch", "squeal_rig", *arguments], cwd=tmp_path)

    yield start
    processes.end_all()


def _said(child):
    return child.output + child.errors


def _wait_for_word(child, word, count=1):
    deadline = time.monotonic() + PATIENCE
    while _said(child).count(word) < count:
        assert child.running, _said(child)
        assert time.monotonic() < deadline, f"{word!r} was not printed: {_said(child)}"
        time.sleep(0.05)


def test_a_replay_ends_when_the_bag_has_been_played(compiled, launch, tmp_path):
    write_squeal(tmp_path / "bag")
    child = launch("replay.launch.py", f"bag:={tmp_path / 'bag'}")
    assert child.wait() == 0, _said(child)
    assert "played 201 messages" in _said(child)
    assert _said(child).count("process has finished cleanly") == 4


def test_a_replay_that_cannot_be_ends_and_says_why(launch, tmp_path):
    child = launch("replay.launch.py", f"bag:={tmp_path / 'none'}")
    assert child.wait() == 1, _said(child)
    assert "There is no bag at" in _said(child)
    assert "ended with exit code 2" in _said(child)


def test_a_rig_that_died_ends_the_launch_with_a_failure(compiled, launch):
    child = launch("rig.launch.py")
    _wait_for_word(child, "Ctrl-C ends it", 5)
    line = next(line for line in _said(child).splitlines() if "[rig-" in line and "started with pid" in line)
    os.kill(int(line.rpartition("[")[2].rstrip("]")), signal.SIGKILL)
    assert child.wait() == 1, _said(child)
    assert "ended with exit code -9" in _said(child)


def test_ctrl_c_twice_ends_every_node_of_a_launch_well(compiled, launch):
    for pause in (0.0, 0.05, 0.2, 0.5):
        child = launch("rig.launch.py", "record:=true")
        _wait_for_word(child, "Ctrl-C ends it", 6)
        # As a terminal sends it: to launch and to every node.
        for wait in (pause, 0.0):
            os.killpg(child.process.pid, signal.SIGINT)
            time.sleep(wait)
        assert child.wait() == 0, _said(child)
        assert _said(child).count("process has finished cleanly") == 6, _said(child)
        assert "process has died" not in _said(child)
