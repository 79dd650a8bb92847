"""Estimators that were stopped for seconds, all at once: they say what they lost, and are well again by themselves."""

import signal

import pytest

from tests.graph.statuses import health_of

pytest.importorskip("rclpy")

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

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
            observer.wait_for(lambda name=name: well(name), f"{name} well again")
    # Three seconds are more than the rig keeps for them: some were lost each time, and told.
    for name in CONSUMERS:
        assert int(health_of(health, name)[2]["lost samples"]) > 0, name
    assert [node.end()[0] for node in nodes.values()] == [0, 0, 0]
    processes.end_all()


def test_a_rig_whose_samples_do_not_arrive_publishes_them_anew(compiled, processes, observer):
    rig = processes.node("simulator")
    health, publisher = observer.follow("/diagnostics"), observer.publisher("/diagnostics")
    blocks = observer.follow_samples("daq/samples")
    observer.wait_for(lambda: blocks, "samples")

    def renewals():
        publisher.publish(DiagnosticArray(status=[told]))
        observer.spin(0.2)  # a flood of ours would drown what the rig says
        state = health_of(health, "rig")
        return state and int(state[2]["publishers made anew"])

    told = DiagnosticStatus(name="stability", values=[KeyValue(key="unserved [s]", value="7.5")])
    observer.wait_for(renewals, "publishers made anew")
    blocks.clear()
    observer.wait_for(lambda: len(blocks) > 10, "samples of the new publisher")
    assert rig.end()[0] == 0
