"""Node `squeal_detector`: `daq/samples` in; whether the rig squeals, how loud and at what frequency out."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node

from squeal_rig.errors import ParameterError
from squeal_rig.estimation.settings import SquealSettings
from squeal_rig.estimation.squeal import SquealDetector, SquealState
from squeal_rig.graph import qos
from squeal_rig.graph.conversions import ERROR, OK, WARN, diagnostics, status
from squeal_rig.graph.health import Health, HealthPublisher
from squeal_rig.graph.lifetime import Lifetime, run_node
from squeal_rig.graph.parameters import NODE_OPTIONS, DeclaredParameters
from squeal_rig.graph.rig_follower import RigFollower
from squeal_rig.instruments.description import RigDescription
from squeal_rig.instruments.driver import Samples


class SquealDetectorNode(Node):
    """Watches the pad's displacement along the belt for squeal."""

    def __init__(self, lifetime: Lifetime) -> None:
        super().__init__("squeal_detector", **NODE_OPTIONS)
        self._settings = DeclaredParameters(self, (SquealSettings(),)).group(SquealSettings)
        self._detector: SquealDetector | None = None
        self._sample_rate = 0
        self._fault = ""
        self._publisher = self.create_publisher(DiagnosticArray, "squeal/state", qos.EVENTS)
        self._rig = RigFollower(self, self._on_rig, self._on_block)
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

    def _on_block(self, stamp: int, daq: Samples) -> None:
        if self._detector is not None:
            for state in self._detector.add_samples(stamp, daq):
                self._publisher.publish(_message(state))

    def _health(self) -> Health:
        level, sentence, values = self._rig.health({})
        return (ERROR, self._fault, values) if self._fault else (level, sentence, values)


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
