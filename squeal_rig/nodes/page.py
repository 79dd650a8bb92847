"""Node `page`: the operator's page. The graph on the node's thread, browsers on the server's."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from itertools import islice
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2

from squeal_rig.errors import SquealRigError
from squeal_rig.graph import qos
from squeal_rig.graph.beside import Beside
from squeal_rig.graph.conversions import ERROR, status_values
from squeal_rig.graph.health import Health, HealthPublisher
from squeal_rig.graph.lifetime import STEADY, Lifetime, run_node
from squeal_rig.graph.operator import Operator
from squeal_rig.graph.parameter_watch import ParameterWatch, Values
from squeal_rig.graph.parameters import NODE_OPTIONS, DeclaredParameters
from squeal_rig.graph.rig_follower import RigFollower
from squeal_rig.instruments.channels import FRICTION_WINDOW_NEEDED, block_from_cdr
from squeal_rig.instruments.description import RigDescription
from squeal_rig.instruments.driver import Samples
from squeal_rig.page.access import Access, in_url, read_token
from squeal_rig.page.commands import HIT
from squeal_rig.page.packing import packed
from squeal_rig.page.picture import Picture
from squeal_rig.page.server import PageServer
from squeal_rig.page.settings import PageSettings
from squeal_rig.page.sound import Sound
from squeal_rig.recording.messages import Status

_BESIDE = (sys.executable, str(Path(__file__).with_name("start.py")), "operating_map")
_LOOK_EVERY = 0.5
_MOST_VALUES = 200  # of a status
_MAP_LIMIT = 600.0  # longest time for a map [s]: a first one is compiled
# Points along each axis of a map: of the first one, which a busy machine has soon, and of the one that takes its place.
_COARSE, _FINE = 20, 80
# Parameters of the rig that do not change the map: they are its axes.
_AXES = ("preload", "belt_speed")


class PageNode(Node):
    """Feeds the page from the graph, and the graph with what the page's operator commands."""

    def __init__(self, lifetime: Lifetime) -> None:
        super().__init__("page", **NODE_OPTIONS)
        settings = DeclaredParameters(self, (PageSettings(),)).group(PageSettings)
        token = read_token(settings.token_file) if settings.token_file else ""
        access = Access(settings.address, token, settings.hosts)
        namespace = self.get_namespace().strip("/")
        self._picture = Picture(settings.control, namespace=f"{namespace}/" if namespace else "")
        self._sound = Sound()
        self._mapped: dict[str, Any] | None = None
        self._operator = Operator(self)
        self._server = PageServer(
            self._picture,
            self._sound,
            access,
            settings.control,
            self._operator.operate,
            frame_rate=settings.frame_rate,
            log=self._log,
        )
        answered = self.create_guard_condition(self._look_beside)
        self._beside = Beside(_BESIDE, answered.trigger, limit=_MAP_LIMIT)
        self._rig = RigFollower(self, self._on_rig, self._on_block)
        subscribe = self.create_subscription
        subscribe(PointCloud2, "friction/windows", self._on_window, qos.EVENTS, raw=True)
        subscribe(DiagnosticArray, "stability/summary", self._on_stability, qos.LATCHED)
        subscribe(DiagnosticArray, "squeal/state", self._on_squeal, qos.EVENTS)
        subscribe(DiagnosticArray, "/diagnostics", self._on_health, qos.EVENTS)
        self._run_events = subscribe(DiagnosticArray, "run/events", self._on_run, qos.RUN_EVENTS)
        subscribe(DiagnosticArray, "supervisor/state", lambda message: self._tell("supervisor", message), qos.LATCHED)
        subscribe(DiagnosticArray, "rig/safe", lambda message: self._tell("safe", message), qos.LATCHED)
        subscribe(DiagnosticArray, "supervisor/trips", self._on_trip, qos.RUN_EVENTS)
        self._watch = ParameterWatch(self, self._on_parameters, self._on_parameters)
        self.create_timer(_LOOK_EVERY, self._look, clock=STEADY)
        HealthPublisher(self, self._health)
        self._server.start(settings.address, settings.port)
        shown = in_url(settings.address)
        self.greeting = f"the page is at http://{shown}:{self._server.port}/" + (
            "" if settings.control else ", read-only but for the emergency stop"
        )

    def close(self) -> None:
        """End the server and the process beside."""
        self._server.close()
        self._beside.close()

    def _log(self, sentence: str) -> None:
        self.get_logger().warning(sentence)

    def _on_rig(self, rig: RigDescription) -> None:
        self._picture.take_rig(rig)
        machine = rig.parameters.replace(**dict.fromkeys(_AXES, 1.0)).as_mapping()
        if machine != self._mapped:
            self._mapped = machine
            self._server.show_map(packed("map", {"state": "being computed"}))
            self._beside.ask([machine, _COARSE])

    def _look(self) -> None:
        self._picture.take_run_is_heard(self.count_publishers(self._run_events.topic_name) > 0)
        self._look_beside()

    def _look_beside(self) -> None:
        found = self._beside.look()
        if found is None:
            return
        (machine, points), answer, reason = found
        if machine != self._mapped:  # it is another one by now
            return
        if answer is not None or points == _COARSE:  # without a fine one the coarse one stays
            self._server.show_map(packed("map", answer or {"state": reason}))
        if points == _COARSE and answer is not None and "rows" in answer:
            self._beside.ask([machine, _FINE])

    def _on_block(self, stamp: int, daq: Samples) -> None:
        self._picture.take_block(daq, 1e-9 * stamp)
        if self._rig.description is not None:
            for rate, message in self._sound.take_block(daq, self._rig.description.sample_rate):
                self._server.hear(rate, message)

    def _on_window(self, data: bytes) -> None:
        try:
            window = block_from_cdr(data, FRICTION_WINDOW_NEEDED).samples[0]
        except SquealRigError as error:
            self._rig.reject(error)
            return
        values = (float(window[name]) for name in ("t_end", "mu", "mu_ratio_of_means", "mu_true"))
        self._picture.take_window(*values)

    def _on_stability(self, message: DiagnosticArray) -> None:
        self._picture.take_stability({found.name: _status(found) for found in message.status})

    def _on_squeal(self, message: DiagnosticArray) -> None:
        for found in message.status[:1]:
            self._picture.take_squeal(_stamp(message), _status(found))

    def _on_run(self, message: DiagnosticArray) -> None:
        for found in message.status:
            self._picture.take_run(_stamp(message), _status(found))

    def _on_health(self, message: DiagnosticArray) -> None:
        for found in message.status:
            self._picture.take_health(found.name[:200], _status(found))

    def _tell(self, what: str, message: DiagnosticArray) -> None:
        for found in message.status[:1]:
            self._picture.take_told(what, _status(found))

    def _on_trip(self, message: DiagnosticArray) -> None:
        for found in message.status:
            _, sentence, values = _status(found)
            self._picture.take_trip(_stamp(message), values.get("level", ""), sentence)

    def _on_parameters(self, node: str, values: Values, _deleted: tuple[str, ...] = ()) -> None:
        if node == f"{self.get_namespace().rstrip('/')}/rig":
            self._picture.take_hit_settings({name: values[name] for name in HIT if name in values})
        elif node == f"{self.get_namespace().rstrip('/')}/supervisor":
            self._picture.take_limits(values)

    def _health(self) -> Health:
        server = self._server
        values = {
            "browsers": server.clients,
            "commands": server.commands,
            "refused": server.refused,
            "browsers dropped": server.dropped,
            "connections closed unused": server.strangers,
        }
        if self._server.failure:
            return ERROR, self._server.failure, values
        return self._rig.health(values)


def _stamp(message: DiagnosticArray) -> float:
    return float(message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec)


def _status(found: Any) -> Status:
    """The status, as much of it as a page needs: whoever is on the graph may have sent any amount."""
    values = islice(status_values(found).items(), _MOST_VALUES)
    cut = {name[:100]: value[:500] for name, value in values}
    return int.from_bytes(found.level, "little"), str(found.message)[:500], cut


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; returns the exit code."""
    return run_node(PageNode, args)


if __name__ == "__main__":
    sys.exit(main())
