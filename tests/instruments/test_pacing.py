"""When blocks are due."""

import pytest

from squeal_rig.instruments.pacing import OVERRUN, Pacer


def test_a_block_is_due_when_its_last_sample_was_taken():
    pacer = Pacer(1.0)
    pacer.start(100.0)
    assert pacer.due(100.009) == (0, False)
    assert pacer.due(100.0100001) == (1, False)
    assert pacer.due(100.0150000) == (0, False)
    assert pacer.due(100.0300001) == (2, False)


def test_it_never_makes_more_or_fewer_blocks_than_time_has_passed():
    pacer = Pacer(2.0)
    pacer.start(0.0)
    total = sum(pacer.due(step * 0.0037)[0] for step in range(1, 1001))
    assert total == pytest.approx(1000 * 0.0037 * 200, abs=1.0)


def test_falling_behind_is_counted_and_skipped_once():
    pacer = Pacer(1.0)
    pacer.start(0.0)
    count, overrun = pacer.due(OVERRUN + 0.5)
    assert (count, overrun) == (1, True)
    assert pacer.overruns == 1
    assert pacer.skipped_seconds == pytest.approx(1.0, abs=0.011)
    assert pacer.due(OVERRUN + 0.511) == (1, False)


def test_a_short_delay_is_caught_up_without_an_overrun():
    pacer = Pacer(1.0)
    pacer.start(0.0)
    made = [pacer.due(0.3)[0], pacer.due(0.3)[0], pacer.due(0.3)[0], pacer.due(0.3)[0]]
    assert made == [10, 10, 10, 0]
    assert pacer.overruns == 0


def test_as_fast_as_possible_always_has_a_block_due():
    pacer = Pacer(0.0)
    pacer.start(0.0)
    assert [pacer.due(0.0)[0] for _ in range(3)] == [1, 1, 1]


def test_blocks_put_back_are_due_once_more():
    pacer = Pacer(1.0)
    pacer.start(0.0)
    assert pacer.due(0.05)[0] == 5
    pacer.put_back(3)
    assert pacer.due(0.05)[0] == 3
