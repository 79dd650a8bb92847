"""A recorded run is whole, others can read it, and its replay gives every byte and every number again."""

import collections

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader

from squeal_rig.recording import Bag, BagWriter, samples_from_cdr
from squeal_rig.session.replay_check import compared, lost_spans, recorded_windows
from tests.graph.processes import PATIENT_RATE, parameters
from tests.graph.statuses import health_of

pytest.importorskip("rclpy")

REPLAYED = ("/daq/samples", "/truth/samples", "/rig/description")
_SAMPLES = ("/daq/samples", "/truth/samples")


@pytest.fixture(scope="module")
def live(compiled, processes, observer, config_file, tmp_path_factory):
    """A bag of a run into squeal, from its first sample on."""
    bag = tmp_path_factory.mktemp("bags") / "live"
    files = ["--params-file", str(config_file)]
    estimator = processes.node("friction_estimator", *files)
    recorder = processes.node("recorder", *files, *parameters(directory=bag))
    simulator = processes.node(
        "simulator", *files, *parameters(autostart="false", preload=300.0, sample_rate=PATIENT_RATE)
    )
    health = observer.follow("/diagnostics")
    assert observer.transition("configure")
    for topic in ("daq/samples", "truth/samples"):
        observer.wait_for_listeners(topic, 2)
    for topic in ("friction/samples", "friction/windows"):  # the recorder hears the estimator too
        observer.wait_for_listeners(topic, 1, "friction_estimator")
    assert observer.transition("activate")
    assert observer.trigger("impact")[0]

    def enough():
        state = health_of(health, "friction_estimator")
        return state and int(state[2]["windows"]) >= 10

    observer.wait_for(enough, "ten windows")
    assert observer.pause(True)[0]

    def published():
        state = health_of(health, "rig")
        if state is None or state[2]["state"] != "paused":  # what it told before, more has followed
            return None
        return {topic: int(state[2][f"last published of {topic[1:]}"]) for topic in _SAMPLES}

    _drained(observer, health, observer.wait_for(published, "the health of the paused rig"))
    for node in (simulator, estimator, recorder):
        code, _ = node.end()
        assert code == 0, node.errors
    return bag


def _drained(observer, health, published):
    """Wait until estimator and recorder have taken what was published, by their own counts, topic by topic."""

    def drained():
        estimator, recorder = health_of(health, "friction_estimator"), health_of(health, "recorder")
        if estimator is None or recorder is None:
            return False
        # The estimator gives a block for a block.
        blocks, windows = int(estimator[2]["blocks"]), int(estimator[2]["windows"])
        wanted = {**published, "/friction/samples": blocks, "/friction/windows": windows}
        taken = {topic: int(recorder[2].get(f"last taken of {topic}", 0)) for topic in wanted}
        return blocks == published["/daq/samples"] and taken == wanted

    observer.wait_for(drained, "an estimator and a recorder that have taken all")


@pytest.fixture(scope="module")
def replayed(live, processes, observer, config_file, tmp_path_factory):
    """A bag of the replay of the live one, with a fresh estimator listening."""
    bag = tmp_path_factory.mktemp("bags") / "replayed"
    files = ["--params-file", str(config_file)]
    estimator = processes.node("friction_estimator", *files)
    recorder = processes.node("recorder", *files, *parameters(directory=bag))
    health = observer.follow("/diagnostics")
    player = processes.node("player", *files, *parameters(bag=live, rate=1.0, start_paused=True))
    # Its publishers stand: the recorder finds them, and the player counts both.
    observer.wait_for(lambda: health_of(health, "player"), "the player")

    def heard():
        return int(health_of(health, "player")[2]["fewest listeners"]) >= 2

    observer.wait_for(heard, "estimator and recorder listening to every topic")
    assert observer.trigger("resume", "player")[0]
    assert observer.wait_for_end(player) == 0
    _drained(observer, health, {topic: Bag(live).topics[topic].message_count for topic in _SAMPLES})
    for node in (estimator, recorder):
        code, _ = node.end()
        assert code == 0, node.errors
    return bag


def _payloads(bag):
    """Topic -> payloads in order, read by `mcap`."""
    payloads = collections.defaultdict(list)
    for file in Bag(bag).files:
        with file.open("rb") as stream:
            for _, channel, message in make_reader(stream, validate_crcs=True).iter_messages():
                payloads[channel.topic].append(message.data)
    return payloads


def _samples(bag, topic):
    return np.concatenate([samples_from_cdr(data).samples for data in _payloads(bag)[topic]])


@pytest.mark.parametrize("topic", _SAMPLES)
def test_the_samples_of_a_bag_are_numbered_from_zero_without_a_gap(live, topic):
    seq = _samples(live, topic)["seq"]
    np.testing.assert_array_equal(seq, np.arange(len(seq)))
    assert len(seq) >= 2 * PATIENT_RATE


def test_rosbags_reads_the_bag_and_every_message_in_it(live):
    counts = collections.Counter()
    with Reader(live) as reader:
        expected = {connection.topic: connection.msgcount for connection in reader.connections}
        assert reader.duration > 2e9
    with AnyReader([live]) as reader:
        for connection, _, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            counts[connection.topic] += 1
            if connection.topic == "/daq/samples":
                assert message.header.frame_id == "rig"
                assert message.width * message.point_step == len(message.data)
    assert counts == {topic: count for topic, count in expected.items() if count}
    wanted = {*REPLAYED, "/friction/windows", "/friction/samples", "/friction/mu", "/pad/state", "/contact/wrench"}
    assert wanted <= set(counts)


def test_mcap_reads_the_bag_with_its_summary_and_checksums(live):
    (file,) = Bag(live).files
    with file.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
        count = sum(1 for _ in reader.iter_messages())
    assert summary.statistics.message_count == count
    assert all(channel.message_encoding == "cdr" for channel in summary.channels.values())
    assert all(channel.metadata["offered_qos_profiles"] for channel in summary.channels.values())
    assert all(channel.metadata["topic_type_hash"].startswith("RIHS01_") for channel in summary.channels.values())


def test_the_bag_says_what_the_run_was_and_how_it_ended(live):
    bag = Bag(live)
    assert bag.ending.startswith("complete")
    assert bag.custom_data["squeal_rig"]
    assert bag.custom_data["library.rclpy"]
    assert bag.topics["/rig/description"].qos[0].durability == "transient_local"
    assert bag.topics["/daq/samples"].qos[0].reliability == "reliable"


@pytest.mark.slow
@pytest.mark.parametrize("topic", REPLAYED)
def test_a_replay_recorded_again_has_the_same_bytes(live, replayed, topic):
    payloads = _payloads(live)[topic]
    assert payloads
    assert _payloads(replayed)[topic] == payloads


@pytest.mark.slow
def test_a_fresh_estimator_gives_the_same_windows_on_the_replay(live, replayed):
    comparison = compared(recorded_windows(live), list(recorded_windows(replayed)))
    assert comparison.live >= 10
    assert comparison.same, comparison


def test_what_the_recorder_lost_is_told_apart_from_what_differs(live, tmp_path):
    windows = recorded_windows(live)
    assert lost_spans(live) == []
    damaged = windows.copy()
    damaged["mu"][[3, 4]] += 1e-12
    assert not compared(windows, list(damaged)).same
    begin, end = float(windows["t_start"][3]), float(windows["t_end"][4])
    told = compared(windows, list(damaged), [(begin + 1e-4, end - 1e-4)])
    assert (told.same, told.equal, told.incomplete) == (True, len(windows) - 2, (2, 2))
    assert "2 hold samples that the recorder lost: the same" in told.sentence
    assert not compared(windows, list(damaged), [(begin + 1e-4, begin + 2e-4)]).same
    ((begin, end),) = lost_spans(_without_block(live, tmp_path / "gap", "/daq/samples", 7))
    assert end - begin == pytest.approx(0.01)
    assert lost_spans(_without_block(live, tmp_path / "no truth", "/truth/samples", 7)) == [(begin, end)]


def _without_block(bag, directory, topic, lost):
    """A copy of a bag without the block of that number of a topic."""
    source, number = Bag(bag), 0
    with BagWriter(directory) as writer:
        handles = {
            name: writer.add_topic(name, there.type_name, there.qos, there.schema)
            for name, there in source.topics.items()
        }
        for message in source.messages():
            number += message.topic == topic
            if message.topic != topic or number != lost:
                writer.write(handles[message.topic], message.data, message.log_time, message.publish_time)
        writer.close("complete")
    return directory


def test_recorded_friction_samples_are_finite_and_as_many_as_measured(live):
    samples = _samples(live, "/friction/samples")
    assert np.all(np.isfinite(samples["mu"]))
    np.testing.assert_array_equal(samples["seq"], np.arange(len(samples)))
    assert len(samples) == len(_samples(live, "/daq/samples"))
