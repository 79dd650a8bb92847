"""Node `supervisor`: watches limits, data and nodes; warns, ramps the rig down or stops it, and keeps it stopped."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence

from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import ParameterEvent
from rcl_interfaces.srv import SetParameters
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import qos_profile_parameter_events
from rclpy.task import Future
from std_msgs.msg import String, UInt8
from std_srvs.srv import Trigger

from squeal_rig.errors import SafetyError
from squeal_rig.graph import qos
from squeal_rig.graph.conversions import (
    ERROR,
    OK,
    WARN,
    diagnostics,
    status,
    status_number,
    status_values,
    whole_number,
)
from squeal_rig.graph.health import Health, HealthPublisher, own_name
from squeal_rig.graph.lifetime import STEADY, Lifetime, run_node
from squeal_rig.graph.parameters import NODE_OPTIONS, DeclaredParameters
from squeal_rig.graph.rig_follower import RigFollower
from squeal_rig.graph.stop_path import EMERGENCY_STOP, HEARTBEAT, SAFE
from squeal_rig.instruments.description import RigDescription
from squeal_rig.instruments.driver import Samples
from squeal_rig.safety.levels import Event, Level
from squeal_rig.safety.settings import SupervisorSettings
from squeal_rig.safety.supervisor import MOVES_BELT, STATE_KEY, RigSafe, Supervisor

_HEARTBEAT_PERIOD = 0.05
_AGAIN = 0.5  # what the rig does not follow is asked for again after so long [s]
_LEVELS = {Level.OK: OK, Level.WARN: WARN, Level.RAMP_DOWN: ERROR, Level.STOP: ERROR}
_OWN = "supervisor: "


class SupervisorNode(Node):
    """Feeds the `Supervisor` from the graph, and does and publishes what it says."""

    def __init__(self, lifetime: Lifetime) -> None:
        super().__init__("supervisor", **NODE_OPTIONS)
        self._lifetime = lifetime
        self._declared = DeclaredParameters(self, (SupervisorSettings(),), apply=self._on_settings)
        self._supervisor = Supervisor(self._declared.group(SupervisorSettings), time.monotonic())
        self._asked_rest = self._asked_stop = -_AGAIN
        self._state = self.create_publisher(DiagnosticArray, "supervisor/state", qos.LATCHED)
        self._trips = self.create_publisher(DiagnosticArray, "supervisor/trips", qos.RUN_EVENTS)
        self._heartbeat = self.create_publisher(UInt8, HEARTBEAT, qos.HEARTBEAT)
        self._stop = self.create_publisher(String, EMERGENCY_STOP, qos.EVENTS)
        self._set = self.create_client(SetParameters, "rig/set_parameters")
        self._told: tuple[Level, set[str], str] | None = None
        self._rig = RigFollower(self, self._on_rig, self._on_block)
        self.create_subscription(DiagnosticArray, "squeal/state", self._on_squeal, qos.EVENTS)
        self.create_subscription(DiagnosticArray, "/diagnostics", self._on_health, qos.EVENTS_IN)
        self.create_subscription(DiagnosticArray, SAFE, self._on_safe, qos.LATCHED)
        self.create_subscription(String, EMERGENCY_STOP, self._on_stop, qos.EVENTS)
        self.create_subscription(ParameterEvent, "/parameter_events", self._on_change, qos_profile_parameter_events)
        self.create_service(Trigger, "~/reset", self._on_reset)
        self.create_timer(_HEARTBEAT_PERIOD, self._beat, clock=STEADY)
        HealthPublisher(self, self._health)
        self._act()

    # --- what comes in

    def _on_settings(self) -> None:
        self._supervisor.settings = self._declared.group(SupervisorSettings)

    def _on_rig(self, rig: RigDescription) -> None:
        self._supervisor.take_rig(rig)
        self._act()

    def _on_block(self, stamp: int, daq: Samples) -> None:
        self._supervisor.take_block(stamp, daq, time.monotonic())
        self._act()

    def _on_squeal(self, message: DiagnosticArray) -> None:
        for found in message.status[:1]:
            detected = status_values(found).get("detected") == "true"
            self._supervisor.take_squeal(detected, status_number(found, "level [dB re 1 um]"), time.monotonic())
        self._act()

    def _on_health(self, message: DiagnosticArray) -> None:
        now = time.monotonic()
        for found in message.status:
            if name := own_name(self, found.name):
                values = status_values(found)
                state = values.get(STATE_KEY, "")
                if MOVES_BELT in values:
                    self._supervisor.moves_belt = values[MOVES_BELT] == "true"
                self._supervisor.take_health(name, int.from_bytes(found.level, "little"), found.message, state, now)
        self._act()

    def _on_safe(self, message: DiagnosticArray) -> None:
        for found in message.status[:1]:
            values = status_values(found)
            stopped = values.get("stopped") == "true"
            safe = RigSafe(
                stopped,
                values.get("reason", ""),
                whole_number(values.get("number", "0")),
                not stopped or values.get("accepted") == "true",
                whole_number(values.get("requests", "0")) if values.get("asked last by") == "service" else 0,
            )
            self._supervisor.take_safe(safe, time.monotonic())
        self._act()

    def _on_stop(self, message: String) -> None:
        if not message.data.startswith(_OWN):
            self._supervisor.ask_stop(message.data, time.monotonic())
        self._act()

    def _on_change(self, event: ParameterEvent) -> None:
        if event.node == f"{self.get_namespace().rstrip('/')}/rig":
            self._supervisor.take_changes(len(event.changed_parameters), time.monotonic())
            self._act()

    # --- what goes out

    def _beat(self) -> None:
        self._supervisor.tick(time.monotonic())
        self._act()
        self._heartbeat.publish(UInt8(data=int(self._supervisor.level)))

    def _act(self) -> None:
        """Command and publish what the supervisor says."""
        now, supervisor = time.monotonic(), self._supervisor
        if supervisor.wants_stop and now - self._asked_stop > _AGAIN:
            self._asked_stop = now
            self._stop.publish(String(data=f"{_OWN}{supervisor.reason}"))
            self._heartbeat.publish(UInt8(data=int(supervisor.level)))
        if supervisor.wants_rest and now - self._asked_rest > _AGAIN:
            self._asked_rest = now
            self._rest()
        for event in supervisor.events():
            self._tell(event)
        told = supervisor.level, {finding.rule for finding in supervisor.findings}, supervisor.sentence
        # Sentences of a warning have numbers that change all the time.
        if self._told is None or told[:2] != self._told[:2] or (told[0] >= Level.RAMP_DOWN and told != self._told):
            self._told = told
            self._publish_state()

    def _rest(self) -> None:
        # One by one: a driver that cannot move the belt can take the preload away.
        request = SetParameters.Request(
            parameters=[Parameter(name, value=0.0).to_parameter_msg() for name in ("preload", "belt_speed")]
        )
        if self._set.service_is_ready():
            self._set.call_async(request).add_done_callback(self._on_rest)

    def _on_rest(self, future: Future) -> None:
        result = future.result()
        refused = [] if result is None else [r.reason for r in result.results if not r.successful]
        if refused:
            self.get_logger().error(f"the rig refused to ramp down: {'; '.join(refused)}", throttle_duration_sec=5.0)

    def _tell(self, event: Event) -> None:
        values = {"rule": event.rule, "level": event.level.words, "raised the level": event.raised}
        told = status(_LEVELS[event.level], "supervisor trip", event.sentence, values)
        self._trips.publish(diagnostics(self._stamp(), told))
        log = self.get_logger()
        text = f"{event.level.words}: {event.sentence}" if event.level else event.sentence
        # One line each: rclpy takes a call's line for its severity.
        if event.level >= Level.RAMP_DOWN:
            log.error(text)
        elif event.level:
            log.warning(text)
        else:
            log.info(text)

    def _publish_state(self) -> None:
        supervisor = self._supervisor
        values = {
            "level": supervisor.level.words,
            "latched": supervisor.latched.words,
            "trips": supervisor.trips,
            "stops asked for": supervisor.stops_asked,
            **{f"finding {finding.rule}": finding.sentence for finding in supervisor.findings},
        }
        told = status(_LEVELS[supervisor.level], "supervisor", supervisor.sentence, values)
        self._state.publish(diagnostics(self._stamp(), told))

    def _stamp(self) -> int:
        return int(self.get_clock().now().nanoseconds)

    def _on_reset(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        try:
            response.message, response.success = self._supervisor.reset(time.monotonic()), True
            self.set_parameters([Parameter("reset_reason", value="")])
        except SafetyError as error:
            response.message, response.success = str(error), False
            self.get_logger().warning(f"reset refused: {error}")
        self._beat()
        return response

    def _health(self) -> Health:
        supervisor = self._supervisor
        own = {"level": supervisor.level.words, "trips": supervisor.trips, "watched": " ".join(supervisor.watched)}
        level, sentence, values = self._rig.health(own)
        if supervisor.level:
            words = f"{supervisor.level.words}: {supervisor.sentence}"
            return _LEVELS[supervisor.level], words, values
        # A rig that is paused or has ended is no fault of ours, and of no other node's.
        return level, sentence, values


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; returns the exit code."""
    return run_node(SupervisorNode, args)


if __name__ == "__main__":
    sys.exit(main())
