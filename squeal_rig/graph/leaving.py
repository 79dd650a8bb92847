"""Leaving the graph, which the middleware may never let us do.

Fast DDS 2.14, as built for PyPI, locks up where a process leaves while news of the others' topics come in: it waits for
whoever takes them in, holding the lock that this one waits for (its endless deadline overflows; issue 6513 of
eProsima/Fast-DDS is about the same line). rclpy would hold Python's own lock meanwhile, and nothing could end the
process. So a thread gives the node back without that lock, and we wait for it only so long.
"""

from __future__ import annotations

import ctypes
import sys
import threading

from rclpy.executors import Executor
from rclpy.node import Node

# It takes some milliseconds, on a busy machine up to two seconds.
_PATIENCE = 4.0
# Who loads a library twice gets the same one.
_RCL = "librcl.so"


def leave_graph(executor: Executor, node: Node) -> bool:
    """Destroy a node, the last one of its context; False where the middleware did not let go of it.

    Then a thread of this process stays busy until the process ends, which it can.
    """
    executor.shutdown()  # first: what it holds of the node cannot be given back afterwards
    handle = node.handle
    # In use for ever: rclpy destroys all that belongs to the node, but must not give the node itself back once more.
    handle.__enter__()
    ctypes.pythonapi.Py_IncRef(ctypes.py_object(handle))
    node.destroy_node()
    pointer = ctypes.c_void_p(handle.pointer)
    # By the calls of rclpy: `PyDLL` keeps Python's lock as rclpy does, `CDLL` lets go of it.
    ctypes.PyDLL(_RCL).rcl_logging_rosout_fini_publisher_for_node(pointer)
    thread = threading.Thread(target=_rcl_node_fini, args=(pointer,), name="leave_graph", daemon=True)
    thread.start()
    thread.join(_PATIENCE)
    if not thread.is_alive():
        return True
    sys.stderr.write(f"the middleware did not let us leave the graph within {_PATIENCE:g} s: left without it\n")
    # At its end the process would wait for the same lock. The last one registered is the first one called: `_exit`,
    # with the exit code of the process.
    libc = ctypes.CDLL(None)
    libc.on_exit(libc._exit, None)
    return False


def _rcl_node_fini(pointer: ctypes.c_void_p) -> None:
    ctypes.CDLL(_RCL).rcl_node_fini(pointer)
