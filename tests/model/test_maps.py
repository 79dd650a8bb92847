"""Stability maps against numpy's eigenvalues and against the analysis of single points."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from squeal_rig.errors import ParameterError
from squeal_rig.model import RigParameters, eigenvalues, squeal_frequency, stability_band, stability_map
from squeal_rig.model.linear.eigen import is_unstable

RIGS = {
    "undamped": {},
    "equally damped": {"damping_x": 20.0, "damping_y": 20.0},
    "damped": {"damping_x": 20.0, "damping_y": 60.0},
    "one direction": {"damping_y": 60.0},
    "overdamped": {"damping_x": 5e5, "damping_y": 50.0},
    "other angles": {"damping_x": 2000.0, "damping_y": 50.0, "arm_angle_2": 0.6},
    "no flutter": {"arm_angle_1": 0.4, "arm_angle_2": 1.2},
    "slip speed": {"friction_speed": "slip", "damping_x": 30.0, "damping_y": 30.0, "preload_direction": "arms"},
    "slip direction": {"friction_direction": "slip", "damping_y": 30.0},
}


def sample(n, seed=1):
    rng = np.random.default_rng(seed)
    return {
        "preload": rng.uniform(10.0, 300.0, n),
        "belt_speed": rng.uniform(0.02, 4.0, n),
        "k1": rng.uniform(1e7, 1.2e8, n),
        "k2": rng.uniform(1e7, 1.2e8, n),
    }


def at(p, grids, i):
    return p.replace(**{name: float(values[i]) for name, values in grids.items()})


def largest_difference(found, expected):
    """Largest |difference| over |lambda|, each eigenvalue with the nearest not yet taken."""
    left, largest = list(found), 0.0
    for value in expected:
        nearest = int(np.argmin(np.abs(np.array(left) - value)))
        largest = max(largest, abs(left.pop(nearest) - value) / abs(value))
    return largest


@pytest.mark.parametrize("rig", RIGS)
def test_eigenvalues_agree_with_numpy(rig):
    p, grids = RigParameters().replace(**RIGS[rig]), sample(100)
    found = stability_map(p, bands=False, eigenvalues=True, **grids)
    for i in range(100):
        expected = eigenvalues(at(p, grids, i), linear=True)
        assert largest_difference(found.eigenvalues[i], expected) < 1e-9
        assert found.growth_rate[i] == pytest.approx(expected.real.max(), abs=1e-9 * abs(expected[0]))
        if is_unstable(expected):
            assert found.squeal_frequency[i] == pytest.approx(squeal_frequency(expected), rel=1e-9)
        else:
            assert np.isnan(found.squeal_frequency[i])


@pytest.mark.parametrize("rig", RIGS)
def test_bounds_are_those_of_the_single_point(rig):
    p, grids = RigParameters().replace(**RIGS[rig]), sample(12, seed=2)
    found = stability_map(p, **grids)
    for i in range(12):
        here = at(p, grids, i)
        lower, upper = stability_band(here)
        np.testing.assert_allclose(found.critical_pad_stiffness[i], lower, rtol=1e-9)
        np.testing.assert_allclose(found.upper_pad_stiffness[i], upper, rtol=1e-9)
        if lower > 0.0:
            assert found.margin[i] == pytest.approx((lower - 0.5 * (here.k1 + here.k2)) / lower, abs=1e-9)


@given(
    mass=st.floats(0.1, 1000.0),
    stiffness=st.floats(1e6, 1e9),
    clips=st.floats(0.0, 1e9),
    contact=st.floats(1e6, 1e10),
    angles=st.tuples(st.floats(-3.1, 3.1), st.floats(-3.1, 3.1)),
    damping=st.tuples(st.floats(0.0, 1e4), st.floats(0.0, 1e4)),
)
@settings(max_examples=100)
def test_roots_of_random_rigs_satisfy_the_characteristic_equation(mass, stiffness, clips, contact, angles, damping):
    p = RigParameters().replace(
        mass=mass,
        pad_stiffness=stiffness,
        k3=clips,
        contact_stiffness=contact,
        arm_angle_1=angles[0],
        arm_angle_2=angles[1],
        damping_x=damping[0],
        damping_y=damping[1],
    )
    found = stability_map(p, bands=False, eigenvalues=True).eigenvalues
    size = np.max(np.abs(found))
    # The sum of the eigenvalues is the trace of the state matrix, whatever their conditioning.
    assert abs(np.sum(found) + (damping[0] + damping[1]) / mass) <= 1e-9 * size
    for value in found:
        # Backward error: rounding moves the quartic's value by eps of its largest terms.
        quartic = np.poly(eigenvalues(p, linear=True)).real
        assert abs(np.polyval(quartic, value)) <= 1e-11 * np.polyval(np.abs(quartic), size)


def test_grids_broadcast():
    p = RigParameters()
    preload, stiffness = np.linspace(10.0, 300.0, 5)[:, None], np.linspace(1e7, 1e8, 4)
    found = stability_map(p, preload=preload, pad_stiffness=stiffness)
    assert found.margin.shape == (5, 4)
    assert found.eigenvalues is None
    alone = stability_map(p, preload=300.0, pad_stiffness=stiffness[2])
    assert found.margin[4, 2] == alone.margin
    assert alone.margin.shape == ()


def test_the_map_does_not_depend_on_the_number_of_threads():
    grids = sample(30_000)
    one = stability_map(RigParameters(damping_x=20.0, damping_y=60.0), threads=1, **grids)
    two = stability_map(RigParameters(damping_x=20.0, damping_y=60.0), threads=2, **grids)
    assert one.margin.tobytes() == two.margin.tobytes()
    assert one.growth_rate.tobytes() == two.growth_rate.tobytes()


@pytest.mark.parametrize(
    ("grids", "sentence"),
    [
        ({"preload": [10.0, -5.0]}, "preload = -5 N is out of bounds"),
        ({"preload": [10.0, float("nan")]}, "preload = nan N is not finite"),
        ({"preloads": 10.0}, "'preloads' is not a parameter of a stability map"),
        ({"arm_length_1": 0.1}, "'arm_length_1' is not a parameter of a stability map"),
        ({"preload": [1.0, 2.0], "mu0": [0.1, 0.2, 0.3]}, "do not broadcast"),
        ({"preload": "ten"}, "preload = 'ten' is not an array of numbers"),
    ],
)
def test_bad_grids_are_refused_with_a_sentence(grids, sentence):
    with pytest.raises(ParameterError, match=sentence):
        stability_map(RigParameters(), **grids)
