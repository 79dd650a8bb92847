"""Nodes as processes on a domain of their own, and a client that talks to them; every wait is bounded."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

PATIENCE = 20.0
LOAD = Path(__file__).with_name("full_load.py")


class Children:
    """Processes of one test; none outlives it."""

    def __init__(self, domain, logs):
        self._environment = {
            **os.environ,
            "ROS_DOMAIN_ID": str(domain),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "PYTHONUNBUFFERED": "1",
        }
        self._logs = logs
        self._running = []

    def start(self, command, name):
        """Start a command of this interpreter; its output goes to a log."""
        log = self._logs / f"{name}_{len(self._running)}.log"
        with open(log, "wb") as stream:
            process = subprocess.Popen(
                [sys.executable, *map(str, command)],
                env=self._environment,
                stdout=stream,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
        process.log = log
        self._running.append(process)
        return process

    def node(self, name, **parameters):
        """Start a node of the package."""
        given = [part for key, value in parameters.items() for part in ("-p", f"{key}:={_text(value)}")]
        return self.start(["-m", f"squeal_rig.nodes.{name}", "--ros-args", *given], name)

    def load(self, log, seconds=3600.0, wait=False):
        """Start the full load; where it is to `wait`, the first block comes when somebody listens to every topic."""
        return self.start([LOAD, log, seconds, *(["wait"] if wait else [])], "load")

    def end_all(self):
        """Kill what still runs."""
        for process in self._running:
            if process.poll() is None:
                os.kill(process.pid, signal.SIGKILL)
            process.wait(PATIENCE)


def _text(value):
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(f"'{item}'" for item in value) + "]"
    return str(value).lower() if isinstance(value, bool) else str(value)


def ended(process, number=signal.SIGINT):
    """End a process by a signal; its exit code."""
    process.send_signal(number)
    return process.wait(PATIENCE)


def published(log):
    """(number of blocks published, time of the last one [ns]) as the load's log tells."""
    lines = log.read_text().splitlines() if log.exists() else []
    whole = [line for line in lines if len(line.split()) == 2]
    return (int(whole[-1].split()[0]) + 1, int(whole[-1].split()[1])) if whole else (0, 0)


def wait_until(condition, what, patience=PATIENCE):
    """Wait for a condition that the client's spinning does not bring about."""
    deadline = time.monotonic() + patience
    while not condition():
        assert time.monotonic() < deadline, f"{what} did not come within {patience:g} s"
        time.sleep(0.02)


class Client:
    """The test's own node."""

    def __init__(self, domain):
        import rclpy
        from diagnostic_msgs.msg import DiagnosticArray
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.node import Node

        os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
        self._context = rclpy.Context()
        rclpy.init(args=[], context=self._context, domain_id=domain)
        self.node = Node("client", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self.health = {}
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._on_health, 100)

    def _on_health(self, message):
        for status in message.status:
            values = {pair.key: pair.value for pair in status.values}
            self.health[status.name] = (int.from_bytes(status.level, "little"), status.message, values)

    def wait_for(self, condition, what, patience=PATIENCE):
        """Spin until a condition holds."""
        deadline = time.monotonic() + patience
        while not condition():
            assert time.monotonic() < deadline, f"{what} did not come within {patience:g} s"
            self._executor.spin_once(timeout_sec=0.02)

    def trigger(self, service):
        """Call a trigger service; (success, message)."""
        from std_srvs.srv import Trigger

        answer = self._call(Trigger, service, Trigger.Request())
        return answer.success, answer.message

    def set(self, node, name, value):
        """Set a parameter; (successful, reason)."""
        from rcl_interfaces.srv import SetParameters
        from rclpy.parameter import Parameter

        request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
        (result,) = self._call(SetParameters, f"{node}/set_parameters", request).results
        return result.successful, result.reason

    def messages_recorded(self):
        """Messages that the recorder says it has taken."""
        return int(self.health["recorder"][2]["messages"]) if "recorder" in self.health else 0

    def close(self):
        """Leave the graph."""
        self.node.destroy_node()
        self._context.try_shutdown()

    def _call(self, kind, service, request):
        client = self.node.create_client(kind, service)
        self.wait_for(client.service_is_ready, service)
        future = client.call_async(request)
        self.wait_for(future.done, f"an answer of {service}")
        self.node.destroy_client(client)
        return future.result()
