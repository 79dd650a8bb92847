"""Node `friction_estimator`: `daq/samples` in; Eq. (2.1) per sample, Eq. (2.2) per window, the refitted law out."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence

import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Float64, Float64MultiArray

from squeal_rig.errors import SquealRigError
from squeal_rig.estimation.friction import FrictionEstimator, FrictionWindow
from squeal_rig.estimation.regression import MODEL_COLUMNS, FrictionRegression
from squeal_rig.estimation.settings import FrictionSettings
from squeal_rig.graph import qos
from squeal_rig.graph.conversions import cloud, labelled_array
from squeal_rig.graph.health import DataWatch, Health, HealthPublisher
from squeal_rig.graph.lifetime import Lifetime, run_node
from squeal_rig.graph.parameters import NODE_OPTIONS, DeclaredParameters
from squeal_rig.graph.rig_follower import RigFollower
from squeal_rig.instruments.channels import DAQ_CHANNELS, FRICTION_SAMPLE_RECORD, TRUTH_CHANNELS, block_from_cdr
from squeal_rig.instruments.description import RigDescription


class FrictionEstimatorNode(Node):
    """Estimates friction from what the rig measures, with the rig's constants from its description."""

    def __init__(self, lifetime: Lifetime) -> None:
        super().__init__("friction_estimator", **NODE_OPTIONS)
        self._declared = DeclaredParameters(self, (FrictionSettings(),))
        self._estimator: FrictionEstimator | None = None
        self._regression = FrictionRegression()
        self._rejected = 0
        self._windows = 0
        self._watch = DataWatch("daq/samples")
        self._mu = self.create_publisher(Float64, "friction/mu", qos.EVENTS)
        self._windows_publisher = self.create_publisher(PointCloud2, "friction/windows", qos.EVENTS)
        self._samples = self.create_publisher(PointCloud2, "friction/samples", qos.BLOCKS)
        self._model = self.create_publisher(Float64MultiArray, "friction/model", qos.LATCHED)
        RigFollower(self, self._on_rig)
        self.create_subscription(PointCloud2, "daq/samples", self._on_daq, qos.BLOCKS_IN, raw=True)
        self.create_subscription(PointCloud2, "truth/samples", self._on_truth, qos.BLOCKS_IN, raw=True)
        HealthPublisher(self, self._health)

    def _on_rig(self, rig: RigDescription) -> None:
        if self._estimator is None or self._estimator.rig.sample_rate != rig.sample_rate:
            self._estimator = FrictionEstimator(rig, self._declared.group(FrictionSettings))
        self._estimator.rig = rig

    def _on_daq(self, data: bytes) -> None:
        self._watch.seen()
        if self._estimator is None:
            return
        try:
            stamp, _, daq = block_from_cdr(data, DAQ_CHANNELS)
            mu, valid, windows = self._estimator.add_samples(stamp, daq)
        except SquealRigError as error:
            self._reject(error)
            return
        samples = np.zeros(len(daq), FRICTION_SAMPLE_RECORD)
        samples["t"], samples["mu"], samples["valid"], samples["seq"] = daq["t"], mu, valid, daq["seq"]
        self._samples.publish(cloud(samples, stamp))
        self._publish(windows)

    def _on_truth(self, data: bytes) -> None:
        if self._estimator is None:
            return
        try:
            self._publish(self._estimator.add_truth(block_from_cdr(data, TRUTH_CHANNELS).samples))
        except SquealRigError as error:
            self._reject(error)

    def _publish(self, windows: list[FrictionWindow]) -> None:
        for window in windows:
            self._windows += 1
            self._windows_publisher.publish(cloud(window.as_record(), window.stamp))
            if not math.isnan(window.values["mu"]):
                self._mu.publish(Float64(data=window.values["mu"]))
            if self._regression.add_window(window.values):
                self._refit()

    def _refit(self) -> None:
        model = self._regression.fit()
        if model is not None:
            self._model.publish(labelled_array([model.row()], "friction model", ", ".join(MODEL_COLUMNS)))

    def _reject(self, error: SquealRigError) -> None:
        self._rejected += 1
        self.get_logger().warning(f"block refused: {error}", throttle_duration_sec=1.0)

    def _health(self) -> Health:
        return self._watch.health(
            {
                "windows": self._windows,
                "lost samples": self._estimator.lost_samples if self._estimator is not None else 0,
                "rejected blocks": self._rejected,
            }
        )


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; returns the exit code."""
    return run_node(FrictionEstimatorNode, args)


if __name__ == "__main__":
    sys.exit(main())
