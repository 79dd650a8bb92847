"""A session that ends without a chance to end its nodes, and one that is asked to end twice."""

import os
import signal
import time
from pathlib import Path

import pytest

from squeal_rig.recording import Bag
from tests.graph import PATIENCE
from tests.graph.processes import has_ended, patient_config

pytest.importorskip("rclpy")

pytestmark = pytest.mark.slow

NODES = {"simulator", "friction_estimator", "stability", "squeal_detector", "supervisor", "recorder"}


def _children(pid):
    """Node name -> process id of what a session has started."""
    found = {}
    for entry in Path("/proc").iterdir():
        try:
            parent = int((entry / "stat").read_text(encoding="utf-8").rpartition(")")[2].split()[1])
            words = (entry / "cmdline").read_bytes().decode().split("\0")
        except (OSError, ValueError, IndexError):
            continue
        if parent == pid:
            found |= {name: int(entry.name) for name in NODES & set(words)}
    return found


def _wait(condition, what):
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline, what
        time.sleep(0.05)


@pytest.fixture
def session(processes, tmp_path):
    """(child, nodes, bag) of a session that samples and records."""
    signal.signal(signal.SIGHUP, signal.SIG_DFL)  # under nohup children would ignore it
    child = processes.command("run", "--config", patient_config(tmp_path), "--bag", tmp_path / "bag", cwd=tmp_path)
    _wait(lambda: "F = 50 N" in child.output or not child.running, "a running session")
    assert child.running, child.errors
    nodes = _children(child.process.pid)
    assert set(nodes) == NODES
    yield child, nodes, tmp_path / "bag"
    for pid in nodes.values():
        if not has_ended(pid):
            os.kill(pid, signal.SIGKILL)


@pytest.mark.parametrize("number", [signal.SIGHUP, signal.SIGKILL])
def test_the_nodes_end_with_their_session_and_the_bag_is_closed(session, number):
    child, nodes, bag = session
    child.send(number)
    assert child.wait() == -number
    _wait(lambda: all(map(has_ended, nodes.values())), f"the end of {nodes}")
    assert Bag(bag).ending == "complete"


def test_a_second_signal_at_any_moment_of_the_end_does_no_harm_to_a_session(session):
    child, _, bag = session
    child.send(signal.SIGINT)
    while child.running:
        time.sleep(0.005)
        child.send(signal.SIGINT)
    assert child.wait() == 0, child.errors
    assert Bag(bag).ending == "complete"


def test_a_node_that_was_started_by_itself_lives_on_when_its_starter_ends(processes):
    starter = processes.start(["sh", "-c", 'nohup "$0" "$@" & echo $!; sleep 600', *_command("stability")])
    _wait(lambda: starter.output, "the node's number")
    node = int(starter.output)
    try:
        _wait(lambda: "Ctrl-C" in starter.errors + starter.output, "the running node")
        starter.kill()
        time.sleep(1.0)  # during which it must not end
        assert not has_ended(node)
        os.kill(node, signal.SIGTERM)
        _wait(lambda: has_ended(node), "its end")
    finally:
        if not has_ended(node):
            os.kill(node, signal.SIGKILL)


def _command(name):
    from squeal_rig.session.processes import node_command

    return node_command(name, [])
