"""Estimators that were stopped for seconds, all at once: they say what they lost, and are well again by themselves."""

import signal

import pytest

from tests.graph.statuses import health_of

pytest.importorskip("rclpy")

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
        observer.wait_for(lambda name=name: well(name), f"{name} well", 60.0)
    for _ in range(3):
        for node in nodes.values():
            node.send(signal.SIGSTOP)
        observer.spin(4.0)
        health.clear()
        for node in nodes.values():
            node.send(signal.SIGCONT)
        for name in CONSUMERS:
            observer.wait_for(lambda name=name: well(name), f"{name} well again", 20.0)
    # Four seconds are more than the queues hold: three times some were lost, and told.
    for name in CONSUMERS:
        assert int(health_of(health, name)[2]["lost samples"]) > 0, name
    assert [node.end()[0] for node in nodes.values()] == [0, 0, 0]
