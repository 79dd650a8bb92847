"""The rig's own way to its safe state, without a supervisor and with one."""

import time

import pytest
from std_msgs.msg import String, UInt8
from std_srvs.srv import Trigger

from squeal_rig.graph import qos
from tests.graph.processes import PATIENT, PATIENT_RIG, parameters
from tests.graph.statuses import health_of, status_of

pytest.importorskip("rclpy")

FAST = {"preload_slew_rate": 1e6, "belt_acceleration": 1e5}


def _in_force(blocks):
    last = blocks[-1].samples[-1]
    return float(last["preload"]), float(last["belt_speed"])


def _safe(messages):
    return status_of(messages[-1], "rig safe") if messages else None


def test_a_lone_rig_is_stopped_by_anybody_and_goes_on_after_its_reset(compiled, processes, observer):
    rig = processes.node("simulator", *parameters(**FAST))
    blocks, safe = observer.follow_samples("daq/samples"), observer.follow("rig/safe")
    health = observer.follow("/diagnostics")
    observer.wait_for(lambda: blocks and _safe(safe), "samples")
    assert _safe(safe)[:2] == (0, "not stopped")
    before = time.time_ns()
    answer = observer.call(Trigger, "emergency_stop", Trigger.Request(), repeat=5.0)
    assert (answer.success, answer.message) == (True, "emergency stop: asked for by the service")
    observer.wait_for(lambda: _in_force(blocks) == (0.0, 0.0), "a rig at rest")
    level, _, values = observer.wait_for(lambda: _safe(safe)[2]["stopped"] == "true" and _safe(safe), "rig/safe")
    assert (level, values["source"], values["accepted"]) == (2, "service", "true")
    assert before <= int(values["requested [ns]"]) <= int(values["accepted [ns]"]) <= time.time_ns()
    # Parameters may be set, and are not in force.
    assert observer.set({"preload": 60.0}) == [(True, "")]
    observer.wait_for(
        lambda: (h := health_of(health, "rig")) and h[0] == 2 and h[1].startswith("emergency stop: "), "health"
    )
    assert _in_force(blocks) == (0.0, 0.0)
    # A second request is counted, the first reason stands.
    publisher = observer.publisher("emergency_stop")
    observer.wait_for(lambda: publisher.get_subscription_count() == 1, "the rig's ear")
    requests = int(_safe(safe)[2]["requests"])
    publisher.publish(String(data="once more"))
    observer.wait_for(
        lambda: _safe(safe)[2]["source"] == "service" and int(_safe(safe)[2]["requests"]) > requests, "it"
    )
    assert _safe(safe)[2]["reason"] == "asked for by the service"
    # A reset starts nothing by itself.
    done, told = observer.trigger("reset")
    assert (done, "set points of preload and belt speed are zero" in told) == (True, True)
    observer.wait_for(lambda: _safe(safe)[2]["stopped"] == "false", "the end of the stop")
    assert observer.get(["preload", "belt_speed"]) == {"preload": 0.0, "belt_speed": 0.0}
    assert observer.set({"preload": 60.0, "belt_speed": 1.0}, atomically=True) == [(True, "")]
    observer.wait_for(lambda: _in_force(blocks) == (60.0, 1.0), "the operating point")
    # Stopped while inactive, it is safe from its first block on.
    assert observer.transition("deactivate")
    assert observer.call(Trigger, "emergency_stop", Trigger.Request(), repeat=5.0).success
    begun = time.time_ns()
    assert observer.transition("activate")

    def since():
        return [block.samples for block in blocks if block.stamp_ns >= begun]

    observer.wait_for(lambda: len(since()) > 3, "samples of the stopped rig")
    assert {(float(b["preload"].max()), float(b["belt_speed"].max())) for b in since()} == {(0.0, 0.0)}
    assert rig.end()[0] == 0
    assert "Traceback" not in rig.errors


@pytest.mark.slow
def test_a_rig_that_wants_a_supervisor_waits_for_its_heartbeat_and_obeys_it(compiled, processes, observer):
    """Our own heartbeat, so that it says what the test wants."""
    rig = processes.node(
        "simulator", *parameters(**FAST, supervisor_required=True, heartbeat_timeout=20.0, watchdog_timeout=60.0)
    )
    blocks, safe = observer.follow_samples("daq/samples"), observer.follow("rig/safe")
    health = observer.follow("/diagnostics")
    heart = observer.node.create_publisher(UInt8, "supervisor/heartbeat", qos.HEARTBEAT)
    level = [0]
    timer = observer.node.create_timer(0.05, lambda: heart.publish(UInt8(data=level[0])))
    timer.cancel()

    def state():
        found = health_of(health, "rig")
        return found and found[2]["state"]

    observer.wait_for(lambda: state() == "waiting", "a rig that waits")
    assert not blocks
    timer.reset()
    observer.wait_for(lambda: blocks and state() == "running", "samples")
    level[0] = 3
    observer.wait_for(lambda: _safe(safe) and _safe(safe)[2]["stopped"] == "true", "the stop")
    done, told = observer.trigger("reset")
    assert (done, "the supervisor's latch stands, set its parameter reset_reason" in told) == (False, True)
    level[0] = 0
    observer.wait_for(lambda: observer.trigger("reset")[0], "the reset")
    timer.cancel()
    observer.wait_for(lambda: "no heartbeat of the supervisor" in _safe(safe)[1], "the stop without heartbeat")
    assert not observer.trigger("reset")[0]
    timer.reset()
    observer.wait_for(lambda: observer.trigger("reset")[0], "the reset with a heartbeat")
    assert rig.end()[0] == 0
    observer.node.destroy_timer(timer)
    assert "Traceback" not in rig.errors
    assert "from outside" not in rig.errors  # a normal end is no trip


@pytest.mark.slow
def test_a_reset_of_the_supervisor_is_refused_in_a_sentence(compiled, processes, observer):
    supervisor = processes.node("supervisor", *parameters(nodes=["rig"], **PATIENT))
    rig = processes.node("simulator", *parameters(supervisor_required=True, **PATIENT_RIG))
    states, trips = observer.follow("supervisor/state"), observer.follow("supervisor/trips")
    blocks, safe = observer.follow_samples("daq/samples"), observer.follow("rig/safe")
    observer.wait_for(lambda: blocks, "samples")

    def reset():
        return observer.trigger("reset", rig="supervisor")

    # A machine that is held up may be warned of, which passes.
    observer.wait_for(lambda: reset() == (False, "nothing to reset: the level is ok"), "the level ok")
    publisher = observer.publisher("emergency_stop")
    observer.wait_for(lambda: publisher.get_subscription_count() == 2, "the ears of rig and supervisor")
    publisher.publish(String(data="a test"))
    observer.wait_for(
        lambda: states and status_of(states[-1], "supervisor")[2]["latched"] == "emergency stop", "the latch"
    )
    assert reset() == (False, "reset_reason is empty: set it to what was found and mended, then reset again")
    # Topic and heartbeat are two ways to the rig; where its reset comes before either, the heartbeat stops it again.
    observer.wait_for(lambda: not observer.trigger("reset")[0], "the rig's reset refused")
    observer.wait_for(lambda: _safe(safe) and _safe(safe)[2]["stopped"] == "true", "the rig's stop")
    assert not observer.trigger("reset")[0]
    assert observer.set({"reset_reason": "seen"}, node="supervisor") == [(True, "")]
    observer.wait_for(lambda: reset()[0], "the reset")
    assert observer.get(["reset_reason"], node="supervisor") == {"reset_reason": ""}
    released = "emergency stop released: seen"
    # A warning, that the machine was held up, may follow it.
    observer.wait_for(
        lambda: any(status_of(trip, "supervisor trip")[1] == released for trip in trips), "the release told"
    )
    told = [status_of(message, "supervisor trip") for message in trips]
    # Whichever comes first: the request itself, or the rig's word that it has followed it.
    assert {"asked for: a test", "the rig was stopped: a test"} & {sentence for _, sentence, _ in told}
    observer.wait_for(lambda: observer.trigger("reset")[0], "the rig's reset")
    assert [rig.end()[0], supervisor.end()[0]] == [0, 0]
    assert "Traceback" not in rig.errors + supervisor.errors
