"""Services of the type Trigger, and those like it: what is done returns a sentence, or says why it cannot be done."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from rclpy.node import Node
from std_srvs.srv import SetBool, Trigger

from squeal_rig.errors import SquealRigError

Response = TypeVar("Response", Trigger.Response, SetBool.Response)


def answer(response: Response, action: Callable[[], str]) -> Response:
    """The response with the sentence of `action`, or with that of the `SquealRigError` that it raised."""
    try:
        response.success, response.message = True, action()
    except SquealRigError as error:
        response.success, response.message = False, str(error)
    return response


def offer_trigger(node: Node, name: str, action: Callable[[], str]) -> None:
    """Offer an action as a Trigger service under the node's name."""
    node.create_service(Trigger, f"~/{name}", lambda _request, response: answer(response, action))
