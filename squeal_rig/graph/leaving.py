"""Leaving the graph, which the middleware may never let us do.

Fast DDS 2.14, as built for PyPI, locks up where a process leaves while news of the others' topics come in: the callback
that takes them in needs the lock that the leaving thread spins with (its endless deadline overflows; issue 6513 of
eProsima/Fast-DDS is about the same line). rclpy would hold Python's own lock meanwhile, and nothing could end the
process. So a thread gives the node back without that lock, and we wait for it only so long.
"""

from __future__ import annotations

import ctypes
import sys
import threading
from contextlib import suppress

from rclpy.executors import Executor
from rclpy.node import Node

#: Longest time to leave [s]. It takes some milliseconds, on a busy machine up to two seconds.
PATIENCE = 4.0
_SENTENCE = (
    f"the middleware did not let us leave the graph within {PATIENCE:g} s: until this process ends, a thread of it"
    " keeps a processor busy"
)


def leave_graph(executor: Executor, node: Node) -> bool:
    """Destroy a node, the last one of its context, once; False where the middleware did not let go of it in time.

    The process can end then, with its own exit code; until its end others may still see it.
    """
    executor.shutdown()  # first: what it holds of the node cannot be given back afterwards
    try:
        # The library that rclpy has loaded, found by its name. `PyDLL` keeps Python's lock, as rclpy does here, since
        # it guards rcl's table of loggers; `CDLL` lets go of it.
        fini_logger = ctypes.PyDLL("librcl.so").rcl_logging_rosout_fini_publisher_for_node
        fini = ctypes.CDLL("librcl.so").rcl_node_fini
    except (OSError, AttributeError):  # a ROS that is built otherwise
        node.destroy_node()
        return True
    handle = node.handle
    # In use for ever: rclpy destroys all that belongs to the node, but must not give the node itself back once more.
    handle.__enter__()
    ctypes.pythonapi.Py_IncRef(ctypes.py_object(handle))
    node.destroy_node()
    pointer = ctypes.c_void_p(handle.pointer)
    fini_logger(pointer)
    thread = threading.Thread(target=fini, args=(pointer,), name="leave_graph", daemon=True)
    thread.start()
    thread.join(PATIENCE)
    if not thread.is_alive():
        return True
    # The tidying of C++ at the end of the process would wait for the same lock. What is registered last is called
    # first: `_exit`, with the exit code of the process.
    libc = ctypes.CDLL(None)
    libc.on_exit(libc._exit, None)
    with suppress(OSError, AttributeError):  # nobody reads what we say any more
        sys.stderr.write(f"{_SENTENCE}\n")
    return False
