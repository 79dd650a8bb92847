"""The live graph as the command line sees it: the rig's state, and experiments' `Rig` on it."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.node import Node
from rclpy.parameter import Parameter
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import String
from std_srvs.srv import Trigger

from squeal_rig.errors import ExperimentError, NoHitError, RecordingError, SquealRigError
from squeal_rig.estimation import hard_squeal
from squeal_rig.estimation.stability_follower import DESCRIPTION_KEY, IN_FORCE, SET_POINT, text_crc
from squeal_rig.experiments.engine import FITTED, RunEvent
from squeal_rig.graph import qos
from squeal_rig.graph.conversions import ERROR, OK, diagnostics, status, status_number, status_values, whole_number
from squeal_rig.graph.health import HEARD, LAST_PUBLISHED, LAST_TAKEN, LISTENERS, own_name
from squeal_rig.graph.leaving import leave_graph
from squeal_rig.graph.lifetime import GuardedExecutor, join_graph
from squeal_rig.graph.names import Claim, is_running
from squeal_rig.instruments.acquisition import NOT_MOVABLE
from squeal_rig.instruments.channels import DAQ_CHANNELS, FRICTION_WINDOW_NEEDED, block_from_cdr
from squeal_rig.instruments.description import RigDescription
from squeal_rig.instruments.driver import Samples
from squeal_rig.instruments.numbering import SEQ_MODULUS, Numbering
from squeal_rig.safety.supervisor import ENDED, INACTIVE, STATE_KEY

# Discovery of a service took up to 2.3 s where it was measured.
_SERVICE_TIMEOUT = 10.0
_TRANSITIONS = {
    Transition.TRANSITION_CONFIGURE: "configured",
    Transition.TRANSITION_ACTIVATE: "activated",
    Transition.TRANSITION_DEACTIVATE: "deactivated",
}
_ASK_AGAIN = 1.0
_STALL_TIMEOUT = 10.0
# Nodes on other machines are mostly found within this time [s].
_DISCOVERY = 0.5
# A first smallest hit ever may have to be compiled.
_HIT_TIMEOUT = 180.0
_SPIN = 0.05
# A rig is safe to touch below these, as it measures them [N], [m/s]; it has so long to come there [s].
_NO_PRELOAD, _NO_SPEED, _STANDSTILL = 5.0, 0.02, 120.0
# Longest that a rig and a recorder that are to end are waited for [s].
_HAND_OVER = 10.0
# Longest that a rig takes to connect anew [s].
_START = 60.0
# Nodes and topics of ours that are kept in mind, whatever names others publish.
_MOST_NAMES = 1000


@dataclass
class LiveState:
    """What the graph last told; nan and None where it has not yet."""

    sampled_time: float = math.nan
    preload: float = math.nan
    belt_speed: float = math.nan
    mu_set: float = math.nan
    mu_estimated: float = math.nan
    mu_ratio_of_means: float = math.nan
    pad_stiffness: float = math.nan
    critical_stiffness: float = math.nan
    margin: float = math.nan
    unstable: bool | None = None
    zone: str = ""
    smallest_hit: float = math.nan
    hit_direction: float = math.nan
    squealing: bool | None = None
    level: float = math.nan
    frequency: float = math.nan
    recorded_bytes: float = math.nan
    trip: str = ""
    listeners: dict[str, int] = field(default_factory=dict)  # as the publishers of the topics count them
    recorded: frozenset[str] = frozenset()  # topics whose publishers the recorder knows
    rig_state: str = ""
    # Number of the last block of a topic, as its publisher counts: that the rig has published, that the recorder has.
    published: dict[str, int] = field(default_factory=dict)
    taken: dict[str, int] = field(default_factory=dict)
    health: dict[str, tuple[int, str]] = field(default_factory=dict)


class LiveGraph:
    """A node of the command line on the live graph: keeps `LiveState`, and is the `Rig` that plans run against.

    Args:
        watched: called now and then while waiting; it may raise to end the wait.
    """

    def __init__(self, watched: Callable[[], None]) -> None:
        join_graph([])
        self._node = Node("console")
        self._executor = GuardedExecutor()
        self._executor.add_node(self._node)
        self._watched = watched
        self._sampled = 0.0
        self._numbering = Numbering()
        self._next_seq: int | None = None
        self._to_fit = ""
        self._description: RigDescription | None = None
        self._described = self._analysed = self._hard_squeal = ""
        self.state = LiveState()
        self.windows: list[Any] = []
        self.keeps_windows = False
        self.on_spin: Callable[[], None] = lambda: None
        self.on_samples: Callable[[Samples], None] = lambda daq: None
        self.ends_with_trip = False
        subscribe = self._node.create_subscription
        subscribe(PointCloud2, "daq/samples", self._on_daq, qos.BLOCKS, raw=True)
        subscribe(PointCloud2, "friction/windows", self._on_window, qos.EVENTS, raw=True)
        subscribe(DiagnosticArray, "stability/summary", self._on_stability, qos.LATCHED)
        subscribe(String, "rig/description", self._on_description, qos.LATCHED)
        subscribe(DiagnosticArray, "squeal/state", self._on_squeal, qos.EVENTS)
        subscribe(DiagnosticArray, "supervisor/state", self._on_supervisor, qos.LATCHED)
        subscribe(DiagnosticArray, "/diagnostics", self._on_health, qos.EVENTS)
        self._node.declare_parameter(FITTED, "")
        self._node.add_on_set_parameters_callback(self._refuse_others)
        self._events = self._node.create_publisher(DiagnosticArray, "run/events", qos.RUN_EVENTS)
        self._change_state = self._node.create_client(ChangeState, "rig/change_state")
        self._triggers = {
            name: self._node.create_client(Trigger, f"rig/{name}") for name in ("reset", "impact", "zero")
        }
        # The last one, see `_introduce`.
        self._set = self._node.create_client(SetParametersAtomically, "rig/set_parameters_atomically")
        self._known = False

    def close(self) -> None:
        """Leave the graph."""
        leave_graph(self._executor, self._node)
        rclpy.try_shutdown()

    def hand_over(self, recorded: Sequence[str], present: Callable[[], bool]) -> None:
        """Have the rig give no more samples and the recorder take its blocks on topics `recorded`, within some seconds.

        What a process that stands still has not received goes with the publisher that ends. `present` tells whether
        rig and recorder are still there.
        """
        state = self.state
        state.rig_state = ""
        if self._change_state.service_is_ready():
            self._change_state.call_async(
                ChangeState.Request(transition=Transition(id=Transition.TRANSITION_DEACTIVATE))
            )
        deadline = time.monotonic() + _HAND_OVER
        while time.monotonic() < deadline and present():
            self._executor.spin_for(_SPIN)
            if state.rig_state in (INACTIVE, ENDED) and all(
                state.taken.get(self._node.resolve_topic_name(name), 0) >= state.published.get(name, 0)
                for name in recorded
            ):
                return

    def spin(self, seconds: float = _SPIN) -> None:
        """Take what comes for that long [s]."""
        self._executor.spin_for(seconds)
        self._watched()
        self.on_spin()
        if self.ends_with_trip and self.state.trip:
            raise ExperimentError(f"the supervisor has tripped, which ends the plan: {self.state.trip}")

    def listeners(self, topic: str) -> int:
        """Subscribers to a topic that the graph knows of."""
        return self._node.count_subscribers(self._node.resolve_topic_name(topic))

    def is_heard(self, wanted: Mapping[str, int]) -> bool:
        """Whether publishers themselves count so many listeners to their topics, and all that the graph knows of.

        The graph knows of a subscriber some time before a publisher does, and what is published in between it does not
        get.
        """
        counts = self.state.listeners
        return all(counts.get(topic, 0) >= max(count, self.listeners(topic)) for topic, count in wanted.items())

    def is_recorded(self, wanted: Iterable[str]) -> bool:
        """Whether the recorder knows the publishers of all those topics.

        A publisher may count a reader before that one knows of it, and takes what it holds for it along when it ends.
        """
        return self.state.recorded.issuperset(map(self._node.resolve_topic_name, wanted))

    def transition(self, number: int, timeout: float) -> None:
        """Take the rig through a lifecycle transition; `ExperimentError` when it fails."""
        request = ChangeState.Request(transition=Transition(id=number))
        if not self._answer(self._change_state, request, timeout).success:
            raise ExperimentError(f"the rig could not be {_TRANSITIONS[number]}: see its log")

    def refuse_other_rig(self) -> None:
        """`ExperimentError` where a rig is on the graph already: two of one name would be commanded as one."""
        domain = self._node.context.get_domain_id()
        claim = Claim(domain, "/rig")
        claim.release()  # our own rig is about to take it
        if not claim.granted or is_running("/rig", discovery=_DISCOVERY):
            raise ExperimentError(f"a rig runs on ROS domain {domain} already: end it, or set ROS_DOMAIN_ID")

    def wait_for(self, condition: Callable[[], bool], what: str, timeout: float) -> None:
        """Spin until a condition holds; `ExperimentError` after `timeout` [s]."""
        if not self.comes(condition, timeout):
            raise ExperimentError(f"waited {timeout:g} s in vain for {what}")

    def comes(self, condition: Callable[[], bool], timeout: float) -> bool:
        """Spin until a condition holds; whether it does within `timeout` [s]."""
        deadline = time.monotonic() + timeout
        while not condition():
            if time.monotonic() > deadline:
                return False
            self.spin()
        return True

    # --- the plan's Rig

    def set_parameters(self, values: Mapping[str, float | str]) -> None:
        """Set parameters of the rig, all or none."""
        request = SetParametersAtomically.Request(
            parameters=[Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
        )
        result = self._answer(self._set, request).result
        if not result.successful:
            raise ExperimentError(f"the rig refused {dict(values)}: {result.reason or 'unknown parameter'}")

    def call(self, service: str) -> str:
        """Call one of the rig's trigger services."""
        response = self._answer(self._triggers[service], Trigger.Request())
        if not response.success:
            raise ExperimentError(f"the rig refused {service}: {response.message}")
        return str(response.message)

    def change_springs(self, name: str, stiffness: float, dwell: float) -> str:
        """Give both arms that stiffness [N/m]: at once where the rig's driver can, else by a mechanic.

        For a mechanic preload and belt come to nothing, and the rig is deactivated. It goes on once this node's
        parameter `spring_fitted` is the springs' name; then the set points are as before.

        Raises:
            ExperimentError: nobody has confirmed it within `dwell` [s]; the rig stays inactive, hands may be on it.
        """
        springs: dict[str, float | str] = {"k1": stiffness, "k2": stiffness}
        try:
            self.set_parameters(springs)
            return "set"
        except ExperimentError as error:
            if NOT_MOVABLE not in str(error):
                raise
        before = self.description.parameters
        self.set_parameters({"preload": 0.0, "belt_speed": 0.0})
        self.wait_for(self._stands, "a rig without preload and with its belt at rest", _STANDSTILL)
        self.transition(Transition.TRANSITION_DEACTIVATE, _SERVICE_TIMEOUT)
        self._node.set_parameters([Parameter(FITTED, value="")])
        self._to_fit = name
        stands = False

        def is_confirmed() -> bool:
            nonlocal stands
            stands = stands or self.state.rig_state == INACTIVE
            if stands and self.state.rig_state != INACTIVE:
                self.transition(Transition.TRANSITION_DEACTIVATE, _SERVICE_TIMEOUT)
                raise ExperimentError(
                    f"the rig was activated while the springs {name!r} were being fitted: it is inactive again"
                )
            return bool(self._node.get_parameter(FITTED).value == name)

        try:
            confirmed = self.comes(is_confirmed, dwell)
        finally:
            self._to_fit = ""
        if not confirmed:
            missing = f"nobody has confirmed the springs {name!r} within {dwell:g} s"
            raise ExperimentError(f"{missing}: the rig stays inactive")
        self.set_parameters(springs)
        self.transition(Transition.TRANSITION_ACTIVATE, _START)
        self.set_parameters({"preload": before.preload, "belt_speed": before.belt_speed})
        return "fitted by hand, confirmed"

    def _refuse_others(self, parameters: Sequence[Parameter]) -> SetParametersResult:
        """Other springs than those to be fitted are not confirmed."""
        for parameter in parameters:
            if parameter.name == FITTED and parameter.value not in ("", self._to_fit):
                asked = f"the springs to fit are {self._to_fit!r}" if self._to_fit else "no springs are to fit now"
                refusal = f"{FITTED} = {str(parameter.value)[:60]!r}: {asked}"
                return SetParametersResult(successful=False, reason=refusal)
        return SetParametersResult(successful=True)

    def _stands(self) -> bool:
        return abs(self.state.preload) < _NO_PRELOAD and abs(self.state.belt_speed) < _NO_SPEED

    def smallest_hit(self) -> tuple[float, float]:
        """Smallest hit [N s] that starts squeal at the rig's set point, and its direction [rad], as `stability` has it.

        Raises:
            NoHitError: there is none.
            ExperimentError: it does not come in time.
        """

        def known() -> bool:
            return self._analysed == self._described and self._hard_squeal not in ("", hard_squeal.COMPUTING)

        self.wait_for(known, "the smallest hit of the set point", _HIT_TIMEOUT)
        hit, direction = self.state.smallest_hit, self.state.hit_direction
        if not hit > 0.0:
            raise NoHitError(f"there is no smallest hit here: the zone of the set point is {self.state.zone!r}")
        return hit, direction

    @property
    def description(self) -> RigDescription:
        """What the rig says of itself."""
        if self._description is None:
            raise ExperimentError("the rig has not described itself yet")
        return self._description

    def tell(self, event: RunEvent) -> None:
        """Publish what has happened, with the number of the sample that comes next."""
        coming = "none" if self._next_seq is None else self._next_seq % SEQ_MODULUS
        told = status(ERROR if event.failed else OK, "run", event.what, {**event.facts, "next sample": coming})
        self._events.publish(diagnostics(time.time_ns(), told))

    def wait_for_reader_of_events(self, timeout: float) -> None:
        """Wait until somebody reads what was told, at most so long [s]; everything told so far reaches them then."""
        deadline = time.monotonic() + timeout
        while self._events.get_subscription_count() == 0 and time.monotonic() < deadline:
            time.sleep(_SPIN)

    def sampled_time(self) -> float:
        """Time sampled since this node joined [s]."""
        return self._sampled

    def wait_until(self, sampled_time: float) -> None:
        """Spin until that much has been sampled; `ExperimentError` when samples stop coming."""
        last, moved = self.sampled_time(), time.monotonic()
        while (now := self.sampled_time()) < sampled_time:
            if now > last:
                last, moved = now, time.monotonic()
            elif time.monotonic() - moved > _STALL_TIMEOUT:
                raise ExperimentError(f"no block of samples came for {_STALL_TIMEOUT:g} s")
            self.spin()

    def _introduce(self, timeout: float) -> None:
        """Wait until the rig knows our clients.

        A server drops its answer where it has not found the client's reader yet, and a transition or a hit must not be
        asked for twice. Clients are found in the order in which they were made: the last one asks for nothing, until it
        has an answer.
        """
        self.wait_for(self._set.service_is_ready, f"service {self._set.srv_name}", timeout)
        asked, futures = -math.inf, []

        def answered() -> bool:
            nonlocal asked
            if time.monotonic() - asked > _ASK_AGAIN:
                asked = time.monotonic()
                futures.append(self._set.call_async(SetParametersAtomically.Request()))
            return any(future.done() for future in futures)

        self.wait_for(answered, f"an answer of {self._set.srv_name}", timeout)
        self._known = True

    def _answer(self, client: Any, request: Any, timeout: float = _SERVICE_TIMEOUT) -> Any:
        if not self._known:
            self._introduce(timeout)
        self.wait_for(client.service_is_ready, f"service {client.srv_name}", timeout)
        future = client.call_async(request)
        self.wait_for(future.done, f"the answer of {client.srv_name}", timeout)
        return future.result()

    # --- what comes

    def _on_daq(self, data: bytes) -> None:
        try:
            stamp, _, daq = block_from_cdr(data, DAQ_CHANNELS)
        except RecordingError:
            return  # the estimator counts and reports refused blocks
        if self._description is None:
            return  # it is latched, and how much time a block is stands in it
        rate, lost = self._description.sample_rate, self._numbering.lost_samples
        # A gap is believed as far as the stamps say so: else a number that jumps would end every wait.
        self._numbering.take(stamp, daq, rate)
        self._sampled += (len(daq) + self._numbering.lost_samples - lost) / rate
        self._next_seq = int(daq["seq"][0]) + len(daq)
        self.on_samples(daq)
        self.state.sampled_time = self.sampled_time()
        self.state.preload, self.state.belt_speed = float(daq["preload"][-1]), float(daq["belt_speed"][-1])

    def _on_window(self, data: bytes) -> None:
        try:
            window = block_from_cdr(data, FRICTION_WINDOW_NEEDED).samples[0]
        except RecordingError:
            return
        if self.keeps_windows:
            self.windows.append(window.copy())  # and not the whole message with it
        self.state.mu_estimated = float(window["mu"])
        self.state.mu_ratio_of_means = float(window["mu_ratio_of_means"])

    def _on_stability(self, message: DiagnosticArray) -> None:
        if not message.status:
            return
        statuses = {found.name: found for found in message.status}
        # What is in force, once samples have come.
        found = statuses.get(IN_FORCE, message.status[0])
        self.state.unstable = {"unstable": True, "stable": False}.get(found.message)
        self.state.mu_set = status_number(found, "mu")
        self.state.pad_stiffness = status_number(found, "k [N/m]")
        self.state.critical_stiffness = status_number(found, "k_cr [N/m]")
        self.state.margin = status_number(found, "margin")
        self._analysed = status_values(statuses[SET_POINT]).get(DESCRIPTION_KEY, "") if SET_POINT in statuses else ""
        hard = statuses.get(hard_squeal.NAME)
        values = {} if hard is None else status_values(hard)
        self._hard_squeal = values.get(hard_squeal.STATE_KEY, "")
        self.state.zone = values.get(hard_squeal.ZONE, self._hard_squeal)
        self.state.smallest_hit, self.state.hit_direction = (
            math.nan if hard is None else status_number(hard, key)
            for key in (hard_squeal.SMALLEST_HIT, hard_squeal.HIT_DIRECTION)
        )

    def _on_description(self, message: String) -> None:
        try:
            self._description = RigDescription.from_yaml(message.data)
        except SquealRigError:
            return  # every node that follows the rig tells it; what was good before stands
        self._described = text_crc(message.data)

    def _on_squeal(self, message: DiagnosticArray) -> None:
        for found in message.status[:1]:
            self.state.squealing = status_values(found).get("detected") == "true"
            self.state.level = status_number(found, "level [dB re 1 um]")
            self.state.frequency = status_number(found, "frequency [Hz]")

    def _on_supervisor(self, message: DiagnosticArray) -> None:
        for found in message.status[:1]:
            latched = status_values(found).get("latched", "ok")
            self.state.trip = "" if latched == "ok" else f"{latched}: {found.message}"

    def _on_health(self, message: DiagnosticArray) -> None:
        for found in message.status:
            name = own_name(self._node, found.name)
            if not name:
                continue
            if name in self.state.health or len(self.state.health) < _MOST_NAMES:
                self.state.health[name] = (int.from_bytes(found.level, "little"), found.message)
            if name == "recorder":
                self.state.recorded_bytes = status_number(found, "bytes")
                self.state.recorded = frozenset(status_values(found).get(HEARD, "").split(", "))
            if name == "rig":
                self.state.rig_state = status_values(found).get(STATE_KEY, "")
            for prefix, numbers in (
                (LISTENERS, self.state.listeners),
                (LAST_PUBLISHED, self.state.published),
                (LAST_TAKEN, self.state.taken),
            ):
                for key, value in status_values(found).items():
                    topic = key.removeprefix(prefix)
                    if topic != key and (topic in numbers or len(numbers) < _MOST_NAMES):
                        numbers[topic] = whole_number(value)
