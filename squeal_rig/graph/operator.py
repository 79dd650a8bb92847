"""What an operator commands, carried out on the graph: asked from any event loop, answered when the graph has."""

from __future__ import annotations

import asyncio
import contextlib
from typing import Any

from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.node import Node
from rclpy.parameter import Parameter
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger

from squeal_rig.experiments.engine import FITTED
from squeal_rig.graph import qos
from squeal_rig.page.commands import (
    ACTIVATE,
    DEACTIVATE,
    EMERGENCY_STOP,
    SET,
    SPRINGS_FITTED,
    SUPERVISOR_RESET,
    Command,
)

# Longest time for an answer [s].
_TIMEOUT = 10.0
_STOP_TIMEOUT = 3.0
# Longest time to connect a device anew [s].
_ACTIVATION = 60.0
# How often a service that is not there is looked for, and how long between [s]: discovery took up to 2.3 s.
_LOOKS, _LOOK_EVERY = 100, 0.05
# Commands that wait for the graph's answer, of all that ask; the emergency stop is not among them.
_MOST_UNDER_WAY = 8
# Command -> service (of type Trigger) that does it.
_TRIGGERS = {
    "reset": "rig/reset",
    "impact": "rig/impact",
    "zero": "rig/zero",
    "record_start": "recorder/start",
    "record_stop": "recorder/stop",
    "snapshot": "recorder/snapshot",
    SUPERVISOR_RESET: "supervisor/reset",
}
_TRANSITIONS = {DEACTIVATE: Transition.TRANSITION_DEACTIVATE, ACTIVATE: Transition.TRANSITION_ACTIVATE}
# Command -> node and parameter that takes its text.
_TEXTS = {SUPERVISOR_RESET: ("supervisor", "reset_reason"), SPRINGS_FITTED: ("console", FITTED)}


class Operator:
    """Clients of all that can be commanded.

    Args:
        node: spun by its own thread, which brings the answers.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        make = node.create_client
        self._triggers = {name: make(Trigger, service) for name, service in _TRIGGERS.items()}
        self._pause = make(SetBool, "rig/pause")
        self._set = make(SetParametersAtomically, "rig/set_parameters_atomically")
        self._texts = {name: make(SetParameters, f"{node}/set_parameters") for name, (node, _) in _TEXTS.items()}
        self._change_state = make(ChangeState, "rig/change_state")
        self._stop_service = make(Trigger, EMERGENCY_STOP)
        self._stop_topic = node.create_publisher(String, EMERGENCY_STOP, qos.EVENTS)
        self._stopping: asyncio.Task[tuple[bool, str]] | None = None
        self._under_way = 0

    async def operate(self, command: Command) -> tuple[bool, str]:
        """Carry a command out; returns whether it was, and the rig's own sentence."""
        if command.name == EMERGENCY_STOP:
            # One at a time: who asks meanwhile has the answer of the same.
            if self._stopping is None or self._stopping.done():
                self._stopping = asyncio.get_running_loop().create_task(self._stop())
            return await asyncio.shield(self._stopping)
        if self._under_way >= _MOST_UNDER_WAY:
            return False, f"{_MOST_UNDER_WAY} commands have no answer yet: wait"
        self._under_way += 1
        try:
            return await self._done(command)
        finally:
            self._under_way -= 1

    async def _done(self, command: Command) -> tuple[bool, str]:
        try:
            if command.name == SET:
                return await self._set_parameters(command)
            if command.name in _TRANSITIONS:
                return await self._taken_through(command.name)
            if command.name in _TEXTS:
                taken, refusal = await self._give_text(command)
                if not taken or command.name not in self._triggers:
                    return taken, _sentence(taken, refusal, f"{command.text}: confirmed")
            if command.name in ("pause", "resume"):
                answer = await self._answer(self._pause, SetBool.Request(data=command.name == "pause"))
            else:
                answer = await self._answer(self._triggers[command.name], Trigger.Request())
            return bool(answer.success), str(answer.message)
        except LookupError as error:
            return False, str(error.args[0])

    async def _give_text(self, command: Command) -> tuple[bool, str]:
        text = Parameter(_TEXTS[command.name][1], value=command.text).to_parameter_msg()
        answer = await self._answer(self._texts[command.name], SetParameters.Request(parameters=[text]))
        return bool(answer.results[0].successful), str(answer.results[0].reason)

    async def _taken_through(self, transition: str) -> tuple[bool, str]:
        """Through a transition of the rig's lifecycle; the answer of that has no words."""
        request = ChangeState.Request(transition=Transition(id=_TRANSITIONS[transition]))
        answer = await self._answer(self._change_state, request, _ACTIVATION)
        failed = f"the rig did not {transition}: its state does not allow it, or its health says why"
        return bool(answer.success), f"{transition}d" if answer.success else failed

    async def _stop(self) -> tuple[bool, str]:
        """By the topic first, which waits for nobody; then by the service, whose answer is the driver's."""
        self._stop_topic.publish(String(data=f"asked for by {self._node.get_name()}"))
        try:
            answer = await self._answer(self._stop_service, Trigger.Request(), _STOP_TIMEOUT)
        except LookupError as error:
            return False, str(error.args[0])
        return bool(answer.success), str(answer.message)

    async def _set_parameters(self, command: Command) -> tuple[bool, str]:
        parameters = [Parameter(name, value=value).to_parameter_msg() for name, value in command.values.items()]
        answer = await self._answer(self._set, SetParametersAtomically.Request(parameters=parameters))
        done = ", ".join(
            f"{name} = {value:g}" if isinstance(value, float) else f"{name} = {value}"
            for name, value in command.values.items()
        )
        successful, reason = bool(answer.result.successful), str(answer.result.reason)
        return successful, _sentence(successful, reason, done)

    async def _answer(self, client: Any, request: Any, timeout: float = _TIMEOUT) -> Any:
        """The answer of a service; LookupError, with a sentence, where there is none."""
        for _ in range(_LOOKS):  # a node that has just started may not have found it yet
            if client.service_is_ready():
                break
            await asyncio.sleep(_LOOK_EVERY)
        else:
            raise LookupError(f"nobody offers {client.srv_name}: its node does not run")
        loop = asyncio.get_running_loop()
        answered: asyncio.Future[Any] = loop.create_future()

        def deliver(future: Any) -> None:
            if not answered.done():  # nobody waits for it any more
                answered.set_result(future.result())

        def take(future: Any) -> None:
            with contextlib.suppress(RuntimeError):  # the loop has ended
                loop.call_soon_threadsafe(deliver, future)

        asked = client.call_async(request)
        asked.add_done_callback(take)
        try:
            return await asyncio.wait_for(answered, timeout)
        except asyncio.TimeoutError:
            client.remove_pending_request(asked)
            raise LookupError(f"{client.srv_name} did not answer within {timeout:g} s") from None


def _sentence(successful: bool, reason: str, done: str) -> str:
    """What an answer says: its reason, or, where it gives none, whether it was done."""
    return reason or (done if successful else "refused, and no reason was given")
