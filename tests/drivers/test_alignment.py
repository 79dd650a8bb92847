"""Times of a device: believed where they can be, counted and told where not; blocks out of unequal packets."""

from fractions import Fraction

import numpy as np
import pytest

from squeal_rig.drivers.alignment import Aligner

RATE, SIZE = 1000, 10
START = Fraction(1_700_000_000)


class Device:
    """Two signals in packets; sample k of both has the value k. The clock of arrival is the device's, 20 ms late."""

    def __init__(self, delays=(0, 0)):
        self.aligner = Aligner(dict(zip("ab", delays, strict=True)), RATE, SIZE)
        self.sentences = []
        self.late = 0.02

    def send(self, name, first, count, claimed=None, damaged=False, late=0.0):
        """Samples first to first + count; `claimed` is the number that their time says."""
        at = first if claimed is None else claimed
        time = None if damaged else START + Fraction(at) / RATE
        arrival = 100.0 + (first + count) / RATE + self.late + late
        sentence = self.aligner.add(name, time, np.arange(first, first + count, dtype=float), arrival)
        if sentence:
            self.sentences.append(sentence)

    def both(self, first, count, **details):
        for name in "ab":
            self.send(name, first, count, **details)

    def blocks(self):
        return list(iter(self.aligner.take_block, None))


def check_whole(blocks, lost=0):
    """Every block holds consecutive samples of both signals, and as many are missing between them as are told."""
    following = None
    missing = 0
    for begin, told, values in blocks:
        for name in "ab":
            assert np.array_equal(values[name], np.arange(begin, begin + SIZE)), name
        if following is not None:
            assert begin - following == told
        missing += told
        following = begin + SIZE
    assert missing == lost


def test_unequal_packets_make_equal_blocks():
    device = Device()
    rng = np.random.default_rng(3)
    first = {"a": 0, "b": 0}
    for _ in range(200):
        for name in "ab":
            count = int(rng.integers(1, 17))
            device.send(name, first[name], count)
            first[name] += count
    blocks = device.blocks()
    assert len(blocks) == min(first.values()) // SIZE
    check_whole(blocks)
    assert device.sentences == []
    assert device.aligner.time_of(1234) == START + Fraction(1234, RATE)


def test_it_begins_with_the_first_sample_that_all_signals_have():
    device = Device()
    device.send("a", 0, 7)
    device.send("b", 4, 30)
    device.send("a", 7, 30)
    blocks = device.blocks()
    assert blocks[0][0] == 4
    check_whole(blocks)


def test_a_delayed_channel_is_moved_to_its_place():
    device = Device(delays=(0, 3))
    device.both(0, 40)
    begin, _, values = device.blocks()[0]
    assert values["b"][0] == values["a"][0] + 3
    assert begin == 0 or values["a"][0] == begin


@pytest.mark.parametrize("gap", [1, 4, 25, 1000])
def test_samples_that_were_lost_are_missing_for_all_signals(gap):
    device = Device()
    device.both(0, 34)
    device.both(34 + gap, 50)
    blocks = device.blocks()
    assert device.sentences == []
    check_whole(blocks, lost=4 + gap)  # with what the block had already
    assert blocks[3][0] == 34 + gap


def test_what_one_signal_lost_is_lost():
    device = Device()
    device.send("a", 0, 60)
    device.send("b", 0, 13)
    device.send("b", 15, 45)
    blocks = device.blocks()
    check_whole(blocks, lost=5)
    assert [begin for begin, _, _ in blocks] == [0, 15, 25, 35, 45]


def test_a_loss_behind_a_stalled_line_is_believed_too():
    device = Device()
    device.both(0, 20)
    device.both(20, 20, late=3.0)  # comes at once with what follows
    device.both(2040, 20)
    blocks = device.blocks()
    assert device.sentences == []
    assert device.aligner.faults == {}
    assert [begin for begin, _, _ in blocks][-2:] == [2040, 2050]
    check_whole(blocks, lost=2000)


@pytest.mark.parametrize(
    ("jump", "what"), [(3600 * RATE, "jumps ahead"), (-3600 * RATE, "runs back"), (-5, "runs back")]
)
def test_a_time_that_jumps_is_not_believed_and_the_own_count_goes_on(jump, what):
    device = Device()
    device.both(0, 20)
    for first in range(20, 80, 10):
        device.both(first, 10, claimed=first + jump)
    blocks = device.blocks()
    check_whole(blocks)
    assert [begin for begin, _, _ in blocks] == list(range(0, 80, 10))
    assert len(device.sentences) == 2  # once a signal: it jumped once
    assert all(what in sentence and "not believed" in sentence for sentence in device.sentences)
    assert sum(device.aligner.faults.values()) == 2


def test_a_time_that_comes_again_with_every_packet_is_not_believed():
    """OpenDAQ issue 1291: the last domain packet is used again."""
    device = Device()
    device.both(0, 20)
    for first in range(20, 60, 10):
        device.both(first, 10, claimed=10)
    device.both(60, 10)
    blocks = device.blocks()
    check_whole(blocks)
    assert blocks[-1][0] == 60
    assert device.aligner.faults == {"time runs back": 8}
    device.both(70, 10)  # and then it is right again
    check_whole(device.blocks())
    assert sum(device.aligner.faults.values()) == 8


def test_a_device_clock_that_was_set_anew_counts_as_one_jump():
    device = Device()
    device.both(0, 20)
    for first in range(20, 200, 10):
        device.both(first, 10, claimed=first + 86400 * RATE)
    check_whole(device.blocks())
    assert sum(device.aligner.faults.values()) == 2


def test_a_damaged_time_is_not_believed():
    device = Device()
    device.both(0, 20)
    device.both(20, 10, damaged=True)
    device.both(30, 10)
    blocks = device.blocks()
    check_whole(blocks)
    assert len(blocks) == 4
    assert device.aligner.faults == {"time is damaged": 2}


def test_signals_whose_clocks_are_hours_apart_are_told_and_joined_by_their_arrival():
    """OpenDAQ issue 1202: a client gets other times than the server sends."""
    device = Device()
    for first in range(0, 60, 10):
        device.send("a", first, 10)
        device.send("b", first, 10, claimed=first + 7200 * RATE)
    blocks = device.blocks()
    check_whole(blocks)
    assert len(blocks) == 6
    assert len(device.sentences) == 1
    assert "b: time differs from that of the other signals by 7200 s" in device.sentences[0]


def test_signals_that_are_sampled_between_each_others_samples_are_told_once():
    device = Device()
    for first in range(0, 60, 10):
        device.send("a", first, 10)
        device.send("b", first, 10, claimed=first + Fraction(1, 4))
    check_whole(device.blocks())
    assert device.sentences == ["b is not sampled with the others, off by 250 us: taken to the nearest sample"]


def test_a_clock_that_drifts_for_hours_is_believed_and_so_are_its_losses():
    device = Device()
    first = 0
    for number in range(3000):
        device.late = 0.02 - 2e-4 * number * 0.1  # the device's clock is 200 ppm fast, a packet every 0.1 s
        device.both(first, 100)
        device.blocks()
        first += 100
    device.both(first + 40, 100)
    assert device.sentences == []
    ((begin, lost, _), *_) = device.blocks()
    assert (begin, lost) == (first + 40, 40)
