"""Parameters within their bounds whose motion cannot be followed: a fault in a sentence, and answers throughout."""

import time

import pytest

from tests.graph.processes import parameters
from tests.graph.statuses import health_of

pytest.importorskip("rclpy")

ERROR = 2
# Friction that sees the slip, over a width of 1 um/s: where the pad sticks it turns a million times a second.
STICKING = {"friction_speed": "slip", "friction_direction": "slip", "regularization_speed": 1e-6}
HELD = {"belt_speed": 0.0, "preload": 2000.0}


def test_a_rig_that_sticks_reports_a_fault_answers_and_ends(compiled, processes, observer, measured):
    rig = processes.node(
        "simulator", *parameters(**STICKING, belt_speed=0.5, belt_acceleration=1e6, preload_slew_rate=1e9)
    )
    health = observer.follow("/diagnostics")
    blocks = observer.follow_samples("daq/samples")
    observer.wait_for(lambda: blocks, "samples")
    assert observer.set(HELD, atomically=True) == [(True, "")]
    state = observer.wait_for(
        lambda: (state := health_of(health, "rig")) and state[0] == ERROR and state, "the fault on /diagnostics"
    )
    assert state[1].startswith("the motion changes too fast: ")
    assert state[1].endswith("; call ~/reset to start again")
    assert observer.set({"belt_speed": 0.5, "preload": 50.0}, atomically=True) == [(True, "")]
    begin = time.monotonic()
    assert observer.trigger("reset")[0]
    blocks.clear()
    observer.wait_for(lambda: blocks, "samples after the reset")
    measured(f"reset of a rig that sticks, to its next samples: {time.monotonic() - begin:.2f} s (asked for: 5 s)")
    # And while it computes in vain, a signal is followed.
    assert observer.set(HELD, atomically=True) == [(True, "")]
    code, seconds = rig.end()
    assert code == 0
    measured(f"end of a rig that sticks: {seconds:.2f} s (asked for: 5 s)")
    assert "Traceback" not in rig.errors


@pytest.mark.slow
@pytest.mark.parametrize(
    "extreme",
    [
        pytest.param({**STICKING, **HELD, "contact_stiffness": 1e12}, id="sticking"),
        pytest.param(
            {"mass": 0.001, "damping_x": 1e6, "damping_y": 1e6, "contact_stiffness": 1e12},
            id="stiff",
        ),
    ],
)
def test_a_rig_that_cannot_start_says_so_at_once(compiled, processes, extreme, measured):
    begin = time.monotonic()
    rig = processes.node("simulator", *parameters(**extreme))
    assert rig.wait() == 2
    measured(f"a rig that cannot start has said so after {time.monotonic() - begin:.1f} s (asked for: 15 s)")
    assert "rig: the motion changes too fast: " in rig.errors
    assert "Traceback" not in rig.errors
