"""Subscribes raw to wanted topics as they appear in the graph, with a request that every publisher meets."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.exceptions import NameValidationException
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.qos import QoSProfile

from squeal_rig.errors import RecordingError
from squeal_rig.graph.interfaces import message_class, offered_qos, requested_qos
from squeal_rig.graph.lifetime import STEADY
from squeal_rig.recording import QosProfile
from squeal_rig.recording.replay import matching_topics

_DISCOVERY_PERIOD = 0.1
_ADAPT_EVERY = 10  # rounds of discovery

Taken = Callable[[bytes, Any], None]


@dataclass
class _Topic:
    type_name: str
    taken: Taken
    request: QoSProfile
    subscription: Any = field(init=False)


def waiting(subscription: Any) -> Iterator[tuple[bytes, Any]]:
    """Take from a raw subscription what has arrived, message by message: the bytes, and what the middleware says."""
    while True:
        with subscription.handle:
            taken = subscription.handle.take_message(subscription.msg_type, True)
        if taken is None:
            return
        yield taken


class TopicSubscriptions:
    """Follows the graph.

    `found` is called with (topic, type, offered QoS) for a topic that is new, and returns what takes its messages; it
    may raise RecordingError, which puts the topic into `unknown` with the reason, until it is found otherwise. A
    publisher that comes later with another type does so too: only what has the first type is taken. `lost` counts
    messages that the middleware says it dropped.
    """

    def __init__(
        self, node: Node, patterns: Sequence[str], found: Callable[[str, str, list[QosProfile]], Taken]
    ) -> None:
        self._node = node
        self._found = found
        self._patterns = [p if "*" in p or "?" in p else node.resolve_topic_name(p) for p in patterns]
        self._topics: dict[str, _Topic] = {}
        self._round = 0
        self.unknown: dict[str, str] = {}
        self.lost = 0
        node.create_timer(_DISCOVERY_PERIOD, self.discover, clock=STEADY)

    def __len__(self) -> int:
        return len(self._topics)

    @property
    def heard(self) -> list[str]:
        """Topics whose publishers the subscription has found itself: it gets what they publish from now on."""
        return sorted(name for name, topic in self._topics.items() if topic.subscription.get_publisher_count() > 0)

    def discover(self) -> None:
        """Subscribe to wanted topics that have a publisher by now."""
        self._round += 1
        present = self._node.get_topic_names_and_types()
        names = [name for name, _ in present]
        wanted = names if "*" in self._patterns else set(matching_topics(names, self._patterns))
        again = self._round % _ADAPT_EVERY == 0
        for topic, _ in present:
            known = self._topics.get(topic)
            # What could not be recorded is looked at again: a publisher of another type may have gone.
            if topic not in wanted or (not again and (known is not None or topic in self.unknown)):
                continue
            publishers = self._node.get_publishers_info_by_topic(topic)
            types = sorted({end.topic_type for end in publishers})
            if known is None:
                if publishers:
                    self._begin(topic, types, [offered_qos(end) for end in publishers])
                continue
            if own := [offered_qos(end) for end in publishers if end.topic_type == known.type_name]:
                self._adapt(topic, known, own)
            if len(own) == len(publishers):
                self.unknown.pop(topic, None)
            else:
                self._refuse(topic, f"it was {known.type_name} and is published as {', '.join(types)} now")

    def _begin(self, topic: str, types: Sequence[str], offered: list[QosProfile]) -> None:
        try:
            if len(types) > 1:
                raise RecordingError(f"it has several types: {', '.join(types)}")
            message_class(types[0])
            known = _Topic(types[0], self._found(topic, types[0], offered), requested_qos(offered))
            self._subscribe(topic, known)
        except (RecordingError, NameValidationException, rclpy_implementation.RCLError) as error:
            self._refuse(topic, str(error))
            return
        self.unknown.pop(topic, None)
        self._topics[topic] = known

    def _refuse(self, topic: str, reason: str) -> None:
        if self.unknown.get(topic) != reason:
            self.unknown[topic] = reason
            self._node.get_logger().warning(f"{topic} is not recorded: {reason}")

    def _adapt(self, topic: str, known: _Topic, offered: list[QosProfile]) -> None:
        """Ask for less where a publisher that came later offers less; never for more."""
        request = requested_qos(offered)
        now = known.request
        if (request.reliability, request.durability) == (now.reliability, now.durability):
            return
        if request.reliability > now.reliability or request.durability > now.durability:  # a larger number is weaker
            self._node.get_logger().info(f"{topic}: asking for less, since a new publisher offers less")
            for data, info in waiting(known.subscription):  # it would go with the subscription
                known.taken(data, info)
            self._node.destroy_subscription(known.subscription)
            del self._topics[topic]
            known.request = request
            self._subscribe(topic, known)
            self._topics[topic] = known

    def _subscribe(self, topic: str, known: _Topic) -> None:
        known.subscription = self._node.create_subscription(
            message_class(known.type_name),
            topic,
            known.taken,
            known.request,
            raw=True,
            # An executor looks at every event before each message: none but this one, not even those that warn.
            event_callbacks=SubscriptionEventCallbacks(message_lost=self._on_lost, use_default_callbacks=False),
        )

    def drain(self, until: int) -> None:
        """Take of every topic what has arrived by a time [ns]."""
        for topic in self._topics.values():
            for data, info in waiting(topic.subscription):
                topic.taken(data, info)
                if (info["received_timestamp"] or 0) > until:
                    break

    def _on_lost(self, info: Any) -> None:
        self.lost += info.total_count_change
