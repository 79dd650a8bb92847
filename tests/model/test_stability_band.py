"""The stability band for any rig, against an independent linear model searched by scan and bisection."""

import math

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq

from squeal_rig.model import RigParameters, eigenvalues, equilibrium, friction_coefficient, stability_band

from . import reference

ROUNDING = 1e-6
STIFFEST = 1e10  # bound of k1, k2
ANGLES = st.one_of(
    st.floats(-math.pi, math.pi),
    st.sampled_from([0.75 * math.pi, 0.25 * math.pi, -0.25 * math.pi, -0.75 * math.pi, 0.5 * math.pi, 0.0]),
)


@st.composite
def rigs(draw, damping="none", angles=ANGLES):
    """Rigs with a friction law of one constant; stiffnesses as multiples of k_c, any angles."""
    k_c = 10.0 ** draw(st.floats(7.0, 10.0))
    angle_1 = draw(angles)
    angle_2 = draw(st.one_of(st.just(angle_1), angles))
    mass = 10.0 ** draw(st.floats(-1.0, 3.0))
    critical = math.sqrt(k_c * mass)
    c_x = c_y = 0.0
    if damping != "none":
        c_x = min(critical * 10.0 ** draw(st.floats(-4.0, -1.0)), 1e6)
        c_y = c_x if damping == "equal" else min(c_x * draw(st.floats(0.2, 5.0)), 1e6)
    return RigParameters(
        mass=mass,
        k1=1e7,
        k2=1e7 * draw(st.sampled_from([1.0, 0.0, 0.3, 0.9, 3.0])),
        k3=k_c * draw(st.one_of(st.floats(0.05, 1.5), st.sampled_from([0.5, 1.0]))),
        k4=0.0,
        contact_stiffness=k_c,
        arm_angle_1=angle_1,
        arm_angle_2=angle_2,
        damping_x=c_x,
        damping_y=c_y,
        mu0=draw(st.floats(0.0, 5.0)),
        mu_speed=0.0,
        mu_preload=0.0,
        mu_speed_preload=0.0,
    )


def scanned_band(p, threshold, extra):
    """Bounds of the lowest range of growth above a threshold: a scan, edges by brentq; nan where none is seen."""
    top = STIFFEST / max(reference.shares(p))
    k = np.unique(np.concatenate([[0.0], np.geomspace(1e-5 * p.contact_stiffness, top, 1500), extra]))
    k = k[k <= top]
    unstable = reference.growth(p, k) > threshold
    if not unstable.any():
        return math.nan, math.nan

    def edge(a, b):
        return brentq(lambda x: float(reference.growth(p, x)[0]) - threshold, a, b, xtol=1e-300, rtol=1e-14)

    first = int(np.argmax(unstable))
    stable_again = np.flatnonzero(~unstable[first:])
    lower = 0.0 if first == 0 else edge(k[first - 1], k[first])
    last = first + stable_again[0] if stable_again.size else 0
    return lower, edge(k[last - 1], k[last]) if last else math.inf


def assert_band_is_the_scanned_one(p):
    lower, upper = stability_band(p)
    stiffest = STIFFEST / max(reference.shares(p))
    if math.isnan(lower):
        lowest, highest = scanned_band(p, threshold(p), [])
        if not math.isnan(lowest):  # flutter too weak to be told from rounding
            k = np.linspace(lowest, min(highest, stiffest), 41)
            assert reference.growth(p, k).max() < 1.5 * ROUNDING, (lowest, highest)
        return
    # A band narrower than the scan's grid is looked for where the closed form claims it.
    width = min(upper, stiffest) - lower
    inside = lower + np.linspace(0.0, 1.0, 41) * width
    lowest, highest = scanned_band(p, threshold(p), inside)
    # Growth sets in with the square root of the distance from the edge, so passes the threshold this far inside.
    blur = 4.0 * width * (threshold(p) / reference.growth(p, inside).max()) ** 2
    assert lower == pytest.approx(lowest, rel=1e-7, abs=blur + 1e-5 * p.contact_stiffness)
    if upper < stiffest:
        assert upper == pytest.approx(highest, rel=1e-7, abs=blur)
    else:
        assert math.isinf(highest)


def threshold(p):
    """Undamped, growth is told from rounding by its size; damped, it passes zero on a slope."""
    return ROUNDING if p.damping_x == 0.0 else 0.0


CALIBRATED = RigParameters()
LEANING = RigParameters(arm_angle_1=0.3, arm_angle_2=0.3, mu0=4.0, mu_speed=0.0, mu_preload=0.0, mu_speed_preload=0.0)


@settings(max_examples=150)
@given(rigs())
@example(CALIBRATED)
@example(LEANING)
@example(LEANING.replace(arm_angle_1=0.2, arm_angle_2=0.7))  # divergence that ends again
@example(CALIBRATED.replace(contact_stiffness=4.65e8))  # k_c = k3 + k4: unstable from k = 0 on
def test_the_undamped_band_is_where_an_independent_scan_finds_growth(p):
    assert_band_is_the_scanned_one(p)


@settings(max_examples=80)
@given(rigs(damping="equal"))
@example(CALIBRATED.replace(damping_x=20.0, damping_y=20.0))
@example(LEANING.replace(damping_x=20.0, damping_y=20.0))
def test_the_band_with_equal_damping_is_where_an_independent_scan_finds_growth(p):
    assert_band_is_the_scanned_one(p)


@settings(max_examples=80)
@given(rigs(damping="unequal"))
@example(CALIBRATED.replace(damping_x=20.0, damping_y=60.0))
@example(CALIBRATED.replace(damping_x=60.0, damping_y=20.0))
def test_the_band_with_unequal_damping_is_where_an_independent_scan_finds_growth(p):
    assert_band_is_the_scanned_one(p)


@settings(max_examples=40)
@given(rigs(), st.booleans(), st.floats(0.1, 1000.0))
def test_damping_of_one_direction_alone_gives_the_band_of_an_independent_scan(p, along, damping):
    p = p.replace(**{"damping_x" if along else "damping_y": damping})
    lower, upper = stability_band(p)
    k = np.geomspace(1e-4 * p.contact_stiffness, STIFFEST / max(reference.shares(p)), 1500)
    grows = reference.growth(p, k)
    if math.isnan(lower):
        assert grows.max() < 1.01 * ROUNDING
        return
    assert not (grows[k < lower * (1.0 - 1e-6)] > 1.01 * ROUNDING).any()
    assert (grows[(k > lower * (1.0 + 1e-6)) & (k < upper * (1.0 - 1e-6))] > 0.99 * ROUNDING).all()


@settings(max_examples=60)
@given(st.floats(0.05, math.pi / 2 - 0.05), st.floats(0.05, 1.5), st.floats(0.1, 6.0), st.floats(0.0, 100.0))
def test_arms_that_lean_along_the_belt_diverge_where_det_k_is_negative(angle, clips, friction, damping):
    """Parallel arms at 0..90 degrees: K_ab > 0, no flutter, det K linear in k."""
    k_c = 1e9
    p = RigParameters(
        k3=clips * k_c,
        k4=0.0,
        contact_stiffness=k_c,
        arm_angle_1=angle,
        arm_angle_2=angle,
        damping_x=damping,
        damping_y=damping,
        mu0=friction,
        mu_speed=0.0,
        mu_preload=0.0,
        mu_speed_preload=0.0,
    )
    s, c = math.sin(angle), math.cos(angle)
    # k1 = k2 = k: det K = clips k_c^2 + k k_c (2 c^2 + 2 s^2 clips - 2 s c mu)
    slope = 2.0 * (c * c + s * s * clips - s * c * friction)
    lower, upper = stability_band(p)
    expected = -clips * k_c / slope if slope < 0.0 else math.inf
    assume(abs(expected / STIFFEST - 1.0) > 1e-3)
    if expected > STIFFEST:
        assert math.isnan(lower)
        return
    # det K's zero is found by cancellation in its slope.
    assert lower == pytest.approx(expected, rel=1e-9 / abs(slope))
    assert math.isinf(upper)
    value = eigenvalues(p.replace(pad_stiffness=min(1.5 * lower, STIFFEST)), linear=True)[0]
    assert value.real > 0.0
    assert value.imag == 0.0


@settings(max_examples=60)
@given(
    st.floats(0.05, math.pi / 2 - 0.05),
    st.floats(0.05, 1.5),
    st.floats(0.0, 5.0),
    st.floats(-9.0, 3.0),
    st.floats(-1.0, 1.0),
)
def test_mirrored_arms_have_no_band_however_little_they_are_damped(angle, clips, friction, exponent, skew):
    damping = 10.0**exponent
    p = RigParameters(
        k3=clips * 1e9,
        k4=0.0,
        contact_stiffness=1e9,
        arm_angle_1=math.pi - angle,
        arm_angle_2=angle,
        damping_x=damping,
        damping_y=damping * 2.0**skew,
        mu0=friction,
        mu_speed=0.0,
        mu_preload=0.0,
        mu_speed_preload=0.0,
    )
    assert all(math.isnan(bound) for bound in stability_band(p))


def test_a_law_that_gives_negative_friction_flutters_as_its_mirror_image_does():
    # x -> -x turns the arms over and the sign of friction with them.
    law = {"mu_speed": 0.0, "mu_preload": 0.0, "mu_speed_preload": 0.0}
    p = RigParameters(mu0=0.5, **law)
    mirrored = RigParameters(mu0=-0.5, arm_angle_1=0.25 * math.pi, arm_angle_2=0.25 * math.pi, **law)
    assert stability_band(mirrored) == pytest.approx(stability_band(p), rel=1e-12)


def test_a_band_that_reaches_beyond_the_stiffest_arm_is_still_found():
    p = RigParameters(
        contact_stiffness=1e11, k3=8e10, k4=0.0, mu0=1.0, mu_speed=0.0, mu_preload=0.0, mu_speed_preload=0.0
    )
    lower, upper = stability_band(p)
    assert lower < STIFFEST < 0.5 * upper
    assert reference.growth(p, [lower * 0.999])[0] < ROUNDING < reference.growth(p, [lower * 1.001])[0]


@pytest.mark.parametrize("ratio", [0.5, 1.0, 2.0])
def test_the_band_is_in_the_mean_stiffness_at_the_rig_s_own_ratio_and_not_of_its_size(ratio):
    p = RigParameters(k1=1e7, k2=ratio * 1e7)
    lower, upper = stability_band(p)
    assert stability_band(RigParameters(k1=7e7, k2=ratio * 7e7)) == pytest.approx((lower, upper), rel=1e-12)
    share_1, share_2 = 2.0 / (1.0 + ratio), 2.0 * ratio / (1.0 + ratio)
    for k, unstable in ((0.999 * lower, False), (1.001 * lower, True)):
        values = eigenvalues(p.replace(k1=share_1 * k, k2=share_2 * k), linear=True)
        assert bool(np.max(values.real / np.abs(values)) > ROUNDING) is unstable


def falling(**changes):
    """The calibrated rig with friction that sees the slip speed and falls with it (dmu/dV = -0.0167 s/m at 50 N)."""
    p = RigParameters(friction_speed="slip").replace(**changes)
    assert p.mu_speed + p.mu_speed_preload * p.preload < 0.0
    return p


def rising(**changes):
    p = RigParameters(friction_speed="slip", mu_speed=0.05).replace(**changes)
    assert p.mu_speed + p.mu_speed_preload * p.preload > 0.0
    return p


@pytest.mark.parametrize("preset", ["yavuz_sen_2023", "yavuz_sen_2023_as_printed"])
def test_friction_that_falls_with_slip_speed_destabilises_the_undamped_rig_at_any_stiffness(preset):
    p = RigParameters.preset(preset).replace(friction_speed="slip")
    lower, upper = stability_band(p)
    assert lower == 0.0
    assert math.isinf(upper)
    for k in np.geomspace(1e5, 1e10, 60):
        assert eigenvalues(p.replace(pad_stiffness=k), linear=True)[0].real > 0.0


def test_friction_that_rises_with_slip_speed_destabilises_coupled_modes_of_the_undamped_rig():
    # Where K_ab (K_ab + mu k_c) < 0, which is k < mu k_c for parallel arms at 135 degrees.
    p = rising()
    edge_of_coupling = friction_coefficient(p) * p.contact_stiffness
    lower, upper = stability_band(p)
    assert lower < 0.3 * stability_band(p.replace(friction_speed="belt"))[0]
    assert upper == pytest.approx(edge_of_coupling, rel=1e-2)
    for k, unstable in ((0.9 * edge_of_coupling, True), (1.1 * edge_of_coupling, False)):
        assert bool(eigenvalues(p.replace(pad_stiffness=k), linear=True)[0].real > 0.0) is unstable


def test_friction_that_rises_with_slip_speed_leaves_uncoupled_modes_stable():
    p = RigParameters.preset("yavuz_sen_2023_as_printed").replace(friction_speed="slip", mu_speed=0.05)
    assert all(math.isnan(bound) for bound in stability_band(p))


def test_with_damping_the_sign_of_the_slope_decides_whether_the_threshold_falls_or_rises():
    damped = {"damping_x": 500.0, "damping_y": 500.0}
    for p, sign in ((falling(**damped), -1.0), (rising(**damped), 1.0)):
        threshold, _ = stability_band(p)
        without, _ = stability_band(p.replace(friction_speed="belt"))
        # Unequal damping may go either way; here c_x = N dmu/dV is what is added to x alone.
        added = sign * abs(p.mu_speed + p.mu_speed_preload * p.preload) * contact_force(p)
        equivalent, _ = stability_band(p.replace(friction_speed="belt", damping_x=500.0 + added))
        # N changes with k: the equivalent damping is that at one stiffness only.
        assert threshold == pytest.approx(equivalent, rel=0.02)
        assert abs(threshold - without) > abs(threshold - equivalent)


def test_without_mode_coupling_a_steep_enough_fall_of_friction_overcomes_damping():
    p = RigParameters.preset("yavuz_sen_2023_as_printed").replace(
        friction_speed="slip", damping_x=20.0, damping_y=20.0, mu0=1.0
    )
    # Uncoupled, the mode along the belt has Re lambda = -(c_x + N dmu/dV)/2m at N of the linear equilibrium.
    for slope in (-0.01, -0.5):
        q = p.replace(mu_speed=slope - p.mu_speed_preload * p.preload)
        _, y = equilibrium(q, linear=True)
        normal_force = q.contact_stiffness * (q.pretension_length - y)
        expected = -(20.0 + normal_force * slope) / (2.0 * q.mass)
        values = eigenvalues(q, linear=True)
        assert np.abs(values.real - expected).min() == pytest.approx(0.0, abs=1e-9 * abs(values).max())
        assert bool(values[0].real > 0.0) is (slope == -0.5)


def contact_force(p):
    return p.contact_stiffness * (p.pretension_length - equilibrium(p)[1])


@pytest.mark.parametrize("preload", [50.0, 150.0, 300.0])
@pytest.mark.parametrize("stiffness", [2e7, 4e7, 6e7])
def test_preload_along_the_arms_keeps_the_band_and_lowers_the_contact_force_by_one_to_six_percent(preload, stiffness):
    vertical = RigParameters(preload=preload, k1=stiffness, k2=stiffness)
    along = vertical.replace(preload_direction="arms")
    assert stability_band(along) == stability_band(vertical)
    assert 0.94 <= contact_force(along) / contact_force(vertical) <= 0.99
    assert eigenvalues(along, linear=True) is not eigenvalues(vertical, linear=True)
    np.testing.assert_array_equal(eigenvalues(along, linear=True), eigenvalues(vertical, linear=True))
