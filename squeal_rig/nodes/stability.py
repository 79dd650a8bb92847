"""Node `stability`: complex eigenvalue analysis of the rig at every update of its parameters."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from pathlib import Path

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Float64MultiArray

from squeal_rig.errors import SquealRigError
from squeal_rig.estimation.hard_squeal import unavailable
from squeal_rig.estimation.settings import StabilitySettings
from squeal_rig.estimation.stability_follower import EIGENVALUES, SUMMARY, Estimate, InForce, StabilityFollower
from squeal_rig.graph import qos
from squeal_rig.graph.beside import Beside
from squeal_rig.graph.health import Health, HealthPublisher
from squeal_rig.graph.lifetime import STEADY, Lifetime, run_node
from squeal_rig.graph.parameters import NODE_OPTIONS, DeclaredParameters
from squeal_rig.graph.rig_follower import RigFollower
from squeal_rig.instruments.channels import FRICTION_WINDOW_NEEDED, block_from_cdr
from squeal_rig.instruments.description import RigDescription
from squeal_rig.instruments.driver import Samples
from squeal_rig.model.parameters import RigParameters

_BESIDE = (sys.executable, str(Path(__file__).with_name("start.py")), "hard_squeal")
_LOOK_EVERY = 0.5


class StabilityNode(Node):
    """Publishes eigenvalues and the stability summary: of the set point, of what is in force, with the estimated mu.

    The set point's zone, borders and smallest hit are computed in a process beside, and published once they are known.
    """

    def __init__(self, lifetime: Lifetime) -> None:
        super().__init__("stability", parameter_overrides=lifetime.kept, **NODE_OPTIONS)
        self._declared = DeclaredParameters(self, (StabilitySettings(),), apply=self._on_settings)
        self._follower = StabilityFollower(self._settings.hard_squeal)
        self._description: RigDescription | None = None
        answered = self.create_guard_condition(self._look_beside)
        self._beside = Beside(_BESIDE, answered.trigger)
        self.create_timer(_LOOK_EVERY, self._look_beside, clock=STEADY)
        self._analyses = 0
        self._outputs = {
            name: self.create_publisher(kind, name, qos.LATCHED)
            for name, kind in ((EIGENVALUES, Float64MultiArray), (SUMMARY, DiagnosticArray))
        }
        self._rig = RigFollower(self, self._on_rig, self._on_block, qos.BLOCKS, events=True, lifetime=lifetime)
        self.create_subscription(PointCloud2, "friction/windows", self._on_window, qos.EVENTS, raw=True)
        HealthPublisher(self, self._health)

    def close(self) -> None:
        """End the process beside."""
        self._beside.close()

    @property
    def _settings(self) -> StabilitySettings:
        settings: StabilitySettings = self._declared.group(StabilitySettings)
        return settings

    def _on_settings(self) -> None:
        self._follower.look_for_hard_squeal(self._settings.hard_squeal)
        if not self._settings.hard_squeal:
            self._beside.close()
        self._publish_if_due()

    def _on_rig(self, rig: RigDescription) -> None:
        self._description = rig
        self._follower.take_rig(rig)
        self._publish_if_due()

    def _on_block(self, _stamp: int, daq: Samples) -> None:
        self._follower.take_block(InForce.after(daq, self._description))
        self._publish_if_due()

    def _on_window(self, data: bytes) -> None:
        try:
            self._follower.take_estimate(Estimate.of(block_from_cdr(data, FRICTION_WINDOW_NEEDED).samples[0]))
        except SquealRigError as error:
            self._rig.reject(error)

    def _publish_if_due(self) -> None:
        """Analyse and publish where something changed."""
        now = time.monotonic()
        if self._follower.is_due(now):
            self._analyses += 1
            for name, data in self._follower.summary(now, self.get_clock().now().nanoseconds):
                self._outputs[name].publish(data)
            self._ask_beside()

    def _ask_beside(self) -> None:
        wanted = self._follower.lacks_hard_squeal()
        if wanted is not None:
            self._beside.ask(wanted.as_mapping())

    def _look_beside(self) -> None:
        found = self._beside.look()
        if found is None:
            return
        asked, answer, reason = found
        self._follower.take_hard_squeal(RigParameters(**asked), unavailable(reason) if answer is None else answer)
        self._publish_if_due()

    def _health(self) -> Health:
        values = {"analyses": self._analyses, "processes beside that ended": self._beside.ended}
        return self._rig.health(values)


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; returns the exit code."""
    return run_node(StabilityNode, args)


if __name__ == "__main__":
    sys.exit(main())
