"""Asks every node of the graph for all its parameters, once, and follows every change after that."""

from __future__ import annotations

import time
from array import array
from collections.abc import Callable, Mapping
from typing import Any

from rcl_interfaces.msg import ParameterEvent
from rcl_interfaces.srv import GetParameters, ListParameters
from rclpy.client import Client
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from rclpy.qos import qos_profile_parameter_events

from squeal_rig.graph.lifetime import STEADY

_PERIOD = 0.5
# A service was seen to match after 2.3 s at worst; each time that nothing comes, the wait for the next answer doubles.
_PATIENCE = 10.0
_MOST_DOUBLINGS = 5

Values = dict[str, Any]


class _Question:
    """One node being asked; the clients live only as long as the question."""

    def __init__(self, node: Node, name: str, patience: float) -> None:
        self.list: Client = node.create_client(ListParameters, f"{name}/list_parameters")
        self.get: Client = node.create_client(GetParameters, f"{name}/get_parameters")
        self.deadline = time.monotonic() + patience
        self.sent = False


class ParameterWatch:
    """Calls back with (node, all values) once for each node, and with (node, values, deleted) for each change.

    Nothing here waits: a node that does not answer, stopped or still starting, is asked again, ever more rarely.
    """

    def __init__(
        self,
        node: Node,
        at_start: Callable[[str, Values], None],
        changed: Callable[[str, Values, tuple[str, ...]], None],
    ) -> None:
        self._node = node
        self._at_start = at_start
        self._changed = changed
        self._asked: dict[str, int] = {}
        self._questions: dict[str, _Question] = {}
        self._answered: set[str] = set()
        node.create_timer(_PERIOD, self._look, clock=STEADY)
        node.create_subscription(ParameterEvent, "/parameter_events", self._on_event, qos_profile_parameter_events)

    @property
    def answered(self) -> int:
        """Nodes whose parameters are known."""
        return len(self._answered)

    def own(self) -> Values:
        """All parameters of the watching node itself."""
        return {name: _plain(p.value) for name, p in self._node.get_parameters_by_prefix("").items()}

    def _look(self) -> None:
        present = set()
        own = self._node.get_fully_qualified_name()
        for name, namespace in self._node.get_node_names_and_namespaces():
            full = f"{namespace.rstrip('/')}/{name}"
            present.add(full)
            if full == own:
                if own not in self._answered:
                    self._answered.add(own)
                    self._at_start(own, self.own())
            elif full not in self._answered and full not in self._questions:
                times = self._asked.get(full, 0)
                self._asked[full] = times + 1
                self._questions[full] = _Question(self._node, full, _PATIENCE * 2 ** min(times, _MOST_DOUBLINGS))
        self._answered &= present  # a node that comes back is asked anew
        self._asked = {name: count for name, count in self._asked.items() if name in present}
        for full, question in list(self._questions.items()):
            if question.deadline < time.monotonic() or full not in present:
                self._forget(full)
            elif not question.sent and question.list.service_is_ready() and question.get.service_is_ready():
                question.sent = True
                future = question.list.call_async(ListParameters.Request(depth=ListParameters.Request.DEPTH_RECURSIVE))
                future.add_done_callback(lambda answer, full=full: self._on_names(full, answer.result()))

    def _on_names(self, full: str, answer: Any) -> None:
        question = self._questions.get(full)
        if question is None or answer is None:
            return
        names = list(answer.result.names)
        future = question.get.call_async(GetParameters.Request(names=names))
        future.add_done_callback(lambda values, full=full, names=names: self._on_values(full, names, values.result()))

    def _on_values(self, full: str, names: list[str], answer: Any) -> None:
        if full in self._questions and answer is not None and len(answer.values) == len(names):
            values = (_plain(parameter_value_to_python(value)) for value in answer.values)
            self._answered.add(full)
            self._at_start(full, dict(zip(names, values, strict=True)))
        self._forget(full)

    def _forget(self, full: str) -> None:
        question = self._questions.pop(full, None)
        if question is not None:
            # Destroyed from the executor's next round: a client must not go while its own answer is handled.
            self._node.executor.create_task(self._destroy, question)

    def _destroy(self, question: _Question) -> None:
        self._node.destroy_client(question.list)
        self._node.destroy_client(question.get)

    def _on_event(self, event: ParameterEvent) -> None:
        values: Mapping[str, Any] = {
            parameter.name: _plain(parameter_value_to_python(parameter.value))
            for parameter in (*event.new_parameters, *event.changed_parameters)
        }
        deleted = tuple(parameter.name for parameter in event.deleted_parameters)
        if values or deleted:
            self._changed(event.node, dict(values), deleted)


def _plain(value: Any) -> Any:
    """A parameter's value as YAML holds it."""
    if isinstance(value, (array, tuple, list)):
        return [_plain(item) for item in value]
    return value.hex() if isinstance(value, bytes) else value
