"""The simulator is killed without a chance to say so: the others report stale data, live on, and recover."""

import signal

import pytest

from tests.graph.processes import parameters
from tests.graph.statuses import health_of

pytest.importorskip("rclpy")

pytestmark = pytest.mark.slow

CONSUMERS = ("friction_estimator", "stability", "squeal_detector")
STALE = 3


@pytest.mark.parametrize("real_time_factor", [1.0, 2.0])
def test_after_kill_9_of_the_simulator_the_others_are_stale_but_alive_and_recover(
    compiled, processes, observer, real_time_factor
):
    # Where the factor is not 1, /clock dies with the simulator, and every ROS timer of the others with it.
    sim_time = parameters(use_sim_time=str(real_time_factor != 1.0).lower())
    health = observer.follow("/diagnostics")
    nodes = {name: processes.node(name, *sim_time) for name in CONSUMERS}

    def start_rig(**settings):
        return processes.node("simulator", *parameters(real_time_factor=real_time_factor, **settings))

    def level(name):
        state = health_of(health, name)
        return state[0] if state else None

    def wait_for_level(wanted):
        for name in CONSUMERS:
            observer.wait_for(lambda name=name: level(name) == wanted, f"{name} at level {wanted}")

    simulator = start_rig()
    wait_for_level(0)
    windows = observer.follow_samples("friction/windows")
    observer.wait_for(lambda: windows and windows[-1].samples["t_start"] >= 2.0, "two seconds of samples")
    simulator.send(signal.SIGKILL)
    assert simulator.wait() == -signal.SIGKILL
    wait_for_level(STALE)
    for name in CONSUMERS:
        assert health_of(health, name)[1].startswith("stale: no daq/samples for")
    # Still there a second of their own time later: health keeps coming, from every one of them.
    health.clear()
    wait_for_level(STALE)
    assert all(node.running for node in nodes.values())

    # A new simulator counts its samples from zero again: everybody takes them up.
    windows.clear()
    states = observer.follow("squeal/state")
    start_rig(autostart="false")
    assert observer.transition("configure")
    observer.wait_for_listeners("daq/samples", len(CONSUMERS))
    assert observer.transition("activate")
    wait_for_level(0)
    observer.wait_for(lambda: len(windows) >= 2 and len(states) >= 2, "windows and squeal states of the new run")
    # The old run's windows went beyond 2 s: these are not what comes once the new run has passed its end.
    assert windows[0].samples["t_start"] < 2.0
    assert windows[-1].samples["valid_share"] == 1.0
    for node in nodes.values():
        code, _ = node.end()
        assert code == 0
        assert "Traceback" not in node.errors
    processes.end_all()
