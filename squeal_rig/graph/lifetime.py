"""How every node starts, spins and ends: exit code 0 on SIGINT, SIGTERM and SIGHUP, 2 on bad input, one sentence.

Nothing from outside ends a node: rclpy lets an exception of a callback, and its own on messages, requests and clocks
that it cannot take, through to whoever spins.
"""

from __future__ import annotations

import os
import sys
import time
import traceback
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import rclpy
from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.context import Context
from rclpy.exceptions import InvalidNamespaceException, InvalidNodeNameException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions

from squeal_rig.errors import ParameterError, SquealRigError
from squeal_rig.graph import signals
from squeal_rig.graph.leaving import leave_graph

# A signal only sets a flag, which is seen after this time [s] at most.
_SPIN_TIMEOUT = 0.1
# Time between leaving the graph and joining it anew [s]. In it everybody lets go of the shared memory there was with
# us, and Fast DDS removes that by a name which ours may have again.
_OUT_OF_THE_GRAPH = 3.0
# Of the domains that have ports, the last.
_LAST_DOMAIN = 232

#: Pacing and staleness use it: a ROS-time timer never fires once `/clock` has died.
STEADY = Clock(clock_type=ClockType.STEADY_TIME)


class Lifetime:
    """Whether a node goes on; the node may end itself, or have itself made anew.

    `rejoins` counts how often it was made anew; `kept` are the parameters that it had, for the one that follows.
    """

    def __init__(self) -> None:
        self._stopped = self._leaving = False
        self.exit_code = self.rejoins = 0
        self.kept: list[Parameter] = []

    @property
    def stopping(self) -> bool:
        """Whether the node is to end: by itself, or since a signal has come."""
        return self._stopped or signals.asked_to_end()

    @property
    def spinning(self) -> bool:
        """Whether the node that there is now is spun on."""
        return not self.stopping and not self._leaving

    def stop(self, exit_code: int = 0) -> None:
        """End the node once the current callback returns."""
        self._stopped, self.exit_code = True, exit_code

    def rejoin(self) -> None:
        """Have the node leave the graph once the current callback returns, and join it anew with its parameters."""
        self._leaving = True

    def anew(self, node: Node) -> bool:
        """Whether the node, which is spun no more, is to be made anew; its parameters are kept then."""
        leaving, self._leaving = self._leaving and not self.stopping, False
        if leaving:
            self.rejoins += 1
            self.kept = list(node.get_parameters_by_prefix("").values())
        return leaving


class GuardedExecutor(SingleThreadedExecutor):
    """Spins one node on, whatever its callbacks or rclpy raise: logged in a sentence, counted, told in its health.

    `errors` are callbacks that failed, `refused_requests` requests that did: those are answered with a refusal.
    """

    def __init__(self, context: Context | None = None) -> None:
        super().__init__(context=context)
        self.errors = self.refused_requests = 0
        self._untold = self._untold_request = ""
        self._node: Node | None = None

    def add_node(self, node: Node) -> bool:
        """Take the node, whose services are all there by now."""
        self._node = node
        for service in node.services:
            service.callback = partial(self._answered, service.callback)
        return bool(super().add_node(node))

    def spin_once(self, timeout_sec: float | None = None) -> None:
        """Run one callback, or wait that long for one [s]."""
        try:
            super().spin_once(timeout_sec)
        except ExternalShutdownException:
            pass  # we are ending, and who spins looks after that
        except Exception as error:
            self._note(error)

    def spin_for(self, seconds: float) -> None:
        """Take what comes for that long [s]."""
        deadline = time.monotonic() + seconds
        while (left := deadline - time.monotonic()) > 0.0:
            self.spin_once(left)

    def untold_error(self) -> str:
        """Sentence on the last error since this was last asked; empty where there was none."""
        told, self._untold = self._untold, ""
        return told

    def untold_refusal(self) -> str:
        """Sentence on the last refused request since this was last asked; empty where there was none."""
        told, self._untold_request = self._untold_request, ""
        return told

    def _note(self, error: Exception) -> None:
        self.errors += 1
        self._untold = f"a callback failed: {described(error)}"
        if self._node is not None:
            self._node.get_logger().error(self._untold, throttle_duration_sec=1.0)

    def _answered(self, callback: Callable[[Any, Any], Any], request: Any, response: Any) -> Any:
        try:
            return callback(request, response)
        except Exception as error:
            self.refused_requests += 1
            self._untold_request = f"a request was refused: {described(error)}"
            if self._node is not None:
                self._node.get_logger().warning(self._untold_request, throttle_duration_sec=1.0)
            return _refusal(request, type(response)(), described(error))


def _refusal(request: Any, response: Any, sentence: str) -> Any:
    """The answer that says no, in the fields that its service has for it."""
    refused = SetParametersResult(successful=False, reason=sentence)
    if isinstance(response, SetParameters.Response):
        response.results = [refused for _ in request.parameters]
    elif isinstance(response, SetParametersAtomically.Response):
        response.result = refused
    elif hasattr(response, "message"):
        response.message = sentence
    return response


def _without_place(error: Exception) -> str:
    """What an error says; rcl adds the place in its source."""
    return " ".join(str(error).split(", at ")[0].split())


def described(error: Exception) -> str:
    """An error in one sentence: our own as they are, others with their kind and place."""
    text = _without_place(error)
    if isinstance(error, SquealRigError):
        return text
    frames = traceback.extract_tb(error.__traceback__)
    place = f" ({Path(frames[-1].filename).name}, line {frames[-1].lineno})" if frames else ""
    return f"{type(error).__name__}: {text}{place}"


def join_graph(args: Sequence[str] | None) -> None:
    """`rclpy.init` without its signal handlers; arguments as after `--ros-args`.

    Raises:
        ParameterError: the ROS domain is none, or an argument is wrong.
    """
    domain = os.environ.get("ROS_DOMAIN_ID", "")
    whole = domain.isascii() and domain.isdecimal()
    # Fast DDS would end the process.
    if domain and not (whole and int(domain.lstrip("0")[:4] or "0") <= _LAST_DOMAIN):
        raise ParameterError(f"ROS_DOMAIN_ID = {domain[:20]!r} cannot be: it must be a number from 0 to {_LAST_DOMAIN}")
    try:
        rclpy.init(args=list(args) if args is not None else None, signal_handler_options=SignalHandlerOptions.NO)
    except rclpy_implementation.UnknownROSArgsError as error:
        raise ParameterError(f"unknown argument after --ros-args: {error}") from None
    except rclpy_implementation.RCLError as error:
        raise ParameterError(_without_place(error)) from None


def run_node(factory: Callable[[Lifetime], Node], args: Sequence[str] | None = None) -> int:
    """Run one node to its end and return the process's exit code.

    `factory` builds the node; a node with a `close()` method has it called before it is destroyed, and one with a
    `greeting` says it once it runs.
    """
    signals.watch()
    try:
        return 0 if signals.asked_to_end() else _run(factory, args)
    finally:
        signals.ignore()


def _run(factory: Callable[[Lifetime], Node], args: Sequence[str] | None) -> int:
    lifetime = Lifetime()
    while True:
        code = _run_once(factory, args, lifetime)
        if code is not None and (not code or not lifetime.rejoins or lifetime.stopping):
            return code
        # It ran before, so it is tried until it runs again. Parameters are kept: their files may have changed by now.
        args = _without_files(sys.argv if args is None else args)
        joins = time.monotonic() + _OUT_OF_THE_GRAPH
        while time.monotonic() < joins and not lifetime.stopping:
            time.sleep(_SPIN_TIMEOUT)
        if lifetime.stopping:
            return lifetime.exit_code


def _without_files(arguments: Sequence[str]) -> list[str]:
    """Arguments of a node without its parameter files."""
    files = [place for place, word in enumerate(arguments) if word == "--params-file"]
    return [word for place, word in enumerate(arguments) if place not in files and place - 1 not in files]


def _run_once(factory: Callable[[Lifetime], Node], args: Sequence[str] | None, lifetime: Lifetime) -> int | None:
    """Run the node from joining the graph to leaving it; returns the exit code, None where it is to join anew."""
    try:
        join_graph(args)
        node = factory(lifetime)
    except (SquealRigError, InvalidNodeNameException, InvalidNamespaceException) as error:
        return _refused(str(error), 2)
    except rclpy_implementation.RCLError as error:
        return _refused(_without_place(error), 2)
    except OSError as error:  # a path that cannot be, a port that is taken
        return _refused(str(error), 2)
    except Exception as error:
        return _refused(f"the node could not start: {described(error)}", 1)
    executor = GuardedExecutor()
    executor.add_node(node)
    greeting = getattr(node, "greeting", "waiting for daq/samples")
    node.get_logger().info(f"{greeting}; ROS domain {node.context.get_domain_id()}, Ctrl-C ends it")
    anew = False
    try:
        while rclpy.ok() and lifetime.spinning:
            executor.spin_once(_SPIN_TIMEOUT)
        anew = lifetime.anew(node)
    finally:
        close = getattr(node, "close", None)
        try:
            if close is not None:
                close()
        except Exception as error:
            failed = _refused(f"the node did not end well: {described(error)}", 1)
            lifetime.exit_code = lifetime.exit_code if anew else failed
        leave_graph(executor, node)
        rclpy.try_shutdown()
    return None if anew else lifetime.exit_code


def _refused(sentence: str, exit_code: int) -> int:
    sys.stderr.write(f"{sentence}\n")
    rclpy.try_shutdown()
    return exit_code
