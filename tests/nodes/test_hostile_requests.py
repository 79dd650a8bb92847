"""Requests and messages that rclpy itself cannot take: every node answers or refuses them, says so, and works on."""

from pathlib import Path

import pytest

from tests.graph.processes import PATIENT, PATIENT_RATE, parameters
from tests.graph.statuses import health_of, healths_of

pytest.importorskip("rclpy")

from rcl_interfaces.msg import Parameter, ParameterEvent, ParameterValue
from rcl_interfaces.srv import GetParameterTypes, SetParameters, SetParametersAtomically
from rosgraph_msgs.msg import Clock

pytestmark = pytest.mark.slow  # every node at once

REFERENCE = Path(__file__).parents[2] / "bags" / "reference"
NODES = ("rig", "friction_estimator", "stability", "squeal_detector", "supervisor", "recorder", "player")
NO_SUCH_TYPE = [Parameter(name="preload", value=ParameterValue(type=200))]
WARN, ERROR = 1, 2


@pytest.fixture(scope="module")
def nodes(compiled, processes, observer, tmp_path_factory, config_file):
    """Every node there is, all of them on a clock that the test may set."""
    clock = ["--params-file", str(config_file), *parameters(use_sim_time="true")]
    bag = tmp_path_factory.mktemp("hostile") / "run"
    # A supervisor that is not patient stops a rig that a busy machine holds up, and its health is that error alone.
    more = {"supervisor": parameters(**PATIENT)}
    started = {name: processes.node(name, *clock, *more.get(name, ())) for name in NODES[1:5]}
    started["recorder"] = processes.node("recorder", *clock, *parameters(directory=bag))
    started["player"] = processes.node(
        "player", *clock, *parameters(bag=REFERENCE, start_paused="true", wait_for_subscribers=0.0)
    )
    started["rig"] = processes.node(
        "simulator", "--params-file", str(config_file), *parameters(sample_rate=PATIENT_RATE)
    )
    health = observer.follow("/diagnostics")
    observer.wait_for(lambda: all(health_of(health, name) for name in NODES), "the health of every node")
    return started, health


def told(observer, nodes, name, key, level, again=lambda: None):
    """Wait until a node's health counts something and is at that level; it has not ended by then."""
    started, health = nodes

    def seen():
        again()
        assert started[name].running, started[name].errors
        return next((state for state in healths_of(health, name) if state[0] == level and int(state[2][key]) > 0), None)

    return observer.wait_for(seen, f"{key} of {name} at level {level}")


@pytest.mark.parametrize("name", NODES)
def test_a_parameter_of_a_type_that_is_not_is_refused_in_the_answer(observer, nodes, name):
    answer = observer.call(SetParameters, f"{name}/set_parameters", SetParameters.Request(parameters=NO_SUCH_TYPE))
    assert [(result.successful, "200" in result.reason) for result in answer.results] == [(False, True)]
    kind = SetParametersAtomically
    answer = observer.call(kind, f"{name}/set_parameters_atomically", kind.Request(parameters=NO_SUCH_TYPE))
    assert not answer.result.successful
    told(observer, nodes, name, "refused requests", WARN)


@pytest.mark.parametrize("name", NODES)
def test_the_type_of_a_parameter_nobody_declared_is_asked_for_in_vain(observer, nodes, name):
    answer = observer.call(
        GetParameterTypes, f"{name}/get_parameter_types", GetParameterTypes.Request(names=["nobody"])
    )
    assert list(answer.types) in ([], [0])


def test_events_of_parameters_of_no_type_are_passed_over(observer, nodes):
    publisher = observer.node.create_publisher(ParameterEvent, "/parameter_events", 10)
    listeners = 4  # stability and supervisor follow them, the recorder does and records them
    observer.wait_for(lambda: publisher.get_subscription_count() >= listeners, "listeners to /parameter_events")
    publisher.publish(ParameterEvent(node="/rig", changed_parameters=NO_SUCH_TYPE))
    told(observer, nodes, "stability", "errors", ERROR)
    told(observer, nodes, "recorder", "errors", ERROR)


def test_a_clock_that_runs_below_zero_ends_nobody(observer, nodes):
    started, _ = nodes
    publisher = observer.node.create_publisher(Clock, "/clock", 10)
    observer.wait_for(lambda: publisher.get_subscription_count() >= 5, "listeners to /clock")
    clock = Clock()
    clock.clock.sec = -5
    for name in NODES[1:]:
        told(observer, nodes, name, "errors", ERROR, again=lambda: publisher.publish(clock))  # it is best effort
    assert all(node.running for node in started.values())


def test_a_transition_that_is_not_valid_now_is_answered_with_no(observer, nodes):
    assert observer.state() == "active"
    assert not observer.transition("activate")
    assert not observer.transition("configure")
    assert observer.state() == "active"
    told(observer, nodes, "rig", "refused requests", WARN)


def test_all_of_them_still_end_well(nodes):
    started, _ = nodes
    for name, node in started.items():
        assert node.end()[0] == 0, name
        assert "Traceback" not in node.errors
