"""Sampling a rig: stamps, sample numbers, slew, tare, impact, against the real virtual driver."""

import dataclasses
import math

import numpy as np
import pytest

from squeal_rig.configuration.declared import declarations
from squeal_rig.errors import DriverError, ParameterError
from squeal_rig.instruments.acquisition import Acquisition, change_refusal
from squeal_rig.instruments.actuators import slewed
from squeal_rig.instruments.channels import DAQ_RECORD, TRUTH_RECORD
from squeal_rig.instruments.description import RigDescription
from squeal_rig.instruments.means import block_means
from squeal_rig.instruments.numbering import SEQ_MODULUS
from squeal_rig.instruments.settings import RigSettings
from squeal_rig.instruments.virtual import VirtualRig
from squeal_rig.model import RigParameters, simulate
from squeal_rig.model.motion.trajectory import displaced_state, resting_state

PARAMETERS = RigParameters().replace(damping_x=20.0, damping_y=20.0)


def acquisition(parameters: RigParameters = PARAMETERS, **settings: object) -> Acquisition:
    rig = Acquisition(VirtualRig(), parameters, RigSettings().from_mapping(settings))
    rig.start(10**18)
    return rig


def test_record_sizes_are_multiples_of_eight_bytes():
    assert DAQ_RECORD.itemsize % 8 == 0
    assert TRUTH_RECORD.itemsize % 8 == 0
    assert DAQ_RECORD["seq"] == np.uint32
    assert "f11" not in (DAQ_RECORD.names or ())


@pytest.mark.parametrize("rate", [1000, 44100, 51200, 48300])
def test_stamps_are_exact_multiples_of_the_sample_interval(rate: int):
    rig = acquisition(sample_rate=rate)
    size = rate // 100
    for number in range(30):
        block = rig.next_block()
        assert block.stamp == 10**18 + number * size * 10**9 // rate
        assert list(block.daq["seq"]) == list(range(number * size, (number + 1) * size))
        assert np.array_equal(block.daq["t"], np.arange(size) / rate)


def test_sample_numbers_wrap_and_go_on_over_a_restart():
    rig = acquisition()
    rig.samples = SEQ_MODULUS - 100
    block = rig.next_block()
    assert block.daq["seq"][99] == SEQ_MODULUS - 1
    assert block.daq["seq"][100] == 0
    rig.start(5)
    following = rig.next_block()
    assert following.stamp == 5
    assert following.daq["seq"][0] == 412


def test_blocks_put_together_are_the_trajectory_of_the_model():
    p = PARAMETERS.replace(preload=300.0)
    rig = acquisition(p)
    rig.next_block()
    rig._driver._motion.set_state(displaced_state(p, 1.0))  # type: ignore[attr-defined]
    blocks = [rig.next_block().truth for _ in range(5)]
    whole = simulate(p, 0.05, initial_state=displaced_state(p, 1.0))
    for name, expected in (("x", whole.x), ("vy", whole.vy), ("normal_force", whole.normal_force)):
        joined = np.concatenate([block[name] for block in blocks])  # type: ignore[index]
        assert np.array_equal(joined, expected[:2560])


def test_arm_forces_carry_the_vertical_balance_at_rest():
    # At rest m y'' = 0, so N is the denominator of Eq. (2.1), to first order in r/L: 1e-4 here.
    block = acquisition().next_block()
    sine = math.sin(PARAMETERS.arm_angle_1)
    normal = (block.daq["arm_left"] + block.daq["arm_right"]) * sine + 2.0 * PARAMETERS.preload * sine
    assert normal == pytest.approx(block.truth["normal_force"], rel=2e-4)  # type: ignore[index]


def test_motor_torque_is_tangential_force_times_drum_radius():
    block = acquisition(drum_radius=0.123).next_block()
    assert np.array_equal(block.daq["motor_torque"], block.truth["tangential_force"] * 0.123)  # type: ignore[index]


def test_clips_balance_what_arms_and_friction_leave_along_the_belt():
    daq, truth = (block := acquisition().next_block()).daq, block.truth
    clips = daq["clip_left"] - daq["clip_right"]  # the left one pulls where it is negative, the right one pushes
    cosine = math.cos(PARAMETERS.arm_angle_1)
    arms = -(daq["arm_left"] + daq["arm_right"]) * cosine
    assert clips + arms + truth["tangential_force"] == pytest.approx(0.0, abs=2e-4 * truth["tangential_force"][0])


def test_preload_in_force_follows_at_the_slew_rate_and_arrives():
    rig = acquisition(preload_slew_rate=1000.0)
    rig.set_point = PARAMETERS.replace(preload=75.0)
    in_force = [float(rig.next_block().daq["preload"][0]) for _ in range(4)]
    assert in_force == [60.0, 70.0, 75.0, 75.0]


def test_friction_law_takes_its_set_point_at_once():
    p = slewed(PARAMETERS, PARAMETERS.replace(mu0=0.5, k1=9e7), RigSettings(), 0.01)
    assert p.mu0 == 0.5
    assert p.k1 == pytest.approx(PARAMETERS.k1 + RigSettings().stiffness_slew_rate * 0.01)


def test_impact_changes_momentum_by_the_impulse():
    rig = acquisition(impact_impulse=0.4, impact_direction=-math.pi / 2)
    rig.next_block()
    assert rig.impact() == pytest.approx((0.0, -0.4), abs=1e-15)
    block = rig.next_block()
    # The first sample is taken at the block boundary, right after the impact; at rest before up to rounding.
    assert block.truth["vy"][0] == pytest.approx(-0.4 / PARAMETERS.mass, rel=1e-6)  # type: ignore[index]


def test_tare_is_the_last_block_and_reset_forgets_it():
    rig = acquisition()
    loaded = float(rig.next_block().daq["arm_left"].mean())
    offsets = rig.take_tare()
    assert offsets["arm_left"] == pytest.approx(loaded, rel=1e-12)
    tared = rig.next_block().daq
    for channel in offsets:
        assert tared[channel].mean() == pytest.approx(0.0, abs=1e-6)
    assert rig.take_tare()["arm_left"] == pytest.approx(loaded, rel=1e-9)  # a second tare does not pile up
    rig.reset()
    assert rig.next_block().daq["arm_left"].mean() == pytest.approx(loaded, rel=1e-9)


def test_reset_rests_the_pad_at_the_equilibrium_in_force():
    rig = acquisition()
    rig.impact()
    rig.next_block()
    rig.reset()
    block = rig.next_block()
    assert [block.truth[name][0] for name in ("x", "y", "vx", "vy")] == list(resting_state(PARAMETERS))


def test_means_without_truth_agree_with_the_true_means_in_steady_sliding():
    rig = acquisition()
    block = rig.next_block()
    true = block_means(block, PARAMETERS, rig.settings.drum_radius)
    blind = block_means(type(block)(block.stamp, block.daq, None, ()), PARAMETERS, rig.settings.drum_radius)
    assert blind.normal == pytest.approx(true.normal, rel=2e-4)
    assert blind.tangential == pytest.approx(true.tangential, rel=1e-12)


def test_only_operating_point_and_friction_law_may_change_while_active():
    can = VirtualRig().capabilities(RigSettings())
    allowed = {name for name in declarations(RigParameters) if change_refusal(name, can) is None}
    assert {"preload", "belt_speed", "k1", "k2", "mu0", "friction_speed"} <= allowed
    assert not {"mass", "k3", "contact_stiffness", "arm_angle_1", "damping_x"} & allowed


def test_a_driver_that_is_not_open_says_so():
    with pytest.raises(DriverError, match="not open"):
        VirtualRig().read(PARAMETERS)


def test_sample_rate_must_give_whole_blocks():
    with pytest.raises(ParameterError, match="multiple of 100 Hz"):
        RigSettings(sample_rate=51234)


def test_description_round_trips_through_yaml():
    description = RigDescription(PARAMETERS, 'a "name"', "virtual", False, 12800, 0.07, {"arm_left": -1.5e-7})
    assert RigDescription.from_yaml(description.to_yaml()) == description
    noisy = dataclasses.replace(description, instruments="poor", noise={"x": 1e-9}, ripple={"preload": 0.5})
    noisy = dataclasses.replace(noisy, full_scale={"arm_left": 500.0})
    assert RigDescription.from_yaml(noisy.to_yaml()) == noisy


def test_made_safe_the_preload_and_the_belt_come_to_nothing_until_reset():
    rig = acquisition(preload_slew_rate=1e4, belt_acceleration=50.0)
    rig.next_block()
    rig.make_safe()
    rig.set_point = PARAMETERS.replace(preload=80.0)  # not obeyed
    for _ in range(20):
        block = rig.next_block()
    assert np.all(block.daq["preload"] == 0.0)
    assert np.all(block.daq["belt_speed"] == 0.0)
    rig.reset()
    for _ in range(20):
        block = rig.next_block()
    assert np.all(block.daq["preload"] == 80.0)
    assert np.all(block.daq["belt_speed"] == PARAMETERS.belt_speed)


def test_what_had_not_come_to_rest_at_a_stop_is_not_taken_up_by_the_reset():
    rig = acquisition(preload_slew_rate=10.0, belt_acceleration=0.1)
    rig.next_block()
    rig.make_safe()
    rig.next_block()
    rig.set_point = PARAMETERS.replace(preload=0.0, belt_speed=0.0)
    rig.reset()
    block = rig.next_block()
    assert np.all(block.daq["preload"] == 0.0)
    assert np.all(block.daq["belt_speed"] == 0.0)


def test_set_points_are_not_in_force_where_the_driver_refuses_the_safe_command():
    class Refusing(VirtualRig):
        def make_safe(self):
            raise OSError("the inverter does not answer")

    rig = Acquisition(Refusing(), PARAMETERS, RigSettings(preload_slew_rate=1e4, belt_acceleration=50.0))
    with pytest.raises(OSError, match="does not answer"):
        rig.make_safe()
    for _ in range(20):
        rig.next_block()
    assert (rig.in_force.preload, rig.in_force.belt_speed) == (0.0, 0.0)


def test_what_a_device_lost_is_missing_from_the_numbers():
    class Device(VirtualRig):
        def read(self, in_force):
            return dataclasses.replace(super().read(in_force), stamp=7_000_000_000, lost=3)

    rig = Acquisition(Device(), PARAMETERS, RigSettings())
    first, second = rig.next_block(), rig.next_block()
    assert int(first.daq["seq"][0]) == 3
    assert int(second.daq["seq"][0]) == int(first.daq["seq"][-1]) + 4
    assert second.stamp == 7_000_000_000


def test_a_device_without_a_block_yet_changes_nothing():
    class Device(VirtualRig):
        def read(self, in_force):
            return None

    rig = Acquisition(Device(), PARAMETERS, RigSettings())
    rig.set_point = PARAMETERS.replace(preload=80.0)
    assert rig.poll() is None
    assert rig.samples == 0
    assert rig.in_force.preload == PARAMETERS.preload
    with pytest.raises(DriverError, match="no whole block"):
        rig.next_block()


def test_what_a_device_sampled_before_the_start_was_not_lost():
    class Device(VirtualRig):
        """A device with its own time that keeps what nobody has asked for."""

        kept = 5

        def capabilities(self, settings):
            return dataclasses.replace(super().capabilities(settings), keeps_time=True)

        def read(self, in_force):
            if self.kept == 0:
                return None
            self.kept -= 1
            return dataclasses.replace(super().read(in_force), stamp=self.kept, lost=1000 * self.kept)

    device = Device()
    rig = Acquisition(device, PARAMETERS, RigSettings())
    for start in (0, 10**9):
        device.kept = 5
        before = rig.samples
        rig.start(start)
        assert rig.poll() is None
        assert rig.samples == before
        device.kept = 1
        assert int(rig.next_block().daq["seq"][0]) == before
