"""A server in a thread and on an event loop of its own: whatever its clients do holds up no node."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from abc import ABC, abstractmethod

from squeal_rig.errors import ConfigurationError, printable

_START_TIMEOUT = 10.0


class ServerThread(ABC):
    """Runs `_serve`, which listens at `_address`, sets `port`, calls `_listens` and returns after `_stopping`.

    Args:
        what: the server, as a sentence begins with it.
    """

    def __init__(self, what: str) -> None:
        self._what = what
        self.loop = asyncio.new_event_loop()
        self._stopping: asyncio.Event | None = None
        self._started = threading.Event()
        self._failure = ""
        self._address = "", 0
        self._thread = threading.Thread(target=self._run, name=what, daemon=True)
        self.port = 0

    @property
    def failure(self) -> str:
        """Why it does not serve any more; empty while it does."""
        return self._failure or ("" if self._thread.is_alive() else f"{self._what} has ended")

    def start(self, address: str, port: int) -> None:
        """Listen.

        Raises:
            ConfigurationError: the address cannot be listened on.
        """
        self._address = address, port
        self._thread.start()
        if not self._started.wait(_START_TIMEOUT) or self._failure:
            raise ConfigurationError(self._failure or f"{self._what} did not start within {_START_TIMEOUT:g} s")

    def close(self) -> None:
        """End, with every connection."""
        if self._stopping is not None:
            with contextlib.suppress(RuntimeError):
                self.loop.call_soon_threadsafe(self._stopping.set)
        self._thread.join(_START_TIMEOUT)

    def _run(self) -> None:
        asyncio.set_event_loop(self.loop)
        try:
            self.loop.run_until_complete(self._serve())
        except Exception as error:
            self._failure = f"{self._what} has ended: {type(error).__name__}: {printable(str(error))[:200]}"
        finally:
            self._started.set()
            rest = asyncio.all_tasks(self.loop)
            for task in rest:
                task.cancel()
            if rest:
                self.loop.run_until_complete(asyncio.wait(rest, timeout=1.0))
            self.loop.close()

    def _listens(self, port: int) -> None:
        self.port = port
        self._started.set()

    def _cannot_listen(self, error: OSError | OverflowError) -> None:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        self._failure = f"{self._what} cannot listen on {self._address[0]} port {self._address[1]}: {reason}"

    @abstractmethod
    async def _serve(self) -> None:
        """Listen, and serve until cancelled: each kind of server in its own way."""
