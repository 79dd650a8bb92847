"""What the long run is judged by finds a leak and a loss that nobody told, and takes noise for none."""

import numpy as np
import pytest

from squeal_rig.recording import BagWriter
from squeal_rig.recording.cdr import diagnostics_message
from tests.messages import schema_of
from tests.recording.bag_making import START, block_cdr
from tests.soak.bags import faults_of_bag
from tests.soak.slopes import TOLERATED, faults_of, growth

_TIMES = np.arange(0.0, 1800.0)


@pytest.fixture
def noise():
    return np.random.default_rng(1).normal(0.0, 3.0, len(_TIMES))


def test_a_leak_is_found_with_its_size(noise):
    leaking = 150.0 + 0.05 * _TIMES + noise
    assert growth(_TIMES, leaking) == pytest.approx(0.05 * 1350.0, rel=0.1)  # of the last three quarters
    (sentence,) = faults_of("recorder", "memory", _TIMES, leaking)
    assert sentence.startswith(("recorder: memory grew by 6", "recorder: memory grew by 7"))


def test_noise_peaks_and_a_rise_at_the_begin_are_no_leak(noise):
    values = 150.0 + noise + 60.0 * np.minimum(_TIMES, 100.0) / 100.0
    values[::60] += 200.0
    assert faults_of("rig", "memory", _TIMES, values) == []


def test_queues_may_fill_once_and_no_more(noise):
    steps = 100.0 + 0.3 * noise + 12.0 * (_TIMES > 700.0) + 9.0 * (_TIMES > 1100.0)
    assert faults_of("recorder", "memory", _TIMES, steps, queues=36.0) == []
    assert faults_of("recorder", "memory", _TIMES, steps) != []
    (sentence,) = faults_of("recorder", "memory", _TIMES, 100.0 + 60.0 * (_TIMES > 1100.0) + 0.3 * noise, queues=36.0)
    assert sentence.startswith("recorder: memory grew by 6")


@pytest.mark.parametrize("hours", [1.0, 3.5, 4.0, 8.0])
def test_a_leak_within_what_queues_hold_is_found_in_a_life_of_any_length(hours):
    times = np.arange(0.0, hours * 3600.0)
    leaking = 100.0 + 20.0 * times / times[-1] + np.random.default_rng(2).normal(0.0, 1.0, len(times))
    (sentence,) = faults_of("recorder", "memory", times, leaking, queues=36.0)
    assert sentence.startswith("recorder: memory grew all the time, by 1")


@pytest.mark.parametrize("period", [1.0, 60.0])
def test_a_leak_within_what_queues_hold_is_found(noise, period):
    leaking = 100.0 + 0.3 * noise + 0.015 * period * (_TIMES // period)
    (sentence,) = faults_of("recorder", "memory", _TIMES, leaking, queues=36.0)
    assert sentence.startswith(("recorder: memory grew all the time, by 1", "recorder: memory grew all the time, by 2"))


def test_a_handle_kept_by_every_minute_is_found():
    assert growth(_TIMES, 20.0 + _TIMES // 60.0) > TOLERATED["handles"] - 1.0
    assert faults_of("rig", "handles", _TIMES, 20.0 + _TIMES // 30.0) != []


def test_a_short_life_is_not_judged():
    assert growth(_TIMES[:8], _TIMES[:8]) == 0.0
    assert growth(_TIMES[:300], _TIMES[:300]) == 0.0


def bag_of_a_killed_recorder(directory, lost, seconds=2, blocks=200):
    """Seconds of health and blocks of 64 samples, 20 of which are missing; `lost`: what each health said to be lost."""
    cloud, health = schema_of("sensor_msgs/msg/PointCloud2"), schema_of("diagnostic_msgs/msg/DiagnosticArray")
    writer = BagWriter(directory)
    topics = [writer.add_topic(name, cloud.type_name, schema=cloud) for name in ("/daq/samples", "/truth/samples")]
    diagnostics = writer.add_topic("/diagnostics", health.type_name, schema=health)
    for number in (*range(100), *range(120, blocks)):
        stamp = START + number * 10_000_000
        for topic in topics:
            writer.write(topic, block_cdr(number, stamp), stamp, stamp)
    for second in range(seconds):
        stamp = START + second * 10**9
        told = [("recorder", lost[second])] if second < len(lost) else []
        for name, count in [*told, ("rig", 9)]:
            data = diagnostics_message(stamp, "", [(1, name, "", {"lost messages": str(count)})])
            writer.write(diagnostics, data, stamp, stamp)
    writer.flush()
    return directory


@pytest.mark.parametrize(("lost", "told"), [((), 0), ((0, 2), 2 * 512), ((3, 1), 512)])
def test_samples_that_a_killed_recorder_said_nothing_of_are_a_fault(tmp_path, lost, told):
    bag = bag_of_a_killed_recorder(tmp_path / "bag", lost)
    assert faults_of_bag(bag, killed=True) == [
        f"bag_recovered: 1280 samples of {topic} are missing, {told} were reported"
        for topic in ("/daq/samples", "/truth/samples")
    ]
    assert bag.exists()


@pytest.mark.parametrize("seconds", [2, 100])
def test_samples_that_a_killed_recorder_said_to_be_lost_are_none_and_its_bag_goes(tmp_path, seconds):
    bag = bag_of_a_killed_recorder(tmp_path / "bag", (0, 3), seconds)
    assert faults_of_bag(bag, killed=True) == []
    assert list(tmp_path.iterdir()) == []


def test_a_recorder_that_heard_nothing_more_of_the_samples_is_a_fault(tmp_path):
    bag = bag_of_a_killed_recorder(tmp_path / "bag", (0, 3), seconds=200)
    assert faults_of_bag(bag, killed=True) == [
        f"bag_recovered: nothing of {topic} in the last 150 s of 199 s" for topic in ("/daq/samples", "/truth/samples")
    ]
    assert bag.exists()
