"""What the command line makes of the samples that it sees."""

import numpy as np
import pytest

from squeal_rig.instruments.channels import DAQ_RECORD
from squeal_rig.instruments.description import RigDescription
from squeal_rig.model import RigParameters
from squeal_rig.recording import cdr_from_samples

pytest.importorskip("rclpy")

_ROWS, _RATE = 512, 51200


@pytest.fixture
def graph(domain, monkeypatch):
    from squeal_rig.session.live import LiveGraph

    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    node = LiveGraph(lambda: None)
    _describe(node, RigDescription(RigParameters(), sample_rate=_RATE).to_yaml())
    yield node
    node.close()


def _describe(graph, text):
    from std_msgs.msg import String

    graph._on_description(String(data=text))


def _block(number, place=None):
    """Block of that number, stamped as at a place in time: by its number where it has none."""
    daq = np.zeros(_ROWS, DAQ_RECORD)
    daq["t"] = np.arange(_ROWS) / _RATE
    daq["seq"] = np.arange(number * _ROWS, (number + 1) * _ROWS) % 2**32
    return cdr_from_samples(daq, 10**18 + (number if place is None else place) * _ROWS * 10**9 // _RATE)


@pytest.mark.parametrize(
    ("numbers", "blocks"),
    [
        (((0, 0), (1, 1), (2, 2)), 3),
        (((5, 0), (6, 1), (9, 4)), 5),  # two were lost
        (((100, 0), (101, 1), (0, 9), (1, 10)), 4),  # a rig started again
        (((2**23 - 1, 0), (0, 1), (1, 2)), 3),  # numbers wrap
        (((7, 0), (7, 0)), 2),  # a replay begun again
        (((7, 0), (2**22, 1), (8, 1)), 3),  # numbers that jump and are no time, as of another rig
    ],
)
def test_sampled_time_counts_lost_blocks_and_no_more(graph, numbers, blocks):
    for number, place in numbers:
        graph._on_daq(_block(number, place))
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
    config.write_text("/**/recorder:\n  ros__parameters:\n    topics: [friction/windows]\n")
    assert _wanted_listeners(SessionOptions(config, bag), 6)["daq/samples"] == 5  # all others


def test_time_stands_still_where_no_rate_is_known_and_nobody_else_can_change_it(graph):
    daq = np.zeros(_ROWS, DAQ_RECORD)
    daq["t"], daq["seq"] = np.arange(_ROWS) * 1000.0, np.arange(_ROWS)
    graph._on_daq(cdr_from_samples(daq, 10**18))
    assert graph.sampled_time() == pytest.approx(_ROWS / _RATE)


def test_a_description_that_is_none_leaves_the_one_before(graph):
    for text in ("x", "", "[1", "sample_rate: fast"):
        _describe(graph, text)
    assert graph.description.parameters == RigParameters()


def test_windows_are_kept_where_they_are_asked_for(graph):
    from squeal_rig.instruments.channels import FRICTION_WINDOW_RECORD

    window = cdr_from_samples(np.zeros(1, FRICTION_WINDOW_RECORD), 10**18)
    graph._on_window(window)
    assert graph.windows == []
    graph.keeps_windows = True
    graph._on_window(window)
    (found,) = graph.windows
    assert found.base.nbytes == FRICTION_WINDOW_RECORD.itemsize  # no view that keeps the message


def test_health_of_other_rigs_is_none_of_ours(graph):
    _told(graph, "b/rig", daq__samples=9)
    _told(graph, "b/friction_estimator", friction__windows=9)
    assert graph.state.listeners == {}
    assert graph.state.health == {}
    from squeal_rig.graph.conversions import OK, diagnostics, status
    from squeal_rig.graph.health import LISTENERS
    from squeal_rig.safety.supervisor import STATE_KEY

    graph._on_health(diagnostics(0, status(OK, "b/rig", "", {STATE_KEY: "inactive"})))
    assert graph.state.rig_state == ""
    graph._on_health(diagnostics(0, status(OK, "rig", "", {LISTENERS + "daq/samples": "none", STATE_KEY: "active"})))
    assert (graph.state.listeners, graph.state.rig_state) == ({"daq/samples": 0}, "active")
    for k in range(3000):
        _told(graph, f"x{k}", **{f"t{k}": 1})
    _told(graph, "x", **{f"u{k}": 1 for k in range(3000)})
    assert len(graph.state.health) <= 1000
    assert len(graph.state.listeners) <= 1000
    _told(graph, "rig", daq__samples=7)
    assert graph.state.listeners["daq/samples"] == 7
