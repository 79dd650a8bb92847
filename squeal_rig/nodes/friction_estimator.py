"""Node `friction_estimator`: `daq/samples` in; Eq. (2.1) per sample, Eq. (2.2) per window, the refitted law out."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from rclpy.node import Node
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Float64, Float64MultiArray

from squeal_rig.errors import SquealRigError
from squeal_rig.estimation.friction_follower import MODEL, MU, SAMPLES, WINDOWS, FrictionFollower, Message
from squeal_rig.estimation.settings import FrictionSettings
from squeal_rig.graph import qos
from squeal_rig.graph.health import Health, HealthPublisher, listeners
from squeal_rig.graph.lifetime import Lifetime, run_node
from squeal_rig.graph.parameters import NODE_OPTIONS, DeclaredParameters
from squeal_rig.graph.rig_follower import RigFollower
from squeal_rig.instruments.channels import TRUTH_CHANNELS, block_from_cdr
from squeal_rig.instruments.driver import Samples

_TOPICS = {
    SAMPLES: (PointCloud2, qos.BLOCKS),
    WINDOWS: (PointCloud2, qos.EVENTS),
    MU: (Float64, qos.EVENTS),
    MODEL: (Float64MultiArray, qos.LATCHED),
}


class FrictionEstimatorNode(Node):
    """Estimates friction from what the rig measures, with the rig's constants from its description."""

    def __init__(self, lifetime: Lifetime) -> None:
        super().__init__("friction_estimator", parameter_overrides=lifetime.kept, **NODE_OPTIONS)
        self._follower = FrictionFollower(DeclaredParameters(self, (FrictionSettings(),)).group(FrictionSettings))
        self._windows = 0
        self._outputs = {name: self.create_publisher(kind, name, profile) for name, (kind, profile) in _TOPICS.items()}
        self._rig = RigFollower(self, self._follower.take_rig, self._on_block, lifetime=lifetime)
        self.create_subscription(PointCloud2, "truth/samples", self._on_truth, qos.BLOCKS_IN, raw=True)
        HealthPublisher(self, self._health)

    def _on_block(self, stamp: int, daq: Samples) -> None:
        self._publish(self._follower.take_block(stamp, daq))

    def _on_truth(self, data: bytes) -> None:
        try:
            self._publish(self._follower.take_truth(block_from_cdr(data, TRUTH_CHANNELS).samples))
        except SquealRigError as error:
            self._rig.reject(error)

    def _publish(self, messages: Sequence[Message]) -> None:
        for name, data in messages:
            self._windows += name == WINDOWS
            self._outputs[name].publish(data)

    def _health(self) -> Health:
        return self._rig.health({"windows": self._windows, **listeners(self._outputs)})


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; returns the exit code."""
    return run_node(FrictionEstimatorNode, args)


if __name__ == "__main__":
    sys.exit(main())
