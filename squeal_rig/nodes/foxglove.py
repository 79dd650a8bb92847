"""Node `foxglove`: the graph's topics, the rig's parameters and services for Foxglove, over its own protocol."""

from __future__ import annotations

import asyncio
import contextlib
import json
import re
import secrets
import sys
import time
from collections.abc import Sequence
from concurrent.futures import Future
from concurrent.futures import TimeoutError as FutureTimeoutError
from dataclasses import dataclass
from typing import Any

import numpy as np
from foxglove import Channel, Context, Schema, set_log_level, start_server
from foxglove.channels import RawAudioChannel
from foxglove.messages import RawAudio, Timestamp
from foxglove.websocket import (
    Capability,
    MessageSchema,
    Parameter,
    ServerListener,
    Service,
    ServiceRequest,
    ServiceSchema,
)
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy

from squeal_rig.errors import RecordingError, SquealRigError
from squeal_rig.graph.conversions import ERROR
from squeal_rig.graph.health import Health, HealthPublisher
from squeal_rig.graph.interfaces import message_class, offered_qos, requested_qos
from squeal_rig.graph.lifetime import STEADY, Lifetime, run_node
from squeal_rig.graph.operator import Operator
from squeal_rig.graph.parameter_watch import ParameterWatch, Values
from squeal_rig.graph.parameters import NODE_OPTIONS, DeclaredParameters
from squeal_rig.graph.rig_follower import RigFollower
from squeal_rig.instruments.description import RigDescription
from squeal_rig.instruments.driver import Samples
from squeal_rig.page.access import Access, in_url, read_token
from squeal_rig.page.commands import EMERGENCY_STOP, PLAIN, Command, RefusedError, command_of
from squeal_rig.page.gate import Gate
from squeal_rig.page.settings import FoxgloveSettings
from squeal_rig.recording import installed_schema
from squeal_rig.recording.cdr import CdrWriter
from squeal_rig.recording.replay import matching_topics
from squeal_rig.view.sound import WithoutOffset

_LOOK_EVERY = 0.5
_ANSWER_TIMEOUT = 75.0  # longer than the operator waits for anything
_SET_TIMEOUT = 0.5  # nothing else of a client is read for so long [s] while its parameters are set
_AUDIO = "pad/sound"
_FULL_SCALE = 20e-6  # displacement [m] that is full scale of the sound
_TRIGGER = "std_srvs/srv/Trigger"


@dataclass
class _Topic:
    channel: Channel
    type_name: str
    latched: bool = False
    subscription: Any = None
    last: tuple[bytes, int] | None = None  # what is latched, and when it came [ns]


class FoxgloveNode(Node, ServerListener):
    """Passes on what somebody has subscribed to, and no more.

    The library's server checks neither origin nor token: it listens on a loopback address that nobody can guess, and a
    `Gate` stands before it.
    """

    def __init__(self, lifetime: Lifetime) -> None:
        super().__init__("foxglove", **NODE_OPTIONS)
        settings = DeclaredParameters(self, (FoxgloveSettings(),)).group(FoxgloveSettings)
        token = read_token(settings.token_file) if settings.token_file else ""
        access = Access(settings.address, token, settings.hosts, settings.origins)
        self._control, self._patterns = settings.control, settings.topics
        self._operator = Operator(self)
        self._values: dict[str, Any] = {}
        self._unanswered: list[Future[None]] = []  # settings of parameters
        self._topics: dict[str, _Topic] = {}
        self._unknown: set[str] = set()
        self._passed = 0
        self._sampled: tuple[int, WithoutOffset] | None = None
        self._sinks = Context()
        set_log_level("ERROR")
        self._sound = RawAudioChannel(self.resolve_topic_name(_AUDIO), context=self._sinks)
        self._rig_name = f"{self.get_namespace().rstrip('/')}/rig"
        names = PLAIN if settings.control else (EMERGENCY_STOP,)
        # 127.0.0.0/8 is this machine: of 2^24 addresses and as many ports as there are, no web page finds this one.
        hidden = "127." + ".".join(str(1 + secrets.randbelow(254)) for _ in range(3))
        self._server = start_server(
            name="squeal_rig",
            host=hidden,
            port=0,
            capabilities=[Capability.Parameters, Capability.Services],
            server_listener=self,
            supported_encodings=["cdr"],
            services=[Service(f"/squeal_rig/{name}", schema=_trigger(), handler=self._serve) for name in names],
            context=self._sinks,
            message_backlog_size=1024,
        )
        self._gate = Gate(access, (hidden, self._server.port), self.get_logger().warning)
        self._gate.start(settings.address, settings.port)
        self._rig = RigFollower(self, self._on_rig, self._on_block)
        self._watch = ParameterWatch(self, self._on_parameters, self._on_parameters)
        self.create_timer(_LOOK_EVERY, self._look, clock=STEADY)
        HealthPublisher(self, self._health)
        shown = in_url(settings.address)
        self.greeting = f"Foxglove connects to ws://{shown}:{self._gate.port}"

    def close(self) -> None:
        """End both servers."""
        self._gate.close()
        self._server.stop()

    def _health(self) -> Health:
        if self._gate.failure:
            return ERROR, self._gate.failure, self._counts()
        return self._rig.health(self._counts())

    def _counts(self) -> dict[str, Any]:
        taken = sum(topic.subscription is not None for topic in self._topics.values())
        return {
            "connections": self._gate.connections,
            "refused": self._gate.refused,
            "topics": len(self._topics),
            "topics subscribed to": taken,
            "messages passed on": self._passed,
        }

    # --- topics

    def _look(self) -> None:
        """Offer topics that are new; subscribe to those that somebody wants, and leave those that nobody does."""
        present = dict(self.get_topic_names_and_types())
        names = list(present)
        wanted = names if "*" in self._patterns else matching_topics(names, [*self._patterns])
        for name in wanted:
            known = self._topics.get(name)
            if known is not None and present[name] == [known.type_name]:
                continue
            published = {end.topic_type for end in self.get_publishers_info_by_topic(name)}
            if known is not None and published and known.type_name not in published:
                self._withdraw(name, known)
                known = None
            if known is None:
                # Who listens for another type does no harm; where nobody publishes yet, all count.
                self._offer(name, sorted(published or present[name]))
        for name, topic in self._topics.items():
            if topic.channel.has_sinks() and topic.subscription is None:
                self._subscribe(name, topic)
            elif not topic.channel.has_sinks() and topic.subscription is not None:
                self.destroy_subscription(topic.subscription)
                topic.subscription = None
                topic.last = None  # it is not followed any more

    def _offer(self, name: str, types: Sequence[str]) -> None:
        try:
            if len(types) != 1:
                raise RecordingError("it has several types")
            message_class(types[0])
            schema = installed_schema(types[0])
        except RecordingError as error:
            if name not in self._unknown:
                self._unknown.add(name)
                self.get_logger().warning(f"{name} is not offered: {error}")
            return
        self._unknown.discard(name)
        data = Schema(name=schema.type_name, encoding="ros2msg", data=_definition(schema.text))
        channel = Channel(name, schema=data, message_encoding="cdr", context=self._sinks)
        self._topics[name] = _Topic(channel, types[0])

    def _withdraw(self, name: str, topic: _Topic) -> None:
        """Take back a topic that is published as another type by now."""
        if topic.subscription is not None:
            self.destroy_subscription(topic.subscription)
        topic.channel.close()
        del self._topics[name]

    def _subscribe(self, name: str, topic: _Topic) -> None:
        offered = [offered_qos(end) for end in self.get_publishers_info_by_topic(name)]
        if not offered:
            return
        request = requested_qos(offered)
        topic.latched = request.durability == DurabilityPolicy.TRANSIENT_LOCAL

        def take(data: bytes) -> None:
            self._passed += 1
            now = time.time_ns()
            if topic.latched:
                topic.last = data, now
            topic.channel.log(data, log_time=now)

        topic.subscription = self.create_subscription(message_class(topic.type_name), name, take, request, raw=True)

    def on_subscribe(self, _client: Any, channel: Any) -> None:
        """Somebody wants a topic: what is latched is said again, to all of its clients, of the time when it came."""
        topic = self._topics.get(channel.topic)
        if topic is not None and (last := topic.last) is not None:
            topic.channel.log(last[0], log_time=last[1])

    # --- sound

    def _on_rig(self, rig: RigDescription) -> None:
        """Its sample rate is that of the sound."""
        if self._sampled is None or self._sampled[0] != rig.sample_rate:
            self._sampled = rig.sample_rate, WithoutOffset(rig.sample_rate)

    def _on_block(self, stamp: int, daq: Samples) -> None:
        if self._sampled is None or not self._sound.has_sinks():
            return
        rate, high_pass = self._sampled
        data = np.round(32767.0 * np.clip(high_pass.add(daq["x"]) / _FULL_SCALE, -1.0, 1.0)).astype("<i2").tobytes()
        moment = Timestamp(stamp // 10**9, stamp % 10**9)
        self._sound.log(
            RawAudio(timestamp=moment, data=data, format="pcm-s16", sample_rate=rate, number_of_channels=1),
            log_time=stamp,
        )

    # --- parameters and services

    def _on_parameters(self, node: str, values: Values, _deleted: tuple[str, ...] = ()) -> None:
        if node == self._rig_name:
            self._values |= {
                name: value for name, value in values.items() if isinstance(value, bool | int | float | str)
            }
            self._server.publish_parameter_values(self._told(list(values)))

    def _told(self, names: Sequence[str]) -> list[Parameter]:
        shown = {f"{self._rig_name}.{name}": value for name, value in self._values.items()}
        asked = {name if "." in name else f"{self._rig_name}.{name}" for name in names}
        return [Parameter(name, value=value) for name, value in shown.items() if not names or name in asked]

    def on_get_parameters(self, _client: Any, param_names: list[str], request_id: str | None = None) -> list[Parameter]:
        """The rig's parameters."""
        del request_id
        return self._told(param_names)

    def on_set_parameters(
        self, _client: Any, parameters: list[Parameter], request_id: str | None = None
    ) -> list[Parameter]:
        """Set parameters of the rig, checked as the page does; what the rig has then goes back.

        The library reads nothing more of the client until this returns, an emergency stop neither. So a rig that does
        not answer is waited for shortly, and once: what it has is told when it does, to those who follow parameters.
        """
        del request_id
        names = [parameter.name for parameter in parameters]
        prefix = f"{self._rig_name}."
        values = {parameter.name.removeprefix(prefix)[:80]: parameter.get_value() for parameter in parameters}
        try:
            command = self._command({"do": "set", "values": values})
        except RefusedError as error:
            self.get_logger().warning(f"refused: {error}")
            return self._told(names)
        unanswered = [one for one in self._unanswered if not one.done()]
        asked = asyncio.run_coroutine_threadsafe(self._set(command, names), self._gate.loop)
        self._unanswered = [*unanswered, asked]
        if not unanswered:
            with contextlib.suppress(FutureTimeoutError):
                asked.result(_SET_TIMEOUT)
        return self._told(names)

    async def _set(self, command: Command, names: Sequence[str]) -> None:
        done, sentence = await self._operator.operate(command)
        if done:
            self._values |= command.values
        else:
            self.get_logger().warning(f"refused: {sentence}")
        self._server.publish_parameter_values(self._told(names))

    def _serve(self, request: ServiceRequest) -> bytes:
        done, sentence = self._do({"do": request.service_name.rpartition("/")[2]})
        answer = CdrWriter()
        answer.octet(int(done))
        answer.text(sentence)
        return answer.done()

    def _do(self, content: dict[str, Any]) -> tuple[bool, str]:
        """Check and carry out, from a thread of the library's."""
        try:
            command = self._command(content)
        except RefusedError as error:
            return False, str(error)
        asked = asyncio.run_coroutine_threadsafe(self._operator.operate(command), self._gate.loop)
        try:
            return asked.result(_ANSWER_TIMEOUT)
        except FutureTimeoutError:
            return False, f"no answer within {_ANSWER_TIMEOUT:g} s: it may still be carried out"

    def _command(self, content: dict[str, Any]) -> Command:
        try:
            return command_of(json.dumps(content).encode(), self._control)
        except (SquealRigError, TypeError, ValueError) as error:
            raise RefusedError(str(error)) from None


def _definition(text: str) -> bytes:
    """A definition whose parts are named as Foxglove's reader finds them: std_msgs/Header, not std_msgs/msg/Header."""
    return re.sub(r"^MSG: (\w+)/msg/(\w+)$", r"MSG: \1/\2", text, flags=re.MULTILINE).encode()


def _trigger() -> ServiceSchema:
    def part(name: str, text: bytes) -> MessageSchema:
        return MessageSchema(encoding="cdr", schema=Schema(name=f"{_TRIGGER}_{name}", encoding="ros2msg", data=text))

    return ServiceSchema(
        _TRIGGER, request=part("Request", b""), response=part("Response", b"bool success\nstring message\n")
    )


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; returns the exit code."""
    return run_node(FoxgloveNode, args)


if __name__ == "__main__":
    sys.exit(main())
