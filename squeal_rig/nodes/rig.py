"""Node `rig`: owns the rig, samples a driver and publishes its blocks; a managed (lifecycle) node."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from rcl_interfaces.msg import SetParametersResult
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter
from rclpy.timer import Timer

from squeal_rig.configuration.declared import Declared
from squeal_rig.errors import DriverError, ParameterError, SafetyError
from squeal_rig.graph.conversions import ERROR, OK, WARN
from squeal_rig.graph.health import Health, HealthPublisher
from squeal_rig.graph.lifetime import STEADY, Lifetime, described, run_node
from squeal_rig.graph.names import Claim, is_running
from squeal_rig.graph.parameters import NODE_OPTIONS, DeclaredParameters, overrides
from squeal_rig.graph.rig_interface import RigOutputs, offer_services
from squeal_rig.graph.stop_path import StopPath
from squeal_rig.instruments.acquisition import Acquisition, change_refusal
from squeal_rig.instruments.actuators import safe_point
from squeal_rig.instruments.data_sheets import load_data_sheets
from squeal_rig.instruments.description import RigDescription
from squeal_rig.instruments.driver import Capabilities, Driver, driver_class
from squeal_rig.instruments.driver_config import check_driver_config
from squeal_rig.instruments.pacing import LATE, Pacer
from squeal_rig.instruments.settings import PresetChoice, RigSettings
from squeal_rig.instruments.tolerances import promises
from squeal_rig.model.core.law import friction_refusal
from squeal_rig.model.parameters import RigParameters
from squeal_rig.safety.outside import FROM_OUTSIDE, Outside
from squeal_rig.safety.supervisor import ENDED, FAULT, INACTIVE, MOVES_BELT, PAUSED, RUNNING, STATE_KEY, WAITING

# Catching up, blocks are made for so long [s] before others get their turn: services, parameters, signals.
_TURN = 0.1
# A driver that keeps its own time is asked for so many blocks in 10 ms: what has piled up is made up for, but not so
# fast that readers, for whom a second is kept, lose what they have not taken yet.
_MOST_AT_ONCE = 4
# Time without a block of a driver [s] that is worth a warning, and that is an error.
_QUIET, _SILENT = 0.2, 1.0
_WATCHDOG = (sys.executable, str(Path(__file__).with_name("start.py")), "watchdog")
_WAITING = "waiting for the supervisor's heartbeat and for the watchdog"
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
        self._sheets = load_data_sheets(self._settings.instruments)
        self._driver_name = fixed_driver or self._settings.driver
        self._driver, self._can = self._chosen_driver()
        self._block_came, self._waiting = time.monotonic(), False
        self._acquisition: Acquisition | None = None
        self._samples = 0
        self._pacer = Pacer(self._settings.real_time_factor)
        self._timer: Timer | None = None
        self._active = self._paused = self._ended = self._held = self._begun = False
        self._fault = ""
        self._told_overruns = 0
        self._warnings: tuple[str, ...] = ()
        domain, full_name = self.context.get_domain_id(), self.get_fully_qualified_name()
        self._claim = Claim(domain, full_name)
        if not self._claim.granted or is_running(full_name, own=self):
            raise DriverError(f"rig: {full_name} runs on ROS domain {domain} already: give this one a namespace")
        self._outputs = RigOutputs(self, self._can.knows_truth, self._settings.real_time_factor != 1.0)
        offer_services(self, {"reset": self.reset, "impact": self.impact, "zero": self.zero}, self.pause)
        self._health_publisher = HealthPublisher(self, self._health)
        self.greeting = f"driver {self._driver_name}, {self._settings.sample_rate} Hz"
        self._stop = StopPath(
            self,
            self._make_safe,
            self._settings.supervisor_required,
            self._settings.heartbeat_timeout,
            lambda: lifetime.stopping,
            self._outside() if self._settings.supervisor_required else None,
        )
        try:
            self._autostart()
        except BaseException:
            self._stop.close()
            raise

    def _autostart(self) -> None:
        if self._settings.autostart:
            for transition in (self.trigger_configure, self.trigger_activate):
                transition()
                if self._fault:
                    raise DriverError(f"rig: {self._fault}")

    def _outside(self) -> Outside:
        """The process that watches ours; it is told the driver where that one can be made safe from there."""
        driver = self._driver_name if hasattr(type(self._driver), FROM_OUTSIDE) else ""
        return Outside(_WATCHDOG, driver, self._settings.as_mapping(), self._settings.watchdog_timeout)

    def _chosen_driver(self) -> tuple[Driver, Capabilities]:
        """The driver, and what it can do with its settings.

        Raises:
            SquealRigError: it is not there, its settings are wrong, or it failed in whatever way.
        """
        name, settings = self._driver_name, self._settings
        try:
            if settings.driver_config:
                check_driver_config(settings.driver_config, name)
            driver: Driver = driver_class(name)()
            can = driver.capabilities(settings)
        except Exception as error:  # a driver may raise anything
            raise DriverError(f"rig: {described(error)}") from None
        if can.keeps_time and settings.real_time_factor != 1.0:
            factor = settings.real_time_factor
            raise ParameterError(
                f"rig: real_time_factor = {factor:g} must be 1: the driver {name!r} keeps its own time"
            )
        return driver, can

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
        """Stop sampling, and have the driver made safe: nobody looks at an inactive rig. Refused, it stays active."""
        return self._attempt(self._deactivate)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Let go of the driver."""
        return self._attempt(self._let_go)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Let go of the driver for good."""
        self._ended = True
        return self._attempt(self._let_go)

    def destroy_node(self) -> None:
        """Give back what belongs to the node; rclpy forgets the state machine, with a publisher of its own."""
        self._state_machine.destroy_when_not_in_use()
        super().destroy_node()

    def close(self) -> None:
        """Let go of the driver and say that this is the end, which is no fault."""
        self._ended = True
        try:
            self._let_go()
        finally:
            self._health_publisher.publish()
            self._stop.close()

    def _let_go(self) -> None:
        """Stop sampling and let go of the driver, which commands its safe state while it is still watched."""
        self._stop_timer()
        try:
            if self._acquisition is not None:
                acquisition, self._acquisition = self._acquisition, None
                self._samples = acquisition.samples
                acquisition.close()
        finally:
            self._set_active(False)

    def _attempt(self, action: Callable[[], None]) -> TransitionCallbackReturn:
        self._fault = ""
        try:
            action()
        except Exception as error:  # rclpy would swallow it, and a driver may raise anything
            self._fail(described(error))
            return TransitionCallbackReturn.FAILURE
        return TransitionCallbackReturn.SUCCESS

    def _open(self) -> None:
        self._let_go()
        wanted: RigParameters = self._declared.group(RigParameters)
        begin = safe_point(wanted) if self._stop.stopped else wanted
        self._acquisition = acquisition = Acquisition(self._driver, begin, self._settings)
        acquisition.set_point, acquisition.samples = wanted, self._samples
        if self._stop.stopped:  # looked at after it is there for the stop's thread to see
            acquisition.make_safe()
        self._outputs.describe(self._description())

    def _activate(self) -> None:
        self._open()
        self._paused, self._held = False, self._must_wait()
        self._begun = not self._held
        if self._held:
            self.get_logger().warning(_WAITING)
        self._set_active(True)
        self._restart()

    def _deactivate(self) -> None:
        self._stop_timer()
        try:
            self._make_safe()
        except Exception as error:  # a driver may raise anything
            raise DriverError(f"the driver has NOT accepted the safe command: {described(error)}") from None
        self._set_active(False)

    def _set_active(self, active: bool) -> None:
        """Active is driven: its stop is watched over, and who follows the rig is told at once."""
        changed, self._active = active != self._active, active
        self._stop.arm(active and self._begun)
        if changed:
            self._health_publisher.publish()

    def _make_safe(self) -> None:
        """Have the driver made safe; called from the thread of the stop."""
        acquisition = self._acquisition
        if acquisition is not None:
            acquisition.make_safe()

    # --- sampling

    def _restart(self) -> None:
        """Sample from now on: the stamps' t0 is set anew."""
        self._stop_timer()
        self._sampled().start(self._outputs.restart_stamp(self.get_clock().now().nanoseconds))
        self._block_came = time.monotonic()
        self._pacer.start(self._block_came)
        # The timer starts after the pacer, so that each shot finds its block due.
        self._timer = self.create_timer(self._pacer.period, self._step, clock=STEADY)

    def _stop_timer(self) -> None:
        if self._timer is not None:
            self.destroy_timer(self._timer)
            self._timer = None

    def _step(self) -> None:
        acquisition = self._acquisition
        if acquisition is None or self._lifetime.stopping or self._is_held():
            return
        # Nothing is behind or skipped where the device keeps the time: it says itself what it lost.
        own = self._can.keeps_time
        stamp, now = self.get_clock().now().nanoseconds, time.monotonic()  # whoever is held up in between is not ahead
        count, overrun = (_MOST_AT_ONCE, False) if own else self._pacer.due(now)
        if overrun:
            # The block due now began a period ago; stamped later, the next reset would turn the samples' time back.
            acquisition.start(self._outputs.restart_stamp(stamp - round(1e9 * self._pacer.period)))
            self.get_logger().warning("fell behind real time: time skipped, t0 set anew")
        try:
            begun = time.monotonic()
            for made in range(1, count + 1):
                block = acquisition.poll()
                self._waiting = block is None
                if block is None:
                    break
                self._block_came = time.monotonic()
                self._outputs.publish(block, acquisition.in_force, self._settings.drum_radius)
                self._warnings = block.warnings or self._warnings
                if self._block_came - begun > _TURN:
                    self._pacer.put_back(0 if own else count - made)
                    break
        except Exception as error:
            self._stop_timer()
            # A supervisor's latch is not released while the rig has a fault, and the rig not reset before that.
            way = "deactivate and activate" if self._settings.supervisor_required else "call ~/reset"
            self._fail(f"{described(error)}; {way} to start again")

    def _is_held(self) -> bool:
        """Whether the rig must not be driven yet; it begins to once the supervisor is there."""
        before, self._held = self._held, not self._begun and self._must_wait()
        if before and not self._held:
            self._begun = True
            self._stop.arm(True)
            self._restart()
            self._health_publisher.publish()
            return True
        return self._held

    def _must_wait(self) -> bool:
        """Whether the supervisor is missed before the rig has begun; later on its silence is a stop."""
        return self._stop.waiting and not self._stop.stopped

    def _fail(self, sentence: str) -> None:
        self._fault = sentence
        self.get_logger().error(sentence)
        self._health_publisher.publish()

    # --- parameters

    def _refuse(self, name: str, now: Declared, wanted: Declared) -> str | None:
        if not isinstance(wanted, RigParameters):
            return None
        changed = getattr(now, name) != getattr(wanted, name)
        refusal = change_refusal(name, self._can) if self._active and changed else None
        return refusal or friction_refusal(wanted)

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
            publishes_truth=self._can.knows_truth,
            sample_rate=self._settings.sample_rate,
            drum_radius=self._settings.drum_radius,
            instruments=self._settings.instruments,
            **promises(self._sheets, self._declared.group(RigParameters), self._settings),
            tare=self._acquisition.tare if self._acquisition is not None else {},
        )

    # --- operations, offered as services

    def reset(self) -> str:
        """Pad at rest at the equilibrium of what is in force, a device connected anew; tare, fault, stop are over."""
        acquisition, number = self._sampled(), self._stop.number()
        stopped = bool(number)
        if stopped:
            self._rest_set_points()
        acquisition.reset()
        self._stop.release(number)
        self._fault, self._warnings = "", ()
        self._outputs.describe(self._description())
        if not self._paused:
            self._restart()
        what = (
            "the driver has begun anew"
            if self._can.keeps_time
            else f"the pad rests at the equilibrium of what is in force from sample {acquisition.samples} on"
        )
        told = "; the stop is over, set points of preload and belt speed are zero" if stopped else ""
        return f"{what}; tare forgotten{told}"

    def _rest_set_points(self) -> None:
        """Set preload and belt speed to zero: a reset after a stop starts nothing by itself (ISO 13850, 4.1.4)."""
        changes = [Parameter(name, value=0.0) for name in ("preload", "belt_speed") if name in self._can.set_points]
        refused = [result.reason for result in self.set_parameters(changes) if not result.successful]
        if refused:
            raise SafetyError(f"the set points cannot be set to zero: {'; '.join(refused)}")

    def impact(self) -> str:
        """An impact."""
        if not self._can.can_hit:
            raise DriverError(f"the driver {self._driver_name!r} cannot give the pad an impact")
        return "impact of ({:.4g}, {:.4g}) N s".format(*self._sampled().impact())

    def zero(self) -> str:
        """Take the force channels' tare."""
        offsets = ", ".join(f"{channel} {value:.6g}" for channel, value in self._sampled().take_tare().items())
        self._outputs.describe(self._description())
        needs = "Eq. (2.1) needs forces tared on the unloaded rig"
        return f"tare taken, subtracted from now on, in N and N m: {offsets}; {needs}"

    def pause(self, pause: bool) -> str:
        """Stop sampling for a while, or go on."""
        self._sampled()
        if pause == self._paused:
            return "paused already" if pause else "running already"
        if pause and self._can.keeps_time and "belt_speed" in self._can.set_points:
            raise DriverError(
                f"the driver {self._driver_name!r} moves a belt that would run on unwatched: set preload and belt_speed"
                " to zero, or deactivate the rig"
            )
        self._paused = pause
        if pause:
            self._stop_timer()
        else:
            self._restart()
        self._health_publisher.publish()
        return "paused" if pause else "running"

    def _sampled(self) -> Acquisition:
        if self._ended:
            raise DriverError("the rig was shut down: start its node again")
        if self._acquisition is None or not self._active:
            raise DriverError("the rig is not active: activate it first")
        return self._acquisition

    # --- health

    def _health(self) -> Health:
        acquisition = self._acquisition
        behind, overruns = self._pacer.worst_behind(), self._pacer.overruns - self._told_overruns
        self._told_overruns = self._pacer.overruns
        stopped = self._stop.stopped
        values = {
            "driver": self._driver_name,
            STATE_KEY: self._state(),
            MOVES_BELT: "belt_speed" in self._can.set_points,
            "samples": acquisition.samples if acquisition is not None else self._samples,
            "overruns": self._pacer.overruns,
            "behind [ms]": round(1e3 * behind, 1),
            "skipped [s]": round(self._pacer.skipped_seconds, 3),
            "not measured": ", ".join(sorted(self._can.not_measured)),
            "tared": bool(acquisition is not None and acquisition.tare),
            **self._outputs.listeners(),
            **self._outputs.published(),
            **self._stop.watchdog_health(),
        }
        warnings, self._warnings = self._warnings, ()  # those of the last second
        if stopped:
            return ERROR, f"{stopped}; {self._fault}" if self._fault else stopped, values
        if self._fault:
            return ERROR, self._fault, values
        if not self._active or self._paused:
            return OK, "shut down" if self._ended else "paused" if self._active else "inactive", values
        if self._stop.trouble:
            return ERROR, self._stop.trouble, values
        if self._held:
            return WARN, _WAITING, values
        silent = time.monotonic() - self._block_came if self._waiting else 0.0
        if silent > _SILENT:
            return ERROR, f"no samples from the driver for {silent:.1f} s", values
        if warnings:
            return WARN, " ".join(warnings), values
        if silent > _QUIET:
            return WARN, f"no samples from the driver for {silent:.2f} s", values
        if overruns:
            return WARN, f"fell behind real time: {self._pacer.skipped_seconds:.2f} s skipped so far", values
        if behind > LATE:
            return WARN, f"behind real time by {1e3 * behind:.0f} ms, catching up", values
        if self._sim_time_asked:
            return WARN, f"{_SIM_TIME} was asked for: {_OWN_TIME}", values
        return OK, "running", values

    def _state(self) -> str:
        """What the rig is doing, in a word for the supervisor."""
        if self._ended:
            return ENDED
        if not self._active:
            return INACTIVE
        if self._fault:
            return FAULT
        return PAUSED if self._paused else WAITING if self._held else RUNNING


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; returns the exit code."""
    return run_node(RigNode, args)


if __name__ == "__main__":
    sys.exit(main())
