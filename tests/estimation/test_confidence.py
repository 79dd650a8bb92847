"""Intervals: coverage by Monte Carlo, and against closed forms."""

import dataclasses
import math

import numpy as np
import pytest

from squeal_rig.estimation.confidence import (
    PointMeans,
    correlation_factor,
    half_width,
    mean_with_error,
    systematic_shifts,
)
from squeal_rig.estimation.regression import FrictionRegression
from squeal_rig.instruments.description import RigDescription
from squeal_rig.model import RigParameters, friction_coefficient
from squeal_rig.model.core.law import COEFFICIENTS

RIG = RigDescription(
    RigParameters(),
    noise={"motor_torque": 0.1, "preload": 0.1},
    gain_error={"motor_torque": 0.01, "arm_left": 0.002, "arm_right": 0.002, "preload": 0.003, "belt_speed": 0.001},
    offset_error={"motor_torque": 0.05, "arm_left": 1.0, "preload": 0.5},
)


def test_without_bounds_the_interval_is_students():
    # t of 10 degrees of freedom at 97.5 %: 2.2281 in every table.
    assert half_width(1.0, 10.0) == pytest.approx(2.2281, abs=1e-4)


def test_one_bound_alone_is_uniform_and_two_equal_ones_triangular():
    assert half_width(0.0, 1.0, [2.0]) == pytest.approx(1.9, abs=0.01)
    # |u1 + u2| <= h has the probability 1 - (2 - h)^2/4 for bounds of one.
    assert half_width(0.0, 1.0, [1.0, 1.0]) == pytest.approx(2.0 - math.sqrt(0.2), abs=0.01)


def test_many_bounds_are_as_good_as_normal():
    assert half_width(0.0, 1.0, [1.0] * 48) == pytest.approx(1.96 * 4.0, rel=0.02)


@pytest.mark.parametrize(("alike", "lowest"), [(0.0, 0.93), (0.5, 0.88)])
def test_means_of_alike_values_are_covered(alike: float, lowest: float):
    """First-order autoregression of 60 values; a short record underrates its likeness: 0.90 instead of 0.95 at 0.5."""
    rng, inside, trials = np.random.default_rng(1), 0, 2000
    for _ in range(trials):
        white = rng.normal(size=80)
        values = np.empty(80)
        values[0] = white[0] / math.sqrt(1.0 - alike**2)
        for i in range(1, 80):
            values[i] = alike * values[i - 1] + white[i]
        found = mean_with_error(values[20:])
        inside += abs(found.mean) <= half_width(found.standard_error, found.freedom)
    assert lowest < inside / trials < 0.98


def test_the_factor_of_an_autoregression_is_the_known_one():
    rng, values = np.random.default_rng(2), np.zeros(200_000)
    white = rng.normal(size=len(values))
    for i in range(1, len(values)):
        values[i] = 0.6 * values[i - 1] + white[i]
    assert correlation_factor(values - values.mean()) == pytest.approx((1 + 0.6) / (1 - 0.6), rel=0.05)


def points() -> PointMeans:
    preload, speed = np.array([50.0, 50.0, 200.0, 200.0, 125.0]), np.array([1.0, 4.0, 1.0, 4.0, 2.0])
    mu = np.array([friction_coefficient(RIG.parameters, v, f) for v, f in zip(speed, preload, strict=True)])
    return PointMeans(mu, speed, preload, 60.0 + preload, 50.0 + preload)


def test_each_shift_is_what_the_error_does_to_the_ratio():
    p, means = RIG.parameters, points()
    s1, s2 = math.sin(p.arm_angle_1), math.sin(p.arm_angle_2)
    normal = means.arm_left * s1 + means.arm_right * s2 + means.preload * (s1 + s2)
    torque = means.mu * normal * RIG.drum_radius
    shifts = {shift.name: shift for shift in systematic_shifts(RIG, means)}
    assert len(shifts) == 8
    for name, shift in shifts.items():
        kind, _, channel = name.partition(" of ")
        read = {"motor_torque": torque, **{c: getattr(means, c) for c in ("arm_left", "arm_right", "preload")}}
        if channel == "belt_speed":
            assert (shift.mu == 0.0).all()
            assert shift.belt_speed == pytest.approx(0.001 * means.belt_speed)
            continue
        h = 1e-6
        read[channel] = read[channel] + h * (
            RIG.gain_error[channel] * read[channel] if kind == "gain" else RIG.offset_error[channel]
        )
        n = read["arm_left"] * s1 + read["arm_right"] * s2 + read["preload"] * (s1 + s2)
        assert shift.mu == pytest.approx((read["motor_torque"] / RIG.drum_radius / n - means.mu) / h, rel=1e-4)


@pytest.mark.parametrize("count", [4, 9])
def test_scatter_of_the_coefficients_is_covered(count: int):
    """With points beyond the coefficients the points tell it, with just as many the windows within them."""
    p, rng, trials = RIG.parameters, np.random.default_rng(3), 400
    layout = [
        (v, f)
        for v in np.linspace(1.0, 4.0, round(math.sqrt(count)))
        for f in np.linspace(50.0, 200.0, round(math.sqrt(count)))
    ]
    inside = dict.fromkeys(COEFFICIENTS, 0)
    for _ in range(trials):
        regression = FrictionRegression()
        for v, f in layout:
            for mu in friction_coefficient(p, v, f) + 0.01 * rng.normal(size=6):
                regression.add(v, f, mu)
        model = regression.fit()
        for name in COEFFICIENTS:
            inside[name] += abs(model.coefficients[name] - getattr(p, name)) <= model.half_widths[name]
    # 0.95 and five standard deviations of a binomial of 400.
    assert all(0.895 < n / trials <= 1.0 for n in inside.values()), inside


def test_a_sensitivity_error_widens_the_interval_and_more_windows_do_not_narrow_it():
    p = RIG.parameters
    quiet = dataclasses.replace(RIG, noise={"preload": 1e-6}, offset_error={}, gain_error={"motor_torque": 0.01})
    widths = []
    for windows in (2, 50):
        regression = FrictionRegression()
        regression.take_rig(quiet, 10240, 10.0)
        for v in (1.0, 2.0, 4.0):
            for f in (50.0, 200.0):
                for _ in range(windows):
                    regression.add(v, f, friction_coefficient(p, v, f), (60.0, 60.0))
        widths.append(regression.fit().half_widths)
    for name in COEFFICIENTS:
        # One uniform error: 95 % of its bound, which is a share of the coefficient.
        assert widths[0][name] == pytest.approx(0.95 * 0.01 * abs(getattr(p, name)), rel=0.01)
        assert widths[1][name] == pytest.approx(widths[0][name], rel=1e-3)


@pytest.mark.parametrize("n", [4, 20, 60])
def test_the_factor_of_a_short_record_is_that_of_the_formula(n: int):
    """Each lag with the mean of its n - k products, of which the formula takes the share 1 - k/n, once."""
    values = np.arange(n, dtype=float)
    residuals = values - values.mean()
    known, power = 1.0, float(residuals @ residuals)
    for lag in range(1, n // 3 + 1):
        pairs = residuals[lag:] @ residuals[:-lag]
        if pairs <= 0.0:
            break
        rho = pairs / (n - lag) / (power / n)
        known += 2.0 * (1.0 - lag / n) * rho
    assert correlation_factor(residuals) == pytest.approx(known, rel=1e-12)


def test_a_point_of_few_windows_counts_little_whichever_channel_is_noisy():
    """Four points, one of them seen twice: its own scatter, not that of a hundred windows, is in the coefficients."""
    p, rng = RIG.parameters, np.random.default_rng(5)
    rig = dataclasses.replace(RIG, noise={"motor_torque": 0.1}, offset_error={}, gain_error={})
    layout, inside, trials = [(1.0, 50.0), (1.0, 200.0), (4.0, 50.0), (4.0, 200.0)], 0, 300
    for _ in range(trials):
        regression = FrictionRegression()
        regression.take_rig(rig, 5120, 1.0)
        for place, (v, f) in enumerate(layout):
            for mu in friction_coefficient(p, v, f) + 0.01 * rng.normal(size=2 if place == 3 else 100):
                regression.add(v, f, mu)
        model = regression.fit()
        inside += (
            abs(model.coefficients["mu_speed_preload"] - p.mu_speed_preload) <= model.half_widths["mu_speed_preload"]
        )
    assert 0.88 < inside / trials < 0.99
