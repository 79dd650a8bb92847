"""The test's own node: sees topics, sets parameters, calls services, waits on conditions."""

import math
import time
from collections import deque
from contextlib import contextmanager

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.msg import ParameterEvent
from rcl_interfaces.srv import GetParameters, SetParameters, SetParametersAtomically
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.qos import qos_profile_parameter_events
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Float64, Float64MultiArray, String, UInt8
from std_srvs.srv import SetBool, Trigger

from squeal_rig.graph import qos
from squeal_rig.graph.leaving import leave_graph
from squeal_rig.instruments.description import RigDescription
from squeal_rig.recording import samples_from_cdr

from . import PATIENCE
from .statuses import health_of

_TRANSITIONS = {
    "configure": Transition.TRANSITION_CONFIGURE,
    "activate": Transition.TRANSITION_ACTIVATE,
    "deactivate": Transition.TRANSITION_DEACTIVATE,
    "cleanup": Transition.TRANSITION_CLEANUP,
    "shutdown": Transition.TRANSITION_ACTIVE_SHUTDOWN,
}
_REPEAT = 2.0
_UNHEARD = 5.0
# A transition that opens the model compiles it where its sources have changed; that takes tens of seconds.
_COMPILING = 600.0
_TOPICS = {
    "rig/description": (String, qos.LATCHED),
    "daq/samples": (PointCloud2, qos.BLOCKS),
    "truth/samples": (PointCloud2, qos.BLOCKS),
    "friction/windows": (PointCloud2, qos.EVENTS),
    "friction/mu": (Float64, qos.EVENTS),
    "friction/model": (Float64MultiArray, qos.LATCHED),
    "friction/samples": (PointCloud2, qos.BLOCKS),
    "stability/summary": (DiagnosticArray, qos.LATCHED),
    "stability/eigenvalues": (Float64MultiArray, qos.LATCHED),
    "squeal/state": (DiagnosticArray, qos.EVENTS),
    "rig/safe": (DiagnosticArray, qos.LATCHED),
    "emergency_stop": (String, qos.EVENTS),
    "supervisor/state": (DiagnosticArray, qos.LATCHED),
    "supervisor/trips": (DiagnosticArray, qos.RUN_EVENTS),
    "supervisor/heartbeat": (UInt8, qos.HEARTBEAT),
    "/diagnostics": (DiagnosticArray, qos.EVENTS),
    "/parameter_events": (ParameterEvent, qos_profile_parameter_events),
}


class Observer:
    """A node in the test's process. Messages are kept, newest last, at most `depth` a topic."""

    def __init__(self, domain):
        self.context = rclpy.Context()
        rclpy.init(args=[], context=self.context, domain_id=domain, signal_handler_options=SignalHandlerOptions.NO)
        self.node = Node("observer", context=self.context, start_parameter_services=False, enable_rosout=False)
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self.node)
        self._clients = {}
        self._followed = []

    def close(self):
        leave_graph(self._executor, self.node)
        self.context.try_shutdown()

    # --- waiting

    def wait_for(self, condition, what, timeout=PATIENCE):
        """Spin until the condition holds; returns its value. Fails after `timeout` [s], and says what was awaited.

        `what` may be a function, for what is known only then.
        """
        deadline = time.monotonic() + timeout
        while not (value := condition()):
            assert time.monotonic() < deadline, f"{what() if callable(what) else what}: not within {timeout:g} s"
            self._executor.spin_once(timeout_sec=0.02)
        return value

    def wait_for_end(self, child, timeout=PATIENCE):
        """Exit code of a child process, once it has ended."""
        self.wait_for(lambda: not child.running, "the end of the process", timeout)
        return child.wait()

    def spin(self, seconds):
        """Take what comes for a time during which something must not happen [s]."""
        deadline = time.monotonic() + seconds
        while (left := deadline - time.monotonic()) > 0.0:
            self._executor.spin_once(timeout_sec=left)

    def wait_for_listeners(self, topic, count, node="rig"):
        """Wait until a node itself counts that many listeners to a topic of samples: it loses no block for them."""
        with self.following_for_a_while():
            health = self.follow("/diagnostics")

            def listeners():
                found = health_of(health, node.lstrip("/"))
                return found and int(found[2][f"listeners to {topic}"]) >= count

            self.wait_for(listeners, f"{count} listeners to {topic}")

    # --- topics

    def follow(self, topic, depth=1000, raw=False):
        """Everything that comes on a topic from now on: a deque of messages, of bytes where `raw`."""
        messages = deque(maxlen=depth)
        self.listen(topic, _taken_by(messages), raw)
        return messages

    def listen(self, topic, take, raw=False):
        """Call `take` with everything that comes on a topic from now on; returns the subscription."""
        kind, profile = _kind_and_profile(topic)
        return self._subscribe(kind, topic, take, profile, raw)

    def follow_samples(self, topic, depth=1000):
        """Blocks of samples from now on: a deque of (stamp [ns], frame, structured array)."""
        blocks = deque(maxlen=depth)
        self._subscribe(PointCloud2, topic, lambda data: blocks.append(samples_from_cdr(data)), qos.BLOCKS_IN, True)
        return blocks

    @contextmanager
    def following_for_a_while(self):
        """End what is followed from here on with the block: every subscription makes all others slower."""
        before = list(self._followed)
        try:
            yield
        finally:
            for subscription in self._followed[len(before) :]:
                self.node.destroy_subscription(subscription)
            self._followed = before

    def _subscribe(self, kind, topic, take, profile, raw):
        subscription = self.node.create_subscription(kind, topic, take, profile, raw=raw)
        self._followed.append(subscription)
        return subscription

    def publisher(self, topic):
        """A publisher with the type and the QoS of the rig's own."""
        kind, profile = _kind_and_profile(topic)
        return self.node.create_publisher(kind, topic, profile)

    def first(self, topic, timeout=PATIENCE):
        """The next message of a topic, or the latched one."""
        with self.following_for_a_while():
            messages = self.follow(topic)
            return self.wait_for(lambda: messages and messages[-1], f"a message on {topic}", timeout)

    def description(self, rig="rig"):
        """The rig's description as it is latched now."""
        namespace = rig[: -len("rig")]
        return RigDescription.from_yaml(self.first(f"{namespace}rig/description").data)

    # --- services

    def call(self, kind, name, request, timeout=PATIENCE, repeat=None):
        """Answer of a service; asked again every `repeat` seconds, where asking twice does no harm.

        A server that was killed counts as ready for some seconds.
        """
        client = self._clients.get(name)
        if client is None:
            client = self._clients[name] = self.node.create_client(kind, name)
            node = name.rpartition("/")[0]
            if node:
                self._introduce(node, timeout)
        return self._answer(client, request, timeout, repeat)

    def _introduce(self, node, timeout):
        """Wait until a node knows every client that we have made so far.

        A server drops its answer where it has not yet found the client's ear for it. We are found in the order in
        which we make things, so a client made after all others that gets an answer vouches for them.
        """
        last = self.node.create_client(GetParameters, f"{node}/get_parameters")
        self._answer(last, GetParameters.Request(), timeout, _REPEAT)
        self.node.destroy_client(last)

    def _answer(self, client, request, timeout, repeat):
        name = client.srv_name
        self.wait_for(client.service_is_ready, f"service {name}", timeout)
        asked, futures = -math.inf, []

        def answered():
            nonlocal asked
            if not futures or (repeat is not None and time.monotonic() - asked > repeat):
                asked = time.monotonic()
                futures.append(client.call_async(request))
            return next((future for future in futures if future.done()), None)

        return self.wait_for(answered, f"the answer of {name}", timeout).result()

    def trigger(self, name, rig="rig", timeout=PATIENCE):
        """(success, message) of one of the rig's trigger services."""
        answer = self.call(Trigger, f"{rig}/{name}", Trigger.Request(), timeout)
        return answer.success, answer.message

    def pause(self, on, rig="rig"):
        """(success, message) of the rig's pause service."""
        answer = self.call(SetBool, f"{rig}/pause", SetBool.Request(data=on))
        return answer.success, answer.message

    def transition(self, name, rig="rig"):
        """Take the rig through a lifecycle transition; returns whether it went.

        Asked again where the state shows that nobody heard it, as after the rig was killed and started anew.
        """
        request = ChangeState.Request(transition=Transition(id=_TRANSITIONS[name]))
        begin = self.state(rig)
        while True:
            try:
                return self.call(ChangeState, f"{rig}/change_state", request, _UNHEARD).success
            except AssertionError:
                # Answered after a transition that is under way.
                if self.state(rig) != begin:
                    return True

    def state(self, rig="rig"):
        """Name of the rig's lifecycle state."""
        return self.call(GetState, f"{rig}/get_state", GetState.Request(), _COMPILING, _REPEAT).current_state.label

    # --- parameters

    def set(self, values, node="rig", atomically=False, timeout=PATIENCE):
        """Set parameters; returns (successful, reason) of each, of the whole where `atomically`."""
        messages = [
            value if hasattr(value, "value") else Parameter(name, value=value).to_parameter_msg()
            for name, value in values.items()
        ]
        if atomically:
            kind, service = SetParametersAtomically, "set_parameters_atomically"
            request = kind.Request(parameters=messages)
            result = self.call(kind, f"{node}/{service}", request, timeout, repeat=_REPEAT).result
            return [(result.successful, result.reason)]
        request = SetParameters.Request(parameters=messages)
        results = self.call(SetParameters, f"{node}/set_parameters", request, timeout, repeat=_REPEAT).results
        return [(result.successful, result.reason) for result in results]

    def get(self, names, node="rig"):
        """Values of parameters by name, as the node's parameter service tells them."""
        request = GetParameters.Request(names=list(names))
        values = self.call(GetParameters, f"{node}/get_parameters", request, repeat=_REPEAT).values
        return dict(zip(names, map(parameter_value_to_python, values), strict=True))


def _taken_by(messages):
    # rclpy looks at a callback's signature, and a built-in's append has none.
    def take(message):
        messages.append(message)

    return take


def _kind_and_profile(topic):
    return _TOPICS[topic if topic in _TOPICS else "/".join(topic.split("/")[-2:])]
