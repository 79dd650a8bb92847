"""Critical pad stiffness and unstable frequency of the presets, against the calibration's table and the paper."""

import math

import numpy as np
import pytest

from squeal_rig.model import (
    RigParameters,
    critical_pad_stiffness,
    eigenvalues,
    squeal_frequency,
    stability_band,
    stability_report,
)

from . import reference
from .published import FREQUENCIES, THRESHOLDS, same_to_digits

#: Judged as in the linear analysis: below this share of |lambda| a positive real part is rounding.
ROUNDING = 1e-6
POINTS = [pytest.param(f, v, ours, paper, id=f"F{f:g}-V{v:g}") for f, v, ours, paper in THRESHOLDS]


def at(preload, belt_speed, **changes):
    return RigParameters.preset("yavuz_sen_2023").replace(preload=preload, belt_speed=belt_speed, **changes)


def grows(p, linear):
    values = eigenvalues(p, linear=linear)
    return bool(np.max(values.real / np.abs(values)) > ROUNDING)


@pytest.mark.parametrize(("preload", "belt_speed", "ours", "paper"), POINTS)
def test_critical_stiffness_has_the_calibrated_value_to_three_digits(preload, belt_speed, ours, paper):
    assert same_to_digits(critical_pad_stiffness(at(preload, belt_speed)), ours, 3)


@pytest.mark.parametrize(("preload", "belt_speed", "ours", "paper"), POINTS)
def test_critical_stiffness_is_within_eight_percent_of_the_paper(preload, belt_speed, ours, paper):
    assert critical_pad_stiffness(at(preload, belt_speed)) == pytest.approx(paper, rel=0.08)


@pytest.mark.parametrize("linear", [True, False], ids=["linear model", "exact Jacobian"])
@pytest.mark.parametrize(("preload", "belt_speed", "ours", "paper"), POINTS)
def test_eigenvalues_are_stable_just_outside_the_band_and_grow_just_inside(preload, belt_speed, ours, paper, linear):
    # The linear model's own edges are met to 1e-9. The exact equilibrium and geometry shift them by about r/L,
    # 1e-4 at most here: 0.1 % is enough for both.
    p = at(preload, belt_speed)
    lower, upper = stability_band(p)
    for margin in (1e-3, 1e-9) if linear else (1e-3,):
        for k, unstable in (
            (lower * (1.0 - margin), False),
            (lower * (1.0 + margin), True),
            (upper * (1.0 - margin), True),
            (upper * (1.0 + margin), False),
        ):
            assert grows(p.replace(pad_stiffness=k), linear) is unstable, (k, lower, upper)


@pytest.mark.parametrize(("preload", "belt_speed", "ours", "paper"), POINTS)
def test_a_scan_of_an_independent_linear_model_finds_growth_in_the_band_and_nowhere_else(
    preload, belt_speed, ours, paper
):
    p = at(preload, belt_speed)
    lower, upper = stability_band(p)
    k = np.geomspace(1e5, 1e10, 20_000)
    np.testing.assert_array_equal(reference.growth(p, k) > ROUNDING, (k > lower) & (k < upper))


@pytest.mark.parametrize(("stiffness", "ours", "paper"), [pytest.param(*row, id=f"k{row[0]:g}") for row in FREQUENCIES])
def test_unstable_frequency_has_the_calibrated_value(stiffness, ours, paper):
    p = at(300.0, 1.0, pad_stiffness=stiffness)
    # The table is printed to 1 Hz.
    assert squeal_frequency(eigenvalues(p, linear=True)) == pytest.approx(ours, abs=0.5)
    assert squeal_frequency(eigenvalues(p)) == pytest.approx(ours, abs=0.6)
    assert squeal_frequency(eigenvalues(p)) == pytest.approx(paper, rel=0.22)


@pytest.mark.parametrize(
    ("preload", "belt_speed", "unstable"),
    [(50.0, 1.0, [6e7]), (200.0, 1.0, [4e7, 6e7])],
)
def test_the_paper_s_own_stiffnesses_squeal_where_it_says(preload, belt_speed, unstable):
    p = at(preload, belt_speed)
    assert [k for k in (2e7, 4e7, 6e7) if grows(p.replace(pad_stiffness=k), linear=False)] == unstable


@pytest.mark.parametrize(
    ("stiffness", "belt_speed", "preload"),
    [(2e7, 1.0, 241.0), (4e7, 1.0, 74.0), (4e7, 4.0, 417.0), (6e7, 1.0, 30.0), (6e7, 4.0, 104.0)],
)
def test_a_stiffness_becomes_unstable_at_the_calibrated_preload(stiffness, belt_speed, preload):
    # Preloads are printed to 1 N.
    assert critical_pad_stiffness(at(preload - 1.0, belt_speed)) > stiffness
    assert critical_pad_stiffness(at(preload + 1.0, belt_speed)) < stiffness


@pytest.mark.parametrize(("damping_x", "damping_y"), [(0.0, 0.0), (20.0, 20.0), (1e-3, 5.0), (300.0, 20.0)])
@pytest.mark.parametrize(("preload", "belt_speed"), [(50.0, 1.0), (300.0, 1.0), (300.0, 4.0), (2000.0, 0.0)])
def test_the_rig_as_printed_has_no_instability_at_any_stiffness(preload, belt_speed, damping_x, damping_y):
    p = RigParameters.preset("yavuz_sen_2023_as_printed").replace(
        preload=preload, belt_speed=belt_speed, damping_x=damping_x, damping_y=damping_y
    )
    assert math.isnan(critical_pad_stiffness(p))
    assert all(math.isnan(bound) for bound in stability_band(p))
    # Not that none is reported: none is there. K is triangular, yet its two eigenvalues coincide near
    # k_c - k3 - k4, where rounding may split them: no more than its square root, below 1e-7.
    k = np.concatenate([[0.0], np.geomspace(1e3, 1e10, 20_000)])
    assert reference.growth(p, k).max() < 1e-7
    assert not any(grows(p.replace(pad_stiffness=value), linear=True) for value in k[::100])


def test_the_report_of_a_squealing_rig_is_its_eigenvalues_and_its_band():
    p = at(300.0, 1.0, pad_stiffness=6e7)
    report = stability_report(p)
    leading = eigenvalues(p)[np.argmax(eigenvalues(p).real)]
    assert report.unstable
    assert report.growth_rate == leading.real > 0.0
    assert report.damping_ratio == pytest.approx(-leading.real / abs(leading), rel=1e-12)
    assert report.squeal_frequency == pytest.approx(abs(leading.imag) / (2.0 * math.pi), rel=1e-12)
    assert (report.critical_pad_stiffness, report.upper_pad_stiffness) == stability_band(p)
    assert report.margin == pytest.approx(1.0 - 6e7 / critical_pad_stiffness(p), rel=1e-12)


def test_the_report_of_a_quiet_rig_has_a_margin_and_no_squeal_frequency():
    report = stability_report(at(50.0, 1.0, pad_stiffness=4e7))
    assert not report.unstable
    assert math.isnan(report.squeal_frequency)
    assert report.margin == pytest.approx(1.0 - 4e7 / report.critical_pad_stiffness, rel=1e-12)
    assert report.margin > 0.0


def test_the_report_of_the_rig_as_printed_has_no_margin():
    report = stability_report(RigParameters.preset("yavuz_sen_2023_as_printed"))
    assert not report.unstable
    assert math.isnan(report.margin)


def hoffmann(friction):
    """Hoffmann's minimal model of mode coupling on the rig: both arms at 135 degrees, so that K_ab = -(k1 + k2)/2.

    With k1 = k2 = 1, k3 + k4 = 1, k_c = 1, m = 1 it is K = [[2, D - 1], [-1, 2]]: s^2 = -2 +- sqrt(1 - D).
    Hoffmann, Fischer, Allgaier, Gaul, A minimal model for studying properties of the mode-coupling type instability
    in friction induced oscillations, Mech. Res. Commun. 29 (2002) 197-205.
    """
    return RigParameters(
        mass=1.0,
        k1=1.0,
        k2=1.0,
        k3=0.5,
        k4=0.5,
        contact_stiffness=1.0,
        arm_angle_1=0.75 * math.pi,
        arm_angle_2=0.75 * math.pi,
        mu0=friction,
        mu_speed=0.0,
        mu_preload=0.0,
        mu_speed_preload=0.0,
    )


@pytest.mark.parametrize("friction", [0.0, 0.3, 0.999, 1.001, 2.0, 5.0])
def test_hoffmann_s_minimal_model_has_its_closed_form_eigenvalues(friction):
    squares = -2.0 + np.array([1.0, -1.0]) * np.emath.sqrt(1.0 - friction)
    expected = np.concatenate([np.sqrt(squares.astype(complex)), -np.sqrt(squares.astype(complex))])
    found = eigenvalues(hoffmann(friction), linear=True)
    # Near D = 1 the eigenvalues all but coincide, and rounding is magnified by 1/sqrt(|1 - D|).
    for value in expected:
        assert np.abs(found - value).min() < 1e-13
    assert grows(hoffmann(friction), linear=True) is (friction > 1.0)


def test_hoffmann_s_minimal_model_at_twice_the_critical_friction_has_the_published_eigenvalue():
    value = eigenvalues(hoffmann(2.0), linear=True)[0]
    assert (value.real, abs(value.imag)) == pytest.approx((0.343561, 1.455347), abs=5e-7)


def test_hoffmann_s_minimal_model_is_critical_at_friction_one():
    # k_c = k3 + k4: the band reaches from 0 to mu k_c in the mean arm stiffness, which is 1 here.
    assert stability_band(hoffmann(1.0)) == pytest.approx((0.0, 1.0), abs=1e-12)
