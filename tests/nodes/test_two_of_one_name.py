"""A second rig of the same name does not start; a killed one does not keep its successor from it."""

import signal

import pytest

from tests.graph.processes import parameters

pytest.importorskip("rclpy")

pytestmark = pytest.mark.slow


def test_a_second_rig_of_one_name_is_refused_and_the_first_goes_on(compiled, processes, observer):
    first = processes.node("simulator")
    observer.first("daq/samples")
    for executable in ("simulator", "rig"):
        second = processes.node(executable)
        assert second.wait() == 2
        assert second.errors.startswith(f"rig: /rig runs on ROS domain {processes.domain} already: ")
        assert second.errors.count("\n") == 1
    assert first.running
    elsewhere = processes.node("simulator", "-r", "__ns:=/lab")
    assert observer.state("lab/rig") == "active"
    assert elsewhere.running
    assert observer.state() == "active"
    processes.end_all()


def test_a_session_does_not_start_beside_a_rig_and_leaves_it_as_it_was(compiled, processes, observer, tmp_path):
    first = processes.node("simulator")
    observer.first("daq/samples")
    session = processes.command("run", "--duration", "1", "--bag", tmp_path / "bag", cwd=tmp_path)
    assert session.wait() == 2
    assert f"a rig runs on ROS domain {processes.domain} already" in session.errors
    assert f"ROS_DOMAIN_ID {processes.domain}, ROS_AUTOMATIC_DISCOVERY_RANGE LOCALHOST" in session.output
    assert list(tmp_path.iterdir()) == []
    assert observer.state() == "active"
    assert first.end()[0] == 0


def test_a_rig_starts_where_one_of_its_name_was_killed(compiled, processes, observer):
    first = processes.node("simulator")
    observer.first("daq/samples")
    first.send(signal.SIGKILL)
    first.wait()
    second = processes.node("simulator", *parameters(preload=77.0))
    blocks = observer.follow_samples("daq/samples")
    observer.wait_for(lambda: blocks and blocks[-1].samples["preload"][-1] == 77.0, "samples of the second")
    assert second.end()[0] == 0


def test_a_session_keeps_to_this_machine_unless_told_otherwise(monkeypatch):
    from squeal_rig.session.run import keep_to_this_machine

    monkeypatch.setenv("ROS_DOMAIN_ID", "7")
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")
    assert keep_to_this_machine() == "ROS_DOMAIN_ID 7, ROS_AUTOMATIC_DISCOVERY_RANGE SUBNET"
    monkeypatch.delenv("ROS_DOMAIN_ID")
    monkeypatch.delenv("ROS_AUTOMATIC_DISCOVERY_RANGE")
    assert keep_to_this_machine() == "ROS_DOMAIN_ID 0, ROS_AUTOMATIC_DISCOVERY_RANGE LOCALHOST"
