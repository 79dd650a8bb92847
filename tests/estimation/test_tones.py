"""Tones: their probabilities against closed forms and trials, their frequencies and levels, events and their rates."""

import math

import numpy as np
import pytest

from squeal_rig.errors import ParameterError
from squeal_rig.estimation.bands import band, harmonics_inside
from squeal_rig.estimation.detection import (
    REFERENCES,
    detection,
    detection_in_known_noise,
    false_alarm,
    line_snr,
    mean_of_rank,
    tonality_for,
)
from squeal_rig.estimation.envelope import decay_rate, growth_rate
from squeal_rig.estimation.settings import SquealSettings, ToneSettings
from squeal_rig.estimation.spectra import amplitude_spectrum
from squeal_rig.estimation.squeal_events import SquealEvents
from squeal_rig.estimation.tones import ToneFinder
from squeal_rig.instruments.channels import DAQ_RECORD
from squeal_rig.model import RigParameters, eigenvalues, simulate
from squeal_rig.model.motion.trajectory import displaced_state

RATE = 51200
WINDOW = 5120


def sine(frequency, amplitude, seconds, phase=0.3):
    return amplitude * np.sin(2.0 * np.pi * frequency * np.arange(round(seconds * RATE)) / RATE + phase)


def events_of(x, block=512, **settings):
    follower = SquealEvents(RATE, SquealSettings(), ToneSettings(**settings))
    ended = []
    for start in range(0, len(x), block):
        ended += follower.add_signal(x[start : start + block])
    return ended + follower.finish()


def test_false_alarm_of_the_largest_reference_is_the_product_of_the_two_first_ones():
    # Rank 1 of 1: the ratio of two independent exponentials exceeds T with probability 1/(1 + T).
    assert false_alarm(3.0, 1, 1) == pytest.approx(0.25, rel=1e-14)
    assert mean_of_rank(3, 3) == pytest.approx(1.0 / 3 + 1.0 / 2 + 1.0)
    assert false_alarm(tonality_for(1e-7)) == pytest.approx(1e-7, rel=1e-9)
    with pytest.raises(ParameterError, match=r"false_alarm = 2\.0 is out of bounds"):
        tonality_for(2.0)


def test_detection_without_a_tone_is_false_alarm_and_with_many_references_that_in_known_noise():
    for tonality in (3.0, 10.0, 30.0):
        assert detection(0.0, tonality) == pytest.approx(false_alarm(tonality), rel=1e-6)
    assert detection(20.0, 12.0, 20000, 15000) == pytest.approx(detection_in_known_noise(20.0, 12.0), abs=2e-3)


def test_roc_of_a_tone_in_white_noise_is_the_closed_form():
    """Noise with tones of several signal-to-noise ratios: shares within four of their standard deviations."""
    generator = np.random.default_rng(5)
    samples, trials, apart = 1024, 300, 110  # lines so far apart share no reference
    finder = ToneFinder(RATE, samples, SquealSettings(band_low=2000.0, band_high=24000.0), ToneSettings())
    middle = int(finder.lines[len(finder.lines) // 2])

    def ratios(amplitude, offset):
        angle = 2.0 * np.pi * (middle + offset) * np.arange(samples) / samples + generator.uniform(0.0, 6.28)
        x = generator.normal(size=samples) + amplitude * np.cos(angle)
        return finder.tonalities(amplitude_spectrum(x, RATE)[1])

    noise = np.concatenate([ratios(0.0, 0.0)[::apart] for _ in range(trials)])
    for probability in (0.1, 0.01):
        expected = probability * len(noise)
        assert abs(np.sum(noise >= tonality_for(probability)) - expected) < 4.0 * math.sqrt(expected)
    for amplitude, offset in ((0.11, 0.0), (0.16, 0.4), (0.22, 0.0)):
        found = np.array([ratios(amplitude, offset)[len(finder.lines) // 2] for _ in range(trials)])
        for probability in (0.1, 0.01, 0.001):
            share = detection(line_snr(amplitude, 1.0, samples, offset), tonality_for(probability))
            spread = math.sqrt(max(share * (1.0 - share), 1e-3) / trials)
            assert abs(np.mean(found >= tonality_for(probability)) - share) < 4.0 * spread, (amplitude, probability)


def test_two_tones_at_once_with_their_frequencies_and_levels():
    x = sine(963.37, 2e-6, 0.1) + sine(1188.81, 3e-7, 0.1) + np.random.default_rng(1).normal(0.0, 1e-9, WINDOW)
    tones = ToneFinder(RATE, WINDOW, SquealSettings(), ToneSettings()).tones(x, -30.0)
    assert [t.frequency for t in tones] == pytest.approx([963.37, 1188.81], abs=0.05)
    assert [t.level for t in tones] == pytest.approx(
        [20.0 * math.log10(2.0 / 2**0.5), 20.0 * math.log10(0.3 / 2**0.5)], abs=0.1
    )


def test_loud_noise_without_a_tone_is_no_squeal_and_a_tone_below_the_level_neither():
    noise = np.random.default_rng(2).normal(0.0, 2e-6, 4 * RATE)
    assert events_of(noise) == []
    assert events_of(sine(1000.0, 1e-7, 2.0)) == []


def test_an_event_tells_onset_end_growth_decay_and_harmonics_however_samples_come_in_blocks():
    t = np.arange(3 * RATE) / RATE
    rise, fall = 60.0, -45.0
    amplitude = 1e-6 * np.minimum(np.minimum(np.exp(rise * (t - 0.8)), 1.0), np.exp(fall * (t - 2.0)))
    x = amplitude * (np.sin(2 * np.pi * 965.0 * t) + 0.1 * np.sin(2 * np.pi * 2895.0 * t))
    x = x + np.random.default_rng(3).normal(0.0, 1e-11, len(t))
    found = events_of(x)
    event = next(e for e in found if math.isnan(e.harmonic_of))
    # -12 dB re 1 um RMS is 0.355e-6 in amplitude; windows of 0.1 s see it early or late by half of one.
    assert event.onset == pytest.approx(0.8 + math.log(0.355) / rise, abs=0.06)
    assert event.end == pytest.approx(2.0 + math.log(0.178) / fall, abs=0.06)
    assert event.frequency == pytest.approx(965.0, abs=0.05)
    assert (event.growth.rate, event.decay.rate) == pytest.approx((rise, fall), rel=1e-2)
    assert event.growth.frequency == pytest.approx(965.0, abs=0.2)
    assert [h.order for h in event.harmonics] == [3]
    assert np.all(np.diff(event.times) > 0.0)
    other = next(e for e in events_of(x, block=777) if math.isnan(e.harmonic_of))
    assert other.times == event.times
    assert other.frequencies == event.frequencies


def test_growth_in_noise_has_a_standard_error_that_is_its_scatter():
    t = np.arange(RATE) / RATE
    x = 1e-6 * np.minimum(np.exp(60.0 * (t - 0.9)), 1.0) * np.sin(2.0 * np.pi * 1150.0 * t)
    generator = np.random.default_rng(8)
    rates = [growth_rate(x + generator.normal(0.0, 1e-11, RATE), RATE, 1150.0) for _ in range(60)]
    scores = np.array([(rate.rate - 60.0) / rate.error for rate in rates])
    # Of 60 normal deviates the root mean square is within 0.7 and 1.3 but once in a thousand; its bias adds 0.1.
    assert 0.7 < math.sqrt(np.mean(scores**2)) < 1.4
    # Noise that leaves less than a neper of straight line leaves no slope.
    assert math.isnan(growth_rate(x + generator.normal(0.0, 2e-8, RATE), RATE, 1150.0).rate)


@pytest.mark.parametrize("preload", [100.0, 200.0, 300.0])
@pytest.mark.parametrize("k", [3.5e7, 4.5e7, 5.5e7, 6.5e7])
def test_growth_at_unstable_points_is_the_eigenvalues(preload, k):
    p = RigParameters.preset("yavuz_sen_2023").replace(
        preload=preload, pad_stiffness=k, damping_x=200.0, damping_y=200.0
    )
    x = simulate(p, 0.6, RATE, displaced_state(p, 1e-12)).x
    events = SquealEvents(RATE, SquealSettings(), ToneSettings())
    found = events.add_signal(x) + events.finish()
    # A side line of the transient has the growth through the flank of its filter: the straightest is the tone's own.
    rate = min((e.growth for e in found if math.isfinite(e.growth.rate)), key=lambda rate: rate.residual)
    eigenvalue = max(eigenvalues(p), key=lambda value: value.real)
    assert rate.rate == pytest.approx(eigenvalue.real, rel=1e-3)
    assert rate.frequency == pytest.approx(abs(eigenvalue.imag) / (2.0 * math.pi), rel=1e-4)


def test_a_step_or_a_steady_tone_has_no_growth_rate():
    steady = sine(1000.0, 1e-6, 1.0)
    assert math.isnan(growth_rate(steady, RATE, 1000.0).rate)
    assert math.isnan(decay_rate(steady, RATE, 1000.0).rate)
    assert math.isnan(growth_rate(np.zeros(100), RATE, 1000.0).rate)


def test_a_gap_ends_an_event():
    follower = SquealEvents(RATE, SquealSettings(), ToneSettings())
    x = sine(1000.0, 1e-6, 1.0)
    daq = np.zeros(len(x), DAQ_RECORD)
    daq["x"], daq["seq"] = x, np.arange(len(x))
    assert follower.add_samples(daq) == []
    assert follower.count == 1
    daq["seq"] += len(x) + 512
    assert len(follower.add_samples(daq)) == 1
    assert follower.count == 2


def test_the_literal_band_of_a_sound_procedure_is_refused_and_says_why():
    with pytest.raises(ParameterError, match="no sound pressure is known here"):
        band("sae_j2521")
    with pytest.raises(ParameterError, match="must be one of rig"):
        band("other")
    assert band("rig").low == 500.0
    assert harmonics_inside(970.0, 2000.0, 6000.0) == [3, 4, 5, 6]
    assert harmonics_inside(math.nan, 1.0, 2.0) == []
    assert REFERENCES == 32


def test_short_tones_are_no_events_in_the_count_whatever_ends_them():
    follower = SquealEvents(RATE, SquealSettings(), ToneSettings(least_duration=0.3))
    x = sine(1000.0, 1e-6, 2.0)
    x[RATE : RATE + WINDOW] += sine(2300.0, 1e-6, 0.1) + sine(3100.0, 1e-6, 0.1)  # two, seen in a window or two
    for start in range(0, len(x), 512):
        follower.add_signal(x[start : start + 512])
    assert [round(event.frequency) for event in follower.current] == [1000]
    assert follower.count == 1
    follower.add_signal(sine(2300.0, 1e-6, 0.1))
    follower.finish()
    assert follower.count == 1
