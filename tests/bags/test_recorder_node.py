"""The recorder as a process: late topics, services, snapshots, provenance, a full disk."""

import shutil
import signal
import subprocess
from itertools import count
from pathlib import Path

import pytest
from bag_nodes import ended, published, wait_until
from full_load import CLOUDS, ROWS

from squeal_rig.recording import Bag, samples_from_cdr
from squeal_rig.recording.parameter_log import parameters_of
from squeal_rig.recording.verify import verify


@pytest.fixture
def load(children, tmp_path):
    children.load(tmp_path / "load.txt")
    return tmp_path / "load.txt"


def recording(client, least=100):
    client.wait_for(lambda: client.messages_recorded() > least, "recorded messages")


def parameter_records(bag, name):
    return [parameters_of(record.values) for record in bag.metadata_records if record.name == name]


def test_late_topics_of_any_type_and_publishers_that_offer_less_are_recorded(children, client, tmp_path):
    from geometry_msgs.msg import Twist
    from rclpy.qos import QoSProfile, ReliabilityPolicy

    recorder = children.node("recorder", directory=tmp_path / "run", topics=["*"])
    client.wait_for(lambda: "recorder" in client.health, "the recorder")

    def topics():
        return int(client.health["recorder"][2]["topics"])

    before = topics()
    first = client.node.create_publisher(Twist, "/late", 10)
    client.wait_for(lambda: topics() > before, "the late topic")
    client.wait_for(lambda: first.get_subscription_count() == 1, "its subscription")
    first.publish(Twist())
    # Reliable until now; a best-effort publisher beside it needs a subscription that asks for less.
    second = client.node.create_publisher(
        Twist, "/late", QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
    )
    client.wait_for(lambda: second.get_subscription_count() == 1, "the weaker subscription")
    had = client.messages_recorded()
    second.publish(Twist())
    client.wait_for(lambda: client.messages_recorded() > had, "the second message")
    assert ended(recorder) == 0
    late = Bag(tmp_path / "run").topics["/late"]
    assert (late.type_name, late.message_count) == ("geometry_msgs/msg/Twist", 2)
    assert "MSG: geometry_msgs/msg/Vector3" in late.schema.text
    assert late.type_hash.startswith("RIHS01_")
    assert late.qos[0].reliability == "reliable"


def test_parameters_of_every_node_and_each_change_are_in_the_bag(children, client, tmp_path):
    children.node("friction_estimator")
    recorder = children.node("recorder", directory=tmp_path / "run")

    def known():
        return int(client.health["recorder"][2]["nodes with known parameters"]) if "recorder" in client.health else 0

    client.wait_for(lambda: known() >= 3, "parameters of recorder, estimator and client")
    assert client.set("/recorder", "snapshot_delay", 12.5) == (True, "")
    had = client.messages_recorded()
    client.wait_for(lambda: client.messages_recorded() > had, "something more")
    assert ended(recorder, signal.SIGTERM) == 0
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


def test_stop_start_and_split_leave_sound_bags(children, client, tmp_path, load):
    recorder = children.node("recorder", directory=tmp_path / "run")
    recording(client)
    assert client.trigger("recorder/split")[0]
    assert client.trigger("recorder/stop") == (True, f"closed {tmp_path / 'run'}")
    assert client.trigger("recorder/stop") == (False, "nothing is being recorded")
    assert client.trigger("recorder/snapshot")[0] is False
    assert client.trigger("recorder/start")[0]
    client.health.clear()
    recording(client)
    assert ended(recorder) == 0
    first, second = Bag(tmp_path / "run"), Bag(tmp_path / "run_2")
    assert len(first.files) == 2
    assert first.ending == "complete: stopped on request"
    for bag in (first, second):
        assert verify(bag.path).findings == []
        assert bag.topics["/rig/description"].message_count == 1, "the latched value is in each"
        assert {node for node, _, _ in parameter_records(bag, "parameters")} >= {"/load", "/recorder"}


def test_a_snapshot_holds_the_last_seconds_on_request_and_on_squeal(children, client, tmp_path, load):
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

    recorder = children.node(
        "recorder", directory=tmp_path / "run", mode="snapshot", snapshot_duration=1.0, snapshot_delay=0.2
    )

    def told(key):
        return float(client.health["recorder"][2][key]) if "recorder" in client.health else 0.0

    client.wait_for(lambda: told("in memory [s]") >= 0.9, "a second in memory")
    assert client.messages_recorded() == 0
    success, sentence = client.trigger("recorder/snapshot")
    assert success, sentence
    client.health.clear()  # what it told before
    client.wait_for(lambda: told("in memory [s]") >= 0.9, "another second in memory")
    squeal = client.node.create_publisher(DiagnosticArray, "squeal/state", 10)
    client.wait_for(lambda: squeal.get_subscription_count() >= 2, "the recorder's subscriptions")
    state = DiagnosticStatus(name="squeal", values=[KeyValue(key="detected", value="true")])
    squeal.publish(DiagnosticArray(status=[state]))
    client.wait_for(lambda: told("snapshots") == 2.0, "the squeal's snapshot")
    assert ended(recorder) == 0
    bag = Bag(tmp_path / "run")
    reasons = [record.values["reason"] for record in bag.metadata_records if record.name == "snapshot"]
    assert reasons == ["on request", "squeal detected"]
    assert len(bag.files) == 2
    for path in bag.files:
        alone = Bag(path)
        # The ring drops by whole messages, and one more tick may come before it is written.
        assert 0.5 < alone.duration < 1.5
        assert 50 <= alone.topics["/daq/samples"].message_count <= 115  # a busy machine makes fewer blocks
        assert alone.topics["/rig/description"].message_count == 1


@pytest.fixture(params=["tmpfs", "reserve"])
def small_disk(request, tmp_path):
    """(folder, reserve [MB]): a disk of 30 MB, or one on which all but 30 MB are to be left free."""
    if request.param == "reserve":
        yield tmp_path, shutil.disk_usage(tmp_path).free / 1e6 - 30.0
        return
    disk = tmp_path / "disk"
    disk.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=30m", "tmpfs", disk], capture_output=True, check=False
    )
    if mounted.returncode != 0:
        pytest.skip(f"a tmpfs cannot be mounted here: {mounted.stderr.decode().strip()}")
    yield disk, 2.0
    subprocess.run(["umount", "-l", disk], check=True)


def test_a_full_disk_ends_the_recording_and_nothing_else(children, client, load, small_disk):
    folder, reserve = small_disk
    recorder = children.node("recorder", directory=folder / "run", disk_reserve=round(reserve, 3))
    client.wait_for(lambda: client.health.get("recorder", (0,))[0] == 2, "the recorder's error", 60.0)
    _level, sentence, _ = client.health["recorder"]
    assert sentence.startswith(f"The disk of {folder / 'run'} is full")
    assert "recording stopped: The disk of" in recorder.log.read_text()
    bag = Bag(folder / "run")
    assert bag.ending == f"stopped: {sentence}"
    assert verify(folder / "run").findings == []
    assert bag.topics["/daq/samples"].message_count > 100
    blocks = published(load)[0]
    wait_until(lambda: published(load)[0] > blocks + 20, "the load going on")
    assert client.trigger("recorder/stop") == (False, "nothing is being recorded")
    assert ended(recorder) == 0


def test_a_stop_during_a_stall_of_the_disk_loses_nothing(children, client, tmp_path, load):
    mark = tmp_path / "stalled"
    script = Path(__file__).with_name("stalled_recorder.py")
    given = ["--ros-args", "-p", f"directory:={tmp_path / 'run'}"]
    recorder = children.start([script, mark, 3.0, *given], "recorder")
    wait_until(mark.exists, "the stall")
    begun = published(load)[0]
    wait_until(lambda: published(load)[0] > begun + 100, "a second of blocks that wait")
    sent = published(load)[0]
    assert ended(recorder) == 0
    bag = Bag(tmp_path / "run")
    assert (bag.ending, bag.custom_data["lost_messages"]) == ("complete", "0")
    last = {message.topic: message.data for message in bag.messages(["/daq/samples", "/truth/samples"])}
    for data in last.values():
        assert samples_from_cdr(data).samples["seq"][0] // ROWS >= sent - 1
    assert verify(bag.path).sound


def test_one_odd_stamp_and_an_early_snapshot_end_no_recording(children, client, tmp_path):
    """The squeal comes before anything else: there is nothing to write yet."""
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
    from std_msgs.msg import String

    recorder = children.node(
        "recorder", directory=tmp_path / "run", mode="snapshot", topics=["words"], snapshot_delay=0.0
    )
    squeal = client.node.create_publisher(DiagnosticArray, "squeal/state", 10)
    client.wait_for(lambda: squeal.get_subscription_count() >= 1, "the recorder's subscription")
    state = DiagnosticStatus(name="squeal", values=[KeyValue(key="detected", value="true")])
    squeal.publish(DiagnosticArray(status=[state]))
    client.wait_for(lambda: "nothing is in memory yet" in recorder.log.read_text(), "its warning")
    words = client.node.create_publisher(String, "words", 10)
    client.wait_for(lambda: words.get_subscription_count() == 1, "the topic's subscription")
    words.publish(String(data="word"))
    client.wait_for(lambda: client.trigger("recorder/snapshot")[0], "the snapshot")
    assert client.health["recorder"][0] == 0
    assert ended(recorder) == 0
    assert Bag(tmp_path / "run").ending == "complete"


def test_messages_that_overrun_the_queue_are_counted(children, client, tmp_path):
    """Fast DDS replaces the oldest without a word; the numbers of the publisher tell."""
    from rclpy.qos import QoSProfile
    from std_msgs.msg import String

    mark = tmp_path / "stalled"
    script = Path(__file__).with_name("stalled_recorder.py")
    given = ["--ros-args", "-p", f"directory:={tmp_path / 'run'}", "-p", "topics:=[words]"]
    recorder = children.start([script, mark, 6.0, *given], "recorder")
    words = client.node.create_publisher(String, "words", QoSProfile(depth=5000))
    client.wait_for(lambda: words.get_subscription_count() == 1, "the subscription")
    numbers = count()
    timer = client.node.create_timer(0.01, lambda: words.publish(String(data=str(next(numbers)))))
    client.wait_for(mark.exists, "the stall")
    timer.cancel()
    for _ in range(3000):
        words.publish(String(data=str(next(numbers))))
    sent = next(numbers)
    assert ended(recorder) == 0
    bag = Bag(tmp_path / "run")
    kept = bag.topics["/words"].message_count
    assert 1000 <= kept < sent
    assert int(bag.custom_data["lost_messages"]) == sent - kept


def test_readers_of_others_agree_message_by_message(children, client, tmp_path, load):
    from mcap.reader import make_reader
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    recorder = children.node("recorder", directory=tmp_path / "run")
    recording(client, 1500)  # three seconds: the load changes its parameter every second
    assert ended(recorder) == 0
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
