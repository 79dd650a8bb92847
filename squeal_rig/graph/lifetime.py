"""How every node starts, spins and ends: exit code 0 on SIGINT and SIGTERM, 2 on bad input, one sentence."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Sequence
from types import FrameType

import rclpy
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.exceptions import InvalidNamespaceException, InvalidNodeNameException
from rclpy.executors import SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from squeal_rig.errors import SquealRigError

# A signal only sets a flag, so a second one during teardown does no harm; the flag is seen after this time [s] at most.
_SPIN_TIMEOUT = 0.1

#: Pacing and staleness use it: a ROS-time timer never fires once `/clock` has died.
STEADY = Clock(clock_type=ClockType.STEADY_TIME)


class Lifetime:
    """Whether a node goes on; the node may end itself."""

    def __init__(self) -> None:
        self.stopping = False
        self.exit_code = 0

    def stop(self, exit_code: int = 0) -> None:
        """End the node once the current callback returns."""
        self.stopping, self.exit_code = True, exit_code

    def on_signal(self, _number: int, _frame: FrameType | None) -> None:
        """End the node cleanly, also on the second and third signal."""
        self.stopping = True


def run_node(factory: Callable[[Lifetime], Node], args: Sequence[str] | None = None) -> int:
    """Run one node to its end and return the process's exit code.

    `factory` builds the node; a node with a `close()` method has it called before it is destroyed.
    """
    lifetime = Lifetime()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lifetime.on_signal)
    try:
        rclpy.init(args=list(args) if args is not None else None, signal_handler_options=SignalHandlerOptions.NO)
        node = factory(lifetime)
    except (SquealRigError, InvalidNodeNameException, InvalidNamespaceException) as error:
        return _refused(str(error))
    except rclpy_implementation.UnknownROSArgsError as error:
        return _refused(f"unknown argument after --ros-args: {error}")
    except rclpy_implementation.RCLError as error:
        return _refused(_first_sentence(str(error)))
    try:
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        while rclpy.ok() and not lifetime.stopping:
            executor.spin_once(timeout_sec=_SPIN_TIMEOUT)
    except SquealRigError as error:
        lifetime.exit_code = _refused(str(error))
    finally:
        close = getattr(node, "close", None)
        if close is not None:
            close()
        node.destroy_node()
        rclpy.try_shutdown()
    return lifetime.exit_code


def _refused(sentence: str) -> int:
    sys.stderr.write(f"{sentence}\n")
    rclpy.try_shutdown()
    return 2


def _first_sentence(text: str) -> str:
    """rcl's message without the place in its source."""
    return " ".join(text.split(", at ")[0].split())
