"""What the command line makes of the samples that it sees."""

import numpy as np
import pytest

from squeal_rig.instruments.channels import DAQ_RECORD
from squeal_rig.recording import cdr_from_samples

pytest.importorskip("rclpy")

_ROWS, _RATE = 512, 51200


@pytest.fixture
def graph(domain, monkeypatch):
    from squeal_rig.session.live import LiveGraph

    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    node = LiveGraph(lambda: None)
    yield node
    node.close()


def _block(seq):
    daq = np.zeros(_ROWS, DAQ_RECORD)
    daq["t"] = np.arange(_ROWS) / _RATE
    daq["seq"] = np.arange(seq, seq + _ROWS) % 2**32
    return cdr_from_samples(daq, 10**18)


@pytest.mark.parametrize(
    ("numbers", "blocks"),
    [
        ((0, 1, 2), 3),
        ((5, 6, 9), 5),  # two were lost
        ((100, 101, 0, 1), 4),  # a rig started again
        ((2**23 - 1, 0, 1), 3),  # numbers wrap
        ((7, 7), 2),  # a replay begun again
    ],
)
def test_sampled_time_counts_lost_blocks_and_no_more(graph, numbers, blocks):
    for number in numbers:
        graph._on_daq(_block(number * _ROWS))
    assert graph.sampled_time() == pytest.approx(blocks * _ROWS / _RATE)


def _told(graph, node, **listeners):
    from squeal_rig.graph.conversions import OK, diagnostics, status
    from squeal_rig.graph.health import LISTENERS

    values = {LISTENERS + topic.replace("__", "/"): count for topic, count in listeners.items()}
    graph._on_health(diagnostics(0, status(OK, node, "running", values)))


def test_a_run_begins_once_every_publisher_counts_who_must_have_its_first_message(graph):
    wanted = {"daq/samples": 2, "friction/windows": 2}
    assert not graph.is_heard(wanted)
    _told(graph, "rig", daq__samples=2)
    assert not graph.is_heard(wanted)  # the recorder has not found the estimator yet
    _told(graph, "friction_estimator", friction__windows=1)
    assert not graph.is_heard(wanted)
    _told(graph, "friction_estimator", friction__windows=2)
    assert graph.is_heard(wanted)


def test_a_run_begins_once_the_recorder_knows_who_publishes_the_samples(graph):
    from squeal_rig.graph.conversions import OK, diagnostics, status
    from squeal_rig.graph.health import HEARD

    def told(heard):
        graph._on_health(diagnostics(0, status(OK, "recorder", "recording", {"bytes": 0, HEARD: heard})))

    wanted = ["daq/samples", "truth/samples"]
    assert not graph.is_recorded(wanted)
    told("")
    assert not graph.is_recorded(wanted)
    told("/daq/samples, /pad/state")
    assert not graph.is_recorded(wanted)
    told("/daq/samples, /pad/state, /truth/samples")
    assert graph.is_recorded(wanted)


def test_a_run_is_over_once_the_recorder_has_the_rigs_last_block(graph):
    from squeal_rig.graph.conversions import OK, diagnostics, status
    from squeal_rig.graph.health import LAST_PUBLISHED, LAST_TAKEN
    from squeal_rig.safety.supervisor import INACTIVE, RUNNING, STATE_KEY

    def told(node, values):
        graph._on_health(diagnostics(0, status(OK, node, "", values)))

    def handed_over():
        """Whether it is not waited any more; `present` is asked between two looks."""
        looks = iter((True, True, False))
        ended = []

        def present():
            ended.append(next(looks))
            return ended[-1]

        graph.hand_over(["daq/samples"], present)
        return ended[-1]

    last = {LAST_PUBLISHED + "daq/samples": 7}
    told("recorder", {LAST_TAKEN + "/daq/samples": 9})
    assert not handed_over()  # nothing of the rig yet
    graph._executor.spin_for = lambda _: told("rig", {STATE_KEY: RUNNING, **last})
    assert not handed_over()
    graph._executor.spin_for = lambda _: told("rig", {STATE_KEY: INACTIVE, **last})
    assert handed_over()
    told("recorder", {LAST_TAKEN + "/daq/samples": 6})
    assert not handed_over()
    told("recorder", {LAST_TAKEN + "/daq/samples": 7})
    assert handed_over()


def test_the_recorder_is_waited_for_on_what_it_records_of_the_estimator(tmp_path):
    from squeal_rig.session.run import SessionOptions, _wanted_listeners

    config = tmp_path / "rig.yaml"
    config.write_text("/**/recorder:\n  ros__parameters:\n    topics: ['daq/*', friction/windows]\n")
    bag = tmp_path / "bag"
    assert _wanted_listeners(SessionOptions(config), 6) == {"daq/samples": 6, "friction/windows": 1}
    recorded = _wanted_listeners(SessionOptions(config, bag), 6)
    assert recorded == {"daq/samples": 6, "friction/samples": 0, "friction/windows": 2, "friction/mu": 0}
    config.write_text("{}\n")
    assert _wanted_listeners(SessionOptions(config, bag), 6)["friction/samples"] == 1
