"""Node `stability`: complex eigenvalue analysis of the rig at every update of its parameters."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Sequence

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Float64MultiArray

from squeal_rig.errors import ModelError, SquealRigError
from squeal_rig.instruments.channels import DAQ_CHANNELS, FRICTION_WINDOW_CHANNELS, block_from_cdr
from squeal_rig.instruments.description import RigDescription
from squeal_rig.model.declared import checked, declarations
from squeal_rig.model.friction import friction_coefficient
from squeal_rig.model.parameters import RigParameters
from squeal_rig.model.stability import stability_report
from squeal_rig.nodes import qos
from squeal_rig.nodes.conversions import ERROR, OK, WARN, diagnostics, labelled_array, status
from squeal_rig.nodes.health import DataWatch, Health, HealthPublisher
from squeal_rig.nodes.lifetime import Lifetime, run_node
from squeal_rig.nodes.parameters import NODE_OPTIONS, DeclaredParameters
from squeal_rig.nodes.rig_follower import RigFollower

# While the operating point slews, what is in force is analysed at most this often [s].
_IN_FORCE_PERIOD = 0.05


class StabilityNode(Node):
    """Publishes eigenvalues and the stability summary: of the set point, of what is in force, with the estimated mu."""

    def __init__(self, lifetime: Lifetime) -> None:
        super().__init__("stability", **NODE_OPTIONS)
        DeclaredParameters(self, ())
        self._set_point: RigParameters | None = None
        self._in_force: tuple[float, float] | None = None  # preload [N], belt speed [m/s]
        self._estimated = math.nan
        self._last_summary = -math.inf
        self._summary_due = False
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
        self._set_point = rig.parameters
        self._publish_summary()

    def _on_daq(self, data: bytes) -> None:
        self._watch.seen()
        try:
            last = block_from_cdr(data, DAQ_CHANNELS).samples[-1]
            in_force = _within_bounds("preload", last["preload"]), _within_bounds("belt_speed", last["belt_speed"])
        except SquealRigError as error:
            self._reject(error)
            return
        if in_force != self._in_force:
            self._in_force = in_force
            self._summary_due = True
        if self._summary_due and time.monotonic() - self._last_summary >= _IN_FORCE_PERIOD:
            self._publish_summary()

    def _on_window(self, data: bytes) -> None:
        try:
            estimated = float(block_from_cdr(data, FRICTION_WINDOW_CHANNELS).samples[0]["mu_ratio_of_means"])
            # nan: this window has none.
            self._estimated = estimated if math.isnan(estimated) else _within_bounds("mu0", estimated)
        except SquealRigError as error:
            self._reject(error)
            return
        self._summary_due = True

    def _reject(self, error: SquealRigError) -> None:
        self._rejected += 1
        self.get_logger().warning(f"message refused: {error}", throttle_duration_sec=1.0)

    def _publish_summary(self) -> None:
        """Analyse and publish; the eigenvalues are those of the set point."""
        if self._set_point is None:
            return
        self._last_summary, self._summary_due = time.monotonic(), False
        self._analyses += 1
        statuses = [self._analysed("set point", self._set_point, "set", with_eigenvalues=True)]
        if self._in_force is not None:
            preload, speed = self._in_force
            in_force = self._set_point.replace(preload=preload, belt_speed=speed)
            statuses.append(self._analysed("in force", in_force, "set"))
            if math.isfinite(self._estimated):
                fixed = in_force.replace(mu0=self._estimated, mu_speed=0.0, mu_preload=0.0, mu_speed_preload=0.0)
                statuses.append(self._analysed("in force, estimated mu", fixed, "estimated"))
        self._summary.publish(diagnostics(self.get_clock().now().nanoseconds, *statuses))

    def _analysed(self, name: str, p: RigParameters, source: str, with_eigenvalues: bool = False) -> DiagnosticStatus:
        point = {
            "preload [N]": p.preload,
            "belt speed [m/s]": p.belt_speed,
            "mu": friction_coefficient(p),
            "mu source": source,
        }
        try:
            report = stability_report(p)
        except ModelError as error:
            return status(ERROR, f"stability: {name}", str(error), point)
        if with_eigenvalues:
            rows = [(value.real, value.imag) for value in report.eigenvalues]
            self._eigenvalues.publish(labelled_array(rows, "eigenvalue [rad/s]", "re, im"))
        values = {
            "k [N/m]": report.pad_stiffness,
            "k_cr [N/m]": report.critical_pad_stiffness,
            "k_upper [N/m]": report.upper_pad_stiffness,
            "margin": report.margin,
            "growth rate [1/s]": report.growth_rate,
            "damping ratio": report.damping_ratio,
            "squeal frequency [Hz]": report.squeal_frequency,
        }
        level, text = (WARN, "unstable") if report.unstable else (OK, "stable")
        return status(level, f"stability: {name}", text, {**values, **point})

    def _health(self) -> Health:
        return self._watch.health({"analyses": self._analyses, "rejected messages": self._rejected})


def _within_bounds(name: str, measured: float) -> float:
    """A measured value that is to be put in a parameter's place; `ParameterError` where it cannot be."""
    return checked(declarations(RigParameters)[name], float(measured))


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; returns the exit code."""
    return run_node(StabilityNode, args)


if __name__ == "__main__":
    sys.exit(main())
