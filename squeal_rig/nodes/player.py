"""Node `player`: replays a rosbag2 MCAP bag with the recorded bytes, spacing and QoS."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Sequence
from itertools import chain

from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rosgraph_msgs.msg import Clock

from squeal_rig.errors import RecordingError
from squeal_rig.nodes import qos
from squeal_rig.nodes.conversions import OK, time_message
from squeal_rig.nodes.health import Health, HealthPublisher
from squeal_rig.nodes.interfaces import message_class, replayed_qos
from squeal_rig.nodes.lifetime import Lifetime, run_node
from squeal_rig.nodes.parameters import NODE_OPTIONS, DeclaredParameters
from squeal_rig.recording import Bag, RawMessage
from squeal_rig.recording.replay import ReplaySchedule, matching_topics
from squeal_rig.recording.settings import PlayerSettings

_WAIT_STEP = 0.02
_CLOCK_PERIOD = 0.01
# Subscribers are found one after the other: all there were for this time [s] are taken for all there are.
_MATCHING = 0.5
_ACKNOWLEDGE_TIMEOUT = 2.0


class PlayerNode(Node):
    """Publishes a bag's messages from a thread of its own; ends when the bag does."""

    def __init__(self, lifetime: Lifetime) -> None:
        super().__init__("player", **NODE_OPTIONS)
        self._lifetime = lifetime
        self._settings: PlayerSettings = DeclaredParameters(self, (PlayerSettings(),)).group(PlayerSettings)
        if not self._settings.bag:
            raise RecordingError("player: bag is empty: give the folder or .mcap file to play")
        self._bag = Bag(self._settings.bag)
        topics = matching_topics(self._bag.topics, self._settings.topics)
        if not topics:
            raise RecordingError(f"player: no topic of {self._settings.bag} matches {', '.join(self._settings.topics)}")
        self._outputs: dict[str, Publisher] = {
            topic: self.create_publisher(
                message_class(self._bag.topics[topic].type_name),
                topic,
                replayed_qos(self._bag.topics[topic].qos),
            )
            for topic in topics
        }
        self._clock_publisher = self.create_publisher(Clock, "/clock", qos.BLOCKS) if self._settings.clock else None
        self._clock_published = -1.0
        self._published = 0
        self._ending = threading.Event()
        HealthPublisher(self, self._health)
        self._thread = threading.Thread(target=self._play, name="player")
        self._thread.start()

    def _play(self) -> None:
        try:
            self._wait_for_subscribers()
            self._publish_all()
            self._wait_for_acknowledgement()
        except RecordingError as error:
            self.get_logger().error(str(error))
            self._lifetime.stop(1)
        else:
            self.get_logger().info(f"played {self._published} messages")
            self._lifetime.stop()

    def _wait_for_subscribers(self) -> None:
        """Wait until every topic has all the subscribers that the graph knows of, one at least, and for a while."""
        if self._settings.wait_for_subscribers == 0.0:
            return
        deadline = time.monotonic() + self._settings.wait_for_subscribers
        complete: float | None = None
        while (now := time.monotonic()) < deadline and not self._ending.wait(_WAIT_STEP):
            counts = {topic: publisher.get_subscription_count() for topic, publisher in self._outputs.items()}
            if any(count < max(1, self.count_subscribers(topic)) for topic, count in counts.items()):
                complete = None
            elif complete is None:
                complete = now
            elif now - complete >= _MATCHING:
                return
        for topic, publisher in self._outputs.items():
            if publisher.get_subscription_count() == 0:
                self.get_logger().warning(f"no subscriber to {topic}: playing without")

    def _wait_for_acknowledgement(self) -> None:
        """Give the last messages time to arrive; a subscriber that hangs must not keep us when we are to end."""
        deadline = time.monotonic() + _ACKNOWLEDGE_TIMEOUT
        for publisher in self._outputs.values():
            while time.monotonic() < deadline and not (self._ending.is_set() or self._lifetime.stopping):
                if publisher.wait_for_all_acked(Duration(seconds=_WAIT_STEP)):
                    break

    def _publish_all(self) -> None:
        messages = self._bag.messages(list(self._outputs))
        first = next(messages, None)
        if first is None:
            return
        schedule = ReplaySchedule(first.log_time, self._settings.rate, self._settings.max_rate * 1e6)
        start = time.monotonic()
        for message in chain((first,), messages):
            due = start + schedule.due(message.log_time, len(message.data))
            if self._ending.wait(max(0.0, due - time.monotonic())) or self._lifetime.stopping:
                return
            self._publish(message)

    def _publish(self, message: RawMessage) -> None:
        now = time.monotonic()
        if self._clock_publisher is not None and now - self._clock_published >= _CLOCK_PERIOD:
            self._clock_published = now
            self._clock_publisher.publish(Clock(clock=time_message(message.log_time)))
        self._outputs[message.topic].publish(message.data)
        self._published += 1

    def _health(self) -> Health:
        return OK, "playing", {"messages": self._published, "of": self._bag.message_count}

    def close(self) -> None:
        """Stop playing."""
        self._ending.set()
        self._thread.join()


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; returns the exit code."""
    return run_node(PlayerNode, args)


if __name__ == "__main__":
    sys.exit(main())
