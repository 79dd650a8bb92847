"""Estimators that were stopped for seconds, all at once: they say what they lost, and are well again by themselves."""

import signal
from contextlib import suppress
from pathlib import Path

import pytest

from tests.graph.statuses import health_of

pytest.importorskip("rclpy")

pytestmark = pytest.mark.slow
CONSUMERS = ("friction_estimator", "stability", "squeal_detector")
OK = 0


def test_consumers_that_were_frozen_tell_their_losses_and_recover(compiled, processes, observer, config_file):
    files = ["--params-file", str(config_file)]
    nodes = {name: processes.node(name, *files) for name in CONSUMERS}
    processes.node("simulator", *files)
    # Nobody but they takes samples: whoever joined would cure them.
    health = observer.follow("/diagnostics")

    def well(name):
        state = health_of(health, name)
        return state and state[0] == OK and int(state[2]["blocks"]) > 0 and state

    for name in CONSUMERS:
        observer.wait_for(lambda name=name: well(name), f"{name} well")
    for _ in range(6):
        for node in nodes.values():
            node.send(signal.SIGSTOP)
        observer.spin(3.0)
        health.clear()
        for node in nodes.values():
            node.send(signal.SIGCONT)
        for name in CONSUMERS:
            observer.wait_for(
                lambda name=name: well(name), lambda name=name: f"{name} well again, and not {health_of(health, name)}"
            )
    # Three seconds are more than the rig keeps for them: some were lost each time, and told by all that went on as they
    # were.
    for name in CONSUMERS:
        counts = health_of(health, name)[2]
        assert int(counts["lost samples"]) > 0 or int(counts["rejoins"]) > 0, (name, counts)
    assert [node.end()[0] for node in nodes.values()] == [0, 0, 0]
    processes.end_all()


def test_a_node_to_which_nothing_of_the_rig_comes_joins_the_graph_anew(compiled, processes, observer):
    node = processes.node("stability")
    health = observer.follow("/diagnostics")

    def told(key):
        state = health_of(health, "stability")
        return int(state[2][key]) if state else 0

    rig = processes.node("simulator")
    observer.wait_for(lambda: told("blocks"), "samples")
    assert observer.set({"hard_squeal": False}, "stability") == [(True, "")]
    # What Fast DDS does to a reader that was stopped, now and then: a rig that is new to it finds another file.
    ports = _ports_in_shared_memory(node.process.pid)
    assert ports
    for port in ports:
        Path(f"/dev/shm/fastrtps_port{port}").unlink()
    assert rig.end()[0] == 0
    rig = processes.node("simulator")
    observer.wait_for(lambda: told("rejoins"), "the node made anew")
    observer.wait_for(lambda: told("blocks") and health_of(health, "stability")[0] == OK, "samples, and all well")
    assert told("rejoins") == 1
    assert observer.get(["hard_squeal"], "stability") == {"hard_squeal": False}
    assert node.end()[0] == rig.end()[0] == 0


def _ports_in_shared_memory(pid):
    """Ports at which a process listens in Fast DDS's shared memory, by the names of its threads."""
    names = []
    for file in Path(f"/proc/{pid}/task").glob("*/comm"):
        with suppress(OSError):  # a thread that has just ended
            names.append(file.read_text().strip())
    ports = [name.removeprefix("dds.shm.") for name in names if name.startswith("dds.shm.")]
    return [port for port in ports if port.isdigit()]
