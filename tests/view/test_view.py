"""What is drawn and heard, against independent computation."""

import math
import time

import numpy as np
import pytest
from scipy.signal import resample_poly

from squeal_rig.instruments.channels import DAQ_RECORD, TRUTH_RECORD
from squeal_rig.recording import installed_schema
from squeal_rig.recording.messages import decoder_of
from squeal_rig.view.follower import ARRAYS, NUMBERS, SHOWN, ViewFollower
from squeal_rig.view.pictures import FLOOR_DB, decimated, spectrum_lines
from squeal_rig.view.settings import ViewSettings
from squeal_rig.view.sound import Resampler, WithoutOffset
from squeal_rig.view.window import LastSamples

RATE = 51200


def blocks(count, rate=RATE, frequency=2200.0, amplitude=3e-6, first=0):
    size = rate // 100
    for number in range(count):
        daq = np.zeros(size, DAQ_RECORD)
        daq["seq"] = first + number * size + np.arange(size)
        daq["t"] = np.arange(size) / rate
        daq["x"] = 1e-5 + amplitude * np.sin(2.0 * math.pi * frequency * daq["seq"] / rate)
        daq["preload"] = 50.0
        yield daq


def read(topic, data):
    kind = "std_msgs/msg/Float64MultiArray" if topic in ARRAYS else "std_msgs/msg/Float64"
    return decoder_of(installed_schema(kind))(data)


def test_every_block_gives_the_envelope_of_every_channel():
    follower = ViewFollower(ViewSettings(), RATE)
    for daq in blocks(3):
        found = read("view/envelope", dict(follower.take_block(daq))["view/envelope"])
        table = np.reshape(found.data, (len(SHOWN), 3))
        for row, channel in zip(table, SHOWN, strict=True):
            assert tuple(row) == (daq[channel.name].min(), daq[channel.name].max(), daq[channel.name].mean())
        assert all(channel.name in found.layout.dim[0].label for channel in SHOWN)


@pytest.mark.parametrize("rate", [1000, 51200, 2_000_000])
def test_no_array_is_longer_than_stock_tools_draw_and_its_rate_is_told(rate):
    follower = ViewFollower(ViewSettings(), rate)
    for daq in blocks(60, rate, frequency=200.0):
        said = dict(follower.take_block(daq))
        for topic in said.keys() & set(ARRAYS):
            assert 0 < len(read(topic, said[topic]).data) <= 500, topic
        if "view/scope/x" in said:
            shown, told = read("view/scope/x", said["view/scope/x"]), read("view/scope_rate", said["view/scope_rate"])
            assert len(daq) / len(shown.data) == pytest.approx(rate / told.data, rel=0.1)
            assert f"{told.data:g} Hz" in shown.layout.dim[1].label
    assert 5.0 * sum(map(len, said.values())) < 1e6


def test_everything_but_the_envelope_comes_at_its_rate():
    follower = ViewFollower(ViewSettings(rate=5.0), RATE)
    said = [dict(follower.take_block(daq)) for daq in blocks(100)]
    assert sum("view/scope/x" in one for one in said) == 5
    assert sum("view/envelope" in one for one in said) == 100
    follower = ViewFollower(ViewSettings(rate=7.0), RATE)  # no whole number of blocks
    assert sum("view/scope/x" in dict(follower.take_block(daq)) for daq in blocks(1000)) == 70


def test_a_number_is_published_once_it_is_known():
    follower = ViewFollower(ViewSettings(), RATE)
    follower.numbers["view/mu"] = 0.3, time.monotonic()
    truth = np.zeros(1000, TRUTH_RECORD)
    truth["normal_force"][250:] = 10.0
    follower.take_truth(truth)
    said = dict(follower.take_block(next(blocks(1))))
    assert {topic: read(topic, said[topic]).data for topic in NUMBERS if topic in said} == {
        "view/mu": 0.3,
        "view/off_belt_share": 0.25,
    }


def test_what_is_old_is_not_published_as_new_but_what_holds_until_it_changes():
    follower = ViewFollower(ViewSettings(), RATE)
    long_ago = time.monotonic() - 60.0
    follower.numbers |= {"view/mu": (0.3, long_ago), "view/margin": (0.2, long_ago)}
    said = dict(follower.take_block(next(blocks(1))))
    assert {topic for topic in NUMBERS if topic in said} == {"view/margin"}


def test_a_line_of_the_spectrum_is_not_lost_where_there_are_more_lines_than_are_drawn():
    x = np.concatenate([daq["x"] for daq in blocks(20)])
    lines = spectrum_lines(x, RATE, 20_000.0, 200)
    assert len(lines.levels) <= 200
    top = int(np.argmax(lines.levels))
    assert lines.levels[top] == pytest.approx(20.0 * math.log10(3.0 / math.sqrt(2.0)), abs=1e-3)
    assert lines.frequencies[top] == pytest.approx(2200.0, abs=1e-6)
    assert np.all(np.diff(lines.frequencies) > 0.0)


def test_silence_has_a_level_that_can_be_drawn():
    assert set(spectrum_lines(np.zeros(1024), RATE, 1e4, 500).levels) == {FLOOR_DB}


def test_what_cannot_be_resolved_does_not_come_back_as_a_slow_wave():
    t = np.arange(5120) / RATE
    values, step = decimated(np.sin(2.0 * math.pi * (RATE / 16) * t), 320)
    assert step == 16
    assert np.abs(values).max() < 1e-12


def test_the_newest_samples_begin_anew_after_a_gap():
    window = LastSamples(1000)
    numbers = np.arange(10_000, dtype=float)
    for begin in range(0, 3000, 170):
        window.add(begin, numbers[begin : begin + 170])
    end = 170 * 18
    assert np.array_equal(window.whole(), numbers[end - 1000 : end])
    window.add(end + 1, numbers[end + 1 : end + 500])
    assert window.whole() is None


@pytest.mark.parametrize(
    ("rate_in", "rate_out"), [(51200, 48000), (51200, 44100), (1000, 48000), (2_000_000, 44100), (48000, 48000)]
)
def test_sound_in_pieces_is_the_sound_of_the_whole_in_every_bit(rate_in, rate_out):
    random = np.random.default_rng(7)
    x = random.normal(size=30_000)
    resampler, pieces, begin = Resampler(rate_in, rate_out), [], 0
    while begin < len(x):
        count = int(random.integers(1, 900))
        pieces.append(resampler.add(x[begin : begin + count]))
        begin += count
    heard = np.concatenate(pieces)
    whole = resample_poly(x, resampler.up, resampler.down)
    missing = 12 * max(resampler.up, resampler.down) / resampler.down + 1
    assert len(whole) - missing <= len(heard) <= len(whole)
    assert np.array_equal(heard, whole[: len(heard)])


def test_sound_without_its_offset_has_no_seam_and_keeps_the_squeal():
    t = np.arange(5120) / RATE
    tone = 3e-6 * np.sin(2.0 * math.pi * 2200.0 * t)
    whole = WithoutOffset(RATE).add(1e-3 + tone)
    by_pieces = WithoutOffset(RATE)
    pieces = np.concatenate([by_pieces.add(1e-3 + piece) for piece in np.split(tone, 10)])
    assert np.array_equal(whole, pieces)
    # A first order at 20 Hz turns a tone of 2.2 kHz by 20/2200 rad; what it begins with dies away as large.
    assert abs(whole - tone).max() < 2.2 * 3e-6 * 20.0 / 2200.0
    assert not WithoutOffset(RATE).add(np.full(100, 1e-3)).any()


def test_what_is_not_finite_is_silent_and_sound_goes_on_after_it():
    high_pass = WithoutOffset(RATE)
    assert not high_pass.add(np.array([1.0, np.nan, 1.0])).any()
    assert np.isfinite(high_pass.add(np.ones(8))).all()
