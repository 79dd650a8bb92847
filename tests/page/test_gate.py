"""The gate before a server that checks nothing itself: who passes, and what is passed on."""

import asyncio
import os
import socket
from pathlib import Path

import pytest

from squeal_rig.errors import ConfigurationError
from squeal_rig.page import gate as gate_module
from squeal_rig.page.access import Access
from squeal_rig.page.gate import Gate

TOKEN = "a-token-that-is-long-enough"


def tried(*requests, token=TOKEN, origins=("https://app.example",), sent_after=b""):
    """Answers to requests, one connection each; what the server behind got, and what was logged."""
    behind, log = [], []

    async def serve(reader, writer):
        behind.append(await reader.readuntil(b"\r\n\r\n"))
        writer.write(b"HTTP/1.1 101 Switching Protocols\r\n\r\n")
        while data := await reader.read(1024):
            writer.write(data[::-1])
        writer.close()

    async def work():
        server = await asyncio.start_server(serve, "127.0.0.1", 0)
        gate = Gate(Access("127.0.0.1", token, (), origins), server.sockets[0].getsockname(), log.append)
        gate.start("127.0.0.1", 0)
        answers = []
        try:
            for request in requests:
                reader, writer = await asyncio.open_connection("127.0.0.1", gate.port)
                writer.write(request.encode("latin-1") if isinstance(request, str) else request)
                head = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), 20.0)
                if sent_after and b" 101 " in head:
                    writer.write(sent_after)
                    head += await asyncio.wait_for(reader.readexactly(len(sent_after)), 20.0)
                answers.append(head)
                writer.close()
        finally:
            await asyncio.to_thread(gate.close)
            server.close()
        return answers

    return asyncio.run(work()), behind, log


def head(target="/", **headers):
    lines = {"Host": "127.0.0.1", "Upgrade": "websocket", "Connection": "Upgrade", **headers}
    return f"GET {target} HTTP/1.1\r\n" + "".join(f"{name}: {value}\r\n" for name, value in lines.items()) + "\r\n"


def test_who_shows_the_token_passes_and_the_token_goes_no_further():
    asked = (
        head(Authorization=f"Bearer {TOKEN}"),
        head(f"/?token={TOKEN}"),
        head(f"/?token={TOKEN}", Origin="https://app.example"),
    )
    answers, behind, log = tried(*asked, sent_after=b"stressed")
    assert all(b" 101 " in answer and answer.endswith(b"desserts") for answer in answers)
    assert len(behind) == 3
    assert all(TOKEN.encode() not in request and b"rigin" not in request for request in behind)
    assert not log


@pytest.mark.parametrize(
    ("request_head", "status"),
    [
        (head(), b" 401 "),
        (head("/?token=wrong"), b" 401 "),
        (head("/?token="), b" 401 "),
        (head("http://["), b" 401 "),
        (head(Authorization=TOKEN), b" 401 "),
        (head(Cookie=f"squeal_rig={TOKEN}"), b" 401 "),
        (head(f"/?token={TOKEN}", Origin="https://evil.example"), b" 403 "),
        (head(f"/?token={TOKEN}", Origin="null"), b" 403 "),
        (head(f"/?token={TOKEN}", Host="evil.example"), b" 403 "),
        (head(f"/?token={TOKEN}").replace("GET", "POST"), b" 400 "),
        (head(f"/?token={TOKEN}").replace("Upgrade: websocket", "host: evil.example"), b" 400 "),
        (head(f"/?token={TOKEN}").replace("Upgrade: websocket", "Upgrade: a\nOrigin: b"), b" 400 "),
        ("GET / HTTP/1.1\r\nX: " + "x" * 20000 + "\r\n\r\n", b" 400 "),
        (b"\x16\x03\x01" + bytes(range(14, 256)) + b"\r\n\r\n", b" 400 "),
    ],
)
def test_who_does_not_is_refused_and_reaches_nothing(request_head, status):
    answers, behind, log = tried(request_head)
    assert status in answers[0]
    assert not behind
    assert len(log) == 1
    assert TOKEN not in log[0]


def test_without_a_token_a_page_of_a_foreign_origin_is_refused_all_the_same():
    foreign, own, none = head(Origin="https://evil.example"), head(Origin="https://app.example"), head()
    answers, behind, _ = tried(foreign, own, none, token="")
    assert [answer.split()[1] for answer in answers] == [b"403", b"101", b"101"]
    assert len(behind) == 2


async def among_strangers(count):
    """One who shows the token, after so many who show no head: its answer, how many of them ended, gate and its log."""

    async def serve(reader, writer):
        await reader.readuntil(b"\r\n\r\n")
        writer.write(b"HTTP/1.1 101 Switching Protocols\r\n\r\n")
        writer.close()

    server = await asyncio.start_server(serve, "127.0.0.1", 0)
    log = []
    gate = Gate(Access("127.0.0.1", TOKEN), server.sockets[0].getsockname(), log.append)
    gate.start("127.0.0.1", 0)
    try:
        strangers = [await asyncio.open_connection("127.0.0.1", gate.port) for _ in range(count)]
        reader, writer = await asyncio.open_connection("127.0.0.1", gate.port)
        writer.write(head(Authorization=f"Bearer {TOKEN}").encode())
        answer = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), 20.0)
        reading = [asyncio.create_task(one.read()) for one, _ in strangers]
        await asyncio.wait(reading, timeout=0.5)
        ended = sum(task.done() for task in reading)
        for _, one in (*strangers, (reader, writer)):
            one.close()
    finally:
        await asyncio.to_thread(gate.close)
        server.close()
    return answer, ended, gate, log


def test_strangers_that_show_no_head_keep_nobody_out(monkeypatch):
    monkeypatch.setattr(gate_module, "_HEAD_TIMEOUT", 60.0)
    answer, ended, gate, log = asyncio.run(among_strangers(100))
    assert b" 101 " in answer
    assert (ended, gate.refused, log) == (0, 0, [])


def test_who_comes_takes_the_place_of_the_oldest_that_shows_no_head(monkeypatch):
    monkeypatch.setattr(gate_module, "_MOST_HEADS", 5)
    monkeypatch.setattr(gate_module, "_HEAD_TIMEOUT", 60.0)
    answer, ended, gate, log = asyncio.run(among_strangers(5))
    assert b" 101 " in answer
    assert (ended, gate.refused, len(log)) == (1, 1, 1)


def open_sockets():
    links = [os.readlink(file) for file in Path("/proc/self/fd").iterdir() if file.is_symlink()]
    return sum(link.startswith("socket:") for link in links)


async def open_sockets_after_one_that_takes_nothing():
    """Sockets of this process before a client that never reads what a server behind the gate pours out, and later."""

    async def pour(reader, writer):
        try:
            while True:
                writer.write(bytes(1 << 20))
                await writer.drain()
        except OSError:
            writer.close()

    server = await asyncio.start_server(pour, "127.0.0.1", 0)
    gate = Gate(Access("127.0.0.1", TOKEN), server.sockets[0].getsockname(), [].append)
    gate.start("127.0.0.1", 0)
    try:
        before = open_sockets()
        with socket.create_connection(("127.0.0.1", gate.port)) as client:
            client.sendall(head(Authorization=f"Bearer {TOKEN}").encode())
            led = False
            for _ in range(600):
                await asyncio.sleep(0.05)
                now, led = open_sockets(), led or gate.connections == 1
                if led and gate.connections == 0 and now == before + 1:  # the client's own
                    break
            assert led
        return before + 1, now
    finally:
        await asyncio.to_thread(gate.close)
        server.close()


def test_a_client_that_takes_nothing_leaves_no_socket_behind(monkeypatch):
    monkeypatch.setattr(gate_module, "_SEND_TIMEOUT", 0.3)
    before, after = asyncio.run(open_sockets_after_one_that_takes_nothing())
    assert after == before


def test_a_token_with_a_plus_is_taken_from_the_address_as_it_is():
    token = "a+token/that+is+long=="
    asked = [head(f"/?token={shown}") for shown in (token, token.replace("+", "%2B"))]
    answers, _, _ = tried(*asked, token=token)
    assert [answer.split()[1] for answer in answers] == [b"101", b"101"]


@pytest.mark.parametrize("address", ["a..b", "192.0.2.1"])
def test_a_gate_that_cannot_listen_says_so_and_serves_nothing(address):
    gate = Gate(Access(address, TOKEN), ("127.0.0.1", 1), print)
    with pytest.raises(ConfigurationError, match="the Foxglove server "):
        gate.start(address, 0)
    assert gate.failure
