"""Eq. (2.3) and its analytic Jacobian, against an independent right-hand side and numerical derivatives."""

import numpy as np
import pytest

from squeal_rig.model import RigParameters, equilibrium, friction_coefficient, jacobian, state_derivative
from squeal_rig.model.core.law import friction_refusal

from . import reference
from .random_rigs import SWITCHES, random_rig, random_state

RIGS_PER_SWITCH = 25  # times eight combinations of switches: 200 sets of parameters
#: Central difference of order 8: weights of f(+h i) - f(-h i), i = 1..4.
WEIGHTS = (4.0 / 5.0, -1.0 / 5.0, 4.0 / 105.0, -1.0 / 280.0)

by_switches = pytest.mark.parametrize("switches", SWITCHES, ids="-".join)


@by_switches
def test_the_right_hand_side_is_eq_2_3_as_typed_from_its_definition(switches):
    rng = np.random.default_rng(11)
    for closed in (True, False) * RIGS_PER_SWITCH:
        p = random_rig(rng, switches)
        state = random_state(rng, p, closed)
        expected = reference.state_derivative(p, state)
        # The plain difference of arm lengths in the reference loses digits: 1e-16 L against 1e-5 L and more.
        scale = (p.k1 * p.arm_length_1 + p.k2 * p.arm_length_2) / p.mass
        np.testing.assert_allclose(state_derivative(p, state), expected, rtol=1e-11, atol=1e-14 * scale)


@by_switches
def test_the_jacobian_is_the_numerical_derivative_of_the_right_hand_side(switches):
    rng = np.random.default_rng(7)
    for closed in (True, False) * RIGS_PER_SWITCH:
        p = random_rig(rng, switches)
        state = random_state(rng, p, closed)
        assert_jacobian_is_the_derivative(p, state)


@by_switches
def test_the_jacobian_at_the_equilibrium_of_the_calibrated_rig_is_the_numerical_derivative(switches):
    direction, speed, preload_direction = switches
    for preload in (50.0, 300.0):
        p = RigParameters(
            preload=preload,
            friction_direction=direction,
            friction_speed=speed,
            preload_direction=preload_direction,
            belt_speed=0.02,  # two widths of the tanh
        )
        assert_jacobian_is_the_derivative(p, np.array([*equilibrium(p), 0.0, 0.0]))


def assert_jacobian_is_the_derivative(p, state):
    """To 1e-6 of each entry; entries below 1e-8 of the largest in their 2x2 block drown in its rounding."""
    exact, numerical = jacobian(p, state), numerical_jacobian(p, state)
    for columns in (slice(0, 2), slice(2, 4)):
        block = exact[2:, columns]
        np.testing.assert_allclose(numerical[2:, columns], block, rtol=1e-6, atol=1e-8 * np.abs(block).max())
    np.testing.assert_array_equal(exact[:2], [[0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])


def numerical_jacobian(p, state):
    """Steps stay on one side of the kinks; arms bend over their length, the tanh over its width."""
    length = 1e-3 * min(p.arm_length_1, p.arm_length_2)
    speed = min(0.02 * p.regularization_speed, 0.2 * abs(p.belt_speed - state[2]))
    steps = (length, min(length, 0.2 * abs(state[1] - p.pretension_length)), speed, 1.0)
    result = np.zeros((4, 4))
    for column, step in enumerate(steps):
        for i, weight in enumerate(WEIGHTS, start=1):
            offset = np.zeros(4)
            offset[column] = i * step
            result[:, column] += (
                weight / step * (state_derivative(p, state + offset) - state_derivative(p, state - offset))
            )
    return result


def test_the_belt_only_pushes():
    p = RigParameters(preload=0.0, k1=0.0, k2=0.0, k3=0.0, k4=0.0)
    off = state_derivative(p, np.array([0.0, 1.1 * p.pretension_length, 0.0, 0.0]))
    on = state_derivative(p, np.array([0.0, 0.9 * p.pretension_length, 0.0, 0.0]))
    np.testing.assert_array_equal(off, np.zeros(4))
    assert on[3] == pytest.approx(0.1 * p.pretension_length * p.contact_stiffness / p.mass, rel=1e-12)
    assert on[2] == pytest.approx(friction_coefficient(p) * on[3], rel=1e-12)


def test_slip_direction_turns_friction_around_when_the_pad_overtakes_the_belt():
    p = RigParameters(friction_direction="slip")
    x, y = equilibrium(p)
    at_rest = state_derivative(p, np.array([x, y, 0.0, 0.0]))[2]
    sticking = state_derivative(p, np.array([x, y, p.belt_speed, 0.0]))[2]
    overtaking = state_derivative(p, np.array([x, y, 2.0 * p.belt_speed, 0.0]))[2]
    assert at_rest - sticking == pytest.approx(sticking - overtaking, rel=1e-12)
    push = friction_coefficient(p) * p.contact_stiffness * (p.pretension_length - y) / p.mass
    assert at_rest - sticking == pytest.approx(push, rel=1e-9)


def test_friction_law_is_the_regression_with_its_interaction():
    p = RigParameters(mu0=0.1, mu_speed=0.02, mu_preload=0.003, mu_speed_preload=-0.0004)
    assert friction_coefficient(p, speed=2.0, preload=100.0) == pytest.approx(0.1 + 0.04 + 0.3 - 0.08, rel=1e-14)
    assert friction_coefficient(p.replace(preload=100.0, belt_speed=2.0)) == pytest.approx(0.36, rel=1e-14)


def test_calibrated_friction_stays_plausible_over_the_demanded_range():
    # Physics: 0.277...0.8004 over F 10...300 N, V 1...4 m/s; bilinear, so its extremes are at corners.
    p = RigParameters.preset("yavuz_sen_2023")
    corners = [friction_coefficient(p, speed=v, preload=f) for v in (1.0, 4.0) for f in (10.0, 300.0)]
    assert (min(corners), max(corners)) == pytest.approx((0.277, 0.8004), abs=5e-4)
    assert friction_coefficient(p, 1.0, 300.0) == pytest.approx(0.8004, abs=5e-5)


def test_a_law_that_gives_negative_friction_is_refused_with_the_operating_point():
    assert friction_refusal(RigParameters()) is None
    sentence = friction_refusal(RigParameters(mu0=-0.5, preload=10.0, belt_speed=3.0))
    assert "mu = -0.46" in sentence
    assert "preload = 10 N" in sentence
    assert "belt_speed = 3 m/s" in sentence
    assert "0 or more" in sentence
