"""What the estimator publishes while the rig slides steadily, squeals and leaves its belt."""

import numpy as np
import pytest

from squeal_rig.model import stability_band
from squeal_rig.model.core.law import friction_basis, friction_coefficient
from tests.graph.processes import parameters

pytest.importorskip("rclpy")

# All below the critical stiffness of 4e7 N/m, so that sliding stays steady.
STEADY_POINTS = [(20.0, 0.5), (20.0, 5.0), (50.0, 1.0), (50.0, 2.0), (80.0, 2.0)]
# Asked for; with ideal instruments at rest both estimates are limited by rounding alone.
_LAW = 1e-3
# In squeal a window cuts the last period of the motion anywhere: 0.2 s hold some 300 periods.
_SQUEAL = 0.03  # what a window of 0.2 s leaves at its two ends: 1.5 % was seen
_WINDOW = 0.2


def _windows_from(bench, seq, count, valid_share=0.0):
    """The first windows that begin at a sample number or later, with their truth and that share of valid samples.

    A window lacks what a busy machine lost on the way to the estimator.
    """
    rate = 1.0 / (bench.daq[-1].samples["t"][1] - bench.daq[-1].samples["t"][0])

    def found():
        begun = (w.samples[0] for w in bench.windows if round(w.samples["t_start"][0] * rate) >= seq)
        windows = [w for w in begun if np.isfinite(w["mu_true"]) and w["valid_share"] >= valid_share]
        return windows[:count] if len(windows) >= count else None

    return np.array(bench.observer.wait_for(found, "windows"))


@pytest.mark.parametrize(("preload", "belt_speed"), STEADY_POINTS)
def test_in_steady_sliding_the_estimates_meet_the_law(bench, preload, belt_speed):
    bench.rest(preload=preload, belt_speed=belt_speed)
    p = bench.observer.description().parameters
    lower, upper = stability_band(p)
    assert not lower < p.k1 < upper
    law = friction_coefficient(p, speed=belt_speed, preload=preload)
    (window,) = _windows_from(bench, int(bench.daq[-1].samples["seq"][0]), 1, valid_share=1.0)
    assert (window["preload"], window["belt_speed"]) == pytest.approx((preload, belt_speed), rel=1e-12)
    assert window["valid_share"] == 1.0
    assert window["mu"] == pytest.approx(law, rel=_LAW)
    assert window["mu_ratio_of_means"] == pytest.approx(law, rel=_LAW)
    assert window["mu_true"] == pytest.approx(law, rel=1e-12)
    assert window["difference"] == window["mu"] - window["mu_true"]
    assert window["t_end"] - window["t_start"] == pytest.approx(_WINDOW)


def _squeal(bench):
    """The rig in squeal at 300 N; returns the number of a sample after which it has settled there."""
    bench.rest(preload=300.0)
    assert bench.observer.trigger("impact")[0]
    bench.observer.wait_for(lambda: np.any(bench.truth[-1].samples["normal_force"] == 0.0), "contact loss")
    return int(bench.daq[-1].samples["seq"][-1])


def test_in_squeal_a_window_holds_both_estimates_the_truth_and_the_difference(bench):
    begin = _squeal(bench)
    windows = _windows_from(bench, begin, 3)
    for name in windows.dtype.names:
        assert np.all(np.isfinite(windows[name])), name
    law = friction_coefficient(bench.observer.description().parameters)
    np.testing.assert_allclose(windows["mu_true"], law, rtol=1e-12)
    np.testing.assert_allclose(windows["mu_ratio_of_means"], windows["mu_true"], rtol=_SQUEAL)
    np.testing.assert_array_equal(windows["difference"], windows["mu"] - windows["mu_true"])
    # The pad leaves the belt, where Eq. (2.1) divides by what is not the normal force: its mean is far off.
    assert np.all(np.abs(windows["difference"]) > 0.1)


@pytest.mark.slow
def test_samples_without_a_safe_denominator_are_marked_invalid_and_never_nan(bench):
    # A second estimator that asks for more than squeal always has; the first takes what there is.
    names = {"__node": "strict_estimator", "friction/samples": "strict/samples", "friction/windows": "strict/windows"}
    renamed = [word for name, new in names.items() for word in ("-r", f"{name}:={new}")]
    begin = _squeal(bench)
    strict = bench.processes.node("friction_estimator", *parameters(minimum_normal_load=600.0), *renamed)
    blocks = bench.observer.follow_samples("friction/samples")
    strict_blocks = bench.observer.follow_samples("strict/samples")
    try:
        bench.observer.wait_for(
            lambda: min(len(blocks), len(strict_blocks)) >= 40, "40 blocks of each of the two estimators"
        )
    finally:
        assert strict.end()[0] == 0
    for found in (blocks, strict_blocks):
        samples = np.concatenate([block.samples for block in found])
        samples = samples[samples["seq"] > begin]  # the estimator may still be at a block before
        assert np.all(np.isfinite(samples["mu"]))
        assert np.all(np.isin(samples["valid"], (0, 1)))
        assert np.all(samples["mu"][samples["valid"] == 0] == 0.0)
    # `samples` is the strict estimator's from here on; its marks are those of Eq. (2.1) on the recorded channels.
    assert 0.05 < np.mean(samples["valid"]) < 0.95
    rig = bench.observer.description()
    daq = np.concatenate([block.samples for block in bench.daq])
    daq = daq[np.isin(daq["seq"], samples["seq"])]
    samples = samples[np.isin(samples["seq"], daq["seq"])]
    sines = np.sin(rig.parameters.arm_angle_1), np.sin(rig.parameters.arm_angle_2)
    denominator = daq["arm_left"] * sines[0] + daq["arm_right"] * sines[1] + daq["preload"] * sum(sines)
    np.testing.assert_array_equal(samples["valid"] == 1, denominator >= 600.0)
    good = samples["valid"] == 1
    expected = daq["motor_torque"][good] / rig.drum_radius / denominator[good]
    np.testing.assert_allclose(samples["mu"][good], expected, rtol=1e-12)


@pytest.mark.slow
def test_a_window_without_a_valid_sample_has_no_mu_and_says_so(bench):
    names = {"__node": "deaf_estimator", "friction/samples": "deaf/samples", "friction/windows": "deaf/windows"}
    renamed = [word for name, new in names.items() for word in ("-r", f"{name}:={new}")]
    bench.rest()
    deaf = bench.processes.node("friction_estimator", *parameters(minimum_normal_load=1e6), *renamed)
    windows = bench.observer.follow_samples("deaf/windows")
    samples = bench.observer.follow_samples("deaf/samples")
    try:
        # It joins a running rig: the truth of the first window may have come before it listened to that.
        bench.observer.wait_for(lambda: any(w.samples["mu_true"][0] > 0.0 for w in windows), "a window with its truth")
        bench.observer.wait_for(lambda: samples, "samples")
    finally:
        assert deaf.end()[0] == 0
    window = next(w.samples[0] for w in windows if w.samples["mu_true"][0] > 0.0)
    assert window["valid_share"] == 0.0
    assert np.isnan([window["mu"], window["mu_ratio_of_means"], window["difference"]]).all()
    assert not samples[0].samples["valid"].any()
    assert np.all(samples[0].samples["mu"] == 0.0)


@pytest.mark.slow
def test_five_operating_points_give_the_law_back(bench):
    # An estimator of its own, begun at rest: the other one has met squeal, whose windows are less exact.
    names = {
        "__node": "fresh_estimator",
        "friction/samples": "fresh/friction/samples",
        "friction/windows": "fresh/friction/windows",
        "friction/model": "fresh/friction/model",
    }
    renamed = [word for name, new in names.items() for word in ("-r", f"{name}:={new}")]
    preload, speed = STEADY_POINTS[0]
    bench.rest(preload=preload, belt_speed=speed)
    fresh = bench.processes.node("friction_estimator", *parameters(window=_WINDOW), *renamed)
    models = bench.observer.follow("fresh/friction/model")
    windows = bench.observer.follow_samples("fresh/friction/windows")
    try:
        for preload, speed in STEADY_POINTS:
            bench.rest(preload=preload, belt_speed=speed)
            windows.clear()

            def whole(point=(preload, speed)):
                points = [(float(w.samples["preload"][0]), float(w.samples["belt_speed"][0])) for w in windows]
                return sum(np.allclose(there, point, rtol=1e-9) for there in points) >= 3

            bench.observer.wait_for(whole, "three windows")
        bench.observer.wait_for(lambda: models and models[-1].data[-1] >= 5, "a fit over five operating points")
    finally:
        assert fresh.end()[0] == 0
    p = bench.observer.description().parameters
    law = [p.mu0, p.mu_speed, p.mu_preload, p.mu_speed_preload]
    preload, speed = np.transpose(STEADY_POINTS)
    # What the coefficients are off by at most where every window is off by `_LAW`, as while the pad still rings.
    basis = friction_basis(speed, preload)
    bound = np.abs(np.linalg.pinv(basis)) @ (_LAW * (basis @ law))
    off = np.abs(models[-1].data[:4] - np.array(law))
    assert (off < bound).all(), (off, bound)
    assert models[-1].data[4] < 1e-3
