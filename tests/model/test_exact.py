"""The exact engine against an independent solver, against itself, and against what physics conserves."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from squeal_rig.errors import ModelError
from squeal_rig.model import (
    Motion,
    RigParameters,
    contact_events,
    displaced_state,
    energy_balance,
    simulate,
    state_derivative,
)
from squeal_rig.model.motion.series import first_zero
from squeal_rig.model.motion.trajectory import resting_state

from .dop853 import reference

RATE = 51200.0
SQUEALING = RigParameters().replace(preload=300.0, belt_speed=1.0, pad_stiffness=6e7, damping_x=20.0, damping_y=20.0)
NO_FRICTION = {"mu0": 0.0, "mu_speed": 0.0, "mu_preload": 0.0, "mu_speed_preload": 0.0}


def states(run):
    return np.column_stack([run.x, run.y, run.vx, run.vy])


def largest_error(found, expected):
    """Largest error of x and y as a share of the largest displacement."""
    return np.max(np.abs(found[:, :2] - expected[:, :2])) / np.max(np.abs(expected[:, :2]))


def amplification(p, start, duration):
    """How much a small change of the start has grown at its largest: the share of an error no solver can avoid."""
    nudged = start.copy()
    nudged[1] -= 1e-8 * abs(start[1])
    moved = states(simulate(p, duration, initial_state=nudged)) - states(simulate(p, duration, initial_state=start))
    return np.max(np.abs(moved[:, :2])) / abs(nudged[1] - start[1])


def test_squeal_with_separations_agrees_with_dop853_over_50_ms():
    start = displaced_state(SQUEALING, 3.0)
    run = simulate(SQUEALING, 0.05, initial_state=start)
    expected, _ = reference(SQUEALING, start, run.t)
    # DOP853 loses about 1e-12 a step here; the start amplifies that some 170 times.
    assert 10.0 < amplification(SQUEALING, start, 0.05) < 1000.0
    assert largest_error(states(run), expected) < 3e-9


def test_events_agree_with_dop853():
    start = displaced_state(SQUEALING, 3.0)
    _, expected = reference(SQUEALING, start, np.arange(600) / RATE)
    found = contact_events(SQUEALING, 599 / RATE, initial_state=start)
    assert len(expected) > 15
    assert len(found.time) == len(expected)
    # DOP853's 1e-12 of some 1e-3 s, amplified.
    np.testing.assert_allclose(found.time, expected, atol=1e-12)
    assert (found.leaves == (found.speed > 0.0)).all()


@pytest.mark.parametrize("sample_rate", [2000.0, 12345.0, 51200.0, 1e6])
def test_the_sample_rate_does_not_change_the_motion(sample_rate):
    start = displaced_state(SQUEALING, 3.0)
    duration = 40 / 2000.0
    found = contact_events(SQUEALING, duration, sample_rate, start)
    expected = contact_events(SQUEALING, duration, 204800.0, start)
    count = min(len(found.time), len(expected.time))
    assert count > 30
    np.testing.assert_allclose(found.time[:count], expected.time[:count], atol=1e-11)


def test_blocks_give_the_bits_of_one_run():
    start = displaced_state(SQUEALING, 3.0)
    whole = np.empty((2048, 6))
    Motion(SQUEALING, RATE, start).advance(whole)
    motion, parts = Motion(SQUEALING, RATE, start), np.empty((2048, 6))
    for first in range(0, 2048, 128):
        motion.advance(parts[first : first + 128])
    np.testing.assert_array_equal(parts, whole)


@pytest.mark.parametrize("count", [1, 2, 3, 101])
def test_a_state_goes_on_as_the_run_it_was_taken_from_to_rounding(count):
    whole, part = np.empty((600, 6)), np.empty((count, 6))
    motion = Motion(SQUEALING, RATE, displaced_state(SQUEALING, 3.0))
    motion.advance(part)
    start = motion.state
    motion.advance(whole)
    rest = np.empty((600, 6))
    Motion(SQUEALING, RATE, start).advance(rest)
    # Rounding, 1e-16 a step, amplified as in all this motion.
    assert largest_error(rest, whole) < 1e-12


def test_two_crossings_within_one_sample_are_both_found():
    # A slow sampling sees the pad on the belt at both ends of many intervals in which it left and returned.
    start = displaced_state(SQUEALING, 3.0)
    found = contact_events(SQUEALING, 0.02, 1000.0, start)
    interval = np.floor(found.time * 1000.0)
    assert np.max(np.unique(interval, return_counts=True)[1]) >= 2
    np.testing.assert_allclose(found.time, contact_events(SQUEALING, 0.02, 1e5, start).time, atol=1e-11)


def test_a_short_hop_between_two_samples_is_not_missed():
    # On the belt at both ends of one sample interval, off it for a tenth of it: speed such that it falls back at once.
    p = SQUEALING.replace(pretension_length=1e-6, preload=100.0)
    edge, interval = p.pretension_length, 1.0 / RATE
    down = -state_derivative(p, np.array([0.0, edge, 0.0, 0.0]))[3]
    hop, before = 0.1 * interval, 0.45 * interval
    leaving = down * hop / 2.0
    start = np.array([0.0, edge - (leaving + down * before / 2.0) * before, 0.0, leaving + down * before])
    found = contact_events(p, interval, RATE, start)
    assert list(found.leaves) == [True, False]
    # Arms and contact change the acceleration by some percent on the way.
    assert found.time[1] - found.time[0] == pytest.approx(hop, rel=0.2)
    np.testing.assert_allclose(found.time, contact_events(p, interval, 64 * RATE, start).time, atol=1e-17)


@given(
    roots=st.lists(st.floats(0.01, 3.0), min_size=1, max_size=5),
    limit=st.floats(0.1, 1.0),
    scale=st.sampled_from([-1e-9, 1.0, 3e5]),
)
@settings(max_examples=300)
def test_no_polynomial_changes_its_sign_before_its_first_zero(roots, limit, scale):
    coefficients = scale * np.polynomial.polynomial.polyfromroots(roots)
    found, is_zero = first_zero(coefficients, limit)
    assert 0.0 < found <= limit
    rounding = 1e-14 * np.sum(np.abs(coefficients))
    # Points between the roots too, where a double crossing would show.
    between = np.convolve(sorted([0.0, *roots]), [0.5, 0.5], "valid")
    points = np.concatenate([np.linspace(0.0, found, 200), between[between < found]])
    values = np.polynomial.polynomial.polyval(points, coefficients) * np.sign(coefficients[0])
    assert values.min() >= -rounding
    if is_zero:
        assert abs(np.polynomial.polynomial.polyval(found, coefficients)) <= rounding


@given(
    preload=st.floats(20.0, 400.0),
    belt_speed=st.floats(0.5, 4.0),
    pad_stiffness=st.floats(1e7, 1.2e8),
    angle_1=st.floats(1.8, 2.8),
    angle_2=st.floats(1.8, 2.8),
    damping=st.sampled_from([0.0, 20.0, 200.0]),
    hit=st.floats(0.3, 3.0),
    vx=st.floats(-0.05, 0.05),
)
@settings(max_examples=25)
def test_energy_balances_over_a_second(preload, belt_speed, pad_stiffness, angle_1, angle_2, damping, hit, vx):
    p = RigParameters().replace(
        preload=preload,
        belt_speed=belt_speed,
        pad_stiffness=pad_stiffness,
        arm_angle_1=angle_1,
        arm_angle_2=angle_2,
        damping_x=damping,
        damping_y=damping,
    )
    try:
        start = displaced_state(p, hit)
    except ModelError:
        return
    start[2] = vx
    balance = energy_balance(p, 1.0, initial_state=start)
    assert abs(balance.imbalance) <= 1e-6 * balance.largest


def test_energy_balances_over_thousands_of_separations():
    balance = energy_balance(SQUEALING, 3.0, initial_state=displaced_state(SQUEALING, 3.0))
    assert balance.separations > 2500
    assert abs(balance.imbalance) <= 1e-8 * balance.largest


@pytest.mark.parametrize(
    "friction",
    [
        {"friction_speed": "slip"},
        {"friction_direction": "slip"},
        {"friction_speed": "slip", "friction_direction": "slip", "regularization_speed": 1e-3},
        {"friction_speed": "slip", "friction_direction": "slip", "regularization_speed": 1e-5},
    ],
    ids=["speed", "direction", "both", "both, sharp"],
)
def test_friction_that_sees_the_slip_is_followed_through_its_reversals(friction):
    p = SQUEALING.replace(belt_speed=0.02, mu0=0.15, mu_speed=0.3, **friction)
    start = displaced_state(p, 3.0)
    run = simulate(p, 0.01, initial_state=start)
    assert run.vx.max() > p.belt_speed
    expected = simulate(p, 0.01, initial_state=start, engine="rk4", step=2e-8)
    # What RK4 leaves at the kinks, with steps of 2e-8 s.
    assert largest_error(states(run), states(expected)) < 2e-8
    balance = energy_balance(p, 0.2, initial_state=start)
    assert abs(balance.imbalance) <= 1e-7 * balance.largest


FALLING = {"mu0": 0.82, "mu_speed": -0.02, "mu_preload": 0.0, "mu_speed_preload": 0.0}
SLIPPING = [
    pytest.param({"friction_direction": "slip"}, 0.02, id="direction"),
    pytest.param({"friction_speed": "slip", **FALLING}, 0.02, id="speed"),
    pytest.param({"friction_direction": "slip", "friction_speed": "slip", **FALLING}, 0.05, id="both"),
    # The pad overtakes the belt: tanh bends, mu has its kink.
    pytest.param({"friction_direction": "slip", "belt_speed": 0.05, "mu0": 0.15}, 0.01, id="direction, reversing"),
    pytest.param({"friction_direction": "slip", "belt_speed": 0.05, "regularization_speed": 1e-3}, 0.005, id="sharp"),
    pytest.param({"friction_speed": "slip", "belt_speed": 0.02, "mu0": 0.15, "mu_speed": 0.3}, 0.01, id="kink"),
]


@pytest.mark.parametrize(("friction", "duration"), SLIPPING)
def test_friction_that_sees_the_slip_agrees_with_dop853(friction, duration):
    p = SQUEALING.replace(**friction)
    start = displaced_state(p, 3.0)
    run = simulate(p, duration, initial_state=start)
    expected, events = reference(p, start, run.t)
    # As with constant friction.
    assert largest_error(states(run), expected) < 1e-9
    found = contact_events(p, len(run.t) / RATE, initial_state=start)
    assert len(events) > 5
    np.testing.assert_allclose(found.time[: len(events)], events, atol=1e-12)


@pytest.mark.parametrize(("friction", "_"), SLIPPING)
def test_energy_balances_with_friction_that_sees_the_slip(friction, _):
    balance = energy_balance(SQUEALING.replace(**friction), 0.5, initial_state=displaced_state(SQUEALING, 3.0))
    assert balance.separations > 100
    assert abs(balance.imbalance) <= 1e-8 * balance.largest


@pytest.mark.parametrize(("friction", "_"), SLIPPING)
def test_blocks_give_the_bits_of_one_run_with_friction_that_sees_the_slip(friction, _):
    assert_blocks_give_the_bits_of_one_run(SQUEALING.replace(**friction), displaced_state(SQUEALING, 3.0))


def test_blocks_give_the_bits_of_one_run_beyond_the_near_range_and_back():
    start = displaced_state(SQUEALING, 25.0)
    whole = assert_blocks_give_the_bits_of_one_run(SQUEALING, start)
    assert np.max(np.abs(whole[:, :2])) > 1e-3
    damped = SQUEALING.replace(preload=20.0, pad_stiffness=2e7, damping_x=1e4, damping_y=1e4)
    whole = assert_blocks_give_the_bits_of_one_run(damped, np.array([0.0, -4e-4, 0.0, 0.0]))
    # From beyond the near range, 0.24 mm here, into it.
    assert np.max(np.abs(whole[:100, :2])) > 2.5e-4
    assert np.max(np.abs(whole[-100:, :2])) < 5e-5


def assert_blocks_give_the_bits_of_one_run(p, start):
    whole = np.empty((2000, 6))
    Motion(p, RATE, start).advance(whole)
    for size in (1, 7, 128):
        motion, parts = Motion(p, RATE, start), np.empty((2000, 6))
        for first in range(0, 2000, size):
            motion.advance(parts[first : first + size])
        np.testing.assert_array_equal(parts, whole)
    run = simulate(p, 1999 / RATE, RATE, start)
    called = (run.x, run.y, run.vx, run.vy, run.normal_force, run.tangential_force)
    np.testing.assert_array_equal(np.column_stack(called), whole)
    return whole


def test_far_motions_agree_with_dop853():
    p = SQUEALING.replace(damping_x=0.0, damping_y=0.0)
    start = displaced_state(p, 25.0)
    run = simulate(p, 0.02, initial_state=start)
    expected, _ = reference(p, start, run.t)
    # The pad swings by a fifth of an arm: the arms' rotation is nothing small.
    assert np.max(np.hypot(run.x, run.y)) > 0.005
    assert largest_error(states(run), expected) < 1e-6


def test_a_pad_that_leaves_the_small_range_within_a_step_agrees_with_dop853():
    p = SQUEALING.replace(damping_x=20.0, damping_y=20.0)
    # From a hundredth of an arm's thousandth to a tenth of an arm in one sample: the far hits of a diverging motion.
    start = np.array([2e-5, 4e-5, -450.0, -750.0])
    run = simulate(p, 2e-5, initial_state=start)
    expected, _ = reference(p, start, run.t)
    assert np.max(np.hypot(run.x, run.y)) > 0.01
    assert largest_error(states(run), expected) < 1e-9


@pytest.mark.parametrize("length", [2e-3, 1e-2, 0.1, 10.0])
def test_arms_of_any_length_agree_with_dop853(length):
    p = SQUEALING.replace(arm_length_1=length, arm_length_2=0.7 * length, pretension_length=2e-5)
    start = displaced_state(p, 3.0)
    run = simulate(p, 0.01, initial_state=start)
    expected, _ = reference(p, start, run.t)
    assert largest_error(states(run), expected) < 1e-9


@given(
    pad_stiffness=st.floats(1e7, 1.2e8),
    preload=st.floats(10.0, 300.0),
    hit=st.floats(-2.0, 4.0),
    vx=st.floats(-0.05, 0.05),
)
@settings(max_examples=20)
def test_without_friction_and_damping_time_can_be_reversed(pad_stiffness, preload, hit, vx):
    p = RigParameters().replace(pad_stiffness=pad_stiffness, preload=preload, **NO_FRICTION)
    start = displaced_state(p, hit)
    start[2] = vx
    out = np.empty((1024, 6))
    motion = Motion(p, RATE, start)
    motion.advance(out)
    motion.set_state(motion.state * [1.0, 1.0, -1.0, -1.0])
    motion.advance(out)
    back = motion.state * [1.0, 1.0, -1.0, -1.0]
    size = np.max(np.abs(out), axis=0)[:4]
    # Separations make the motion irregular: rounding, 1e-16, grows; 1e-8 leaves it eight digits in 40 ms.
    assert np.max(np.abs(back - start)[:2]) <= 1e-8 * max(size[0], size[1], 1e-6)
    assert np.max(np.abs(back - start)[2:]) <= 1e-8 * max(size[2], size[3], 1e-2)


@given(
    pad_stiffness=st.floats(2e7, 1e8),
    preload=st.floats(50.0, 300.0),
    belt_speed=st.floats(1.0, 4.0),
    hit=st.floats(1.5, 4.0),
)
@settings(max_examples=20)
def test_halving_the_sample_interval_leaves_the_first_20_events(pad_stiffness, preload, belt_speed, hit):
    p = RigParameters().replace(
        pad_stiffness=pad_stiffness, preload=preload, belt_speed=belt_speed, damping_x=20.0, damping_y=20.0
    )
    start = displaced_state(p, hit)
    coarse = contact_events(p, 0.05, RATE, start).time[:20]
    fine = contact_events(p, 0.05, 2.0 * RATE, start).time[:20]
    assert len(coarse) == len(fine)
    np.testing.assert_allclose(coarse, fine, rtol=0.0, atol=1e-9)


def test_a_pad_at_rest_stays_there():
    p = SQUEALING.replace(preload=20.0)
    start = resting_state(p)
    run = simulate(p, 0.5, initial_state=start)
    # Stable here, but lightly damped: the rounding of some thousand steps rings on.
    assert np.max(np.abs(states(run)[:, :2] - start[:2])) <= 1e-10 * np.max(np.abs(start[:2]))


def test_a_pad_resting_on_the_very_edge_of_the_belt_stays_there():
    p = RigParameters().replace(preload=0.0, pretension_length=0.0)
    run = simulate(p, 0.05, initial_state=[0.0, 0.0, 0.0, 0.0])
    assert not np.any(states(run))


def test_a_diverging_motion_is_refused_with_a_sentence():
    # Friction that falls with the slip without end, and a pad without arms to hold it.
    p = RigParameters().replace(pad_stiffness=0.0, k3=0.0, k4=0.0, friction_speed="slip", mu_speed=-10.0)
    with pytest.raises(ModelError, match="left every bound"):
        simulate(p, 5.0, initial_state=[0.0, 0.0, 0.0, 0.0])


def test_new_parameters_act_from_the_next_block_on():
    other = SQUEALING.replace(preload=100.0)
    motion, block = Motion(SQUEALING, RATE, displaced_state(SQUEALING, 3.0)), np.empty((512, 6))
    motion.advance(block)
    between = motion.state
    motion.set_parameters(other)
    motion.advance(block)
    expected = np.empty((512, 6))
    Motion(other, RATE, between).advance(expected)
    np.testing.assert_array_equal(block, expected)
