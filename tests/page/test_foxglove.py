"""The node `foxglove` to a client that speaks its protocol: every topic, decoded by the schema that was served."""

import asyncio
import json
import os
import re
import shutil
import signal
import struct
import subprocess
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("foxglove")
aiohttp = pytest.importorskip("aiohttp")

from mcap.records import Schema  # noqa: E402
from mcap_ros2.decoder import DecoderFactory  # noqa: E402

from squeal_rig.graph.operator import Operator  # noqa: E402
from squeal_rig.page.commands import Command  # noqa: E402
from tests.graph import PATIENCE  # noqa: E402
from tests.graph.processes import parameters  # noqa: E402

_RATE = 12800
_MODULES = "FOXGLOVE_CLIENT_MODULES"
_SOUND = "/pad/sound"
_CLIENT = Path(__file__).with_name("foxglove_client.cjs")


@pytest.fixture(scope="module")
def rig(compiled, processes):
    """The rig's node behind the servers."""
    return processes.node("simulator", *parameters(sample_rate=_RATE, supervisor_required=False))


@pytest.fixture(scope="module")
def stops(observer):
    """What comes on the topic of the emergency stop; followed before anybody is there who says it."""
    return observer.follow("emergency_stop")


@pytest.fixture(scope="module")
def nodes(stops, rig, processes, observer):
    """A server that takes commands, and one that does not."""
    for name in ("friction_estimator", "stability", "squeal_detector", "view"):
        processes.node(name)
    nodes = [
        processes.node("foxglove", *parameters(port=0, control=True)),
        processes.node("foxglove", "-r", "__node:=foxglove_read_only", *parameters(port=0)),
    ]
    for node in nodes:
        observer.wait_for(lambda node=node: "ws://" in node.errors or not node.running, "the address", 300.0)
        assert node.running, node.errors
    observer.wait_for(lambda: observer.state() == "active", "an active rig", 300.0)
    return nodes


@pytest.fixture(scope="module")
def served(nodes):
    """Their addresses."""
    return [re.search(r"ws://[\d.:]+", node.errors)[0] for node in nodes]


class Spoken:
    """A client of the protocol `foxglove.sdk.v1`: subscribes to everything, decodes what comes."""

    def __init__(self, url):
        self.url = url
        self.topics, self.services, self.values, self.answers = {}, {}, {}, []
        self.schemas = {}  # by topic
        self.times = {}  # those of the messages of each topic [ns]
        self._channels = {}

    async def __aenter__(self):
        self._session = aiohttp.ClientSession()
        self._socket = await self._session.ws_connect(self.url, protocols=["foxglove.sdk.v1"])
        return self

    async def __aexit__(self, *_error):
        await self._session.close()

    async def send(self, **content):
        await self._socket.send_str(json.dumps(content))

    async def call(self, name, number):
        encoding = b"cdr"
        head = struct.pack("<BIII", 2, self.services[name], number, len(encoding))
        await self._socket.send_bytes(head + encoding + b"\0\1\0\0\0")

    async def until(self, condition, patience=PATIENCE):
        deadline = time.monotonic() + patience
        while not condition():
            silent = [topic for topic, count in self.topics.items() if not count]
            assert time.monotonic() < deadline, (
                f"{silent} say nothing; services {self.services}, answers {self.answers}"
            )
            try:
                message = await asyncio.wait_for(self._socket.receive(), 1.0)
            except asyncio.TimeoutError:
                continue
            await self._take(message)

    async def _take(self, message):
        if message.type == aiohttp.WSMsgType.BINARY:
            self._take_bytes(message.data)
            return
        content = json.loads(message.data)
        if content["op"] == "advertise":
            for channel in content["channels"]:
                self._channels[channel["id"]] = channel, _decoder(channel)
                self.topics[channel["topic"]] = 0
                self.times[channel["topic"]] = []
                self.schemas[channel["topic"]] = channel["schemaName"]
                await self.send(op="subscribe", subscriptions=[{"id": channel["id"], "channelId": channel["id"]}])
        elif content["op"] == "status" and (found := re.fullmatch(r"Unknown channel ID: (\d+)", content["message"])):
            # The library tells its clients of a channel a moment before it knows it itself.
            await asyncio.sleep(0.1)
            number = int(found[1])
            await self.send(op="subscribe", subscriptions=[{"id": number, "channelId": number}])
        elif content["op"] == "advertiseServices":
            self.services |= {service["name"]: service["id"] for service in content["services"]}
        elif content["op"] == "parameterValues":
            self.values |= {one["name"]: one.get("value") for one in content["parameters"]}
        elif content["op"] == "serviceCallFailure":
            self.answers.append(content["message"])

    def _take_bytes(self, data):
        if data[0] == 1:
            channel, decode = self._channels[struct.unpack_from("<I", data, 1)[0]]
            if decode is not None:
                decode(data[13:])
            self.topics[channel["topic"]] += 1
            self.times[channel["topic"]].append(struct.unpack_from("<Q", data, 5)[0])
        elif data[0] == 3:
            (length,) = struct.unpack_from("<I", data, 9)
            self.answers.append(data[13 + length :])


def _decoder(channel):
    if channel["encoding"] != "cdr":
        return None
    text = channel["schema"].encode()
    schema = Schema(id=1, name=channel["schemaName"], encoding=channel["schemaEncoding"], data=text)
    return DecoderFactory().decoder_for("cdr", schema)


# Said only now and then, or where something happens.
_RARE = {"/emergency_stop", "/run/events", "/rosout", "/parameter_events", "/friction/model", "/clock"}


def test_every_topic_comes_and_is_decoded_by_the_schema_served(served):
    async def work():
        async with Spoken(served[0]) as spoken:
            wanted = {"/daq/samples", "/truth/samples", "/rig/description", "/stability/summary", "/squeal/state"}
            wanted |= {"/view/envelope", "/view/spectrum", "/friction/windows", "/pad/state", "/diagnostics", _SOUND}
            await spoken.until(lambda: wanted <= set(spoken.topics))
            await spoken.until(lambda: all(n for topic, n in spoken.topics.items() if _often(topic)))
            return spoken.topics

    topics = asyncio.run(work())
    assert len(topics) > 25


def test_a_topic_that_comes_back_as_another_type_is_served_as_that(observer, served):
    from geometry_msgs.msg import Twist
    from std_msgs.msg import String

    async def work():
        async with Spoken(served[0]) as spoken:
            for kind in (String, Twist):
                publisher = observer.node.create_publisher(kind, "/mended", 10)

                def comes(kind=kind, publisher=publisher):
                    publisher.publish(kind())
                    schema = f"{kind.__module__.split('.')[0]}/msg/{kind.__name__}"
                    return spoken.schemas.get("/mended") == schema and spoken.topics["/mended"] > 0

                await spoken.until(comes)
                observer.node.destroy_publisher(publisher)

    asyncio.run(work())


def _often(topic):
    rare = topic in _RARE or topic.startswith(
        ("/rig/transition_event", "/supervisor", "/view/smallest", "/view/squeal")
    )
    return not rare and topic != "/rig/safe"


def test_parameters_and_services_go_through_the_page_s_checks(served, observer):
    async def work():
        async with Spoken(served[0]) as spoken:
            await spoken.until(lambda: "/squeal_rig/reset" in spoken.services)
            # A rig on a busy machine may answer after the server's patience: then only those who follow are told.
            await spoken.send(op="subscribeParameterUpdates", parameterNames=["/rig.preload"])
            await spoken.send(op="setParameters", parameters=[{"name": "/rig.preload", "value": 61.5}], id="1")
            await spoken.until(lambda: spoken.values.get("/rig.preload") == 61.5)
            for name, value in (("preload", 1e9), ("mass", 1.0), ("driver", "evil"), ("preload", "x" * 3000)):
                given = [{"name": f"/rig.{name}", "value": value}]
                await spoken.send(op="setParameters", parameters=given, id="2")
            await spoken.call("/squeal_rig/reset", 1)
            await spoken.until(lambda: spoken.answers)
            return spoken.answers

    answers = asyncio.run(work())
    assert b"equilibrium" in answers[0]
    assert observer.get(["preload", "driver"]) == {"preload": 61.5, "driver": "virtual"}


def test_a_server_without_control_stops_the_rig_and_does_nothing_else(served, observer, stops):
    before = observer.get(["preload"])
    stops.clear()

    async def work():
        async with Spoken(served[1]) as spoken:
            await spoken.until(lambda: spoken.services)
            services = dict(spoken.services)
            await spoken.send(op="setParameters", parameters=[{"name": "/rig.preload", "value": 99.0}], id="1")
            await spoken.call("/squeal_rig/emergency_stop", 1)
            await spoken.until(lambda: spoken.answers)
            return services, spoken.answers

    services, answers = asyncio.run(work())
    assert list(services) == ["/squeal_rig/emergency_stop"]
    assert b"emergency stop" in answers[0]
    observer.wait_for(lambda: stops, "the stop on its topic")
    assert stops[0].data == "asked for by foxglove_read_only"  # who reads of it knows whom to ask
    assert observer.get(["preload"]) == before
    assert observer.trigger("reset")[0]


def test_what_is_latched_keeps_its_time_when_another_client_comes(served):
    topic = "/rig/description"

    async def work():
        async with Spoken(served[0]) as first:
            await first.until(lambda: first.topics.get(topic))
            settled = time.monotonic() + 2.0  # the test before has just reset the rig, which describes itself anew then
            await first.until(lambda: time.monotonic() > settled)
            came = list(first.times[topic])
            async with Spoken(served[0]) as second:
                await second.until(lambda: second.topics.get(topic))
                await first.until(lambda: first.topics[topic] > len(came))
                return set(came), {*first.times[topic], *second.times[topic]}

    came, said = asyncio.run(work())
    assert said == came


def test_a_rig_that_does_not_answer_a_set_keeps_no_emergency_stop_waiting(served, nodes, rig, observer):
    refused = "refused: /rig/set_parameters_atomically did not answer"

    async def work():
        async with Spoken(served[0]) as spoken:
            await spoken.until(lambda: "/squeal_rig/emergency_stop" in spoken.services)
            rig.send(signal.SIGSTOP)
            try:
                for number in range(4):
                    given = [{"name": "/rig.preload", "value": 60.0 + number}]
                    await spoken.send(op="setParameters", parameters=given, id=str(number))
                await spoken.call("/squeal_rig/emergency_stop", 1)
                await spoken.until(lambda: spoken.answers)
                return spoken.answers[0], refused in nodes[0].errors
            finally:
                rig.send(signal.SIGCONT)

    answer, waited = asyncio.run(work())
    assert b"did not answer" in answer  # not the service: by its topic the rig has the stop as soon as it goes on
    assert not waited
    observer.wait_for(lambda: observer.trigger("reset")[0], "a rig that is free again")


class Unreasoned(Operator):
    """An operator on a graph that refuses all and says nothing."""

    def __init__(self):
        self._under_way, self._stopping, self._set = 0, None, None
        self._texts, self._triggers = {"springs_fitted": None}, {}

    async def _answer(self, *_asked):
        refusal = SimpleNamespace(successful=False, reason="")
        return SimpleNamespace(result=refusal, results=[refusal])


@pytest.mark.parametrize("command", [Command("set", {"preload": 60.0}), Command("springs_fitted", text="stiff")])
def test_a_refusal_without_a_reason_does_not_read_like_success(command):
    assert asyncio.run(Unreasoned().operate(command)) == (False, "refused, and no reason was given")


@pytest.mark.slow
def test_a_client_that_is_not_ours_reads_every_topic(served, measured):
    """By npm's @foxglove/ws-protocol, rosmsg, rosmsg2-serialization and ws, in the folder of that variable."""
    modules = os.environ.get(_MODULES)
    if not modules or shutil.which("node") is None:
        pytest.skip(f"no node, or {_MODULES} names no folder with npm's @foxglove/ws-protocol and what belongs to it")
    command = ["node", _CLIENT, modules, served[0], "12"]
    told = subprocess.run(command, check=True, capture_output=True, text=True, timeout=120)
    result = json.loads(told.stdout)
    assert not result["errors"], result["errors"]
    read = {topic for topic, found in result["topics"].items() if found["count"]}
    measured(f"foxglove: {len(read)} of {len(result['topics'])} topics read and decoded by @foxglove/ws-protocol")
    assert {topic for topic in result["topics"] if _often(topic)} <= read
    assert ["/rig.preload", 61.5] in result["parameters"]
    assert any("equilibrium" in answer for answer in result["answers"])
