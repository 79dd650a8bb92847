"""A guest on the graph, for `test_leaving.py`: `stuck`, `stay`, `churn SECONDS` or `come-and-go SECONDS`."""

import ctypes
import signal
import sys
import time

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import String

from squeal_rig.graph import leaving


def _joined(name):
    context = rclpy.Context()
    rclpy.init(args=[], context=context, signal_handler_options=SignalHandlerOptions.NO)
    node = Node(name, context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    return context, node, executor


def _leave(context, node, executor):
    """Leave, and tell how long that took [s] and how it ended."""
    begin = time.monotonic()
    left = leaving.leave_graph(executor, node)
    context.try_shutdown()
    sys.stdout.write(f"{time.monotonic() - begin:.3f} {'left' if left else 'kept'}\n")
    sys.stdout.flush()
    return left


class _NeverFini:
    """In place of the library: the one call that never returns."""

    rcl_node_fini = ctypes.CDLL(None).pause


def stuck():
    """Leave by a middleware that never lets go, and exit with 3, past what would wait at the end of the process."""
    libc, real = ctypes.CDLL(None), ctypes.CDLL
    libc.on_exit(libc.pause, None)
    guest = _joined("stuck")
    ctypes.CDLL = lambda name: _NeverFini if name == "librcl.so" else real(name)
    _leave(*guest)
    sys.exit(3)


def stay():
    """Stay until SIGINT comes, then leave."""
    asked = []
    signal.signal(signal.SIGINT, lambda *_: asked.append(True))
    guest = _joined("guest")
    while not asked:
        guest[2].spin_once(0.1)
    _leave(*guest)
    time.sleep(600.0)  # it is the leave that shall be seen by others, and not the end of the process


def churn(end):
    """Have news for everybody on the graph all the time."""
    context, node, executor = _joined("churn")
    while time.monotonic() < end:
        for reader in [node.create_subscription(String, f"news_{n}", print, 1) for n in range(4)]:
            node.destroy_subscription(reader)
        executor.spin_once(0.0)
    _leave(context, node, executor)


def come_and_go(end):
    """Join and leave over and over."""
    number = 0
    while time.monotonic() < end:
        context, node, executor = _joined(f"guest_{number}")
        node.create_subscription(String, "news_0", print, 1)
        for _ in range(number % 7):
            executor.spin_once(0.02)
        if not _leave(context, node, executor):
            sys.exit(3)
        number += 1


if __name__ == "__main__":
    if sys.argv[1] in ("stuck", "stay"):
        {"stuck": stuck, "stay": stay}[sys.argv[1]]()
    else:
        {"churn": churn, "come-and-go": come_and_go}[sys.argv[1]](time.monotonic() + float(sys.argv[2]))
