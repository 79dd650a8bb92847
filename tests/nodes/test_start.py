"""How nodes start: on which import path, what they say, and what signals do to them meanwhile."""

import signal
import time

import pytest

from squeal_rig.nodes.start import NODES
from squeal_rig.session.processes import node_command
from tests.graph.processes import parameters
from tests.graph.statuses import health_of
from tests.made_bag import write_squeal

pytest.importorskip("rclpy")

pytestmark = pytest.mark.slow

_PLANTED = "import pathlib\npathlib.Path({mark!r}).touch()\nraise RuntimeError('planted')\n"


def test_what_lies_in_the_current_folder_is_not_imported(compiled, processes, observer, tmp_path):
    # As in the parent folder of a clone: a folder of our name that is no package.
    (tmp_path / "squeal_rig").mkdir()
    mark = tmp_path / "executed"
    for name in ("numpy", "yaml", "rclpy", "std_msgs", "typing"):
        (tmp_path / f"{name}.py").write_text(_PLANTED.format(mark=str(mark)), encoding="utf-8")
    node = processes.node("stability", cwd=tmp_path)
    observer.wait_for(lambda: "stability" in observer.node.get_node_names() or not node.running, "the node")
    assert node.running, node.errors
    assert not mark.exists()
    assert node.end()[0] == 0


@pytest.mark.parametrize("name", NODES)
def test_a_node_says_one_line_once_it_runs(compiled, processes, observer, tmp_path, name):
    write_squeal(tmp_path / "bag")
    settings = {"player": parameters(bag=tmp_path / "bag", start_paused=True)}
    settings["recorder"] = parameters(directory=tmp_path / "new")
    node = processes.node(name, *settings.get(name, []))
    observer.wait_for(lambda: "Ctrl-C" in node.errors or not node.running, "its word")
    assert node.running, node.errors
    said = [line for line in node.errors.splitlines() if "[INFO]" in line]
    assert len(said) == 1, said
    assert f"ROS domain {processes.domain}" in said[0]
    assert node.end()[0] == 0


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_while_it_still_imports_ends_a_node_well(compiled, processes, number):
    for step in range(8):
        node = processes.node("simulator")
        time.sleep(0.08 * step)  # the moment of the signal itself, not a wait for something
        node.send(number)
        assert node.wait() == 0, (step, node.errors)
        assert "Traceback" not in node.errors


def test_a_node_ends_well_as_its_terminal_closes_and_goes_on_under_nohup(compiled, processes, observer):
    health = observer.follow("/diagnostics")
    command = node_command("simulator", [])
    for before, word in (((), "ended"), (("nohup",), "goes on")):
        node = processes.start([*before, *command])
        observer.wait_for(lambda node=node: "Ctrl-C" in node.errors or not node.running, "the node")
        node.send(signal.SIGHUP)
        if word == "ended":
            assert observer.wait_for_end(node) == 0
        else:
            health.clear()
            observer.wait_for(lambda: health_of(health, "rig"), "a health after it")
            assert node.end()[0] == 0
        assert "Traceback" not in node.errors


@pytest.mark.parametrize(("name", "number"), [("simulator", signal.SIGINT), ("friction_estimator", signal.SIGTERM)])
def test_a_second_signal_at_any_moment_of_the_end_does_no_harm(compiled, processes, observer, name, number):
    codes = []
    for step in range(12):
        node = processes.node(name, "-r", f"__node:=n{step}")
        observer.wait_for(lambda node=node: "Ctrl-C" in node.errors or not node.running, "the node")
        node.send(number)
        # Again and again until it is gone: one of them meets every moment.
        while node.running:
            time.sleep(0.002 + 0.001 * step)
            node.send(number)
        codes.append(node.wait())
    assert codes == [0] * 12
