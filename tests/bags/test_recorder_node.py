"""The recorder as a process: late topics, services, snapshots, provenance, a full disk."""

import re
import signal
import subprocess
import sys
from functools import partial
from itertools import count
from pathlib import Path

import pytest

from squeal_rig.recording import Bag, samples_from_cdr
from squeal_rig.recording.parameter_log import parameters_of
from squeal_rig.recording.verify import verify
from tests.graph.processes import parameters
from tests.graph.statuses import health_of

from .full_load import CLOUDS, ROWS, published, start_load


@pytest.fixture
def load(processes, tmp_path):
    start_load(processes, tmp_path / "load.txt", listeners=1)
    return tmp_path / "load.txt"


def stalled(processes, mark, seconds, **settings):
    """A recorder whose disk stalls once for so many seconds."""
    script = str(Path(__file__).with_name("stalled_recorder.py"))
    ros_arguments = ["--ros-args", *parameters(**settings)]
    return processes.start([sys.executable, script, str(mark), str(seconds), *ros_arguments])


def told(health, key, otherwise=0.0):
    """A number of the recorder's newest health, or another one where it has not told any yet."""
    state = health_of(health, "recorder")
    return float(state[2][key]) if state else otherwise


def damage(bag):
    """What is wrong with a bag, beside messages that a busy machine lost on the way here or brought late."""
    errors = [finding for finding in verify(bag).findings if finding.level == "error"]
    missing = [(finding, re.match(r"(\d+) samples are missing", finding.sentence)) for finding in errors]
    lost = sum(int(found[1]) // ROWS for _, found in missing if found)
    accounted = lost <= int(Bag(bag).custom_data["lost_messages"])
    return [finding for finding, found in missing if not (found and accounted)]


def recording(observer, health, count=100):
    observer.wait_for(lambda: told(health, "messages") > count, "recorded messages")


def parameter_records(bag, name):
    return [parameters_of(record.values) for record in bag.metadata_records if record.name == name]


def test_late_topics_of_any_type_and_publishers_that_offer_less_are_recorded(processes, observer, health, tmp_path):
    from geometry_msgs.msg import Twist
    from rclpy.qos import QoSProfile, ReliabilityPolicy

    recorder = processes.node("recorder", *parameters(directory=tmp_path / "run", topics=["/la*"]))
    observer.wait_for(lambda: health_of(health, "recorder"), "the recorder")

    before = told(health, "topics")
    first = observer.node.create_publisher(Twist, "/late", 10)
    observer.wait_for(lambda: told(health, "topics") > before, "the late topic")
    observer.wait_for(lambda: first.get_subscription_count() == 1, "its subscription")
    observer.wait_for(lambda: "/late" in health_of(health, "recorder")[2]["heard"].split(", "), "its publisher heard")
    first.publish(Twist())
    # No other topic is recorded, not even its own health: the messages it counts are those of this one.
    observer.wait_for(lambda: told(health, "messages") == 1.0, "the first message")
    # Reliable until now; a best-effort publisher beside it needs a subscription that asks for less.
    second = observer.node.create_publisher(
        Twist, "/late", QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
    )
    observer.wait_for(lambda: second.get_subscription_count() == 1, "the weaker subscription")
    second.publish(Twist())
    observer.wait_for(lambda: told(health, "messages") == 2.0, "the second message")
    assert recorder.end()[0] == 0
    late = Bag(tmp_path / "run").topics["/late"]
    assert (late.type_name, late.message_count) == ("geometry_msgs/msg/Twist", 2)
    assert "MSG: geometry_msgs/msg/Vector3" in late.schema.text
    assert late.type_hash.startswith("RIHS01_")
    assert late.qos[0].reliability == "reliable"


@pytest.mark.slow
def test_who_listens_for_another_type_keeps_no_topic_from_the_bag(processes, observer, health, tmp_path):
    from geometry_msgs.msg import Twist
    from std_msgs.msg import String

    from tests.graph.observer import Observer

    stranger = Observer(processes.domain)
    stranger.node.create_subscription(String, "/odd", lambda message: None, 10)
    recorder = processes.node("recorder", *parameters(directory=tmp_path / "run", topics=["/odd"]))
    observer.wait_for(lambda: health_of(health, "recorder"), "the recorder")
    twist = observer.node.create_publisher(Twist, "/odd", 10)

    def recorded():
        twist.publish(Twist())
        return told(health, "messages") > 0

    observer.wait_for(recorded, "the topic recorded", 60.0)
    assert health_of(health, "recorder")[0] == 0
    assert recorder.end()[0] == 0
    stranger.close()
    assert Bag(tmp_path / "run").topics["/odd"].type_name == "geometry_msgs/msg/Twist"


def test_a_topic_that_comes_back_as_another_type_is_told(processes, observer, health, tmp_path):
    from geometry_msgs.msg import Twist
    from std_msgs.msg import String

    recorder = processes.node("recorder", *parameters(directory=tmp_path / "run", topics=["/mended"]))
    observer.wait_for(lambda: health_of(health, "recorder"), "the recorder")
    for kind, level in ((String, 0), (Twist, 1), (String, 0)):
        publisher = observer.node.create_publisher(kind, "/mended", 10)
        observer.wait_for(lambda: told(health, "topics") == 1, "the topic")

        def seen(level=level):
            found, sentence, _ = health_of(health, "recorder")
            return found == level and (level == 0 or sentence == "not recorded: /mended")

        observer.wait_for(seen, f"a health of level {level}")
        observer.node.destroy_publisher(publisher)
    reason = "it was std_msgs/msg/String and is published as geometry_msgs/msg/Twist now"
    assert recorder.errors.count(f"/mended is not recorded: {reason}") == 1
    assert recorder.end()[0] == 0


def test_parameters_of_every_node_and_each_change_are_in_the_bag(processes, observer, health, tmp_path):
    processes.node("friction_estimator")
    # Nothing else is recorded, so that the messages it counts are changes of parameters.
    settings = parameters(directory=tmp_path / "run", topics=["/parameter_events"])
    recorder = processes.node("recorder", *settings)

    # The observer has no parameter services.
    observer.wait_for(lambda: told(health, "nodes with known parameters") >= 2, "parameters of recorder and estimator")
    # What a starting node declared may still be on its way: the newest health counts that.
    health.clear()
    observer.wait_for(lambda: health_of(health, "recorder"), "its health as of now")
    had = told(health, "messages")
    assert observer.set({"snapshot_delay": 12.5}, "recorder") == [(True, "")]
    observer.wait_for(lambda: told(health, "messages") > had, "the change recorded")
    assert recorder.end(signal.SIGTERM)[0] == 0
    bag = Bag(tmp_path / "run")
    at_start = {node: values for node, _, values in parameter_records(bag, "parameters")}
    assert at_start["/friction_estimator"]["minimum_normal_load"] == 10.0
    assert at_start["/recorder"]["directory"] == str(tmp_path / "run")
    assert ("/recorder", {"snapshot_delay": 12.5}) in [
        (node, values) for node, _, values in parameter_records(bag, "parameter_change")
    ]
    assert bag.topics["/parameter_events"].message_count >= 1
    assert bag.ending == "complete"
    assert {"squeal_rig", "os", "cpu_count", "started_utc", "finished_utc"} <= set(bag.custom_data)


def test_stop_start_and_split_leave_sound_bags(processes, observer, health, tmp_path, load):
    recorder = processes.node("recorder", *parameters(directory=tmp_path / "run"))
    recording(observer, health)
    observer.wait_for(lambda: told(health, "nodes with known parameters") >= 2, "parameters of recorder and load")
    assert observer.trigger("split", "recorder")[0]
    assert observer.trigger("stop", "recorder") == (True, f"closed {tmp_path / 'run'}")
    assert observer.trigger("stop", "recorder") == (False, "nothing is being recorded")
    assert observer.trigger("snapshot", "recorder")[0] is False
    assert observer.trigger("start", "recorder")[0]
    health.clear()
    recording(observer, health)
    assert recorder.end()[0] == 0
    first, second = Bag(tmp_path / "run"), Bag(tmp_path / "run_2")
    assert len(first.files) == 2
    assert first.ending == "complete: stopped on request"
    for bag in (first, second):
        assert damage(bag.path) == []
        assert bag.topics["/rig/description"].message_count == 1, "the latched value is in each"
        assert {node for node, _, _ in parameter_records(bag, "parameters")} >= {"/load", "/recorder"}


def test_a_snapshot_holds_the_last_seconds_on_request_and_on_squeal(processes, observer, health, tmp_path, load):
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

    settings = parameters(directory=tmp_path / "run", mode="snapshot", snapshot_duration=1.0, snapshot_delay=0.2)
    recorder = processes.node("recorder", *settings)

    def much_more_than_it_keeps():
        begun = published(load)[0]
        observer.wait_for(lambda: published(load)[0] > begun + 400, "four seconds of blocks")

    observer.wait_for(lambda: told(health, "in memory [s]") >= 0.9, "a second in memory")
    much_more_than_it_keeps()
    assert told(health, "messages") == 0
    success, sentence = observer.trigger("snapshot", "recorder")
    assert success, sentence
    # What it told before the first snapshot may still arrive.
    observer.wait_for(lambda: told(health, "snapshots") == 1.0 and told(health, "in memory [s]") >= 0.9, "another one")
    much_more_than_it_keeps()
    squeal = observer.node.create_publisher(DiagnosticArray, "squeal/state", 10)
    observer.wait_for(lambda: squeal.get_subscription_count() >= 2, "the recorder's subscriptions")
    state = DiagnosticStatus(name="squeal", values=[KeyValue(key="detected", value="true")])
    squeal.publish(DiagnosticArray(status=[state]))
    observer.wait_for(lambda: told(health, "snapshots") == 2.0, "the squeal's snapshot")
    assert recorder.end()[0] == 0
    bag = Bag(tmp_path / "run")
    reasons = [record.values["reason"] for record in bag.metadata_records if record.name == "snapshot"]
    assert reasons == ["on request", "squeal detected"]
    assert len(bag.files) == 2
    missing = 0
    for path in bag.files:
        alone = Bag(path)
        taken = [
            (m.publish_time, int(samples_from_cdr(m.data).samples["seq"][0]) // ROWS)
            for m in alone.messages(["/daq/samples"])
        ]
        assert taken
        # The ring drops in the order of arrival: a recorder that is held up keeps its second and what waited for it.
        assert (taken[-1][0] - taken[0][0]) * 1e-9 < 2.5
        blocks = [block for _, block in taken]
        assert blocks == sorted(set(blocks))
        missing += blocks[-1] - blocks[0] + 1 - len(blocks)
        assert alone.topics["/rig/description"].message_count == 1
    # What a busy machine lost on the way here is told.
    assert missing <= int(bag.custom_data["lost_messages"])


@pytest.fixture(params=[pytest.param("tmpfs", marks=pytest.mark.slow), "told"])
def small_disk(request, processes, tmp_path):
    """(folder, starts a recorder): on a disk of 30 MB, or on one of which it is told that it has these."""
    if request.param == "told":
        command = [sys.executable, Path(__file__).with_name("recorder_on_small_disk.py"), tmp_path, 30.0, "--ros-args"]
        yield tmp_path, lambda *settings: processes.start([*command, *settings])
        return
    disk = tmp_path / "disk"
    disk.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=30m", "tmpfs", disk], capture_output=True, check=False
    )
    if mounted.returncode != 0:
        pytest.skip(f"a tmpfs cannot be mounted here: {mounted.stderr.decode().strip()}")
    yield disk, partial(processes.node, "recorder")
    subprocess.run(["umount", "-l", disk], check=True)


def test_a_full_disk_ends_the_recording_and_nothing_else(observer, health, load, small_disk):
    folder, start_recorder = small_disk
    recorder = start_recorder(*parameters(directory=folder / "run", disk_reserve=2.0))
    observer.wait_for(lambda: (health_of(health, "recorder") or (0,))[0] == 2, "the recorder's error")
    _level, sentence, _ = health_of(health, "recorder")
    assert sentence.startswith(f"The disk of {folder / 'run'} is full")
    assert "recording stopped: The disk of" in recorder.errors
    bag = Bag(folder / "run")
    assert bag.ending == f"stopped: {sentence}"
    assert damage(folder / "run") == []
    assert bag.topics["/daq/samples"].message_count > 100
    blocks = published(load)[0]
    observer.wait_for(lambda: published(load)[0] > blocks + 20, "the load going on")
    assert observer.trigger("stop", "recorder") == (False, "nothing is being recorded")
    assert recorder.end()[0] == 0


@pytest.mark.slow
def test_a_stop_during_a_stall_of_the_disk_loses_nothing(processes, observer, tmp_path, load):
    mark = tmp_path / "stalled"
    recorder = stalled(processes, mark, 3.0, directory=tmp_path / "run")
    observer.wait_for(mark.exists, "the stall")
    begun = published(load)[0]
    observer.wait_for(lambda: published(load)[0] > begun + 100, "a second of blocks that wait")
    sent = published(load)[0]
    assert recorder.end()[0] == 0
    bag = Bag(tmp_path / "run")
    assert bag.ending == "complete"
    numbers = {"/daq/samples": [], "/truth/samples": []}
    for message in bag.messages(list(numbers)):
        numbers[message.topic].append(samples_from_cdr(message.data).samples["seq"][0] // ROWS)
    # What waited is written: the last blocks are there. What the middleware dropped before, on a busy machine, is told.
    assert all(blocks[-1] >= sent - 1 for blocks in numbers.values())
    missing = sum(blocks[-1] - blocks[0] + 1 - len(blocks) for blocks in numbers.values())
    # It counts those of other topics too.
    assert int(bag.custom_data["lost_messages"]) >= missing
    assert missing < 0.1 * sent
    assert verify(bag.path).sound == (int(bag.custom_data["lost_messages"]) == 0)


@pytest.mark.slow
def test_one_odd_stamp_and_an_early_snapshot_end_no_recording(processes, observer, health, tmp_path):
    """The squeal comes before anything else: there is nothing to write yet."""
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
    from std_msgs.msg import String

    settings = {"directory": tmp_path / "run", "mode": "snapshot", "topics": ["words"], "snapshot_delay": 0.0}
    recorder = processes.node("recorder", *parameters(**settings))
    squeal = observer.node.create_publisher(DiagnosticArray, "squeal/state", 10)
    observer.wait_for(lambda: squeal.get_subscription_count() >= 1, "the recorder's subscription")
    state = DiagnosticStatus(name="squeal", values=[KeyValue(key="detected", value="true")])
    squeal.publish(DiagnosticArray(status=[state]))
    observer.wait_for(lambda: "nothing is in memory yet" in recorder.errors, "its warning")
    words = observer.node.create_publisher(String, "words", 10)
    observer.wait_for(lambda: words.get_subscription_count() == 1, "the topic's subscription")
    words.publish(String(data="word"))
    observer.wait_for(lambda: observer.trigger("snapshot", "recorder")[0], "the snapshot")
    observer.wait_for(lambda: health_of(health, "recorder"), "its health")
    assert health_of(health, "recorder")[0] == 0
    assert recorder.end()[0] == 0
    assert Bag(tmp_path / "run").ending == "complete"


@pytest.mark.slow
def test_messages_that_overrun_the_queue_are_counted_for_the_bag_that_lacks_them(processes, observer, health, tmp_path):
    """Fast DDS replaces the oldest without a word; the numbers of the publisher tell."""
    from rclpy.qos import QoSProfile
    from std_msgs.msg import String

    mark = tmp_path / "stalled"
    recorder = stalled(processes, mark, 6.0, directory=tmp_path / "run", topics=["words"])
    words = observer.node.create_publisher(String, "words", QoSProfile(depth=5000))
    observer.wait_for(lambda: words.get_subscription_count() == 1, "the subscription")
    numbers = count()
    timer = observer.node.create_timer(0.01, lambda: words.publish(String(data=str(next(numbers)))))
    observer.wait_for(mark.exists, "the stall")
    timer.cancel()
    for _ in range(3000):
        words.publish(String(data=str(next(numbers))))
    sent = next(numbers)
    assert observer.trigger("stop", "recorder")[0]
    assert observer.trigger("start", "recorder")[0]
    observer.wait_for(lambda: told(health, "lost messages", 1.0) == 0, "a health of the second bag")
    for _ in range(5):
        words.publish(String(data="a word"))
    observer.wait_for(lambda: told(health, "messages") == 5, "messages of the second bag")
    assert health_of(health, "recorder")[0] == 0
    assert recorder.end()[0] == 0
    first, second = Bag(tmp_path / "run"), Bag(tmp_path / "run_2")
    kept = first.topics["/words"].message_count
    assert 1000 <= kept < sent
    assert int(first.custom_data["lost_messages"]) == sent - kept
    assert (second.topics["/words"].message_count, second.custom_data["lost_messages"]) == (5, "0")


def test_readers_of_others_agree_message_by_message(processes, observer, health, tmp_path, load):
    from mcap.reader import make_reader
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    recorder = processes.node("recorder", *parameters(directory=tmp_path / "run"))
    recording(observer, health)
    # One of its own: the load's are missed for as long as the recorder has not found that publisher, some seconds now
    # and then on a busy machine.
    assert observer.set({"snapshot_delay": 12.5}, "recorder") == [(True, "")]
    recording(observer, health, 1500)
    assert recorder.end()[0] == 0
    bag = Bag(tmp_path / "run")
    ours = sorted((m.topic, m.log_time, m.data) for m in bag.messages())
    with open(bag.files[0], "rb") as stream:
        theirs = [(c.topic, m.log_time, m.data) for _, c, m in make_reader(stream, validate_crcs=True).iter_messages()]
    assert sorted(theirs) == ours
    store = get_typestore(Stores.ROS2_JAZZY)
    with AnyReader([tmp_path / "run"], default_typestore=store) as reader:
        theirs = []
        for connection, time, data in reader.messages():
            reader.deserialize(data, connection.msgtype)
            theirs.append((connection.topic, time, bytes(data)))
    assert sorted(theirs) == ours
    assert {m[0] for m in ours} >= {*CLOUDS, "/rosout", "/parameter_events", "/diagnostics"}
