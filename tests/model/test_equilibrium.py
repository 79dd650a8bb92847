"""Static equilibrium: exact and linear, and the sentences where there is none."""

import math

import numpy as np
import pytest

from squeal_rig.errors import ModelError
from squeal_rig.model import RigParameters, displaced_state, equilibrium, stability_report, state_derivative

from . import reference
from .random_rigs import SWITCHES, random_rig

EPSILON = np.finfo(float).eps


@pytest.mark.parametrize("switches", SWITCHES, ids="-".join)
def test_the_exact_equilibrium_has_no_acceleration_but_rounding(switches):
    rng = np.random.default_rng(3)
    found = 0
    while found < 20:
        p = random_rig(rng, switches)
        try:
            x, y = equilibrium(p)
        except ModelError:
            continue
        found += 1
        assert y < p.pretension_length
        # Rounding of the position itself, seen through the stiffest spring, and of the loads that balance.
        stiffest = p.k1 + p.k2 + p.k3 + p.k4 + p.contact_stiffness
        loads = 2.0 * p.preload + p.contact_stiffness * (p.pretension_length + abs(y))
        rounding = EPSILON * (stiffest * (abs(x) + abs(y)) + loads) / p.mass
        residual = state_derivative(p, np.array([x, y, 0.0, 0.0]))[2:]
        assert np.abs(residual).max() <= 8.0 * rounding


@pytest.mark.parametrize("preset", ["yavuz_sen_2023", "yavuz_sen_2023_as_printed"])
@pytest.mark.parametrize("preload_direction", ["vertical", "arms"])
def test_the_linear_equilibrium_solves_eq_3_1_without_its_stray_friction_coefficient(preset, preload_direction):
    p = RigParameters.preset(preset).replace(preload=300.0, preload_direction=preload_direction)
    mu = reference.friction_law(p, p.belt_speed, p.preload)
    sines = math.sin(p.arm_angle_1) + math.sin(p.arm_angle_2)
    cosines = math.cos(p.arm_angle_1) + math.cos(p.arm_angle_2)
    pretension = p.contact_stiffness * p.pretension_length
    along = -p.preload * cosines if preload_direction == "arms" else 0.0
    loads = [mu * pretension + along, pretension - p.preload * sines]
    matrix = reference.stiffness(p, 0.5 * (p.k1 + p.k2))[0]
    np.testing.assert_allclose(equilibrium(p, linear=True), np.linalg.solve(matrix, loads), rtol=1e-12)


def normal_force(p, y):
    return p.contact_stiffness * (p.pretension_length - y)


def test_the_linear_equilibrium_smooths_the_contact_as_eq_3_1_does():
    # sigma L_pre = 1: the regularised contact carries (tanh(1) + 1)/2 of the pretension.
    p = RigParameters(preload=0.0, contact_smoothing=1e5, pretension_length=1e-5)
    full = equilibrium(p.replace(contact_smoothing=1e15), linear=True)
    share = 0.5 * (math.tanh(1.0) + 1.0)
    assert equilibrium(p, linear=True) == pytest.approx((share * full[0], share * full[1]), rel=1e-12)


def test_the_exact_equilibrium_approaches_the_linear_one_with_the_size_of_the_displacement():
    # The first neglected term is of second order: the relative difference falls with r/L.
    differences = []
    for length in (0.1, 1.0, 10.0):
        p = RigParameters(preload=300.0, arm_length_1=length, arm_length_2=length)
        exact, linear = np.array(equilibrium(p)), np.array(equilibrium(p, linear=True))
        differences.append(np.linalg.norm(exact - linear) / np.linalg.norm(linear))
    assert differences[0] < 1e-3
    assert differences[1] == pytest.approx(0.1 * differences[0], rel=0.01)
    assert differences[2] == pytest.approx(0.01 * differences[0], rel=0.01)


def test_contact_force_balances_the_preload_of_both_arms_where_arms_carry_nothing_else():
    # Mirrored arms without stiffness: N* = 2 F sin(theta).
    p = RigParameters.preset("yavuz_sen_2023_as_printed").replace(pad_stiffness=0.0, preload=100.0)
    _, y = equilibrium(p)
    assert normal_force(p, y) == pytest.approx(2.0 * 100.0 * math.sin(p.arm_angle_1), rel=1e-12)


def test_a_pad_lifted_off_the_belt_has_no_equilibrium_in_contact_and_the_sentence_says_where_it_is():
    # Arms at -135 degrees: the preload pulls the pad off the belt.
    p = RigParameters(arm_angle_1=-0.75 * math.pi, arm_angle_2=-0.75 * math.pi, preload=2000.0, mu0=0.0)
    for linear in (True, False):
        with pytest.raises(ModelError, match=r"^no equilibrium in contact: y = 1\.\d+e-05 m must be below .* 1e-05 m$"):
            equilibrium(p, linear=linear)
    with pytest.raises(ModelError, match=r"^no equilibrium in contact"):
        stability_report(p)


def test_without_pretension_and_preload_nothing_presses_the_pad_on_the_belt():
    with pytest.raises(ModelError, match=r"^no equilibrium in contact: y = 0 m"):
        equilibrium(RigParameters(pretension_length=0.0, preload=0.0))


def test_a_pad_that_nothing_holds_along_the_belt_has_no_equilibrium():
    p = RigParameters(k1=0.0, k2=0.0, k3=0.0, k4=0.0)
    with pytest.raises(ModelError, match=r"^no equilibrium: the stiffness matrix of Eq\. \(3\.1\) is singular$"):
        equilibrium(p, linear=True)
    with pytest.raises(ModelError, match=r"^no equilibrium found: Newton's method on Eq\. \(2\.3\) did not converge"):
        equilibrium(p)


@pytest.mark.parametrize(("preload", "stiffness"), [(50.0, 1e3), (500.0, 1e4), (2000.0, 1e5)])
def test_the_exact_equilibrium_is_found_where_it_is_far_from_the_linear_one(preload, stiffness):
    # Friction drags the pad by more than an arm length against soft arms, where the linear model means nothing.
    p = RigParameters(
        k1=stiffness, k2=stiffness, k3=0.0, k4=0.0, preload=preload, mu0=5.0, arm_length_1=0.01, arm_length_2=0.01
    )
    x, y = equilibrium(p)
    assert x > p.arm_length_1
    assert abs(x - equilibrium(p, linear=True)[0]) > 0.5 * x
    push = reference.friction_ratio(p, 0.0) * normal_force(p, y)
    assert np.abs(reference.state_derivative(p, [x, y, 0.0, 0.0])).max() < 1e-12 * push / p.mass


@pytest.mark.parametrize("compressions", [0.0, 0.1, 1.0, -2.0])
def test_a_displaced_state_is_so_many_static_compressions_towards_the_belt(compressions):
    p = RigParameters(preload=300.0)
    x, y = equilibrium(p)
    state = displaced_state(p, compressions)
    np.testing.assert_array_equal(state[[0, 2, 3]], [x, 0.0, 0.0])
    u = normal_force(p, y) / p.contact_stiffness
    assert y - state[1] == pytest.approx(compressions * u, rel=1e-9)
