"""The differentiator against exact derivatives, its stated noise gain, and what the correction gains."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from squeal_rig.estimation.differentiator import PASS_BAND, differentiator
from squeal_rig.estimation.friction import FrictionEstimator, corrected_ratio_of_means
from squeal_rig.estimation.settings import FrictionSettings
from squeal_rig.instruments.acquisition import Acquisition
from squeal_rig.instruments.description import RigDescription
from squeal_rig.instruments.means import contact_forces
from squeal_rig.instruments.settings import RigSettings
from squeal_rig.instruments.virtual import VirtualRig
from squeal_rig.model import RigParameters

RATE = 51200.0
D = differentiator(RATE)
DAMPED = RigParameters().replace(damping_x=20.0, damping_y=20.0)


@given(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3), st.floats(-1e3, 1e3))
def test_a_parabola_is_differentiated_exactly(a: float, b: float, c: float):
    t = np.arange(100) / RATE
    slope, curvature = D(a + b * t + c * t**2)
    inner = t[D.reach : -D.reach]
    # Rounding of 1e-16 of y is divided by dt^2.
    assert slope == pytest.approx(b + 2.0 * c * inner, abs=1e-9 * (abs(a) + abs(b) + abs(c) + 1.0))
    assert curvature == pytest.approx(np.full(len(inner), 2.0 * c), abs=1e-4 * (abs(a) + abs(b) + abs(c) + 1.0))


@pytest.mark.parametrize("frequency", [100.0, 1000.0, 3000.0, 5000.0])
def test_sines_of_the_pass_band_are_differentiated_within_half_a_percent(frequency: float):
    w = 2.0 * np.pi * frequency
    t = np.arange(2000) / RATE
    slope, curvature = D(np.sin(w * t))
    inner = t[D.reach : -D.reach]
    assert slope == pytest.approx(w * np.cos(w * inner), abs=5e-3 * w)
    assert curvature == pytest.approx(-(w**2) * np.sin(w * inner), abs=5e-3 * w**2)
    assert D.response(np.array([frequency]))[1][0] == pytest.approx(1.0, abs=5e-3)


def test_half_of_the_amplitude_is_left_at_the_edge_and_nothing_far_above():
    response = D.response(np.array([PASS_BAND, 2.0 * PASS_BAND]))[1]
    assert response[0] == pytest.approx(0.5, abs=0.02)
    assert abs(response[1]) < 1e-2


def test_the_noise_gain_is_that_of_white_noise():
    noise = np.random.default_rng(1).normal(size=400_000)
    slope, curvature = D(noise)
    assert np.std(11.5 * curvature + 20.0 * slope) == pytest.approx(D.noise_gain(11.5, 20.0), rel=0.01)


def test_a_low_sample_rate_has_a_lower_edge():
    slow = differentiator(1000.0)
    assert slow.response(np.array([100.0]))[0][0] == pytest.approx(1.0, abs=5e-3)


def squeal(seconds: float) -> list:
    p = DAMPED.replace(preload=300.0)
    rig = Acquisition(VirtualRig(), p, RigSettings(impact_impulse=1e-3))
    rig.start(0)
    rig.impact()
    return [rig.next_block() for _ in range(round(seconds * 100))]


@pytest.fixture(scope="module")
def blocks() -> list:
    return squeal(2.6)


def test_in_squeal_the_correction_takes_away_what_the_windows_ends_leave(blocks: list):
    p = DAMPED.replace(preload=300.0)
    estimator = FrictionEstimator(RigDescription(p), FrictionSettings())
    windows = []
    for block in blocks:
        windows += estimator.add_samples(block.stamp, block.daq)[2] + estimator.add_truth(block.truth)
    settled = [window.values for window in windows[-4:]]
    plain, corrected = (
        max(abs(w[name] / w["mu_true"] - 1.0) for w in settled) for name in ("mu_ratio_of_means", "mu_corrected")
    )
    assert corrected < 1e-4  # 5e-5 of it is the arms' rotation
    assert plain > 10.0 * corrected


def test_the_windows_correction_is_that_of_the_contact_force(blocks: list):
    """Against the truth: the sum of N itself, by the trapezoidal rule over the same samples."""
    p = DAMPED.replace(preload=300.0)
    daq, truth = (np.concatenate([getattr(b, name) for b in blocks[-20:]]) for name in ("daq", "truth"))
    tangential, normal = contact_forces(daq, p, 0.05)
    found = corrected_ratio_of_means(tangential, normal, daq["y"], D, p.mass, p.damping_y)
    inner = slice(D.reach, len(daq) - D.reach)
    weight = np.ones(len(daq) - 2 * D.reach)
    weight[[0, -1]] = 0.5
    exact = (truth["tangential_force"][inner] @ weight) / (truth["normal_force"][inner] @ weight)
    assert found == pytest.approx(exact, rel=1e-4)


def test_sample_by_sample_the_contact_force_is_met(blocks: list):
    p = DAMPED.replace(preload=300.0)
    daq, truth = (np.concatenate([getattr(b, name) for b in blocks[-20:]]) for name in ("daq", "truth"))
    _, normal = contact_forces(daq, p, 0.05)
    slope, curvature = D(np.ascontiguousarray(daq["y"]))
    inner = slice(D.reach, len(daq) - D.reach)
    found = normal[inner] + p.mass * curvature + p.damping_y * slope
    true = truth["normal_force"][inner]
    # The corners at take-off and landing are above the pass band: 2 % of the force's RMS was seen.
    assert np.std(found - true) < 0.03 * np.std(true)
    assert np.std(normal[inner] - true) > 0.5 * np.std(true)


def test_a_window_with_a_gap_or_too_short_has_no_correction(blocks: list):
    p = DAMPED.replace(preload=300.0)
    estimator = FrictionEstimator(RigDescription(p, publishes_truth=False), FrictionSettings())
    windows = [w for b in blocks[:5] + blocks[7:40] for w in estimator.add_samples(b.stamp, b.daq)[2]]
    assert [np.isnan(w.values["mu_corrected"]) for w in windows] == [True, False]
    assert [np.isnan(w.values["mu_standard_error"]) for w in windows] == [True, False]
    short = FrictionEstimator(RigDescription(p, publishes_truth=False), FrictionSettings(window=0.001))
    windows = [w for b in blocks[:2] for w in short.add_samples(b.stamp, b.daq)[2]]
    assert all(np.isnan(w.values["mu_corrected"]) for w in windows)
