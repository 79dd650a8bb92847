"""Node `player`: replays a rosbag2 MCAP bag with the recorded bytes, spacing and QoS."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Sequence
from functools import partial

from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rosgraph_msgs.msg import Clock

from squeal_rig.configuration.declared import Declared
from squeal_rig.errors import RecordingError, printable
from squeal_rig.graph import qos
from squeal_rig.graph.conversions import OK, WARN, time_message
from squeal_rig.graph.health import Health, HealthPublisher
from squeal_rig.graph.interfaces import message_class, replayed_qos
from squeal_rig.graph.lifetime import Lifetime, run_node
from squeal_rig.graph.parameters import NODE_OPTIONS, DeclaredParameters
from squeal_rig.graph.triggers import offer_trigger
from squeal_rig.recording import Bag, RawMessage
from squeal_rig.recording.replay import Beat, check_topic_name, matching_topics, remapped
from squeal_rig.recording.settings import PlayerSettings
from squeal_rig.recording.transport import Transport

_WAIT_STEP = 0.02
_CLOCK_PERIOD = 0.01
# Subscribers are found one after the other: all there were for this time [s] are taken for all there are.
_MATCHING = 0.5
# Fast DDS asks for what is missing every 3 s.
_ACKNOWLEDGE_TIMEOUT = 5.0
_CLOCK = "/clock"
_LONGEST_TOLD = 80  # of a name that is none


class PlayerNode(Node):
    """Publishes a bag's messages from a thread of its own; ends when the bag does."""

    def __init__(self, lifetime: Lifetime) -> None:
        super().__init__("player", **NODE_OPTIONS)
        self._lifetime = lifetime
        self._transport: Transport | None = None
        self._declared = DeclaredParameters(self, (PlayerSettings(),), refuse=self._refuse)
        settings = self._settings
        if not settings.bag:
            raise RecordingError("player: bag = '' names no bag: give the folder or .mcap file to play")
        self._bag = Bag(settings.bag)
        self._skipped: dict[str, str] = {}
        self._outputs = self._make_outputs()
        self._transport = Transport(
            self._bag, self._outputs, settings.rate, settings.max_rate * 1e6, settings.start_offset
        )
        self._transport.loop = settings.loop
        if settings.start_paused:
            self._transport.pause()
        self._clock_publisher = self.create_publisher(Clock, _CLOCK, qos.BLOCKS) if settings.clock else None
        self._clock_beat = Beat(_CLOCK_PERIOD)
        self._ending = threading.Event()
        self.add_post_set_parameters_callback(self._apply)
        for name, action in (("pause", self._pause), ("resume", self._resume), ("step", self._step)):
            offer_trigger(self, name, partial(self._on_transport, action))
        HealthPublisher(self, self._health)
        self.greeting = f"{'paused in' if settings.start_paused else 'playing'} {settings.bag}"
        self._thread = threading.Thread(target=self._play, name="player")
        self._thread.start()

    @property
    def _settings(self) -> PlayerSettings:
        settings: PlayerSettings = self._declared.group(PlayerSettings)
        return settings

    def _make_outputs(self) -> dict[str, Publisher]:
        """A publisher for each recorded topic that is played, by its recorded name."""
        settings, topics = self._settings, self._bag.topics
        chosen = matching_topics(topics, settings.topics)
        if settings.clock:
            chosen = [topic for topic in chosen if topic != _CLOCK]  # one source of time is enough
        names = remapped(chosen, settings.remap)
        outputs = {}
        for topic in chosen:
            try:
                if topics[topic].serialization_format != "cdr":
                    raise RecordingError(f"it is stored as {topics[topic].serialization_format!r}, not as cdr")
                check_topic_name(names[topic])
                kind = message_class(topics[topic].type_name)
            except RecordingError as error:
                name = printable(topic[:_LONGEST_TOLD])
                self._skipped[name] = str(error)
                self.get_logger().warning(f"{name} is not played: {error}")
                continue
            outputs[topic] = self.create_publisher(kind, names[topic], replayed_qos(topics[topic].qos))
        if not outputs:
            why = "; ".join(f"{topic}: {reason}" for topic, reason in self._skipped.items())
            raise RecordingError(
                f"player: no topic of {settings.bag} matches {', '.join(settings.topics)}"
                + (f" ({why})" if why else "")
            )
        return outputs

    # --- the thread

    def _play(self) -> None:
        assert self._transport is not None
        try:
            self._wait_for_subscribers()
            self._transport.run(self._publish, self._tick)
            self._wait_for_acknowledgement()
        except RecordingError as error:
            self.get_logger().error(str(error))
            self._lifetime.stop(1)
        except Exception as error:
            if not self._ending.is_set():  # a context that is being shut down refuses to publish
                self.get_logger().error(f"{type(error).__name__}: {error}")
                self._lifetime.stop(1)
        else:
            self.get_logger().info(f"played {self._transport.published} messages")
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

    def _publish(self, message: RawMessage) -> None:
        self._outputs[message.topic].publish(message.data)

    def _tick(self, log_time: int) -> float:
        if self._clock_beat.due(time.monotonic()) and self._clock_publisher is not None:
            self._clock_publisher.publish(Clock(clock=time_message(log_time)))
        return self._clock_beat.left(time.monotonic())

    # --- parameters and services

    def _refuse(self, name: str, _now: Declared, wanted: Declared) -> str | None:
        if name == "seek_to" and self._transport is not None and isinstance(wanted, PlayerSettings):
            try:
                self._transport.log_time("seek_to", wanted.seek_to)
            except RecordingError as error:
                return str(error)
        return None

    def _apply(self, changes: list[Parameter]) -> None:
        if self._transport is None:
            return
        for change in changes:
            if change.name == "seek_to":
                self._transport.seek(float(change.value))
            elif change.name == "rate":
                self._transport.set_rate(float(change.value))
            elif change.name == "loop":
                self._transport.loop = bool(change.value)

    def _pause(self, transport: Transport) -> str:
        transport.pause()
        return f"paused at {transport.position:.3f} s"

    def _resume(self, transport: Transport) -> str:
        transport.resume()
        return f"playing from {transport.position:.3f} s"

    def _step(self, transport: Transport) -> str:
        transport.step()
        return "the next message is played"

    def _on_transport(self, action: Callable[[Transport], str]) -> str:
        assert self._transport is not None
        return action(self._transport)

    def _health(self) -> Health:
        assert self._transport is not None
        transport = self._transport
        values = {
            "messages": transport.published,
            "of": sum(self._bag.topics[topic].message_count for topic in self._outputs),
            "position [s]": round(transport.position, 3),
            "loops": transport.loops,
            "fewest listeners": min(publisher.get_subscription_count() for publisher in self._outputs.values()),
            "worst lateness [ms]": round(transport.worst_lateness * 1e3, 3),
        }
        state = "paused" if transport.paused else "playing"
        if self._skipped:
            return WARN, f"{state}; not played: {', '.join(sorted(self._skipped))}", values
        return OK, state, values

    def close(self) -> None:
        """Stop playing."""
        self._ending.set()
        if self._transport is not None:
            self._transport.stop()
        self._thread.join()


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; returns the exit code."""
    return run_node(PlayerNode, args)


if __name__ == "__main__":
    sys.exit(main())
