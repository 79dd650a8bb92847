"""Node `stability`: complex eigenvalue analysis of the rig at every update of its parameters."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Float64MultiArray

from squeal_rig.errors import SquealRigError
from squeal_rig.estimation.stability_follower import EIGENVALUE_LABELS, Estimate, InForce, StabilityFollower
from squeal_rig.graph import qos
from squeal_rig.graph.conversions import diagnostics, labelled_array, status
from squeal_rig.graph.health import DataWatch, Health, HealthPublisher
from squeal_rig.graph.lifetime import Lifetime, run_node
from squeal_rig.graph.parameters import NODE_OPTIONS, DeclaredParameters
from squeal_rig.graph.rig_follower import RigFollower
from squeal_rig.instruments.channels import DAQ_CHANNELS, FRICTION_WINDOW_CHANNELS, block_from_cdr
from squeal_rig.instruments.description import RigDescription


class StabilityNode(Node):
    """Publishes eigenvalues and the stability summary: of the set point, of what is in force, with the estimated mu."""

    def __init__(self, lifetime: Lifetime) -> None:
        super().__init__("stability", **NODE_OPTIONS)
        DeclaredParameters(self, ())
        self._follower = StabilityFollower()
        self._analyses = 0
        self._rejected = 0
        self._watch = DataWatch("daq/samples")
        self._eigenvalues = self.create_publisher(Float64MultiArray, "stability/eigenvalues", qos.LATCHED)
        self._summary = self.create_publisher(DiagnosticArray, "stability/summary", qos.LATCHED)
        RigFollower(self, self._on_rig, events=True)
        self.create_subscription(PointCloud2, "daq/samples", self._on_daq, qos.BLOCKS, raw=True)
        self.create_subscription(PointCloud2, "friction/windows", self._on_window, qos.EVENTS, raw=True)
        HealthPublisher(self, self._health)

    def _on_rig(self, rig: RigDescription) -> None:
        self._follower.take_rig(rig)
        self._publish_if_due()

    def _on_daq(self, data: bytes) -> None:
        self._watch.seen()
        try:
            last = block_from_cdr(data, DAQ_CHANNELS).samples[-1]
            in_force = InForce(float(last["preload"]), float(last["belt_speed"]), int(last["seq"]))
        except SquealRigError as error:
            self._reject(error)
            return
        self._follower.take_block(in_force)
        self._publish_if_due()

    def _on_window(self, data: bytes) -> None:
        try:
            window = block_from_cdr(data, FRICTION_WINDOW_CHANNELS).samples[0]
            self._follower.take_estimate(Estimate(float(window["mu_ratio_of_means"]), float(window["t_end"])))
        except SquealRigError as error:
            self._reject(error)

    def _reject(self, error: SquealRigError) -> None:
        self._rejected += 1
        self.get_logger().warning(f"message refused: {error}", throttle_duration_sec=1.0)

    def _publish_if_due(self) -> None:
        """Analyse and publish; the eigenvalues are those of the set point."""
        now = time.monotonic()
        if not self._follower.is_due(now):
            return
        self._analyses += 1
        summary = self._follower.summary(now)
        if summary.eigenvalues is not None:
            self._eigenvalues.publish(labelled_array(summary.eigenvalues, *EIGENVALUE_LABELS))
        statuses = [status(bytes([s.level]), s.name, s.message, s.values) for s in summary.statuses]
        self._summary.publish(diagnostics(self.get_clock().now().nanoseconds, *statuses))

    def _health(self) -> Health:
        return self._watch.health({"analyses": self._analyses, "rejected messages": self._rejected})


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; returns the exit code."""
    return run_node(StabilityNode, args)


if __name__ == "__main__":
    sys.exit(main())
