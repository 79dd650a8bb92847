"""Every node's health on `/diagnostics`, once a second."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node

from squeal_rig.graph import qos
from squeal_rig.graph.conversions import ERROR, OK, WARN, diagnostics, status
from squeal_rig.graph.lifetime import STEADY, GuardedExecutor, described

#: (level, message, values) of a node's health.
Health = tuple[bytes, str, Mapping[str, Any]]


#: Key of a health value, before a topic: subscriptions of it that no message is lost for from now on. A follower of the
#: rig that samples have stopped coming to has two for a while.
LISTENERS = "listeners to "

#: Key of the recorder's health value: the topics of whose publishers it knows.
HEARD = "heard"
#: Keys of health values, before a topic of blocks: the publisher's number, from 1, of the last one that the rig has
#: published, and that the recorder has taken.
LAST_PUBLISHED, LAST_TAKEN = "last published of ", "last taken of "


def own_name(node: Node, name: str) -> str:
    """Name of a node of our namespace, from that of a status on `/diagnostics`; empty for those of other rigs."""
    namespace = node.get_namespace().strip("/")
    prefix = f"{namespace}/" if namespace else ""
    own = name.removeprefix(prefix)
    return own if name.startswith(prefix) and "/" not in own else ""


def listeners(publishers: Mapping[str, Any]) -> dict[str, int]:
    """Health values: how many subscribers each publisher, by its topic, counts itself.

    The graph knows of a subscriber before a publisher does: who must have the first message waits for this count.
    """
    return {LISTENERS + topic: publisher.get_subscription_count() for topic, publisher in publishers.items()}


class HealthPublisher:
    """Publishes a node's health once a second of real time, whatever `/clock` does."""

    def __init__(self, node: Node, health: Callable[[], Health]) -> None:
        self._node = node
        self._health = health
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", qos.EVENTS)
        node.create_timer(1.0, self.publish, clock=STEADY)

    def publish(self) -> None:
        """Publish now."""
        try:
            level, message, values = self._health()
        except Exception as error:
            level, message, values = ERROR, f"the health is not known: {described(error)}", {}
        executor = self._node.executor
        if isinstance(executor, GuardedExecutor):
            values = {**values, "refused requests": executor.refused_requests, "errors": executor.errors}
            if failure := executor.untold_error():
                level, message = ERROR, failure
            elif level == OK and (refusal := executor.untold_refusal()):  # it waits until nothing worse is to be told
                level, message = WARN, refusal
        name = self._node.get_fully_qualified_name().lstrip("/")
        stamp = self._node.get_clock().now().nanoseconds
        self._publisher.publish(diagnostics(stamp, status(level, name, message, values)))
