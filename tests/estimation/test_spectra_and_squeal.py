"""Calibration of spectra, and the squeal detector's hysteresis."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from squeal_rig.errors import ParameterError
from squeal_rig.estimation.regression import FrictionRegression
from squeal_rig.estimation.settings import SquealSettings
from squeal_rig.estimation.spectra import amplitude_spectrum, band_rms, level_db, peak_frequency
from squeal_rig.estimation.squeal import SquealDetector
from squeal_rig.instruments.channels import DAQ_RECORD
from squeal_rig.model import RigParameters, friction_coefficient

RATE = 51200


def blocks(signal: np.ndarray, first_seq: int = 0) -> list:
    result = []
    for start in range(0, len(signal), 512):
        daq = np.zeros(min(512, len(signal) - start), DAQ_RECORD)
        daq["x"] = signal[start : start + 512]
        daq["t"] = np.arange(len(daq)) / RATE
        daq["seq"] = first_seq + start + np.arange(len(daq))
        result.append((round(start * 1e9 / RATE), daq))
    return result


def sine(frequency: float, amplitude: float, seconds: float = 0.1) -> np.ndarray:
    return amplitude * np.sin(2 * np.pi * frequency * np.arange(round(seconds * RATE)) / RATE) + 3e-6


def test_a_sine_on_a_bin_shows_its_amplitude():
    frequencies, amplitudes = amplitude_spectrum(sine(1000.0, 2e-6), RATE)
    assert amplitudes[frequencies == 1000.0] == pytest.approx(2e-6, rel=1e-12)


@given(st.floats(600.0, 4800.0), st.floats(1e-9, 1e-4))
def test_frequency_and_level_of_any_sine_in_the_band(frequency: float, amplitude: float):
    spectrum = amplitude_spectrum(sine(frequency, amplitude), RATE)
    # Parabola through the logarithms of a Hann line: known to be within 0.06 bins; a bin is 10 Hz here.
    assert peak_frequency(*spectrum, 500.0, 5000.0) == pytest.approx(frequency, abs=0.6)
    assert band_rms(*spectrum, 500.0, 5000.0) == pytest.approx(amplitude / math.sqrt(2.0), rel=1e-3)


def test_band_rms_equals_the_rms_of_noise_inside_the_band():
    noise = np.random.default_rng(1).normal(size=RATE)
    # White noise of RMS 1 has the share band/Nyquist of its power in the band; 1 % is the scatter of 4500 bins.
    expected = math.sqrt(4500.0 / (RATE / 2))
    assert band_rms(*amplitude_spectrum(noise, RATE), 500.0, 5000.0) == pytest.approx(expected, rel=0.03)


def test_level_of_one_micrometre_is_zero_db():
    assert level_db(1e-6) == 0.0
    assert level_db(0.0) < -300.0


def test_squeal_begins_at_the_upper_level_and_ends_at_the_lower_one():
    settings = SquealSettings()
    amplitude = {level: 1e-6 * math.sqrt(2.0) * 10.0 ** (level / 20.0) for level in (-20.0, -15.0, -10.0)}
    levels = (-20.0, -15.0, -10.0, -15.0, -20.0, -15.0)
    detector = SquealDetector(RATE, settings)
    signal = np.concatenate([sine(1000.0, amplitude[level]) for level in levels])
    states = [state for stamp, daq in blocks(signal) for state in detector.add_samples(stamp, daq)]
    assert [state.detected for state in states] == [False, False, True, True, False, False]
    assert [state.level for state in states] == pytest.approx(levels, abs=0.01)
    assert states[2].since == states[3].since == 200_000_000
    assert states[2].frequency == pytest.approx(1000.0, abs=0.1)
    assert math.isnan(states[4].frequency)
    assert states[4].since is None


def test_a_gap_starts_the_window_anew():
    detector = SquealDetector(RATE, SquealSettings())
    first, second = blocks(sine(1000.0, 1e-5, 0.05)), blocks(sine(1000.0, 1e-5, 0.1), first_seq=99999)
    states = [state for stamp, daq in first + second for state in detector.add_samples(stamp, daq)]
    assert len(states) == 1


def test_a_band_above_half_the_sample_rate_is_refused():
    with pytest.raises(ParameterError, match="band_high = 5000 Hz is above half the sample rate, 4000 Hz"):
        SquealDetector(8000, SquealSettings())


def test_off_level_above_on_level_is_refused():
    with pytest.raises(ParameterError, match="off_level = 0 dB"):
        SquealSettings(off_level=0.0, on_level=-5.0)
    with pytest.raises(ParameterError, match="band_low"):
        SquealSettings(band_low=6000.0)


def test_the_law_is_recovered_from_four_operating_points():
    p = RigParameters()
    regression = FrictionRegression()
    for number, (speed, preload) in enumerate([(1.0, 50.0), (4.0, 50.0), (1.0, 200.0), (4.0, 200.0)]):
        assert regression.fit() is None
        for _ in range(2):
            regression.add(speed, preload, friction_coefficient(p, speed, preload))
        assert (regression.fit() is not None) == (number == 3)
    model = regression.fit()
    assert model is not None
    assert model.operating_points == 4
    assert tuple(model.coefficients.values()) == pytest.approx(
        (p.mu0, p.mu_speed, p.mu_preload, p.mu_speed_preload), rel=1e-9
    )


def test_points_on_one_line_do_not_determine_the_law():
    regression = FrictionRegression()
    for preload in (50.0, 100.0, 200.0, 300.0):
        regression.add(1.0, preload, 0.3)
    assert regression.fit() is None


def test_only_steady_whole_windows_are_taken():
    regression = FrictionRegression()
    window = {"belt_speed": 1.0, "preload": 50.0, "valid_share": 1.0, "mu_ratio_of_means": 0.3}
    assert not regression.add_window(window)  # nobody knows yet whether it was steady
    assert regression.add_window(window)
    assert not regression.add_window({**window, "preload": 60.0})
    assert regression.add_window({**window, "preload": 60.0})
    assert not regression.add_window({**window, "preload": 60.0, "valid_share": 0.9})


def test_a_displacement_that_is_no_number_is_neither_quiet_nor_loud():
    detector = SquealDetector(RATE, SquealSettings())
    signal = np.concatenate([sine(1000.0, 1e-9), np.full(RATE // 10, math.nan), sine(1000.0, 1e-9)])
    levels = []
    for stamp, daq in blocks(signal):
        detector.add_samples(stamp, daq)
        levels.append(detector.state.level)
    tenth = len(levels) // 3
    assert math.isnan(levels[2 * tenth - 1])
    assert levels[-1] == pytest.approx(-60.0 - 3.01, abs=0.1)


def test_a_window_too_short_for_the_band_is_refused():
    with pytest.raises(ParameterError, match=r"no line of a window of 0\.02 s lies between 1010 and 1040 Hz"):
        SquealDetector(51200, SquealSettings(band_low=1010.0, band_high=1040.0, window=0.02))
