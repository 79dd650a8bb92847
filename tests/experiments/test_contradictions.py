"""Where the paper's printed equations contradict its own results: a proof for each entry of docs/physics.md.

Number 6 ("these two cases" after naming one) is a matter of words.
"""

import math

import numpy as np
import pytest

from squeal_rig.model import (
    RigParameters,
    critical_pad_stiffness,
    displaced_state,
    eigenvalues,
    equilibrium,
    friction_coefficient,
    simulate,
    stability_band,
    state_derivative,
)
from squeal_rig.model.linear.eigen import is_unstable, state_matrix

PRESET = RigParameters.preset("yavuz_sen_2023")
POINTS = [(50.0, 1.0), (50.0, 4.0), (200.0, 1.0), (300.0, 1.0)]


def normal_force(p, y):
    return p.contact_stiffness * (p.pretension_length - y)


def stiffness_matrix(p):
    return -p.mass * state_matrix(p, linear=True)[2:, :2]


def loads(p: RigParameters) -> tuple[float, float]:
    """k_c L_pre and 2 F sin(theta) [N]; tanh(sigma L_pre) is 1 to rounding."""
    return p.contact_stiffness * p.pretension_length, 2.0 * p.preload * math.sin(p.arm_angle_1)


def test_1_mirrored_arms_cannot_squeal_in_the_linear_model():
    for preload, speed in POINTS:
        p = RigParameters.preset("yavuz_sen_2023_as_printed").replace(preload=preload, belt_speed=speed)
        assert math.isnan(critical_pad_stiffness(p))
        for k in np.geomspace(1e5, 1e10, 200):
            assert not is_unstable(eigenvalues(p.replace(pad_stiffness=k), linear=True))


def test_2_the_friction_coefficient_in_the_second_row_is_not_in_the_nonlinear_model():
    # Small displacements: the linear equilibrium must tend to the exact one as r/L tends to 0. Without mu it does.
    p = PRESET.replace(preload=300.0, arm_length_1=10.0, arm_length_2=10.0)
    pretension, press = loads(p)
    mu = friction_coefficient(p)
    stray = np.linalg.solve(stiffness_matrix(p), [mu * pretension, mu * pretension - press])
    exact = np.array(equilibrium(p))
    assert np.linalg.norm(equilibrium(p, linear=True) - exact) < 1e-5 * np.linalg.norm(exact)
    assert np.linalg.norm(stray - exact) > 0.1 * np.linalg.norm(exact)


def test_3_the_printed_solution_of_the_equilibrium_lacks_parentheses():
    p = PRESET.replace(preload=300.0)
    pretension, press = loads(p)
    (k11, k12), (k21, k22) = stiffness_matrix(p)
    mu, determinant = friction_coefficient(p), k11 * k22 - k12 * k21
    # y* of Eq. (3.3), with the mu of its second row left out in both (contradiction 2).
    printed = (k11 * -press + pretension - k21 * mu * pretension) / determinant
    mended = (k11 * (-press + pretension) - k21 * mu * pretension) / determinant
    y = equilibrium(p, linear=True)[1]
    assert mended == pytest.approx(y, rel=1e-9)
    assert abs(printed / y - 1.0) > 0.5


def test_4_only_the_difference_to_the_equilibrium_frees_the_equations_of_their_constants():
    p = PRESET.replace(preload=300.0)
    pretension, press = loads(p)
    load = np.array([friction_coefficient(p) * pretension, pretension - press])
    rest = np.array(equilibrium(p, linear=True))
    # K r = load with r = r' + r* leaves K r' = 0; with r' = r + r*, as printed, it leaves K r' = 2 load.
    assert np.linalg.norm(stiffness_matrix(p) @ rest - load) < 1e-9 * np.linalg.norm(load)
    assert np.linalg.norm(stiffness_matrix(p) @ -rest - load) > np.linalg.norm(load)


def test_5_printed_friction_drives_a_pad_that_is_faster_than_the_belt():
    x, y = equilibrium(PRESET)
    slower, faster = ([x, y, v * PRESET.belt_speed, 0.0] for v in (0.5, 1.5))
    printed = [state_derivative(PRESET, np.array(state))[2] for state in (slower, faster)]
    assert printed[0] == printed[1]
    slip = PRESET.replace(friction_direction="slip")
    with_direction = [state_derivative(slip, np.array(state))[2] for state in (slower, faster)]
    assert with_direction[0] - with_direction[1] == pytest.approx(
        2.0 * friction_coefficient(PRESET) * normal_force(PRESET, y) / PRESET.mass
    )


def test_7_the_first_row_of_table_1_is_above_its_threshold_and_loses_contact():
    p = PRESET.replace(preload=300.0, belt_speed=1.0, pad_stiffness=2e7)
    assert critical_pad_stiffness(p) < 2e7
    # Undamped, as in the paper: flutter grows until the pad leaves the belt, within some hundredths of a second.
    run = simulate(p, 0.1, initial_state=displaced_state(p, 0.1))
    assert (run.normal_force == 0.0).any()
    assert np.abs(run.x).max() < 1e-3 * p.arm_length_1


@pytest.mark.parametrize(("preload", "speed"), POINTS)
def test_8_preload_along_parallel_arms_changes_the_normal_force_but_no_threshold(preload, speed):
    vertical = PRESET.replace(preload=preload, belt_speed=speed)
    along = vertical.replace(preload_direction="arms")
    assert stability_band(along) == stability_band(vertical)
    lowered = 1.0 - normal_force(along, equilibrium(along)[1]) / normal_force(vertical, equilibrium(vertical)[1])
    assert 0.01 <= lowered <= 0.065
