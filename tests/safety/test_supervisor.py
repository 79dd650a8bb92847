"""The supervisor's rules, levels, latch and reset, with made samples and a made time."""

import dataclasses

import numpy as np
import pytest

from squeal_rig.errors import ParameterError, SafetyError
from squeal_rig.instruments.channels import DAQ_RECORD
from squeal_rig.instruments.data_sheets import load_data_sheets
from squeal_rig.instruments.description import RigDescription
from squeal_rig.instruments.settings import RigSettings
from squeal_rig.instruments.tolerances import promises
from squeal_rig.model.parameters import RigParameters
from squeal_rig.safety.awake import AwakeTime
from squeal_rig.safety.levels import Level, shortened
from squeal_rig.safety.settings import SupervisorSettings
from squeal_rig.safety.supervisor import RigSafe, Supervisor

RATE, ROWS = 51200, 512
RIG = RigDescription(RigParameters(preload=50.0, belt_speed=1.0))


class Bench:
    """A supervisor fed with blocks of a quiet rig, 10 ms each, but for what a test changes."""

    def __init__(self, rig=RIG, **settings):
        self.now, self.stamp, self.seq = 100.0, 10**18, 0
        self.supervisor = Supervisor(SupervisorSettings(**settings), self.now)
        self.rig, self.rows = rig, rig.sample_rate // 100
        self.supervisor.take_rig(rig)
        self.health("rig", state="running")
        self.run(5)

    def block(self, **channels):
        """Samples in which named channels have a value, or values (ROWS,)."""
        numbers = np.arange(self.rows)
        daq = np.zeros(self.rows, DAQ_RECORD)
        daq["t"], daq["seq"] = numbers / self.rig.sample_rate, (self.seq + numbers) % 2**32
        daq["belt_speed"], daq["preload"] = 1.0, 50.0
        for name, value in channels.items():
            daq[name] = value
        return daq

    def run(self, blocks=1, **channels):
        for k in range(blocks):
            self.now += 0.01
            if k % 100 == 0:
                self.health("rig", state="running")
            self.supervisor.take_block(self.stamp, self.block(**channels), self.now)
            self.supervisor.tick(self.now)
            self.stamp += 10_000_000
            self.seq += self.rows
        return self.supervisor.level

    def silent(self, seconds):
        for _ in range(round(seconds / 0.05)):
            self.now += 0.05
            self.supervisor.tick(self.now)
        return self.supervisor.level

    def health(self, name, level=0, message="running", state=""):
        self.supervisor.take_health(name, level, message, state, self.now)

    def reset(self, reason="mended"):
        self.supervisor.settings = dataclasses.replace(self.supervisor.settings, reset_reason=reason)
        return self.supervisor.reset(self.now)


def test_a_quiet_rig_stays_at_ok():
    bench = Bench()
    assert bench.run(300) == Level.OK
    assert bench.supervisor.events() == []
    assert bench.supervisor.sentence == "within all limits"


@pytest.mark.parametrize(
    ("channel", "value", "level"),
    [
        ("arm_left", 9_999.0, Level.OK),
        ("arm_left", -10_001.0, Level.WARN),
        ("arm_right", 15_001.0, Level.RAMP_DOWN),
        ("clip_left", -20_001.0, Level.STOP),
        ("preload", 20_001.0, Level.STOP),
        ("x", -1.1e-4, Level.WARN),
        ("y", 2.1e-4, Level.RAMP_DOWN),
        ("x", 4.1e-4, Level.STOP),
        ("motor_torque", 501.0, Level.WARN),
        ("motor_torque", -751.0, Level.RAMP_DOWN),
        ("motor_torque", 1001.0, Level.STOP),
    ],
)
def test_limits_have_three_levels(channel, value, level):
    bench = Bench()
    assert bench.run(**{channel: value}) == level
    if level:
        (event,) = bench.supervisor.events()
        assert event.sentence.startswith(f"{channel} reaches")
        assert "the limit is" in event.sentence


def test_a_spike_is_warned_of_and_a_fourth_sample_is_none():
    bench = Bench()
    values = np.zeros(ROWS)
    values[100:103] = 1e6
    assert bench.run(arm_left=values) == Level.WARN
    values[103] = 1e6
    assert bench.run(arm_left=values) == Level.STOP


def test_a_warning_goes_and_a_trip_stays():
    bench = Bench()
    bench.run(arm_left=11e3)
    assert bench.run(50) == Level.WARN
    assert bench.run(60) == Level.OK
    bench.run(arm_left=16e3)
    assert bench.run(300) == Level.RAMP_DOWN
    assert "arm_left reaches 1.6e+04 N, the limit is 15000 N" in bench.supervisor.sentence


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_numbers_that_are_none_warn_and_then_ramp_down(value):
    bench = Bench()
    assert bench.run(10, arm_left=value) == Level.WARN
    assert bench.run(1, arm_left=value) == Level.RAMP_DOWN
    bench = Bench()
    for _ in range(20):  # now and then is a warning
        bench.run(arm_left=value)
        assert bench.run(5) == Level.WARN


def test_saturation_is_at_the_full_scale_of_the_description():
    rig = dataclasses.replace(RIG, full_scale={"arm_left": 1000.0, "x": 1e-4})
    bench = Bench(rig)
    assert bench.run(30, arm_left=999.0, x=9.9e-5) == Level.OK
    assert bench.run(10, arm_left=-1000.0) == Level.WARN
    assert bench.run(1, arm_left=-1000.0) == Level.RAMP_DOWN
    assert "arm_left is at its full scale of 1000 N in 512 of 512 samples" in bench.supervisor.sentence


def test_a_stuck_channel_is_found_by_what_must_move_with_it():
    moving = np.sin(np.arange(ROWS))
    bench = Bench()
    assert bench.run(200, x=0.0, arm_left=0.0) == Level.OK  # all rest
    assert bench.run(51, x=1e-5 * moving, y=1e-6 * moving, arm_left=7.0, arm_right=100.0 * moving) == Level.RAMP_DOWN
    assert bench.supervisor.sentence.startswith("arm_left stands at 7 N for 0.5")


def test_a_channel_with_noise_is_stuck_where_it_rests():
    rng = np.random.default_rng(1)
    rig = dataclasses.replace(RIG, noise={"preload": 0.1, "motor_torque": 0.1})
    bench = Bench(rig)
    for _ in range(100):
        assert bench.run(preload=50.0 + 0.1 * rng.standard_normal(ROWS)) == Level.OK
    assert bench.run(52, preload=50.0) == Level.RAMP_DOWN


def test_the_belt_may_take_its_time_between_two_set_points_and_no_longer():
    bench = Bench()
    bench.supervisor.take_rig(bench.rig.with_parameters({"belt_speed": 3.0}))
    for speed in np.linspace(1.0, 3.0, 40):
        assert bench.run(belt_speed=speed) == Level.OK
    assert bench.run(100, belt_speed=3.05) == Level.OK
    assert bench.run(10, belt_speed=2.5) == Level.OK  # not yet for long
    assert bench.run(2, belt_speed=2.5) == Level.RAMP_DOWN


def test_a_belt_that_does_not_follow_is_found_after_the_settling():
    bench = Bench()
    bench.supervisor.take_rig(bench.rig.with_parameters({"belt_speed": 1.5}))
    assert bench.run(490, belt_speed=1.0) == Level.OK
    assert bench.run(30, belt_speed=1.0) == Level.RAMP_DOWN


def test_a_runaway_is_stopped_also_on_the_way_to_a_set_point():
    bench = Bench()
    bench.supervisor.take_rig(bench.rig.with_parameters({"belt_speed": 1.5}))
    assert bench.run(12, belt_speed=2.6) == Level.STOP


def test_a_belt_that_nobody_commands_has_no_set_point():
    bench = Bench()
    bench.supervisor.moves_belt = False
    assert bench.run(30, belt_speed=7.0) == Level.OK


def test_ripple_and_noise_of_the_drive_are_no_deviation():
    rng = np.random.default_rng(2)
    rig = dataclasses.replace(RIG, noise={"belt_speed": 0.5}, ripple={"belt_speed": 0.2})
    bench = Bench(rig)
    for k in range(300):
        speed = 1.0 + 0.2 * np.sin(0.1 * k) + 0.5 * rng.standard_normal(ROWS)
        assert bench.run(belt_speed=speed) == Level.OK


def test_time_back_ramps_down_and_time_ahead_is_warned_of():
    bench = Bench()
    bench.stamp += 10**9
    assert bench.run() == Level.WARN
    assert "jumps ahead by 1 s" in bench.supervisor.sentence
    bench.run(200)
    bench.stamp -= 10**9
    assert bench.run() == Level.RAMP_DOWN
    assert "runs back by 1 s" in bench.supervisor.sentence


def test_lost_blocks_by_their_share_of_a_second():
    bench = Bench()
    for k in range(10):
        bench.stamp += 10_000_000
        bench.seq += ROWS
        level = bench.run()
        assert level == (Level.WARN if k < 9 else Level.RAMP_DOWN), k


def test_late_blocks_are_disorder_and_not_lost():
    bench = Bench()

    def swap():
        first = bench.stamp, bench.seq
        bench.stamp, bench.seq = bench.stamp + 10_000_000, bench.seq + ROWS
        bench.run()
        after = bench.stamp, bench.seq
        bench.stamp, bench.seq = first
        bench.run()
        bench.stamp, bench.seq = after
        return bench.run(3)

    assert swap() == Level.WARN
    assert {finding.rule for finding in bench.supervisor.findings if finding.rule == "order"}
    swap()
    assert swap() == Level.RAMP_DOWN
    assert "out of order" in bench.supervisor.sentence


def test_numbers_that_wrap_are_in_order():
    bench = Bench()
    bench.health("rig", state="paused")
    bench.health("rig", state="running")
    bench.seq = 2**32 - 5 * ROWS
    assert bench.run(10) == Level.OK


def test_a_rig_without_samples_is_stale_and_then_stopped():
    bench = Bench()
    assert bench.silent(0.15) == Level.OK
    assert bench.silent(0.1) == Level.WARN
    assert bench.silent(0.7) == Level.WARN
    assert bench.silent(0.15) == Level.STOP


def test_a_rig_that_is_too_slow_is_warned_of():
    bench = Bench()
    bench.run(300)
    for _ in range(100):
        assert bench.supervisor.level == Level.OK or bench.supervisor.sentence.startswith("samples come at ")
        bench.now += 0.02
        bench.supervisor.tick(bench.now)
        bench.run()
    bench.run(100)
    assert bench.supervisor.level == Level.WARN


@pytest.mark.parametrize("state", ["paused", "inactive", "waiting", "ended"])
def test_a_rig_that_says_why_is_not_stale(state):
    bench = Bench()
    bench.health("rig", state=state)
    assert bench.silent(2.0) == Level.OK
    bench.health("rig", state="running")
    assert bench.silent(0.1) == Level.OK
    assert bench.silent(1.1) == Level.STOP


def test_who_was_held_up_himself_takes_nobody_for_silent():
    bench = Bench()
    bench.now += 60.0
    bench.supervisor.tick(bench.now)
    assert bench.supervisor.level == Level.OK
    clock = AwakeTime(0.0, 0.1)
    assert clock.look(0.05) == pytest.approx(0.05)
    assert clock.look(60.0) == pytest.approx(0.15)
    assert clock.look(59.0) == pytest.approx(0.15)


def test_a_node_that_has_been_well_must_go_on_telling():
    bench = Bench(node_timeout=1.5)
    bench.health("stability", level=1, message="no daq/samples yet")
    bench.health("squeal_detector")
    bench.health("stranger")
    assert bench.supervisor.watched == ["rig", "squeal_detector"]
    assert bench.run(149) == Level.OK
    assert bench.run(3) == Level.RAMP_DOWN
    assert bench.supervisor.sentence.startswith("squeal_detector has not reported its health for 1.5")
    with pytest.raises(SafetyError, match="squeal_detector has not reported"):
        bench.reset()
    bench.health("squeal_detector")
    assert bench.reset() == "ramp down released: mended"


def test_an_inactive_rig_may_be_silent_while_it_compiles_and_a_driven_one_may_not():
    bench = Bench()
    bench.health("rig", message="inactive", state="inactive")
    assert bench.silent(60.0) == Level.WARN
    assert bench.supervisor.sentence.startswith("rig has not reported its health for ")
    bench.health("rig", state="running")
    assert bench.run(5) == Level.OK
    bench.health("rig", state="paused")
    assert bench.silent(60.0) == Level.STOP


def test_an_error_of_a_node_is_warned_of_and_a_fault_of_the_rig_stops():
    bench = Bench()
    bench.health("friction_estimator", level=2, message="two rigs")
    assert bench.supervisor.level == Level.WARN
    bench.health("rig", level=2, message="ZeroDivisionError: no bridge voltage", state="fault")
    assert bench.supervisor.level == Level.STOP
    assert "no bridge voltage" in bench.supervisor.sentence


def test_squeal_has_a_level_and_a_duration():
    bench = Bench(squeal_duration=3.0)
    take = bench.supervisor.take_squeal
    take(True, 20.0, bench.now)
    assert bench.supervisor.level == Level.OK
    take(True, 31.0, bench.now)
    assert bench.supervisor.level == Level.WARN
    take(True, 36.0, bench.now)
    assert bench.supervisor.level == Level.RAMP_DOWN
    bench = Bench(squeal_duration=3.0)
    for k in range(400):
        bench.run()
        bench.supervisor.take_squeal(k != 250, 0.0, bench.now)
    assert bench.supervisor.level == Level.OK  # two squeals, neither for so long
    for _ in range(200):
        bench.run()
        bench.supervisor.take_squeal(True, 0.0, bench.now)
    assert bench.supervisor.level == Level.RAMP_DOWN


def test_a_flood_of_parameters_is_warned_of_and_then_ramps_down():
    bench = Bench()
    bench.supervisor.take_changes(50, bench.now)
    assert bench.supervisor.level == Level.OK
    bench.supervisor.take_changes(1, bench.now)
    assert bench.supervisor.level == Level.WARN
    bench.supervisor.take_changes(10**9, bench.now)
    assert bench.supervisor.level == Level.RAMP_DOWN


def test_a_ramp_down_wants_the_set_points_at_zero_and_a_rig_at_rest_in_time():
    bench = Bench(ramp_time=1.0)
    bench.run(arm_left=16e3)
    assert bench.supervisor.wants_rest
    bench.supervisor.take_rig(bench.rig.with_parameters({"preload": 0.0, "belt_speed": 0.0}))
    assert not bench.supervisor.wants_rest
    assert bench.run(90, belt_speed=0.0) == Level.RAMP_DOWN
    assert bench.run(20, belt_speed=0.0, preload=50.0) == Level.STOP
    assert "not at rest 1 s after the ramp down began: preload 50 N" in bench.supervisor.sentence
    # Whoever moves the set points again gets them set back.
    bench = Bench()
    bench.run(arm_left=16e3)
    bench.supervisor.take_rig(bench.rig.with_parameters({"preload": 0.0, "belt_speed": 0.0}))
    bench.supervisor.take_rig(bench.rig)
    assert bench.supervisor.wants_rest


def test_the_reset_of_a_stop_wants_a_reason_and_a_healthy_rig_and_uses_the_reason_up():
    bench = Bench()
    with pytest.raises(SafetyError, match="nothing to reset: the level is ok"):
        bench.reset()
    bench.supervisor.ask_stop("somebody is near the drum", bench.now)
    assert bench.supervisor.level == Level.STOP
    assert bench.supervisor.wants_stop
    bench.supervisor.take_safe(RigSafe(True, "somebody is near the drum", 5), bench.now)
    assert not bench.supervisor.wants_stop
    for empty in ("", "  "):
        with pytest.raises(SafetyError, match="reset_reason is empty: set it to what was found"):
            bench.reset(empty)
    bench.run(200, arm_left=21e3)
    with pytest.raises(SafetyError, match=r"the rig is not healthy: arm_left reaches 2\.1e\+04 N"):
        bench.reset()
    bench.run(150, belt_speed=0.0)
    assert (
        bench.reset("it was a mouse")
        == "emergency stop released: it was a mouse; the rig stays safe until its own ~/reset"
    )
    assert bench.supervisor.settings.reset_reason == ""
    assert bench.run(100, belt_speed=0.0) == Level.OK  # the rig's own stop, which we know, is no new one
    rules = [event.rule for event in bench.supervisor.events()]
    assert rules[0] == "request"
    assert rules[-1] == "reset"


def test_a_stop_that_the_rig_made_by_itself_is_latched():
    bench = Bench()
    bench.supervisor.take_safe(RigSafe(True, "no heartbeat of the supervisor", 7), bench.now)
    assert bench.supervisor.level == Level.STOP
    assert "no heartbeat" in bench.supervisor.sentence


def test_a_supervisor_that_comes_to_a_stopped_rig_takes_the_stop_over_and_can_be_reset():
    bench = Bench()
    fresh = bench.supervisor = Supervisor(SupervisorSettings(), bench.now)
    fresh.take_rig(RIG)
    fresh.take_safe(RigSafe(True, "no heartbeat of the supervisor", 7), bench.now)
    bench.health("rig", level=2, message="emergency stop: no heartbeat of the supervisor", state="running")
    assert bench.run(10, belt_speed=0.0) == Level.STOP
    assert bench.reset("started again").startswith("emergency stop released: started again")


def test_a_stop_that_the_driver_does_not_accept_cannot_be_released():
    bench = Bench()
    bench.supervisor.take_safe(RigSafe(True, "a test", 7, accepted=False), bench.now)
    assert bench.supervisor.wants_stop
    with pytest.raises(SafetyError, match="not accepted the safe command"):
        bench.reset()


def test_a_stop_that_the_rig_has_not_told_of_cannot_be_released():
    # As where it was killed and started again: the stop that is on its way would reach the rig after the reset.
    bench = Bench()
    bench.supervisor.ask_stop("a test", bench.now)
    with pytest.raises(SafetyError, match="not reported yet that it is stopped"):
        bench.reset()
    bench.supervisor.take_safe(RigSafe(True, "a test", 7), bench.now)
    assert bench.reset().startswith("emergency stop released")


def test_a_stop_by_the_rigs_service_after_the_reset_is_latched_anew():
    bench = Bench()
    safe = RigSafe(True, "a test", 7, by_service=1)
    bench.supervisor.take_safe(safe, bench.now)
    bench.reset()
    bench.supervisor.take_safe(safe, bench.now)
    assert not bench.supervisor.latched  # told again, and not asked for again
    bench.supervisor.take_safe(dataclasses.replace(safe, by_service=2), bench.now)
    assert bench.supervisor.latched == Level.STOP


def test_a_supervisor_that_meets_a_running_rig_without_samples_stops_it_in_the_end():
    bench = Bench()
    fresh = bench.supervisor = Supervisor(SupervisorSettings(nodes=("rig",)), bench.now)
    fresh.take_rig(RIG)
    met = bench.now
    for _ in range(600):  # 12 s
        bench.now += 0.02
        bench.health("rig", state="running")
        fresh.tick(bench.now)
        if bench.now < met + 4.0:
            assert fresh.level <= Level.WARN  # discovery takes its time
    assert fresh.level == Level.STOP
    assert "no samples of the rig" in fresh.sentence


def test_a_rig_that_says_good_bye_is_missed_by_nobody():
    bench = Bench()
    bench.run(10)
    bench.health("rig", state="ended")
    for _ in range(1500):
        bench.now += 0.02
        bench.supervisor.tick(bench.now)
    assert bench.supervisor.latched == Level.OK


@pytest.mark.parametrize("name", ["typical", "poor"])
def test_a_rig_that_came_to_rest_is_not_stopped_for_its_noise(name):
    rng = np.random.default_rng(3)
    bench = Bench(dataclasses.replace(RIG, **promises(load_data_sheets(name), RIG.parameters, RigSettings())))
    noise, offset = bench.rig.noise, bench.rig.offset_error

    def at_rest():
        return {
            channel: rng.normal(0.9 * offset.get(channel, 0.0), noise[channel], 512)
            for channel in ("preload", "belt_speed")
        }

    bench.run(arm_left=16e3)
    assert bench.supervisor.latched == Level.RAMP_DOWN
    bench.supervisor.take_rig(bench.rig.with_parameters({"preload": 0.0, "belt_speed": 0.0}))
    for _ in range(1500):  # 15 s
        bench.run(1, **at_rest())
    assert bench.supervisor.latched == Level.RAMP_DOWN


def test_a_preload_that_is_no_number_is_not_at_rest():
    bench = Bench()
    bench.run(30, preload=np.nan)
    assert bench.supervisor.latched == Level.RAMP_DOWN
    bench.supervisor.take_rig(bench.rig.with_parameters({"preload": 0.0, "belt_speed": 0.0}))
    bench.run(1200, preload=np.nan, belt_speed=0.0)
    assert bench.supervisor.latched == Level.STOP


@pytest.mark.parametrize("rate", [1000, 51200])
def test_spikes_in_every_block_are_none(rate):
    bench = Bench(dataclasses.replace(RIG, sample_rate=rate))
    values = np.zeros(rate // 100)
    values[:1] = 1e6
    bench.run(1, arm_left=values)
    assert bench.supervisor.level == Level.WARN
    bench.run(3, arm_left=values)
    assert bench.supervisor.level == Level.STOP


def test_a_long_reason_is_cut():
    bench = Bench()
    bench.supervisor.ask_stop("x" * 1_000_000, bench.now)
    assert len(bench.supervisor.sentence) < 250
    assert shortened("two\n lines") == "two lines"


def test_limits_out_of_order_are_refused():
    with pytest.raises(ParameterError, match="force_warn = 20000 N must not be above force_ramp_down = 15000 N"):
        SupervisorSettings(force_warn=2e4)
    with pytest.raises(ParameterError, match="stale_warn = 2 s must not be above stale_stop = 1 s"):
        SupervisorSettings(stale_warn=2.0)
