"""The rig's services: reset, impact, zero, pause."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, TypeVar

from rclpy.node import Node
from std_srvs.srv import SetBool, Trigger

from squeal_rig.errors import SquealRigError

Response = TypeVar("Response", Trigger.Response, SetBool.Response)


class Operations(Protocol):
    """What the services ask of the rig; each returns a sentence and may raise a `SquealRigError`."""

    def reset(self) -> str:
        """Bring the pad to rest."""

    def impact(self) -> str:
        """An impact on the pad."""

    def zero(self) -> str:
        """Tare the force channels."""

    def pause(self, pause: bool) -> str:
        """Stop sampling for a while, or go on."""


def offer_services(node: Node, rig: Operations) -> None:
    """Offer the rig's operations as services under the node's name."""

    def trigger(action: Callable[[], str]) -> Callable[[Trigger.Request, Trigger.Response], Trigger.Response]:
        return lambda _request, response: _answer(response, action)

    node.create_service(Trigger, "~/reset", trigger(rig.reset))
    node.create_service(Trigger, "~/impact", trigger(rig.impact))
    node.create_service(Trigger, "~/zero", trigger(rig.zero))
    node.create_service(
        SetBool, "~/pause", lambda request, response: _answer(response, lambda: rig.pause(request.data))
    )


def _answer(response: Response, action: Callable[[], str]) -> Response:
    try:
        response.success, response.message = True, action()
    except SquealRigError as error:
        response.success, response.message = False, str(error)
    return response
