"""The node that sends what `graph` has drawn; the only part of the suite that imports ROS."""

import json
import time
from contextlib import suppress

from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.msg import Parameter, ParameterEvent, ParameterValue
from rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    GetParameterTypes,
    ListParameters,
    SetParameters,
    SetParametersAtomically,
)
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.qos import QoSProfile
from rosgraph_msgs.msg import Clock
from std_srvs.srv import SetBool, Trigger

from squeal_rig.graph import qos
from squeal_rig.graph.interfaces import message_class
from tests.graph.observer import Observer

from .graph import SUBSCRIBED

RCLError = rclpy_implementation.RCLError
_LATCHED = ("/rig/description", "/friction/model", "/stability/summary")
_SCALARS = ("bool", "integer", "double", "string")
_ARRAYS = ("byte", "bool", "integer", "double", "string")
_FIELDS = dict(enumerate([*(f"{k}_value" for k in _SCALARS), *(f"{k}_array_value" for k in _ARRAYS)], 1))
_SERVICES = {
    "set": (SetParameters, "set_parameters"),
    "set_atomically": (SetParametersAtomically, "set_parameters_atomically"),
    "get": (GetParameters, "get_parameters"),
    "get_types": (GetParameterTypes, "get_parameter_types"),
    "describe": (DescribeParameters, "describe_parameters"),
    "list": (ListParameters, "list_parameters"),
    "transition": (ChangeState, "change_state"),
    "pause": (SetBool, "pause"),
    "trigger": (Trigger, ""),
}


class Talker(Observer):
    """Publishes bytes, calls services without waiting, and keeps the futures until they are asked for."""

    def __init__(self, domain):
        super().__init__(domain)
        self.health = self.follow("/diagnostics")
        self._outputs = {}
        self._asked = []
        for topic, kind in SUBSCRIBED.items():
            profile = qos.LATCHED if topic in _LATCHED else QoSProfile(depth=100)
            self._outputs[topic] = self.node.create_publisher(message_class(kind), topic, profile)

    def publish(self, topic, data):
        """Publish a message, or the bytes of one; our own middleware may refuse to send them, then nobody gets them."""
        with suppress(RCLError):
            self._outputs[topic].publish(data)

    def act(self, name, data):
        """Do what an action of a case says; a moment is left, so that not all fall into one round of a node."""
        how, whom = (*name.split(" ", 1), "")[:2]
        if how == "publish":
            self.publish(whom, data)
        else:
            arguments = json.loads(data)
            if how == "clock":
                message = Clock()
                message.clock.sec, message.clock.nanosec = arguments
                self.publish("/clock", message)
            elif how == "event":
                self.publish("/parameter_events", ParameterEvent(node=whom, changed_parameters=_parameters(arguments)))
            else:
                self._ask(how, whom, arguments)
        self.spin(0.005)

    def _ask(self, how, whom, arguments):
        kind, service = _SERVICES[how]
        request, name = kind.Request(), f"{whom}/{service}" if service else whom
        if how in ("set", "set_atomically"):
            request.parameters = _parameters(arguments)
        elif how in ("get", "get_types", "describe"):
            request.names = arguments
        elif how == "list":
            request.depth, request.prefixes = arguments
        elif how == "transition":
            request.transition = Transition(id=arguments[0], label=arguments[1])
        elif how == "pause":
            request.data = arguments
        if name not in self._clients:
            self._clients[name] = self.node.create_client(kind, name)
            self.wait_for(self._clients[name].service_is_ready, f"service {name}")
            self._introduce(whom.partition("/")[0], 60.0)
        self._asked.append((name, self._clients[name].call_async(request)))

    def unanswered(self, seconds):
        """Services that have not answered all requests in that time."""
        end = time.monotonic() + seconds
        while time.monotonic() < end and not all(future.done() for _, future in self._asked):
            self._executor.spin_once(timeout_sec=0.02)
        names = sorted({name for name, future in self._asked if not future.done()})
        self._asked = []
        return names

    def cure(self, values):
        """Bring the rig back to work."""
        for number in (4, 1):  # deactivate: the constants may change; configure where nobody has
            self._ask("transition", "rig", [number, ""])
        self._ask("set_atomically", "rig", [(name, 3, value) for name, value in values.items()])
        self._ask("transition", "rig", [3, ""])
        self._ask("pause", "rig", False)
        self._ask("trigger", "rig/reset", None)
        self.unanswered(20.0)


def _parameters(settings):
    messages = []
    for name, kind, value in settings:
        message = ParameterValue(type=kind)
        if kind in _FIELDS:
            setattr(message, _FIELDS[kind], [bytes([item]) for item in value] if kind == 5 else value)
        messages.append(Parameter(name=name, value=message))
    return messages
