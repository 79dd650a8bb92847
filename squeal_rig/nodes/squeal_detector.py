"""Node `squeal_detector`: `daq/samples` in; whether the rig squeals, how loud and at what frequency out."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2

from squeal_rig.errors import ParameterError, SquealRigError
from squeal_rig.estimation.settings import SquealSettings
from squeal_rig.estimation.squeal import SquealDetector, SquealState
from squeal_rig.graph import qos
from squeal_rig.graph.conversions import ERROR, OK, WARN, diagnostics, status
from squeal_rig.graph.health import DataWatch, Health, HealthPublisher
from squeal_rig.graph.lifetime import Lifetime, run_node
from squeal_rig.graph.parameters import NODE_OPTIONS, DeclaredParameters
from squeal_rig.graph.rig_follower import RigFollower
from squeal_rig.instruments.channels import DAQ_CHANNELS, block_from_cdr
from squeal_rig.instruments.description import RigDescription


class SquealDetectorNode(Node):
    """Watches the pad's displacement along the belt for squeal."""

    def __init__(self, lifetime: Lifetime) -> None:
        super().__init__("squeal_detector", **NODE_OPTIONS)
        self._settings = DeclaredParameters(self, (SquealSettings(),)).group(SquealSettings)
        self._detector: SquealDetector | None = None
        self._sample_rate = 0
        self._fault = ""
        self._rejected = 0
        self._watch = DataWatch("daq/samples")
        self._publisher = self.create_publisher(DiagnosticArray, "squeal/state", qos.EVENTS)
        RigFollower(self, self._on_rig)
        self.create_subscription(PointCloud2, "daq/samples", self._on_daq, qos.BLOCKS_IN, raw=True)
        HealthPublisher(self, self._health)

    def _on_rig(self, rig: RigDescription) -> None:
        if rig.sample_rate == self._sample_rate:
            return
        self._sample_rate, self._detector, self._fault = rig.sample_rate, None, ""
        try:
            self._detector = SquealDetector(rig.sample_rate, self._settings)
        except ParameterError as error:
            self._fault = str(error)
            self.get_logger().error(self._fault)

    def _on_daq(self, data: bytes) -> None:
        self._watch.seen()
        if self._detector is None:
            return
        try:
            stamp, _, daq = block_from_cdr(data, DAQ_CHANNELS)
            for state in self._detector.add_samples(stamp, daq):
                self._publisher.publish(_message(state))
        except SquealRigError as error:
            self._rejected += 1
            self.get_logger().warning(f"block refused: {error}", throttle_duration_sec=1.0)

    def _health(self) -> Health:
        values = {"rejected blocks": self._rejected}
        return (ERROR, self._fault, values) if self._fault else self._watch.health(values)


def _message(state: SquealState) -> DiagnosticArray:
    values = {
        "detected": state.detected,
        "level [dB re 1 um]": state.level,
        "frequency [Hz]": state.frequency,
        "since [s]": f"{state.since / 1e9:.9f}" if state.since is not None else "none",
    }
    level, text = (WARN, "squeal") if state.detected else (OK, "quiet")
    return diagnostics(state.stamp, status(level, "squeal", text, values))


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; returns the exit code."""
    return run_node(SquealDetectorNode, args)


if __name__ == "__main__":
    sys.exit(main())
