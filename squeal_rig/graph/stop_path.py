"""The rig's way to its safe state, in a thread and on a ROS context of its own: it works while the rig's node hangs."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import String, UInt8
from std_srvs.srv import Trigger

from squeal_rig.errors import SafetyError
from squeal_rig.graph import qos
from squeal_rig.graph.conversions import ERROR, OK, diagnostics, status
from squeal_rig.graph.leaving import leave_graph
from squeal_rig.graph.lifetime import GuardedExecutor, described
from squeal_rig.safety.awake import AwakeTime
from squeal_rig.safety.levels import Level, shortened
from squeal_rig.safety.outside import Outside

#: Topics of the way to stop.
EMERGENCY_STOP, HEARTBEAT, SAFE = "emergency_stop", "supervisor/heartbeat", "rig/safe"
_TICK = 0.02
_RETRY_EVERY = 0.1
_START_TIMEOUT = 10.0


@dataclass
class _Stop:
    """A stop: why and by whom first; of the last request, when [ns since the epoch] sent, received, accepted."""

    number: int
    reason: str
    source: str
    requests: int = 0
    requested: int = 0
    received: int = 0
    accepted: int = 0
    refusal: str = ""
    last: str = ""  # by whom it was asked for last


class StopPath:
    """Listens to `emergency_stop` (topic and service) and to the supervisor's heartbeat, and has the rig made safe.

    Args:
        node: the rig; ours is `rig_stop` in its namespace and domain.
        make_safe: called from our thread, returns once the safe command is accepted.
        required: whether the supervisor must be there.
        patience: longest time without its heartbeat [s].
        ending: whether the process has been asked to end; then no heartbeat is missed.
        outside: the process beside that acts where this thread does not run.
    """

    def __init__(
        self,
        node: Node,
        make_safe: Callable[[], None],
        required: bool,
        patience: float,
        ending: Callable[[], bool],
        outside: Outside | None = None,
    ) -> None:
        self._make_safe, self._required, self._patience, self._ending = make_safe, required, patience, ending
        self._outside = outside
        self._lock = threading.Lock()
        self._stop: _Stop | None = None
        self._armed = False
        self._awake = AwakeTime(time.monotonic())
        self._beat: float | None = None
        self._level = Level.OK
        self._tried = 0.0
        self._closing = threading.Event()
        self._logger = node.get_logger()
        self._context = rclpy.Context()
        rclpy.init(
            args=[],
            context=self._context,
            domain_id=node.context.get_domain_id(),
            signal_handler_options=SignalHandlerOptions.NO,
        )
        own = self._node = Node(
            "rig_stop",
            context=self._context,
            namespace=node.get_namespace(),
            use_global_arguments=False,
            start_parameter_services=False,
            enable_rosout=False,
        )
        self._publisher = own.create_publisher(DiagnosticArray, SAFE, qos.LATCHED)
        own.create_subscription(String, EMERGENCY_STOP, self._on_request, qos.EVENTS)
        own.create_subscription(UInt8, HEARTBEAT, self._on_heartbeat, qos.HEARTBEAT)
        own.create_service(Trigger, EMERGENCY_STOP, self._on_service)
        self._executor = GuardedExecutor(self._context)
        self._executor.add_node(own)
        self._publish()
        self._thread = threading.Thread(target=self._run, name="stop_path", daemon=True)
        self._thread.start()

    # --- for the rig, from its thread

    @property
    def stopped(self) -> str:
        """Why the rig is stopped, and whether the driver has accepted it; empty where it is not."""
        with self._lock:
            stop = self._stop
            return "" if stop is None else _sentence(stop)

    @property
    def waiting(self) -> bool:
        """Whether the rig must not be driven yet: supervisor or process beside are required and not there."""
        return self._required and not (self._heard() and (self._outside is None or self._outside.ready))

    def arm(self, armed: bool) -> None:
        """Whether the rig is driven from now on: only then the heartbeat counts."""
        self._armed = armed
        if self._outside is not None:
            self._outside.arm(armed)

    @property
    def trouble(self) -> str:
        """What is wrong with the ways to stop; empty where they are there."""
        if not self._thread.is_alive() and not self._closing.is_set():
            return "the thread of the emergency stop has ended: start the rig's node again"
        if self._outside is None:
            return ""
        if self._outside.failed:
            return "the watchdog cannot load the driver: nobody could stop the rig from outside; its log says why"
        return "" if self._outside.running else "the watchdog has ended; it is started again"

    def watchdog_health(self) -> dict[str, Any]:
        """What the rig's health tells of the process beside."""
        if self._outside is None:
            return {}
        return {
            "watchdog": "running" if self._outside.running else "ended",
            "watchdog restarts": self._outside.restarts,
        }

    def number(self) -> int:
        """Requests to stop so far, to be given to `release`.

        Raises:
            SafetyError: the rig is stopped, and the supervisor's latch stands or it is not heard.
        """
        with self._lock:
            if self._stop is None:
                return 0
            if self._required and not self._heard():
                raise SafetyError(f"{_sentence(self._stop)}: the supervisor's heartbeat is not heard, start it first")
            if self._level == Level.STOP and self._heard():
                raise SafetyError(
                    f"{_sentence(self._stop)}: the supervisor's latch stands, set its parameter reset_reason and call"
                    " its ~/reset first"
                )
            return self._stop.requests

    def release(self, number: int) -> None:
        """The driver was reset: the stop is over.

        Raises:
            SafetyError: another stop was asked for meanwhile; the driver is made safe again.
        """
        with self._lock:
            again = self._stop is not None and self._stop.requests != number
            if not again:
                self._stop = None
        if again:
            self._command()
            raise SafetyError("another emergency stop was asked for during the reset")
        self._publish()

    def close(self) -> None:
        """End the thread, its node and the process beside."""
        if not self._closing.is_set():
            self._closing.set()
            if threading.current_thread() is not self._thread:
                self._thread.join(_START_TIMEOUT)
            if self._outside is not None:
                self._outside.close()

    # --- in our own thread

    def _run(self) -> None:
        try:
            while not self._closing.is_set():
                self._executor.spin_once(_TICK)
                try:
                    self._tick()
                except Exception as error:  # this thread is the way to stop: nothing ends it
                    told = f"the emergency stop's watch failed: {described(error)}"
                    self._logger.error(told, throttle_duration_sec=1.0)
        finally:
            leave_graph(self._executor, self._node)
            self._context.try_shutdown()

    def _tick(self) -> None:
        now = self._awake.look(time.monotonic())
        if self._outside is not None:
            self._outside.beat()
        stop = self._stop
        if stop is not None and stop.refusal and time.monotonic() - self._tried > _RETRY_EVERY:
            self._command()
        silent = self._required and self._beat is not None and now - self._beat > self._patience
        if silent and self._armed and stop is None and not self._ending():
            assert self._beat is not None
            told = f"no heartbeat of the supervisor for {now - self._beat:.2f} s, {self._patience:g} s is the limit"
            self._demand("heartbeat", told, time.time_ns())

    def _heard(self) -> bool:
        return self._beat is not None and self._awake.time - self._beat <= self._patience

    def _on_heartbeat(self, message: UInt8) -> None:
        self._beat = self._awake.look(time.monotonic())
        self._level = Level(min(message.data, Level.STOP))
        if self._level == Level.STOP and self._stop is None:
            self._demand("supervisor", "the supervisor's level is emergency stop", time.time_ns())

    def _on_request(self, message: String, info: Any) -> None:
        sent = info["source_timestamp"] if isinstance(info, dict) else info.source_timestamp
        self._demand("topic", message.data or "no reason given", sent)

    def _on_service(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._demand("service", "asked for by the service", time.time_ns())
        stop = self._stop
        response.success = stop is not None and not stop.refusal
        response.message = self.stopped
        return response

    def _demand(self, source: str, reason: str, requested: int) -> None:
        received, reason = time.time_ns(), shortened(reason)
        with self._lock:
            if self._stop is None:
                self._stop = _Stop(received, reason, source)
            elif self._stop.source == "supervisor":
                self._stop.reason, self._stop.source = reason, source  # its heartbeat can come before its words
            stop = self._stop
            stop.requests, stop.last = stop.requests + 1, source
            stop.requested, stop.received = requested, received
        self._command()
        self._logger.error(self.stopped)

    def _command(self) -> None:
        """Have the driver made safe; refused, it is told so again and again."""
        self._tried = time.monotonic()
        try:
            self._make_safe()
            refusal = ""
        except Exception as error:  # a driver may raise anything
            refusal = described(error)
        with self._lock:
            if self._stop is not None:
                self._stop.accepted, self._stop.refusal = time.time_ns(), refusal
        self._publish()

    def _publish(self) -> None:
        with self._lock:
            stop = self._stop
            if stop is None:
                message = status(OK, "rig safe", "not stopped", {"stopped": False})
            else:
                values = {
                    "stopped": True,
                    "reason": stop.reason,
                    "source": stop.source,
                    "number": stop.number,
                    "requests": stop.requests,
                    "asked last by": stop.last,
                    "accepted": not stop.refusal,
                    "requested [ns]": stop.requested,
                    "received [ns]": stop.received,
                    "accepted [ns]": stop.accepted,
                    "delay [ms]": round(1e-6 * (stop.accepted - stop.requested), 3),
                }
                message = status(ERROR, "rig safe", _sentence(stop), values)
        self._publisher.publish(diagnostics(time.time_ns(), message))


def _sentence(stop: _Stop) -> str:
    refused = f"; the driver has NOT accepted it: {stop.refusal}" if stop.refusal else ""
    return f"emergency stop: {stop.reason}{refused}"
