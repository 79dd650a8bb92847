"""Trajectories: sampling, resuming, warnings, and the rig's known behaviour."""

import math

import numpy as np
import pytest

from squeal_rig.errors import ModelError, ParameterError
from squeal_rig.model import (
    Motion,
    RigParameters,
    critical_pad_stiffness,
    displaced_state,
    eigenvalues,
    equilibrium,
    friction_coefficient,
    sample_room,
    simulate,
    simulate_blocks,
    squeal_frequency,
)
from squeal_rig.model.core.layout import SAMPLE_SIZE
from squeal_rig.model.motion.trajectory import ENGINES, validity_warnings

SQUEALING = RigParameters(preload=300.0, damping_x=20.0, damping_y=20.0)


def columns(run):
    return np.column_stack([run.x, run.y, run.vx, run.vy, run.normal_force, run.tangential_force])


@pytest.mark.parametrize("blocks", [[512] * 4, [1, 2047], [700, 1, 1, 1346]])
@pytest.mark.parametrize("step", [None, 3e-6])
def test_a_motion_advanced_in_blocks_is_bit_for_bit_one_call_of_simulate(blocks, step):
    rate, start = 51200.0, displaced_state(SQUEALING, 0.4)
    run = simulate(SQUEALING, 2047 / rate, rate, start, step=step)
    motion = Motion(SQUEALING, rate, start, step=step)
    parts = []
    for size in blocks:
        block = np.empty((size, SAMPLE_SIZE))
        motion.advance(block)
        parts.append(block)
    assert len(run.t) == sum(blocks) == 2048
    np.testing.assert_array_equal(np.concatenate(parts), columns(run))


def test_blocks_of_a_run_follow_each_other_and_are_bit_for_bit_one_call_of_simulate():
    p = SQUEALING.replace(belt_speed=0.02)
    run = simulate(p, 0.02)
    blocks = list(simulate_blocks(p, 0.02, block_size=100))
    assert [len(block.x) for block in blocks] == [100] * 10 + [25]
    np.testing.assert_array_equal(np.concatenate([columns(block) for block in blocks]), columns(run))
    np.testing.assert_array_equal(np.concatenate([block.t for block in blocks]), run.t)
    # A block tells of its own samples: the motion grows, the pad overtakes the belt later on.
    assert blocks[0].warnings == ()
    assert run.warnings[0] in [sentence for block in blocks for sentence in block.warnings]


def test_a_run_longer_than_memory_can_be_iterated():
    blocks = simulate_blocks(SQUEALING, 1e7, block_size=10)
    assert next(blocks).t[-1] == 9 / 51200.0
    assert next(blocks).t[0] == 10 / 51200.0


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"block_size": 0}, "block_size = 0 is out of bounds"),
        ({"duration": -1.0}, "duration = -1.0 s is out of bounds"),
        ({"duration": 1e300}, "samples is out of bounds: at most"),
    ],
)
def test_a_bad_argument_of_simulate_blocks_is_refused_before_the_first_block(arguments, sentence):
    with pytest.raises(ParameterError, match=sentence):
        simulate_blocks(SQUEALING, **{"duration": 0.01, **arguments})


@pytest.mark.parametrize(
    "block",
    [
        np.zeros((100, 2 * SAMPLE_SIZE))[:, ::2],
        np.zeros((SAMPLE_SIZE, 100)).T,
        sample_room(100),
        sample_room(200)[50:150],
        np.zeros((100, 4)),
    ],
    ids=["every other column", "transposed", "room", "part of a room", "states alone"],
)
@pytest.mark.parametrize("engine", ENGINES)
def test_a_motion_fills_blocks_of_any_layout(block, engine):
    start = displaced_state(SQUEALING, 0.4)
    block[:] = math.nan
    Motion(SQUEALING, 51200.0, start, engine).advance(block)
    run = columns(simulate(SQUEALING, 99 / 51200.0, 51200.0, start, engine))
    np.testing.assert_array_equal(block, run[:, : block.shape[1]])


def test_a_motion_resumed_from_its_state_goes_on_bit_for_bit():
    whole, block = np.empty((600, SAMPLE_SIZE)), np.empty((300, SAMPLE_SIZE))
    start = displaced_state(SQUEALING, 0.4)
    Motion(SQUEALING, 51200.0, start).advance(whole)
    first = Motion(SQUEALING, 51200.0, start)
    first.advance(block)
    Motion(SQUEALING, 51200.0, first.state).advance(block)
    np.testing.assert_array_equal(block, whole[300:])


def test_a_motion_takes_new_parameters_from_the_next_block_on_and_not_before():
    stiffer = SQUEALING.replace(pad_stiffness=8e7)
    start, block = displaced_state(SQUEALING, 0.4), np.empty((100, SAMPLE_SIZE))
    motion = Motion(SQUEALING, 51200.0, start)
    motion.advance(block)
    np.testing.assert_array_equal(block, columns(simulate(SQUEALING, 99 / 51200.0, 51200.0, start)))
    state = motion.state
    motion.set_parameters(stiffer)
    motion.advance(block)
    np.testing.assert_array_equal(block, columns(simulate(stiffer, 99 / 51200.0, 51200.0, state)))


def test_a_kick_changes_the_velocity_and_nothing_else():
    motion = Motion(SQUEALING, 51200.0)
    before = motion.state
    motion.kick(0.01, -0.02)
    np.testing.assert_array_equal(motion.state, before + np.array([0.0, 0.0, 0.01, -0.02]))


def test_the_state_handed_out_and_taken_in_is_a_copy():
    start = displaced_state(SQUEALING, 0.4)
    motion = Motion(SQUEALING, 51200.0, start)
    kept = start.copy()
    motion.state[:] = 1.0
    motion.advance(np.empty((10, SAMPLE_SIZE)))
    np.testing.assert_array_equal(start, kept)
    motion.set_state(start)
    motion.kick(1.0, 1.0)
    np.testing.assert_array_equal(start, kept)


def test_a_pad_at_its_equilibrium_stays_there():
    p = RigParameters(damping_x=20.0, damping_y=20.0)
    block = np.empty((5120, SAMPLE_SIZE))
    Motion(p, 51200.0).advance(block)
    compression = p.pretension_length - equilibrium(p)[1]
    # Newton leaves the equilibrium at rounding; a stable rig does not magnify it.
    assert np.abs(block[:, :2] - equilibrium(p)).max() < 1e-9 * compression


def test_samples_are_at_multiples_of_the_sampling_interval_from_zero_to_the_duration():
    run = simulate(SQUEALING, 0.01, 1000.0)
    np.testing.assert_array_equal(run.t, np.arange(11) / 1000.0)
    assert len(simulate(SQUEALING, 0.0105, 1000.0).t) == 11
    # 0.3 * 10 is below 3 in no rounding: the last sample is not lost.
    assert len(simulate(SQUEALING, 0.7, 10.0).t) == 8
    assert {array.dtype for array in (run.t, run.x, run.y, run.vx, run.vy, run.normal_force)} == {np.dtype(np.float64)}


@pytest.mark.parametrize("direction", ["constant", "slip"])
@pytest.mark.parametrize("speed", ["belt", "slip"])
def test_forces_are_those_of_the_contact_and_of_the_friction_law(direction, speed):
    # A pad that overtakes the belt at first, whose slip passes the range in which tanh turns.
    p = SQUEALING.replace(friction_direction=direction, friction_speed=speed, belt_speed=0.1, regularization_speed=1e-3)
    run = simulate(p, 0.1, initial_state=displaced_state(p, 3.0) + np.array([0.0, 0.0, 0.3, 0.0]))
    slip = p.belt_speed - run.vx
    normal = p.contact_stiffness * np.maximum(0.0, p.pretension_length - run.y)
    speeds = np.abs(slip) if speed == "slip" else np.full(len(slip), p.belt_speed)
    mu = np.array([friction_coefficient(p.replace(belt_speed=float(v), friction_speed="belt")) for v in speeds])
    turned = np.tanh(slip / p.regularization_speed) if direction == "slip" else 1.0
    np.testing.assert_allclose(run.normal_force, normal, rtol=1e-15)
    np.testing.assert_allclose(run.tangential_force, mu * turned * normal, rtol=1e-12)
    assert (run.normal_force == 0.0).any()
    assert (slip < 0.0).any()
    assert (np.abs(slip) < 5e-3).any()


def test_a_block_that_has_no_room_for_samples_is_refused_and_an_empty_one_is_no_matter():
    motion = Motion(SQUEALING, 51200.0)
    with pytest.raises(ParameterError, match=r"shape \(10, 5\) must have 4 or 6 columns"):
        motion.advance(np.empty((10, 5)))
    motion.advance(np.empty((0, 6)))
    np.testing.assert_array_equal(motion.state, Motion(SQUEALING, 51200.0).state)


def test_a_motion_that_ends_says_when_whoever_asks():
    # Friction that falls with the slip without end, and a pad without arms to hold it: many pieces later it is gone.
    start = np.zeros(4)
    p = RigParameters().replace(pad_stiffness=0.0, k3=0.0, k4=0.0, friction_speed="slip", mu_speed=-10.0)
    with pytest.raises(ModelError) as called:
        simulate(p, 5.0, initial_state=start)
    block = np.full((256_001, 4), 7.0)
    with pytest.raises(ModelError) as advanced:
        Motion(p, 51200.0, start).advance(block)
    assert str(called.value) == str(advanced.value)
    assert block[-1, 0] == 7.0


def test_the_sampling_rate_does_not_change_the_motion():
    # 1 kHz and 10 kHz take the same steps of 1e-6 s.
    slow, fast = simulate(SQUEALING, 0.05, 1e3), simulate(SQUEALING, 0.05, 1e4)
    amplitude = np.ptp(fast.x)
    # Steps differ in their last bit (1e-3/1000 against 1e-4/100), and squeal magnifies that.
    np.testing.assert_allclose(slow.x, fast.x[::10], atol=1e-6 * amplitude)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"duration": 0.0}, "duration = 0.0 s is out of bounds: it must be above 0 s"),
        ({"duration": -1.0}, "duration = -1.0 s is out of bounds: it must be above 0 s"),
        ({"duration": math.nan}, "duration = nan s is out of bounds: it must be above 0 s"),
        ({"duration": math.inf}, "duration = inf s is out of bounds: it must be above 0 s"),
        (
            {"duration": 1e9},
            "duration times sample_rate = 5.12e+13 samples is out of bounds: at most 2147483648",
        ),
        ({"sample_rate": 0.0}, "sample_rate = 0.0 Hz is out of bounds: it must be above 0 Hz"),
        ({"sample_rate": math.nan}, "sample_rate = nan Hz is out of bounds: it must be above 0 Hz"),
        ({"step": 0.0}, "step = 0.0 s is out of bounds: it must be above 0 s"),
        ({"step": math.nan}, "step = nan s is out of bounds: it must be above 0 s"),
        ({"engine": "euler"}, "engine = 'euler' is not known: it must be one of"),
        ({"initial_state": [0.0, 0.0, 0.0]}, "initial_state = [0.0, 0.0, 0.0] must be four finite numbers"),
        ({"initial_state": [0.0, math.nan, 0.0, 0.0]}, "must be four finite numbers: x, y [m], vx, vy [m/s]"),
    ],
)
def test_a_bad_argument_of_simulate_is_refused_with_a_sentence(arguments, sentence):
    with pytest.raises(ParameterError) as refusal:
        simulate(SQUEALING, **{"duration": 0.01, **arguments})
    assert sentence in str(refusal.value)


def test_without_an_equilibrium_there_is_no_default_start():
    with pytest.raises(ModelError, match=r"^no equilibrium in contact"):
        simulate(RigParameters(preload=0.0, pretension_length=0.0), 0.01)


def test_a_step_too_long_for_the_method_ends_with_a_sentence_and_not_with_nan():
    # omega h = 8: far outside RK4's stability region.
    with pytest.raises(ModelError, match=r"^the motion left every bound 0\.\d+ s into the block"):
        simulate(SQUEALING, 1.0, 1000.0, engine="rk4", step=1e-3)


def test_the_default_start_is_a_tenth_of_the_static_compression_towards_the_belt():
    run = simulate(SQUEALING, 1e-4)
    np.testing.assert_array_equal([run.x[0], run.y[0], run.vx[0], run.vy[0]], displaced_state(SQUEALING, 0.1))


# The rig's known behaviour.


def share_off_the_belt(run, last):
    return float(np.mean(run.normal_force[run.t >= run.t[-1] - last] == 0.0))


def frequency(run, last):
    """Mean frequency [Hz] over the last seconds, from upward crossings of the mean."""
    y, t = run.y[run.t >= run.t[-1] - last], run.t[run.t >= run.t[-1] - last]
    y = y - 0.5 * (y.max() + y.min())
    up = np.flatnonzero((y[:-1] < 0.0) & (y[1:] >= 0.0))
    crossings = t[up] - y[up] * (t[up + 1] - t[up]) / (y[up + 1] - y[up])
    return (len(crossings) - 1) / (crossings[-1] - crossings[0])


def test_small_motion_below_separation_grows_at_the_rate_and_frequency_of_the_eigenvalue():
    p = SQUEALING.replace(pad_stiffness=6e7)
    value = eigenvalues(p)[0]
    run = simulate(p, 0.012, 1e6, displaced_state(p, 1e-5))
    assert run.normal_force.min() > 0.0
    deviation = run.y - equilibrium(p)[1]
    # The envelope between two peaks late in the run, when the other modes have died away.
    peaks = 1 + np.flatnonzero((deviation[1:-1] > deviation[:-2]) & (deviation[1:-1] >= deviation[2:]))
    first, last = peaks[-8], peaks[-1]
    rate = math.log(deviation[last] / deviation[first]) / (run.t[last] - run.t[first])
    # The other mode pair still dies away at the rate the first grows, and 1e-6 s is 1/850 of a period.
    assert rate == pytest.approx(value.real, rel=0.01)
    assert 7.0 / (run.t[last] - run.t[first]) == pytest.approx(squeal_frequency(eigenvalues(p)), rel=1e-3)


def test_damped_squeal_settles_on_a_limit_cycle_with_the_known_share_and_frequency():
    # F = 300 N, V = 1 m/s, k = 6e7 N/m, c = 20 N s/m: share 0.582, 974 Hz, below the linear 1174 Hz.
    run = simulate(SQUEALING.replace(pad_stiffness=6e7), 8.0)
    assert share_off_the_belt(run, last=1.0) == pytest.approx(0.582, abs=0.005)
    assert frequency(run, last=1.0) == pytest.approx(974.0, abs=3.0)
    halves = [np.ptp(run.y[(run.t > t) & (run.t < t + 0.5)]) for t in (7.0, 7.5)]
    assert halves[1] == pytest.approx(halves[0], rel=0.01)


@pytest.mark.parametrize(("damping", "quiet", "squeals"), [(20.0, 0.3, 0.4), (1000.0, 0.5, 0.6)])
def test_below_the_critical_stiffness_a_hit_starts_squeal_that_stays(damping, quiet, squeals):
    # Subcritical onset at F = 50 N, k = 4e7 N/m: the smallest hit on a grid of 0.1 u is 0.4 u, 0.6 u when damped more.
    p = RigParameters(preload=50.0, k1=4e7, k2=4e7, damping_x=damping, damping_y=damping)
    assert p.k1 < critical_pad_stiffness(p)
    after_small = simulate(p, 3.0, initial_state=displaced_state(p, quiet))
    after_large = simulate(p, 3.0, initial_state=displaced_state(p, squeals))
    assert share_off_the_belt(after_small, last=0.5) == 0.0
    late = after_small.t > 2.5
    assert np.ptp(after_small.y[late]) < 0.5 * np.ptp(after_small.y[:5000])
    # 0.46 to 0.52 over all stiffnesses and dampings, to the digits given.
    assert 0.455 <= share_off_the_belt(after_large, last=0.5) <= 0.525


def test_motion_scales_with_the_static_compression():
    # Apart from geometry separation is the only scale: twice preload and pretension, same friction, twice the motion.
    one = SQUEALING.replace(mu0=0.8, mu_speed=0.0, mu_preload=0.0, mu_speed_preload=0.0, preload=100.0)
    two = one.replace(preload=200.0, pretension_length=2.0 * one.pretension_length)
    runs = [simulate(p, 0.01) for p in (one, two)]
    assert (runs[0].normal_force == 0.0).any()
    amplitude = np.ptp(runs[0].y)
    # Geometry is of the order r/L = 1e-4, magnified by the growth of a few contacts.
    assert np.abs(runs[1].y - 2.0 * runs[0].y).max() < 0.02 * amplitude


def test_a_pad_that_overtakes_the_belt_is_reported_where_friction_is_taken_as_printed():
    p = SQUEALING.replace(belt_speed=0.02, pad_stiffness=4e7)
    run = simulate(p, 0.1)
    assert run.vx.max() > p.belt_speed
    assert len(run.warnings) == 1
    assert "above the belt speed 0.02 m/s: the printed direction of friction does not hold there" in run.warnings[0]
    assert f"{run.vx.max():.4g} m/s" in run.warnings[0]


def test_friction_in_slip_direction_holds_beyond_the_belt_speed_and_needs_no_warning():
    p = SQUEALING.replace(belt_speed=0.02, pad_stiffness=4e7, friction_direction="slip")
    run = simulate(p, 0.1)
    beyond = run.vx > p.belt_speed
    assert beyond.any()
    assert run.tangential_force[beyond].max() <= 0.0
    assert run.warnings == ()


def test_a_hard_hit_that_leaves_the_range_of_small_displacements_is_reported():
    # k = 6e7 N/m, hits of 15 to 40 u: grows until arm geometry stops it, at millimetres.
    p = RigParameters(preload=300.0, k1=6e7, k2=6e7)
    run = simulate(p, 2.0, initial_state=displaced_state(p, 40.0))
    assert max(np.abs(run.x).max(), np.abs(run.y).max()) > 1e-3
    assert any("displacement reached" in sentence and "arm length 0.1 m" in sentence for sentence in run.warnings)


def test_a_quiet_run_has_no_warnings():
    run = simulate(RigParameters(), 0.1)
    assert run.warnings == ()
    assert validity_warnings(RigParameters(), np.empty((0, SAMPLE_SIZE))) == []


@pytest.mark.parametrize(
    "changes",
    [
        {"mass": 1e-3, "contact_stiffness": 1e12},
        {"damping_x": 1e6, "damping_y": 1e6, "mass": 1e-3},
        {"friction_direction": "slip", "regularization_speed": 1e-6, "belt_speed": 0.0},
    ],
    ids=["stiff", "damped", "sharp"],
)
def test_a_block_that_would_take_too_long_is_given_up_with_a_sentence(changes):
    p = SQUEALING.replace(**changes)
    motion = Motion(p, 51200.0, displaced_state(p, 3.0), budget=20_000)
    with pytest.raises(ModelError, match=r"^the motion changes too fast: it used up its budget of steps \S+ s into"):
        motion.advance(np.empty((512, SAMPLE_SIZE)))


def test_a_budget_that_is_enough_changes_nothing():
    start = displaced_state(SQUEALING, 3.0)
    free, bound = np.empty((512, SAMPLE_SIZE)), np.empty((512, SAMPLE_SIZE))
    Motion(SQUEALING, 51200.0, start).advance(free)
    Motion(SQUEALING, 51200.0, start, budget=100_000).advance(bound)
    assert free.tobytes() == bound.tobytes()
