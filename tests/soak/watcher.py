"""A browser's stand-in that looks at the operator's page all the time, and comes back whenever the page is gone."""

import asyncio
import socket
import threading

import aiohttp

_AGAIN = 1.0  # s between two tries
#: What the page sends at most in one message [bytes]: a new map.
_MOST = 64 * 2**20


def free_port():
    """A port of the loopback address that nobody has now: the page has the same one after every start."""
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return found.getsockname()[1]


class Watcher:
    """Counts messages and connections, on a thread of its own."""

    def __init__(self, port):
        self.messages = self.connections = 0
        self._url = f"http://127.0.0.1:{port}/ws"
        self._ending = threading.Event()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._look()), daemon=True)
        self._thread.start()

    async def _look(self):
        async with aiohttp.ClientSession() as session:
            while not self._ending.is_set():
                try:
                    async with session.ws_connect(self._url, max_msg_size=_MOST) as page:
                        self.connections += 1
                        async for _ in page:
                            self.messages += 1
                            if self._ending.is_set():
                                return
                except aiohttp.ClientError:
                    pass
                await asyncio.sleep(_AGAIN)

    def close(self):
        self._ending.set()
        self._thread.join(10.0)
