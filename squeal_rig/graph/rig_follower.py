"""Following the rig: its description, and its parameters as they change. No second copy to keep equal by hand."""

from __future__ import annotations

from collections.abc import Callable

from rcl_interfaces.msg import ParameterEvent
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from rclpy.qos import qos_profile_parameter_events
from std_msgs.msg import String

from squeal_rig.configuration.declared import declarations
from squeal_rig.errors import SquealRigError
from squeal_rig.graph import qos
from squeal_rig.instruments.description import RigDescription
from squeal_rig.model.parameters import RigParameters

_RIG_NODE = "rig"


class RigFollower:
    """Calls back with the rig's description whenever it changes.

    Args:
        node: the node that follows; the rig is the node `rig` of its namespace.
        changed: called with every new description.
        events: follow `/parameter_events` too, which tell a change before the description does.
    """

    def __init__(self, node: Node, changed: Callable[[RigDescription], None], events: bool = False) -> None:
        self._node = node
        self._changed = changed
        self.description: RigDescription | None = None
        node.create_subscription(String, "rig/description", self._on_description, qos.LATCHED)
        if events:
            namespace = node.get_namespace().rstrip("/")
            self._rig = f"{namespace}/{_RIG_NODE}"
            node.create_subscription(ParameterEvent, "/parameter_events", self._on_event, qos_profile_parameter_events)

    def _on_description(self, message: String) -> None:
        try:
            self._take(RigDescription.from_yaml(message.data))
        except SquealRigError as error:
            self._node.get_logger().error(str(error))

    def _on_event(self, event: ParameterEvent) -> None:
        if event.node != self._rig or self.description is None:
            return
        known = declarations(RigParameters)
        changes = {
            parameter.name: parameter_value_to_python(parameter.value)
            for parameter in event.changed_parameters
            if parameter.name in known
        }
        if not changes:
            return
        try:
            self._take(self.description.with_parameters(changes))
        except SquealRigError as error:
            self._node.get_logger().error(str(error))

    def _take(self, description: RigDescription) -> None:
        if description != self.description:
            self.description = description
            self._changed(description)
