"""Node `rig`: owns the rig, samples a driver and publishes its blocks; a managed (lifecycle) node."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence

from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import SetParametersResult
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter
from rclpy.timer import Timer

from squeal_rig.configuration.declared import Declared
from squeal_rig.errors import DriverError, ParameterError
from squeal_rig.graph import qos
from squeal_rig.graph.conversions import ERROR, OK, WARN, status_number
from squeal_rig.graph.health import Health, HealthPublisher
from squeal_rig.graph.lifetime import STEADY, Lifetime, described, run_node
from squeal_rig.graph.names import Claim, is_running
from squeal_rig.graph.parameters import NODE_OPTIONS, DeclaredParameters, overrides
from squeal_rig.graph.rig_follower import UNSERVED
from squeal_rig.graph.rig_interface import RigOutputs, offer_services
from squeal_rig.instruments.acquisition import Acquisition, change_refusal
from squeal_rig.instruments.description import RigDescription
from squeal_rig.instruments.driver import driver_class
from squeal_rig.instruments.pacing import LATE, Pacer
from squeal_rig.instruments.settings import PresetChoice, RigSettings
from squeal_rig.model.core.law import friction_refusal
from squeal_rig.model.parameters import RigParameters

# Catching up, blocks are made for so long [s] before others get their turn: services, parameters, signals.
_TURN = 0.1
# A node that has got no samples for so long [s] has tried to get them by itself; tries of ours are so far apart [s].
_UNSERVED_LIMIT, _RENEW_EVERY = 6.0, 10.0
_SIM_TIME = "use_sim_time"
_OWN_TIME = "the rig makes the time, and its stamps are the system's"


class RigNode(LifecycleNode):
    """Samples a driver in blocks of 10 ms and takes changes of the operating point at block boundaries."""

    def __init__(self, lifetime: Lifetime, fixed_driver: str | None = None) -> None:
        super().__init__("rig", **NODE_OPTIONS)
        self._lifetime = lifetime
        self._sim_time_asked = self._keep_system_time()
        preset = PresetChoice.from_mapping({k: v for k, v in overrides(self).items() if k == "preset"})
        base = RigParameters.preset(preset.preset)
        self._declared = DeclaredParameters(self, (preset, base, RigSettings()), self._refuse, self._apply)
        sentence = friction_refusal(self._declared.group(RigParameters))
        if sentence:
            raise ParameterError(f"rig: {sentence}")
        self._settings: RigSettings = self._declared.group(RigSettings)
        self._driver_name = fixed_driver or self._settings.driver
        self._driver = driver_class(self._driver_name)()
        self._acquisition: Acquisition | None = None
        self._samples = 0
        self._pacer = Pacer(self._settings.real_time_factor)
        self._timer: Timer | None = None
        self._active = self._paused = self._ended = False
        self._fault = ""
        self._told_overruns = 0
        self._warnings: tuple[str, ...] = ()
        domain, full_name = self.context.get_domain_id(), self.get_fully_qualified_name()
        self._claim = Claim(domain, full_name)
        if not self._claim.granted or is_running(full_name, own=self):
            raise DriverError(f"rig: {full_name} runs on ROS domain {domain} already: give this one a namespace")
        self._outputs = RigOutputs(self, self._driver.publishes_truth, self._settings.real_time_factor != 1.0)
        offer_services(self, {"reset": self.reset, "impact": self.impact, "zero": self.zero}, self.pause)
        self._renewals, self._renewed = 0, time.monotonic()
        self.create_subscription(DiagnosticArray, "/diagnostics", self._on_health, qos.EVENTS)
        HealthPublisher(self, self._health)
        self.greeting = f"driver {self._driver_name}, {self._settings.sample_rate} Hz"
        if self._settings.autostart:
            for transition in (self.trigger_configure, self.trigger_activate):
                transition()
                if self._fault:
                    raise DriverError(f"rig: {self._fault}")

    def _keep_system_time(self) -> bool:
        """Whether simulated time was asked for, as in files for every node: who makes the time cannot follow it."""
        asked = bool(self.get_parameter(_SIM_TIME).value)
        if asked:
            self.set_parameters([Parameter(_SIM_TIME, value=False)])

        def refuse(changes: list[Parameter]) -> SetParametersResult:
            refused = any(change.name == _SIM_TIME and change.value for change in changes)
            return SetParametersResult(successful=not refused, reason=_OWN_TIME if refused else "")

        self.add_on_set_parameters_callback(refuse)
        return asked

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
        return self._attempt(self.close)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Let go of the driver for good."""
        self._ended = True
        return self._attempt(self.close)

    def close(self) -> None:
        """Stop sampling and let go of the driver."""
        self._stop_timer()
        self._active = False
        if self._acquisition is not None:
            acquisition, self._acquisition = self._acquisition, None
            self._samples = acquisition.samples
            acquisition.close()

    def _attempt(self, action: Callable[[], None]) -> TransitionCallbackReturn:
        try:
            action()
        except Exception as error:  # rclpy would swallow it, and a driver may raise anything
            self._fail(described(error))
            return TransitionCallbackReturn.FAILURE
        self._fault = ""
        return TransitionCallbackReturn.SUCCESS

    def _open(self) -> None:
        self.close()
        self._acquisition = Acquisition(self._driver, self._declared.group(RigParameters), self._settings)
        self._acquisition.samples = self._samples
        self._outputs.describe(self._description())

    def _activate(self) -> None:
        self._open()
        self._active, self._paused = True, False
        self._restart()

    # --- sampling

    def _restart(self) -> None:
        """Sample from now on: the stamps' t0 is set anew."""
        self._stop_timer()
        self._sampled().start(self._outputs.restart_stamp(self.get_clock().now().nanoseconds))
        self._pacer.start(time.monotonic())
        # The timer starts after the pacer, so that each shot finds its block due.
        self._timer = self.create_timer(self._pacer.period, self._step, clock=STEADY)

    def _stop_timer(self) -> None:
        if self._timer is not None:
            self.destroy_timer(self._timer)
            self._timer = None

    def _step(self) -> None:
        acquisition = self._acquisition
        if acquisition is None or self._lifetime.stopping:
            return
        count, overrun = self._pacer.due(time.monotonic())
        if overrun:
            self.get_logger().warning("fell behind real time: time skipped, t0 set anew")
            acquisition.start(self._outputs.restart_stamp(self.get_clock().now().nanoseconds))
        try:
            begun = time.monotonic()
            for made in range(1, count + 1):
                block = acquisition.next_block()
                self._outputs.publish(block, acquisition.in_force, self._settings.drum_radius)
                self._warnings = block.warnings or self._warnings
                if time.monotonic() - begun > _TURN:
                    self._pacer.put_back(count - made)
                    break
        except Exception as error:
            self._stop_timer()
            self._fail(f"{described(error)}; call ~/reset to start again")

    def _fail(self, sentence: str) -> None:
        self._fault = sentence
        self.get_logger().error(sentence)

    # --- parameters

    def _refuse(self, name: str, now: Declared, wanted: Declared) -> str | None:
        if not isinstance(wanted, RigParameters):
            return None
        changed = getattr(now, name) != getattr(wanted, name)
        return (change_refusal(name) if self._active and changed else None) or friction_refusal(wanted)

    def _apply(self) -> None:
        self._settings = self._declared.group(RigSettings)
        if self._acquisition is not None:
            self._acquisition.settings = self._settings
            self._acquisition.set_point = self._declared.group(RigParameters)
        self._outputs.describe(self._description())

    def _description(self) -> RigDescription:
        return RigDescription(
            parameters=self._declared.group(RigParameters),
            preset=self._declared.group(PresetChoice).preset,
            driver=self._driver_name,
            publishes_truth=self._driver.publishes_truth,
            sample_rate=self._settings.sample_rate,
            drum_radius=self._settings.drum_radius,
            tare=self._acquisition.tare if self._acquisition is not None else {},
        )

    # --- operations, offered as services

    def reset(self) -> str:
        """Pad at rest at the equilibrium of what is in force; tare and fault forgotten."""
        self._sampled().reset()
        self._fault, self._warnings = "", ()
        self._outputs.describe(self._description())
        if not self._paused:
            self._restart()
        return "the pad rests at the equilibrium of what is in force; tare forgotten"

    def impact(self) -> str:
        """An impact."""
        return "impact of ({:.4g}, {:.4g}) N s".format(*self._sampled().impact())

    def zero(self) -> str:
        """Take the force channels' tare."""
        offsets = ", ".join(f"{channel} {value:.6g}" for channel, value in self._sampled().take_tare().items())
        self._outputs.describe(self._description())
        return f"subtracted from now on, in N and N m: {offsets}; Eq. (2.1) needs forces tared on the unloaded rig"

    def pause(self, pause: bool) -> str:
        """Stop sampling for a while, or go on."""
        self._sampled()
        if pause == self._paused:
            return "paused already" if pause else "running already"
        self._paused = pause
        if pause:
            self._stop_timer()
        else:
            self._restart()
        return "paused" if pause else "running"

    def _sampled(self) -> Acquisition:
        if self._ended:
            raise DriverError("the rig was shut down: start its node again")
        if self._acquisition is None or not self._active:
            raise DriverError("the rig is not active: activate it first")
        return self._acquisition

    # --- health

    def _on_health(self, message: DiagnosticArray) -> None:
        """Serve samples again that the middleware holds back, where a node tells that none come.

        Once readers were stopped for seconds, Fast DDS was seen to deliver nothing of a publisher any more, to new
        readers neither. Nodes that follow the rig first try to be served again by themselves.
        """
        for status in message.status:
            unserved = status_number(status, UNSERVED)
            if unserved > _UNSERVED_LIMIT and self._active and not self._paused and not self._fault:
                now = time.monotonic()
                if now - self._renewed > _RENEW_EVERY:
                    self._renewed = now
                    self._renewals += 1
                    self.get_logger().warning(f"{status.name} has got no samples for {unserved:.0f} s: publishing anew")
                    self._outputs.renew()

    def _health(self) -> Health:
        acquisition = self._acquisition
        behind, overruns = self._pacer.worst_behind(), self._pacer.overruns - self._told_overruns
        self._told_overruns = self._pacer.overruns
        values = {
            "driver": self._driver_name,
            "samples": acquisition.samples if acquisition is not None else self._samples,
            "overruns": self._pacer.overruns,
            "behind [ms]": round(1e3 * behind, 1),
            "skipped [s]": round(self._pacer.skipped_seconds, 3),
            "publishers made anew": self._renewals,
            "tared": bool(acquisition is not None and acquisition.tare),
            **{f"listeners to {topic}": count for topic, count in self._outputs.listeners().items()},
        }
        warnings, self._warnings = self._warnings, ()  # those of the last second
        if self._fault:
            return ERROR, self._fault, values
        if not self._active or self._paused:
            return OK, "shut down" if self._ended else "paused" if self._active else "inactive", values
        if warnings:
            return WARN, " ".join(warnings), values
        if overruns:
            return WARN, f"fell behind real time: {self._pacer.skipped_seconds:.2f} s skipped so far", values
        if behind > LATE:
            return WARN, f"behind real time by {1e3 * behind:.0f} ms, catching up", values
        if self._sim_time_asked:
            return WARN, f"{_SIM_TIME} was asked for: {_OWN_TIME}", values
        return OK, "running", values


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; returns the exit code."""
    return run_node(RigNode, args)


if __name__ == "__main__":
    sys.exit(main())
