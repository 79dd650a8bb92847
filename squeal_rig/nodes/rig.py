"""Node `rig`: owns the rig, samples a driver and publishes its blocks; a managed (lifecycle) node."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from typing import TypeVar

from geometry_msgs.msg import WrenchStamped
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.timer import Timer
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState, PointCloud2
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger

from squeal_rig.errors import SquealRigError
from squeal_rig.instruments.acquisition import Acquisition, Block, change_refusal
from squeal_rig.instruments.description import RigDescription
from squeal_rig.instruments.driver import make_driver
from squeal_rig.instruments.means import block_means
from squeal_rig.instruments.pacing import Pacer
from squeal_rig.instruments.settings import PresetChoice, RigSettings
from squeal_rig.model.declared import Declared
from squeal_rig.model.friction import friction_refusal
from squeal_rig.model.parameters import RigParameters
from squeal_rig.nodes import qos
from squeal_rig.nodes.conversions import ERROR, OK, WARN, cloud, joint_state, time_message, wrench
from squeal_rig.nodes.health import Health, HealthPublisher
from squeal_rig.nodes.lifetime import STEADY, Lifetime, run_node
from squeal_rig.nodes.parameters import NODE_OPTIONS, DeclaredParameters, overrides

Response = TypeVar("Response", Trigger.Response, SetBool.Response)


class RigNode(LifecycleNode):
    """Samples a driver in blocks of 10 ms and takes changes of the operating point at block boundaries."""

    def __init__(self, lifetime: Lifetime, fixed_driver: str | None = None) -> None:
        super().__init__("rig", **NODE_OPTIONS)
        self._lifetime = lifetime
        preset = PresetChoice.from_mapping({k: v for k, v in overrides(self).items() if k == "preset"})
        base = RigParameters.preset(preset.preset)
        self._declared = DeclaredParameters(self, (preset, base, RigSettings()), self._refuse, self._apply)
        self._settings: RigSettings = self._declared.group(RigSettings)
        self._driver_name = fixed_driver or self._settings.driver
        self._check_operating_point()
        self._acquisition: Acquisition | None = None
        self._pacer = Pacer(self._settings.real_time_factor)
        self._timer: Timer | None = None
        self._active = self._paused = False
        self._fault = ""
        self._warnings: tuple[str, ...] = ()
        self._next_stamp: int | None = None
        self._make_interfaces()
        HealthPublisher(self, self._health)
        if self._settings.autostart:
            self.trigger_configure()
            self.trigger_activate()
            if self._fault:
                raise SquealRigError(f"rig: {self._fault}")

    def _make_interfaces(self) -> None:
        self._daq = self.create_publisher(PointCloud2, "daq/samples", qos.BLOCKS)
        self._truth = self.create_publisher(PointCloud2, "truth/samples", qos.BLOCKS)
        self._state = self.create_publisher(JointState, "pad/state", qos.BLOCKS)
        self._wrench = self.create_publisher(WrenchStamped, "contact/wrench", qos.BLOCKS)
        self._description = self.create_publisher(String, "rig/description", qos.LATCHED)
        self._clock_publisher = (
            self.create_publisher(Clock, "/clock", qos.BLOCKS) if self._settings.real_time_factor != 1.0 else None
        )
        for name, action in (("reset", self._reset), ("impact", self._impact), ("zero", self._zero)):
            self.create_service(Trigger, f"~/{name}", action)
        self.create_service(SetBool, "~/pause", self._pause)

    # --- lifecycle

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Open the driver on the parameters as they are now."""
        return self._attempt(self._open)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Open the driver anew, since constants may have changed while inactive, and start sampling."""
        return self._attempt(self._activate)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop sampling."""
        self._stop_timer()
        self._active = False
        return TransitionCallbackReturn.SUCCESS

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Let go of the driver."""
        self.close()
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Let go of the driver."""
        self.close()
        return TransitionCallbackReturn.SUCCESS

    def close(self) -> None:
        """Stop sampling and let go of the driver."""
        self._stop_timer()
        self._active = False
        if self._acquisition is not None:
            self._acquisition.close()
            self._acquisition = None

    def _attempt(self, action: Callable[[], None]) -> TransitionCallbackReturn:
        try:
            action()
        except SquealRigError as error:
            self._fail(str(error))
            return TransitionCallbackReturn.FAILURE
        return TransitionCallbackReturn.SUCCESS

    def _open(self) -> None:
        driver = make_driver(self._driver_name)
        samples = self._acquisition.samples if self._acquisition is not None else 0
        self._acquisition = Acquisition(driver, self._declared.group(RigParameters), self._settings)
        self._acquisition.samples = samples
        self._publish_description()

    def _activate(self) -> None:
        self._open()
        self._fault, self._active, self._paused = "", True, False
        self._restart()

    # --- sampling

    def _restart(self) -> None:
        """Start sampling from now on: the stamps' t0 is set anew."""
        self._stop_timer()
        stamp = self.get_clock().now().nanoseconds
        if self._clock_publisher is not None and self._next_stamp is not None:
            stamp = self._next_stamp  # simulated time goes on where it stopped
        assert self._acquisition is not None
        self._acquisition.start(stamp)
        self._pacer.start(time.monotonic())
        # The timer starts after the pacer, so that each shot finds its block due.
        self._timer = self.create_timer(self._pacer.period, self._step, clock=STEADY)

    def _stop_timer(self) -> None:
        if self._timer is not None:
            self.destroy_timer(self._timer)
            self._timer = None

    def _step(self) -> None:
        if self._acquisition is None or self._lifetime.stopping:
            return
        count, overrun = self._pacer.due(time.monotonic())
        if overrun:
            self.get_logger().warning("fell behind real time: samples skipped, t0 set anew")
            self._acquisition.start(self.get_clock().now().nanoseconds)
        try:
            for _ in range(count):
                self._publish(self._acquisition.next_block())
        except SquealRigError as error:
            self._stop_timer()
            self._fail(f"{error}; call ~/reset to start again")

    def _publish(self, block: Block) -> None:
        self._daq.publish(cloud(block.daq, block.stamp))
        if block.truth is not None:
            self._truth.publish(cloud(block.truth, block.stamp))
        means = block_means(block, self._declared.group(RigParameters), self._settings.drum_radius)
        self._state.publish(joint_state(block.stamp, means.position, means.velocity))
        self._wrench.publish(wrench(block.stamp, means.tangential, means.normal))
        self._next_stamp = block.stamp + 10_000_000
        if self._clock_publisher is not None:
            self._clock_publisher.publish(Clock(clock=time_message(self._next_stamp)))
        self._warnings = block.warnings or self._warnings

    def _fail(self, sentence: str) -> None:
        self._fault = sentence
        self.get_logger().error(sentence)

    # --- parameters

    def _refuse(self, name: str, now: Declared, wanted: Declared) -> str | None:
        if not isinstance(wanted, RigParameters):
            return None
        if self._active and getattr(now, name) != getattr(wanted, name):
            sentence = change_refusal(name)
            if sentence:
                return sentence
        return friction_refusal(wanted)

    def _check_operating_point(self) -> None:
        sentence = friction_refusal(self._declared.group(RigParameters))
        if sentence:
            raise SquealRigError(f"rig: {sentence}")

    def _apply(self) -> None:
        self._settings = self._declared.group(RigSettings)
        if self._acquisition is not None:
            self._acquisition.settings = self._settings
            self._acquisition.set_point = self._declared.group(RigParameters)
        self._publish_description()

    def _description_now(self) -> RigDescription:
        acquisition = self._acquisition
        return RigDescription(
            parameters=self._declared.group(RigParameters),
            preset=self._declared.group(PresetChoice).preset,
            driver=self._driver_name,
            publishes_truth=acquisition is None or acquisition.publishes_truth,
            sample_rate=self._settings.sample_rate,
            drum_radius=self._settings.drum_radius,
            tare=acquisition.tare if acquisition is not None else {},
        )

    def _publish_description(self) -> None:
        self._description.publish(String(data=self._description_now().to_yaml()))

    # --- services

    def _reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return self._serve(response, self._do_reset)

    def _do_reset(self, acquisition: Acquisition) -> str:
        acquisition.reset()
        self._fault, self._warnings = "", ()
        self._publish_description()
        if not self._paused:
            self._restart()
        return "the pad rests at the equilibrium of what is in force; tare forgotten"

    def _impact(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return self._serve(response, lambda rig: "hit the pad with ({:.4g}, {:.4g}) N s".format(*rig.impact()))

    def _zero(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return self._serve(response, self._do_zero)

    def _do_zero(self, acquisition: Acquisition) -> str:
        offsets = ", ".join(f"{channel} {value:.6g}" for channel, value in acquisition.zero().items())
        self._publish_description()
        return f"subtracted from now on, in N and N m: {offsets}; Eq. (2.1) needs forces tared on the unloaded rig"

    def _pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        return self._serve(response, lambda rig: self._do_pause(request.data))

    def _do_pause(self, pause: bool) -> str:
        if pause == self._paused:
            return "paused already" if pause else "running already"
        self._paused = pause
        if pause:
            self._stop_timer()
        else:
            self._restart()
        return "paused" if pause else "running"

    def _serve(self, response: Response, action: Callable[[Acquisition], str]) -> Response:
        if self._acquisition is None or not self._active:
            response.success, response.message = False, "the rig is not active: activate it first"
            return response
        try:
            response.success, response.message = True, action(self._acquisition)
        except SquealRigError as error:
            response.success, response.message = False, str(error)
        return response

    # --- health

    def _health(self) -> Health:
        acquisition = self._acquisition
        values = {
            "driver": self._driver_name,
            "samples": acquisition.samples if acquisition is not None else 0,
            "overruns": self._pacer.overruns,
            "skipped [s]": round(self._pacer.skipped_seconds, 3),
            "tared": bool(acquisition is not None and acquisition.tare),
        }
        warnings, self._warnings = self._warnings, ()  # those of the last second
        if self._fault:
            return ERROR, self._fault, values
        if not self._active or self._paused:
            return OK, "paused" if self._active else "inactive", values
        if warnings:
            return WARN, " ".join(warnings), values
        if self._pacer.overruns:
            return WARN, f"fell behind real time {self._pacer.overruns} times", values
        return OK, "running", values


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; returns the exit code."""
    return run_node(RigNode, args)


if __name__ == "__main__":
    sys.exit(main())
