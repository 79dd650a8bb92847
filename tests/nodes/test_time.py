"""Stamps, sample numbers, pacing and `/clock`."""

import itertools
import signal
import time

import numpy as np
import pytest

from tests.graph.processes import parameters
from tests.graph.statuses import health_of

pytest.importorskip("rclpy")

_BLOCK_NS = 10_000_000


def _assert_gapless(blocks, rate, overruns):
    """Blocks of 10 ms, stamped t0 + k/rate in whole nanoseconds, numbered without a gap; t0 anew at an overrun only.

    A busy machine may lose whole blocks on the way here; those that came have the stamps and numbers that they have
    without that, and most come one after the other.
    """
    size = rate // 100
    for block in blocks:
        assert len(block.samples) == size
        np.testing.assert_array_equal(block.samples["t"], np.arange(size) / rate)
        np.testing.assert_array_equal(np.diff(block.samples["seq"].astype(np.int64)), 1)
    firsts = np.array([int(block.samples["seq"][0]) for block in blocks])
    steps = np.diff(firsts)
    assert np.all(steps > 0)
    assert np.all(steps % size == 0)
    assert np.count_nonzero(steps == size) > len(steps) / 2
    starts = [block.stamp_ns - int(first) // size * _BLOCK_NS for block, first in zip(blocks, firsts, strict=True)]
    assert sum(a != b for a, b in itertools.pairwise(starts)) <= overruns


def _overruns(bench):
    return int(health_of(bench.health, "rig")[2]["overruns"])


def test_stamps_are_t0_plus_k_over_rate_without_drift(bench):
    bench.rest()
    begin = int(bench.daq[-1].samples["seq"][-1])
    before = _overruns(bench)

    def found():
        blocks = [block for block in bench.daq if block.samples["seq"][0] > begin]
        return blocks if len(blocks) >= 150 else None

    blocks = bench.observer.wait_for(found, "150 blocks")
    bench.health.clear()
    bench.observer.wait_for(lambda: health_of(bench.health, "rig"), "the rig's health after them")
    _assert_gapless(blocks, 51200, _overruns(bench) - before)
    stamps, true_stamps = (
        {int(block.samples["seq"][0]): block.stamp_ns for block in blocks} for blocks in (bench.daq, bench.truth)
    )
    both = stamps.keys() & true_stamps.keys()
    assert len(both) > 100
    assert all(stamps[seq] == true_stamps[seq] for seq in both)


@pytest.mark.parametrize(
    ("real_time_factor", "rate"),
    [*(pytest.param(*other, marks=pytest.mark.slow) for other in ((0.0, 20000), (2.0, 51200))), (1000.0, 51200)],
)
def test_when_not_in_real_time_the_clock_is_published_and_follows_the_samples(
    compiled, processes, observer, measured, real_time_factor, rate
):
    from rosgraph_msgs.msg import Clock

    from squeal_rig.graph import qos

    ns = f"/factor_{real_time_factor:.0f}"
    clock = []
    subscription = observer.node.create_subscription(
        Clock, "/clock", lambda m: clock.append(m.clock.sec * 10**9 + m.clock.nanosec), qos.BLOCKS
    )
    blocks = observer.follow_samples(f"{ns}/daq/samples", depth=100_000)
    settings = parameters(real_time_factor=real_time_factor, sample_rate=rate, autostart="false")
    node = processes.node("simulator", "-r", f"__ns:={ns}", *settings)
    assert observer.transition("configure", f"{ns}/rig")
    observer.wait_for_listeners("daq/samples", 1, f"{ns}/rig")
    begin = time.monotonic()
    assert observer.transition("activate", f"{ns}/rig")
    observer.wait_for(lambda: len(blocks) >= 200, "200 blocks")
    pace = 2.0 / (time.monotonic() - begin)
    # Services are answered however fast the rig samples, and time goes on where it was.
    assert observer.trigger("reset", f"{ns}/rig")[0]
    count = len(blocks)
    observer.wait_for(lambda: len(blocks) >= count + 20, "blocks after the reset")
    assert node.end()[0] == 0
    observer.node.destroy_subscription(subscription)
    assert len(clock) > 100
    assert all(a < b for a, b in itertools.pairwise(clock))
    stamps = [block.stamp_ns for block in blocks]
    assert all(a < b for a, b in itertools.pairwise(stamps))
    if real_time_factor == 2.0:
        # Faster than anybody can read, a queue of one second is outrun and a reader loses blocks.
        _assert_gapless(list(blocks), rate, 0)  # simulated time goes on where it was, after an overrun too
        assert pace < 1.2 * real_time_factor
    assert set(clock) & {stamp + _BLOCK_NS for stamp in stamps}
    measured(f"real_time_factor {real_time_factor:g}, {rate} Hz: {pace:.1f} sampled seconds per second")


def test_a_node_samples_by_itself_once_started(compiled, processes, observer, measured):
    blocks = observer.follow_samples("/quick/daq/samples")
    begin = time.monotonic()
    node = processes.node("simulator", "-r", "__ns:=/quick")
    observer.wait_for(lambda: blocks, "the first block")
    seconds = time.monotonic() - begin
    measured(f"start of the simulator to its first block: {seconds:.2f} s (asked for: 2 s on a machine at rest)")
    assert node.end()[0] == 0


@pytest.mark.slow
def test_after_an_overrun_no_reset_turns_the_time_back(compiled, processes, observer):
    rig = processes.node("simulator", *parameters(sample_rate=12800))
    blocks, health = observer.follow_samples("daq/samples", depth=2000), observer.follow("/diagnostics")
    observer.wait_for(lambda: blocks, "samples")
    for number in range(3):
        rig.send(signal.SIGSTOP)
        time.sleep(0.6)
        rig.send(signal.SIGCONT)
        # By their stamps: what was on its way before may come only now.
        now = time.time_ns()
        observer.wait_for(lambda now=now: blocks[-1].stamp_ns > now + 5 * _BLOCK_NS, "samples after the overrun")
        assert observer.trigger("reset")[0], number
        now = time.time_ns()
        observer.wait_for(lambda now=now: blocks[-1].stamp_ns > now + 5 * _BLOCK_NS, "samples after the reset")
    observer.wait_for(lambda: int(health_of(health, "rig")[2]["overruns"]) >= 3, "three overruns")
    assert rig.end()[0] == 0
    stamps = np.array([block.stamp_ns for block in blocks])
    assert np.diff(stamps).min() >= _BLOCK_NS - 1_000_000


@pytest.mark.slow
def test_a_rig_that_is_asked_to_follow_a_clock_keeps_the_systems_time_and_says_so(compiled, processes, observer):
    rig = processes.node("simulator", *parameters(use_sim_time="true"))
    blocks, health = observer.follow_samples("daq/samples"), observer.follow("/diagnostics")
    observer.wait_for(lambda: blocks, "samples")
    assert abs(blocks[-1].stamp_ns - time.time_ns()) < 5 * 10**9

    def warned():
        level, sentence, _ = health_of(health, "rig") or (0, "", {})
        return level == 1 and sentence.startswith("use_sim_time was asked for: ")  # a busy one may be late as well

    observer.wait_for(warned, "a warning on /diagnostics")
    assert abs(health[-1].header.stamp.sec - time.time()) < 5.0
    ((done, reason),) = observer.set({"use_sim_time": True})
    assert (done, "the rig makes the time" in reason) == (False, True)
    assert rig.end()[0] == 0
