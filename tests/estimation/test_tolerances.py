"""Tolerances that come from the noise keep their false-alarm probabilities: Monte Carlo against the binomial."""

import dataclasses
import math
from statistics import NormalDist

import numpy as np
import pytest

from squeal_rig.estimation.friction import FrictionEstimator, sample_friction
from squeal_rig.estimation.regression import FrictionRegression
from squeal_rig.estimation.settings import FrictionSettings, SquealSettings
from squeal_rig.estimation.spectra import amplitude_spectrum, band_rms
from squeal_rig.estimation.squeal import SquealDetector
from squeal_rig.estimation.stability_follower import InForce, StabilityFollower
from squeal_rig.estimation.tolerances import (
    PointTolerance,
    band_noise,
    denominator_noise,
    least_valid_share,
    measured_point,
    noise_level,
    point_tolerance,
    set_point_tolerance,
    standard_error,
)
from squeal_rig.instruments.channels import DAQ_RECORD
from squeal_rig.instruments.data_sheets import load_data_sheets
from squeal_rig.instruments.description import RigDescription
from squeal_rig.instruments.settings import RigSettings
from squeal_rig.instruments.tolerances import promises
from squeal_rig.model import RigParameters

RATE = 51200
NOISY = RigDescription(RigParameters(), noise={"preload": 0.3, "belt_speed": 1e-3, "x": 2e-7, "arm_left": 2.0})
# Probability with which a sound implementation fails a binomial bound below.
UNLUCKY = 1e-6


def at_most(probability: float, trials: int) -> float:
    """Count that a binomial of that probability exceeds with `UNLUCKY` (normal approximation, one for the step)."""
    z = -NormalDist().inv_cdf(UNLUCKY)
    return trials * probability + z * math.sqrt(trials * probability * (1.0 - probability)) + 1.0


def at_least(probability: float, trials: int) -> float:
    return 2.0 * trials * probability - at_most(probability, trials)


@pytest.mark.parametrize("correlation", [0.0, 4e-4])
def test_means_of_one_operating_point_differ_by_more_as_rarely_as_stated(correlation: float):
    rig = dataclasses.replace(NOISY, correlation=dict.fromkeys(NOISY.noise, correlation))
    samples, trials, probability = 512, 4000, 0.05
    tolerance = point_tolerance(rig, samples, probability=probability)
    rng = np.random.default_rng(1)
    # Moving averages of white noise: alike over their length, and of the correlation that they say.
    length = max(1, round(correlation * RATE))
    split = np.zeros(trials, dtype=bool)
    for channel, allowed in (("preload", tolerance.preload), ("belt_speed", tolerance.belt_speed)):
        white = rng.normal(size=(trials, 2, samples + length - 1))
        sums = np.cumsum(np.pad(white, ((0, 0), (0, 0), (1, 0))), axis=2)
        noise = rig.noise[channel] * (sums[:, :, length:] - sums[:, :, :-length]) / math.sqrt(length)
        means = noise.mean(axis=2)
        split |= np.abs(means[:, 0] - means[:, 1]) > allowed
    assert at_least(probability, trials) * 0.8 <= split.sum() <= at_most(probability, trials)


def test_a_ripple_alone_never_splits_an_operating_point():
    rig = RigDescription(RigParameters(), ripple={"preload": 1.0})
    t = np.arange(512) / RATE
    tolerance = point_tolerance(rig, 512)
    means = [np.mean(50.0 + np.sin(2 * np.pi * 40.0 * t + phase)) for phase in np.linspace(0.0, 6.2, 60)]
    assert 1.0 < max(means) - min(means) <= tolerance.preload


def test_without_noise_every_tolerance_is_zero():
    rig = RigDescription(RigParameters())
    assert point_tolerance(rig, 512) == set_point_tolerance(rig, 512) == PointTolerance()
    assert point_tolerance(rig, 512).exact
    assert noise_level(rig, SquealSettings()) == 0.0
    assert least_valid_share(rig, 100.0, 10.0, 512) == 1.0


def test_noise_of_a_constant_offset_does_not_average_out():
    rig = dataclasses.replace(NOISY, correlation={"preload": 10.0})
    assert standard_error(rig, "preload", 512) == rig.noise["preload"]


@pytest.mark.parametrize("probability", [0.05, 0.01])
def test_noise_alone_exceeds_its_level_as_rarely_as_stated(probability: float):
    settings, trials = SquealSettings(), 4000
    threshold = noise_level(NOISY, settings, probability)
    rng = np.random.default_rng(2)
    above = 0
    for _ in range(trials):
        signal = rng.normal(scale=NOISY.noise["x"], size=round(settings.window * RATE))
        rms = band_rms(*amplitude_spectrum(signal, RATE), settings.band_low, settings.band_high)
        above += rms**2 > threshold
    # The number of alike lines is an approximation: half of the probability is asked for from below.
    assert 0.5 * at_least(probability, trials) <= above <= at_most(probability, trials)


def test_the_floor_in_the_band_is_that_of_a_long_record():
    signal = np.random.default_rng(3).normal(scale=NOISY.noise["x"], size=20 * RATE)
    found = band_rms(*amplitude_spectrum(signal, RATE), 500.0, 5000.0) ** 2
    assert found == pytest.approx(band_noise(NOISY, 500.0, 5000.0), rel=0.02)  # scatter of 90000 lines: 0.5 %


def detected(noise: float, seconds: float, signal: float = 0.0, known: bool = True) -> list[bool]:
    """States of a detector that sees noise [m] and a sine at 1 kHz [m RMS]."""
    rig = RigDescription(RigParameters(), noise={"x": noise})
    detector = SquealDetector(RATE, SquealSettings())
    if known:
        detector.take_rig(rig)
    rng, states = np.random.default_rng(4), []
    for start in range(0, round(seconds * RATE), 512):
        daq = np.zeros(512, DAQ_RECORD)
        t = (start + np.arange(512)) / RATE
        daq["x"] = rng.normal(scale=noise, size=512) + signal * math.sqrt(2.0) * np.sin(2.0 * np.pi * 1000.0 * t)
        daq["seq"] = start + np.arange(512)
        states += [state.detected for state in detector.add_samples(0, daq)]
    return states


def test_noise_above_the_level_of_squeal_is_called_quiet_and_squeal_in_it_is_heard():
    noise = 1.2e-6  # 0.5 um RMS in the band, where squeal begins at 0.25 um
    assert all(detected(noise, 2.0, known=False))
    assert not any(detected(noise, 10.0))
    assert all(detected(noise, 2.0, signal=1e-6))


def test_a_detector_without_noise_has_the_levels_of_its_settings():
    settings = SquealSettings()
    detector = SquealDetector(RATE, settings)
    detector.take_rig(RigDescription(RigParameters()))
    assert (detector.on_level, detector.off_level) == (settings.on_level, settings.off_level)
    detector.take_rig(NOISY)
    assert detector.off_level > settings.off_level
    assert detector.on_level > detector.off_level


def test_noise_makes_samples_invalid_no_more_often_than_stated():
    minimum, normal, samples, probability, trials = 10.0, 12.0, 2000, 0.05, 3000
    share = least_valid_share(NOISY, normal, minimum, samples, probability)
    rng = np.random.default_rng(5)
    refused = 0
    for _ in range(trials):
        noisy = normal + denominator_noise(NOISY) * rng.normal(size=samples)
        refused += sample_friction(noisy, noisy, minimum)[1].mean() < share
    assert 0.02 < 1.0 - share < 0.5
    assert refused <= at_most(probability, trials)


def daq_of(preload: float, belt_speed: float, rng: np.random.Generator, seq: int = 0) -> np.ndarray:
    daq = np.zeros(512, DAQ_RECORD)
    daq["preload"] = preload + NOISY.noise["preload"] * rng.normal(size=512)
    daq["belt_speed"] = belt_speed + NOISY.noise["belt_speed"] * rng.normal(size=512)
    daq["arm_left"] = daq["arm_right"] = 60.0
    daq["motor_torque"] = 3.0
    daq["seq"], daq["t"] = seq + np.arange(512), np.arange(512) / RATE
    return daq


def test_a_belt_at_rest_may_be_read_as_negative():
    rng = np.random.default_rng(6)
    points = [measured_point(NOISY, daq_of(0.0, 0.0, rng)) for _ in range(20)]
    assert min(preload for preload, _ in points) == min(speed for _, speed in points) == 0.0
    # What noise does not explain is told as it is.
    assert measured_point(NOISY, daq_of(-5.0, 1.0, rng))[0] < -4.0


def test_stability_is_told_anew_when_the_point_moves_and_not_when_noise_does():
    rng, follower = np.random.default_rng(7), StabilityFollower(looks_for_hard_squeal=False)
    follower.take_rig(NOISY)
    follower.take_block(InForce.after(daq_of(50.0, 1.0, rng), NOISY))
    follower.summary(0.0, 0)
    for number in range(100):
        follower.take_block(InForce.after(daq_of(50.0, 1.0, rng), NOISY))
        assert not follower.is_due(1.0 + number)
    # A ramp slower than the tolerance per block adds up.
    due = []
    for number in range(20):
        follower.take_block(InForce.after(daq_of(50.0 + 0.02 * number, 1.0, rng), NOISY))
        due.append(follower.is_due(200.0))
    assert not due[0]
    assert due[-1]


def test_noisy_windows_of_one_point_are_one_point_of_the_regression():
    rng = np.random.default_rng(8)
    rig = dataclasses.replace(NOISY, publishes_truth=False)
    estimator, regression = FrictionEstimator(rig, FrictionSettings()), FrictionRegression()
    exact = FrictionRegression()
    regression.take_rig(rig, estimator.window_samples, 10.0)
    taken, number = [], 0
    for preload, speed in ((50.0, 1.0), (50.0, 4.0), (200.0, 1.0), (200.0, 4.0)):
        for _ in range(120):
            windows = estimator.add_samples(number * 10_000_000, daq_of(preload, speed, rng, 512 * number))[2]
            number += 1
            for window in windows:
                taken.append(regression.add_window(window.values))
                exact.add_window(window.values)
    # The first window of a point tells nobody that it is steady.
    assert taken == ([False] + [True] * 5) * 4
    model = regression.fit()
    assert model is not None
    assert model.operating_points == 4
    assert exact.fit() is None  # what a tolerance of zero makes of it
    assert all(width > 0.0 for width in model.half_widths.values())


@pytest.mark.parametrize("name", ["typical", "poor"])
def test_promises_of_data_sheets_survive_the_description(name: str):
    p, settings = RigParameters(), RigSettings(instruments=name)
    told = promises(load_data_sheets(name), p, settings)
    rig = RigDescription(p, instruments=name, **told)
    assert RigDescription.from_yaml(rig.to_yaml()) == rig
    assert rig.correlation["motor_torque"] > 100.0 / RATE  # a torque that is held and filtered
    assert rig.gain_error["arm_left"] > 0.0
    assert rig.offset_error["motor_torque"] > 0.0


def test_ideal_data_sheets_promise_nothing():
    told = promises(load_data_sheets("ideal"), RigParameters(), RigSettings())
    assert all(not mapping for mapping in told.values())
