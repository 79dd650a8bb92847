"""Every node's health on `/diagnostics`, once a second, and the watch on data that stops coming."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node

from squeal_rig.graph import qos
from squeal_rig.graph.conversions import ERROR, OK, STALE, WARN, diagnostics, status
from squeal_rig.graph.lifetime import STEADY, GuardedExecutor, described

#: (level, message, values) of a node's health.
Health = tuple[bytes, str, Mapping[str, Any]]


class HealthPublisher:
    """Publishes a node's health once a second of real time, whatever `/clock` does."""

    def __init__(self, node: Node, health: Callable[[], Health]) -> None:
        self._node = node
        self._health = health
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", qos.EVENTS)
        node.create_timer(1.0, self.publish, clock=STEADY)

    def publish(self) -> None:
        """Publish now."""
        try:
            level, message, values = self._health()
        except Exception as error:
            level, message, values = ERROR, f"the health is not known: {described(error)}", {}
        executor = self._node.executor
        if isinstance(executor, GuardedExecutor):
            values = {**values, "refused requests": executor.refused_requests, "errors": executor.errors}
            failure, refusal = executor.untold()
            if failure:
                level, message = ERROR, failure
            elif refusal and level == OK:
                level, message = WARN, refusal
        name = self._node.get_fully_qualified_name().lstrip("/")
        stamp = self._node.get_clock().now().nanoseconds
        self._publisher.publish(diagnostics(stamp, status(level, name, message, values)))


class DataWatch:
    """Tells since when data has stopped coming, by the steady clock.

    Args:
        what: the data, for the sentence.
        limit: time without data [s] after which it is stale.
    """

    def __init__(self, what: str, limit: float = 1.0) -> None:
        self._what = what
        self._limit = limit
        self._last: float | None = None
        self._started = time.monotonic()

    def seen(self) -> None:
        """Data has come."""
        self._last = time.monotonic()

    def health(self, values: Mapping[str, Any]) -> Health:
        """Health of a node that needs the data: stale while it does not come."""
        since = time.monotonic() - (self._started if self._last is None else self._last)
        if self._last is None:
            return WARN if since < self._limit else STALE, f"no {self._what} yet", values
        if since > self._limit:
            return STALE, f"stale: no {self._what} for {since:.1f} s", values
        return OK, "running", values
