"""What stands before a WebSocket server that checks nothing itself: host, origin and token, then bytes both ways."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Callable
from urllib.parse import parse_qs, urlsplit

from squeal_rig.errors import printable
from squeal_rig.page.access import Access
from squeal_rig.page.serving import ServerThread

_LONGEST_HEAD = 16 * 1024
_HEAD_TIMEOUT = 5.0  # a head that takes longer [s] is none
# Connections that are led on, and those whose head has not been judged. Where there are so many of these, the oldest
# makes room for who comes: strangers keep nobody out.
_MOST_CONNECTIONS, _MOST_HEADS = 32, 256
_SEND_TIMEOUT = 30.0  # a client that takes nothing for so long [s] is left
_LAST_WAIT = 1.0  # for a client to take what is left when its connection is closed [s]
_PIECE = 64 * 1024
_TOKEN_KEY = "token"


class Gate(ServerThread):
    """Listens in a thread and on an event loop of its own, and leads who may pass to the server behind.

    The token is shown as `Authorization: Bearer TOKEN`, or as `?token=TOKEN` by what can set no header; it goes no
    further, and into no log.

    Args:
        access: who may pass.
        behind: address and port of the server.
        log: takes a sentence for the log.
    """

    def __init__(self, access: Access, behind: tuple[str, int], log: Callable[[str], None]) -> None:
        self._access, self._behind, self._log = access, behind, log
        super().__init__("the Foxglove server")
        self._told = 0.0
        self._unjudged: dict[asyncio.StreamWriter, None] = {}  # the oldest first
        self.connections = self.refused = 0

    async def _serve(self) -> None:
        self._stopping = asyncio.Event()
        host, port = self._address
        try:
            server = await asyncio.start_server(self._connected, host, port, limit=_LONGEST_HEAD)
        except (OSError, OverflowError) as error:
            self._cannot_listen(error)
            return
        self._listens(server.sockets[0].getsockname()[1])
        await self._stopping.wait()
        server.close()
        others = [task for task in asyncio.all_tasks() if task is not asyncio.current_task()]
        for task in others:
            task.cancel()
        await asyncio.gather(*others, return_exceptions=True)

    async def _connected(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            if len(self._unjudged) >= _MOST_HEADS:
                self._close_oldest()
            self._unjudged[writer] = None
            try:
                head = await self._judge(reader, writer)
            finally:
                self._unjudged.pop(writer, None)
            if head is None:
                return
            if self.connections >= _MOST_CONNECTIONS:
                await self._refuse(writer, "503 Service Unavailable", "too many connections")
                return
            self.connections += 1
            try:
                await self._lead(head, reader, writer)
            finally:
                self.connections -= 1
        except (OSError, asyncio.IncompleteReadError):
            pass  # one side is gone
        finally:
            await _close(writer)

    def _close_oldest(self) -> None:
        oldest = next(iter(self._unjudged))
        del self._unjudged[oldest]
        self._count_refusal(oldest, "it sent no request header while many others came")
        oldest.transport.abort()

    async def _judge(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> bytes | None:
        """The head that goes to the server behind; None where it was refused."""
        try:
            head = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), _HEAD_TIMEOUT)
        except (asyncio.LimitOverrunError, asyncio.TimeoutError):
            await self._refuse(writer, "400 Bad Request", "a request header that is too long or came too slowly")
            return None
        line, *lines = head.decode("latin-1").split("\r\n")[:-2]
        words = line.split(" ")
        fields = [field.partition(":") for field in lines]
        headers: dict[str, str] = {name.lower(): value.strip() for name, _, value in fields}
        if len(words) != 3 or words[0] != "GET" or len(headers) != len(lines) or "\n" in line + "".join(lines):
            await self._refuse(writer, "400 Bad Request", "a request that does not open a WebSocket")
            return None
        refusal = self._access.refusal(headers.get("host", ""), headers.get("origin"))
        if refusal:
            await self._refuse(writer, "403 Forbidden", refusal)
            return None
        given = headers.pop("authorization", "")
        shown = _shown_token(words[1])
        if not self._access.admits(f"Bearer {shown}" if shown else given, ""):
            await self._refuse(writer, "401 Unauthorized", "it does not show the token")
            return None
        kept = "".join(f"{name}: {value}\r\n" for name, value in headers.items() if name != "origin")
        return f"GET / HTTP/1.1\r\n{kept}\r\n".encode("latin-1")

    async def _lead(self, head: bytes, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Carry bytes both ways, until one side ends or takes nothing for too long."""
        behind_reader, behind_writer = await asyncio.open_connection(*self._behind)
        try:
            behind_writer.write(head)
            ways = [
                asyncio.create_task(_pipe(reader, behind_writer)),
                asyncio.create_task(_pipe(behind_reader, writer)),
            ]
            try:
                await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
            finally:
                for way in ways:
                    way.cancel()
        finally:
            await _close(behind_writer)

    def _count_refusal(self, writer: asyncio.StreamWriter, reason: str) -> None:
        """Count and log it, one line a second at most."""
        self.refused += 1
        if time.monotonic() - self._told > 1.0:
            self._told = time.monotonic()
            peer = writer.get_extra_info("peername")
            self._log(f"refused a connection of {peer[0] if peer else 'somebody'}: {printable(reason)[:200]}")

    async def _refuse(self, writer: asyncio.StreamWriter, status: str, reason: str) -> None:
        self._count_refusal(writer, reason)
        writer.write(f"HTTP/1.1 {status}\r\nContent-Length: 0\r\nConnection: close\r\n\r\n".encode())
        with contextlib.suppress(OSError, asyncio.TimeoutError):
            await asyncio.wait_for(writer.drain(), 1.0)


def _shown_token(target: str) -> str:
    try:
        query = urlsplit(target).query.replace("+", "%2B")  # a token may have it, and parse_qs makes it a space
        return next(iter(parse_qs(query).get(_TOKEN_KEY, [])), "")
    except ValueError:
        return ""


async def _close(writer: asyncio.StreamWriter) -> None:
    """Close a connection, by force where the other side does not take what is left: its socket would stay with us."""
    writer.close()
    try:
        await asyncio.wait_for(writer.wait_closed(), _LAST_WAIT)
    except (OSError, asyncio.TimeoutError):
        writer.transport.abort()


async def _pipe(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    with contextlib.suppress(OSError, asyncio.TimeoutError):
        while data := await reader.read(_PIECE):
            writer.write(data)
            await asyncio.wait_for(writer.drain(), _SEND_TIMEOUT)
