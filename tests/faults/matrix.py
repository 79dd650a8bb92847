"""The fault matrix: what is injected, where it ends, within what time. `make faults` writes docs/faults.md from it."""

import os
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass, field

#: Where a case ends.
WARN, RAMP, STOP = "warn", "ramp down", "emergency stop"


@dataclass(frozen=True)
class Case:
    """One fault.

    Args:
        name: what is wrong, for people.
        inject: does it; returns the time of it [s since the epoch].
        ends: level that the supervisor goes to.
        within: documented time to there [s], on a machine that is not busy.
        says: part of the sentence that it is told with.
        by: who finds it.
        normal: also part of `make test`.
        after: brings the bench to where the case can be mended.
        dies: nodes that end.
    """

    name: str
    inject: Callable
    ends: str
    within: float
    says: str
    by: str = "supervisor"
    normal: bool = False
    after: Callable = field(default=lambda bench: None)
    dies: tuple = ()


def _fault(name, content=""):
    return lambda bench: bench.put(name, content)


def _send(node, number):
    def send(bench):
        begun = time.time()
        bench.nodes[node].send(number)
        return begun

    return send


def _go_on(node):
    return lambda bench: bench.nodes[node].send(signal.SIGCONT)


def _set_limit(**limits):
    """A limit drawn below what is, as where a rig is loaded beyond it."""

    def change(bench):
        begun = time.time()
        bench.observer.set(limits, node="supervisor", atomically=True)
        return begun

    return change


def _limits_back(bench):
    from squeal_rig.safety.settings import SupervisorSettings

    names = ("squeal_warn", "squeal_ramp_down", "squeal_duration", "ramp_time")
    values = {name: getattr(SupervisorSettings(), name) for name in names}
    bench.observer.set({"mu0": 0.25010}, atomically=True)
    bench.observer.set(values, node="supervisor", atomically=True)


def _squeal(bench):
    begun = time.time()
    bench.observer.set({"preload": 300.0, "mu0": 0.4}, atomically=True)
    return begun


def _squeal_long(bench):
    _set_limit(squeal_duration=2.0)(bench)
    return _squeal(bench)


def _squeal_loud(bench):
    _set_limit(squeal_warn=-15.0, squeal_ramp_down=-12.0)(bench)
    return _squeal(bench)


def _flood(count):
    """So many changes of a parameter, 20 in a request and 50 requests a second."""

    def flood(bench):
        from rcl_interfaces.srv import SetParameters
        from rclpy.parameter import Parameter

        client = bench.observer.node.create_client(SetParameters, "rig/set_parameters")
        bench.observer.wait_for(client.service_is_ready, "the rig's parameters")
        begun = time.time()
        futures = []
        for first in range(0, count, 20):
            messages = [
                Parameter("impact_impulse", value=0.05 + 1e-6 * (first + i)).to_parameter_msg() for i in range(20)
            ]
            futures.append(client.call_async(SetParameters.Request(parameters=messages)))
            bench.observer.spin(0.02)
        # A service keeps the ten newest requests: a rig that was held up for a moment never sees those before them.
        bench.observer.wait_for(futures[-1].done, "the last answer")
        bench.observer.node.destroy_client(client)
        return begun

    return flood


def _stop_in_a_ramp(bench):
    bench.observer.set({"belt_speed": 4.0, "preload": 200.0}, atomically=True)
    bench.observer.wait_for(lambda: 1.2 < bench.in_force()[1] < 3.5, "the ramp")
    return bench.ask_stop("in a ramp")


def _stop_twice(bench):
    begun = bench.ask_stop("once")
    bench.observer.wait_for(bench.is_safe, "the stop")
    bench.ask_stop("twice")
    bench.observer.wait_for(
        lambda: bench.status(bench.safe, "rig safe")[2]["requests"] not in ("0", "1"), "the second request"
    )
    return begun


def _stop_by_service(bench):
    from std_srvs.srv import Trigger

    begun = time.time()
    answer = bench.observer.call(Trigger, "emergency_stop", Trigger.Request(), repeat=5.0)
    assert answer.success, answer.message
    return begun


def _stop_while(name, content=""):
    def stop(bench):
        bench.put(name, content)
        time.sleep(0.1)
        return bench.ask_stop(f"while {name}")

    return stop


def _stop_refused(bench):
    bench.put("refuse safe")
    begun = bench.ask_stop("an inverter that does not answer")
    bench.observer.wait_for(
        lambda: "NOT accepted it: OSError" in bench.status(bench.safe, "rig safe")[1], "the refusal", 10.0
    )
    (bench.faults / "refuse safe").unlink()
    return begun


def _ramp_is_not_followed(bench):
    _set_limit(ramp_time=0.5)(bench)
    bench.put("stuck", "preload")
    time.sleep(0.1)
    return bench.put("nan", "x nan")


def _restart_of_the_rig(bench):
    begun = _send("rig", signal.SIGKILL)(bench)
    bench.nodes["rig"].wait()
    bench.start("rig")
    return begun


CASES = (
    Case(
        "stuck arm transducer, while the pad moves",
        lambda b: (_shake(b), b.put("stuck", "arm_left"))[1],
        RAMP,
        1.0,
        "arm_left stands at",
        after=_limits_back,
    ),
    Case(
        "stuck displacement sensor, while the arms move",
        lambda b: (_shake(b), b.put("stuck", "x"))[1],
        RAMP,
        1.0,
        "x stands at",
        after=_limits_back,
    ),
    Case(
        "stuck belt speed, while the belt is moved",
        lambda b: (b.put("stuck", "belt_speed"), _faster(b))[1],
        RAMP,
        6.0,
        "off its set point",
    ),
    Case("a channel is NaN", _fault("nan", "arm_left nan"), RAMP, 0.3, "arm_left is not finite", normal=True),
    Case("a channel at its full scale", _fault("set", "arm_right 9000"), RAMP, 0.3, "at its full scale"),
    Case("a channel is infinite", _fault("nan", "motor_torque inf"), RAMP, 0.3, "motor_torque is not finite"),
    Case(
        "spike of one sample beyond the force limit",
        _fault("spike", "arm_right 1e6"),
        WARN,
        0.2,
        "a spike",
    ),
    Case("force beyond the limit of ramp down", _fault("add", "clip_left 16000"), RAMP, 0.2, "clip_left reaches"),
    Case("force beyond the limit of stop", _fault("add", "arm_left 30000"), STOP, 0.2, "arm_left reaches", normal=True),
    Case("preload beyond the limit", _fault("add", "preload 25000"), STOP, 0.2, "preload reaches"),
    Case("displacement beyond the limit", _fault("add", "y 0.0005"), STOP, 0.2, "y reaches"),
    Case("torque beyond the limit", _fault("add", "motor_torque 800"), RAMP, 0.2, "motor_torque reaches"),
    Case("drive stall: the belt stands", _fault("stall", "belt_speed"), RAMP, 0.4, "off its set point"),
    Case("drive runaway, 5 m/s^2", _fault("runaway", "belt_speed"), STOP, 1.5, "off its set point"),
    Case("squeal louder than the limit", _squeal_loud, RAMP, 2.0, "the rig squeals", after=_limits_back),
    Case("squeal for longer than the limit (2 s here)", _squeal_long, RAMP, 5.0, "the rig squeals", after=_limits_back),
    Case("time jumps ahead by 1 s", _fault("jump", "1.0"), WARN, 0.2, "time jumps ahead"),
    Case("time jumps back by 1 s", _fault("jump", "-1.0"), RAMP, 0.2, "time runs back"),
    Case("one block lost", _fault("lose", "1"), WARN, 0.2, "samples lost within a second"),
    Case("every second block lost", _fault("lose half"), RAMP, 0.5, "samples lost within a second"),
    Case("two blocks swapped once", _fault("swap", "1"), WARN, 0.2, "late, or twice"),
    Case("blocks swapped again and again", _fault("swap", "5"), RAMP, 0.5, "out of order"),
    Case("numbers of the samples jump", _fault("jump the numbers", "1000000"), WARN, 0.2, "begin anew"),
    Case("stale driver: no blocks any more", _fault("no blocks"), STOP, 1.3, "no samples of the rig"),
    Case("driver slower than its blocks (30 ms each)", _fault("slow", "0.03"), WARN, 5.0, "of their rate"),
    Case("exception in the driver", _fault("raise"), STOP, 0.3, "no bridge voltage"),
    Case("driver hangs with the GIL released", _fault("hang"), STOP, 1.3, "no samples of the rig"),
    Case("emergency stop while the driver hangs", _stop_while("hang"), STOP, 0.1, "while hang", by="rig", normal=True),
    Case(
        "driver holds the GIL",
        _fault("hold", "60"),
        STOP,
        1.6,
        "no samples of the rig",
        by="watchdog",
        dies=("rig",),
    ),
    Case(
        "emergency stop while the GIL is held",
        _stop_while("hold", "60"),
        STOP,
        1.6,
        "while hold",
        by="watchdog",
        dies=("rig",),
    ),
    Case("emergency stop by topic", lambda b: b.ask_stop("a test"), STOP, 0.1, "a test", by="rig"),
    Case("emergency stop by service", _stop_by_service, STOP, 0.1, "asked for by the service", by="rig"),
    Case("emergency stop during a ramp of the belt", _stop_in_a_ramp, STOP, 0.1, "in a ramp", by="rig"),
    Case("double emergency stop", _stop_twice, STOP, 0.1, "once", by="rig"),
    Case("emergency stop that the driver refuses, then accepts", _stop_refused, STOP, 0.3, "does not answer", by="rig"),
    Case("flood of parameters: 300 a second", _flood(600), RAMP, 2.0, "changes of the rig's parameters"),
    Case("flood of parameters: 80 at once", _flood(80), WARN, 0.5, "changes of the rig's parameters"),
    Case("rig killed", _send("rig", signal.SIGKILL), STOP, 1.3, "no samples of the rig", dies=("rig",)),
    Case("rig killed and started again at once", _restart_of_the_rig, STOP, 1.3, "no samples of the rig"),
    Case(
        "rig stopped (SIGSTOP)",
        _send("rig", signal.SIGSTOP),
        STOP,
        1.6,
        "no samples of the rig",
        by="watchdog",
        dies=("rig",),
    ),
    Case(
        "supervisor killed",
        _send("supervisor", signal.SIGKILL),
        STOP,
        0.7,
        "no heartbeat of the supervisor",
        by="rig",
        dies=("supervisor",),
    ),
    Case(
        "supervisor hung (SIGSTOP)",
        _send("supervisor", signal.SIGSTOP),
        STOP,
        0.7,
        "no heartbeat of the supervisor",
        by="rig",
        after=_go_on("supervisor"),
    ),
    Case(
        "a node of the session killed",
        _send("squeal_detector", signal.SIGKILL),
        RAMP,
        3.5,
        "squeal_detector has not reported its health",
        dies=("squeal_detector",),
    ),
    Case(
        "a node of the session hung (SIGSTOP)",
        _send("squeal_detector", signal.SIGSTOP),
        RAMP,
        4.5,
        "squeal_detector has not reported its health",
        after=_go_on("squeal_detector"),
    ),
    Case(
        "ramp down that the preload does not follow",
        _ramp_is_not_followed,
        STOP,
        1.5,
        "not at rest",
        after=_limits_back,
    ),
)


def _shake(bench):
    """A pad that moves: it squeals."""
    bench.observer.set({"preload": 300.0, "mu0": 0.4}, atomically=True)
    bench.observer.wait_for(lambda: _span(bench) > 1e-6, "squeal")


def _span(bench):
    x = bench.daq[-1].samples["x"]
    return float(x.max() - x.min())


def _faster(bench):
    begun = time.time()
    bench.observer.set({"belt_speed": 2.0}, atomically=True)
    return begun


#: The file that a run writes the table to.
TABLE = os.environ.get("FAULTS_TABLE", "")
