"""The page's web server, in a thread and on an event loop of its own: whatever a browser does holds up no node."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import time
from collections import deque
from collections.abc import Awaitable, Callable
from importlib.resources import files
from typing import Any

from aiohttp import WSCloseCode, WSMsgType, web

from squeal_rig.errors import ParameterError, SquealRigError, printable
from squeal_rig.page.access import Access, cookie_name
from squeal_rig.page.commands import EMERGENCY_STOP, MOST_BYTES, Command, RefusedError, command_of
from squeal_rig.page.picture import Picture
from squeal_rig.page.serving import ServerThread
from squeal_rig.page.sound import Sound

_STATIC = {
    "/": ("index.html", "text/html"),
    "/page.css": ("page.css", "text/css"),
    "/page.js": ("page.js", "text/javascript"),
    "/plots.js": ("plots.js", "text/javascript"),
    "/sound.js": ("sound.js", "text/javascript"),
}
_LOGIN = "login.html"
_HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:;"
    " connect-src 'self'; form-action 'self'; base-uri 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
    "Cross-Origin-Resource-Policy": "same-origin",
}
_MOST_CLIENTS = 32
# Who has connected and not yet made a request that was admitted has so long [s]; where there are more connections than
# so many, such strangers have no time at all.
_STRANGER_TIMEOUT, _MOST_CONNECTIONS, _LOOK_EVERY = 5.0, 256, 0.25
_MOST_SOUND = 500  # pieces of sound that wait for a client: 5 s
_SEND_TIMEOUT = 5.0  # a client that takes nothing for so long [s] is dropped
_STATE_EVERY = 0.5
_WORDS, _WORDS_PER_SECOND = 20.0, 10.0  # messages, and pings, a browser may send at once, and in the long run
_WRONG_TOKEN_DELAY = 0.5
_BODY_TIMEOUT = 5.0  # a command that takes longer to come [s] is none

Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]
#: Carries a command out; returns (done, sentence).
Operate = Callable[[Command], Awaitable[tuple[bool, str]]]
#: Messages for a time of a bag [s].
Seek = Callable[[float], list[bytes]]


class Client:
    """One browser: the newest picture of each kind, and sound in its order."""

    def __init__(self, socket: web.WebSocketResponse) -> None:
        self.socket = socket
        self.rate = 0
        self.wanted: float | None = None  # time of a bag [s]
        self._newest: dict[str, bytes] = {}
        self._sound: deque[bytes] = deque()
        self._waiting = asyncio.Event()
        self.hangs = False

    def give(self, kind: str, message: bytes) -> None:
        """Have a message sent; of one kind of picture only the newest."""
        self._newest[kind] = message
        self._waiting.set()

    def hear(self, message: bytes) -> None:
        """Have a piece of sound sent; a client that has stopped taking them is dropped."""
        if len(self._sound) >= _MOST_SOUND:
            self.hangs = True
        else:
            self._sound.append(message)
        self._waiting.set()

    async def send(self) -> None:
        """Send what there is, until the client is gone or hangs."""
        while not self.socket.closed and not self.hangs:
            await self._waiting.wait()
            self._waiting.clear()
            while (self._sound or self._newest) and not self.hangs:
                if self._sound:
                    message = self._sound.popleft()
                else:
                    message = self._newest.pop(next(iter(self._newest)))
                try:
                    await asyncio.wait_for(self.socket.send_bytes(message), _SEND_TIMEOUT)
                except (asyncio.TimeoutError, ConnectionError, RuntimeError):
                    self.hangs = True


class _Allowance:
    """`_WORDS` at once, and `_WORDS_PER_SECOND` in the long run."""

    def __init__(self) -> None:
        self._left, self._since = _WORDS, time.monotonic()

    def take(self) -> float:
        """Take one; returns how long to wait before it is used [s]."""
        now = time.monotonic()
        self._left = min(_WORDS, self._left + (now - self._since) * _WORDS_PER_SECOND) - 1.0
        self._since = now
        return max(0.0, -self._left / _WORDS_PER_SECOND)


class PageServer(ServerThread):
    """Serves the page.

    Args:
        picture, sound: what is shown and heard; fed from another thread.
        access: who may speak to it.
        control: whether commands other than the emergency stop are taken.
        operate: carries out a command, on the server's loop; None where there is nothing to operate.
        seek: the messages for a time of a bag; None for a live rig.
        frame_rate: most pictures a second [Hz].
        log: takes a sentence for the log.
    """

    def __init__(
        self,
        picture: Picture,
        sound: Sound,
        access: Access,
        control: bool = False,
        operate: Operate | None = None,
        seek: Seek | None = None,
        frame_rate: float = 15.0,
        log: Callable[[str], None] = lambda _sentence: None,
    ) -> None:
        super().__init__("the page")
        self._picture, self._sound, self._access, self._control = picture, sound, access, control
        self._operate, self._seek, self._period, self._log = operate, seek, 1.0 / frame_rate, log
        self._clients: set[Client] = set()
        self._admitted: set[object] = set()  # connections that have made a request that was admitted
        self._working: dict[object, int] = {}  # connections with requests that are being answered, and how many
        self._map: bytes | None = None
        self._told, self._untold, self._stop_told = 0.0, 0, 0.0
        self.refused = self.dropped = self.commands = self.strangers = 0
        static = files("squeal_rig.page") / "static"
        self._static = {path: (static.joinpath(name).read_bytes(), kind) for path, (name, kind) in _STATIC.items()}
        self._login = static.joinpath(_LOGIN).read_bytes()

    # --- for whoever feeds it, from any thread

    @property
    def clients(self) -> int:
        """Browsers that are connected."""
        return len(self._clients)

    def hear(self, rate: int, message: bytes) -> None:
        """Send a piece of sound to those who listen at that rate."""
        with contextlib.suppress(RuntimeError):  # the loop has ended
            self.loop.call_soon_threadsafe(self._heard, rate, message)

    def show_map(self, message: bytes) -> None:
        """Send the operating map, now and to whoever comes."""
        with contextlib.suppress(RuntimeError):
            self.loop.call_soon_threadsafe(self._mapped, message)

    # --- on the loop

    async def _serve(self) -> None:
        logging.getLogger("aiohttp").setLevel(logging.CRITICAL)  # it would log what strangers send
        self._stopping = asyncio.Event()
        app = web.Application(client_max_size=MOST_BYTES, middlewares=[self._guard])
        app.router.add_get("/ws", self._socket)
        app.router.add_post("/command", self._command)
        app.router.add_post("/login", self._take_login)
        for path in _STATIC:
            app.router.add_get(path, self._file)
        runner = web.AppRunner(
            app, access_log=None, keepalive_timeout=30.0, handler_cancellation=False, shutdown_timeout=1.0
        )
        await runner.setup()
        host, port = self._address
        site = web.TCPSite(runner, host, port)
        try:
            await site.start()
        except (OSError, OverflowError) as error:
            self._cannot_listen(error)
            await runner.cleanup()
            return
        assert site._server is not None
        self._listens(site._server.sockets[0].getsockname()[1])  # type: ignore[attr-defined]
        assert runner.server is not None
        tasks = [asyncio.create_task(self._show()), asyncio.create_task(self._close_strangers(runner.server))]
        stopping = asyncio.create_task(self._stopping.wait())
        await asyncio.wait((*tasks, stopping), return_when=asyncio.FIRST_COMPLETED)
        ended = [task for task in tasks if task.done()]
        for task in (*tasks, stopping):
            task.cancel()
        for client in list(self._clients):
            with contextlib.suppress(Exception):
                await asyncio.wait_for(client.socket.close(code=WSCloseCode.GOING_AWAY), 0.5)
        await runner.cleanup()
        for task in ended:
            await task  # it has ended by an exception, which is told

    async def _close_strangers(self, server: web.Server) -> None:
        """Close connections on which nobody asks for anything: who holds many of them keeps others out."""
        since: dict[Any, float] = {}
        while True:
            await asyncio.sleep(_LOOK_EVERY)
            now, present = time.monotonic(), set(server.connections)
            self._admitted &= present
            since = {one: since.get(one, now) for one in present - self._admitted}
            crowded = len(present) > _MOST_CONNECTIONS
            # Not who has come since the last look: it may be about to ask for a stop.
            longest = 0.5 * _LOOK_EVERY if crowded else _STRANGER_TIMEOUT
            unused = [one for one, begin in since.items() if now - begin >= longest]
            if crowded:  # nor does it help to have been admitted once
                unused += [one for one in present & self._admitted if one not in self._working]
            for one in unused:
                self.strangers += 1
                one.force_close()

    @web.middleware
    async def _guard(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        """Check every request, and give every answer its headers."""
        try:
            response = await self._guarded(request, handler)
        except web.HTTPException as error:
            response = _plain(error.status, error.reason)
        except asyncio.CancelledError:
            raise
        except Exception as error:
            self._refuse(request, f"{type(error).__name__} while it was answered")
            response = _plain(500, "it could not be answered")
        if not response.prepared:
            response.headers.update(_HEADERS)
            if response.status in (401, 403):
                response.force_close()
        return response

    async def _guarded(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        refusal = self._access.refusal(request.headers.get("Host", ""), request.headers.get("Origin"))
        if refusal:
            self._refuse(request, refusal)
            return _plain(403, "refused: the request is not of this page")
        if request.path == "/login" and request.method == "POST":
            return await handler(request)
        shown = request.cookies.get(cookie_name(self.port), "")
        if not self._access.admits(request.headers.get("Authorization", ""), shown):
            if request.path == "/" and "Authorization" not in request.headers:
                return web.Response(body=self._login, content_type="text/html", charset="utf-8", status=401)
            if request.path == "/page.css":  # the page that asks for the token has it
                return await self._file(request)
            self._refuse(request, "it does not show the token")
            return _plain(401, "refused: the token is needed")
        one = request.protocol
        self._admitted.add(one)
        self._working[one] = self._working.get(one, 0) + 1
        try:
            return await handler(request)
        except web.HTTPException as error:
            self._refuse(request, f"{error.status} {error.reason}")
            raise
        finally:
            self._working[one] -= 1
            if not self._working[one]:
                del self._working[one]

    async def _file(self, request: web.Request) -> web.Response:
        body, kind = self._static[request.path]
        return web.Response(body=body, content_type=kind, charset="utf-8")

    async def _take_login(self, request: web.Request) -> web.StreamResponse:
        form = await request.post()
        given = form.get("token", "")
        if not isinstance(given, str) or not self._access.is_token(given.strip()):
            self._refuse(request, "a wrong token")
            await asyncio.sleep(_WRONG_TOKEN_DELAY)
            wrong = self._login.replace(b"<!-- wrong -->", b'<p role="alert">That is not the token.</p>')
            return web.Response(body=wrong, content_type="text/html", charset="utf-8", status=403)
        answer = web.Response(status=303, headers={"Location": "/"})
        name = cookie_name(self.port)
        answer.set_cookie(name, self._access.cookie, httponly=True, samesite="Strict", path="/")
        return answer

    async def _command(self, request: web.Request) -> web.Response:
        """A command, as JSON; the emergency stop among them. A form of a foreign page cannot have this type."""
        if request.content_type != "application/json":
            self._refuse(request, "a command that is not JSON")
            return _plain(415, "a command is application/json")
        try:
            if self._operate is None:
                raise RefusedError("this is a recording: there is nothing to operate")
            text = await asyncio.wait_for(request.read(), _BODY_TIMEOUT)
            command = command_of(text, self._control)
        except asyncio.TimeoutError:
            self._refuse(request, f"a command that did not come within {_BODY_TIMEOUT:g} s")
            return _plain(408, "the command did not come")
        except RefusedError as error:
            self._refuse(request, str(error))
            return web.json_response({"done": False, "sentence": str(error)}, status=400)
        self.commands += 1
        if command.name == EMERGENCY_STOP:
            self._tell_stop(request)
        done, sentence = await self._operate(command)
        return web.json_response({"done": done, "sentence": printable(sentence)[:1000]}, status=200 if done else 409)

    async def _socket(self, request: web.Request) -> web.StreamResponse:
        if len(self._clients) >= _MOST_CLIENTS:
            self._refuse(request, f"{_MOST_CLIENTS} browsers are connected already")
            return _plain(503, "too many browsers are connected")
        # Its pings are answered by _listen: aiohttp itself answers any number of them.
        socket = web.WebSocketResponse(max_msg_size=MOST_BYTES, heartbeat=10.0, compress=False, autoping=False)
        await socket.prepare(request)
        client = Client(socket)
        self._clients.add(client)
        client.give("hello", self._picture.hello())
        if self._map is not None:
            client.give("map", self._map)
        if self._seek is None:
            client.give("state", self._picture.state())
        else:
            client.wanted = 0.0
        sender = asyncio.create_task(client.send())
        listener = asyncio.create_task(self._listen(client, request))
        try:
            await asyncio.wait((sender, listener), return_when=asyncio.FIRST_COMPLETED)
        finally:
            self._clients.discard(client)
            for task in (sender, listener):
                task.cancel()
            self._listening()
            if client.hangs:
                self.dropped += 1
                if request.transport is not None:
                    request.transport.abort()
            else:
                with contextlib.suppress(Exception):
                    await asyncio.wait_for(socket.close(), 1.0)
        return socket

    async def _listen(self, client: Client, request: web.Request) -> None:
        """Take what a browser says. One that says more than it may is read more slowly: its words wait with it.

        Who pings more than that is no browser, which never does, and goes: pings without content that wait cost
        memory which older versions of aiohttp do not count.
        """
        words, pings = _Allowance(), _Allowance()
        async for message in client.socket:
            if message.type in (WSMsgType.PING, WSMsgType.PONG):
                if pings.take() > 0.0:
                    self._refuse(request, "more pings on the socket than a browser sends")
                    return
                if message.type is WSMsgType.PING:
                    try:
                        await client.socket.pong(message.data)
                    except (ConnectionError, RuntimeError):  # it is gone
                        return
                continue
            if (wait := words.take()) > 0.0:
                await asyncio.sleep(wait)
            if message.type is not WSMsgType.TEXT:
                self._refuse(request, "a message on the socket that is not text")
                return
            try:
                self._take_word(client, message.data)
            except (ValueError, RecursionError, ParameterError) as error:
                self._refuse(request, f"a message on the socket that cannot be meant: {error}")
                return
        if client.socket.exception() is not None:
            self._refuse(request, f"the socket broke: {client.socket.exception()}")

    def _take_word(self, client: Client, text: str) -> None:
        """Take {"sound": rate or 0} or {"seek": time [s]}."""
        content = json.loads(text)
        if not isinstance(content, dict) or len(content) != 1:
            raise ParameterError("it is not one of sound and seek")
        (name, value), *_ = content.items()
        if name not in ("sound", "seek") or isinstance(value, bool) or not isinstance(value, int | float):
            raise ParameterError("it is not one of sound and seek with a number")
        if name == "sound":
            if not isinstance(value, int):
                raise ParameterError("a rate of sound is a whole number")
            rates = {other.rate for other in self._clients if other is not client and other.rate}
            self._sound.listen(rates | {value} if value else rates)
            client.rate = value
        elif not 0.0 <= value <= 1e9:
            raise ParameterError("seek must be 0 to 1e9 s")
        else:
            client.wanted = float(value)

    def _listening(self) -> None:
        self._sound.listen({client.rate for client in self._clients if client.rate})

    def _heard(self, rate: int, message: bytes) -> None:
        for client in self._clients:
            if client.rate == rate:
                client.hear(message)

    def _mapped(self, message: bytes) -> None:
        self._map = message
        for client in self._clients:
            client.give("map", message)

    async def _show(self) -> None:
        """Send pictures, as long as somebody looks."""
        next_state = 0.0
        while True:
            await asyncio.sleep(self._period)
            if not self._clients:
                continue
            try:
                if self._seek is not None:
                    await self._show_bag(self._seek)
                    continue
                frame = self._picture.frame()
                if frame is not None:
                    self._give("frame", frame)
                if time.monotonic() >= next_state:
                    next_state = time.monotonic() + _STATE_EVERY
                    self._give("state", self._picture.state())
            except Exception as error:
                self._log(f"a picture could not be made: {type(error).__name__}: {printable(str(error))}")
                await asyncio.sleep(1.0)

    async def _show_bag(self, seek: Seek) -> None:
        for client in list(self._clients):
            if client.wanted is None:
                continue
            wanted, client.wanted = client.wanted, None
            try:
                messages = await asyncio.to_thread(seek, wanted)
            except SquealRigError as error:
                self._log(str(error))
                continue
            for number, message in enumerate(messages):
                client.give(f"bag {number}", message)

    def _give(self, kind: str, message: bytes) -> None:
        for client in self._clients:
            client.give(kind, message)

    def _tell_stop(self, request: web.Request) -> None:
        """Log who asks for a stop, one line a second at most."""
        now = time.monotonic()
        if now - self._stop_told >= 1.0:
            self._stop_told = now
            self._log(f"emergency stop asked for by {request.remote}")

    def _refuse(self, request: web.Request, reason: str) -> None:
        """Count and log a request that was refused, one line a second at most; never what could hold a token."""
        self.refused += 1
        now = time.monotonic()
        if now - self._told < 1.0:
            self._untold += 1
            return
        more = f" ({self._untold} more before)" if self._untold else ""
        self._told, self._untold = now, 0
        what = f"{request.method} {printable(request.path)[:80]!r} of {request.remote}"
        self._log(f"refused {what}: {printable(reason)[:200]}{more}")


def _plain(status: int, sentence: str) -> web.Response:
    return web.Response(status=status, text=sentence + "\n", content_type="text/plain")
