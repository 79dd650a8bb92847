"""Node `view`: small topics for people, drawn by stock tools without a plug-in."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Sequence

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Float64, Float64MultiArray

from squeal_rig.errors import SquealRigError
from squeal_rig.estimation import hard_squeal
from squeal_rig.estimation.stability_follower import IN_FORCE
from squeal_rig.graph import qos
from squeal_rig.graph.conversions import status_number
from squeal_rig.graph.health import Health, HealthPublisher
from squeal_rig.graph.lifetime import Lifetime, run_node
from squeal_rig.graph.parameters import NODE_OPTIONS, DeclaredParameters
from squeal_rig.graph.rig_follower import RigFollower
from squeal_rig.instruments.channels import FRICTION_WINDOW_NEEDED, TRUTH_CHANNELS, block_from_cdr
from squeal_rig.instruments.description import RigDescription
from squeal_rig.instruments.driver import Samples
from squeal_rig.view.follower import ARRAYS, LASTING, NUMBERS, SCOPE_RATE, Numbers, ViewFollower
from squeal_rig.view.settings import ViewSettings


class ViewNode(Node):
    """Feeds a `ViewFollower` from the graph and publishes what it says."""

    def __init__(self, lifetime: Lifetime) -> None:
        super().__init__("view", parameter_overrides=lifetime.kept, **NODE_OPTIONS)
        self._settings = DeclaredParameters(self, (ViewSettings(),)).group(ViewSettings)
        self._follower: ViewFollower | None = None
        self._sample_rate = 0
        self._numbers: Numbers = {}
        types = dict.fromkeys(ARRAYS, Float64MultiArray) | dict.fromkeys((*NUMBERS, SCOPE_RATE), Float64)
        self._outputs = {topic: self.create_publisher(kind, topic, qos.EVENTS) for topic, kind in types.items()}
        self._rig = RigFollower(self, self._on_rig, self._on_block, lifetime=lifetime)
        subscribe = self.create_subscription
        subscribe(PointCloud2, "truth/samples", self._on_truth, qos.BLOCKS_IN, raw=True)
        subscribe(PointCloud2, "friction/windows", self._on_window, qos.EVENTS, raw=True)
        subscribe(DiagnosticArray, "stability/summary", self._on_stability, qos.LATCHED)
        subscribe(DiagnosticArray, "squeal/state", self._on_squeal, qos.EVENTS)
        HealthPublisher(self, self._health)

    def _on_rig(self, rig: RigDescription) -> None:
        if rig.sample_rate != self._sample_rate:
            self._sample_rate = rig.sample_rate
            self._follower = ViewFollower(self._settings, rig.sample_rate, self._numbers)

    def _on_block(self, _stamp: int, daq: Samples) -> None:
        if self._follower is not None:
            for topic, data in self._follower.take_block(daq):
                self._outputs[topic].publish(data)

    def _on_truth(self, data: bytes) -> None:
        try:
            truth = block_from_cdr(data, TRUTH_CHANNELS).samples
            if self._follower is not None:
                self._follower.take_truth(truth)
        except SquealRigError as error:
            self._rig.reject(error)

    def _on_window(self, data: bytes) -> None:
        try:
            window = block_from_cdr(data, FRICTION_WINDOW_NEEDED).samples[0]
        except SquealRigError as error:
            self._rig.reject(error)
            return
        for topic, name in (
            ("view/mu", "mu_ratio_of_means"),
            ("view/mu_windows", "mu"),
            ("view/mu_true", "mu_true"),
        ):
            self._take(topic, float(window[name]))

    def _on_stability(self, message: DiagnosticArray) -> None:
        for name, topic, key in (
            (IN_FORCE, "view/margin", "margin"),
            (hard_squeal.NAME, "view/smallest_hit", hard_squeal.SMALLEST_HIT),
        ):
            found = next((found for found in message.status if found.name == name), None)
            # What is not told any more was of another point.
            self._take(topic, math.nan if found is None else status_number(found, key))

    def _on_squeal(self, message: DiagnosticArray) -> None:
        for found in message.status[:1]:
            self._take("view/squeal_level", status_number(found, "level [dB re 1 um]"))
            self._take("view/squeal_frequency", status_number(found, "frequency [Hz]"))

    def _health(self) -> Health:
        if not self.count_publishers("stability/summary"):  # nobody will say that it is not so any more
            for topic in LASTING:
                self._numbers.pop(topic, None)
        return self._rig.health({})

    def _take(self, topic: str, value: float) -> None:
        self._numbers[topic] = value, time.monotonic()


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; returns the exit code."""
    return run_node(ViewNode, args)


if __name__ == "__main__":
    sys.exit(main())
