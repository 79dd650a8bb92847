"""The page's server against whoever speaks to it, over real sockets, without ROS."""

import asyncio
import contextlib
import json
import os
import signal
import struct
import threading
import time
import types

import numpy as np
import pytest

pytest.importorskip("aiohttp")

import itertools

import aiohttp

from squeal_rig.errors import ConfigurationError, ParameterError, SquealRigError
from squeal_rig.experiments.engine import RUN_STARTED
from squeal_rig.instruments.channels import DAQ_RECORD
from squeal_rig.instruments.description import RigDescription
from squeal_rig.model.parameters import RigParameters
from squeal_rig.page import serve_bag as serve_bag_module
from squeal_rig.page import server as server_module
from squeal_rig.page.access import Access, in_url
from squeal_rig.page.picture import SPECTRUM_HIGH, Picture, SquealTable, column
from squeal_rig.page.server import PageServer
from squeal_rig.page.settings import PageSettings
from squeal_rig.page.sound import Sound

TOKEN = "a-token-that-is-long-enough"


def block(number, size=512):
    daq = np.zeros(size, DAQ_RECORD)
    daq["seq"] = (number * size + np.arange(size)) % 2**32
    daq["x"] = 1e-6 * np.sin(0.27 * daq["seq"])
    return daq


def unpacked(message):
    (size,) = struct.unpack_from("<I", message)
    head = json.loads(message[4 : 4 + size])
    offset, arrays = 4 + size, {}
    for name, code, count in head["arrays"]:
        arrays[name] = np.frombuffer(message, "<" + code, count, offset)
        offset += -(-arrays[name].nbytes // 4) * 4
    assert offset == len(message)
    return head, arrays


class Console:
    """Takes what is printed."""

    def __init__(self):
        self.lines = []

    def print(self, line):
        self.lines.append(line)


class Served:
    def __init__(self, control=True, token="", address="127.0.0.1"):
        self.commands, self.log = [], []
        self.picture, self.sound = Picture(control), Sound()
        self.picture.take_rig(RigDescription(RigParameters()))

        async def operate(command):
            self.commands.append(command)
            return command.name != "zero", f"<b>{command.name}</b>"

        access = Access(address, token)
        self.server = PageServer(self.picture, self.sound, access, control, operate, log=self.log.append)
        self.server.start("127.0.0.1", 0)
        self.url = f"http://127.0.0.1:{self.server.port}"

    def feed(self, number):
        self.picture.take_block(block(number))
        for rate, message in self.sound.take_block(block(number), 51200):
            self.server.hear(rate, message)


@pytest.fixture
def serve():
    started = []

    def start(**options):
        started.append(Served(**options))
        return started[-1]

    yield start
    for one in started:
        one.server.close()


def talk(work):
    """Run a client; at most a minute."""

    async def within():
        async with aiohttp.ClientSession() as session:
            return await asyncio.wait_for(work(session), 60.0)

    return asyncio.run(within())


async def post(session, served, content, **headers):
    data = content if isinstance(content, bytes) else json.dumps(content).encode()
    headers = {"Content-Type": "application/json", **{k.replace("_", "-"): v for k, v in headers.items()}}
    async with session.post(f"{served.url}/command", data=data, headers=headers) as answer:
        return answer.status, await answer.text()


def test_a_command_is_carried_out_and_its_sentence_comes_back(serve):
    served = serve()

    async def work(session):
        return await post(session, served, {"do": "reset"}), await post(session, served, {"do": "zero"})

    (status, text), (refused, _) = talk(work)
    assert (status, json.loads(text)) == (200, {"done": True, "sentence": "<b>reset</b>"})
    assert refused == 409
    assert [command.name for command in served.commands] == ["reset", "zero"]


def test_no_request_of_a_foreign_origin_or_host_is_answered(serve):
    served = serve()

    async def work(session):
        found = [await post(session, served, {"do": "reset"}, Origin="http://evil.example")]
        found.append(await post(session, served, {"do": "reset"}, Host="evil.example"))
        for path in ("/", "/ws", "/page.js"):
            async with session.get(served.url + path, headers={"Origin": "http://evil.example"}) as answer:
                found.append((answer.status, ""))
        with pytest.raises(aiohttp.WSServerHandshakeError):
            await session.ws_connect(f"{served.url}/ws", origin="http://evil.example")
        return found

    assert {status for status, _ in talk(work)} == {403}
    assert not served.commands
    assert served.log
    assert "evil.example" in served.log[0]


def test_without_the_token_nothing_is_answered_and_with_it_everything(serve):
    served = serve(token=TOKEN)

    async def work(session):
        refused = [await post(session, served, {"do": "emergency_stop"})]
        refused.append(await post(session, served, {"do": "emergency_stop"}, Authorization="Bearer wrong-" + TOKEN))
        refused.append(await post(session, served, {"do": "emergency_stop"}, Cookie=f"squeal_rig={TOKEN}"))
        for path in ("/ws", "/page.js", "/plots.js"):
            async with session.get(served.url + path) as answer:
                refused.append((answer.status, ""))
        with pytest.raises(aiohttp.WSServerHandshakeError):
            await session.ws_connect(f"{served.url}/ws")
        async with session.get(served.url) as answer:
            assert answer.status == 401
            assert "password" in await answer.text()
        async with session.post(f"{served.url}/login", data={"token": "wrong" + TOKEN}) as answer:
            assert answer.status == 403
        given = await post(session, served, {"do": "emergency_stop"}, Authorization=f"Bearer {TOKEN}")
        jar = aiohttp.CookieJar(unsafe=True)
        async with aiohttp.ClientSession(cookie_jar=jar) as browser:
            async with browser.post(f"{served.url}/login", data={"token": TOKEN}) as answer:
                assert "Emergency" in (await answer.text()).title()
            async with browser.ws_connect(f"{served.url}/ws") as socket:
                assert unpacked((await socket.receive()).data)[0]["kind"] == "hello"
        return refused, given

    refused, given = talk(work)
    assert {status for status, _ in refused} == {401}
    assert given[0] == 200
    assert len(served.commands) == 1
    assert not [line for line in served.log if TOKEN in line]


def test_two_pages_on_one_host_do_not_take_each_other_s_cookies(serve):
    pages = serve(token=TOKEN), serve(token=TOKEN + "x")

    async def work(session):
        jar = aiohttp.CookieJar(unsafe=True)
        async with aiohttp.ClientSession(cookie_jar=jar) as browser:
            for page, token in zip(pages, (TOKEN, TOKEN + "x"), strict=True):
                async with browser.post(f"{page.url}/login", data={"token": token}) as answer:
                    assert answer.status == 200
            return [(await browser.get(f"{page.url}/page.js")).status for page in pages]

    assert talk(work) == [200, 200]


def test_a_page_that_is_read_only_stops_the_rig_and_does_nothing_else(serve):
    served = serve(control=False)

    async def work(session):
        return await post(session, served, {"do": "impact"}), await post(session, served, {"do": "emergency_stop"})

    (refused, sentence), (done, _) = talk(work)
    assert refused == 400
    assert "read-only" in sentence
    assert done == 200
    assert [command.name for command in served.commands] == ["emergency_stop"]


@pytest.mark.parametrize(
    "path",
    ["/../setup.py", "/..%2f..%2fetc/passwd", "/static/index.html", "/page.py", "//etc/passwd", "/bags/..", "/%00"],
)
def test_nothing_but_the_page_s_own_files_is_served(serve, path):
    served = serve()

    async def work(session):
        reader, writer = await asyncio.open_connection("127.0.0.1", served.server.port)
        writer.write(f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: close\r\n\r\n".encode())
        answer = await reader.read()
        writer.close()
        return answer

    assert b"404" in talk(work).split(b"\r\n")[0]


def test_requests_that_nobody_means_well_leave_the_server_as_it_was(serve):
    served = serve()

    async def work(session):
        statuses = [await post(session, served, content) for content in (b"x" * 100_000, b"\xff", b"[" * 4000, b"{}")]
        statuses.append(await post(session, served, {"do": "reset"}, Content_Type="text/plain"))
        async with session.post(f"{served.url}/login", data=b"\xff" * 5000) as answer:
            statuses.append((answer.status, ""))
        async with session.request("PUT", f"{served.url}/command") as answer:
            statuses.append((answer.status, ""))
        for message in (
            "x",
            "[]",
            "{}",
            '{"seek": -1}',
            '{"sound": 47}',
            '{"sound": true}',
            '{"sound": 48000.0}',
            '{"a": 1}',
            "[" * 4000,
        ):
            async with session.ws_connect(f"{served.url}/ws") as socket:
                await socket.send_str(message)
                await until_closed(socket)
        for message in (b"\0" * 10, b"\0" * 100_000):
            async with session.ws_connect(f"{served.url}/ws") as socket:
                await socket.send_bytes(message)
                await until_closed(socket)
        reader, writer = await asyncio.open_connection("127.0.0.1", served.server.port)
        writer.write(b"\x16\x03\x01" + bytes(range(256)) * 40 + b"\r\n\r\n")
        await reader.read()
        writer.close()
        return statuses, await post(session, served, {"do": "reset"})

    statuses, (last, _) = talk(work)
    assert all(400 <= status < 500 for status, _ in statuses), statuses
    assert last == 200
    assert len(served.commands) == 1


async def until_closed(socket):
    async for message in socket:
        if message.type not in (aiohttp.WSMsgType.BINARY, aiohttp.WSMsgType.TEXT):
            break


def test_pings_are_answered_and_who_sends_more_than_any_browser_goes(serve):
    served = serve()

    async def work(session):
        async def pongs(socket, enough):
            found = []
            while len(found) < enough and not socket.closed:
                message = await asyncio.wait_for(socket.receive(), 20.0)
                if message.type is aiohttp.WSMsgType.PONG:
                    found.append(bytes(message.data))
            return found

        async with session.ws_connect(f"{served.url}/ws", autoping=False) as socket:
            for _ in range(3):
                await socket.pong()
            await socket.send_str('{"sound": 48000}')
            await socket.ping(b"some")
            few = await pongs(socket, 1)
            while not served.sound.take_block(block(0), 51200):  # the word counts as ever
                await asyncio.sleep(0.01)
            count = served.server.clients
        async with session.ws_connect(f"{served.url}/ws", autoping=False) as socket:
            with contextlib.suppress(ConnectionError):
                for _ in range(500):
                    await socket.ping()
            many = await pongs(socket, 500)
            closed = socket.closed
        while served.server.clients:
            await asyncio.sleep(0.01)
        return few, count, many, closed

    few, count, many, closed = talk(work)
    assert (few, count) == ([b"some"], 1)
    assert closed
    assert len(many) < 100
    assert any("pings" in line for line in served.log)


def test_every_answer_forbids_what_is_not_the_page_s_own(serve):
    served = serve()

    async def work(session):
        for path in ("/", "/page.js", "/nothing"):
            async with session.get(served.url + path) as answer:
                policy = answer.headers["Content-Security-Policy"]
                assert "default-src 'none'" in policy
                assert "unsafe" not in policy
                assert answer.headers["X-Content-Type-Options"] == "nosniff"
        async with session.get(served.url) as answer:
            return await answer.text()

    text = talk(work)
    assert "http://" not in text  # nothing is loaded from elsewhere
    assert "https://" not in text


def test_pictures_and_sound_come_and_a_client_that_hangs_holds_nobody_up(serve):
    served = serve()

    async def work(session):
        # It asks for sound and never reads: its socket fills up, and it is dropped.
        _reader, writer = await asyncio.open_connection("127.0.0.1", served.server.port, limit=1024)
        key = "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n"
        writer.write(
            f"GET /ws HTTP/1.1\r\nHost: 127.0.0.1\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n{key}\r\n".encode()
        )
        heard, kinds, number = [], set(), 0
        async with session.ws_connect(f"{served.url}/ws") as socket:
            await socket.send_str('{"sound": 48000}')
            deadline = time.monotonic() + 30.0
            while time.monotonic() < deadline and (len(heard) < 50 or kinds < {"hello", "state", "frame", "sound"}):
                served.feed(number)
                number += 1
                try:
                    message = await asyncio.wait_for(socket.receive(), 0.02)
                except asyncio.TimeoutError:
                    continue
                head, arrays = unpacked(message.data)
                kinds.add(head["kind"])
                if head["kind"] == "sound":
                    heard.append((head["origin"], head["first"], arrays["sound"]))
        writer.close()
        return heard, kinds

    heard, kinds = talk(work)
    assert kinds == {"hello", "state", "frame", "sound"}
    assert len(heard) >= 50
    for (origin, first, sound), (other, following, _) in itertools.pairwise(heard):
        assert (origin, first + len(sound)) == (other, following)


def test_a_lost_sample_begins_a_stream_anew():
    sound = Sound()
    sound.listen({48000})
    messages = [unpacked(m)[0] for n in (0, 1, 2, 5, 6) for _, m in sound.take_block(block(n), 51200)]
    assert [message["origin"] for message in messages] == [0, 0, 0, 5 * 512, 5 * 512]
    with pytest.raises(ParameterError, match="sound at 47 Hz"):
        sound.listen({47})


def test_a_port_that_is_taken_is_told_in_a_sentence(serve):
    served = serve()
    other = PageServer(served.picture, served.sound, Access("127.0.0.1"))
    with pytest.raises(ConfigurationError, match="cannot listen"):
        other.start("127.0.0.1", served.server.port)
    other.close()


def test_a_bag_s_page_whose_server_has_ended_ends_with_a_sentence(tmp_path, monkeypatch):
    async def broken(_self):
        await asyncio.sleep(0.5)
        raise RuntimeError("a test")

    recorded = types.SimpleNamespace(picture=Picture(False), at=lambda _time: [])
    monkeypatch.setattr(serve_bag_module, "RecordedPicture", lambda _bag: recorded)
    monkeypatch.setattr(PageServer, "_show", broken)
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    given_up = threading.Timer(20.0, os.kill, (os.getpid(), signal.SIGTERM))
    given_up.start()
    console = Console()
    try:
        with pytest.raises(SquealRigError, match="the page has ended"):
            serve_bag_module.serve_bag(tmp_path, PageSettings(port=0), console)
    finally:
        given_up.cancel()
        for number, handler in handlers.items():
            signal.signal(number, handler)
    assert "http://127.0.0.1:" in console.lines[0]


def test_an_address_of_ipv6_stands_in_brackets_in_a_url():
    assert [in_url(one) for one in ("127.0.0.1", "::1", "rig.example")] == ["127.0.0.1", "[::1]", "rig.example"]


def test_squeals_are_rows_with_their_loudest_moment():
    table = SquealTable()
    for stamp, detected, level in ((1.0, True, -5.0), (2.0, True, 3.0), (3.0, True, 1.0), (4.0, False, -40.0)):
        table.take(stamp, 0.5 if detected else 3.5, detected, level, 2000.0 + level, (50.0, 1.0))
    table.take(5.0, 5.0, True, 0.0, 2000.0, (60.0, 1.0))
    first, second = table.rows
    assert (first["begin"], first["end"], first["level"], first["frequency"]) == (0.5, 4.0, 3.0, 2003.0)
    assert second["end"] is None


async def until_ended(reader):
    """What comes until a connection ends; a reset ends it too, where the server had not read all."""
    try:
        return await asyncio.wait_for(reader.read(), 30.0)
    except ConnectionResetError:
        return b""


def test_connections_that_ask_for_nothing_keep_nobody_out(serve, monkeypatch):
    monkeypatch.setattr(server_module, "_STRANGER_TIMEOUT", 0.5)
    served = serve(token=TOKEN)

    async def work(session):
        idle = [await asyncio.open_connection("127.0.0.1", served.server.port) for _ in range(300)]
        idle[0][1].write(b"GET / HT")  # a head that never ends
        authorized = {"Authorization": f"Bearer {TOKEN}"}
        async with session.ws_connect(f"{served.url}/ws", headers=authorized) as socket:
            status, _ = await post(session, served, {"do": "emergency_stop"}, **authorized)
            ends = [await until_ended(reader) for reader, _ in idle]
            await asyncio.sleep(1.0)
            lives = not socket.closed and (await socket.receive()).type == aiohttp.WSMsgType.BINARY
        for _, writer in idle:
            writer.close()
        return status, ends, lives

    status, ends, lives = talk(work)
    assert status == 200
    assert not any(ends)
    assert lives  # who was admitted stays
    assert 300 <= served.server.strangers <= 302  # in a crowd, connections with nothing to answer go too


def test_a_request_that_was_refused_is_the_last_of_its_connection(serve):
    served = serve(token=TOKEN)

    async def work(session):
        reader, writer = await asyncio.open_connection("127.0.0.1", served.server.port)
        writer.write(b"GET /page.js HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n" * 5)
        answer = await asyncio.wait_for(reader.read(), 10.0)
        writer.close()
        return answer

    assert talk(work).count(b"HTTP/1.1 401") == 1


def test_the_supervisors_limits_are_rows_with_their_units():
    picture = Picture(False)
    picture.take_limits({"force_warn": 1e4, "force_ramp_down": 1.5e4, "force_stop": 2e4, "squeal_warn": 30.0, "x": "y"})
    picture.take_limits({"force_warn": 9e3, "nodes": ["rig"], "displacement_warn": "much"})
    head, _ = unpacked(picture.state())
    assert head["limits"] == [
        {"what": "force", "unit": "N", "warn": 9e3, "ramp_down": 1.5e4, "stop": 2e4},
        {"what": "squeal", "unit": "dB re 1 um", "warn": 30.0, "ramp_down": None, "stop": None},
    ]


def test_a_run_that_nobody_tells_of_any_more_is_gone():
    picture = Picture(False)
    assert unpacked(picture.state())[0]["run"] is None
    picture.take_run(0.0, (0, RUN_STARTED, {"campaign": "Smoke", "points": "24"}))
    assert unpacked(picture.state())[0]["run"]["gone"] is False
    picture.take_run_is_heard(False)
    assert unpacked(picture.state())[0]["run"]["gone"] is True


@pytest.mark.parametrize("rate", [6400, 12800, 51200, 400_000])
def test_a_tone_stands_at_its_frequency_in_the_spectrogram_whatever_the_rate(rate):
    t = np.arange(rate // 5) / rate
    shown = column(1e-6 * np.sin(2.0 * np.pi * 2200.0 * t), rate)
    assert np.argmax(shown) == int(2200.0 / SPECTRUM_HIGH * len(shown))
