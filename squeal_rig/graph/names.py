"""One rig of a name: two would be commanded as one, and their samples be mixed."""

from __future__ import annotations

import errno
import hashlib
import socket
import time

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node

from squeal_rig.graph import qos
from squeal_rig.graph.lifetime import GuardedExecutor

# Health comes once a second, and two nodes were seen to match after 2.3 s.
_HEALTH_TIMEOUT = 3.5


class Claim:
    """A node's full name on a ROS domain, taken on this machine until it is released or the process has ended.

    By an abstract socket: it reaches as far as the loopback device, knows no users and goes with its process, however
    that ends. The graph is slower and says less: nodes find each other after 3 s at worst, and it lists a node that was
    killed for 20 s more.
    """

    def __init__(self, domain: int, name: str) -> None:
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.granted = True
        try:
            self._socket.bind(f"\0squeal_rig {domain} {hashlib.sha256(name.encode()).hexdigest()}")
        except OSError as error:
            self.granted = error.errno != errno.EADDRINUSE

    def release(self) -> None:
        """Give the name back."""
        self._socket.close()


def is_running(name: str, own: Node | None = None, discovery: float = 0.0) -> bool:
    """Whether the graph knows a node of that full name, other than our `own`, whose health comes.

    Nodes of other machines are found so, where the graph reaches that far; `discovery` is time to find them in [s].
    """
    heard: list[str] = []

    def take(message: DiagnosticArray) -> None:
        heard.extend(f"/{status.name}" for status in message.status)

    listener = Node("listener", use_global_arguments=False, start_parameter_services=False, enable_rosout=False)
    listener.create_subscription(DiagnosticArray, "/diagnostics", take, qos.EVENTS)
    executor = GuardedExecutor()
    executor.add_node(listener)

    def listed() -> bool:
        names = [f"{namespace.rstrip('/')}/{other}" for other, namespace in listener.get_node_names_and_namespaces()]
        return names.count(name) > (own is not None)

    executor.spin_for(discovery)
    deadline = time.monotonic() + _HEALTH_TIMEOUT
    while listed() and name not in heard and time.monotonic() < deadline:
        executor.spin_for(0.05)
    executor.shutdown()
    listener.destroy_node()  # not the last of its context, which is what `leave_graph` is for
    return name in heard
