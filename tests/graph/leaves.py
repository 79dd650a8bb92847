"""Child of `test_leaving.py`: joins the graph and leaves it, `stuck`, `churn SECONDS` or `come-and-go SECONDS`."""

import ctypes
import sys
import time

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from std_msgs.msg import String

from squeal_rig.graph import leaving


def _joined(name):
    context = rclpy.Context()
    rclpy.init(args=[], context=context)
    node = Node(name, context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    return context, node, executor


def _leave(executor, node):
    """Leave, and tell how long that took [s] and how it ended."""
    begin = time.monotonic()
    left = leaving.leave_graph(executor, node)
    sys.stdout.write(f"{time.monotonic() - begin:.3f} {'left' if left else 'kept'}\n")
    sys.stdout.flush()
    return left


def stuck():
    """Leave by a middleware that never lets go, and exit with 3."""
    leaving._rcl_node_fini = lambda _pointer: ctypes.CDLL(None).pause()
    context, node, executor = _joined("stuck")
    _leave(executor, node)
    context.try_shutdown()
    sys.exit(3)


def churn(end):
    """Have news for everybody on the graph all the time."""
    context, node, executor = _joined("churn")
    while time.monotonic() < end:
        for reader in [node.create_subscription(String, f"news_{n}", print, 1) for n in range(4)]:
            node.destroy_subscription(reader)
        executor.spin_once(0.0)
    leaving.leave_graph(executor, node)
    context.try_shutdown()


def come_and_go(end):
    """Join and leave over and over."""
    number = 0
    while time.monotonic() < end:
        context, node, executor = _joined(f"guest_{number}")
        node.create_subscription(String, "news_0", print, 1)
        for _ in range(number % 7):
            executor.spin_once(0.02)
        left = _leave(executor, node)
        context.try_shutdown()
        if not left:
            sys.exit(3)
        number += 1


if __name__ == "__main__":
    if sys.argv[1] == "stuck":
        stuck()
    {"churn": churn, "come-and-go": come_and_go}[sys.argv[1]](time.monotonic() + float(sys.argv[2]))
